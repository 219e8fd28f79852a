"""Loading a profile: file, the files it extends, overrides, all checks; and a line of each shipped one."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ValidationError

from edmctl.dataclasses import astuple, dataclass, replace
from edmctl.errors import Diagnostic, ProfileError
from edmctl.planning.erosion import with_expected_erosion
from edmctl.planning.forecast import Job
from edmctl.planning.rules.pulse import sim_agrees
from edmctl.planning.rules.target import time_limit
from edmctl.planning.rules.violations import (
    in_share_only,
    partial_profile,
    violations,
    with_time_limit,
)
from edmctl.profile.diagnose import rule_diagnostics, schema_diagnostics, schema_problems
from edmctl.profile.findings import Finding
from edmctl.profile.folders import find_profile, shipped_profiles
from edmctl.profile.model import Profile, ProfileFile, SimSettings
from edmctl.profile.places import Place, places
from edmctl.profile.positions import SET_OPTION, Sources, TomlTable
from edmctl.profile.read import apply_overrides, read_chain
from edmctl.profile.setup import Setup
from edmctl.results.result import Forecast, ProfileSummary


@dataclass(frozen=True, slots=True)
class LoadedProfile:
    """A checked profile, and where it came from.

    `text` is the file verbatim. `sha256` is of the recipe in effect (after `extends`, `--set` and defaults),
    `sim_sha256` of the `[sim]` table in effect: equal hashes mean equal jobs, however they were written. `places`
    are those of `[[sites]]`, those from files too; none where the job is one hole or a channel.
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
    forecast: Forecast  # of the job on the machine that it was checked for
    stated: TomlTable
    """What the file, the files that it extends and the overrides state; all else are defaults or follows from it."""

    @property
    def recipes(self) -> tuple[tuple[str, str], ...]:
        """Both hashes; then those of earlier versions, in which the controller in C was not the only one."""
        return (self.sha256, self.sim_sha256), (self.sha256, _sha256(self.sim))

    def __repr__(self) -> str:
        changed = f", {len(self.overrides)} values overridden" if self.overrides else ""
        return f"<LoadedProfile {self.profile.meta.name}, {self.path}{changed}>"


def load_profile(
    name_or_path: str, overrides: Sequence[str] = (), setup: Setup | None = None
) -> LoadedProfile:
    """Load and check a profile by path or shipped name.

    `overrides` are `key=value` texts; `setup` is the machine it is checked for, by default the stock one.
    Raises ProfileError with every diagnostic, UsageError when there is no such profile.
    """
    machine = setup if setup is not None else Setup()
    path = find_profile(name_or_path)
    file = read_chain(path)
    merged = apply_overrides(file, overrides)
    sources = Sources(merged.sources, file.sources[0])
    written = _written(merged.table, sources, machine)
    recipe = Profile.model_construct(
        _fields_set=written.model_fields_set - {"sim"},
        **{name: getattr(written, name) for name in Profile.model_fields},
    )
    found, unread = _places(recipe, path, sources)
    warnings = _refuse_errors(violations(recipe, machine, found), sources, unread)
    profile = with_time_limit(with_expected_erosion(in_share_only(recipe)), machine, found)
    job = Job(profile, machine, found)
    late = [*time_limit(job), *sim_agrees(profile, written.sim)]
    warnings += _refuse_errors(late, sources)
    return LoadedProfile(
        profile=profile,
        sim=written.sim,
        path=path,
        text=file.sources[0].text,
        sha256=_sha256(profile, found),
        sim_sha256=_sha256(_as_before(written.sim)),
        overrides=merged.changes,
        warnings=warnings,
        places=found,
        forecast=job.forecast,
        stated=merged.table,
    )


def _written(table: TomlTable, sources: Sources, machine: Setup) -> ProfileFile:
    """Validate a table as a profile; report wrong values together with violated rules."""
    try:
        return ProfileFile.model_validate(table)
    except ValidationError as error:
        problems = schema_problems(error, ProfileFile, table)
    wrong = schema_diagnostics(problems, ProfileFile, table, sources)
    wrong += rule_diagnostics(violations(partial_profile(table, problems), machine), sources)
    raise ProfileError(tuple(wrong))


def _places(
    profile: Profile, path: Path, sources: Sources
) -> tuple[tuple[Place, ...], tuple[Diagnostic, ...]]:
    """Return the places of a profile, or why they are unknown."""
    if not profile.sites:
        return (), ()
    where = sources.value(("sites",))
    folder = Path() if where.file == SET_OPTION else Path(where.file).parent
    try:
        return places(profile, folder), ()
    except ProfileError as error:
        return (), tuple(replace(d, where=d.where or where) for d in error.diagnostics)


def _refuse_errors(
    findings: list[Finding], sources: Sources, others: tuple[Diagnostic, ...] = ()
) -> tuple[Diagnostic, ...]:
    """Return the warnings. Raises ProfileError with all diagnostics if one is an error."""
    diagnostics = (*rule_diagnostics(findings, sources), *others)
    if all(d.is_warning for d in diagnostics):
        return diagnostics
    raise ProfileError(diagnostics)


def _as_before(sim: SimSettings) -> SimSettings:
    """Return the settings with the former name of the controller, which the hash contains."""
    return sim.model_copy(update={"controller": "python"}) if sim.controller == "firmware" else sim


def _sha256(model: BaseModel, found: tuple[Place, ...] = ()) -> str:
    """Hash of a table, and of the places that it does not hold itself."""
    values = model.model_dump(by_alias=True)
    if found:
        values["places"] = [astuple(replace(place, where=None))[:-1] for place in found]
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()


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
