"""The actuator model: bent and rounded plays, creep behind some of them, lag and delay, what it remembers.

y(t) = zero + Σ_i Σ_m S_im h_m(z_i) + Σ_k R_k p_k + Σ_gj C_gj L_gj, all at t − delay and of the voltage behind a
first-order lag, with plays z_i, hinges h_m, rounded plays p_k and lags L_gj. All S, R and C are ≥
0 and the first play (threshold 0) has a positive slope everywhere, so the displacement rises strictly with the
voltage from any state, with a lag in steps of up to four times the lag: the model can be inverted exactly. With one
hinge per play, no rounded one and no lag it is the Prandtl-Ishlinskii operator, and so the paper's Maxwell slip
model (`paper_model`).

Play of threshold r (volts): z_k = max(u_k − r, min(u_k + r, z_{k−1})), Krasnosel'skii & Pokrovskii 1989. It
needs no time: between turning points only the end matters. A play's output is bent by hinges, straight pieces
between knots (Prandtl's form of a discrete Preisach operator). Creep is a bank of first-order lags behind some
of the plays, L' = (z − L)/τ, exact for a play that moves in a straight line from sample to sample, so that a
record may be sampled at any rate.

A rounded play is C·u − s with a stop s that forgets with the way of the voltage (Bouc 1967, Wen 1976; Dahl's and
Duhem's friction are of the kind). With σ = ±s over the limit of the direction that the voltage moves in and the way
w over that limit,

    dσ/dw = (1 − σ)(1 + c·σ) for σ ≥ 0, loading;  1 + ρ·((1 − c)|σ| + c·σ²) for σ < 0, unloading:

c = 0 and 1 are the equation's powers 1 and 2, between lie those between, two limits make branches differ, and moves
have a closed form. C is the steepest that s can rise, so that a rounded play never falls while the voltage rises.

The amplifier's lag u_f' = (u − u_f)/τ comes before all of them, exact for a voltage that goes straight from sample
to sample. u_f may turn between two samples, where it crosses u: a path has its turning points too.

The library in C calculates them (firmware/operators). `Bank` and `Memory` are its records; the arrays whose
addresses they contain are checked.

Plays remember turning points and nothing else; a rounded one forgets with the way that the voltage goes, so that
small swings let it slide. Actuators are of the one kind, of the other, or between; what a record asks for is
found by `identification`.

The state decides half of what the actuator does next: a model that starts without memory on an actuator that
has been working is wrong by at least half the loop's width near 0 V, which is the size of the unexplained
error at the trough of Muralidhara et al. 2009, Fig. 3a.

The model does not know temperature, load (0.2 N/µm at the tool), ageing, driver error or the output resonance.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from ctypes import byref, c_double, c_int64, c_void_p
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from edmctl.array_types import Array, Integers
from edmctl.core.library import library
from edmctl.dataclasses import dataclass, field, replace

CREEP_FROM_S, CREEP_TO_S = 0.1, 10.0  # creep rates are customarily given between these times after a step

SLOW_CYCLE_S, CYCLE_SAMPLES = 100.0, 400
CLOCK_ROUNDING_S = 1e-9


States = tuple[Array, Array, Array]  # arrays of a state: plays (n,), stops (k,) and lags (g, j)
_FLOAT = np.dtype(np.float64)
_Bytes = ctypes.c_char * 0  # gives an address several times as fast as `ndarray.ctypes`


class Bank(ctypes.Structure):
    """Parameters, `struct bank`: n sharp plays of m pieces, k rounded ones, g of them with j lags each.

    thresholds (n,), knots (n, m + 1), slopes (n, m), taus (j,), weights (g, j) : ndarray
    rounded : ndarray, shape (k, 5): rising and falling limit, c, ρ, C
    roundness : ndarray, shape (k,): weights of the rounded plays
    creeping : ndarray of int, shape (g,): plays, from n on rounded ones

    Raises ValueError when the arrays do not fit each other.
    """

    _fields_ = [
        *((name, c_int64) for name in "nmkgj"),
        *((name, c_void_p) for name in ("thresholds", "knots", "slopes", "rounded", "roundness")),
        *((name, c_void_p) for name in ("creeping", "taus", "weights")),
        ("lag_s", c_double),
    ]

    def __init__(
        self,
        thresholds: Array,
        knots: Array,
        slopes: Array,
        rounded: Array,
        roundness: Array,
        creeping: Integers,
        taus: Array,
        weights: Array,
        lag_s: float,
    ) -> None:
        (n, m), k, g, j = slopes.shape, len(roundness), len(creeping), len(taus)
        shapes = (thresholds.shape, knots.shape, rounded.shape, weights.shape)
        inside = bool(((creeping >= 0) & (creeping < n + k)).all())
        if shapes != ((n,), (n, m + 1), (k, 5), (g, j)) or m < 1 or not inside:
            raise ValueError("the arrays of a bank do not fit each other")
        plays = [contiguous(one) for one in (thresholds, knots, slopes, rounded, roundness)]
        creep = np.ascontiguousarray(creeping, dtype=np.int64), contiguous(taus), contiguous(weights)
        self._arrays = (*plays, *creep)  # kept as long as their addresses
        super().__init__(n, m, k, g, j, *(one.ctypes.data for one in self._arrays), lag_s)
        self.shapes = ((n,), (k,), (g, j))
        self.room: int = library().bank_room(byref(self))

    def __reduce__(self) -> tuple[object, ...]:
        """Return how a copy is made: with arrays of its own."""
        return Bank, (*self._arrays, self.lag_s)


class Memory(ctypes.Structure):
    """State of a bank, `struct memory`, over its arrays, which C changes; ValueError for those of another bank."""

    t_s: float
    u_v: float
    lagged_v: float

    _fields_ = [
        *((name, c_void_p) for name in ("plays", "stops", "lags", "room")),
        *((name, c_double) for name in ("t_s", "u_v", "lagged_v")),
    ]

    def __init__(self, bank: Bank, arrays: States, t_s: float, u_v: float, lagged_v: float) -> None:
        plays, stops, lags = arrays
        if (plays.shape, stops.shape, lags.shape) != bank.shapes:
            shapes = tuple(one.shape for one in arrays)
            raise ValueError(f"a state of shape {shapes} for a model of {bank.shapes}")
        room = np.empty(bank.room)
        self._arrays = plays, stops, lags, room  # kept as long as their addresses
        super().__init__(*map(address_of, self._arrays), t_s, u_v, lagged_v)


def call(function: str, *arguments: object) -> None:
    """Call a function of the library with numbers, structures (by reference) and contiguous arrays (by address)."""
    getattr(library(), function)(*(_passed(argument) for argument in arguments))


def _passed(argument: object) -> object:
    if isinstance(argument, ctypes.Structure):
        return byref(argument)
    return argument.ctypes.data if isinstance(argument, np.ndarray) else argument


def contiguous(array: Array) -> Array:
    return np.ascontiguousarray(array, dtype=np.float64)


def address_of(array: Array) -> int:
    """Return the address of an array that C writes. Raises ValueError unless it is contiguous, writable float64."""
    if array.dtype != _FLOAT or not array.flags.carray:
        raise ValueError("the arrays of a state are float64, row after row in memory, and writable")
    return ctypes.addressof(_Bytes.from_buffer(array.data))


def none_of(*shape: int) -> Array:
    """Return an empty array, for a part that a model does not have."""
    return np.empty(shape)


@dataclass(frozen=True, eq=False)
class ActuatorModel:
    """Parameters of one actuator; immutable.

    thresholds_v : shape (n,), thresholds of the plays, ascending from 0
    knots_v : shape (n, m + 1), where each play's pieces begin and end, ascending; the outer pieces go on beyond
    slopes_um_per_v : shape (n, m)
    creep_plays : int, shape (g,), plays that creep; n + k is the rounded play k
    time_constants_s, creep_um_per_v : shapes (j,) and (g, j)
    low_v, high_v : the range of voltage that the model was identified over
    rounded_limits_v : shape (k, 2), limits of the rounded plays' stops while the voltage rises and while it falls
    rounded_sharpness : shape (k,), c in [0, 1]: how sharply a stop bends into its limit
    rounded_unloading : shape (k,), ρ ≥ 0: how much steeper a stop unloads than it begins to load
    rounded_um_per_v : shape (k,)
    lag_s : time constant of amplifier and actuator, before the hysteresis

    Raises ValueError when the arrays do not fit each other or the model could not be inverted.
    """

    thresholds_v: Array
    knots_v: Array
    slopes_um_per_v: Array
    creep_plays: NDArray[np.int64]
    time_constants_s: Array
    creep_um_per_v: Array
    zero_um: float
    delay_s: float
    low_v: float
    high_v: float
    rounded_limits_v: Array = field(default_factory=lambda: none_of(0, 2))
    rounded_sharpness: Array = field(default_factory=lambda: none_of(0))
    rounded_unloading: Array = field(default_factory=lambda: none_of(0))
    rounded_um_per_v: Array = field(default_factory=lambda: none_of(0))
    lag_s: float = 0.0

    def __post_init__(self) -> None:
        for problem in _problems(self):
            raise ValueError(problem)

    def predict(self, t_s: Array, u_v: Array, state: ActuatorState | None = None) -> Array:
        """Displacement in µm, shape (n,), for a voltage that was applied from `state` on, which stays as it is.

        t_s, u_v : shape (n,); time strictly ascending, every turning point of the voltage a sample
        state : default: conditioned, come to the first voltage as its first move shows

        Raises ValueError for arrays that are not one-dimensional, equally long, finite, or whose time runs back.
        """
        times_s, volts = consecutive(t_s, u_v)
        if not len(times_s):
            return np.empty(0)
        start = self.starting_state(times_s, volts) if state is None else state
        y_um = self.advance(start.copy(), times_s, volts)
        return np.interp(times_s - self.delay_s, times_s, y_um) if self.delay_s > 0.0 else y_um

    def own_state(self, state: ActuatorState | None) -> ActuatorState:
        """Return a copy of `state` (default: conditioned, at the low end). Raises ValueError for another model's."""
        if state is None:
            return ActuatorState.conditioned(self)
        state.memory(self)
        return state.copy()

    def starting_state(self, t_s: Array, u_v: Array, previous_v: float | None = None) -> ActuatorState:
        """State at the first sample of a voltage, shape (n,) each.

        previous_v : what the actuator was held at before. None: it had been cycling over the model's range and
        comes from the end that the voltage's first move leads away from.
        """
        first_v = float(u_v[0])
        if previous_v is not None:
            state = ActuatorState.after_jump(self, previous_v, first_v)
        else:
            moved = np.abs(u_v - first_v) > 0.02 * (self.high_v - self.low_v)
            falls = bool(moved.any() and u_v[int(moved.argmax())] < first_v)
            state = ActuatorState.conditioned(self, first_v, falling=falls)
        state.t_s = float(t_s[0])
        return state

    def advance(self, state: ActuatorState, t_s: Array, u_v: Array) -> Array:
        """Advance `state` in place; return the displacement without delay, µm, shape (n,).

        Raises ValueError as `predict`, and for the state of another model; `state` stays as it was then.
        """
        return self.advance_checked(state, *consecutive(t_s, u_v, state.t_s))

    def advance_checked(self, state: ActuatorState, times_s: Array, volts: Array) -> Array:
        """Do the same with what `consecutive` has returned."""
        memory, output = state.memory(self), np.empty(len(times_s))
        places = times_s.ctypes.data, volts.ctypes.data, address_of(output)
        library().bank_advance(byref(self.bank), byref(memory), len(times_s), *places)
        state.move_to(memory)
        output += self.zero_um
        return output

    def at_once_um(self, state: ActuatorState, u_v: float) -> float:
        """Return where a voltage brings the actuator at once, behind the lag and before any creep; the state stays.

        Raises ValueError for the state of another model.
        """
        y_um = self.without_lag.advance(state.copy(), np.array([state.t_s]), np.array([u_v]))
        return float(y_um[0])

    @cached_property
    def bank(self) -> Bank:
        """Return the parameters as the library takes them."""
        return Bank(
            self.thresholds_v,
            self.knots_v,
            self.slopes_um_per_v,
            self.rounded,
            self.rounded_um_per_v,
            self.creep_plays,
            self.time_constants_s,
            self.creep_um_per_v,
            self.lag_s,
        )

    @cached_property
    def rounded(self) -> Array:
        """Rounded plays as the library takes them, shape (k, 5)."""
        return rounded_table(self.rounded_limits_v, self.rounded_sharpness, self.rounded_unloading)

    @cached_property
    def without_lag(self) -> ActuatorModel:
        """The same actuator behind an immediate amplifier."""
        return replace(self, lag_s=0.0)

    @cached_property
    def stroke_um(self) -> float:
        """Displacement from trough to crest of a slow full cycle (10 mHz), conditioned, µm."""
        return float(np.ptp(self._slow_cycle_um()))

    @cached_property
    def gain_um_per_v(self) -> float:
        """Mean slope over the range, µm/V."""
        return self.stroke_um / (self.high_v - self.low_v)

    @cached_property
    def loop_width(self) -> float:
        """Distance of the branches of a slow full cycle at the middle of the range, over the stroke."""
        rising_um, falling_um = self._slow_cycle_um()[[CYCLE_SAMPLES // 4, 3 * CYCLE_SAMPLES // 4]]
        return float(falling_um - rising_um) / self.stroke_um

    @cached_property
    def gamma_per_decade(self) -> float:
        """Creep after a step over the range, per decade of time, relative to the displacement at 0.1 s."""
        if not self.creep_um_per_v.any():
            return 0.0
        times_s = np.array([CREEP_FROM_S, CREEP_TO_S])
        actuator = self.without_lag  # a lag takes a step of 0.1 s as a straight way
        state = ActuatorState.conditioned(actuator)
        start_um = actuator.at_once_um(state, self.low_v)
        actuator.advance(state, np.array([0.0]), np.array([self.high_v]))
        first_um, last_um = actuator.advance(state, times_s, np.full(2, self.high_v))
        decades = float(np.log10(CREEP_TO_S / CREEP_FROM_S))
        return float((last_um - first_um) / (first_um - start_um)) / decades

    def _slow_cycle_um(self) -> Array:
        """Second of two straight full cycles at 10 mHz from rest at the low end, shape (CYCLE_SAMPLES,)."""
        t_s: Array = np.arange(2.0 * CYCLE_SAMPLES) * (SLOW_CYCLE_S / CYCLE_SAMPLES)
        swing = 1.0 - np.abs(1.0 - 2.0 * (t_s / SLOW_CYCLE_S % 1.0))
        u_v: Array = self.low_v + (self.high_v - self.low_v) * swing
        return self.advance(ActuatorState.conditioned(self), t_s, u_v)[CYCLE_SAMPLES:]


def rounded_table(limits_v: Array, sharpness: Array, unloading: Array) -> Array:
    """Rising and falling limit, c, ρ and the steepest that each stop can rise, shape (k, 5)."""
    farthest = limits_v.max(axis=1) / limits_v.min(axis=1)
    steepest = 1.0 + unloading * ((1.0 - sharpness) * farthest + sharpness * farthest**2)
    return np.column_stack([limits_v, sharpness, unloading, steepest])


def _problems(model: ActuatorModel) -> list[str]:
    """Return the violated requirements of a model."""
    thresholds, knots, slopes = model.thresholds_v, model.knots_v, model.slopes_um_per_v
    taus, creep, plays = model.time_constants_s, model.creep_um_per_v, model.creep_plays
    limits, roundness = model.rounded_limits_v, model.rounded_um_per_v
    sharpness, unloading = model.rounded_sharpness, model.rounded_unloading
    n, m, k = len(thresholds), slopes.shape[-1], len(roundness)
    arrays = (thresholds, knots, slopes, taus, creep, limits, sharpness, unloading, roundness)
    shapes = ((n,), (n, m + 1), (n, m), (len(taus),), (len(plays), len(taus)), (k, 2), (k,), (k,), (k,))
    if n == 0 or m == 0 or any(a.shape != shape for a, shape in zip(arrays, shapes, strict=True)):
        return ["the arrays of the model do not fit each other"]
    scalars = (model.zero_um, model.delay_s, model.low_v, model.high_v, model.lag_s)
    if not all(np.isfinite(a).all() for a in (*arrays, scalars)):
        return ["the model holds numbers that are not finite"]
    checks = (
        (thresholds[0] == 0.0 and np.diff(thresholds) > 0, "thresholds ascend from 0"),
        (np.diff(knots, axis=1) > 0, "the knots of a play ascend"),
        (slopes >= 0, "slopes are not negative"),
        (slopes[0] > 0, "the play of threshold 0 has positive slopes"),
        (taus > 0, "time constants are positive"),
        (creep >= 0, "creep is not negative"),
        ((plays >= 0) & (plays < n + k), "creep follows plays of the model"),
        (limits > 0, "limits of rounded plays are positive"),
        ((sharpness >= 0) & (sharpness <= 1), "the sharpness of a rounded play is 0 to 1"),
        ((unloading >= 0) & (roundness >= 0), "rounded plays are not negative"),
        (model.lag_s >= 0.0, "the lag is not negative"),
        (model.delay_s >= 0.0, "the delay is not negative"),
        (model.low_v < model.high_v, "low_v lies below high_v"),
    )
    return [f"a model needs: {rule}" for holds, rule in checks if not np.all(holds)]


@dataclass(slots=True)
class ActuatorState:
    """State of an `ActuatorModel`; arrays change in place.

    plays_v : shape (n,)
    lags_v : shape (g, j), creep: each lag follows the play it belongs to
    stops_v : shape (k,), stops of the rounded plays
    u_v, lagged_v, t_s : voltage applied last, what of it has come through the lag, and when
    """

    plays_v: Array
    lags_v: Array
    stops_v: Array
    u_v: float
    lagged_v: float
    t_s: float = 0.0

    @classmethod
    def virgin(cls, model: ActuatorModel, u_v: float = 0.0) -> ActuatorState:
        """Never driven before, resting at `u_v`: the next rise follows the initial loading curve."""
        return cls._relaxed(model, (u_v,))

    @classmethod
    def conditioned(
        cls, model: ActuatorModel, u_v: float | None = None, *, falling: bool = False
    ) -> ActuatorState:
        """Cycled over the model's range, then brought to `u_v` (default: the low end) and long at rest.

        It came up from the low end, or with `falling` down from the high one.
        """
        ends = (model.high_v, model.low_v) if falling else (model.low_v, model.high_v)
        rest_v = model.low_v if u_v is None else u_v
        return cls._relaxed(model, (rest_v, *ends, *ends, ends[0], rest_v))

    @classmethod
    def after_jump(cls, model: ActuatorModel, from_v: float, to_v: float) -> ActuatorState:
        """Held at `from_v`, then brought to `to_v` in one move; creep has followed the move."""
        return cls._relaxed(model, (from_v, to_v))

    def memory(self, model: ActuatorModel) -> Memory:
        """Return the state as the library takes it, over the same arrays.

        Raises ValueError for the state of another model.
        """
        arrays = (self.plays_v, self.stops_v, self.lags_v)
        return Memory(model.bank, arrays, self.t_s, self.u_v, self.lagged_v)

    def move_to(self, memory: Memory) -> None:
        """Take time and voltages of a memory over the arrays of this state."""
        self.t_s, self.u_v, self.lagged_v = memory.t_s, memory.u_v, memory.lagged_v

    def copy(self) -> ActuatorState:
        """Return an independent copy."""
        arrays = self.plays_v.copy(), self.lags_v.copy(), self.stops_v.copy()
        return ActuatorState(*arrays, self.u_v, self.lagged_v, self.t_s)

    @classmethod
    def _relaxed(cls, model: ActuatorModel, turns: Sequence[float]) -> ActuatorState:
        """At rest where it is after the voltage has gone from the first turn to the last; virgin at the first."""
        plays_v, stops_v = np.full(model.thresholds_v.shape, turns[0]), np.zeros(len(model.rounded_um_per_v))
        for u_v in turns:
            plays_v = np.clip(plays_v, u_v - model.thresholds_v, u_v + model.thresholds_v)
        if len(stops_v):
            rounded, way_v = np.ascontiguousarray(model.rounded), np.array(turns, dtype=np.float64)
            library().turned_stops(
                len(stops_v), rounded.ctypes.data, len(way_v), way_v.ctypes.data, address_of(stops_v)
            )
        rest_v = turns[-1]
        standing_v = np.concatenate([plays_v, model.rounded[:, -1] * rest_v - stops_v])
        lags_v = np.repeat(standing_v[model.creep_plays, np.newaxis], len(model.time_constants_s), axis=1)
        return cls(plays_v, lags_v, stops_v, rest_v, rest_v)


def consecutive(t_s: ArrayLike, values: ArrayLike, since_s: float = -math.inf) -> tuple[Array, Array]:
    """Return times and values as float64 arrays of shape (n,), row after row in memory.

    Raises ValueError unless both are one-dimensional, equally long and finite, and time runs forwards from
    `since_s` on.
    """
    times, numbers = _line(t_s), _line(values)
    if times.ndim != 1 or times.shape != numbers.shape:
        raise ValueError(
            f"times of shape {times.shape} and values of shape {numbers.shape}: (n,) each is needed"
        )
    if not (np.isfinite(times).all() and np.isfinite(numbers).all()):
        raise ValueError("times and values are finite numbers")
    if len(times) and (times[0] < since_s - CLOCK_ROUNDING_S or bool((times[1:] < times[:-1]).any())):
        raise ValueError(f"time runs forwards, here from {since_s:g} s on")
    return times, numbers


def _line(values: ArrayLike) -> Array:
    return np.ascontiguousarray(np.asarray(values, dtype=np.float64))


class Estimator:
    """Follows one actuator: Z = gain · y(voltage) + offset, from a copy of `state` (default: conditioned, low end).

    Feed it every turning point of the voltage really applied: samples that skip one leave the plays where the
    samples went, not where the actuator did. Only trusted events may change `gain` and `offset_um` (`correction`).
    """

    def __init__(self, model: ActuatorModel, state: ActuatorState | None = None) -> None:
        self.model = model
        self.state = model.own_state(state)
        self.gain, self.offset_um = 1.0, 0.0
        self._passed_s, self._passed_um = np.empty(0), np.empty(0)
        """Samples that reach one delay into the past, without that delay."""

    def correct(self, gain: float, offset_um: float) -> None:
        """Set the two slow parameters. Raises ValueError unless they are finite and the gain is positive."""
        if not (0.0 < gain < math.inf and math.isfinite(offset_um)):
            raise ValueError(f"a gain is positive and finite, a zero is finite: {gain}, {offset_um}")
        self.gain, self.offset_um = gain, offset_um

    def creep_um(self, slower_than_s: float) -> float:
        """Return how much of the displacement is creep with time constants above `slower_than_s`, µm."""
        slow = self.model.time_constants_s > slower_than_s
        return self.gain * float(np.sum(self.model.creep_um_per_v[:, slow] * self.state.lags_v[:, slow]))

    def tick(self, u_v: float, dt_s: float) -> float:
        """Displacement in µm when the voltage is `u_v`, `dt_s` after the last sample; raises as `advance`."""
        t_s, volts = np.array([self.state.t_s + dt_s], np.float64), np.array([u_v], np.float64)
        if self.model.delay_s == 0.0 and 0.0 <= dt_s < math.inf and math.isfinite(u_v):  # the usual, fast way
            return self.gain * float(self.model.advance_checked(self.state, t_s, volts)[0]) + self.offset_um
        return float(self.advance(t_s, volts)[0])

    def advance(self, t_s: Array, u_v: Array) -> Array:
        """Displacement in µm, shape (n,), at consecutive samples; time runs on from the last one.

        Raises ValueError, and stays as it was, as `ActuatorModel.predict` does.
        """
        t_s, u_v = consecutive(t_s, u_v, self.state.t_s)
        y_um: Array = self.model.advance_checked(self.state, t_s, u_v)
        if self.model.delay_s > 0.0 and len(t_s):
            times_s = np.concatenate([self._passed_s, t_s])
            values_um = np.concatenate([self._passed_um, y_um])
            wanted_s = t_s - self.model.delay_s
            kept = max(0, int(np.searchsorted(times_s, wanted_s[-1], side="right")) - 1)
            self._passed_s, self._passed_um = times_s[kept:], values_um[kept:]
            y_um = np.interp(wanted_s, times_s, values_um)
        return self.gain * y_um + self.offset_um
