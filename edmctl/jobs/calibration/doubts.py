"""What is doubtful about a calibration that is used: another machine's, not accepted, of too few voltages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.errors import Diagnostic

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.profile.calibration_tables import Calibration

LOW_END_SHARE = 0.15
"""Of the voltages to be used: a calibration that begins so far above the lowest still serves there."""


class VoltageRange(Protocol):
    """Voltages that a model was identified over."""

    @property
    def low_v(self) -> float: ...
    @property
    def high_v(self) -> float: ...


def owner(calibration: Calibration) -> str:
    """Return the serial number of the machine that it was made on, or words where it names none."""
    return calibration.serial or "an unnamed machine"


def of_another(path: Path, calibration: Calibration, serial: str, this: str, hint: str) -> list[Diagnostic]:
    """Warn (W8101) of a calibration of another machine than `serial`, which `this` introduces."""
    if calibration.serial == serial:
        return []
    return [_doubt("W8101", f"{path} is of {owner(calibration)}; {this} {serial}.", hint)]


def not_accepted(what: str, problems: str, hint: str) -> Diagnostic:
    """Warn (W8102) of a calibration that was not accepted."""
    return _doubt("W8102", f"{what} was not accepted: {problems}", hint)


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
