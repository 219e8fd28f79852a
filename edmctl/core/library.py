"""The compiled library, called by ctypes: its functions, and the records that Python and C share.

Each name and type of a record is declared once, by a class with annotations, and laid out in memory as in C:

    @record
    class Tool(Record):
        length_um: float
        sites: int
        wear_um: Array = series(16)

Python reads and writes plain attributes. The headers in firmware/ are made from the declarations (tools/generate).
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from ctypes import CFUNCTYPE, POINTER, c_bool, c_char_p, c_int, c_int16, c_size_t, c_uint16, c_uint32
from ctypes import c_double as double
from ctypes import c_int64 as int64
from ctypes import c_void_p as pointer
from functools import cache, partial
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from edmctl.array_types import Array
from edmctl.core.build import Build, built, failed, found

_KINDS: dict[str, Any] = {"float": ctypes.c_double, "int": ctypes.c_int64}


def series(length: int) -> Any:
    """Declare a field of so many floats."""
    return ctypes.c_double * length


class _Address:
    def __init__(self, declared: str) -> None:
        self.declared = declared


address: Any = _Address
"""Declare a field that is an address: the pointer's type in C, such as `double *`."""


class Record(ctypes.Structure):
    """Named numbers; all are zero at first."""

    pointers: ClassVar[Mapping[str, str]] = {}
    """Types in C of the fields that are addresses."""

    @property
    def place(self) -> int:
        """The address of the record."""
        return ctypes.addressof(self)

    def array(self, name: str) -> Array:
        """A series as an array that shares its memory."""
        return np.ctypeslib.as_array(getattr(self, name))

    def numbers(self) -> dict[str, float]:
        """Every single number by its name, in order."""
        return {name: getattr(self, name) for name, kind, *_ in self._fields_ if kind in _KINDS.values()}

    def arrays(self) -> dict[str, Array]:
        """A copy of every series by its name."""
        return {
            name: self.array(name).copy() for name, kind, *_ in self._fields_ if kind not in _KINDS.values()
        }

    def __deepcopy__(self, _: object) -> Self:
        return type(self).from_buffer_copy(self)


RECORD_BYTES: dict[str, int] = {}
"""Sizes of the records that were declared, by the name of the class."""

_R = TypeVar("_R", bound=Record)


def record(cls: type[_R]) -> type[_R]:
    """Make the fields of a record of its annotations."""
    declared = vars(cls)
    cls.pointers = {name: one.declared for name, one in declared.items() if isinstance(one, _Address)}
    kinds = {name: None if name in cls.pointers else declared.get(name) for name in cls.__annotations__}
    cls._fields_ = [(name, kinds[name] or _KINDS[kind]) for name, kind in cls.__annotations__.items()]
    RECORD_BYTES[cls.__name__] = ctypes.sizeof(cls)
    return cls


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
    "set_generator": CFUNCTYPE(double, *5 * [double]),
    "stage_stop": CFUNCTYPE(None, int64, double),
    "path_begin": CFUNCTYPE(None),
    "path_line": CFUNCTYPE(None, int64),
    "path_end": CFUNCTYPE(None),
    "wave_memory": CFUNCTYPE(int64),
    "wave_keep": CFUNCTYPE(None),
    "wave_forget": CFUNCTYPE(None, int64),
    "wave_read": CFUNCTYPE(None, int64, int64, POINTER(c_int16)),
    "follow": CFUNCTYPE(None, int64),
    "due": CFUNCTYPE(int64),
}


class Callbacks(ctypes.Structure):
    """What the core asks of the machine's model, between ticks."""

    _fields_ = list(CALLBACKS.items())


_HOST: dict[str, tuple[Any, Sequence[Any]]] = {
    **{name: (c_size_t, ()) for name in ("size", "inputs_at", "seen_at", "out_at")},
    **{name: (c_size_t, ()) for name in ("last_samples_at", "samples_at")},
    "real_bytes": (c_int, ()),
    "schema_hash": (c_uint32, ()),
    "bind": (None, (pointer, pointer, pointer, POINTER(Callbacks))),
    "create": (None, (pointer, c_char_p, POINTER(double))),
    "set": (None, (pointer, c_int, c_uint32, c_int, double)),
    "receive": (c_size_t, (pointer, c_char_p, c_size_t)),
    **{name: (None, (pointer,)) for name in ("line_read", "advanced", "taken", "heard")},
    "count_from": (None, (pointer, int64, c_uint16, c_uint32, c_uint32, c_uint32)),
    "fault": (None, (pointer, c_int, c_int)),
    "reset": (None, (pointer, c_int)),
    "keep": (None, (pointer, pointer)),
    "take_up": (None, (pointer, pointer)),
}
"""Functions of the controller: result and arguments."""

_MODELS: dict[str, tuple[Any, Sequence[Any]]] = {
    "machine_run": (int64, (int64, pointer, pointer)),
    "machine_advance": (None, (int64, c_bool, int64, pointer, pointer)),
    "plant_run": (c_bool, (pointer,)),
    "actuator_run": (double, (pointer, int64, pointer, *3 * [double], *3 * [pointer])),
    "actuator_tick": (None, (pointer, pointer, double)),
    "pump": (None, (pointer, pointer, double)),
    "renew_clearing": (None, (pointer, pointer)),
    "strike_pulses": (None, (pointer,)),
    "pulse_signals": (None, (int64, pointer, *5 * [double], *2 * [pointer])),
    "work_look": (double, (pointer, *6 * [double])),
    "work_tabulate": (int64, (pointer, double, pointer, int64, *2 * [pointer])),
    "work_sink": (None, (pointer, double, double)),
    "bank_room": (int64, (pointer,)),
    "bank_advance": (None, (*2 * [pointer], int64, *3 * [pointer])),
    "bank_features": (None, (*2 * [pointer], int64, *3 * [pointer], int64, pointer)),
    "bank_solve": (None, (*2 * [pointer], int64, *2 * [pointer], *2 * [double], *2 * [pointer])),
    "turned_stops": (None, (int64, pointer, int64, *2 * [pointer])),
    "maxwell_loads": (None, (pointer, *2 * [double], int64, *2 * [pointer])),
    "maxwell_positions": (None, (pointer, *2 * [double], int64, *2 * [pointer])),
    "pow": (double, (double, double)),
    **{name: (double, (double,)) for name in ("exp", "log", "sin", "cos")},
    "transducer_advance": (None, (*3 * [pointer], int64, *5 * [pointer])),
}
"""Functions of the virtual machine, of the actuator models, and elementary ones."""


class Library:
    """A loaded build: functions by their names in C without `edm_` or `edm_host_`.

    Pointers are addresses as integers, or `byref` of a record. Calls release the interpreter's lock.
    """

    def __init__(self, build: Build) -> None:
        self.build = build
        self.loaded = ctypes.CDLL(str(build.path))
        for prefix, functions in (("edm_host_", _HOST), ("edm_", _MODELS)):
            for name, (result, arguments) in functions.items():
                function = getattr(self.loaded, f"{prefix}{name}")
                function.restype, function.argtypes = result, list(arguments)
                setattr(self, name, function)
        self.plant_run_at: int = ctypes.cast(self.loaded.edm_plant_run, pointer).value or 0
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
