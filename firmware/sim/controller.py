"""The emulated board as a controller of the simulator: the interface of `Controller`, behind a real line.

Bytes take their time, answers come with the millisecond, and the clock runs: the image knows nothing of a driven
one. Where the host drives the clock, its ADVANCE is answered here, and HELLO's answer is told so.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from edmctl.core.library import library
from edmctl.link.frame import Frame, FrameDecoder, encode_frame
from edmctl.link.messages import (
    Advance,
    AdvanceReply,
    GetSchema,
    Hello,
    ResetCause,
    State,
    Status,
)
from edmctl.simulator.injection import Injector, Trigger
from edmctl.simulator.plant_records import TICK_NS

from .addresses import CCM_AT
from .chip import FLASH_AT, LOCKED_UP, PC, Chip, ChipFailed, Reset
from .circuit import INPUT_MS, STEP_DEG, STEP_UM, Bench
from .compiling import shared
from .converters import NOISE, SAMPLES_PER_MS
from .host_side import REPLY_BIT, Samples, Stm32Link, Waiting
from .image_memory import MEMBERS, Seen
from .line import LINE_BYTES
from .loop import BITTEN_BY_IWDG, BITTEN_BY_WWDG, CHANGED, FAILED, LOOK, Watch, run
from .pins import generator_of

if TYPE_CHECKING:
    from edmctl.board.image import Elf
    from edmctl.link.faults import FaultCode
    from edmctl.simulator.plant import Plant

BAUD = 921_600
_CAUSES = {
    ResetCause.POWER_ON: Reset.POWER_ON,
    ResetCause.COMMANDED: Reset.SOFTWARE,
    ResetCause.WATCHDOG: Reset.INDEPENDENT_WATCHDOG,
    ResetCause.BROWN_OUT: Reset.BROWN_OUT,
    ResetCause.EXTERNAL: Reset.PIN,
}
_GREETING_MS = 25
START_MS = 200
MOST_AT_ONCE = 50
"""Milliseconds for which random numbers are drawn at once."""


class Stm32Controller:
    """An image on an emulated chip over one plant.

    chip : the chip; bench : what lies between it and the plant.
    watch : what the loop keeps, the load of the chip among it. The image has its controller in CCM.
    """

    def __init__(self, plant: Plant, image: Elf, baud: int = BAUD) -> None:
        self.plant = plant
        self.chip = Chip(image, plant.serial.encode())
        self.bench = Bench()
        self._layout = dict(zip(MEMBERS, self._words("edm_layout"), strict=True))
        self._at = image.symbols["controller"][0]
        self._rx = np.zeros(LINE_BYTES, np.uint8)
        self._tx = np.zeros(4096, np.uint8)
        hiss = np.random.default_rng([*plant.serial.encode(), 17]).standard_normal(NOISE)
        self._hiss = np.concatenate((hiss, hiss[: 2 * SAMPLES_PER_MS]))
        self.bench.rate = baud * 100
        self.bench.input_ms = INPUT_MS
        self.baud_told = baud
        self.board = 0
        self.host_time_scale = 1.0
        self.link = Stm32Link(self)
        self.telemetry = Samples()
        self.loop = self.parameters = self.black_box = Seen(self)
        self.injector = Injector(self)
        self.host_wait = Waiting(self)
        self._commands = FrameDecoder(watch_for_abort=False)
        self._pending = b""
        self._has_zero = False
        self._generator: tuple[float, ...] = ()
        self._steps = np.zeros(3)  # of the stages since they last rested
        self._scans = False
        self.watch = Watch()
        self.watch.arms_at, self.watch.touches_at = (
            self._at + self._layout[name] - CCM_AT for name in ("arms", "touch_offs")
        )
        self._read_inputs()
        self._start(Reset.POWER_ON)
        if not self._await_start():
            at = self.chip.program_counter
            raise ChipFailed(f"the image does not come to its main loop; it stands at {at:#x}")
        self.link.take_output()  # nobody listens when a machine is switched on

    # --------------------------------------------------------------------------------------- what stands in memory
    def bytes_of(self, name: str, size: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Bytes of a member of the image's controller."""
        if not self.bench.ticks:
            return np.zeros(size, np.uint8)  # what stands there is of before the start
        at = self._at + self._layout[name] - CCM_AT
        return self.chip.ccm[at : at + size]

    def _words(self, name: str) -> list[int]:
        """Words of a constant of the image."""
        at, size = self.chip.image.symbols[name]
        words: list[int] = self.chip.flash[at - FLASH_AT :][:size].view("<u4").tolist()
        return words

    @property
    def ticks_before(self) -> int:
        """Milliseconds of the machine before the image's tick 0."""
        return self.tick - self.watch.is_due - int(self.bytes_of("tick", 8).view("<i8")[0])

    def word(self, name: str) -> int:
        """A member of 32 bits."""
        return int(self.bytes_of(name, 4).view("<u4")[0])

    @property
    def tick(self) -> int:
        """Milliseconds since the machine was set up; resets do not touch them."""
        return self.plant.readings.tick

    @property
    def boot_tick(self) -> int:
        """The tick at which the controller started."""
        return int(self.bytes_of("boot_tick", 8).view("<i8")[0]) + self.ticks_before

    @property
    def time_us(self) -> int:
        """Controller time: µs since its start."""
        return (self.tick - self.boot_tick) * TICK_NS // 1000

    @property
    def state(self) -> State:
        """State of the controller."""
        return State(int(self.bytes_of("state", 1)[0]))

    @property
    def armed(self) -> bool:
        """Whether the watchdog runs."""
        return bool(self.bytes_of("armed", 1)[0])

    @property
    def fault(self) -> int:
        """Latched fault, 0 for none."""
        return int(self.bytes_of("keeps.fault", 2).view("<u2")[0])

    @property
    def boot_count(self) -> int:
        """How often it has started."""
        return self.word("keeps.boot_count")

    @property
    def baud(self) -> int:
        """Baud of the line."""
        return self.baud_told

    @baud.setter
    def baud(self, baud: int) -> None:
        """The image has its own, whatever the line at the other end says."""

    def count_from(self, time_us: int, event_no: int, boot_count: int, frames: int, pulse_no: int) -> None:
        """Let every counter of the link stand where it does after a long time, as tests of its wrap need it."""
        ticks = int(self.bytes_of("tick", 8).view("<i8")[0])
        self.bytes_of("boot_tick", 8).view("<i8")[0] = ticks - time_us // 1000
        self.bytes_of("keeps.event_no", 2).view("<u2")[0] = event_no
        for name, value in (
            ("keeps.boot_count", boot_count),
            ("receiver.bad", frames),
            ("link.drop", frames),
            ("gap.pulse_no", pulse_no),
        ):
            self.bytes_of(name, 4).view("<u4")[0] = value & 0xFFFFFFFF
        for name in ("telemetry.counter", "telemetry.pulse_counter"):
            self.bytes_of(name, 2).view("<u2")[0] = frames & 0xFFFF

    # ------------------------------------------------------------------------------------------------ bytes and time
    def receive(self, data: bytes) -> None:
        """Put bytes on the line; an ADVANCE among them is carried out here where the clock is driven."""
        if not self.link.driven:
            self._put_on_line(data)
            return
        *whole, self._pending = (self._pending + data).split(b"\0")
        asked = None
        if whole and not self.bench.ticks:
            self._await_start()
        for piece in whole:
            frames = self._commands.feed(b"\0" + piece + b"\0") if piece else []
            if frames and frames[0].type_id == Advance.ID:
                self._let_time_pass(frames[0])
                self._has_zero = True  # the zero before it went on
            elif self._has_zero and not piece:
                self._has_zero = False
            else:
                self._has_zero = False
                asked = frames[0] if frames else asked
                if frames and frames[0].type_id in (Hello.ID, GetSchema.ID):
                    self.link.advanced = False  # whoever asks does not drive the clock yet
                self._put_on_line(piece + b"\0")
        if asked is not None and not self.link.advanced:
            self._answer_without_advance(asked)

    def _restart(self) -> None:
        """Let a board that has said so restart, before a host that drives its clock asks it anything."""
        self.link.reboots = False
        before = len(self.chip.resets)
        for _ in range(START_MS):
            if len(self.chip.resets) > before and self.bench.ticks > 1:
                return
            self.advance(1)

    def _await_start(self) -> bool:
        """Let the image come to its main loop, before which it hears nothing; False where it does not."""
        for _ in range(START_MS):
            self.advance(1)
            if self.bench.ticks > 1:
                return True
        return False

    def _answer_without_advance(self, asked: Frame) -> None:
        """Let the time pass that an answer takes, to whoever does not drive the clock yet."""
        link = self.link
        link.awaited = (asked.type_id | REPLY_BIT, asked.seq)
        for _ in range(_GREETING_MS):
            self.advance(1)
            if link.awaited is None:
                break
        link.due = True

    def _put_on_line(self, data: bytes) -> None:
        bench = self.bench
        while data:
            place = bench.rx_tail & (LINE_BYTES - 1)
            part = data[: min(LINE_BYTES - place, LINE_BYTES - (bench.rx_tail - bench.rx_head))]
            if not part:
                self.advance(1)
            self._rx[place : place + len(part)] = np.frombuffer(part, np.uint8)
            bench.rx_tail += len(part)
            data = data[len(part) :]

    def _let_time_pass(self, frame: Any) -> None:
        try:
            asked = Advance.unpack(frame.payload)
        except ValueError:
            self.link.answer(
                encode_frame(frame.type_id | REPLY_BIT, frame.seq, frame.session, Status.BAD_LENGTH, b"")
            )
            return
        self.link.advanced = True
        if asked.timeout_us:
            self.host_wait.wait(asked.timeout_us * 1e-6)
        if self.link.reboots:
            self._restart()
        reply = AdvanceReply(t_dev_us=self.time_us)
        self.link.answer(
            encode_frame(frame.type_id | REPLY_BIT, frame.seq, frame.session, Status.OK, reply.pack())
        )

    def host_heard(self) -> None:
        """Nothing feeds a board's watchdog but frames."""

    def step(self, ticks: int) -> int:
        """Compile what runs the millisecond; `ticks` is 0."""
        return 0

    def advance(self, ticks: int) -> None:
        """Let `ticks` milliseconds pass: for each, what the chip does at its begin, then the machine's own."""
        self.run(ticks, stops_when_sent=False)

    def run(self, ticks: int, *, stops_when_sent: bool) -> None:
        """Let up to `ticks` milliseconds pass, or until a frame has gone out that somebody waits for."""
        end = self.tick + ticks
        while (now := self.tick) < end:
            self.injector.apply_due(now)
            self.plant.chips.look()
            self._read_inputs()
            until = min(end, self.injector.next_tick(now), self.plant.chips.next_tick(now) or end)
            reason = self._loop(min(max(until - now, 1), MOST_AT_ONCE), stops_when_sent)
            self._see_to(reason)
            if stops_when_sent and self.link.urgent:
                return

    def _loop(self, ticks: int, stops_when_sent: bool) -> int:
        plant, chip = self.plant, self.chip
        plant.random.provide(plant.state, ticks * (TICK_NS // plant.unit.pulse_period_ns + 2), 4 * ticks)
        frame, entry, leave = chip.buffers
        reason: int = run(
            ticks,
            stops_when_sent,
            shared(self.watch),
            chip.core,
            chip.r,
            chip.sram,
            chip.ccm,
            frame,
            entry,
            leave,
            shared(self.bench),
            self._rx,
            self._tx,
            shared(plant.unit),
            shared(plant.scope),
            self._hiss,
            shared(plant.drive),
            shared(plant.readings),
            library().plant_run_at,
            plant.in_c().place,
        )
        return reason

    def _see_to(self, reason: int) -> None:
        """What the loop came back for."""
        if self.bench.tx_size:
            self.link.sent(self._tx[: self.bench.tx_size].tobytes())
            self.bench.tx_size = self.bench.urgent = 0
        if reason == LOOK:
            self.plant.look()
        elif reason == FAILED:
            if self.chip.has_set_guard:
                self.chip.close_guard()
            if not self.chip.conclude(self.watch.status):
                self._start(Reset.SOFTWARE)
            elif self.watch.status and self.chip.core[PC] != LOCKED_UP:
                self.watch.is_due = 1  # for the handler of the fault
        elif reason == BITTEN_BY_WWDG:
            self._start(Reset.WINDOW_WATCHDOG)
        elif reason == BITTEN_BY_IWDG:
            self._start(Reset.INDEPENDENT_WATCHDOG)
        elif reason == CHANGED:
            self._follow()

    def _follow(self) -> None:
        """Carry what the image has set on to the machine, and tell whoever waits for a trigger."""
        if self.chip.take_gate_changes():
            self._set_generator()
        if self.bench.moved:
            self._move_stages()
        watch = self.watch
        seen = self.word("arms"), self.word("touch_offs")
        before, (watch.arms, watch.touches) = (watch.arms, watch.touches), seen
        for _ in range(seen[0] - before[0]):
            self.injector.note(Trigger.ARM)
        for _ in range(seen[1] - before[1]):
            self.injector.note(Trigger.TOUCH)

    def _read_inputs(self) -> None:
        plant, bench = self.plant, self.bench
        inputs = plant.inputs()
        bench.chain_loop = plant.estop or plant.door_open  # by contacts of their own
        bench.estop, bench.door, bench.hv_ok = inputs.estop, inputs.door_open, inputs.hv_supply_ok
        bench.level_ok, bench.limit = inputs.level_ok, inputs.limit_switch
        bench.flow_lpm, bench.temperature_c = inputs.flow_lpm, inputs.temperature_c

    def _set_generator(self) -> None:
        setting = generator_of(self.chip.r)
        if setting == self._generator or min(setting[:4]) <= 0.0:
            return
        self._generator = setting
        self.plant.set_generator(*setting)

    def _move_stages(self) -> None:
        """Carry step pulses to the stages.

        While there are sparks or a scan goes on the tool follows them; otherwise the stages land where they end.
        """
        plant, bench = self.plant, self.bench
        steps = bench.array("steps")
        self._steps += steps
        steps[:] = 0.0
        way = self._steps * (STEP_UM, STEP_UM, STEP_DEG)
        is_over, bench.moved = bench.moved > 1, 0
        if plant.drive.pulses_on or self._scans:
            if not self._scans:
                plant.begin_scan()
                self._scans = True
            for axis in range(2):
                plant.reported[axis] += float(way[axis])
            self._steps[:2] = 0.0
            plant.drive.stage_x_um, plant.drive.stage_y_um = plant.reported[:2]
            plant.look()
            if is_over:
                plant.follow_stages(scan_goes_on=False)
                self._scans = False
        if is_over:
            for axis in range(3):
                if self._steps[axis]:
                    plant.stage_lands(axis, plant.reported[axis] + float(way[axis]))
            self._steps[:] = 0.0

    # --------------------------------------------------------------------------------------------------- resets
    def _start(self, cause: Reset) -> None:
        self.chip.reset(cause)
        bench, watch = self.bench, self.watch
        bench.ticks = bench.alive_edges = bench.gate_starts = 0
        bench.rx_head = bench.rx_tail
        bench.frame_bytes = 0
        watch.is_due = 1
        watch.wwdg_silent = watch.iwdg_silent = 0
        watch.arms = watch.touches = 0

    def raise_fault(self, code: FaultCode, detail: int = 0) -> None:
        """Let the time pass in which the board finds out that the host is silent: no other fault is asked for."""
        self.advance(self.loop.watchdog_ticks + 1)

    def reset(self, cause: ResetCause) -> None:
        """Start anew."""
        self.plant.look()
        self._start(_CAUSES[cause])
