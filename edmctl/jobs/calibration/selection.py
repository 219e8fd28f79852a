"""Choose the calibration of a run, with warnings; state the uncertainty of a run without a sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from edmctl import failures
from edmctl.actuator.correction import GAIN_SD_BETWEEN_DAYS
from edmctl.dataclasses import dataclass
from edmctl.errors import Diagnostic, PreconditionError
from edmctl.procedures.job import CalibratedActuator
from edmctl.profile.folders import find_calibration
from edmctl.profile.model import Profile
from edmctl.profile.read import read_source
from edmctl.profile.setup import Setup

if TYPE_CHECKING:
    from edmctl.profile.calibration import Calibration

LOW_END_SHARE = 0.15
"""Share of the voltage range: a calibration that starts this far above the lowest voltage is still used there."""


class VoltageRange(Protocol):
    """Voltages that a model was identified over."""

    @property
    def low_v(self) -> float: ...
    @property
    def high_v(self) -> float: ...


def owner(calibration: Calibration) -> str:
    """Return the serial number of the calibrated machine, or words if it is unnamed."""
    return calibration.serial or "an unnamed machine"


def of_another(path: Path, calibration: Calibration, serial: str, this: str, hint: str) -> list[Diagnostic]:
    """Warn (W8101) of a calibration of another machine than `serial`, which `this` introduces."""
    if calibration.serial == serial:
        return []
    return [_doubt("W8101", f"{path} is of {owner(calibration)}; {this} {serial}.", hint)]


def not_accepted(what: str, problems: str, hint: str) -> Diagnostic:
    """Warn (W8102) of a calibration that was not accepted."""
    return _doubt("W8102", f"{what} was not accepted: {problems}", hint)


def restricted(what: str, restrictions: Sequence[str]) -> Diagnostic:
    """Warn (W8109) of a calibration that was accepted with restrictions."""
    return _doubt(
        "W8109",
        f"{what} was accepted {' Accepted '.join(restrictions)}",
        "Calibrate with swings of several rates and holds, as `edmctl calibrate` drives them.",
    )


def narrow(message: str, hint: str) -> Diagnostic:
    """Warn (W8104) of a calibration that does not hold all voltages to be used."""
    return _doubt("W8104", message, hint)


def reaches_down(model: VoltageRange, low_v: float, high_v: float) -> bool:
    """Whether a calibration begins low enough for voltages from `low_v` to `high_v`."""
    return model.low_v <= low_v + LOW_END_SHARE * (high_v - low_v)


def reaches_up(model: VoltageRange, high_v: float, tolerance_v: float = 0.0) -> bool:
    """Whether a calibration ends no more than `tolerance_v` below `high_v`."""
    return high_v <= model.high_v + tolerance_v


def _doubt(code: str, message: str, hint: str) -> Diagnostic:
    return Diagnostic(code, message, hint, is_warning=True)


SHORT_HASH = 12
LOAD_UM_PER_N = 5.0
"""Loss of displacement per newton at the tool: 0.2 N/µm stiffness of the amplified actuator."""


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


def refuse_unasked(setup: Setup, *, allow_model: bool) -> None:
    """Raise PreconditionError E8030 if no sensor is fitted and the request does not allow the model instead."""
    if setup.sensor.fitted or allow_model:
        return
    raise failures.no_sensor_fitted()


def _refuse_unconditioned(setup: Setup) -> None:
    if setup.sensor.fitted or setup.actuator.conditioning_cycles:
        return
    raise failures.conditioning_off_without_sensor()


def look_at_named(option: Path | None, environ: Mapping[str, str], setup: Setup, profile: Profile) -> None:
    """Load a named calibration, so that its errors are reported before anything is connected."""
    _refuse_unconditioned(setup)
    if named := find_calibration(option, environ, setup.actuator.calibration, None):
        from edmctl.profile.calibration import load_calibration

        _refuse_narrow(named, load_calibration(named), setup, profile)


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
    path = find_calibration(option, environ, setup.actuator.calibration, serial if lasting else None)
    if path is None:
        if not setup.sensor.fitted:
            raise _uncalibrated(serial, calibrate, lasting=lasting)
        swings = setup.actuator.conditioning_cycles
        model = "quick, from the conditioning swings" if swings else "none, without conditioning swings"
        return Choice(None, ModelUsed(alone=False, path=None, sha256=None, accepted=None, text=model))
    return _chosen(path, setup, profile, serial)


def _uncalibrated(serial: str, calibrate: str, *, lasting: bool) -> PreconditionError:
    if lasting:
        message = f"No displacement sensor is fitted, and there is no calibration of {serial}."
        hint = f"Run `{calibrate}` once with a borrowed sensor, or name a file with --calibration."
    else:
        message = f"No displacement sensor is fitted, and no calibration of {serial} is named."
        hint = f"Run `{calibrate}` with a sensor, and name its file with --calibration."
    return failures.no_calibration(problem=message, remedy=hint)


def _chosen(path: Path, setup: Setup, profile: Profile, serial: str) -> Choice:
    from edmctl.profile.calibration import load_calibration

    calibration = load_calibration(path)
    _refuse_narrow(path, calibration, setup, profile)
    held_out = calibration.quality.held_out
    return Choice(
        actuator=CalibratedActuator(calibration.model(), held_out.rms_um),
        used=_used(path, calibration, setup, serial),
        warnings=tuple(_doubts(path, calibration, setup, profile, serial)),
        text=read_source(path).text,
    )


def _used(path: Path, calibration: Calibration, setup: Setup, serial: str) -> ModelUsed:
    short, accepted = calibration.sha256[:SHORT_HASH], calibration.quality.accepted
    words = ["accepted" if accepted else "not accepted"]
    if accepted and calibration.quality.restrictions:
        words = ["accepted with restrictions"]
    if calibration.serial != serial:
        words.append(f"of {owner(calibration)}, not of {serial}")
    text = f"calibration {path} (sha256 {short}, {', '.join(words)})"
    return ModelUsed(not setup.sensor.fitted, str(path), short, accepted, text)


def _covers(calibration: Calibration, profile: Profile) -> bool:
    """Whether the calibration covers all voltages of the job, from 0 V to the profile's limit."""
    model, top_v = calibration.actuator, profile.limits.stroke_v_max
    return reaches_up(model, top_v) and reaches_down(model, 0.0, top_v)


def _range_in_words(path: Path, calibration: Calibration, profile: Profile) -> str:
    model, top_v = calibration.actuator, profile.limits.stroke_v_max
    return f"{path} covers {model.low_v:.1f} V to {model.high_v:.1f} V; limits.stroke_v_max is {top_v:.1f} V"


def _refuse_narrow(path: Path, calibration: Calibration, setup: Setup, profile: Profile) -> None:
    if setup.sensor.fitted or _covers(calibration, profile):
        return
    raise failures.calibration_range_too_small(path=_range_in_words(path, calibration, profile))


def _doubts(
    path: Path, calibration: Calibration, setup: Setup, profile: Profile, serial: str
) -> list[Diagnostic]:
    elsewhere = "Every actuator is another one: run `edmctl calibrate` here."
    doubts = of_another(path, calibration, serial, "this machine is", elsewhere)
    if not calibration.quality.accepted:
        problems = " ".join(calibration.quality.problems)
        doubts.append(not_accepted(str(path), problems, "Run `edmctl calibrate` again."))
    elif calibration.quality.restrictions:
        doubts.append(restricted(str(path), calibration.quality.restrictions))
    if not _covers(calibration, profile):
        message = f"{_range_in_words(path, calibration, profile)}. Beyond it the model guesses."
        doubts.append(narrow(message, "Calibrate from 0 V over the whole stroke."))
    if not setup.sensor.fitted:
        doubts.append(_cost(calibration))
    return doubts


def _cost(calibration: Calibration) -> Diagnostic:
    held_out = calibration.quality.held_out
    return failures.no_sensor(
        rms_um=held_out.rms_um,
        max_um=held_out.max_um,
        gain_sd_between_days=100 * GAIN_SD_BETWEEN_DAYS,
        load_um_per_n=LOAD_UM_PER_N,
    )
