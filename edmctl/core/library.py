"""The compiled library, called by ctypes: its functions, and the records that host.h shares with them."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import (
    CFUNCTYPE,
    POINTER,
    c_bool,
    c_char_p,
    c_double,
    c_int,
    c_int16,
    c_int64,
    c_size_t,
    c_uint16,
    c_uint32,
    c_void_p,
)
from functools import cache, partial
from typing import Any

from edmctl.array_types import Array
from edmctl.core.build import Build, built, failed, found
from edmctl.core.records import RECORD_BYTES, Record, record, series

PACK = 12
"""Bits of each count in `Seen.tick_counts`."""
BOX_TICKS = 2048
"""Milliseconds of the black box."""
SAMPLES_BYTES = 262144
"""Room for the merged samples of an advance; it ends when half of it is full."""


@record
class Inputs(Record):
    """What the core reads of interlocks and slow readings; the caller writes it."""

    estop: int
    door_open: int
    hv_supply_ok: int
    level_ok: int
    limit_switch: int
    flow_lpm: float
    temperature_c: float
    monitor_v: float


@record
class Seen(Record):
    """What is in the core; every call renews it, but those of the tick."""

    tick: int
    boot_tick: int
    state: int
    armed: int
    fault: int
    boot_count: int
    frozen_tick: int
    watchdog_ticks: int
    param_crc: int
    mode: int
    tick_counts: int  # pulses of the last millisecond: open, normal, arcs, shorts, PACK bits each
    pulse_no: int
    tlm_next: int
    scanning: int
    command_v: float
    displacement_um: float
    slow_displacement_um: float
    gap_v: float
    rx_bad: int
    rx_drop: int
    rx_frames: int
    urgent: int
    due: int
    advanced: int
    advancing: int
    advance_us: int
    reboot_asked: int
    arms: int
    touch_offs: int
    out_bytes: int
    lost_frames: int
    session: int
    zero_um: float
    interlocks: int
    pulses_allowed: int
    pulse_period_ns: int
    duty_v: float
    sensor_fitted: int
    watched: int  # written by the caller: the host waits, and is heard without heartbeats
    merges: int  # written by the caller: samples are taken from `samples_at`, without frames
    sample_bytes: int


@record
class Merged(Record):
    """Head of consecutive TLM frames of one period without a gap; their records follow."""

    counter: int  # of the last frame
    t0_us: int
    period_us: int
    samples: int
    dropped: int
    frames: int


@record
class Kept(Record):
    """What outlives a loss of power: latched fault, counters and the black box, a ring of BOX_TICKS milliseconds."""

    fault: int
    event_no: int
    boot_count: int
    boot_tick: int
    since_tick: int
    frozen: int
    frozen_tick: int
    frozen_boot_tick: int
    flags: int
    waves_frozen: int
    waves_empty: int
    waves_begin_ns: int
    waves_end_ns: int
    waves_boot_ns: int
    displacement_um: Array = series(BOX_TICKS)
    actuator_v: Array = series(BOX_TICKS)
    gap_v: Array = series(BOX_TICKS)
    charge_uc: Array = series(BOX_TICKS)
    opens: Array = series(BOX_TICKS)
    normals: Array = series(BOX_TICKS)
    arcs: Array = series(BOX_TICKS)
    shorts: Array = series(BOX_TICKS)
    states: Array = series(BOX_TICKS)
    all_flags: Array = series(BOX_TICKS)


CALLBACKS: dict[str, Any] = {
    "set_generator": CFUNCTYPE(c_double, c_double, c_double, c_double, c_double, c_double),
    "stage_stop": CFUNCTYPE(None, c_int64, c_double),
    "path_begin": CFUNCTYPE(None),
    "path_line": CFUNCTYPE(None, c_int64),
    "path_end": CFUNCTYPE(None),
    "wave_memory": CFUNCTYPE(c_int64),
    "wave_keep": CFUNCTYPE(None),
    "wave_forget": CFUNCTYPE(None, c_int64),
    "wave_read": CFUNCTYPE(None, c_int64, c_int64, POINTER(c_int16)),
    "follow": CFUNCTYPE(None, c_int64),
    "due": CFUNCTYPE(c_int64),
}


class Callbacks(ctypes.Structure):
    """What the core asks of the machine's model, between ticks."""

    _fields_ = list(CALLBACKS.items())


_FUNCTIONS: dict[str, tuple[Any, Sequence[Any]]] = {
    "size": (c_size_t, ()),
    "inputs_at": (c_size_t, ()),
    "seen_at": (c_size_t, ()),
    "out_at": (c_size_t, ()),
    "last_samples_at": (c_size_t, ()),
    "samples_at": (c_size_t, ()),
    "real_bytes": (c_int, ()),
    "schema_hash": (c_uint32, ()),
    "bind": (None, (c_void_p, c_void_p, c_void_p, POINTER(Callbacks))),
    "create": (None, (c_void_p, c_char_p, POINTER(c_double))),
    "set": (None, (c_void_p, c_int, c_uint32, c_int, c_double)),
    "receive": (c_size_t, (c_void_p, c_char_p, c_size_t)),
    "line_read": (None, (c_void_p,)),
    "advanced": (None, (c_void_p,)),
    "taken": (None, (c_void_p,)),
    "heard": (None, (c_void_p,)),
    "count_from": (None, (c_void_p, c_int64, c_uint16, c_uint32, c_uint32, c_uint32)),
    "fault": (None, (c_void_p, c_int, c_int)),
    "reset": (None, (c_void_p, c_int)),
    "keep": (None, (c_void_p, c_void_p)),
    "take_up": (None, (c_void_p, c_void_p)),
}


_PLANT: dict[str, tuple[Any, Sequence[Any]]] = {
    "machine_run": (c_int64, (c_int64, c_void_p, c_void_p)),
    "machine_advance": (None, (c_int64, c_bool, c_int64, c_void_p, c_void_p)),
    "plant_run": (c_bool, (c_void_p,)),
    "plant_tick": (c_bool, (c_void_p,)),
    "plant_follow": (c_bool, (c_void_p,)),
    "actuator_run": (c_double, (c_void_p, c_int64, c_void_p, *3 * [c_double], *3 * [c_void_p])),
    "actuator_tick": (None, (c_void_p, c_void_p, c_double)),
    "pump": (None, (c_void_p, c_void_p, c_double)),
    "renew_clearing": (None, (c_void_p, c_void_p)),
    "strike_pulses": (None, (c_void_p,)),
    "pulse_signals": (None, (c_int64, c_void_p, *5 * [c_double], *2 * [c_void_p])),
    "work_look": (c_double, (c_void_p, *6 * [c_double])),
    "work_tabulate": (c_int64, (c_void_p, c_double, c_void_p, c_int64, *2 * [c_void_p])),
    "work_sink": (None, (c_void_p, c_double, c_double)),
}

_OPERATORS: dict[str, tuple[Any, Sequence[Any]]] = {
    "bank_room": (c_int64, (c_void_p,)),
    "bank_advance": (None, (*2 * [c_void_p], c_int64, *3 * [c_void_p])),
    "bank_features": (None, (*2 * [c_void_p], c_int64, *3 * [c_void_p], c_int64, c_void_p)),
    "bank_solve": (None, (*2 * [c_void_p], c_int64, *2 * [c_void_p], *2 * [c_double], *2 * [c_void_p])),
    "turned_stops": (None, (c_int64, c_void_p, c_int64, *2 * [c_void_p])),
    "maxwell_loads": (None, (c_void_p, *2 * [c_double], c_int64, *2 * [c_void_p])),
    "maxwell_positions": (None, (c_void_p, *2 * [c_double], c_int64, *2 * [c_void_p])),
    "pow": (c_double, (c_double, c_double)),
    **{name: (c_double, (c_double,)) for name in ("exp", "log", "sin", "cos")},
    "transducer_advance": (None, (*3 * [c_void_p], c_int64, *5 * [c_void_p])),
}


class Library:
    """A loaded build: functions by their names in C without `edm_` or `edm_host_`.

    Pointers are addresses as integers, or `byref` of a record. Calls release the interpreter's lock.
    """

    def __init__(self, build: Build) -> None:
        self.build = build
        self.loaded = ctypes.CDLL(str(build.path))
        for prefix, functions in (("edm_host_", _FUNCTIONS), ("edm_", _PLANT | _OPERATORS)):
            for name, (result, arguments) in functions.items():
                function = getattr(self.loaded, f"{prefix}{name}")
                function.restype, function.argtypes = result, list(arguments)
                setattr(self, name, function)
        self.plant_run_at: int = ctypes.cast(self.loaded.edm_plant_run, c_void_p).value or 0
        self.loaded.edm_sources.restype = c_char_p
        if (sources := self.loaded.edm_sources()) != build.sources.encode():
            raise OSError(f"it was built from other sources ({sources!r})")
        self.loaded.edm_records.restype = c_char_p
        said = self.loaded.edm_records().decode().split()
        compiled = dict(zip(said[::2], map(int, said[1::2]), strict=True))
        if other := [name for name, size in RECORD_BYTES.items() if compiled.get(name, size) != size]:
            raise OSError(f"its records {', '.join(other)} have other sizes; run `python -m tools.generate`")

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)


def library(real: str = "double") -> Library:
    """Return the library of that arithmetic, built if need be.

    One that cannot be loaded, such as another system's, is built again. Nothing is deleted: the reason may pass.
    Raises PreconditionError E8093, E8094 as `built` does.
    """
    return loaded(real)


@cache
def loaded(real: str) -> Library:
    """Return the same; every call has its arithmetic, so that a library is looked for and loaded once."""
    reasons = []
    for find in (found, built, partial(built, anew=True)):
        build = find(real)
        try:
            return Library(build)
        except (OSError, AttributeError) as error:
            reasons.append(f"what {build.compiler} made cannot be loaded: {error}")
        if build.is_new:
            break
    raise failed("; ".join(dict.fromkeys(reasons)))
