"""The calibration and the drift file that a run uses, with warnings about them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.actuator.correction import GAIN_SD_BETWEEN_DAYS
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic
from edmctl.procedures.job import CalibratedActuator
from edmctl.profile.folders import find_kept
from edmctl.profile.model import Profile
from edmctl.profile.read import read_source
from edmctl.profile.setup import Setup
from edmctl.quantity import Value
from edmctl.wording import duration, plural

if TYPE_CHECKING:  # needs numpy and pydantic's models of files
    from edmctl.actuator.model import ActuatorModel
    from edmctl.process.rest_drift import DriftModel
    from edmctl.profile.calibration import Calibration, Parameters

LOW_END_SHARE = 0.15
"""Share of the voltage range: a calibration that starts this far above the lowest voltage is still used there."""
SHORT_HASH = 12
LOAD_UM_PER_N = 5.0
"""Loss of displacement per newton at the tool: 0.2 N/µm stiffness of the amplified actuator."""
_DAY_S = 86_400.0
FADED_S = 1800.0
"""Creep of a full stroke is negligible after this time."""
CLOCK_STEP_S = 3600.0
"""Tolerated correction of a clock: a file may be this much newer than now."""


@dataclass(frozen=True, slots=True)
class ModelUsed:
    """Source of a run's estimated displacements; path, hash and acceptance are None without a calibration.

    `alone` means that no sensor is fitted: every length of the result is estimated.
    """

    alone: bool
    path: str | None
    sha256: str | None
    accepted: bool | None
    text: str


@dataclass(frozen=True, slots=True)
class Choice:
    """The calibrated actuator of a run, warnings, and the text of the file for the run file."""

    actuator: CalibratedActuator | None
    used: ModelUsed
    warnings: tuple[Diagnostic, ...] = ()
    text: str = ""


def check_named_calibration(
    option: Path | None, environ: Mapping[str, str], setup: Setup, profile: Profile, *, allow_model: bool
) -> None:
    """Load a named calibration, so that its errors are reported before anything is connected.

    Raises PreconditionError: E8030 no sensor is fitted and the request does not allow the model instead, E8035 a
    setup without a sensor does not condition the actuator.
    """
    if not setup.sensor.fitted:
        if not allow_model:
            raise failures.no_sensor_fitted()
        if not setup.actuator.conditioning_cycles:
            raise failures.conditioning_off_without_sensor()
    if named := find_kept("calibration", environ, setup.actuator.calibration, None, option):
        _loaded(named, setup, profile)


def choose(
    option: Path | None,
    environ: Mapping[str, str],
    setup: Setup,
    profile: Profile,
    serial: str,
    calibrate: str = "edmctl calibrate",
    *,
    lasting: bool = True,
) -> Choice:
    """Find the calibration for the machine with that serial number. `calibrate` is the command that makes one.

    A machine that is not `lasting` (a virtual one of this command) has no calibration of its own, so that a seed
    always gives the same result.

    Raises RecordError if the file cannot be used, PreconditionError if a machine without a sensor has none (E8031)
    or one with too small a range (E8032).
    """
    path = find_kept("calibration", environ, setup.actuator.calibration, serial if lasting else None, option)
    if path is None:
        if not setup.sensor.fitted:
            raise failures.no_calibration(serial=serial, calibrate=calibrate)
        swings = setup.actuator.conditioning_cycles
        model = "quick, from the conditioning swings" if swings else "none, without conditioning swings"
        return Choice(None, ModelUsed(alone=False, path=None, sha256=None, accepted=None, text=model))
    calibration = _loaded(path, setup, profile)
    quality, sha256 = calibration.quality, calibration.sha256[:SHORT_HASH]
    verdict, warnings = "accepted", list[Diagnostic]()
    if calibration.serial != serial:
        warnings.append(failures.calibration_of_another(path=path, owner=owner(calibration), serial=serial))
    if not quality.accepted:
        verdict = "not accepted"
        warnings.append(failures.unaccepted_calibration(path=path, problems=" ".join(quality.problems)))
    elif quality.restrictions:
        verdict = "accepted with restrictions"
        restrictions = " Accepted ".join(quality.restrictions)
        warnings.append(failures.calibration_restricted(path=path, restrictions=restrictions))
    if not _covers(calibration, profile):
        model_v, top_v = calibration.actuator, profile.limits.stroke_v_max
        warnings.append(
            failures.calibration_too_narrow(
                path=path, low_v=model_v.low_v, high_v=model_v.high_v, top_v=top_v
            )
        )
    if not setup.sensor.fitted:
        warnings.append(
            failures.no_sensor(
                rms_um=quality.held_out.rms_um,
                max_um=quality.held_out.max_um,
                gain_sd_between_days=100 * GAIN_SD_BETWEEN_DAYS,
                load_um_per_n=LOAD_UM_PER_N,
            )
        )
    another = "" if calibration.serial == serial else f", of {owner(calibration)}, not of {serial}"
    text = f"calibration {path} (sha256 {sha256}, {verdict}{another})"
    return Choice(
        actuator=CalibratedActuator(calibration.model(), quality.held_out.rms_um),
        used=ModelUsed(not setup.sensor.fitted, str(path), sha256, quality.accepted, text),
        warnings=tuple(warnings),
        text=read_source(path).text,
    )


def owner(calibration: Calibration) -> str:
    """Return the serial number of the calibrated machine, or words if it is unnamed."""
    return calibration.serial or "an unnamed machine"


def reaches_down(model: ActuatorModel | Parameters, low_v: float, high_v: float) -> bool:
    """Whether a calibration begins low enough for voltages from `low_v` to `high_v`."""
    return model.low_v <= low_v + LOW_END_SHARE * (high_v - low_v)


def reaches_up(model: ActuatorModel | Parameters, high_v: float, tolerance_v: float = 0.0) -> bool:
    """Whether a calibration ends no more than `tolerance_v` below `high_v`."""
    return high_v <= model.high_v + tolerance_v


def _covers(calibration: Calibration, profile: Profile) -> bool:
    """Whether the calibration covers all voltages of the job, from 0 V to the profile's limit."""
    model, top_v = calibration.actuator, profile.limits.stroke_v_max
    return reaches_up(model, top_v) and reaches_down(model, 0.0, top_v)


def _loaded(path: Path, setup: Setup, profile: Profile) -> Calibration:
    """Load a calibration. Raises PreconditionError E8032 if there is no sensor and it covers too little."""
    from edmctl.profile.calibration import Calibration

    calibration = Calibration.load(path)
    if not (setup.sensor.fitted or _covers(calibration, profile)):
        model, top_v = calibration.actuator, profile.limits.stroke_v_max
        raise failures.calibration_range_too_small(
            path=path, low_v=model.low_v, high_v=model.high_v, top_v=top_v
        )
    return calibration


@dataclass(frozen=True, slots=True)
class DriftChoice:
    """The drift that a job corrects, None without a usable file; the file in words, its text, and warnings.

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
    """Find the result of `measure-drift` for the machine with that serial number.

    A machine that is not `lasting` (a virtual one of this command) has none of its own, so that a seed always
    gives the same result. A file that is too old or of another machine is ignored with a warning. Raises
    RecordError if the file cannot be used.
    """
    if not (setup.drift.use and setup.sensor.fitted):
        return DriftChoice()
    path = find_kept("drift", environ, setup.drift.file, serial if lasting else None)
    if path is None:
        return DriftChoice()
    from edmctl.profile.drift_file import DriftFile

    file, warning = DriftFile.load(path), None
    age_s, most_days = file.age_s(), setup.drift.max_age_days
    if file.made.serial != serial:
        warning = failures.drift_file_of_another(path=path, owner=file.made.serial, serial=serial)
    elif not age_s >= -CLOCK_STEP_S:
        warning = failures.drift_file_outdated(path=path, what="states no date, or one to come")
    elif age_s > most_days * _DAY_S:
        age = plural(int(age_s / _DAY_S), "day")
        what = f"is {age} old; drift.max_age_days is {most_days:g}"
        warning = failures.drift_file_outdated(path=path, what=what)
    if warning is not None:
        return DriftChoice(warnings=(warning,))
    text = f"drift file {path} (sha256 {file.sha256[:SHORT_HASH]})"
    model, measured = assumed_drift(file.model(), setup), file.measured
    touch = Value(measured.touch_um_per_s, measured.touch_u_um_per_s).widened(model.apart_u_um_per_s)
    return DriftChoice(model, text, read_source(path).text, touch_um_per_s=touch)


def assumed_drift(model: DriftModel, setup: Setup) -> DriftModel:
    """Return the model of a job: the drift between tool and workpiece may have changed since it was measured."""
    apart_u_um_per_s = math.hypot(model.apart_u_um_per_s, setup.drift.apart_u_um_per_s)
    return replace(model, apart_u_um_per_s=apart_u_um_per_s)


def unknown_use_warning(choice: DriftChoice, unknown_use_s: float) -> list[Diagnostic]:
    """Return a warning if creep of an unknown use of the actuator may affect the zero-voltage holds."""
    if choice.model is None or unknown_use_s >= FADED_S:
        return []
    return [failures.actuator_use_unknown(unknown_use_s=duration(unknown_use_s))]
