"""Whether an identified model is accepted: reasons against it, restrictions, and notes.

A model is verified where the rest of its record has been. What lies beyond is extrapolation and is reported apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.fitting import OWN_TAU_SHARE, Design
from edmctl.actuator.record import (
    Record,
    half_periods_s,
    has_several_rates,
    known_from,
    length_s,
    longest_hold_s,
    noise_sd,
)
from edmctl.actuator.validation import ErrorFigures, HeldOut
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
    places = _worst_places(parts, lambda um: excess(ErrorFigures.over(um, errors.range_um)) <= 1.0)
    if places == []:
        return (
            "a fit of all of it misses far less, so no part of the record tells what the others hold. Record "
            "longer: full swings, smaller ones at several voltages, and holds, each more than once"
        )
    if places:
        knocks = " and ".join(places)
        return f"the worst is at {knocks}: look for a knock or a jump there, cut it off or measure again"
    return (
        "it is everywhere and follows the voltage. Look for a sensor that is loose or has moved, a wrong "
        "--previous-voltage, a load on the tool, a voltage that is not the one applied, or an actuator that rings "
        "after steps; without any of these the actuator is of a kind that this model does not hold"
    )


def _worst_places(parts: Sequence[Left], is_accepted: Callable[[Array], bool]) -> list[str] | None:
    """Return the few places without which the errors would be accepted; None if there are more."""
    left = [part.errors_um.copy() for part in parts]
    places: list[str] = []
    while not is_accepted(np.concatenate(left)):
        if len(places) == MOST_KNOCKS:
            return None
        worst = int(np.argmax([np.abs(errors_um).max(initial=0.0) for errors_um in left]))
        record, errors_um = parts[worst].record, left[worst]
        k = int(np.abs(errors_um).argmax())
        reach = max(5, round(KNOCK_SHARE * len(errors_um)))
        errors_um[max(0, k - reach) : k + reach + 1] = 0.0
        at, y_um = parts[worst].index[k], record.y_um
        margin_um = END_SHARE * float(np.ptp(y_um))
        at_end = not y_um.min() + margin_um < y_um[at] < y_um.max() - margin_um
        limit = ", where the sensor may stand at the end of its range" if at_end else ""
        places.append(f"{record.t_s[at]:.4g} s of {record.name}{limit}")
    return places


ACCEPTED_RMS_PCT, ACCEPTED_MAX_PCT = 0.5, 2.0
COVERED_BINS = 10
NOISE_MARGIN, NOISY_MAX_PCT = 1.2, 4.0
"""Where noise alone reaches the largest accepted error, so many times the noise is, up to a bound."""
NOISE_SHARE = 0.7  # of the largest error, from which on noise is worth a word
LEAST_BEYOND_SHARE = 0.001
JUDGED_SHARE = 0.8
"""Of the voltage range, that has to be judged: swings that grow evenly leave an eighth of it to the last of eight
folds, and what they leave continues what was judged."""
DIFFERING = (
    "the records differ from each other. Measure them under the same conditions: temperature, mounting, load and "
    "voltage held before (--previous-voltage)"
)
LEAST_HOLD_SHARE = 0.5  # of the slowest lag with a weight of its own


def problems_of(
    design: Design,
    records: Sequence[Record],
    held_out: HeldOut,
    whole: ErrorFigures | None,
    left: Sequence[Left],
    noise: Noise,
    judged_without: Callable[[], Sequence[tuple[str, ErrorFigures]]],
    *,
    on_floor: bool,
) -> tuple[str, ...]:
    """Return the reasons to refuse a model, each with its remedy.

    whole : errors of records that were held out whole; None if there are none
    left : residuals of the fit to all data, by record
    judged_without : suspected causes, in words, and held-out errors without each
    """
    problems: list[str] = []
    errors = held_out.errors
    if excess := excess_of(errors, noise):
        scale = errors.range_um / 100.0
        most_um = most_accepted_pct(noise, errors.range_um) * scale
        cause = cause_of(left, noise, errors, ACCEPTED_RMS_PCT * scale, most_um, judged_without)
        problems.append(f"Held-out {excess}; {cause}.")
    if whole is not None and (excess := excess_of(whole, noise)):
        problems.append(f"Records held out whole: {excess}; {DIFFERING}.")
    if on_floor:
        problems.append(
            "Not monotone: somewhere in the range the data show no immediate answer to the voltage; "
            "look for a sensor or an amplifier at its limit."
        )
    problems += _unjudged(design, held_out)
    problems += _uncovered(design, records)
    return tuple(problems)


def excess_of(errors: ErrorFigures, noise: Noise) -> str:
    """Return which errors are above the accepted ones, in words; empty if none is."""
    most_pct = most_accepted_pct(noise, errors.range_um)
    wrong = (
        (errors.rms_pct > ACCEPTED_RMS_PCT, f"RMS error {errors.rms_pct:.2f}", f"{ACCEPTED_RMS_PCT}"),
        (errors.max_pct > most_pct, f"error up to {errors.max_pct:.1f}", f"{most_pct:.3g}"),
    )
    words = (
        f"{error} % of the range, at most {most} % is accepted" for is_wrong, error, most in wrong if is_wrong
    )
    return ", ".join(words)


def most_accepted_pct(noise: Noise, range_um: float) -> float:
    """Largest held-out error that is accepted, %: what noise alone brings cannot be asked for, within bounds."""
    reachable_pct = NOISE_MARGIN * 100.0 * noise.largest_um / range_um
    return max(ACCEPTED_MAX_PCT, min(reachable_pct, NOISY_MAX_PCT))


def _unjudged(design: Design, held_out: HeldOut) -> list[str]:
    """Return a problem if the held-out errors cover too little of the voltage range."""
    if held_out.high_v - held_out.low_v >= JUDGED_SHARE * (design.high_v - design.low_v):
        return []
    beyond = held_out.beyond
    missed = "" if beyond is None else f", with errors up to {beyond.max_pct:.1f} % of the range"
    return [
        f"Judged from {held_out.low_v:.1f} V to {held_out.high_v:.1f} V only, of {design.low_v:.1f} V to "
        f"{design.high_v:.1f} V: swings beyond were recorded at one place, which nothing else tells of{missed}. "
        "Record the largest swings twice, early and late in the record or in another one."
    ]


def _uncovered(design: Design, records: Sequence[Record]) -> list[str]:
    """Return which voltages were not passed in both directions, or only in a state that is unknown."""
    found: list[str] = []
    bins = np.linspace(design.low_v, design.high_v, COVERED_BINS + 1)
    for direction, sign in (("rising", 1.0), ("falling", -1.0)):
        seen, known = np.zeros((2, COVERED_BINS), dtype=bool)
        for record in records:
            moves = np.flatnonzero(sign * np.diff(record.u_v) > 0.0)
            places = np.clip(np.digitize(record.u_v[1:][moves], bins) - 1, 0, COVERED_BINS - 1)
            seen[places] = True
            known[places[moves >= known_from(record)]] = True
        gap = int(np.argmin(seen if not seen.all() else known))
        between = f"{direction} voltage between {bins[gap]:.1f} V and {bins[gap + 1]:.1f} V"
        if not seen.all():
            found.append(f"Not covered: no {between}; record full cycles.")
        elif not known.all():
            found.append(
                f"Unknown start: every {between} depends on what the actuator was held at before the record. Give "
                "that voltage (--previous-voltage), or record two full swings."
            )
    return found


def notes_on(held_out: HeldOut, noise: Noise) -> tuple[str, ...]:
    """Return what else a reader should know."""
    notes: list[str] = []
    errors, beyond = held_out.errors, held_out.beyond
    if beyond is not None and held_out.beyond_share >= LEAST_BEYOND_SHARE:
        notes.append(
            f"{100.0 * held_out.beyond_share:.2g} % of the samples lie beyond what the other blocks reached, and "
            f"are judged apart: there the model extrapolates, with errors up to {beyond.max_pct:.1f} % of the range "
            f"({beyond.rms_pct:.2f} % RMS). Record the largest swings more than once."
        )
    if noise.largest_um >= NOISE_SHARE * errors.max_um:
        notes.append(
            f"Noise alone, {noise.sd_um:.3g} µm (1 sd) in a sample, comes to {noise.largest_um:.3g} µm at most: no "
            "largest error below it can be reached."
        )
    return tuple(notes)


def restrictions_on(records: Sequence[Record]) -> tuple[str, ...]:
    """Return what an acceptance is limited to by the fitted and validated records; each continues "accepted"."""
    restrictions: list[str] = []
    if not has_several_rates(records):
        restrictions.append(
            f"for this rate only: all records swing at one rate{rate_in_words(records)}, where delay, creep and "
            "hysteresis look alike. Record a second rate, or check one with --validate."
        )
    held_s = max(longest_hold_s(record) for record in records)
    if held_s < OWN_TAU_SHARE * LEAST_HOLD_SHARE * length_s(records):
        restrictions.append(
            f"for use without holds only: the voltage is never held longer than {held_s:.2g} s, and slower creep is "
            "continued from faster creep. Hold a step for a minute to measure it."
        )
    return tuple(restrictions)


def rate_in_words(records: Sequence[Record]) -> str:
    """Return the median rate of the large swings, such as " (20 Hz)"; empty if there is no full swing."""
    swings_s = np.concatenate([half_periods_s(record) for record in records])
    return f" ({0.5 / float(np.median(swings_s)):.2g} Hz)" if len(swings_s) else ""
