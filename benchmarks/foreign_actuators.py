"""Print how a calibration does on actuators of kinds that edmctl does not hold.

    python -m benchmarks.foreign_actuators [--kind bouc-wen preisach prandtl] [--count 8] [--first-seed 1]
        [--variants all] [--jobs 2] [--zero mean] [--mixed servo steps]

Three kinds, each drawn from a seed: Bouc-Wen (an equation of rate, without the memory of turning points), Preisach
with a smooth density, and generalised Prandtl-Ishlinskii with other envelopes up than down. All have a bent and
saturating reversible part, creep, and an amplifier with delay and lag; none shares code with `edmctl`.

The voltage of the calibration is the one that `edmctl calibrate` drives on the virtual machine, millisecond by
millisecond, with the samples that the host gets of it; what is fitted is what the command fits. Then five mixed
waveforms and one of 5 to 50 Hz are held out, with fresh noise and drift of the sensor: before each the actuator
swings twice over its stroke and rests, and from there on the model gets the voltage alone. Errors are against the
noise-free displacement, in % of the stroke, with the zero set by least squares over the waveform (`--zero start`:
once, through the sensor, from the last two seconds of the rest). What a calibration states of the model, without the
sensor's noise, is compared with that; what it states through the sensor with what `validate` finds of the same
waveforms through it, with its noise and drift.

    python -m benchmarks.foreign_actuators --verdicts [--count 8] [--first-seed 1]

Eight cases of each kind, 24 plants with `--count 8`: records of one rate, verified with a file of another rate; no
holds; a drifting or differing sensor; a resonance. Each is fitted twice, to the record of one rate alone and with
one of a second rate, as `edmctl calibrate --from ... --validate ...` does it. No fit may be accepted above the
limits, and the better of two fits must not be refused while the worse is accepted.

Exit code 1 where a bar is missed, 2 where none of twenty builds of a draw is an actuator (hysteretic, creeping,
monotone, of 445 µm).
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import statistics
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from random import Random
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from edmctl.actuator.record import Record

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from edmctl.actuator.model import ActuatorModel

Array = NDArray[np.float64]
compiled = numba.njit(nogil=True, error_model="numpy")

KINDS = ("bouc-wen", "preisach", "prandtl")
BOUC_WEN, PREISACH, PRANDTL = range(3)
STROKE_V, STROKE_UM = 150.0, 445.0
KNEE_V = 90.0
"""The reversible part saturates from here on."""
TICK_S = 0.001
SUBSTEPS = 5
STEP_S = TICK_S / SUBSTEPS
DAC_V, SENSOR_UM = 0.0025, 0.001
"""Least steps of command and reading on the wire."""
SLEW_V_S = 1000.0

MOST_MAX_PCT, MOST_MEDIAN_PCT, MOST_FAST_PCT = 2.0, 1.0, 1.5
RMS_RATIO, MAX_RATIO = 1.3, 1.6
SHARE = 20 / 24
ACCEPT_RMS_PCT, ACCEPT_MAX_PCT, REFUSE_RMS_PCT, REFUSE_MAX_PCT = 0.5, 2.0, 1.0, 4.0


# --- the physics, compiled ---------------------------------------------------------------------------------------


@compiled
def reversible(w: float, bow: float, saturation: float) -> float:
    """The part without memory, V: a quadratic bow, and less and less above the knee."""
    y = w + bow * w * (w - STROKE_V) / STROKE_V
    over = w - KNEE_V
    if over > 0.0:
        y -= saturation * STROKE_V * (over / (STROKE_V - KNEE_V)) ** 2
    return y


@compiled
def bouc_wen(w: float, before: float, h: float, shape: Array) -> float:
    """The hysteretic voltage after a move from `before` to `w`, by midpoint steps of 0.1 V.

    dh/du = A (1 - |h/h_s|^n (1 + b/2 sgn(du)) (γ + β sgn(h du))), γ + β = 1 where β is not doubled: Bouc-Wen in the
    form of Low and Guo (1995), with a limit that differs between the branches.
    """
    limit, slope, power, beta, gamma, branch = shape[0], shape[1], shape[2], shape[3], shape[4], shape[5]
    move = w - before
    if move == 0.0:
        return h
    steps = 1 + int(abs(move) / 0.1)
    du = move / steps
    sign = 1.0 if move > 0.0 else -1.0
    scale = 1.0 + 0.5 * branch * sign
    for _ in range(steps):
        along = beta if h * sign > 0.0 else -beta
        middle = h + 0.5 * du * slope * (1.0 - abs(h / limit) ** power * scale * (gamma + along))
        along = beta if middle * sign > 0.0 else -beta
        h += du * slope * (1.0 - abs(middle / limit) ** power * scale * (gamma + along))
    return h


@compiled
def cubic(at: float, weights: Array) -> None:
    """Weights of four equally spaced values at -1, 0, 1, 2 for what is between the middle two."""
    weights[0] = -at * (at - 1.0) * (at - 2.0) / 6.0
    weights[1] = (at + 1.0) * (at - 1.0) * (at - 2.0) / 2.0
    weights[2] = -(at + 1.0) * at * (at - 2.0) / 2.0
    weights[3] = (at + 1.0) * at * (at - 1.0) / 6.0


@compiled
def everett(high: float, low: float, both: Array, up: Array, down: Array, work: Array) -> float:
    """Relays that switch between two turning points, ∬ density over low < β < α < high, from its tables.

    up(α) - both(α, β) + down(β), by cubic interpolation: smooth between the nodes of GRID_V.
    """
    x, y = high - FIRST_V, low - FIRST_V
    i, j = int(x), int(y)
    wx, wy = work[0], work[1]
    cubic(x - i, wx)
    cubic(y - j, wy)
    total = 0.0
    for k in range(4):
        row = 0.0
        for m in range(4):
            row += both[i - 1 + k, j - 1 + m] * wy[m]
        total += wx[k] * (up[i - 1 + k] - row) + wy[k] * down[j - 1 + k]
    return total


@compiled
def preisach(w: float, stack: Array, flow: Array, both: Array, up: Array, down: Array, work: Array) -> float:
    """Relays that are on: turning points that still count lie in `stack` (voltage, value), oldest first.

    flow : how many, the direction (1 up, -1 down), the voltage and value before.
    """
    depth, direction = int(flow[0]), flow[1]
    if (w - flow[2]) * direction < 0.0:
        if depth == len(stack):
            raise ValueError("more turning points than there is room for")
        stack[depth, 0], stack[depth, 1] = flow[2], flow[3]
        depth += 1
        direction = -direction
    while depth > 2 and (w - stack[depth - 2, 0]) * direction >= 0.0:
        depth -= 2
    last, value = stack[depth - 1, 0], stack[depth - 1, 1]
    if direction > 0.0:
        value += everett(w, last, both, up, down, work)
    else:
        value -= everett(last, w, both, up, down, work)
    flow[0], flow[1], flow[2], flow[3] = depth, direction, w, value
    return float(value)


@compiled
def prandtl(w: float, before: float, shape: Array, thresholds: Array, weights: Array, plays: Array) -> float:
    """Sum of generalised plays: one tanh envelope drags them up, another one down (Al Janaideh et al. 2009)."""
    x = 2.0 * w / STROKE_V - 1.0
    total = 0.0
    if w >= before:
        edge = math.tanh(shape[0] * x + shape[1]) / shape[0]
        for i in range(len(plays)):
            plays[i] = max(plays[i], edge - thresholds[i])
            total += weights[i] * plays[i]
    else:
        edge = math.tanh(shape[2] * x + shape[3]) / shape[2] + shape[4]
        for i in range(len(plays)):
            plays[i] = min(plays[i], edge + thresholds[i])
            total += weights[i] * plays[i]
    return total


@compiled
def run_actuator(
    kind: int,
    held_v: Array,
    chain: Array,
    shape: Array,
    thresholds: Array,
    weights: Array,
    both: Array,
    up: Array,
    down: Array,
    shifts: Array,
    creeps: Array,
    now: Array,
    plays: Array,
    stack: Array,
    flow: Array,
    y_v: Array,
) -> None:
    """Displacement in V of the reversible part at the end of every millisecond; the state is left where it ends.

    held_v : command, held for a millisecond each
    chain : delay in substeps, share of the way that the amplifier goes in one, hysteretic share, bow, saturation
    shifts, creeps : rows (share of the way in a substep, weight, state) of what creeps before and after hysteresis
    now : command before, amplifier's voltage, effective voltage, hysteretic part
    """
    delay, follow, share, bow, saturation = chain[0], chain[1], chain[2], chain[3], chain[4]
    work = np.empty((2, 4))
    shifted = 1.0 + shifts[1].sum()
    held, amplifier, w, h = now[0], now[1], now[2], now[3]
    for k in range(len(held_v)):
        y = 0.0
        for step in range(SUBSTEPS):
            late = min(max(step + 1.0 - delay, 0.0), 1.0)
            amplifier += follow * (held + late * (held_v[k] - held) - amplifier)
            before = w
            w = amplifier
            for j in range(shifts.shape[1]):
                shifts[2, j] += shifts[0, j] * (amplifier - shifts[2, j])
                w += shifts[1, j] * shifts[2, j]
            w /= shifted
            if kind == BOUC_WEN:
                h = bouc_wen(w, before, h, shape)
                y = reversible(w, bow, saturation) - h
            else:
                if kind == PREISACH:
                    h = preisach(w, stack, flow, both, up, down, work)
                else:
                    h = prandtl(w, before, shape, thresholds, weights, plays)
                y = (1.0 - share) * reversible(w, bow, saturation) + share * h
            slow = 0.0
            for j in range(creeps.shape[1]):
                creeps[2, j] += creeps[0, j] * (y - creeps[2, j])
                slow += creeps[1, j] * creeps[2, j]
            y += slow
        held = held_v[k]
        y_v[k] = y
    now[0], now[1], now[2], now[3] = held, amplifier, w, h


# --- actuators ---------------------------------------------------------------------------------------------------

FIRST_V, LAST_V, FINE = -12.0, 164.0, 4
"""Preisach's triangle has nodes every volt, 15 000 cells in all, its density FINE² points a cell."""
PLAYS = 40
TURNS = 4096
LONGEST_TAU_S = 5e4


@dataclass(frozen=True)
class Draw:
    """What a seed, and then a variant, settles of an actuator; everything else follows from it.

    loop : opening of a full cycle of 20 s at the middle of the stroke, over the stroke
    sharpness : power n of Bouc-Wen; other kinds have their own spread
    bow, saturation : of the reversible part, shares of the stroke
    branch : how much the bend of the branches differs, over its mean: term of Bouc-Wen, steepness of envelopes
    creep : per decade of time
    """

    kind: str
    seed: int
    loop: float
    sharpness: float
    branch: float
    bow: float
    saturation: float
    creep: float
    creep_from_s: float
    delay_s: float
    lag_s: float
    noise_um: float
    drift_um_per_s: float
    beta: float = 1.0


def drawn(kind: str, seed: int) -> Draw:
    """Draw the figures of one actuator of the base set."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    return Draw(
        kind=kind,
        seed=seed,
        loop=rng.uniform(0.08, 0.18),
        sharpness=rng.uniform(1.0, 2.0),
        branch=rng.uniform(0.0, 0.6) if kind == "bouc-wen" else rng.uniform(0.0, 0.3),
        bow=rng.uniform(0.02, 0.10),
        saturation=rng.uniform(0.004, 0.02),
        creep=math.exp(rng.uniform(math.log(0.01), math.log(0.05))),
        creep_from_s=math.exp(rng.uniform(math.log(0.004), math.log(0.05))),
        delay_s=rng.uniform(1e-4, 1e-3),
        lag_s=rng.uniform(1e-4, 5e-4),
        noise_um=rng.uniform(0.12, 0.15),
        drift_um_per_s=rng.uniform(-1.0, 1.0) / 600.0,
    )


@dataclass
class State:
    """Where an actuator is."""

    shifts: Array
    creeps: Array
    now: Array
    plays: Array
    stack: Array
    flow: Array

    def copy(self) -> State:
        """Return an independent copy."""
        return State(*(values.copy() for values in vars(self).values()))


class Foreign:
    """One actuator: cycled over its stroke, ten minutes at rest at 0 V, and there again with every `drive`.

    build : which of those that a draw leaves open; `built` takes the first that is an actuator
    """

    def __init__(self, draw: Draw, build: int = 0) -> None:
        self.draw = draw
        rng = np.random.default_rng([draw.seed, KINDS.index(draw.kind), 1, *([build] if build else [])])
        self._kind = KINDS.index(draw.kind)
        self._thresholds, self._weights = np.zeros(0), np.zeros(0)
        self._tables = (np.zeros((0, 0)), np.zeros(0), np.zeros(0))
        follow = 1.0 - math.exp(-STEP_S / draw.lag_s)
        self._chain = np.array([draw.delay_s / STEP_S, follow, 0.0, draw.bow, draw.saturation])
        self._shape = np.zeros(6)
        (self._bouc_wen, self._preisach, self._prandtl)[self._kind](rng)
        self._shifts, self._creeps = self._creep(rng)
        self._um_per_v, self._zero_v = 1.0, 0.0
        self._set_loop()
        if draw.beta != 1.0:
            self._shape[3] *= draw.beta
        self._set_stroke(rng)

    def _bouc_wen(self, rng: np.random.Generator) -> None:
        beta = rng.uniform(0.5, 0.75)
        slope = rng.uniform(0.25, 0.38)
        self._shape[:] = (1.0, slope, self.draw.sharpness, beta, 1.0 - beta, self.draw.branch)

    def _preisach(self, rng: np.random.Generator) -> None:
        """Relays spread over half width (α-β)/2 and middle (α+β)/2 by bumps that lie off any grid."""
        volts = np.linspace(FIRST_V, LAST_V, int(FINE * (LAST_V - FIRST_V)) + 1)
        half = 0.5 * (volts[:, np.newaxis] - volts)
        middle = 0.5 * (volts[:, np.newaxis] + volts)
        width_v, wide_v = rng.uniform(9.0, 16.0), rng.uniform(70.0, 110.0)
        # A broad ground as soft PZT has it, many narrow relays, and bumps on it.
        density = np.exp(-0.5 * (half / width_v) ** 2 - 0.5 * ((middle - 75.0) / wide_v) ** 2)
        for _ in range(int(rng.integers(3, 6))):
            at_half, at_middle = rng.uniform(2.0, 24.0), rng.uniform(15.0, 135.0)
            sd_half, sd_middle = rng.uniform(5.0, 10.0), rng.uniform(12.0, 35.0)
            bump = np.exp(
                -0.5 * ((half - at_half) / sd_half) ** 2 - 0.5 * ((middle - at_middle) / sd_middle) ** 2
            )
            density += rng.uniform(0.2, 0.8) * bump
        density += rng.uniform(0.0, 0.02)
        step = volts[1] - volts[0]
        inner = _summed(density, step)  # over α, for each β
        both = _summed(inner.T, step).T
        diagonal = _summed(np.ascontiguousarray(np.diag(inner)), step)
        nodes = slice(None, None, FINE)
        up = np.diag(both) - diagonal
        self._tables = tuple(
            np.ascontiguousarray(table) for table in (both[nodes, nodes], up[nodes], diagonal[nodes])
        )  # type: ignore[assignment]
        work = np.empty((2, 4))
        full = everett(STROKE_V, 0.0, *self._tables, work)
        self._tables = tuple(table * STROKE_V / full for table in self._tables)  # type: ignore[assignment]

    def _prandtl(self, rng: np.random.Generator) -> None:
        steep, branch = rng.uniform(0.6, 1.1), self.draw.branch
        rise, fall = steep * (1.0 + 0.5 * branch), steep * (1.0 - 0.5 * branch)
        self._shape[:5] = (rise, rng.uniform(-0.2, 0.2), fall, rng.uniform(-0.2, 0.2), 0.0)
        x = np.linspace(-1.0, 1.0, 401)
        gap = np.tanh(fall * x + self._shape[3]) / fall - np.tanh(rise * x + self._shape[1]) / rise
        self._shape[4] = -gap.mean()
        most = max(0.0, float((gap.mean() - gap).max()))
        spread = rng.uniform(0.12, 0.3)
        thresholds = np.sort(0.8 * ((np.arange(PLAYS) + rng.uniform(0.0, 1.0, PLAYS)) / PLAYS) ** 1.4)
        # Envelopes that cross would let a play jump: no threshold is below half of that.
        self._thresholds = 0.5 * most + 0.002 + thresholds
        self._weights = np.exp(-thresholds / spread) * np.exp(0.3 * rng.standard_normal(PLAYS))
        self._weights *= 0.5 * STROKE_V / self._weights.sum()

    def _creep(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Banks before and after the hysteresis, rows of share of the way, weight and state.

        Like the logarithm of time, two lags an octave, after the hysteresis; with Preisach a few lags at random
        times with random weights instead, and a part of them shifts what the relays see.
        """
        draw = self.draw
        if draw.kind == "preisach":
            ratios = rng.uniform(2.5, 6.0, 40)
            taus_s = draw.creep_from_s * np.cumprod(ratios)
            taus_s, ratios = taus_s[taus_s < LONGEST_TAU_S], ratios[taus_s < LONGEST_TAU_S]
            shares = draw.creep * np.log10(ratios) * np.exp(0.3 * rng.standard_normal(len(taus_s)))
            before = rng.uniform(0.3, 0.7)
        else:
            count = int(2.0 * math.log2(LONGEST_TAU_S / draw.creep_from_s))
            taus_s = draw.creep_from_s * 2.0 ** (0.5 * np.arange(count))
            shares = np.full(count, draw.creep * math.log10(2.0) / 2.0)
            before = 0.0
        follow = 1.0 - np.exp(-STEP_S / taus_s)
        bank = np.stack([follow, shares, np.zeros(len(taus_s))])
        shifts = bank.copy() if before else bank[:, :0].copy()
        shifts[1] *= before
        bank[1] *= 1.0 - before
        return shifts, bank

    def _set_loop(self) -> None:
        """Set the size of what is hysteretic by the opening that was drawn.

        Bouc-Wen opens widest near a limit of 40 times its slope, V; where that is too little, the slope grows.
        """
        swing = _path([(0.0, 0.0), *[(10.0 * k, STROKE_V * (k % 2)) for k in range(1, 7)]])

        def opening(size: float) -> float:
            self._size(size)
            return _opening(swing[-20_000:], self._run(swing, self._fresh())[-20_000:])

        low, high = 0.02, 0.95
        if self._kind == BOUC_WEN:
            while opening(35.0 * self._shape[1]) < self.draw.loop:
                self._shape[1] *= 1.05
            low, high = 1.0, 35.0 * float(self._shape[1])
        for _ in range(12):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if opening(middle) < self.draw.loop else (low, middle)

    def _size(self, value: float) -> None:
        if self._kind == BOUC_WEN:
            self._shape[0] = value
        else:
            self._chain[2] = value

    def _set_stroke(self, rng: np.random.Generator) -> None:
        """Scale to the stroke in a slow cycle, and remember the actuator at rest."""
        state = self._fresh()
        self._run(
            _path([(0.0, 0.0), *[(2.0 * k, STROKE_V * (k % 2)) for k in range(1, 9)], (616.0, 0.0)]), state
        )
        self._rest = state
        y = self._run(_path([(0.0, 0.0), (50.0, STROKE_V), (100.0, 0.0)]), state.copy())
        self.stroke_um = STROKE_UM * (1.0 + 0.01 * rng.standard_normal())
        self._um_per_v = self.stroke_um / float(np.ptp(y))
        self._zero_v = float(y[0])

    def _fresh(self) -> State:
        """Never driven, at 0 V."""
        plays = np.full(PLAYS, -0.8)
        stack = np.zeros((TURNS, 2))
        stack[0] = (FIRST_V + 2.0, 0.0)
        flow = np.array([1.0, 1.0, FIRST_V + 2.0, 0.0])
        return State(self._shifts.copy(), self._creeps.copy(), np.zeros(4), plays, stack, flow)

    def _run(self, held_v: Array, state: State) -> Array:
        y_v = np.empty(len(held_v))
        run_actuator(
            self._kind,
            held_v,
            self._chain,
            self._shape,
            self._thresholds,
            self._weights,
            *self._tables,
            state.shifts,
            state.creeps,
            state.now,
            state.plays,
            state.stack,
            state.flow,
            y_v,
        )
        return y_v

    def drive(self, held_v: Array) -> Array:
        """True displacement at the end of every millisecond, µm, from rest; 0 µm is where it rests."""
        return self._um_per_v * (self._run(held_v, self._rest.copy()) - self._zero_v)

    def sensed(self, truth_um: Array, rng: np.random.Generator) -> Array:
        """What the displacement sensor reads of consecutive milliseconds: noise, and a drift that wanders slowly."""
        t_s = TICK_S * np.arange(len(truth_um))
        period_s, phase = rng.uniform(200.0, 900.0), rng.uniform(0.0, 2.0 * math.pi)
        drift_um_per_s = self.draw.drift_um_per_s * rng.uniform(0.5, 1.0)
        sway_um = 0.2 * (np.sin(2.0 * math.pi * t_s / period_s + phase) - math.sin(phase))
        noise_um = self.draw.noise_um * rng.standard_normal(len(t_s))
        read: Array = np.round((truth_um + drift_um_per_s * t_s + sway_um + noise_um) / SENSOR_UM) * SENSOR_UM
        return read


def _summed(values: Array, step: float) -> Array:
    """Integral from the first row on, by trapezoids, shape as before."""
    total = np.zeros_like(values)
    np.cumsum(0.5 * step * (values[1:] + values[:-1]), axis=0, out=total[1:])
    return total


def _path(knots: Sequence[tuple[float, float]]) -> Array:
    """Command every millisecond along straight lines between (s, V), on the converter's grid."""
    times_s, volts = np.array(knots).T
    ticks = TICK_S * np.arange(1, round(times_s[-1] / TICK_S) + 1)
    return _on_grid(np.interp(ticks, times_s, volts))


def _on_grid(u_v: Array) -> Array:
    return np.round(np.clip(u_v, 0.0, STROKE_V) / DAC_V) * DAC_V


def _opening(u_v: Array, y: Array) -> float:
    """Distance of the branches at mid-voltage, over the range, of one cycle that begins at its low end."""
    top = int(u_v.argmax())
    rising = float(np.interp(0.5 * STROKE_V, u_v[: top + 1], y[: top + 1]))
    falling = float(np.interp(0.5 * STROKE_V, u_v[: top - 1 : -1], y[: top - 1 : -1]))
    return (falling - rising) / float(np.ptp(y))


# --- what is driven ----------------------------------------------------------------------------------------------


class Driven(NamedTuple):
    """The calibration's command every millisecond, and which of them the host gets, with its time."""

    held_v: Array
    ticks: NDArray[np.int64]
    t_s: Array


def calibration_drive() -> Driven:
    """Let `edmctl calibrate` drive the virtual machine, and note the actuator's voltage at every tick."""
    from edmctl.link.session import Session
    from edmctl.machine.controller import LinkMachine
    from edmctl.machine.stop import StopRequest
    from edmctl.procedures.calibration import measure_actuator, plan_calibration
    from edmctl.profile.setup import Setup
    from edmctl.simulator import BenchConfig, open_bench

    bench = open_bench(BenchConfig(), 1)
    held: list[Array] = []
    seen = bench.plant.readings.tick
    read = bench.transport.read

    def noting(timeout_s: float) -> bytes:
        nonlocal seen
        data = read(timeout_s)
        ring, tick = bench.controller.kept().array("actuator_v"), bench.plant.readings.tick
        if tick - seen > len(ring):
            raise RuntimeError("more milliseconds passed at once than the controller remembers")
        held.append(ring[np.arange(seen, tick) % len(ring)])
        seen = tick
        return data

    bench.transport.read = noting  # type: ignore[method-assign]
    session = Session(bench.transport, Random(1))
    session.open()
    setup = Setup()
    record = measure_actuator(
        LinkMachine(session, StopRequest()), setup, plan_calibration(setup), _Deaf()
    ).record
    held_v = np.concatenate(held)
    since = np.round(record.t_s / TICK_S).astype(np.int64)
    first_moved = int(np.argmax(record.u_v > 0.0))
    for at in np.flatnonzero(np.isclose(held_v, record.u_v[first_moved], atol=1e-9)).tolist():
        ticks = since + at - since[first_moved]
        if ticks[0] >= 0 and ticks[-1] < len(held_v) and np.allclose(held_v[ticks], record.u_v, atol=1e-9):
            return Driven(held_v[ticks[0] : ticks[-1] + 1].copy(), ticks - ticks[0], record.t_s)
    raise RuntimeError("the host's samples are not among the milliseconds of the controller")


class _Deaf:
    """Watches nothing."""

    def progress(self, p: object) -> None: ...
    def note(self, text: str) -> None: ...


SWINGS: tuple[tuple[float, float], ...] = (
    (0.0, 0.0),
    (2.5, 150.0),
    (5.0, 0.0),
    (7.5, 150.0),
    (10.0, 0.0),
    (20.0, 0.0),
)
"""Two conditioning swings, as before every job, and a rest."""
REST_END, ZERO_TICKS = 20_000, 2000


def _slow(rng: np.random.Generator) -> Array:
    """10 mHz: a triangle and a sine of other heights."""
    first_v, second_v = rng.uniform(120.0, 150.0), rng.uniform(60.0, 140.0)
    triangle = _path([(0.0, 0.0), (50.0, first_v), (100.0, 0.0)])
    t_s = TICK_S * np.arange(1, 100_001)
    return np.concatenate([triangle, 0.5 * second_v * (1.0 - np.cos(0.02 * math.pi * t_s))])


def _second(rng: np.random.Generator) -> Array:
    """1 Hz: every half swing goes to another voltage."""
    ends_v = rng.uniform(0.0, 150.0, 81)
    ends_v[0] = 0.0
    ease = 0.5 * (1.0 - np.cos(math.pi * np.arange(1, 501) / 500))
    return np.concatenate([a + (b - a) * ease for a, b in pairwise(ends_v)])


def _steps(rng: np.random.Generator) -> Array:
    """Jumps to four voltages, held for a minute each."""
    knots, t_s = [(0.0, 0.0)], 0.0
    for level_v in (
        rng.uniform(90.0, 145.0),
        rng.uniform(20.0, 80.0),
        rng.uniform(60.0, 140.0),
        rng.uniform(0.0, 30.0),
    ):
        t_s += abs(level_v - knots[-1][1]) / SLEW_V_S
        knots += [(t_s, level_v), (t_s + 60.0, level_v)]
        t_s += 60.0
    return _path(knots)


def _jumps(rng: np.random.Generator) -> Array:
    """A slow feed; after every so many seconds the electrode jumps back and returns."""
    knots, t_s, feed_v = [(0.0, 0.0)], 0.0, 0.0
    top_v = rng.uniform(110.0, 145.0)
    for jump in range(1, 10):
        interval_s, away_s, feed_v = rng.uniform(6.0, 12.0), rng.uniform(0.3, 1.5), top_v * jump / 9.0
        back_v = feed_v * rng.uniform(0.0, 0.7)
        travel_s = (feed_v - back_v) / SLEW_V_S
        for after_s, u_v in ((interval_s, feed_v), (travel_s, back_v), (away_s, back_v), (travel_s, feed_v)):
            t_s += after_s
            knots.append((t_s, u_v))
    return _path(knots)


def _servo(rng: np.random.Generator) -> Array:
    """200 s of a gap servo: a feed that wanders, small oscillations that come and go."""
    count = 200_000
    t_s = TICK_S * np.arange(1, count + 1)
    start_v, end_v = rng.uniform(20.0, 50.0), rng.uniform(90.0, 130.0)
    feed_v = np.interp(t_s, [0.0, 5.0, 200.0], [0.0, start_v, end_v])
    walk_v = np.cumsum(rng.normal(0.0, 1.0, count // 20))
    walk_v = (
        4.0 * (walk_v - np.linspace(walk_v[0], walk_v[-1], len(walk_v))) / max(float(np.std(walk_v)), 1e-9)
    )
    walk = np.interp(t_s, np.linspace(0.0, 200.0, len(walk_v)), walk_v)
    swing = np.zeros(count)
    for _ in range(3):
        frequency_hz, phase = rng.uniform(1.0, 8.0), rng.uniform(0.0, 6.28)
        depth = 0.5 * (1.0 - np.cos(2.0 * math.pi * t_s / rng.uniform(7.0, 40.0)))
        swing += rng.uniform(0.3, 1.0) * depth * np.sin(2.0 * math.pi * frequency_hz * t_s + phase)
    fade = np.clip(t_s / 5.0, 0.0, 1.0)
    return np.asarray(feed_v + fade * (np.clip(walk, -12.0, 12.0) + swing))


def _fast(rng: np.random.Generator) -> Array:
    """Sums of sines of 5 to 50 Hz on three biases, 5 to 20 V high in all, faded in and out over half a second."""
    parts, last_v = [], 0.0
    t_s = TICK_S * np.arange(1, 6001)
    fade = np.clip(2.0 * np.minimum(t_s, 6.0 - t_s), 0.0, 1.0)
    for bias_v, high_v in zip(
        rng.permutation([40.0, 75.0, 110.0]), (5.0, rng.uniform(8.0, 16.0), 20.0), strict=True
    ):
        frequencies_hz = np.append(rng.uniform(5.0, 45.0, 3), 50.0)
        sines = np.sin(2.0 * math.pi * frequencies_hz[:, np.newaxis] * t_s + rng.uniform(0.0, 6.28, (4, 1)))
        total = rng.uniform(0.5, 1.0, 4) @ sines
        parts += [_path([(0.0, last_v), (1.0, bias_v)]), bias_v + fade * high_v * total / np.abs(total).max()]
        last_v = float(bias_v)
    return np.concatenate(parts)


MIXED: dict[str, Callable[[np.random.Generator], Array]] = {
    "10 mHz": _slow,
    "1 Hz": _second,
    "steps": _steps,
    "jumps": _jumps,
    "servo": _servo,
}
FAST = "to 50 Hz"
WAVEFORMS = {**MIXED, FAST: _fast}
ALONE, SLOW_TICKS = "sines alone", 400
"""The same less the mean error over 0.4 s: what delay and lag cost, without where the hysteresis is by now."""


SEEN = "seen"
"""Through the sensor, as `validate` finds it, instead of against the noise-free displacement."""


class How(NamedTuple):
    """How the zero is set, and which waveforms count as mixed."""

    zero: str
    mixed: tuple[str, ...] = tuple(MIXED)


# --- judging -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Errors:
    """Largest and RMS error, % of the stroke, of so many samples."""

    max_pct: float
    rms_pct: float
    samples: int

    @classmethod
    def of(cls, left_pct: Array) -> Errors:
        """Of errors, shape (n,)."""
        return cls(float(np.abs(left_pct).max()), float(np.sqrt(np.mean(left_pct**2))), len(left_pct))

    @classmethod
    def joined(cls, parts: Sequence[Errors]) -> Errors:
        """Of several waveforms, every millisecond alike."""
        total = sum(part.samples for part in parts)
        mean_square = sum(part.samples * part.rms_pct**2 for part in parts) / total
        return cls(max(part.max_pct for part in parts), math.sqrt(mean_square), total)


@dataclass(frozen=True)
class Judged:
    """An actuator, what its calibration says of itself, and what is true; `waveforms` by how the zero was set."""

    draw: Draw
    variant: str
    shape: dict[str, float]
    stated: Errors
    stated_model: Errors
    maxwell: Errors
    accepted: bool
    problems: tuple[str, ...]
    notes: tuple[str, ...]
    delay_ms: float
    waveforms: dict[str, dict[str, Errors]]

    def mixed(self, how: How) -> Errors:
        """Over the mixed waveforms."""
        return Errors.joined([self.waveforms[how.zero][name] for name in how.mixed])

    def alone(self, how: How) -> Errors:
        """Over the sines of that, without what is slower."""
        return self.waveforms[how.zero][ALONE]

    def fast(self, how: How) -> Errors:
        """Over what goes to 50 Hz."""
        return self.waveforms[how.zero][FAST]


def judge(draw: Draw, variant: str, driven: Driven) -> Judged:
    """Build, calibrate and judge one actuator."""
    from edmctl.actuator.validation import ZERO
    from edmctl.jobs.calibration_fit import find

    actuator, shape = built(draw)
    rng = np.random.default_rng([draw.seed, KINDS.index(draw.kind), 2])
    read_um = actuator.sensed(actuator.drive(driven.held_v), rng)
    record = Record(driven.t_s, driven.held_v[driven.ticks], read_um[driven.ticks], None, draw.kind)
    findings = find([record], [], ZERO, None)
    found = findings.identification
    waveforms: dict[str, dict[str, Errors]] = {"start": {}, "mean": {}, SEEN: {}}
    for name, wave in WAVEFORMS.items():
        u_v = np.concatenate([_path(SWINGS), _on_grid(wave(rng))])
        truth_um = actuator.drive(u_v)
        seen_um = actuator.sensed(truth_um, rng)
        error_um = predicted(found.model, u_v) - truth_um
        missed_um = error_um - (seen_um - truth_um)
        for zero, errors_um, zero_um in (
            ("start", error_um, missed_um[REST_END - ZERO_TICKS : REST_END].mean()),
            ("mean", error_um, error_um[REST_END:].mean()),
            (SEEN, missed_um, missed_um[REST_END:].mean()),
        ):
            left = 100.0 * (errors_um[REST_END:] - zero_um) / actuator.stroke_um
            waveforms[zero][name] = Errors.of(left)
            if name == FAST:
                slow = np.convolve(left, np.full(SLOW_TICKS, 1.0 / SLOW_TICKS), "same")
                waveforms[zero][ALONE] = Errors.of((left - slow)[SLOW_TICKS:-SLOW_TICKS])
    return Judged(
        draw=draw,
        variant=variant,
        shape=shape,
        stated=Errors(found.held_out.max_pct, found.held_out.rms_pct, found.samples),
        stated_model=Errors(found.held_out_model.max_pct, found.held_out_model.rms_pct, found.samples),
        maxwell=Errors(
            findings.held_out_baselines["maxwell"].max_pct,
            findings.held_out_baselines["maxwell"].rms_pct,
            found.samples,
        ),
        accepted=found.accepted,
        problems=tuple(found.problems),
        notes=tuple(found.notes),
        delay_ms=1000.0 * found.model.delay_s,
        waveforms=waveforms,
    )


def predicted(model: ActuatorModel, u_v: Array) -> Array:
    """What the model makes of a command every millisecond, from rest after full swings on, µm."""
    t_s: Array = TICK_S * np.arange(float(len(u_v)))
    return model.predict(t_s, u_v, model.starting_state(t_s, u_v, None))


BUILDS = 20


def built(draw: Draw) -> tuple[Foreign, dict[str, float]]:
    """Build the first of a draw that is an actuator, and what it looks like. Raises AssertionError where none is.

    A wide loop of generalised plays with steep envelopes all but stands at its ends, which no actuator does.
    """
    none = AssertionError()
    for build in range(BUILDS):
        actuator = Foreign(draw, build)
        try:
            return actuator, look_at(actuator)
        except AssertionError as wrong:
            none = wrong
    raise none


def look_at(actuator: Foreign) -> dict[str, float]:
    """Stroke, loop, slopes and creep as one would measure them. Raises AssertionError where it is no actuator."""
    u_v = _path([(0.0, 0.0), (50.0, STROKE_V), (100.0, 0.0)])
    y_um = actuator.drive(u_v)
    rising, falling = slice(3000, 48_000, 1000), slice(53_000, 97_000, 1000)
    mean_slope = float(np.ptp(y_um)) / STROKE_V
    slopes = [np.diff(y_um[part]) / np.diff(u_v[part]) for part in (rising, falling)]
    held_um = actuator.drive(_path([(0.0, 0.0), (0.12, 120.0), (100.12, 120.0)]))
    first_um, second_um, last_um = held_um[1120], held_um[10_120], held_um[100_119]
    small_v = 60.0 + 5.0 * np.sin(2.0 * math.pi * TICK_S * np.arange(1, 4001))
    minor_um = actuator.drive(_on_grid(np.concatenate([_path([(0.0, 0.0), (5.0, 60.0)]), small_v])))[-1000:]
    shape = {
        "stroke_um": float(np.ptp(y_um)),
        "loop": _opening(u_v, y_um),
        "least_slope": float(np.concatenate(slopes).min()) / mean_slope,
        "most_slope": float(np.concatenate(slopes).max()) / mean_slope,
        "minor_slope": float(np.ptp(minor_um)) / 10.0 / mean_slope,
        "creep_1_10_s": float((second_um - first_um) / first_um),
        "creep_10_100_s": float((last_um - second_um) / first_um),
    }
    wrong = [
        what
        for what, is_right in (
            ("a stroke of 445 µm", abs(shape["stroke_um"] - STROKE_UM) <= 0.04 * STROKE_UM),
            ("a loop of 5 to 25 %", 0.05 <= shape["loop"] <= 0.25),
            ("a slope that is positive", shape["least_slope"] >= 0.1 and 0.1 <= shape["minor_slope"] <= 1.5),
            ("creep of 0.4 to 12 % a decade", 0.004 <= shape["creep_1_10_s"] <= 0.12),
            ("creep that goes on", shape["creep_10_100_s"] >= 0.3 * shape["creep_1_10_s"]),
        )
        if not is_right
    ]
    if wrong:
        raise AssertionError(f"{actuator.draw} has not {' and '.join(wrong)}: {shape}")
    return shape


# --- verdicts ----------------------------------------------------------------------------------------------------

CASES = ("one rate", "near rate", "no hold", "drift", "differing", "ringing", "lag 5 ms", "creep x3")
RECORD_EVERY = 2
"""A record keeps each second millisecond."""


@dataclass(frozen=True)
class Verdict:
    """A fit: what it was fitted to, its errors on each file and held out (RMS %, max %), and what was said."""

    name: str
    fitted: str
    accepted: bool
    restricted: bool
    held_out: tuple[float, float]
    validated: tuple[tuple[float, float], ...]
    limit_max_pct: float
    problems: tuple[str, ...]

    @property
    def excess(self) -> float:
        """Worst error on the validation files, over what is accepted."""
        return max(max(rms / ACCEPT_RMS_PCT, largest / ACCEPT_MAX_PCT) for rms, largest in self.validated)

    @property
    def is_above(self) -> bool:
        """Whether an error that the verdict depends on is above the limits."""
        errors = (self.held_out, *self.validated)
        return any(rms > ACCEPT_RMS_PCT or largest > self.limit_max_pct for rms, largest in errors)


def _cycles(rng: np.random.Generator, frequency_hz: float, seconds: float, hold_s: float) -> Array:
    """Two full swings, swings of other heights at one rate, a step up with a hold, full swings again."""
    count = max(6, round(seconds * frequency_hz))
    tops_v = np.concatenate([[150.0] * 2, rng.uniform(40.0, 150.0, count - 4), [150.0] * 2])
    phase = np.arange(round(1.0 / (frequency_hz * TICK_S))) * TICK_S * frequency_hz
    swings = [0.5 * top_v * (1.0 - np.cos(2.0 * math.pi * phase)) for top_v in tops_v]
    held = [
        _path([(0.0, 0.0), (0.1, 100.0), (0.1 + hold_s, 100.0), (0.2 + hold_s, 0.0)])
        for _ in range(hold_s > 0)
    ]
    half = count // 2
    return _on_grid(np.concatenate([*swings[:half], *held, *swings[half:]]))


def _stepping(rng: np.random.Generator) -> Array:
    """Steps within a millisecond to levels that are kept for 0.2 s."""
    levels_v = rng.uniform(0.0, 150.0, 60)
    levels_v[[0, 20, 40]], levels_v[[1, 21, 41]] = 0.0, 150.0
    return _on_grid(np.repeat(levels_v, 200))


def _resonating(y_um: Array, frequency_hz: float, damping: float) -> Array:
    """What a mass on a spring makes of a displacement, sampled every millisecond."""
    from scipy import signal

    omega = 2.0 * math.pi * frequency_hz
    spring = np.array([omega**2]), np.array([1.0, 2.0 * damping * omega, omega**2])
    numerator, denominator, _ = signal.cont2discrete(spring, TICK_S, "zoh")
    filtered: Array = signal.lfilter(numerator.ravel(), denominator, y_um - y_um[0]) + y_um[0]
    return filtered


def verdicts_of(kind: str, number: int, first_seed: int) -> list[Verdict]:
    """Fit one plant to one record and to two, and verify both with files of other rates."""
    from edmctl.actuator.acceptance import most_accepted_pct
    from edmctl.jobs.calibration_fit import find

    case, seed = CASES[number % len(CASES)], first_seed + number
    draw = drawn(kind, seed)
    change = VARIANTS[case].change if case in VARIANTS else (lambda same: same)
    actuator, _ = built(change(draw))
    rng = np.random.default_rng([seed, KINDS.index(kind), 4])
    slow_hz = rng.uniform(1.0, 4.0)
    fast_hz = slow_hz * (1.6 if case == "near rate" else rng.uniform(4.0, 6.0))
    hold_s = 0.0 if case in ("no hold", "one rate") else 4.0
    voltages = {
        "slow": _cycles(rng, slow_hz, 12.0, hold_s),
        "fast": _cycles(rng, fast_hz, 8.0, hold_s),
        "between": _cycles(rng, math.sqrt(slow_hz * fast_hz), 8.0, 0.0),
        "beyond": _cycles(rng, 1.5 * fast_hz, 4.0, 0.0),
    }
    if case == "ringing":
        for name in voltages:
            voltages[name] = np.concatenate([voltages[name], _stepping(rng)])
    ring_hz, damping = rng.uniform(60.0, 180.0), rng.uniform(0.02, 0.05)
    records = {}
    for name, held_v in voltages.items():
        truth_um = actuator.drive(held_v)
        if case == "ringing":
            truth_um = _resonating(truth_um, ring_hz, damping)
        y_um: Array = actuator.sensed(truth_um, rng)
        if case == "drift":
            y_um += rng.uniform(15.0, 40.0) * np.linspace(0.0, 1.0, len(y_um)) ** rng.uniform(1.0, 2.0)
        if case == "differing" and name == "fast":
            y_um *= rng.uniform(1.02, 1.05)
        t_s: Array = TICK_S * np.arange(1.0, len(held_v) + 1.0)
        kept = slice(None, None, RECORD_EVERY)
        records[name] = Record(t_s[kept], held_v[kept], y_um[kept], None, name)
    validation = [records["between"], records["beyond"]]
    found = []
    for fitted in (("slow",), ("slow", "fast")):
        one = find([records[name] for name in fitted], validation, ("zero",), None)
        whole, noise = one.identification.held_out_records, one.identification.noise
        errors = [one.held_out, *([whole] if whole else [])]
        found.append(
            Verdict(
                name=f"{kind} {seed} {case}",
                fitted=" + ".join(fitted),
                accepted=one.identification.accepted,
                restricted=bool(one.identification.restrictions),
                held_out=(max(e.rms_pct for e in errors), max(e.max_pct for e in errors)),
                validated=tuple((file.rms_pct, file.max_pct) for file in one.files),
                limit_max_pct=most_accepted_pct(noise, one.held_out.range_um),
                problems=one.identification.problems,
            )
        )
    return found


def judge_verdicts(given: argparse.Namespace) -> int:
    """Print every verdict and the bars."""
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    plants = [(kind, number) for number in range(given.count) for kind in given.kind]
    print(f"{'plant':28}{'fitted to':14}{'held out':>14}  validated, RMS/max %")
    above, inverted, rings = [], [], []
    with ProcessPoolExecutor(given.jobs, multiprocessing.get_context("spawn")) as pool:
        for pair in pool.map(partial(_verdicts, first_seed=given.first_seed), plants):
            for one in pair:
                words = (
                    ("accepted with restrictions" if one.restricted else "accepted")
                    if one.accepted
                    else "refused"
                )
                files = ", ".join(f"{rms:.2f}/{largest:.2f}" for rms, largest in one.validated)
                held = "{:.2f}/{:.2f}".format(*one.held_out)
                why = "".join(f"\n    {what[:150]}" for what in one.problems)
                print(f"{one.name:28}{one.fitted:14}{held:>14}  {files}  {words}{why}", flush=True)
                if one.accepted and one.is_above:
                    above.append(f"{one.name} {one.fitted}")
            better, worse = sorted(pair, key=lambda one: one.excess)
            if worse.accepted and not better.accepted:
                inverted.append(better.name)
            if "ringing" in pair[0].name:
                rings.append(any("rings at" in what for one in pair for what in one.problems))
    bars = Bars()
    print()
    bars.say(
        f"accepted above the limits: {len(above)} of {2 * len(plants)} fits{_listed(above)}", is_met=not above
    )
    words = f"better of two fits refused while the worse is accepted: {len(inverted)} of {len(plants)} plants"
    bars.say(f"{words}{_listed(inverted)}", is_met=not inverted)
    bars.say(f"ringing is named for {sum(rings)} of {len(rings)} plants", is_met=all(rings))
    return int(bool(bars.missed))


def _verdicts(plant: tuple[str, int], first_seed: int) -> list[Verdict]:
    return verdicts_of(*plant, first_seed)


# --- the whole ---------------------------------------------------------------------------------------------------

BASE = "base"
MOST_CREEP = 0.08
"""Per decade; the most that measured records show is 0.055."""


@dataclass(frozen=True)
class Variant:
    """Another set: what becomes of a draw, and for which kinds that means something."""

    change: Callable[[Draw], Draw]
    kinds: tuple[str, ...] = KINDS


VARIANTS = {
    "bow x3": Variant(lambda d: replace(d, bow=3.0 * d.bow)),
    "saturation x4": Variant(lambda d: replace(d, saturation=4.0 * d.saturation)),
    "creep x3": Variant(lambda d: replace(d, creep=min(MOST_CREEP, 3.0 * d.creep))),
    "branch 0.4": Variant(lambda d: replace(d, branch=0.4), ("bouc-wen", "prandtl")),
    "branch 0.6": Variant(lambda d: replace(d, branch=0.6), ("bouc-wen", "prandtl")),
    "beta x2": Variant(lambda d: replace(d, beta=2.0), ("bouc-wen",)),
    "loop 17.5 %": Variant(lambda d: replace(d, loop=0.175)),
    "n = 2": Variant(lambda d: replace(d, sharpness=2.0), ("bouc-wen",)),
    "lag 2 ms": Variant(lambda d: replace(d, lag_s=0.002)),
    "lag 5 ms": Variant(lambda d: replace(d, lag_s=0.005)),
}


@dataclass
class Bars:
    """Bars, each met or missed."""

    missed: list[str] = field(default_factory=list)

    def say(self, what: str, *, is_met: bool) -> None:
        """Print one."""
        print(f"  {'met   ' if is_met else 'MISSED'} {what}")
        if not is_met:
            self.missed.append(what)


OTHER = {"start": "mean", "mean": "start"}


def line_of(one: Judged, how: How) -> str:
    """One line of the table."""
    mixed, fast = one.mixed(how), one.fast(how)
    rms, largest = stated_over(one, how)
    other = one.mixed(how._replace(zero=OTHER[how.zero]))
    accepted = "accepted" if one.accepted else "refused: " + " | ".join(what[:48] for what in one.problems)
    return (
        f"{one.draw.kind:9}{one.draw.seed:4} {one.variant:14}"
        f"{100 * one.shape['loop']:6.1f}{100 * one.shape['creep_1_10_s']:6.1f}{one.delay_ms:6.2f}"
        f"{mixed.max_pct:7.2f}/{mixed.rms_pct:5.3f}{other.max_pct:7.2f}/{other.rms_pct:5.3f}"
        f"{one.stated.max_pct:8.2f}/{one.stated.rms_pct:5.3f}"
        f"{largest:7.2f}/{rms:4.2f}"
        f"{fast.max_pct:8.2f}/{fast.rms_pct:5.3f}{one.alone(how).max_pct:8.2f}"
        f"{one.maxwell.max_pct:7.1f}/{one.maxwell.rms_pct:4.2f}  {accepted}"
    )


def heading(how: How) -> str:
    """What stands above the table."""
    return (
        f"{'errors, max/RMS, % of stroke':28}{'loop':>6}{'creep':>6}{'delay':>6}{f'mixed ({how.zero})':>13}"
        f"{f'({OTHER[how.zero]})':>13}{'stated':>14}{'ratio':>12}{'to 50 Hz':>14}{'alone':>8}{'Maxwell':>12}"
    )


def stated_over(one: Judged, how: How) -> tuple[float, float]:
    """RMS and largest error that are stated, over those that come: through the sensor, or of the model alone."""
    mixed, stated = one.mixed(how), one.stated if how.zero == SEEN else one.stated_model
    return stated.rms_pct / mixed.rms_pct, stated.max_pct / mixed.max_pct


def is_honest(one: Judged, how: How) -> bool:
    """Whether what is stated is near what comes, from either side."""
    rms, largest = stated_over(one, how)
    return 1.0 / RMS_RATIO <= rms <= RMS_RATIO and 1.0 / MAX_RATIO <= largest <= MAX_RATIO


def wrongly_judged(many: Sequence[Judged], how: How) -> list[str]:
    """Good ones that were refused and bad ones that were accepted."""
    wrong = []
    for one in many:
        mixed, name = one.mixed(how), f"{one.draw.kind} {one.draw.seed} {one.variant}"
        is_good = mixed.rms_pct <= ACCEPT_RMS_PCT and mixed.max_pct <= ACCEPT_MAX_PCT
        is_bad = mixed.rms_pct > REFUSE_RMS_PCT or mixed.max_pct > REFUSE_MAX_PCT
        if (is_good and not one.accepted) or (is_bad and one.accepted):
            wrong.append(f"{name} {'refused' if is_good else 'accepted'}")
    return wrong


def judge_bars(many: Sequence[Judged], how: How) -> Bars:
    """Print the bars; those of the base set, of the lags, and of acceptance over all."""
    bars = Bars()
    base = [one for one in many if one.variant == BASE]
    if base:
        largest = [one.mixed(how).max_pct for one in base]
        count, needed = len(base), math.ceil(SHARE * len(base) - 1e-9)
        good = sum(value <= MOST_MAX_PCT for value in largest)
        bars.say(f"max <= {MOST_MAX_PCT} % in {good} of {count}, {needed} needed", is_met=good >= needed)
        median = statistics.median(largest)
        bars.say(
            f"median of max {median:.2f} %, <= {MOST_MEDIAN_PCT} % needed", is_met=median <= MOST_MEDIAN_PCT
        )
        honest = sum(is_honest(one, how) for one in base)
        words = (
            f"stated RMS within x{RMS_RATIO} and max within x{MAX_RATIO} of the truth in {honest} of {count}"
        )
        seen = sum(is_honest(one, how._replace(zero=SEEN)) for one in base)
        words = f"{words} (through the sensor, of what validate finds, in {seen})"
        bars.say(f"{words}, {needed} needed", is_met=honest >= needed)
        fast = [one.fast(how).max_pct for one in base]
        near = sum(value <= MOST_FAST_PCT for value in fast)
        words = f"content to 50 Hz <= {MOST_FAST_PCT} % in {near} of {count} (median {statistics.median(fast):.2f},"
        bars.say(f"{words} worst {max(fast):.2f}), {needed} needed", is_met=near >= needed)
    for name in ("lag 2 ms", "lag 5 ms"):
        fast = [one.fast(how).max_pct for one in many if one.variant == name]
        if fast:
            words = f"{name}: to 50 Hz median {statistics.median(fast):.2f}, worst {max(fast):.2f} %"
            bars.say(f"{words}, <= {MOST_FAST_PCT} % needed", is_met=max(fast) <= MOST_FAST_PCT)
    wrong = wrongly_judged(many, how)
    bars.say(f"accepted what is good, not what is bad: {len(wrong)} wrong{_listed(wrong)}", is_met=not wrong)
    return bars


def _listed(names: Sequence[str]) -> str:
    return f" ({', '.join(names)})" if names else ""


def summary_of(many: Sequence[Judged], how: How) -> None:
    """Print a line per set, and which waveform costs what for which kind in the base set."""
    print(
        f"\n{'set':14}{'n':>4}{'max: median, worst':>20}{'RMS: median, worst':>20}"
        f"{'50 Hz: median, worst':>22}{'sines alone':>14}"
    )
    for name in dict.fromkeys(one.variant for one in many):
        some = [one for one in many if one.variant == name]
        columns = (
            [one.mixed(how).max_pct for one in some],
            [one.mixed(how).rms_pct for one in some],
            [one.fast(how).max_pct for one in some],
            [one.alone(how).max_pct for one in some],
        )
        texts = (f"{statistics.median(column):.2f}, {max(column):.2f}" for column in columns)
        accepted = sum(one.accepted for one in some)
        print("{:14}{:4}{:>20}{:>20}{:>22}{:>14}   {} accepted".format(name, len(some), *texts, accepted))
    names = [*WAVEFORMS, ALONE]
    print(f"\n{'max of the base set: median, worst':34}" + "".join(f"{name:>13}" for name in names))
    for kind in KINDS:
        some = [one for one in many if one.variant == BASE and one.draw.kind == kind]
        if some:
            largest = ([one.waveforms[how.zero][name].max_pct for one in some] for name in names)
            texts = (f"{statistics.median(column):.2f}, {max(column):.2f}" for column in largest)
            print(f"{kind:34}" + "".join(f"{text:>13}" for text in texts))


def asked(given: argparse.Namespace) -> list[tuple[Draw, str]]:
    """What is to be judged."""
    seeds = range(given.first_seed, given.first_seed + given.count)
    cases = [] if given.no_base else [(drawn(kind, seed), BASE) for kind in given.kind for seed in seeds]
    names = list(VARIANTS) if "all" in given.variants else given.variants
    few = range(given.first_seed, given.first_seed + min(given.count, given.of_a_variant))
    for name in names:
        variant = VARIANTS[name]
        cases += [
            (variant.change(drawn(kind, s)), name)
            for kind in given.kind
            if kind in variant.kinds
            for s in few
        ]
    return cases


def options() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--count", type=int, default=8, help="actuators of a kind in the base set")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--variants", nargs="*", choices=("all", *VARIANTS), default=[])
    parser.add_argument("--of-a-variant", type=int, default=2, help="actuators of a kind in each variant")
    parser.add_argument("--no-base", action="store_true", help="variants alone")
    parser.add_argument("--zero", choices=("start", "mean"), default="mean", help="how bars set the zero")
    words = "held-out waveforms that bars count as mixed"
    parser.add_argument("--mixed", nargs="+", choices=tuple(MIXED), default=tuple(MIXED), help=words)
    parser.add_argument("--verdicts", action="store_true", help="verdicts on records of few rates instead")
    parser.add_argument("--jobs", type=int, choices=(1, 2), default=2)
    return parser.parse_args()


def measured(given: argparse.Namespace, how: How) -> list[Judged]:
    """Calibrate and judge all that was asked for, printing a line for each."""
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    driven = calibration_drive()
    length_s, period_s = driven.t_s[-1], float(np.median(np.diff(driven.t_s)))
    print(f"calibration: {len(driven.t_s)} samples in {length_s:.1f} s, one every {1000 * period_s:g} ms")
    print(heading(how), flush=True)
    many: list[Judged] = []
    with ProcessPoolExecutor(given.jobs, multiprocessing.get_context("spawn")) as pool:
        judging = partial(judge, driven=driven)
        for one in pool.map(judging, *zip(*asked(given), strict=True)):
            print(line_of(one, how), flush=True)
            many.append(one)
    return many


def main() -> int:
    """Judge all, print, and return the exit code."""
    given = options()
    how = How(given.zero, tuple(given.mixed))
    if given.verdicts:
        return judge_verdicts(given)
    try:
        many = measured(given, how)
    except AssertionError as none:
        print(none)
        return 2
    summary_of(many, how)
    print(f"\nbars, zero by {how.zero}")
    return 1 if judge_bars(many, how).missed else 0


if __name__ == "__main__":
    sys.exit(main())
