"""Why a model misses a record: noise, a knock, a shift that stays, drift, too little in it, or the class of model.

All by what the fit of the whole record leaves, in its own order. Noise is what a sample has apart from its
neighbours; a knock is short; a shift and a drift follow time and nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.checks import noise_sd

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]

MAIN_SHARE = 0.5
"""Of the sum of squares, that a cause has to explain."""
KNOCK_SHARE, MOST_KNOCKS = 0.005, 3
"""How far around its worst sample a knock is looked for, over the record."""
END_SHARE = 0.01
POLYNOMIAL = 2
"""Of time, which drift follows."""
SHARPER = 0.5
"""Of what a drift leaves, a shift leaves at most this; both explain much of the other."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of one sample: one sd, and the largest that so many samples have by it, µm."""

    sd_um: float
    largest_um: float

    @classmethod
    def of(cls, residuals_um: Sequence[Array]) -> Noise:
        """Noise of what a fit leaves of records, shape (n,) each; the noisiest one counts."""
        sd_um = max(noise_sd(left_um) for left_um in residuals_um)
        samples = sum(len(left_um) for left_um in residuals_um)
        return cls(sd_um, sd_um * math.sqrt(2.0 * math.log(max(2, samples))))


@dataclass(frozen=True, slots=True)
class Left:
    """What a fit leaves of one record, of the samples that count, shape (n,)."""

    record: Record
    index: NDArray[np.int64]
    errors_um: Array

    @classmethod
    def of(cls, record: Record, used: Flags, residual_um: Array) -> Left:
        """Residuals, shape (n,), of samples that are used, less their mean."""
        index = np.flatnonzero(used)
        errors_um = residual_um[index]
        return cls(record, index, errors_um - errors_um.mean())


def cause_of(parts: Sequence[Left], noise: Noise, rms_um: float, most_rms_um: float, most_um: float) -> str:
    """Say what most of the error comes from, with the remedy.

    rms_um : the held-out error that is too large
    most_rms_um, most_um : RMS and largest error that would be accepted
    """
    if noise.sd_um**2 >= MAIN_SHARE * rms_um**2:
        return (
            f"most of it is the sensor's noise, {noise.sd_um:.3g} µm (1 sd) in a sample. Average several samples to "
            "one, or look for what disturbs the sensor"
        )
    left_um = math.sqrt(_squares(parts) / sum(len(part.errors_um) for part in parts))
    if left_um <= most_rms_um and max(float(np.abs(part.errors_um).max()) for part in parts) <= most_um:
        return (
            "a fit of all of it misses far less, so no part of the record tells what the others hold. Record "
            "longer: full swings, smaller ones at several voltages, and holds, each more than once"
        )
    knocks = _knocks(parts, most_rms_um, most_um)
    if knocks:
        places = " and ".join(knocks)
        return f"the worst is at {places}: look for a knock or a jump there, cut it off or measure again"
    for part in parts:
        found = _over_time(part, most_rms_um)
        if found:
            return found
    return (
        "it is everywhere and follows the voltage. Look for a loose sensor, a wrong --previous-voltage, a load on "
        "the tool or a voltage that is not the one applied; without any of these the actuator is of a kind that "
        "this model does not hold"
    )


def _squares(parts: Sequence[Left]) -> float:
    return sum(float(part.errors_um @ part.errors_um) for part in parts)


def _knocks(parts: Sequence[Left], most_rms_um: float, most_um: float) -> list[str]:
    """Places without which the errors would be accepted; none where more than a few would have to go."""
    left = [part.errors_um.copy() for part in parts]
    places = []
    for _ in range(MOST_KNOCKS):
        worst = int(np.argmax([np.abs(errors_um).max(initial=0.0) for errors_um in left]))
        part, errors_um = parts[worst], left[worst]
        k = int(np.abs(errors_um).argmax())
        reach = max(5, round(KNOCK_SHARE * len(errors_um)))
        places.append(_place(part, k))
        errors_um[max(0, k - reach) : k + reach + 1] = 0.0
        joined = np.concatenate(left)
        if math.sqrt(float(joined @ joined) / len(joined)) <= most_rms_um and np.abs(joined).max() <= most_um:
            return places
    return []


def _place(part: Left, k: int) -> str:
    """Time and record, and whether the sensor is at an end."""
    y_um = part.record.y_um
    at_um = float(y_um[part.index[k]])
    margin_um = END_SHARE * float(np.ptp(y_um))
    at_end = not y_um.min() + margin_um < at_um < y_um.max() - margin_um
    limit = ", where the sensor may stand at the end of its range" if at_end else ""
    return f"{part.record.t_s[part.index[k]]:.4g} s of {part.record.name}{limit}"


def _over_time(part: Left, most_rms_um: float) -> str:
    """A shift that stays or a drift, where it is most of what is left of a record; else nothing."""
    errors_um, times_s = part.errors_um, part.record.t_s[part.index]
    total = float(errors_um @ errors_um)
    if total <= most_rms_um**2 * len(errors_um):
        return ""
    along = np.linspace(-1.0, 1.0, len(errors_um))
    trend_um = np.polynomial.polynomial.polyval(
        along, np.polynomial.polynomial.polyfit(along, errors_um, POLYNOMIAL)
    )
    drift = 1.0 - float(np.sum((errors_um - trend_um) ** 2)) / total
    sums = np.cumsum(errors_um)[:-1]
    before = np.arange(1.0, len(errors_um))
    gains = sums**2 * len(errors_um) / (before * (len(errors_um) - before))
    k = int(gains.argmax())
    shift = float(gains[k]) / total
    if shift >= MAIN_SHARE and 1.0 - shift <= SHARPER * (1.0 - drift):
        shift_um = float(errors_um[: k + 1].mean() - errors_um[k + 1 :].mean())
        return (
            f"the displacement shifts by {shift_um:+.3g} µm at {times_s[k + 1]:.4g} s of {part.record.name} and "
            "stays there: look for a sensor or a mount that moved, and give the parts as files of their own"
        )
    if drift >= MAIN_SHARE:
        return (
            f"it follows time, by {np.ptp(trend_um):.3g} µm over {part.record.name}: the sensor or the machine "
            "drifts. Let them warm up, and measure again"
        )
    return ""
