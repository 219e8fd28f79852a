"""Voltages over time: the record of a calibration, waveforms of trials, and figures of Muralidhara et al. 2009.

Everything but the sine is a chain of straight lines, so that a machine can run it as ramps. No line is steeper
than the slew limit; a "step" is a ramp at that limit. Lines end on a sample: no turning point is lost.

The paper gives lengths in words, some as a range, and not always where they were read; that is stated here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.record import runs_of
from edmctl.array_types import Array, Flags, Integers
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
    """Parts of a calibration in order, each from 0 V and back; `fast` is sampled faster."""

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


FIGURE_NAMES = {
    "fig3a": "Fig. 3a, sine 10 mHz",
    "fig3b": "Fig. 3b, sine 1 Hz",
    "fig4": "Fig. 4, square",
    "fig5": "Fig. 5, jumps",
    "loop": "loop",
}
"""Figures, and loops of voltage and displacement inside one another."""
HIGH_V = 120.0
SLOW_HZ, SLOW_CYCLES = 0.01, 2
FAST_HZ, FAST_CYCLES = 1.0, 5
SQUARE_HZ, SQUARE_CYCLES = 0.05, 2
"""The paper does not say how long its square wave is held; it looks at it for 6 s."""
LOOP_TOPS_V = (150.0, 100.0, 50.0)  # one slow cycle each, the first over the whole stroke
STROKE_UM = 445.0  # of the paper's actuator, at 150 V
NEAR_TROUGH_SHARE = 0.25  # of the swing, from its low end: the paper says only "near the trough"
SETTLED_S = 0.1  # after a step; creep is customarily counted from there
STEP_SHARE = 0.5  # of the slew limit: what is steeper is a step


@dataclass(frozen=True, slots=True)
class Reading:
    """One length of the paper beside ours.

    paper_low_um, paper_high_um : the paper's range, both the same where it gives one number; NaN where it gives none
    ours_um : the same of model and sensor here
    at_s : where ours was read
    """

    figure: str
    what: str
    paper: str
    paper_low_um: float
    paper_high_um: float
    ours_um: float
    at_s: float
    is_error: bool = True  # whether it is a difference of model and sensor, not a displacement of the model
    paper_side: float = 1.0  # sign of the model less the sensor that the paper's length is of


def figure_command(figure: str, rate_hz: float) -> Array:
    """Return the voltage of a figure at so many samples a second, shape (n,). KeyError for another name."""
    if figure == "fig3a":
        return sine(0.0, HIGH_V, SLOW_HZ, SLOW_CYCLES, rate_hz).u_v
    if figure == "fig3b":
        return sine(0.0, HIGH_V, FAST_HZ, FAST_CYCLES, rate_hz).u_v
    if figure == "fig4":
        return square(0.0, HIGH_V, SQUARE_HZ, SQUARE_CYCLES, rate_hz).u_v
    if figure == "fig5":
        return jump_train(0.0, HIGH_V, rate_hz).u_v
    cycles = [sine(0.0, top_v, SLOW_HZ, 1, rate_hz).u_v for top_v in LOOP_TOPS_V]
    return np.concatenate([cycles[0], *(cycle[1:] for cycle in cycles[1:])])


def readings(figure: str, u_v: Array, error_um: Array, model_um: Array, rate_hz: float) -> list[Reading]:
    """Return what the paper says of a figure, and ours.

    u_v, error_um, model_um : ndarray, shape (n,); the voltage by `figure_command`, model less sensor, and model.

    KeyError for another figure.
    """
    seen = _Seen(u_v, error_um, model_um, rate_hz)
    if figure == "fig3b":
        return [seen.largest("3b", "crests", (25.0, 25.0), seen.instants(2 * FAST_CYCLES)[1::2])]
    return {"fig3a": _slow_sine, "fig4": _square, "fig5": _jumps, "loop": _loop}[figure](seen)


def _stretches(inside: Flags) -> list[tuple[int, int]]:
    return [(begin - 1, end - 1) for begin, end in runs_of(inside).tolist()]


class _Seen(NamedTuple):
    """A record of one figure; ndarrays of shape (n,)."""

    u_v: Array
    error_um: Array
    model_um: Array
    rate_hz: float

    def largest(
        self,
        figure: str,
        what: str,
        paper_um: tuple[float, float] | None,
        at: Integers,
        said: str = "–",
        left_of: Reading | None = None,
    ) -> Reading:
        """Read the largest error at some samples; `said` stands where the paper has no number.

        left_of : what the paper's length is left of, on the same side; else it is taken to be on the side of ours
        """
        worst = int(at[np.abs(self.error_um[at]).argmax()])
        low_um, high_um = paper_um or (math.nan, math.nan)
        if paper_um is not None:
            said = f"{low_um:g}" if low_um == high_um else f"{low_um:g}–{high_um:g}"
        ours_um = float(self.error_um[worst])
        side = math.copysign(1.0, ours_um) if left_of is None else left_of.paper_side
        return Reading(
            figure, what, said, low_um, high_um, abs(ours_um), worst / self.rate_hz, paper_side=side
        )

    def instants(self, parts: int) -> Integers:
        """Return the samples at the ends of so many equal parts."""
        return np.rint(np.linspace(0.0, len(self.u_v) - 1.0, parts + 1)).astype(np.int64)

    def after(self, starts: Integers, begin_s: float, end_s: float) -> Integers:
        """Return the samples between two times after each start."""
        span = np.arange(round(begin_s * self.rate_hz), round(end_s * self.rate_hz))
        wanted: Integers = (starts[:, np.newaxis] + span).ravel()
        return wanted[wanted < len(self.u_v)]

    def steps(self, way: float) -> list[tuple[int, int]]:
        """Return the first and the last sample of each step up (`way` 1) or down (−1)."""
        return _stretches(way * self.slope_v_s > STEP_SHARE * SLEW_V_S)

    @property
    def slope_v_s(self) -> Array:
        """Slope that leads to each sample, shape (n,)."""
        return np.diff(self.u_v, prepend=self.u_v[0]) * self.rate_hz


def _slow_sine(seen: _Seen) -> list[Reading]:
    troughs = seen.instants(SLOW_CYCLES)
    away = np.flatnonzero(seen.u_v > seen.u_v.min() + NEAR_TROUGH_SHARE * np.ptp(seen.u_v))
    return [
        seen.largest("3a", "away from the troughs", (8.0, 10.0), away),
        seen.largest("3a", "first trough", (30.0, 35.0), troughs[:1]),
        seen.largest("3a", "later troughs", (30.0, 35.0), troughs[1:]),
    ]


def _square(seen: _Seen) -> list[Reading]:
    arrivals = np.array([end for _, end in seen.steps(1.0)])
    settled = arrivals + round(SETTLED_S * seen.rate_hz)
    first = seen.largest("4", "as the voltage arrives", (30.0, 30.0), seen.after(arrivals, 0.0, 1.0))
    soon = seen.largest("4", "0.1 s later", None, settled)
    later = seen.after(arrivals, 5.0, 6.0)
    return [first, soon, seen.largest("4", "5 to 6 s later", (10.0, 12.0), later, left_of=first)]


def _jumps(seen: _Seen) -> list[Reading]:
    slope_v_s = seen.slope_v_s
    rising = (slope_v_s > 0.0) & (slope_v_s < STEP_SHARE * SLEW_V_S)
    ramps = [np.arange(*ends) for ends in _stretches(rising)]
    stays = zip(seen.steps(-1.0), seen.steps(1.0), strict=True)
    settled = [np.arange(down[1] + round(SETTLED_S * seen.rate_hz), up[0]) for down, up in stays]
    return [
        seen.largest("5", "rising ramps, the first", (10.0, 10.0), ramps[0]),
        seen.largest("5", "rising ramps, later ones", (10.0, 10.0), np.concatenate(ramps[1:])),
        seen.largest("5", "retracted, from 0.1 s on", None, np.concatenate(settled), "small"),
    ]


def _loop(seen: _Seen) -> list[Reading]:
    crest, trough = (round(share * seen.rate_hz / SLOW_HZ) for share in (0.5, 1.0))
    stroke_um = float(seen.model_um[crest] - seen.model_um[trough])
    what = f"stroke at {seen.u_v[crest]:.0f} V"
    at_s = crest / seen.rate_hz
    return [Reading("loop", what, f"{STROKE_UM:g}", STROKE_UM, STROKE_UM, stroke_um, at_s, is_error=False)]
