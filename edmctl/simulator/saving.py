"""A virtual bench as plain arrays, numbers and texts, and back: what remains of it when its power is cut.

That is the machine as it is afterwards: work, tool, actuator with its memory, sensors, every random stream. The
controller keeps what a board keeps: its latched fault and black box, and its counts of boots and events.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmctl import failures
from edmctl.core.library import Kept, Record
from edmctl.link.faults import FAULTS
from edmctl.link.messages import ResetCause
from edmctl.simulator.bench import VirtualBench
from edmctl.simulator.config import BenchConfig, DischargeConstants
from edmctl.simulator.controller import Controller
from edmctl.simulator.plant import BLOCK, Plant
from edmctl.simulator.plant_records import BURNING, MOST_PULSES, PATH_LINES
from edmctl.simulator.waveforms import PULSE, PULSE_COLUMNS, SAMPLE_NS, RecentPulses, Waveforms
from edmctl.simulator.work_under_tool import MOST_CELLS, TILE, Hole

State = Mapping[str, Any]
"""Names of arrays, numbers, texts and further states."""

_RECORDS = ("unit", "state", "drive", "readings")
_VALUES = (
    *("serial", "theta_deg", "dielectric_level_ok", "dielectric_flow_lpm", "dielectric_temperature_c"),
    *("estop", "door_open", "limit_switch", "hv_supply_ok", "tool_lost_um", "obstacle_um", "current_factor"),
    "_offset_um",
)
_ARRAYS = ("position_um", "_tilt_mrad")
_RANDOM_ARRAYS = ("pulse", "noise", "tables")
_STREAMS = ("_decide", "_shape", "_delay", "_noise")
_HOLE = tuple(field.name for field in dataclasses.fields(Hole))
_NO_HOLE = -1
_MOST = 1 << 60
"""Whole numbers are smaller than this, so that C can add two of them."""
_UNBOUNDED = ("thickness_um", "obstacle_um", "next_level_um", "rarity")
"""Numbers that may be infinite: what does not exist, or never comes."""
_RANGES: Mapping[str, tuple[float, float]] = {
    "random_at": (0, BLOCK),
    "noise_at": (0, BLOCK),
    "level_at": (0, _MOST),
    "previous_burning": (-1, BURNING - 1),
    "stage_line": (0, PATH_LINES - 1),
    "stage_lines_done": (0, PATH_LINES),
    "pulses": (0, MOST_PULSES),
    "tick": (0, 1 << 40),
    "pulse_period_ns": (1, 1 << 40),
    "gap_exponent": (0, 20),
}
"""Least and greatest value of what the library in C uses as a count or as an index."""


def bench_state(bench: VirtualBench) -> State:
    """Return all that outlives a loss of power now, with every injected fault repaired. The bench itself goes on.

    A tool that is out is retracted first and a controller disarmed, without a fault.
    """
    rest = deepcopy(bench)
    rest.clear_injections()
    if not rest.is_safe:
        rest.controller.reset(ResetCause.POWER_ON)
        rest.settle()
    kept = rest.controller.kept()
    kept.boot_count = bench.controller.boot_count
    return {
        "config": dataclasses.asdict(rest.plant.config),
        "plant": _plant_state(rest.plant),
        "controller": {"kept": _record_state(kept), **_waveform_state(rest.controller.waveforms)},
    }


def restored_bench(state: State) -> VirtualBench:
    """Build the machine of a state; its controller has just been switched on.

    Raises RunFileError E9021 if the state lacks something, or has impossible values.
    """
    try:
        _refuse_not_finite(state)
        plant = _part(state, "plant")
        config = _rebuilt(BenchConfig(), _part(state, "config"))
        if not 0.0 < config.tool_diameter_um < MOST_CELLS * config.cell_um:
            raise ValueError(f"a tool of {config.tool_diameter_um} µm over cells of {config.cell_um} µm")
        bench = VirtualBench(config, seed=0)
        for name in _RECORDS:
            _restore_record(getattr(bench.plant, name), _part(plant, name))
        _restore_plant(bench.plant, plant)
        _restore_controller(bench.controller, _part(state, "controller"))
    except (KeyError, IndexError, TypeError, ValueError, ArithmeticError, MemoryError) as error:
        raise failures.saved_bench_does_not_fit(kind=type(error).__name__, error=error) from error
    bench.controller.reset(ResetCause.POWER_ON)
    bench.controller.link.take_output()  # no host was there
    return bench


def _refuse_not_finite(state: State) -> None:
    """Raise ValueError for an infinite number or NaN. Readings of the machine may be: no sensor, no pulse."""
    for name, value in state.items():
        if name == "readings" or (name in _UNBOUNDED and value == np.inf):
            continue
        if isinstance(value, Mapping):
            _refuse_not_finite(value)
        elif isinstance(value, float | np.ndarray) and not np.all(np.isfinite(value)):
            raise ValueError(f"{name} is not finite")


def _rebuilt(usual: Any, state: State) -> Any:
    """Return a dataclass like `usual` with the values of a state.

    Raises KeyError, TypeError, OverflowError for a field that lacks, is not known or is of another kind.
    """
    values = {}
    for field in dataclasses.fields(usual):
        known, value = getattr(usual, field.name), state[field.name]
        if dataclasses.is_dataclass(known):
            value = _rebuilt(known, _part(state, field.name))
        elif isinstance(known, float) and type(value) in (int, float):
            value = float(value)
        elif isinstance(known, bool) and value in (0, 1):
            value = bool(value)
        elif type(value) is not type(known):
            raise TypeError(f"{field.name} is of another kind")
        values[field.name] = value
    if unknown := state.keys() - values.keys():
        raise TypeError(f"{', '.join(unknown)} is not known")
    return type(usual)(**values)


def _record_state(record: Record) -> State:
    return {"numbers": record.numbers(), **record.arrays()}


def _restore_record(record: Record, state: State) -> None:
    numbers = _part(state, "numbers")
    for field, present in record.numbers().items():
        number: float = numbers[field]
        whole = (-_MOST, _MOST) if isinstance(present, int) else None
        if (within := _RANGES.get(field, whole)) and not within[0] <= number <= within[1]:
            raise ValueError(f"{field} is {number}")
        setattr(record, field, number)
    for field in record.arrays():
        _fill(record.array(field), state[field])


def _plant_state(plant: Plant) -> State:
    holes, ground, random = plant.work_under_tool.true_holes(), plant.work_under_tool, plant.random
    ground.settle()
    tiles = ground.work.tiles
    state: dict[str, Any] = {name: _record_state(getattr(plant, name)) for name in _RECORDS}
    for name in _VALUES:
        value = getattr(plant, name)
        state[name] = int(value) if isinstance(value, bool) else value
    state |= {name: getattr(plant, name).copy() for name in _ARRAYS}
    rows = [[getattr(hole, name) for name in _HOLE] for hole in holes]
    return state | {
        "discharge": dataclasses.asdict(plant.discharge),
        "reported": np.array(plant.reported),
        "holes": np.array(rows, dtype=np.float64).reshape(-1, len(_HOLE)),
        "here": next((i for i, hole in enumerate(holes) if hole is ground.here), _NO_HOLE),
        "tile_at": np.array(list(tiles), dtype=np.int64).reshape(-1, 2),
        "tiles": np.array(list(tiles.values()), dtype=np.float64).reshape(-1, TILE, TILE),
        "tools_worn_um": dict(plant.tools_worn_um),
        "stage_noise": _stream_text(plant._stage_noise),
        "random": {name: getattr(random, name).copy() for name in _RANDOM_ARRAYS}
        | {name: _stream_text(getattr(random, name)) for name in _STREAMS},
    }


def _restore_plant(plant: Plant, state: State) -> None:
    for name in _VALUES:
        setattr(plant, name, type(getattr(plant, name))(state[name]))
    for name in _ARRAYS:
        _fill(getattr(plant, name), state[name])
    plant.reported = [float(value) for value in np.asarray(state["reported"])]
    plant.discharge = _rebuilt(DischargeConstants(), _part(state, "discharge"))
    ground = plant.work_under_tool
    ground.holes = []
    for x_um, y_um, depth_um, through, *surface in np.asarray(state["holes"]).tolist():
        ground.holes.append(Hole(x_um, y_um, depth_um, bool(through), *surface))
    ground.work.tiles = {}
    for at, cells in zip(np.asarray(state["tile_at"]).tolist(), np.asarray(state["tiles"]), strict=True):
        column, row = map(int, at)
        ground.work.tiles[column, row] = tile = np.zeros((TILE, TILE))
        _fill(tile, cells)
    ground.arrive(*map(float, plant.position_um))
    here = state["here"]
    if not isinstance(here, int):
        raise TypeError("here is not a whole number")
    ground.here = None if here == _NO_HOLE else ground.holes[here]
    worn = _part(state, "tools_worn_um")
    if not all(isinstance(worn_um, float) for worn_um in worn.values()):
        raise TypeError("the wear of a tool is not a number")
    plant.tools_worn_um = dict(worn)
    _restore_stream(plant._stage_noise, state["stage_noise"])
    random = _part(state, "random")
    for name in _RANDOM_ARRAYS:
        _fill(getattr(plant.random, name), random[name])
    shapes = plant.random.pulse[1]
    if not np.all((shapes >= 0.0) & (shapes < 1.0)):
        raise ValueError("a random number is outside of its range")
    for name in _STREAMS:
        _restore_stream(getattr(plant.random, name), random[name])


def _waveform_state(waveforms: Waveforms) -> State:
    """Return the pulses about a latched fault; none without one."""
    pulses = waveforms.frozen
    if pulses is None:
        return {"waveform_pulses": np.zeros((0, len(PULSE_COLUMNS)))}
    return {
        "waveform_pulses": pulses.rows.view(np.float64).reshape(-1, len(PULSE_COLUMNS)),
        "waveform_times_ns": np.array([pulses.fault_ns, pulses.period_ns, waveforms.boot_ns], dtype=np.int64),
        "waveform_generator": np.array([pulses.open_v, pulses.on_time_us]),
    }


def _restore_controller(controller: Controller, state: State) -> None:
    kept = Kept()
    _restore_record(kept, _part(state, "kept"))
    if kept.fault and kept.fault not in FAULTS:
        raise ValueError(f"{kept.fault} is not a fault")
    controller.take_up(kept)
    if "waveform_times_ns" in state:
        _restore_waveforms(controller.waveforms, state)
    if kept.waves_frozen and not kept.waves_empty:
        pulses = controller.waveforms.frozen
        window_ns = (kept.waves_begin_ns, kept.waves_end_ns)
        if pulses is None or controller.waveforms.window_ns(pulses) != window_ns:
            raise ValueError("the waveforms are not those of the fault")


def _restore_waveforms(waveforms: Waveforms, state: State) -> None:
    times_ns, generator = np.zeros(3, dtype=np.int64), np.zeros(2)
    _fill(times_ns, state["waveform_times_ns"])
    _fill(generator, state["waveform_generator"])
    rows = np.zeros((len(np.asarray(state["waveform_pulses"])), len(PULSE_COLUMNS)))
    _fill(rows, state["waveform_pulses"])
    start_ns = rows[:, PULSE_COLUMNS.index("start_ns")]
    fault_ns, period_ns, waveforms.boot_ns = times_ns.tolist()
    oldest_ns = fault_ns - waveforms.memory * SAMPLE_NS
    ascend = len(rows) == 0 or (oldest_ns <= start_ns[0] and np.all(np.diff(start_ns) > 0.0))
    if not (ascend and np.all(np.abs(times_ns) < _MOST) and period_ns > 0):
        raise ValueError("the pulses of the waveforms are impossible")
    open_v, on_time_us = generator.tolist()
    waveforms.frozen = RecentPulses(rows.view(PULSE)[:, 0], fault_ns, period_ns, open_v, on_time_us)


def _part(state: State, name: str) -> State:
    part = state[name]
    if not isinstance(part, Mapping):
        raise TypeError(f"{name} is not a group")
    return part


def _fill(array: NDArray[np.generic], values: object) -> None:
    new = np.asarray(values)
    if new.shape != array.shape:
        raise ValueError(f"an array has shape {new.shape}, not {array.shape}")
    array[...] = new


def _stream_text(stream: np.random.Generator) -> str:
    return json.dumps(stream.bit_generator.state, default=lambda array: array.tolist())


def _restore_stream(stream: np.random.Generator, text: object) -> None:
    if not isinstance(text, str):
        raise TypeError("the state of a random stream is not a text")
    stream.bit_generator.state = json.loads(text)
