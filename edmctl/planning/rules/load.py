"""Loading a profile: file, the files it extends, overrides, all rules; and a line of each shipped one."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ValidationError

from edmctl.dataclasses import astuple, dataclass, replace
from edmctl.errors import Diagnostic, ProfileError
from edmctl.failures import Code
from edmctl.planning.forecast import Job, forecast
from edmctl.planning.removal import recipes_of, with_expected_erosion, with_regimes, with_sought_reference
from edmctl.planning.rules import machining, sites
from edmctl.planning.rules.bound import Finding, Findings, Rule
from edmctl.profile.diagnose import schema_diagnostics, schema_problems
from edmctl.profile.folders import find_profile, shipped_profiles
from edmctl.profile.model import Profile, ProfileFile, SimSettings
from edmctl.profile.places import Place, places
from edmctl.profile.read import SET_OPTION, Sources, apply_overrides, read_chain
from edmctl.profile.setup import Setup
from edmctl.profile.tables import TomlTable, content_hash
from edmctl.results.result import Forecast, ProfileSummary

OF_PULSES: tuple[Rule, ...] = (
    machining.reference_window,
    machining.slope_against_feed,
    machining.limit_cycle,
    machining.pulse_energy,
    *machining.PULSE_BOUNDS,
    machining.discharge_time,
    machining.within_the_laws,
)
"""What holds for pulses and reference of every regime."""
SHARES = 1e-6
TIME_LIMIT_FORECASTS = 3.0


def regimes(job: Job) -> Findings:
    """Rule 37: shares make up the whole depth of one blind hole, and every regime is a recipe that works."""
    profile = job.profile
    if not profile.regimes:
        return
    unsuited = (
        (profile.target.kind != "depth", f'target.kind = "{profile.target.kind}"'),
        (bool(profile.sites), "[[sites]]"),
        (profile.path is not None, "[path]"),
        (profile.wear.remeasure == "never", 'wear.remeasure = "never"'),
        (profile.pulse.mode == "isopulse", 'pulse.mode = "isopulse"'),
    )
    wrong = [
        (f"regimes are for the measured depth of one blind hole, not for {what}", "leave one of the two out")
        for is_unsuited, what in unsuited
        if is_unsuited
    ]
    whole = math.fsum(regime.share for regime in profile.regimes)
    if abs(whole - 1.0) > SHARES:
        share = 1.0 - whole + profile.regimes[-1].share
        message = f"the shares of all regimes are {whole:g} together, not 1"
        wrong.append((message, f"the last one could have {share:.3g}"))
    names = Counter(regime.name for regime in profile.regimes)
    wrong += [(f"two regimes are called {name}", "give each a name") for name, n in names.items() if n > 1]
    if wrong:
        yield Finding(Code.REGIMES, "regimes", *wrong[0])
        return
    for number, recipe in enumerate(recipes_of(with_regimes(profile))):
        if recipe.profile.pulse == profile.pulse and recipe.profile.servo == profile.servo:
            continue  # its findings are those of the profile
        alone = Job(recipe.profile.model_copy(update={"regimes": []}), job.setup, job.places)
        for one in (one for rule in OF_PULSES for one in rule(alone)):
            yield replace(one, key=("regimes", number), message=f"regime {recipe.name}: {one.message}")


BEFORE_ALL: tuple[Rule, ...] = (machining.reference_stated_once, sites.path_keys, machining.does_nothing)
"""Rules without which nothing can be calculated: the others are checked once these are kept."""
RULES: tuple[Rule, ...] = (
    machining.reference_window,
    machining.stroke,
    machining.slope_against_feed,
    machining.limit_cycle,
    *machining.BOUNDS,
    machining.jump,
    machining.pulse_energy,
    *machining.PULSE_BOUNDS,
    machining.discharge_time,
    sites.tolerance,
    *sites.BOUNDS,
    sites.kinds,
    sites.names,
    sites.clear_of_each_other,
    sites.within_reach,
    sites.array_wear,
    sites.LAYER,
    sites.depth_beyond_tolerance,
    machining.known_materials,
    machining.within_the_laws,
    regimes,
)
"""Every other rule. Rule 12 (one touch speed for Z1, Z2 and Z3) has no key to break it."""


@dataclass(frozen=True, slots=True)
class LoadedProfile:
    """A checked profile, and where it came from; `text` is the file verbatim.

    `sha256` is of the recipe in effect (after `extends`, `--set` and defaults), `sim_sha256` of the `[sim]` table:
    equal hashes mean equal jobs. `places` are all of `[[sites]]`. `forecast` is of the job on the machine that it
    was checked for. `stated` is what files and overrides state.
    """

    profile: Profile
    sim: SimSettings
    path: Path
    text: str
    sha256: str
    sim_sha256: str
    overrides: tuple[str, ...]
    warnings: tuple[Diagnostic, ...]
    places: tuple[Place, ...]
    forecast: Forecast
    stated: TomlTable

    @property
    def recipe(self) -> tuple[str, str]:
        """Both hashes."""
        return self.sha256, self.sim_sha256

    def __repr__(self) -> str:
        changed = f", {len(self.overrides)} values overridden" if self.overrides else ""
        return f"<LoadedProfile {self.profile.meta.name}, {self.path}{changed}>"


def load_profile(
    name_or_path: str, overrides: Sequence[str] = (), setup: Setup | None = None
) -> LoadedProfile:
    """Load and check a profile by path or shipped name.

    `overrides` are `key=value` texts; `setup` is the machine it is checked for, by default the stock one. Rules are
    checked once every value can be read. Raises ProfileError with every wrong value or every violated rule,
    UsageError when there is no such profile.
    """
    machine = setup if setup is not None else Setup()
    path = find_profile(name_or_path)
    file = read_chain(path)
    merged = apply_overrides(file, overrides)
    sources = Sources(merged.sources, file.sources[0])
    try:
        written = ProfileFile.model_validate(merged.table)
    except ValidationError as error:
        problems = schema_problems(error, ProfileFile, merged.table)
        wrong = schema_diagnostics(problems, ProfileFile, merged.table, sources)
        raise ProfileError(tuple(wrong)) from None
    recipe = Profile.model_construct(
        _fields_set=written.model_fields_set - {"sim"},
        **{name: getattr(written, name) for name in Profile.model_fields},
    )
    placed = _places(recipe, sources)
    job = Job(recipe, machine, placed)
    warnings = _refuse_errors([one for rule in BEFORE_ALL for one in rule(job)], sources)
    with_share = _with_share(recipe)
    job = Job(with_expected_erosion(with_share), machine, placed)
    findings = [one for rule in RULES for one in rule(job)]
    if all(one.code.startswith("W") for one in findings):
        findings += machining.stated_agrees(Job(with_share, machine))
    warnings += _refuse_errors(findings, sources)
    job = Job(_with_time_limit(_completed(with_share), machine, placed), machine, placed)
    late = [*sites.time_limit(job), *machining.sim_agrees(job.profile, written.sim)]
    return LoadedProfile(
        profile=job.profile,
        sim=written.sim,
        path=path,
        text=file.sources[0].text,
        sha256=_sha256(job.profile, placed),
        sim_sha256=_sha256(written.sim),
        overrides=merged.changes,
        warnings=warnings + _refuse_errors(late, sources),
        places=placed,
        forecast=job.forecast,
        stated=merged.table,
    )


def _places(profile: Profile, sources: Sources) -> tuple[Place, ...]:
    """Return the places of a profile. Raises ProfileError; what has no line of its own is located at `sites`."""
    where = sources.value(("sites",))
    folder = Path() if where.file == SET_OPTION else Path(where.file).parent
    try:
        return places(profile, folder)
    except ProfileError as error:
        diagnostics = (replace(one, where=one.where or where) for one in error.diagnostics)
        raise ProfileError(tuple(diagnostics)) from None


def _refuse_errors(findings: Sequence[Finding], sources: Sources) -> tuple[Diagnostic, ...]:
    """Return the warnings. Raises ProfileError with all diagnostics if one is an error."""
    diagnostics = tuple(_diagnostic(one, sources) for one in findings)
    if all(one.is_warning for one in diagnostics):
        return diagnostics
    raise ProfileError(diagnostics)


def _diagnostic(one: Finding, sources: Sources) -> Diagnostic:
    key = tuple(one.key.split(".")) if isinstance(one.key, str) else one.key
    where = one.where or sources.value(key)
    return Diagnostic(one.code, one.message, one.hint, where, one.code.startswith("W"))


def _with_share(profile: Profile) -> Profile:
    """Return the profile with its servo reference as a share of the open voltage."""
    if profile.adaptive.seek_reference:
        return with_sought_reference(profile)
    if profile.servo.reference_v is None:
        return profile
    return profile.having("servo", reference=profile.servo.reference_v / profile.pulse.duty_voltage_v)


def _completed(profile: Profile) -> Profile:
    """Fill in what regimes leave to the profile, and what is expected of materials; the reference is a share."""
    stated = with_regimes(profile)
    if stated.servo.reference_v is not None:
        stated = stated.having("servo", reference_v=None)
    return with_expected_erosion(stated)


def _with_time_limit(profile: Profile, setup: Setup, placed: tuple[Place, ...]) -> Profile:
    """Fill in the time limit where none is given, from the forecast."""
    if "max_time_s" in profile.limits.model_fields_set:
        return profile
    max_time_s = TIME_LIMIT_FORECASTS * forecast(profile, setup, placed).time_s
    return profile.having("limits", max_time_s=max_time_s)


def _sha256(model: BaseModel, placed: tuple[Place, ...] = ()) -> str:
    """Hash of a table, and of the places that it does not hold itself."""
    values = model.model_dump(by_alias=True)
    if placed:
        values["places"] = [astuple(replace(place, where=None))[:-1] for place in placed]
    return content_hash(values)


def summaries(setup: Setup) -> list[ProfileSummary]:
    """A summary of every shipped profile, for a machine."""
    return [_summary(name, setup) for name in shipped_profiles()]


def _summary(name: str, setup: Setup) -> ProfileSummary:
    try:
        loaded = load_profile(name, setup=setup)
    except ProfileError as error:
        return ProfileSummary(name, name, "", "", None, None, None, None, None, refused=error.message)
    expected, meta = loaded.forecast, loaded.profile.meta
    return ProfileSummary(
        profile=name,
        name=meta.name,
        description=meta.description,
        materials=f"{loaded.profile.tool.material} → {loaded.profile.work.material}",
        time_s=expected.time_s,
        depth_um=expected.depth_um,
        holes=expected.holes,
        channel_um=expected.channel_um,
        tool_wear_um=expected.tool_wear_um,
    )
