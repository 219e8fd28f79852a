"""The cross-field rules that a profile violates, also one of which some values could not be read.

In such a partial profile a value that is wrong or missing is absent: asking for it raises AttributeError (see
`lacks_value`), and rules that need it are left out.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, get_args

from pydantic import TypeAdapter

from edmctl.failures import Code
from edmctl.planning.erosion import recipes_of, with_expected_erosion, with_regimes, with_sought_reference
from edmctl.planning.forecast import Job, forecast
from edmctl.planning.rules import motion, pulse, sites, target
from edmctl.profile.findings import Finding
from edmctl.profile.model import Profile, Regime, SiteTable
from edmctl.profile.places import Place
from edmctl.profile.positions import KeyPath, TomlTable
from edmctl.profile.setup import Setup
from edmctl.profile.tables import Table, keys_at, nearest

OF_PULSES: tuple[Callable[[Job], Iterable[Finding]], ...] = (
    pulse.reference_window,
    motion.slope_against_feed,
    motion.limit_cycle,
    pulse.pulse_energy,
    *pulse.PULSE_TIMES,
    pulse.FILTER_CORNER,
    *pulse.DISCHARGE_TIME,
    pulse.within_the_laws,
)
"""What holds for pulses and reference of every regime."""
SHARES = 1e-6
SUITS = "a depth of one blind hole that is measured"


def regimes(job: Job) -> Iterator[Finding]:
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
        (f"regimes are for {SUITS}, not for {what}", "leave one of the two out")
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
        yield Finding(Code.REGIMES, ("regimes",), *wrong[0])
        return
    for number, recipe in enumerate(recipes_of(with_regimes(profile))):
        if recipe.profile.pulse == profile.pulse and recipe.profile.servo == profile.servo:
            continue  # what is wrong with it has been said of the profile
        alone = recipe.profile.model_copy(update={"regimes": []})
        for found in (one for rule in OF_PULSES for one in rule(Job(alone, job.setup, job.places))):
            message = f"regime {recipe.name}: {found.message}"
            yield replace(found, path=("regimes", number), message=message)


RULES: tuple[Callable[[Job], Iterable[Finding]], ...] = (
    pulse.reference_window,
    motion.stroke,
    motion.slope_against_feed,
    motion.limit_cycle,
    *motion.RAMP_ORDER,
    motion.OFFSET,
    motion.jump,
    pulse.pulse_energy,
    *pulse.PULSE_TIMES,
    motion.through_stroke,
    target.tolerance,
    pulse.FILTER_CORNER,
    target.FEED_WITHOUT_REMEASURING,
    *pulse.DISCHARGE_TIME,
    target.TOOL_WEAR,
    motion.APPROACH_TRAVEL,
    target.BLIND_DEPTH,
    motion.ACTUATOR_VOLTAGE,
    motion.PAD_DISTANCE,
    *target.THROUGH_TARGET,
    *motion.ADAPTIVE,
    sites.CHANNEL_DEPTH,
    sites.SITES_OR_PATH,
    sites.depths_of_places,
    sites.names,
    sites.walls,
    sites.clear_of_each_other,
    sites.within_reach,
    sites.array_wear,
    sites.array_stroke,
    sites.LAYER,
    target.depth_shown,
    target.depth_beyond_tolerance,
    pulse.known_materials,
    pulse.within_the_laws,
    regimes,
)
"""Every rule, in order of its number. Rule 12 (one touch speed for Z1, Z2 and Z3) has no key to break it."""

TIME_LIMIT_FORECASTS = 3.0
EXPECTED = (
    ("work", "removal_um3_per_uj"),
    ("work", "side_gap_um"),
    ("wear", "expected_ratio"),
    ("measure", "expected_gap_um"),
)
"""What is expected of materials and pulses where it is not given."""
_LISTS: dict[str, TypeAdapter[Any]] = {
    "sites": TypeAdapter(list[SiteTable]),
    "regimes": TypeAdapter(list[Regime]),
}


def with_time_limit(profile: Profile, setup: Setup, places: tuple[Place, ...] = ()) -> Profile:
    """Fill in the time limit where none is given, from the forecast."""
    if "max_time_s" in profile.limits.model_fields_set:
        return profile
    max_time_s = TIME_LIMIT_FORECASTS * forecast(profile, setup, places).time_s
    return profile.having("limits", max_time_s=max_time_s)


def in_share_only(profile: Profile) -> Profile:
    """Turn a reference in volts, or one that is sought, into the share that it is, so that it is stated once."""
    stated = with_regimes(_with_share(profile))
    return stated if stated.servo.reference_v is None else stated.having("servo", reference_v=None)


def _with_share(profile: Profile) -> Profile:
    """Return the profile with its reference as a share of the open voltage."""
    if profile.adaptive.seek_reference:
        return with_sought_reference(profile)
    if profile.servo.reference_v is None:
        return profile
    return profile.having("servo", reference=profile.servo.reference_v / profile.pulse.duty_voltage_v)


def violations(profile: Profile, setup: Setup, places: tuple[Place, ...] = ()) -> list[Finding]:
    """Every violated rule, warnings included, in order.

    Rules that need a value which a partial profile lacks are left out.
    """
    once = _findings(reference_stated_once, Job(profile, setup))
    shaped = _findings(sites.path_keys, Job(profile, setup))
    if idle := _findings(pulse.does_nothing, Job(profile, setup)):
        return [*once, *shaped, *idle]  # no rule can be checked without removal
    share = ("servo", "reference")
    known = without(profile, share) if once else _completed(profile, _with_share, share)
    doubted = _findings(lambda job: pulse.stated_agrees(job.profile), Job(known, setup))
    open_values = [path for path in EXPECTED if not _is_given(known, *path)]
    known = _completed(known, with_expected_erosion, *open_values)
    job = Job(without(known, ("path",)) if shaped else known, setup, places)
    found = [*once, *shaped, *(finding for rule in RULES for finding in _findings(rule, job))]
    return [*found, *doubted] if all(one.is_warning for one in found) else found


def reference_stated_once(job: Job) -> Iterable[Finding]:
    """Rule 16: the servo reference is given as a share or in volts, not twice and not never."""
    servo = job.profile.servo
    share, volts = servo.reference, servo.reference_v
    given = servo.model_fields_set & {"reference", "reference_v"}
    if len(given) == 2:
        message = f"the servo reference is given twice: reference {share:g} and reference_v {volts:g} V"
        yield Finding(Code.REFERENCE_ONCE, ("servo", "reference_v"), message, "remove one of the two")
    elif not given and not job.profile.adaptive.seek_reference:
        hint = "add reference = 0.80 to [servo], or seek_reference = true to [adaptive]"
        yield Finding(Code.REFERENCE_ONCE, ("servo",), "servo.reference is missing", hint)


def _findings(rule: Callable[[Job], Iterable[Finding]], job: Job) -> list[Finding]:
    """Return the findings of a rule; none if it needs a value that could not be read."""
    try:
        return list(rule(job))
    except AttributeError as error:
        if lacks_value(error):
            return []
        raise


def _completed(
    profile: Profile, complete: Callable[[Profile], Profile], *open_values: tuple[str, ...]
) -> Profile:
    """Return the completed profile, or the profile without these values if it lacks what they follow from."""
    try:
        return complete(profile)
    except AttributeError as error:
        if lacks_value(error):
            return without(profile, *open_values)
        raise


def partial_profile(table: TomlTable, problems: Mapping[KeyPath, Code]) -> Profile:
    """What can be read of a profile whose problems are these."""
    lacking = [lost for path, code in problems.items() if (lost := _lost(path, code, table))]
    tables: dict[str, Any] = {
        name: _read_table(name, written)
        for name in Profile.model_fields
        if isinstance(written := table.get(name), dict) and not _is_gone(name, lacking)
    }
    for name, adapter in _LISTS.items():
        if name in table and (name,) not in lacking:
            tables[name] = adapter.validate_python(table[name])
    return without(Profile.model_construct(**tables), *lacking)


def without(profile: Profile, *paths: tuple[str, ...]) -> Profile:
    """A copy that lacks these tables (`("servo",)`) and values (`("servo", "reference")`)."""
    copy = profile.model_copy()
    for table, *keys in paths:
        if _is_gone(table, paths):
            copy.__dict__.pop(table, None)
        elif table in copy.__dict__:
            held = copy.__dict__[table].model_copy()
            held.__dict__.pop(keys[0], None)
            copy.__dict__[table] = held
    return copy


def _is_given(profile: Profile, table: str, key: str) -> bool:
    held = profile.__dict__.get(table)
    return held is not None and key in held.model_fields_set


def lacks_value(error: AttributeError) -> bool:
    """Whether the error comes from asking a partial profile for a value that it lacks."""
    return isinstance(error.obj, Table) and error.name in type(error.obj).model_fields


def _read_table(name: str, written: TomlTable) -> Table:
    annotation = Profile.model_fields[name].annotation
    models: list[type[Table]] = [one for one in (annotation, *get_args(annotation)) if isinstance(one, type)]
    if name == "target":
        models = [one for one in models if written["kind"] in get_args(one.model_fields["kind"].annotation)]
    model = models[0]
    values = {key: value for key, value in written.items() if key in keys_at(model, ())}
    return model.model_construct(_fields_set=set(values), **values)


def _is_gone(name: str, lacking: Collection[tuple[str, ...]]) -> bool:
    """Whether a table cannot be read: it is missing, no table, or a target of unknown kind."""
    return (name,) in lacking or (name == "target" and (name, "kind") in lacking)


def _lost(path: KeyPath, code: Code, table: TomlTable) -> tuple[str, ...] | None:
    """Return the table or value that a problem hides; None for an unknown key."""
    if path[0] in _LISTS:
        return (str(path[0]),)
    names = tuple(str(part) for part in path[:2])
    return _meant(names, table) if code == Code.UNKNOWN_KEY else names


def _meant(path: tuple[str, ...], table: TomlTable) -> tuple[str, ...] | None:
    """Return the absent key that an unknown one misspells."""
    *above, key = path
    below: object = table
    for part in above:
        below = below.get(part) if isinstance(below, dict) else None
    close = nearest(key, keys_at(Profile, tuple(above)))
    is_written = isinstance(below, dict) and close in below
    return (*above, close) if close and not is_written else None
