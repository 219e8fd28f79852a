"""What may be right and is worth a second look in a measured record: its clock, its gaps, its spikes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from edmctl.actuator.waveshape import half_periods_s

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.actuator.record import Record

    Array = NDArray[np.float64]

LEAST_LOOP = 1e-4
"""RMS distance from a straight line over the range; a stage with its own position control leaves more."""
DOUBTFUL_STEP_S = 1.0
DOUBTFUL_SWING_S = 300.0
"""Slower swings are rather fast ones on a clock in ms."""
SHORT_S = 5.0
"""A shorter record says next to nothing about creep."""
GAP_STEPS = 20.0
"""A gap lasts this many sample periods."""
SPIKE_SHARE = 0.1
"""Height of a spike over the displacement's range."""
SD_PER_BEND = 0.605
"""Standard deviation of normal noise over the median of its second differences: 1.4826 / √6."""


def doubts_about(record: Record) -> tuple[str, ...]:
    """Sentences with their remedy, samples counted from 1."""
    return (*_doubts_of_time(record), *_spikes(record), *_proportional(record))


def _doubts_of_time(record: Record) -> list[str]:
    steps_s, length_s = np.diff(record.t_s), float(record.t_s[-1] - record.t_s[0])
    period_s = float(np.median(steps_s))
    doubts = []
    if period_s >= DOUBTFUL_STEP_S:
        doubts.append(
            f"{record.name}: its sample period is {period_s:g} s. If t_s is in ms, multiply it by 0.001; if it "
            "counts samples, by their period."
        )
    elif (swing_s := _swing_s(record)) >= DOUBTFUL_SWING_S:
        doubts.append(
            f"{record.name}: one swing takes {swing_s:.3g} s. If t_s is in ms, multiply it by 0.001."
        )
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
    """Warn of a displacement without loop and noise, which no sensor shows."""
    slope, zero_um = np.polynomial.polynomial.polyfit(record.u_v, record.y_um, 1)[::-1]
    left_um = float(np.std(record.y_um - slope * record.u_v - zero_um))
    if left_um > LEAST_LOOP * float(np.ptp(record.y_um)):
        return []
    return [
        f"{record.name}: y_um is u_V times a constant, without loop or noise. If it is a command or was computed "
        "from the voltage, give the column of the sensor."
    ]


def _swing_s(record: Record) -> float:
    """Usual time from one large turning point to the next; 0 where there are none."""
    swings_s = half_periods_s(record)
    return float(np.median(swings_s)) if len(swings_s) else 0.0


def _spikes(record: Record) -> list[str]:
    """Warn of single samples far from both their neighbours while the voltage hardly moved."""
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
