"""The waveforms of `simulate actuator`, checked and sampled at the virtual actuator's tick."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from edmctl import failures
from edmctl.actuator import waveforms as waves
from edmctl.actuator.waveforms import FIGURE_NAMES, Leg, figure_command, jump_train, sampled, servo_dither
from edmctl.array_types import Array, Flags
from edmctl.dataclasses import dataclass
from edmctl.record.columns import TIME, VOLTAGE, read_columns
from edmctl.simulator import actuator
from edmctl.simulator.actuator import RATE_HZ, SLEW_V_S

LOW_V, HIGH_V = 0.0, 120.0
"""The range of Muralidhara et al. 2009, Figs 3–5."""
FREQUENCY_HZ, CYCLES = 1.0, 5
SLOW_HZ, SLOW_CYCLES = 0.01, 2
STEP_HOLD_S = 60.0
FIGURES = "figures"
"""All figures of the paper that show waveforms."""
LONGEST_S = 1800.0
"""Half an hour takes about 200 MB, and briefly 1 GB if it is written as CSV."""
_PERIODIC: dict[str, tuple[Callable[[float, float, float, int, float], waves.Waveform], float]] = {
    "sine": (waves.sine, math.pi),
    "triangle": (waves.triangle, 2.0),
    "square": (waves.square, 2.0),
}
"""Steepest slope over range and frequency; a square wave's edges must fit into its period."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """The options of the command line; None if not given."""

    shape: str
    frequency_hz: float | None
    low_v: float | None
    high_v: float | None
    cycles: int | None
    source: Path | None


class Waveform(NamedTuple):
    """A name and the voltage for every millisecond, shape (n,); `figure` is the paper's figure that shows it."""

    name: str
    command_v: Array
    figure: str = ""


def waveforms(wanted: Wanted) -> list[Waveform]:
    """Return the requested waveforms: one, or several for `all`."""
    shape = wanted.shape
    _refuse_misplaced(wanted)
    if shape == FIGURES or shape in FIGURE_NAMES:
        names = FIGURE_NAMES if shape == FIGURES else [shape]
        return [Waveform(FIGURE_NAMES[name], figure_command(name, RATE_HZ), name) for name in names]
    if wanted.source:
        return [Waveform(wanted.source.name, command_from(wanted.source, LONGEST_S))]
    low_v = LOW_V if wanted.low_v is None else wanted.low_v
    high_v = HIGH_V if wanted.high_v is None else wanted.high_v
    least_v, most_v = actuator.LOW_V, actuator.HIGH_V
    if not least_v <= low_v < high_v <= most_v:
        raise failures.waveform_voltages_out_of_range(
            low_v=low_v, high_v=high_v, least_v=least_v, most_v=most_v
        )
    if shape in _PERIODIC:
        frequency_hz = FREQUENCY_HZ if wanted.frequency_hz is None else wanted.frequency_hz
        return [_periodic(shape, low_v, high_v, frequency_hz, wanted.cycles or CYCLES)]
    step = [Leg(high_v, (high_v - low_v) / SLEW_V_S), Leg(high_v, STEP_HOLD_S)]
    chains: dict[str, Callable[[], waves.Waveform]] = {
        "step": lambda: sampled(step, RATE_HZ, low_v),
        "jumps": lambda: jump_train(low_v, high_v, RATE_HZ),
        "servo": lambda: servo_dither(low_v, high_v, RATE_HZ),
    }
    if shape in chains:
        return [Waveform(shape, chains[shape]().u_v)]
    return [
        _periodic("sine", low_v, high_v, SLOW_HZ, SLOW_CYCLES),
        _periodic("sine", low_v, high_v, FREQUENCY_HZ, CYCLES),
        *(Waveform(name, make().u_v) for name, make in chains.items()),
    ]


def _periodic(shape: str, low_v: float, high_v: float, frequency_hz: float, cycles: int) -> Waveform:
    if not frequency_hz > 0.0 or cycles / frequency_hz > LONGEST_S:
        raise failures.waveform_too_slow(
            cycles=cycles, frequency_hz=frequency_hz, longest_s=LONGEST_S, least_hz=cycles / LONGEST_S
        )
    make, steepness = _PERIODIC[shape]
    fastest_hz = SLEW_V_S / (steepness * (high_v - low_v))
    if frequency_hz > fastest_hz:
        raise failures.waveform_too_fast(
            waveform=shape,
            range_v=high_v - low_v,
            frequency_hz=frequency_hz,
            slew_v_s=SLEW_V_S,
            most_hz=math.floor(1e3 * fastest_hz) / 1e3,
        )
    return Waveform(f"{shape} {frequency_hz:g} Hz", make(low_v, high_v, frequency_hz, cycles, RATE_HZ).u_v)


def _refuse_misplaced(wanted: Wanted) -> None:
    """Refuse options that the waveform does not use."""
    periodic: dict[str, object] = {"--frequency": wanted.frequency_hz, "--cycles": wanted.cycles}
    ranged: dict[str, object] = {"--low": wanted.low_v, "--high": wanted.high_v}
    if wanted.shape == FIGURES or wanted.shape in FIGURE_NAMES:
        unused = {**periodic, **ranged, "--from": wanted.source}
        reason = "its voltage is that of the paper"
    elif wanted.shape == "csv":
        if wanted.source is None:
            raise failures.waveform_file_missing()
        unused, reason = {**periodic, **ranged}, "the file says all of the voltage"
    else:
        unused, reason = {"--from": wanted.source}, "only csv reads a file"
        if wanted.shape not in _PERIODIC and wanted.source is None:
            unused, reason = periodic, "only sine, square and triangle have cycles"
    for option, value in unused.items():
        if value is not None:
            raise failures.waveform_option_unused(option=option, waveform=wanted.shape, reason=reason)


def command_from(path: Path, longest_s: float) -> Array:
    """Return the voltage for every millisecond, shape (n,), interpolated from columns t_s and u_V."""
    import numpy as np

    t_s, u_v = read_columns(path, TIME, VOLTAGE)
    low_v, high_v = actuator.LOW_V, actuator.HIGH_V

    def first(wrong: Flags) -> str:
        row = int(np.argmax(wrong))
        return f"{path}: row {row + 1} ({t_s[row]:g} s, {u_v[row]:g} V)"

    if (wrong := ~(np.isfinite(t_s) & np.isfinite(u_v))).any():
        raise failures.waveform_not_finite(row=first(wrong))
    if (wrong := np.diff(t_s, prepend=-math.inf) <= 0.0).any():
        raise failures.waveform_time_not_ascending(row=first(wrong))
    if (wrong := (u_v < low_v) | (u_v > high_v)).any():
        raise failures.waveform_beyond_actuator(row=first(wrong), low_v=low_v, high_v=high_v)
    length_s = float(t_s[-1] - t_s[0])
    if length_s > longest_s:
        raise failures.waveform_too_long(path=path, length_s=length_s, longest_s=longest_s)
    ticks_s = t_s[0] + np.arange(math.floor(length_s * RATE_HZ + 1e-6) + 1) / RATE_HZ
    return np.asarray(np.interp(ticks_s, t_s, u_v), dtype=np.float64)
