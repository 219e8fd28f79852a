"""Reading a profile: file, the files it extends, overrides, checks."""

from __future__ import annotations

import hashlib
import json
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pydantic import BaseModel, ValidationError

from edmctl.errors import Diagnostic, ProfileError
from edmctl.profile.codes import Code
from edmctl.profile.diagnose import rule_diagnostics, schema_diagnostics, schema_problems
from edmctl.profile.findings import Job
from edmctl.profile.model import Profile
from edmctl.profile.overrides import apply_overrides
from edmctl.profile.partial_profile import draft
from edmctl.profile.places import places
from edmctl.profile.read import parse, read_chain, read_source
from edmctl.profile.rules import in_share_only, violations, with_expected_gap, with_time_limit
from edmctl.profile.setup import Setup
from edmctl.profile.shipped import find_profile
from edmctl.profile.sim import ProfileFile, SimSettings
from edmctl.profile.sources import SET_OPTION, Sources
from edmctl.profile.target_rules import time_limit

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.profile.findings import Finding
    from edmctl.profile.places import Place
    from edmctl.profile.sources import TomlTable

_M = TypeVar("_M", bound=BaseModel)


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


def load_profile(
    name_or_path: str, overrides: Sequence[str] = (), setup: Setup | None = None
) -> LoadedProfile:
    """Load and check a profile by path or shipped name.

    `overrides` are `key=value` texts; `setup` is the machine it is checked for, by default the stock one.
    Raises ProfileError with every diagnostic, UsageError when there is no such profile.
    """
    machine = setup if setup is not None else Setup()
    path = find_profile(name_or_path)
    chain = read_chain(path)
    overridden = apply_overrides(chain.table, overrides)
    sources = Sources((*reversed(overridden.sources), *chain.sources), chain.sources[0])
    written = _validated(ProfileFile, overridden.table, sources, machine)
    recipe = with_expected_gap(_recipe(written))
    found, unread = _places(recipe, path, sources)
    warnings = _refuse_errors(violations(recipe, machine, found), sources, unread)
    profile = with_time_limit(in_share_only(recipe), machine, found)
    warnings += _refuse_errors(list(time_limit(Job(profile, machine, found))), sources)
    return LoadedProfile(
        profile=profile,
        sim=written.sim,
        path=path,
        text=chain.sources[0].text,
        sha256=_sha256(profile, found),
        sim_sha256=_sha256(written.sim),
        overrides=(*chain.changes, *overridden.changes),
        warnings=warnings,
        places=found,
    )


def load_setup(path: Path | None = None) -> Setup:
    """Load the machine's settings; without a path, those of the stock machine.

    Raises ProfileError with every diagnostic.
    """
    if path is None:
        return Setup()
    source = read_source(path)
    sources = Sources((source,), source)
    setup = _validated(Setup, parse(source), sources)
    actuator = setup.actuator
    if actuator.slew_v_s < actuator.conditioning_slew_v_s:
        message = (
            f"the conditioning ramp, {actuator.conditioning_slew_v_s:g} V/s, is faster than the actuator's "
            f"fastest, {actuator.slew_v_s:g} V/s"
        )
        hint = f"set actuator.conditioning_slew_v_s to at most {actuator.slew_v_s:g} V/s"
        where = sources.value(("actuator", "slew_v_s"))
        raise ProfileError((Diagnostic(Code.OUT_OF_RANGE, message, hint, where),))
    return setup if actuator.calibration is None else _with_calibration_beside(path, setup)


def _with_calibration_beside(path: Path, setup: Setup) -> Setup:
    """Resolve the calibration file that a setup names against the setup's folder."""
    calibration = str(path.parent / (setup.actuator.calibration or ""))
    return setup.model_copy(
        update={"actuator": setup.actuator.model_copy(update={"calibration": calibration})}
    )


def _validated(model: type[_M], table: TomlTable, sources: Sources, machine: Setup | None = None) -> _M:
    """The model of a table. A profile, checked for `machine`, is told the violated rules with the wrong values."""
    try:
        return model.model_validate(table)
    except ValidationError as error:
        problems = schema_problems(error, model, table)
    wrong = schema_diagnostics(problems, model, table, sources)
    if machine is not None:
        wrong += rule_diagnostics(violations(draft(table, problems), machine), sources)
    raise ProfileError(tuple(wrong))


def _places(
    profile: Profile, path: Path, sources: Sources
) -> tuple[tuple[Place, ...], tuple[Diagnostic, ...]]:
    """The places of a profile, or why they cannot be told; files are relative to the text that names them."""
    where = sources.value(("sites",))
    folder = Path() if where.file == SET_OPTION else Path(where.file).parent
    try:
        return places(profile, folder), ()
    except ProfileError as error:
        return (), tuple(replace(d, where=d.where or where) for d in error.diagnostics)


def _refuse_errors(
    findings: list[Finding], sources: Sources, others: tuple[Diagnostic, ...] = ()
) -> tuple[Diagnostic, ...]:
    """Diagnostics of findings that only warn; raises ProfileError with all of them and others if one refuses."""
    diagnostics = (*rule_diagnostics(findings, sources), *others)
    if all(d.is_warning for d in diagnostics):
        return diagnostics
    raise ProfileError(diagnostics)


def _recipe(written: ProfileFile) -> Profile:
    return Profile.model_construct(
        _fields_set=written.model_fields_set - {"sim"},
        **{name: getattr(written, name) for name in Profile.model_fields},
    )


def _sha256(model: BaseModel, found: tuple[Place, ...] = ()) -> str:
    """Hash of a table, and of the places that it does not hold itself."""
    values = model.model_dump(by_alias=True)
    if found:
        values["places"] = [astuple(replace(place, where=None))[:-1] for place in found]
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()
