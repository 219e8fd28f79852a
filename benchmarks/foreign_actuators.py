"""Print how a calibration does on actuators of kinds that edmctl does not hold.

    python -m benchmarks.foreign_actuators [--kind bouc-wen preisach prandtl] [--count 8] [--first-seed 1]
        [--variants "lag 2 ms" "lag 5 ms"] [--jobs 2]

Three kinds, each drawn from a seed: Bouc-Wen (an equation of rate, without the memory of turning points), Preisach
with a smooth density, and generalised Prandtl-Ishlinskii with other envelopes up than down. All have a bent and
saturating reversible part, creep, and an amplifier with delay and lag; none shares code with `edmctl`.

The voltage of the calibration is the one that `edmctl calibrate` drives on the virtual machine, millisecond by
millisecond, with the samples that the host gets of it; what is fitted is what the command fits. Then five mixed
waveforms and one of 5 to 50 Hz are held out, with fresh noise and drift of the sensor: before each the actuator
swings twice over its stroke and rests, and from there on the model gets the voltage alone. Errors are against the
noise-free displacement, in % of the stroke, with the zero set by least squares over the waveform. What a calibration
states of the model, without the sensor's noise, is compared with that; what it states through the sensor with what
`validate` finds of the same waveforms through it, with its noise and drift.

Exit code 1 where a bar is missed, 2 where none of twenty builds of a draw is an actuator (hysteretic, creeping,
monotone, of 445 µm).
"""

from __future__ import annotations

import math
import multiprocessing
import os
import statistics
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from random import Random
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from benchmarks.common import options
from edmctl.actuator.record import Record

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from edmctl.actuator.identification import Identification
    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.validation import ErrorFigures

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
REST_END = 20_000


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


# --- judging -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Errors:
    """Largest and RMS error, % of the stroke."""

    max_pct: float
    rms_pct: float

    @classmethod
    def of(cls, left_pct: Array) -> Errors:
        """Of errors, shape (n,)."""
        return cls(float(np.abs(left_pct).max()), float(np.sqrt(np.mean(left_pct**2))))

    def is_near(self, stated: ErrorFigures) -> bool:
        """Whether what is stated is near these errors, from either side."""
        rms, largest = stated.rms_pct / self.rms_pct, stated.max_pct / self.max_pct
        return 1.0 / RMS_RATIO <= rms <= RMS_RATIO and 1.0 / MAX_RATIO <= largest <= MAX_RATIO


@dataclass(frozen=True)
class Judged:
    """An actuator, what its calibration says of itself, and its errors on the waveforms held out.

    mixed, fast : against the noise-free displacement, on mixed waveforms and to 50 Hz
    seen : through the sensor, as `validate` finds it, on mixed waveforms
    """

    draw: Draw
    variant: str
    found: Identification
    mixed: Errors
    seen: Errors
    fast: Errors

    @property
    def is_wrong(self) -> bool:
        """Whether it is good and was refused, or bad and accepted."""
        mixed = self.mixed
        is_good = mixed.rms_pct <= ACCEPT_RMS_PCT and mixed.max_pct <= ACCEPT_MAX_PCT
        is_bad = mixed.rms_pct > REFUSE_RMS_PCT or mixed.max_pct > REFUSE_MAX_PCT
        return (is_good and not self.found.accepted) or (is_bad and self.found.accepted)

    def __str__(self) -> str:
        stated, model = self.found.held_out, self.found.held_out_model
        figures = (self.mixed, self.seen, stated, model, self.fast)
        row = "".join(f"{one.max_pct:9.2f}/{one.rms_pct:5.3f}" for one in figures)
        verdict = "accepted" if self.found.accepted else f"refused: {' | '.join(self.found.problems)[:80]}"
        return f"{self.draw.kind:9}{self.draw.seed:4} {self.variant:14}{row}  {verdict}"


HEADING = f"{'errors, max/RMS, % of stroke':28}" + "".join(
    f"{name:>15}" for name in ("mixed", "validate", "stated", "of the model", "to 50 Hz")
)


def judge(draw: Draw, variant: str, driven: Driven) -> Judged:
    """Build, calibrate and judge one actuator."""
    from edmctl.jobs.calibrate import find

    actuator = built(draw)
    rng = np.random.default_rng([draw.seed, KINDS.index(draw.kind), 2])
    read_um = actuator.sensed(actuator.drive(driven.held_v), rng)
    record = Record(driven.t_s, driven.held_v[driven.ticks], read_um[driven.ticks], None, draw.kind)
    found = find([record], [], ("zero",), None).identification
    true_pct: dict[str, Array] = {}
    seen_pct: dict[str, Array] = {}
    for name, wave in WAVEFORMS.items():
        u_v = np.concatenate([_path(SWINGS), _on_grid(wave(rng))])
        truth_um = actuator.drive(u_v)
        seen_um = actuator.sensed(truth_um, rng)
        predicted_um = predicted(found.model, u_v)
        for errors_pct, real_um in ((true_pct, truth_um), (seen_pct, seen_um)):
            left_um = (predicted_um - real_um)[REST_END:]
            errors_pct[name] = 100.0 * (left_um - left_um.mean()) / actuator.stroke_um
    mixed, seen = (Errors.of(np.concatenate([one[name] for name in MIXED])) for one in (true_pct, seen_pct))
    return Judged(draw, variant, found, mixed, seen, Errors.of(true_pct[FAST]))


def predicted(model: ActuatorModel, u_v: Array) -> Array:
    """What the model makes of a command every millisecond, from rest after full swings on, µm."""
    t_s: Array = TICK_S * np.arange(float(len(u_v)))
    return model.predict(t_s, u_v, model.starting_state(t_s, u_v, None))


BUILDS = 20


def built(draw: Draw) -> Foreign:
    """Build the first of a draw that is an actuator. Raises AssertionError where none is.

    A wide loop of generalised plays with steep envelopes all but stands at its ends, which no actuator does.
    """
    none = AssertionError()
    for build in range(BUILDS):
        actuator = Foreign(draw, build)
        try:
            look_at(actuator)
        except AssertionError as wrong:
            none = wrong
        else:
            return actuator
    raise none


def look_at(actuator: Foreign) -> None:
    """Raise AssertionError if stroke, loop, slopes and creep are not those of an actuator."""
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


# --- the whole ---------------------------------------------------------------------------------------------------

BASE = "base"
VARIANTS = {"lag 2 ms": 0.002, "lag 5 ms": 0.005}
"""Other sets: lag of the amplifier, s."""


class Bars:
    """Bars, each met or missed."""

    missed = False

    def say(self, what: str, *, is_met: bool) -> None:
        """Print one."""
        print(f"  {'met   ' if is_met else 'MISSED'} {what}")
        self.missed |= not is_met


def judge_bars(many: Sequence[Judged]) -> Bars:
    """Print the bars; those of the base set, of the lags, and of acceptance over all."""
    bars, base = Bars(), [one for one in many if one.variant == BASE]
    count, needed = len(base), math.ceil(SHARE * len(base) - 1e-9)
    largest, fast = [one.mixed.max_pct for one in base], [one.fast.max_pct for one in base]
    good, near = (
        sum(value <= MOST_MAX_PCT for value in largest),
        sum(value <= MOST_FAST_PCT for value in fast),
    )
    median = statistics.median(largest)
    bars.say(f"max <= {MOST_MAX_PCT} % in {good} of {count}, {needed} needed", is_met=good >= needed)
    words = f"median of max {median:.2f} %, <= {MOST_MEDIAN_PCT} % needed; worst {max(largest):.2f} %"
    bars.say(words, is_met=median <= MOST_MEDIAN_PCT)
    honest = sum(one.mixed.is_near(one.found.held_out_model) for one in base)
    seen = sum(one.seen.is_near(one.found.held_out) for one in base)
    words = f"stated RMS within x{RMS_RATIO} and max within x{MAX_RATIO} of the truth in {honest} of {count}"
    words = f"{words} (through the sensor, of what validate finds, in {seen}), {needed} needed"
    bars.say(words, is_met=honest >= needed)
    words = (
        f"content to 50 Hz <= {MOST_FAST_PCT} % in {near} of {count} (median {statistics.median(fast):.2f},"
    )
    bars.say(f"{words} worst {max(fast):.2f}), {needed} needed", is_met=near >= needed)
    for name in VARIANTS:
        if fast := [one.fast.max_pct for one in many if one.variant == name]:
            words = f"{name}: to 50 Hz median {statistics.median(fast):.2f}, worst {max(fast):.2f} %"
            bars.say(f"{words}, <= {MOST_FAST_PCT} % needed", is_met=max(fast) <= MOST_FAST_PCT)
    wrong = [f"{one.draw.kind} {one.draw.seed} {one.variant}" for one in many if one.is_wrong]
    words = f"accepted what is good, not what is bad: {len(wrong)} wrong {', '.join(wrong)}"
    bars.say(words, is_met=not wrong)
    return bars


def main() -> int:
    """Judge all, print, and return the exit code."""
    given = options(
        __doc__, {"kind": KINDS, "variants": VARIANTS}, kind=KINDS, count=8, first_seed=1, variants=[], jobs=2
    )
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    seeds = range(given.first_seed, given.first_seed + given.count)
    cases = [(drawn(kind, seed), BASE) for kind in given.kind for seed in seeds]
    cases += [
        (replace(drawn(kind, seed), lag_s=VARIANTS[name]), name)
        for name in given.variants
        for kind in given.kind
        for seed in seeds[:2]
    ]
    driven, many = calibration_drive(), []
    print(f"calibration: {len(driven.t_s)} samples in {driven.t_s[-1]:.1f} s")
    print(HEADING, flush=True)
    try:
        with ProcessPoolExecutor(given.jobs, multiprocessing.get_context("spawn")) as pool:
            for one in pool.map(partial(judge, driven=driven), *zip(*cases, strict=True)):
                print(one, flush=True)
                many.append(one)
    except AssertionError as none:
        print(none)
        return 2
    return int(judge_bars(many).missed)


if __name__ == "__main__":
    sys.exit(main())
