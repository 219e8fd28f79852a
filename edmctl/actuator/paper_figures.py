"""The waveforms of Muralidhara et al. 2009, Figs 3 to 5, and what the paper reads off them, read off our records.

The paper gives lengths in words, some of them as a range, and not always where exactly they were read. Where it
leaves that open, the place is stated here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.waveforms import SLEW_V_S, jump_train, sine, square
from edmctl.array_types import Array, Integers
from edmctl.dataclasses import dataclass

NAMES = {
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


def command(figure: str, rate_hz: float) -> Array:
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

    u_v, error_um, model_um : ndarray, shape (n,); the voltage by `command`, model less sensor, and model.

    KeyError for another figure.
    """
    read = {"fig3a": _slow_sine, "fig3b": _fast_sine, "fig4": _square, "fig5": _jumps, "loop": _loop}
    return read[figure](_Seen(u_v, error_um, model_um, rate_hz))


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


def _fast_sine(seen: _Seen) -> list[Reading]:
    return [seen.largest("3b", "crests", (25.0, 25.0), seen.instants(2 * FAST_CYCLES)[1::2])]


def _square(seen: _Seen) -> list[Reading]:
    arrivals = np.array([end for _, end in seen.steps(1.0)])
    settled = arrivals + round(SETTLED_S * seen.rate_hz)
    first = seen.largest("4", "as the voltage arrives", (30.0, 30.0), seen.after(arrivals, 0.0, 1.0))
    later = seen.after(arrivals, 5.0, 6.0)
    return [
        first,
        seen.largest("4", "0.1 s later", None, settled),
        seen.largest("4", "5 to 6 s later", (10.0, 12.0), later, left_of=first),
    ]


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


def _stretches(inside: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(inside.astype(np.int8), prepend=0, append=0))
    return [(int(begin) - 1, int(end) - 1) for begin, end in edges.reshape(-1, 2)]
