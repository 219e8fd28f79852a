"""Why a model misses a record: noise, outliers, a shift, drift, too little in it, a knock, or the class of model.

Noise is what a sample has apart from its neighbours. Outliers, a shift and a drift are the cause where the record
without them is predicted so much better (`suspects`); a knock is short in what the fit of the whole record leaves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.checks import noise_sd
from edmctl.actuator.record import Record
from edmctl.actuator.validation import ErrorFigures
from edmctl.array_types import Array, Flags
from edmctl.dataclasses import dataclass

MAIN_SHARE = 0.5  # of the squares, that a cause has to explain
KNOCK_SHARE, MOST_KNOCKS = 0.005, 3  # how far around its worst sample a knock is looked for, over the record
END_SHARE = 0.01


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


def cause_of(
    parts: Sequence[Left],
    noise: Noise,
    errors: ErrorFigures,
    most_rms_um: float,
    most_um: float,
    judged_without: Callable[[], Sequence[tuple[str, ErrorFigures]]],
) -> str:
    """Say what most of the error comes from, with the remedy.

    errors : held out, which are too large
    most_rms_um, most_um : RMS and largest error that would be accepted
    judged_without : causes, in words, and what the held-out errors are without them; takes its time
    """
    if noise.sd_um**2 >= MAIN_SHARE * errors.rms_um**2:
        return (
            f"most of it is the sensor's noise, {noise.sd_um:.3g} µm (1 sd) in a sample. Average several samples to "
            "one, or look for what disturbs the sensor"
        )

    def excess(one: ErrorFigures) -> float:
        return max(one.rms_um / most_rms_um, one.max_um / most_um)

    left, words = min((excess(one), words) for words, one in judged_without())
    if left**2 <= (1.0 - MAIN_SHARE) * excess(errors) ** 2:
        return words
    squares = sum(float(part.errors_um @ part.errors_um) for part in parts)
    left_um = math.sqrt(squares / sum(len(part.errors_um) for part in parts))
    if left_um <= most_rms_um and max(float(np.abs(part.errors_um).max()) for part in parts) <= most_um:
        return (
            "a fit of all of it misses far less, so no part of the record tells what the others hold. Record "
            "longer: full swings, smaller ones at several voltages, and holds, each more than once"
        )
    knocks = _knocks(parts, most_rms_um, most_um)
    if knocks:
        places = " and ".join(knocks)
        return f"the worst is at {places}: look for a knock or a jump there, cut it off or measure again"
    return (
        "it is everywhere and follows the voltage. Look for a loose sensor, a wrong --previous-voltage, a load on "
        "the tool or a voltage that is not the one applied; without any of these the actuator is of a kind that "
        "this model does not hold"
    )


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
