"""The controller in C (firmware/core) over the plant: what a board and a simulator do around the core.

The simulator adds injections, a driven clock, and the end of slices of time.
"""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable
from copy import deepcopy
from typing import Any, Generic, TypeVar

import numpy as np

from edmctl.core.library import CALLBACKS, SAMPLES_BYTES, Callbacks, Inputs, Kept, Merged, Seen, library
from edmctl.link.faults import FaultCode
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.messages import ResetCause, State, Tlm
from edmctl.link.transport import MergedTlm
from edmctl.simulator.injection import NEVER, Injector, Trigger
from edmctl.simulator.plant import BLOCK, Plant
from edmctl.simulator.plant_records import TICK_NS, TICK_S
from edmctl.simulator.waveforms import Waveforms

T = TypeVar("T")
_INPUTS = struct.Struct(
    "=" + "".join("q" if kind is ctypes.c_int64 else "d" for _, kind, *_ in Inputs._fields_)
)
FRAME_TICKS = 100
"""A host that waits sees what is wrong with its samples as soon as on a live line."""
ANSWERS_PER_TICK = 100
MOST_AT_ONCE = 4096
"""Bytes that the core gets at once: the answers to them fit into its memory."""


class _seen(Generic[T]):
    """A value of the core's record as an attribute of its controller."""

    def __init__(self, name: str, kind: Callable[[Any], T]) -> None:
        self._name, self._kind = name, kind

    def __get__(self, controller: Controller, _: object) -> T:
        return self._kind(getattr(controller.seen, self._name))


class SampleLine:
    """What is wrong with a controller's samples: `lost` ones do not come, `frozen` ones have an old time."""

    def __init__(self, controller: Controller) -> None:
        self._c = controller
        self._lost = self._frozen = False
        self._frozen_us = 0

    @property
    def lost(self) -> bool:
        return self._lost

    @lost.setter
    def lost(self, lost: bool) -> None:
        self._c.drain()
        self._lost = bool(lost)
        self._c.seen.merges = 0

    @property
    def frozen(self) -> bool:
        return self._frozen

    @frozen.setter
    def frozen(self, frozen: bool) -> None:
        self._c.drain()
        if frozen and not self._frozen:
            frames = FrameDecoder(watch_for_abort=False).feed(self._c.last_samples() + b"\0")
            self._frozen_us = Tlm.unpack(frames[0].payload).t0_us if frames else 0
        self._frozen = bool(frozen)
        self._c.seen.merges = 0

    @property
    def is_broken(self) -> bool:
        return self._lost or self._frozen

    def passes(self, data: bytes) -> bytes:
        """Return what is sent of whole frames."""
        if not self.is_broken:
            return data
        sent = []
        for frame in FrameDecoder(watch_for_abort=False).feed(data):
            payload = frame.payload
            if frame.type_id == Tlm.ID and self._lost:
                continue
            if frame.type_id == Tlm.ID:
                samples = Tlm.unpack(payload)
                samples.t0_us = self._frozen_us
                payload = samples.pack()
            sent.append(encode_frame(frame.type_id, frame.seq, frame.session, frame.flags, payload))
        return b"".join(sent)


class HostWait:
    """Lets time pass for a host that waits.

    The controller answers commands at once, without time. So that a host which only asks cannot stop the clock, a
    millisecond passes after a hundred answers. A wait ends early if there is something for the host to see; if that
    comes in the last millisecond of a wait, the next one ends without time.
    """

    def __init__(self, controller: Controller) -> None:
        self._c = controller
        self._answers = 0
        self._came_last = False

    def wait(self, timeout_s: float) -> None:
        """Let up to `timeout_s` pass: nothing if an answer is there already, else whole milliseconds."""
        urgent = self._c.urgent or self._came_last
        self._came_last = False
        if urgent and self._answers < ANSWERS_PER_TICK:
            self._answers += 1
            return
        self._answers = 0
        ticks = 1 if urgent else max(1, math.floor(timeout_s / TICK_S + 0.5))
        self._came_last = self._c.advance(ticks, wakes=True) == ticks and self._c.urgent


class Controller:
    """One core over one plant; it is its own end of the line, `link`.

    real : arithmetic of the core, "double" or, as on a board, "float".
    baud, board : what the core reports of its line and of itself. driven : its time passes only by ADVANCE.
    host_time_scale : by which it measures what its host does. The core gets these with the next bytes or ticks.
    answer_ticks : milliseconds within which a command is answered.
    """

    answer_ticks = 0

    def __init__(self, plant: Plant, real: str = "double") -> None:
        self.plant = plant
        self.real = real
        self._library = library(real)
        self._memory = (ctypes.c_double * (self._library.size() // 8 + 1))()
        self.waveforms = Waveforms(plant)
        self.baud = self.board = 0
        self.host_time_scale = 1.0
        self.driven = False
        self._out: list[bytes] = []
        self._failed: BaseException | None = None
        self._samples: list[MergedTlm] = []
        self._bind()
        self._read_inputs()
        self._create()
        self.link = self
        self.telemetry = SampleLine(self)
        self.injector = Injector(self)
        self.host_wait = HostWait(self)
        self._noted = (0, 0)

    def _bind(self) -> None:
        """Show the core where everything is: its own memory, the plant's records, the model's functions."""
        core = self._library
        self._at = ctypes.addressof(self._memory)
        self._inputs_at = core.inputs_at()
        self.seen = Seen.from_buffer(self._memory, core.seen_at())
        self.loop = self.parameters = self.black_box = self.seen
        acts: dict[str, Callable[..., object]] = {
            "set_generator": self._set_generator,
            "stage_stop": self.plant.stage_lands,
            "path_begin": self.plant.begin_scan,
            "path_line": self.plant.draw_line_error,
            "path_end": lambda: self.plant.follow_stages(scan_goes_on=False),
            "wave_memory": lambda: self.waveforms.memory,
            "wave_keep": lambda: self.waveforms.freeze(self.tick, self.boot_tick),
            "wave_forget": lambda kept: self.waveforms.thaw() if kept else self.waveforms.forget(),
            "wave_read": self._read_waveforms,
            "follow": self._follow,
            "due": self._handle_due,
        }
        self._callbacks = Callbacks(*(kind(self._guarded(acts[name])) for name, kind in CALLBACKS.items()))
        drive, readings = self.plant.drive, self.plant.readings
        core.bind(
            self._at, ctypes.addressof(drive), ctypes.addressof(readings), ctypes.byref(self._callbacks)
        )

    def _create(self) -> None:
        places = (ctypes.c_double * 3)(*self.plant.reported)
        self._library.create(self._at, self.plant.serial.encode().ljust(12, b"\0"), places)
        self._raise_failed()

    def _guarded(self, act: Callable[..., Any]) -> Callable[..., Any]:
        """Keep what goes wrong in a function that C calls, for the caller of C; show C where it has put things."""

        def call(*arguments: float) -> Any:
            try:
                return act(*arguments)
            except BaseException as error:
                self._failed = error
                return 0
            finally:
                self.plant.in_c()

        return call

    def _raise_failed(self) -> None:
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed

    def _set_generator(
        self, on_us: float, off_us: float, open_v: float, peak_a: float, set_us: float
    ) -> float:
        self.plant.set_generator(on_us, off_us, open_v, peak_a, set_us)
        return self.plant.unit.nominal_siemens

    def _read_waveforms(self, offset: int, samples: int, counts: Any) -> None:
        reply = self.waveforms.read(offset, self.tick)
        assert reply is not None
        assert samples == reply.n
        ctypes.memmove(counts, np.frombuffer(reply.records, "<i2").astype("=i2").tobytes(), 4 * samples)

    @property
    def tick(self) -> int:
        return self.plant.readings.tick

    @property
    def time_us(self) -> int:
        return (self.tick - self.boot_tick) * TICK_NS // 1000

    @property
    def state(self) -> State:
        return State(self.seen.state)

    @property
    def greeting(self) -> bool:
        return bool(self.driven and self.seen.urgent and not self.seen.advanced)

    boot_tick = _seen("boot_tick", int)
    boot_count = _seen("boot_count", int)
    armed = _seen("armed", bool)
    fault = _seen("fault", int)
    urgent = _seen("urgent", bool)
    due = _seen("due", bool)
    rx_bad = _seen("rx_bad", int)
    rx_drop = _seen("rx_drop", int)
    rx_frames = _seen("rx_frames", int)

    def count_from(self, time_us: int, event_no: int, boot_count: int, frames: int, pulse_no: int) -> None:
        self._library.count_from(
            self._at, time_us, event_no, boot_count, frames & 0xFFFFFFFF, pulse_no & 0xFFFFFFFF
        )

    def receive(self, data: bytes) -> None:
        at = 0
        while at < len(data):
            self._read_inputs()
            part = data[at : at + MOST_AT_ONCE]
            at += self._library.receive(self._at, part, len(part))
            self._after_call()
            if self.seen.advancing:
                self._let_time_pass()
        self._library.line_read(self._at)
        self._after_call()
        if self.seen.reboot_asked:
            self.reset(ResetCause.COMMANDED)

    def _let_time_pass(self) -> None:
        timeout_us = self.seen.advance_us
        if self.seen.reboot_asked:
            self.reset(ResetCause.COMMANDED)
        if timeout_us:
            self.host_wait.wait(timeout_us * 1e-6)
        self._library.advanced(self._at)
        self._after_call()

    def host_heard(self) -> None:
        self._library.heard(self._at)

    def advance(self, ticks: int, *, wakes: bool = False) -> int:
        """Let milliseconds pass, with `wakes` until something is sent that the host answers; return how many."""
        plant, end = self.plant, self.tick + ticks
        most = BLOCK // (TICK_NS // plant.unit.pulse_period_ns + 2) - 2
        if wakes and self.telemetry.is_broken:
            most = min(most, FRAME_TICKS)
        while (left := end - self.tick) > 0:
            self._provide(min(most, left))
            self._read_inputs()
            self._library.machine_advance(min(most, left), wakes, self._due(), plant.in_c().place, self._at)
            self._after_call()
            if self.seen.sample_bytes >= SAMPLES_BYTES // 2:
                self._merge()
            if wakes and (self.seen.urgent or self._wait_must_be_short):
                break
        return self.tick - end + ticks

    def _provide(self, ticks: int) -> None:
        plant = self.plant
        pulses = ticks * TICK_NS // plant.unit.pulse_period_ns + 2
        plant.random.provide(plant.state, pulses, 2 * ticks + 2)

    def _follow(self, look: int) -> None:
        self.plant.follow_stages(scan_goes_on=True)
        if look:
            self.plant.look()

    def _due(self) -> int:
        """The tick at which injections or chips have to be looked at next."""
        now = self.tick
        return min(self.injector.next_tick(now), self.plant.chips.next_tick(now) or NEVER)

    def _handle_due(self) -> int:
        self._note_begun()
        self.injector.apply_due(self.tick)
        self.plant.chips.look()
        self._read_inputs()
        return 0 if self._wait_must_be_short else max(self._due(), self.tick + 1)

    @property
    def _wait_must_be_short(self) -> bool:
        """Whether a host that waits is to look sooner: at its samples, or at a line that needs heartbeats now."""
        return self.telemetry.is_broken or bool(self.seen.watched and self.injector.line.is_damaged)

    def _read_inputs(self) -> None:
        """Show the core its inputs, and what it is to report of itself and of its line."""
        self._library.set(self._at, self.board, self.baud, self.driven, self.host_time_scale)
        _INPUTS.pack_into(self._memory, self._inputs_at, *self.plant.inputs())

    def _after_call(self) -> None:
        """What follows a call of the core: its bytes are lined up, what it has begun is told to the injector."""
        if self._failed is not None:
            self._raise_failed()
        seen = self.seen
        if seen.lost_frames:
            raise RuntimeError(
                f"{seen.lost_frames} frames of the core did not fit into its memory of the line"
            )
        if seen.out_bytes:
            self.drain()
        self._note_begun()

    def _note_begun(self) -> None:
        seen = self.seen
        if (seen.arms, seen.touch_offs) != self._noted:
            arms, touches = self._noted
            self._noted = seen.arms, seen.touch_offs
            for _ in range(seen.arms - arms):
                self.injector.note(Trigger.ARM)
            for _ in range(seen.touch_offs - touches):
                self.injector.note(Trigger.TOUCH)

    def drain(self) -> None:
        """Line up what the core has sent."""
        size = self.seen.out_bytes
        self.seen.out_bytes = 0
        if size:
            sent = ctypes.string_at(self._at + self._library.out_at(), size)
            self._out.append(self.telemetry.passes(sent))

    def take_samples(self) -> list[MergedTlm]:
        """Return the samples that were merged since the last call; none of them is in a frame."""
        self._merge()
        samples, self._samples = self._samples, []
        return samples

    def _merge(self) -> None:
        """Take merged samples out of the memory of the core."""
        size, self.seen.sample_bytes = self.seen.sample_bytes, 0
        if size == 0:
            return
        data, at = ctypes.string_at(self._at + self._library.samples_at(), size), 0
        while at < size:
            head = Merged.from_buffer_copy(data, at)
            at += ctypes.sizeof(Merged)
            end = at + head.samples * Tlm.record_dtype().itemsize
            heads = head.counter, head.t0_us, head.period_us, head.samples, head.dropped
            self._samples.append(MergedTlm(*heads, data[at:end], head.frames))
            at = end

    def last_samples(self) -> bytes:
        """The newest telemetry frame of samples; zeros before the first."""
        return ctypes.string_at(self._at + self._library.last_samples_at(), 257)

    def take_output(self) -> bytes:
        """Return everything that is to be sent."""
        out = b"".join(self._out)
        self._out.clear()
        self._library.taken(self._at)
        return out

    def kept(self) -> Kept:
        """Return what outlives a loss of power."""
        kept = Kept()
        self._library.keep(self._at, kept.place)
        return kept

    def take_up(self, kept: Kept) -> None:
        """Go on from what was kept on the plant as it is now, before a reset."""
        self._create()
        self._library.take_up(self._at, kept.place)
        self._noted = (self.seen.arms, self.seen.touch_offs)

    def __deepcopy__(self, memo: dict[int, object]) -> Controller:
        twin = object.__new__(type(self))
        memo[id(self)] = twin
        here = {"_library", "_memory", "_at", "_inputs_at", "_callbacks"}
        here |= {"seen", "loop", "parameters", "black_box"}
        twin._library = self._library
        twin._memory = type(self._memory).from_buffer_copy(self._memory)
        for name, value in vars(self).items():
            if name not in here:
                setattr(twin, name, deepcopy(value, memo))
        twin._bind()
        return twin

    def raise_fault(self, code: FaultCode, detail: int = 0) -> None:
        self._library.fault(self._at, int(code), detail)
        self._after_call()

    def reset(self, cause: ResetCause) -> None:
        self.plant.look()
        self._library.reset(self._at, int(cause))
        self._after_call()
