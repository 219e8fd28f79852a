"""Which drift file a run goes by, and what is doubtful about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic
from edmctl.profile.folders import find_drift
from edmctl.quantity import Value
from edmctl.wording import duration, plural

if TYPE_CHECKING:
    from edmctl.process.rest_drift import DriftModel
    from edmctl.profile.setup import Setup

_DAY_S = 86_400.0
FADED_S = 1800.0
"""Creep of a full stroke is gone by then, as far as it counts."""
CLOCK_STEP_S = 3600.0
"""A file may be so much younger than now: clocks are put right."""


@dataclass(frozen=True, slots=True)
class DriftChoice:
    """The drift that jobs correct by, None without a file that counts; the file in words, its text, and doubts.

    `touch_um_per_s` is the drift of touches when it was measured.
    """

    model: DriftModel | None = None
    text: str = ""
    toml: str = ""
    warnings: tuple[Diagnostic, ...] = ()
    touch_um_per_s: Value | None = None


def choose_drift(
    environ: Mapping[str, str], setup: Setup, serial: str, *, lasting: bool = True
) -> DriftChoice:
    """Find what `measure-drift` has told of the machine with that serial number.

    A machine that is not `lasting`, a virtual one of this command alone, has none of its own: the same seed gives
    the same result, whatever was measured meanwhile. A file that is too old or of another machine does not count,
    and is warned of. Raises RecordError where one that was found cannot be used.
    """
    if not (setup.drift.use and setup.sensor.fitted):
        return DriftChoice()
    path = find_drift(environ, setup.drift.file, serial if lasting else None)
    if path is None:
        return DriftChoice()
    from edmctl.profile.drift_file import load_drift
    from edmctl.profile.read import read_source

    found = load_drift(path)
    if found.made.serial != serial:
        return _ignored("W8106", f"{path} is of {found.made.serial}; this machine is {serial}.")
    age_s = found.age_s()
    if not age_s >= -CLOCK_STEP_S:
        return _ignored("W8107", f"{path} does not say when it was made, or says a time to come.")
    if age_s > setup.drift.max_age_days * _DAY_S:
        age = plural(int(age_s / _DAY_S), "day")
        return _ignored("W8107", f"{path} is {age} old; drift.max_age_days is {setup.drift.max_age_days:g}.")
    words = f"drift file {path} (sha256 {found.sha256[:12]})"
    model, measured = believed(found.model(), setup), found.measured
    touch = Value(measured.touch_um_per_s, measured.touch_u_um_per_s).widened(model.apart_u_um_per_s)
    return DriftChoice(model, words, read_source(path).text, touch_um_per_s=touch)


def believed(model: DriftModel, setup: Setup) -> DriftModel:
    """Return what a job goes by: with a drift between tool and work that was another one when it was measured."""
    apart_u_um_per_s = math.hypot(model.apart_u_um_per_s, setup.drift.apart_u_um_per_s)
    return replace(model, apart_u_um_per_s=apart_u_um_per_s)


def doubts_of_use(choice: DriftChoice, unknown_use_s: float) -> list[Diagnostic]:
    """Return a warning where creep of a use that nobody has followed may be in the rests."""
    if choice.model is None or unknown_use_s >= FADED_S:
        return []
    message = (
        f"How the actuator was used until {duration(unknown_use_s)} ago is unknown: a command was killed, stopped, "
        "or followed no creep. Where the rests tell less of the drift than the setup does, nothing is corrected."
    )
    hint = "Half an hour of rest mends it; the next run knows what this one leaves."
    return [Diagnostic("W8108", message, hint, is_warning=True)]


def _ignored(code: str, message: str) -> DriftChoice:
    hint = "Drift is not corrected in this run. Run `edmctl measure-drift` here."
    return DriftChoice(warnings=(Diagnostic(code, message, hint, is_warning=True),))
