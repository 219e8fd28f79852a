"""Voltages over time: the record that a calibration is made from, and the waveforms that actuators are judged by.

Everything but the sine is a chain of straight lines, so that a machine can run it as ramps. No line is steeper
than the slew limit; a "step" is a ramp at that limit. Lines end on a sample: no turning point is lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass

SLEW_V_S = 1000.0  # slew limit of a "step" where none is given: 0–150 V in 0.15 s
FAST_SHARE, SERVO_SHARE = 0.067, 0.04
"""Largest swing of fast legs and of a servo at work, over the range: 10 V and 6 V of 150 V."""
SERVO_MOVES = 180
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True, slots=True)
class Leg:
    """A straight line from where the voltage is to `u_v`, lasting `duration_s`."""

    u_v: float
    duration_s: float


class Waveform(NamedTuple):
    """Samples at one rate; ndarrays of float64, shape (n,). Time starts at 0."""

    t_s: Array
    u_v: Array


def sampled(legs: Sequence[Leg], rate_hz: float, start_v: float = 0.0) -> Waveform:
    """Sample legs, beginning with `start_v` at 0 s.

    A leg that does not last a whole number of samples is lengthened to the next one.
    """
    parts = [np.array([start_v])]
    last_v = start_v
    for leg in legs:
        steps = max(1, math.ceil(leg.duration_s * rate_hz - 1e-6))
        parts.append(last_v + (leg.u_v - last_v) * np.arange(1, steps) / steps)
        parts.append(np.array([leg.u_v]))
        last_v = leg.u_v
    return _clocked(np.concatenate(parts), rate_hz)


class CalibrationLegs(NamedTuple):
    """What a calibration drives, one part after the other, each from 0 V and back; `fast` is sampled faster."""

    slow: tuple[Leg, ...]
    fast: tuple[Leg, ...]
    use: tuple[Leg, ...]


def calibration_legs(high_v: float, slew_v_s: float = SLEW_V_S) -> CalibrationLegs:
    """Legs of a calibration over 0…`high_v`."""
    return CalibrationLegs(
        slow_legs(high_v, slew_v_s), fast_legs(high_v, slew_v_s), use_legs(high_v, slew_v_s)
    )


def calibration_waveform(high_v: float, rate_hz: float, every: int) -> tuple[Waveform, NDArray[np.bool_]]:
    """Voltage of a calibration, and which samples are in its record: each `every`-th, all of the fast legs."""
    slow, fast, use = calibration_legs(high_v)
    waveform = sampled((*slow, *fast, *use), rate_hz)
    is_kept = np.arange(len(waveform.t_s)) % every == 0
    first, end = (len(sampled(legs, rate_hz).t_s) for legs in (slow, (*slow, *fast)))
    is_kept[first:end] = True
    return waveform, is_kept


def slow_legs(high_v: float, slew_v_s: float = SLEW_V_S) -> tuple[Leg, ...]:
    """Slow legs of a calibration over 0…`high_v`, starting at 0 V: 296 s when nothing is slowed down.

    Full triangles condition the actuator; descending ones and minor loops open the inside of the hysteresis
    (first-order reversal curves); holds of a minute show the creep, and 1 s to 50 s cycles tell creep from
    hysteresis, which a single frequency cannot.
    """
    chain = _Chain(slew_v_s)
    for _ in range(3):
        chain.triangle(high_v, 4.0)
    for share in range(15, 0, -2):
        chain.triangle(high_v * share / 15.0, 4.0)
    middle_v = 0.4 * high_v
    chain.ramp(middle_v, 1.0)
    for span_v in (high_v / 1.5, high_v / 2.5, high_v / 5.0):
        for _ in range(2):
            chain.ramp(middle_v + 0.5 * span_v, 0.625)
            chain.ramp(middle_v - 0.5 * span_v, 1.25)
            chain.ramp(middle_v, 0.625)
    chain.ramp(0.0, 1.0)
    chain.ramp(0.0, 10.0)
    for level_v, hold_s in ((0.8 * high_v, 60.0), (0.4 * high_v, 40.0), (0.0, 40.0)):
        chain.step(level_v, hold_s)
    for _ in range(15):
        chain.triangle(high_v, 1.0)
    for period_s in (10.0, 10.0, 50.0):
        chain.triangle(high_v, period_s)
    return tuple(chain.legs)


def fast_legs(high_v: float, slew_v_s: float = SLEW_V_S) -> tuple[Leg, ...]:
    """Swings of 50 Hz to 5 Hz about three voltages, from 0 V and back: some 6 s in which delay and lag part.

    Sampled at 1 kHz, a lag of some milliseconds rounds what a delay only shifts.
    """
    chain = _Chain(slew_v_s)
    for bias_share in (0.25, 0.5, 0.75):
        bias_v = bias_share * high_v
        chain.ramp(bias_v, 0.3)
        for frequency_hz in (50.0, 35.0, 25.0, 16.0, 10.0, 5.0):
            for swing in range(1, max(2, round(0.12 * frequency_hz)) + 1):
                swing_v = FAST_SHARE * high_v * (0.4 + 0.6 * (swing * GOLDEN % 1.0))
                chain.ramp(bias_v + swing_v, 0.5 / frequency_hz)
                chain.ramp(bias_v - swing_v, 0.5 / frequency_hz)
    chain.ramp(0.0, 0.3)
    return tuple(chain.legs)


def use_legs(high_v: float, slew_v_s: float = SLEW_V_S) -> tuple[Leg, ...]:
    """Of every use a part, from 0 V and back in some 90 s.

    Two full swings and a rest, as before every job; swings of 1 Hz between voltages that do not repeat; two steps
    with holds; a feed with the small moves of a gap servo, from which the tool jumps back now and then.
    """
    chain = _Chain(slew_v_s)
    for _ in range(2):
        chain.triangle(high_v, 4.0)
    chain.ramp(0.0, 4.0)
    for swing in range(1, 21):
        chain.ramp(high_v * (swing * GOLDEN % 1.0), 0.5)
    for level, hold_s in ((0.8, 12.0), (0.3, 8.0)):
        chain.step(level * high_v, hold_s)
    for move in range(1, SERVO_MOVES + 1):
        feed_v = high_v * (0.3 + 0.5 * move / SERVO_MOVES)
        chain.ramp(feed_v, 0.12)
        chain.ramp(feed_v - SERVO_SHARE * high_v * (0.2 + 0.8 * (move * GOLDEN % 1.0)), 0.08)
        if move % (SERVO_MOVES // 6) == 0:
            chain.step(feed_v * (0.2 + 0.6 * (3 * move * GOLDEN % 1.0)), 0.5)
            chain.step(feed_v, 0.2)
    chain.step(0.0, 4.0)
    return tuple(chain.legs)


def sine(low_v: float, high_v: float, frequency_hz: float, cycles: float, rate_hz: float) -> Waveform:
    """Raised cosine: whole swings low → high → low."""
    samples = round(cycles / frequency_hz * rate_hz) + 1
    phase = 2.0 * math.pi * frequency_hz * np.arange(samples) / rate_hz
    return _clocked(low_v + (high_v - low_v) * 0.5 * (1.0 - np.cos(phase)), rate_hz)


def triangle(low_v: float, high_v: float, frequency_hz: float, cycles: int, rate_hz: float) -> Waveform:
    """Straight swings low → high → low."""
    legs = [Leg(high_v, 0.5 / frequency_hz), Leg(low_v, 0.5 / frequency_hz)] * cycles
    return sampled(legs, rate_hz, low_v)


def square(
    low_v: float,
    high_v: float,
    frequency_hz: float,
    cycles: int,
    rate_hz: float,
    slew_v_s: float = SLEW_V_S,
) -> Waveform:
    """Steps low → high at 0 s and back after half a period (Muralidhara et al. 2009, Fig. 4)."""
    chain = _Chain(slew_v_s, low_v)
    hold_s = max(0.0, 0.5 / frequency_hz - abs(high_v - low_v) / slew_v_s)
    for _ in range(cycles):
        chain.step(high_v, hold_s)
        chain.step(low_v, hold_s)
    return sampled(chain.legs, rate_hz, low_v)


def jump_train(
    low_v: float,
    high_v: float,
    rate_hz: float,
    *,
    jumps: int = 8,
    interval_s: float = 10.0,
    away_s: float = 1.0,
    slew_v_s: float = SLEW_V_S,
) -> Waveform:
    """Slow linear feed from low to high; after every interval the electrode jumps to low and comes back.

    Muralidhara et al. 2009, Fig. 5. The tool stays away for `away_s`, and after the last return for as long.
    """
    chain = _Chain(slew_v_s, low_v)
    for jump in range(1, jumps + 1):
        feed_v = low_v + (high_v - low_v) * jump / jumps
        chain.ramp(feed_v, interval_s)
        chain.step(low_v, away_s)
        chain.step(feed_v, away_s if jump == jumps else 0.0)
    return sampled(chain.legs, rate_hz, low_v)


def servo_dither(
    low_v: float,
    high_v: float,
    rate_hz: float,
    *,
    duration_s: float = 200.0,
    swing_v: float = 3.0,
    slew_v_s: float = SLEW_V_S,
) -> Waveform:
    """A gap servo at work: a slow feed made of small uneven advances and retracts.

    The first twentieth brings the tool from low to a fifth of the range, the rest feeds to high. Retracts
    last 0.2 s and differ in length up to `swing_v`, spread evenly without repeating (golden ratio).
    """
    chain = _Chain(slew_v_s, low_v)
    start_v = low_v + 0.2 * (high_v - low_v)
    chain.ramp(start_v, duration_s / 20.0)
    moves = max(1, round(0.95 * duration_s))
    move_s = 0.95 * duration_s / moves
    for move in range(1, moves + 1):
        feed_v = start_v + (high_v - start_v) * move / moves
        chain.ramp(feed_v, 0.8 * move_s)
        chain.ramp(feed_v - swing_v * (move * GOLDEN % 1.0), 0.2 * move_s)
    return sampled(chain.legs, rate_hz, low_v)


class _Chain:
    """Legs one after the other, none steeper than the slew limit."""

    def __init__(self, slew_v_s: float, start_v: float = 0.0) -> None:
        self.legs: list[Leg] = []
        self._slew_v_s = slew_v_s
        self._last_v = start_v

    def ramp(self, u_v: float, duration_s: float) -> None:
        self.legs.append(Leg(u_v, max(duration_s, abs(u_v - self._last_v) / self._slew_v_s)))
        self._last_v = u_v

    def step(self, u_v: float, hold_s: float) -> None:
        self.ramp(u_v, 0.0)
        if hold_s > 0.0:
            self.ramp(u_v, hold_s)

    def triangle(self, peak_v: float, period_s: float) -> None:
        self.ramp(peak_v, 0.5 * period_s)
        self.ramp(0.0, 0.5 * period_s)


def _clocked(u_v: Array, rate_hz: float) -> Waveform:
    return Waveform(np.arange(len(u_v)) / rate_hz, u_v)
