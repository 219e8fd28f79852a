"""A measured record: its samples, what the voltage covers, and checks with a remedy for each mistake.

Checks of recording, units and sign raise; doubtful values (clock, gaps, spikes) are warnings. The bounds are wide,
because a refused good record does more harm than an accepted bad one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmctl import failures
from edmctl.array_types import Array, Flags

HELD_SHARE = 0.02  # a voltage that stays within this share of the span is held
TURN_SHARE = 0.3  # a swing of less than this share of the span does not show the rate of a record
RATES_APART = 2.0
MOST = 1e30


class Record(NamedTuple):
    """Consecutive samples of one measurement.

    t_s, u_v, y_um : ndarray, shape (n,)
        Time (strictly ascending), voltage applied to the actuator, displacement of the tool.
    previous_v : float or None
        Voltage that the actuator was held at before the first sample. None: it had been cycling over the
        record's own range, and comes from the end that the first move leads away from.
    name : str
        What messages call it.
    """

    t_s: Array
    u_v: Array
    y_um: Array
    previous_v: float | None = None
    name: str = "record"


def check_numbers(record: Record) -> None:
    """Raise ValueError for a record that holds anything but numbers whose squares are numbers."""
    for values in record[:3]:
        if not np.isfinite(values).all():
            raise ValueError(f"{record.name}: holds numbers that are not finite")
        if len(values) and float(np.abs(values).max()) > MOST:
            raise ValueError(f"{record.name}: holds numbers beyond {MOST:g}")


def length_s(records: Sequence[Record]) -> float:
    """Duration of the longest record."""
    return max(float(record.t_s[-1] - record.t_s[0]) for record in records)


def sample_s(records: Sequence[Record]) -> float:
    """Time from sample to sample of the slowest sampled record."""
    return max(float(np.median(np.diff(record.t_s))) for record in records)


def longest_hold_s(record: Record) -> float:
    """Longest time that the voltage stays within 2 % of its span."""
    level = np.round((record.u_v - record.u_v.min()) / (HELD_SHARE * np.ptp(record.u_v)))
    edges = np.concatenate([[0], np.flatnonzero(np.diff(level)) + 1, [len(level) - 1]])
    return float(np.diff(record.t_s[edges]).max())


def half_periods_s(record: Record) -> Array:
    """Times from one large turning point to the next, shape (k,)."""
    u_v, least_v = record.u_v, TURN_SHARE * float(np.ptp(record.u_v))
    changes = np.concatenate([[0], np.flatnonzero(np.diff(u_v)) + 1])
    turns = np.flatnonzero(np.diff(np.sign(np.diff(u_v[changes]))) != 0) + 1
    kept: list[int] = []
    for k in changes[turns].tolist():
        if not kept or abs(u_v[k] - u_v[kept[-1]]) >= least_v:
            kept.append(k)
        elif len(kept) > 1 and (u_v[k] - u_v[kept[-1]]) * (u_v[kept[-1]] - u_v[kept[-2]]) > 0:
            kept[-1] = k
    return np.diff(record.t_s[kept])


def has_several_rates(records: Sequence[Record]) -> bool:
    """Whether the records swing at rates so different that delay and hysteresis can be told apart."""
    times_s = np.concatenate([half_periods_s(record) for record in records])
    if len(times_s) < 2:
        return False
    fast_s, slow_s = np.percentile(times_s, [10, 90])
    return bool(slow_s >= RATES_APART * fast_s)


def known_from(record: Record) -> int:
    """Return the first sample from which both ends of the voltage have been visited.

    Before it, the plays depend on an unrecorded history, unless the voltage before the record is given.
    """
    if record.previous_v is not None:
        return 0
    margin_v = HELD_SHARE * float(np.ptp(record.u_v))
    top = int(np.argmax(record.u_v >= record.u_v.max() - margin_v))
    bottom = int(np.argmax(record.u_v <= record.u_v.min() + margin_v))
    return max(top, bottom)


def settled_from(record: Record) -> int:
    """Return the sample of `known_from` if it is in the first fifth of the record, else 0."""
    known = known_from(record)
    return known if known <= len(record.u_v) // 5 else 0


def runs_of(flags: Flags) -> NDArray[np.int64]:
    """Return first and end of each run of true flags, shape (k, 2)."""
    return np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)


LEAST_SAMPLES = 200  # four for each of the model's 45 weights and delay
LEAST_CORRELATION = 0.5  # loop, creep and a phase lag of 40° together leave 0.7
LEAST_UM_PER_V, MOST_UM_PER_V = 0.01, 100.0
"""Stacks and amplified actuators have 0.05 to 5 µm/V, with a 10 V command before the amplifier up to 50 µm/V."""
LEAST_RANGE_UM, MOST_RANGE_UM = 0.5, 5000.0
"""A few hundred µm given in mm come to less; the longest amplified actuators move 2 mm."""
LONGEST_LAG_S = 0.02  # a delay that identification searches for
MOST_SPAN_V = 2500.0  # actuators of the highest voltage swing over 2000 V
LONGEST_STEP_S = 100.0
CLIPPED_SHARE = 0.03  # share of the voltage's span that passes while the displacement stands at its limit
LEADING_AREA = 0.02
"""Area of a loop that runs the wrong way round, of its box; hysteresis and delay make 0 to 0.2 the right way."""
LEAST_CLIPPED = 5  # samples that a displacement stands at its limit, one after the other
LEAST_LOOP = 1e-4
"""RMS distance from a straight line over the range; a stage with its own position control leaves more."""
LEAST_RESOLUTION, LEVEL_SHARE = 0.001, 0.1
"""Steps of a coarse sensor, over the range; and how many levels a record has then, over its samples."""
DOUBTFUL_STEP_S = 1.0
DOUBTFUL_SWING_S = 300.0  # slower swings are rather fast ones on a clock in ms
SHORT_S = 5.0  # a shorter record says next to nothing about creep
GAP_STEPS = 20.0  # a gap lasts this many sample periods
SPIKE_SHARE = 0.1  # height of a spike over the displacement's range
SD_PER_BEND = 0.605
"""Standard deviation of normal noise over the median of its second differences: 1.4826 / √6."""


def check_record(record: Record) -> tuple[str, ...]:
    """Return what is doubtful about a record, in sentences with their remedy.

    Samples are counted from 1. Raises RecordError for what cannot be used: E3611 too short, E3612 not finite, E3613
    time does not ascend, E3614 the voltage never changes, E3615 the displacement never changes or does not follow
    the voltage, E3616 the sensor is at its limit, E3617 reversed sign, E3618 units,
    E3626 the displacement leads the voltage.
    """
    _check_numbers(record)
    _check_time(record)
    _check_voltage(record)
    y_um = without_spikes(record.y_um)
    _check_displacement(record, y_um)
    _check_sign(record, y_um)
    _check_gain(record, y_um)
    _check_limits(record, y_um)
    _check_direction(record, y_um)
    return (*_doubts_of_time(record), *_spikes(record), *_proportional(record), *_resolution(record))


def _check_numbers(record: Record) -> None:
    count = len(record.t_s)
    if count < LEAST_SAMPLES:
        raise failures.record_too_short(record=record.name, count=count, least=LEAST_SAMPLES)
    for column, values in (("t_s", record.t_s), ("u_V", record.u_v), ("y_um", record.y_um)):
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            raise failures.record_not_finite(
                record=record.name, wrong=len(wrong), count=count, column=column, first=wrong[0] + 1
            )


def _check_time(record: Record) -> None:
    steps_s = np.diff(record.t_s)
    wrong = np.flatnonzero(steps_s <= 0.0)
    if len(wrong):
        k, t_s = int(wrong[0]), record.t_s
        stands = steps_s[k] == 0.0
        failure = failures.record_time_stands_still if stands else failures.record_time_goes_back
        raise failure(record=record.name, sample=k + 2, after_s=t_s[k + 1], before_s=t_s[k], steps=len(wrong))
    period_s = float(np.median(steps_s))
    if period_s > LONGEST_STEP_S:
        raise failures.record_period_too_long(record=record.name, period_s=period_s)


def _check_voltage(record: Record) -> None:
    span_v = float(np.ptp(record.u_v))
    if span_v <= 1e-9 * float(np.abs(record.u_v).max()):
        raise failures.record_voltage_constant(record=record.name, what=f"always {record.u_v[0]:g} V")
    if span_v > MOST_SPAN_V:
        raise failures.record_voltage_too_large(record=record.name, span_v=span_v)


def _check_displacement(record: Record, y_um: Array) -> None:
    if float(np.ptp(y_um)) <= 1e-9 * float(np.abs(y_um).max()):
        span_v = float(np.ptp(record.u_v))
        raise failures.record_displacement_constant(record=record.name, y_um=y_um[0], span_v=span_v)


def _check_sign(record: Record, y_um: Array) -> None:
    correlation = _correlation(record.u_v, y_um)
    if correlation < -LEAST_CORRELATION:
        raise failures.record_reversed(record=record.name, correlation=correlation)
    # Fast swings follow after a delay, which can be searched for.
    most = min(len(y_um) // 2, int(LONGEST_LAG_S / float(np.median(np.diff(record.t_s)))))
    lags = np.unique(np.linspace(1, most, 40).astype(int)) if most >= 1 else ()
    later = (_correlation(record.u_v[:-lag], y_um[lag:]) for lag in lags)
    if correlation >= LEAST_CORRELATION or any(one >= LEAST_CORRELATION for one in later):
        return
    if float(np.std(record.u_v)) < 1.5 * noise_sd(record.u_v):
        raise failures.record_voltage_constant(
            record=record.name, what=f"noise about {record.u_v.mean():.4g} V"
        )
    raise failures.record_displacement_unrelated(record=record.name, correlation=correlation)


def _correlation(u_v: Array, y_um: Array) -> float:
    u, y = _shape(u_v), _shape(y_um)
    both = float(u @ u) * float(y @ y)
    return float(u @ y) / math.sqrt(both) if both > 0.0 else 0.0


def _shape(values: Array) -> Array:
    shifted: Array = values - values.mean()
    largest = float(np.abs(shifted).max())
    return shifted / largest if largest > 0.0 else shifted


def _check_gain(record: Record, y_um: Array) -> None:
    slope = float(np.std(y_um) / np.std(record.u_v))
    range_um, span_v = float(np.ptp(y_um)), float(np.ptp(record.u_v))
    is_small = slope < LEAST_UM_PER_V or (range_um < LEAST_RANGE_UM and slope < 10.0 * LEAST_UM_PER_V)
    is_large = slope > MOST_UM_PER_V or range_um > MOST_RANGE_UM
    if not (is_small or is_large):
        return
    if is_large and range_um <= MOST_RANGE_UM and span_v <= 1.0:
        column, unit, factor = "u_V", "kV", "1000"
    elif is_large:
        column, unit, factor = "y_um", "nm", "0.001"
    elif 1000.0 * slope < LEAST_UM_PER_V:
        column, unit, factor = "y_um", "m", "1e6"
    else:
        column, unit, factor = "y_um", "mm", "1000"
    looks = {"column": column, "unit": unit, "factor": factor}
    raise failures.record_in_other_units(
        record=record.name, range_um=range_um, span_v=span_v, slope=slope, **looks
    )


def _check_limits(record: Record, y_um: Array) -> None:
    range_um = float(np.ptp(y_um))
    noise_um = 6.0 * noise_sd(y_um)
    for sign, end in ((1.0, "upper"), (-1.0, "lower")):
        y, u = sign * y_um, sign * record.u_v
        for tolerance_um in (1e-9 * range_um, 0.002 * range_um + noise_um):
            share, first = _longest_push(u, y >= y.max() - tolerance_um)
            if share <= max(CLIPPED_SHARE, 10.0 * tolerance_um / range_um):
                continue
            limit_um = sign * float(y.max())
            raise failures.record_clipped(
                record=record.name, end=end, limit_um=limit_um, first=first + 1, percent=100.0 * share
            )


def _longest_push(u_v: Array, at_end: Flags) -> tuple[float, int]:
    """Largest rise of the voltage within a run of flagged samples, over its span, and where that run begins.

    Only runs that last until the voltage has come back count: where the displacement turns before the voltage,
    time is off, and nothing is clipped.
    """
    largest, where = 0.0, 0
    for start, end in runs_of(at_end).tolist():
        if end - start < LEAST_CLIPPED:
            continue
        top_v = float(u_v[start:end].max())
        rise_v = top_v - float(u_v[start])
        if rise_v > largest and (end == len(u_v) or u_v[end] < top_v - 0.5 * rise_v):
            largest, where = rise_v, start
    return largest / float(np.ptp(u_v)), where


def _check_direction(record: Record, y_um: Array) -> None:
    area = _loop_area(record.u_v, y_um)
    if area < -LEADING_AREA:
        raise failures.record_ahead_of_voltage(record=record.name, percent=-100.0 * area)


def _loop_area(u_v: Array, y_um: Array) -> float:
    """Mean area of the loops between the first and the last rise through mid-voltage, of the box around them."""
    u = (u_v - u_v.min()) / float(np.ptp(u_v))
    y = (y_um - y_um.min()) / float(np.ptp(y_um))
    rises = np.flatnonzero((u[:-1] < 0.5) & (u[1:] >= 0.5))
    if len(rises) < 2:
        return 0.0
    inside = slice(int(rises[0]), int(rises[-1]) + 1)
    u, y = u[inside], y[inside]
    swings = 0.5 * float(np.abs(np.diff(u)).sum())
    return 0.5 * float(u[:-1] @ y[1:] - u[1:] @ y[:-1]) / max(swings, 1.0)


def _doubts_of_time(record: Record) -> list[str]:
    steps_s, length_s = np.diff(record.t_s), float(record.t_s[-1] - record.t_s[0])
    period_s, swings_s = float(np.median(steps_s)), half_periods_s(record)
    doubts = []
    if period_s >= DOUBTFUL_STEP_S:
        doubts.append(
            f"{record.name}: its sample period is {period_s:g} s. If t_s is in ms, multiply it by 0.001; if it "
            "counts samples, by their period."
        )
    elif len(swings_s) and float(np.median(swings_s)) >= DOUBTFUL_SWING_S:
        swing = f"one swing takes {float(np.median(swings_s)):.3g} s"
        doubts.append(f"{record.name}: {swing}. If t_s is in ms, multiply it by 0.001.")
    elif length_s < SHORT_S:
        doubts.append(
            f"{record.name}: it lasts {length_s:.2g} s, which says next to nothing about creep; "
            "a voltage held for a minute does."
        )
    gaps = np.flatnonzero(steps_s > GAP_STEPS * period_s)
    if len(gaps):
        widest = int(gaps[steps_s[gaps].argmax()])
        doubts.append(
            f"{record.name}: time has gaps, {len(gaps)} in all, the longest of {steps_s[widest]:.3g} s after sample "
            f"{widest + 1}. The voltage is taken as straight across; if it was not, give the parts as files of "
            "their own."
        )
    return doubts


def _proportional(record: Record) -> list[str]:
    slope, zero_um = np.polynomial.polynomial.polyfit(record.u_v, record.y_um, 1)[::-1]
    left_um = float(np.std(record.y_um - slope * record.u_v - zero_um))
    if left_um > LEAST_LOOP * float(np.ptp(record.y_um)):
        return []
    return [
        f"{record.name}: y_um is u_V times a constant, without loop or noise. If it is a command or was computed "
        "from the voltage, give the column of the sensor."
    ]


def _resolution(record: Record) -> list[str]:
    """Warn of a displacement in coarse steps, which the noise estimate misses."""
    levels_um = np.unique(without_spikes(record.y_um))
    if not 2 < len(levels_um) <= LEVEL_SHARE * len(record.y_um):
        return []
    gaps_um = np.diff(levels_um)
    step_um = float(np.median(gaps_um))
    parts = gaps_um / step_um
    is_grid = bool(np.all(np.abs(parts - np.round(parts)) < 0.01) and parts.min() > 0.5)
    if not is_grid or step_um < max(LEAST_RESOLUTION * np.ptp(levels_um), 3.0 * noise_sd(record.y_um)):
        return []
    return [
        f"{record.name}: the displacement goes in steps of {step_um:.3g} µm, which are no noise and are told as "
        "error. Use a finer range of the sensor, or average several samples to one where they go to and fro between "
        "steps."
    ]


def _spikes(record: Record) -> list[str]:
    y_um, u_v = record.y_um, record.u_v
    least_um = max(SPIKE_SHARE * float(np.ptp(without_spikes(y_um))), 10.0 * noise_sd(y_um))
    before_um, after_um = y_um[1:-1] - y_um[:-2], y_um[1:-1] - y_um[2:]
    is_far = (before_um * after_um > 0.0) & (np.minimum(np.abs(before_um), np.abs(after_um)) > least_um)
    moved_v = np.abs(np.diff(u_v))
    is_quiet = np.maximum(moved_v[:-1], moved_v[1:]) < 0.5 * SPIKE_SHARE * float(np.ptp(u_v))
    spikes = np.flatnonzero(is_far & is_quiet) + 1
    if not len(spikes):
        return []
    return [
        f"{record.name}: {len(spikes)} displacements stand out from their neighbours by {least_um:.3g} µm or more, "
        f"the first at sample {spikes[0] + 1}. Look for a loose cable, and leave these samples out."
    ]


def noise_sd(values: Array) -> float:
    """Noise of one sample, from second differences; what moves adds to it."""
    bends = np.diff(values, 2)
    return SD_PER_BEND * float(np.median(np.abs(bends - np.median(bends))))


def without_spikes(y_um: Array) -> Array:
    """Median of each sample and its neighbours: single samples that stand out are gone, steps are not."""
    before, here, after = y_um[:-2], y_um[1:-1], y_um[2:]
    middle = np.maximum(np.minimum(before, here), np.minimum(np.maximum(before, here), after))
    return np.concatenate((middle[:1], middle, middle[-1:]))
