"""Random schedules of frames and time for one virtual machine, and a digest of all that comes of them.

A schedule is a host that mostly knows what it does, and everything that can go wrong between it and the machine:
damaged and repeated frames, other sessions, aborts, restarts, injected faults, values that make no sense.
"""

from __future__ import annotations

import hashlib
import math
from copy import deepcopy
from random import Random
from typing import Any

from edmctl.link import messages as m
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.wire import Message, Param
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from edmctl.simulator.injection import INJECTIONS, parse_injection

ABORT_ZEROS = 8
CAUSES = (m.ResetCause.WATCHDOG, m.ResetCause.BROWN_OUT, m.ResetCause.POWER_ON, m.ResetCause.EXTERNAL)
SPOILED = tuple(name for name in INJECTIONS if name not in ("UNPLUG", "SILENCE", "LINE_NOISE"))
"""The line is spoiled by the schedule itself."""
FAILED = (
    ("sensor_gain", math.nan),
    ("sensor_gain", -1e9),
    ("monitor_gain", math.nan),
    ("monitor_gain", 0.9),
    ("off_time_a", math.nan),
    ("gap_stuck_v", 5.0),
    ("gap_stuck_v", 60.0),
    ("gap_stuck_v", 1e6),
)
"""Constants of the machine that no machine has, for what it then reads."""


class Schedule:
    """One host and its mishaps. `commands` counts frames that were sent whole."""

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)
        offset_um = self.random.choice((2.0, 5.0, 20.0, 45.0))
        self.bench = open_bench(BenchConfig(offset_um=offset_um), seed)
        self._digest = hashlib.sha256()
        self.commands = 0
        self.session = self.seq = self.beat_seq = 0
        self.sent: list[bytes] = []
        self.hellos: list[bytes] = []
        self.values: dict[str, float] = {}
        self.last_event = 0
        self.host_us = 0
        self.faults: set[int] = set()

    def run(self, steps: int) -> None:
        """Do so many things."""
        self._open()
        acts = [(act, weight) for act, weight in self._acts()]
        for _ in range(steps):
            (act,) = self.random.choices([a for a, _ in acts], [w for _, w in acts])
            act()

    def digest(self) -> str:
        """SHA-256 of every byte that the controller has said, and of its state and its plant after every step."""
        return self._digest.hexdigest()

    def _acts(self) -> list[tuple[Any, float]]:
        return [
            (self._work, 30),
            (self._pass_time, 20),
            (self._beat, 20),
            (self._any_command, 12),
            (self._ask, 10),
            (self._go_on, 8),
            (self._repeat, 3),
            (self._damage, 3),
            (self._garbage, 1),
            (self._together, 2),
            (self._zeros, 0.7),
            (self._open, 0.7),
            (self._spoil, 1.2),
            (self._repair, 0.8),
            (self._restart, 0.3),
            (self._short, 3),
            (self._drive, 2),
        ]

    # ------------------------------------------------------------------------------------------------ the line
    def _write(self, data: bytes) -> bytes:
        """Hand bytes over, sometimes in pieces."""
        cuts = sorted(
            self.random.randrange(len(data) + 1) for _ in range(self.random.choice((0, 0, 0, 1, 3)))
        )
        at = 0
        for cut in [*cuts, len(data)]:
            self.bench.controller.receive(data[at:cut])
            at = cut
        return self._hear()

    def _hear(self) -> bytes:
        """Return what the controller has said since the last call."""
        data = self.bench.controller.link.take_output()
        self._digest.update(data)
        self._digest.update(_view(self.bench))
        for frame in FrameDecoder(watch_for_abort=False).feed(data):
            if frame.type_id in (m.Event.ID, m.Fault.ID):
                self.last_event = int.from_bytes(frame.payload[:2], "little")
            if frame.type_id == m.Fault.ID:
                self.faults.add(m.Fault.unpack(frame.payload).code)
        return data

    def _framed(self, message: Message, *, seq: int | None = None, session: int | None = None) -> bytes:
        if seq is None:
            self.seq = (self.seq + 1) % 256
            seq = self.seq
        self.commands += 1
        data = encode_frame(message.ID, seq, self.session if session is None else session, 0, message.pack())
        self.sent = [*self.sent[-12:], data]
        return data

    def _send(self, message: Message, **header: int) -> bytes:
        return self._write(self._framed(message, **header))

    def _advance(self, ticks: int) -> None:
        self.bench.controller.advance(ticks)
        self._hear()

    # ------------------------------------------------------------------------------------------------- the acts
    def _open(self) -> None:
        r = self.random
        self.session, self.seq = r.randrange(1, 256), r.randrange(256)
        self.values = {}
        hash_ = m.SCHEMA_HASH if r.random() < 0.95 else r.getrandbits(32)
        hello = self._framed(
            m.Hello(m.PROTO_MAJOR, r.choice((5, 4, 6)), r.getrandbits(32), hash_), seq=self.seq
        )
        self.hellos.append(hello)
        self._write(hello)

    def _pass_time(self) -> None:
        self._advance(self.random.choice((1, 1, 2, 5, 20, 49, 50, 120, 200, 240)))

    def _beat(self) -> None:
        r = self.random
        self.host_us += r.choice((0, 1, 1000, 50_000, 50_000, 50_000))
        stale = self.host_us if r.random() < 0.9 else max(0, self.host_us - r.randrange(100_000))
        acknowledged = self.last_event if r.random() < 0.8 else r.randrange(40)
        self.beat_seq = (self.beat_seq + 1) % 256
        self._send(m.Heartbeat(stale, acknowledged), seq=self.beat_seq)

    def _alive(self, ms: int) -> None:
        """Let time pass with heartbeats."""
        while ms > 0 and not self.bench.controller.fault:
            self.host_us += 50_000
            self.beat_seq = (self.beat_seq + 1) % 256
            self._send(m.Heartbeat(self.host_us, self.last_event), seq=self.beat_seq)
            self._advance(min(ms, 100))
            ms -= 100

    def _go_on(self) -> None:
        self._alive(self.random.choice((200, 500, 1500, 4000)))

    def _work(self) -> None:
        """The next sensible thing for the state that the machine is in."""
        r, c = self.random, self.bench.controller
        state = c.state
        if state in (m.State.FAULT, m.State.ESTOP):
            if r.random() < 0.5:
                self._repair()
            self._alive(300)
            self._advance(r.choice((100, 500)))
            self._send(m.ClearFault(c.fault if r.random() < 0.9 else r.randrange(9000)))
        elif state is m.State.IDLE:
            self._prepare()
        elif state is m.State.ARMED:
            self._send(self._motion())
        elif state is m.State.MACHINING and r.random() < 0.4:
            self._alive(800)
        elif state is m.State.MACHINING:
            self._send(r.choice((self._line, self._line, self._jump, self._stop))())
        else:
            self._alive(r.choice((100, 300, 1000)))

    def _prepare(self) -> None:
        r = self.random
        for _ in range(r.randrange(4)):
            self._stage_parameter()
        if r.random() < 0.8:
            self._send(m.CommitProfile(m.param_crc(self.values)))
        if r.random() < 0.7:
            self._send(self._generator())
        if r.random() < 0.8:
            self._send(self._telemetry())
        self._send(m.Arm(self.bench.controller.seen.param_crc))
        if r.random() < 0.9:
            self._send(m.PulseEnable(1))
        if r.random() < 0.7:
            self._send(m.StageMove(m.Axis.X, r.choice((0, 0, 1000, -3_000_000)), 50_000_000))
            self._alive(300)

    def _stage_parameter(self) -> None:
        r = self.random
        param = r.choice(list(m.PARAMS.values()))
        wire = param.to_wire(self._any_value(param))
        self._send(m.SetParam(param.id, wire))
        if self.bench.controller.state is m.State.IDLE:
            self.values[param.name] = param.from_wire(wire)

    def _any_value(self, param: Param) -> float:
        """A value within its range; of those that stop most of what follows, one that does not."""
        r = self.random
        low, high = param.minimum, param.maximum
        value = r.choice(
            (low, high, param.default, r.uniform(low, high), param.default * r.uniform(0.5, 2.0))
        )
        value = min(high, max(low, value))
        if param.name == "servo_period_us":
            value = 1000.0 * r.choice((1, 2, 7))
        if param.name in ("piezo_max_v", "slew_limit_v_s", "retract_v_s", "sensor_fitted", "watchdog_s"):
            value = max(value, param.default)
        return value

    def _generator(self) -> m.PulseConfig:
        r = self.random
        period_us = r.choice((20.0, 50.0, 434.783, 434.783, 1000.0, 7000.0, 19.999))
        on_us = round(period_us * r.uniform(0.1, 0.9), 3)
        mode = r.choice((0, 0, 0, 1, 2))
        return m.PulseConfig(
            on_us, round(period_us - on_us, 3), r.choice((20.0, 40.0, 80.0)), 0.12, mode, on_us * r.random()
        )

    def _telemetry(self) -> m.TlmStart:
        r = self.random
        return m.TlmStart(
            r.choice((1000, 1000, 2000, 7000, 65000, 500)), r.randrange(16), r.choice((0, 1, 1, 2, 2, 3))
        )

    def _motion(self) -> Message:
        r = self.random
        duty_v = 12.0
        return r.choice(
            (
                lambda: m.Approach(r.choice((5.0, 20.0, 100.0)), r.choice((3.0, 100.0)), 0.9 * duty_v),
                lambda: m.Approach(20.0, 100.0, 0.9 * duty_v),
                lambda: m.ServoStart(0.8 * duty_v, r.choice((3.0, 500.0)), r.choice((0.01, 1.0, 100.0))),
                lambda: m.ServoStart(0.8 * duty_v, 500.0, 100.0),
                lambda: m.ScanStart(0.8 * duty_v, r.choice((-5.0, 5.0, 30.0)), 60.0),
                lambda: m.ScanStart(0.8 * duty_v, 30.0, 60.0),
                self._touch,
                self._touch,
                self._jump,
                lambda: m.PiezoSet(r.choice((0.0, 1.0, 3.0, 10.0, 60.0)), r.choice((1.0, 50.0, 337.25))),
                lambda: m.PiezoSet(0.0, 337.25),
                lambda: m.StageMove(
                    r.randrange(4), r.randrange(-300_000, 300_000), r.randrange(1, 5_000_000)
                ),
                lambda: m.SelfTest(),
                lambda: m.SetZero(r.uniform(-30.0, 10.0)),
                lambda: m.PulseEnable(1),
                self._generator,
                lambda: m.Disarm(),
                lambda: m.ServoStop(),
            )
        )()

    def _touch(self) -> m.TouchOff:
        r = self.random
        return m.TouchOff(
            r.choice((20.0, 100.0)),
            r.choice((-5.0, 1.0, 10.0)),
            r.choice((1.0, 5.0)),
            r.choice((2.0, 60.0)),
            r.choice((0.5, 3.0)),
            r.choice((0.0, 0.05, 0.2)),
            r.randrange(4),
        )

    def _jump(self) -> m.Jump:
        r = self.random
        return m.Jump(
            r.choice((0.0, 5.0, 50.0)),
            r.choice((50.0, 500.0, 5000.0)),
            r.choice((0.0, 0.05)),
            r.choice((0.0, 2.0)),
        )

    def _line(self) -> m.PathMove:
        r = self.random
        x_um, y_um = r.uniform(-30.0, 30.0), r.uniform(-30.0, 30.0)
        speed_um_s = r.choice((0.0, 5.0, 100.0, 20_000.0))
        return m.PathMove(x_um, y_um, speed_um_s, r.uniform(0.0, 30.0), int(r.random() < 0.1))

    def _stop(self) -> Message:
        return self.random.choice((m.ServoStop(), m.PulseEnable(0), m.Disarm(), m.GetStatus()))

    def _ask(self) -> None:
        r = self.random
        self._send(
            r.choice(
                (
                    m.GetStatus(),
                    m.GetParam(r.randrange(60)),
                    m.GetSchema(r.choice((0, 243, 2400, 2500, 65535))),
                    m.BlackboxRead(r.choice((0, 0, 14, 500, 2040, 65535))),
                    m.WaveformRead(r.choice((0, 0, 58, 5000, 34_000, 1 << 31))),
                    m.TlmStop(),
                    self._telemetry(),
                )
            )
        )

    def _any_command(self) -> None:
        """Any command with any payload, of its length or not; any seq and session now and then."""
        r = self.random
        kind = r.choice(list(m.REQUESTS.values()))
        if kind in (m.Hello, m.Advance):
            return
        size = _size_of(kind)
        payload = r.randbytes(size if r.random() < 0.9 else r.randrange(30))
        if r.random() < 0.5:  # small numbers are nearer to what makes sense
            payload = bytes(b if i % 4 == 0 else 0 for i, b in enumerate(payload))
        type_id = kind.ID if r.random() < 0.95 else r.randrange(256)
        if type_id == m.Advance.ID:
            return
        self.seq = (self.seq + r.choice((1, 1, 1, 1, 2, 127, 128, 129, 255))) % 256
        session = self.session if r.random() < 0.95 else r.randrange(256)
        self.commands += 1
        self._write(encode_frame(type_id, self.seq, session, 0, payload))

    def _repeat(self) -> None:
        """A copy of something: of one of the last commands, or of any HELLO ever."""
        if self.hellos and self.random.random() < 0.2:
            self.commands += 1
            self._write(self.random.choice(self.hellos))
        elif self.sent:
            self.commands += 1
            self._write(self.random.choice(self.sent))

    def _damage(self) -> None:
        r = self.random
        data = bytearray(self._framed(m.GetStatus()) if not self.sent else r.choice(self.sent))
        for _ in range(r.choice((1, 1, 3))):
            data[r.randrange(len(data))] ^= 1 << r.randrange(8)
        self._write(bytes(data[: r.randrange(1, len(data) + 1)]) + b"\0")

    def _garbage(self) -> None:
        r = self.random
        self._write(bytes(r.choice((0, 1, r.randrange(256))) for _ in range(r.randrange(600))))

    def _together(self) -> None:
        """Several frames, some of them damaged, in one read."""
        r = self.random
        data = b""
        for _ in range(r.randrange(2, 20)):
            frame = bytearray(
                self._framed(r.choice((m.GetStatus(), m.TlmStop(), m.GetParam(3), m.ServoStop())))
            )
            if r.random() < 0.4:
                frame[r.randrange(1, len(frame) - 1)] ^= 0x10
            data += bytes(frame)
        self._write(data)

    def _zeros(self) -> None:
        r = self.random
        zeros = bytes(r.choice((ABORT_ZEROS - 2, ABORT_ZEROS, 32)))
        behind = self._framed(m.GetStatus()) if r.random() < 0.5 else b""
        self._write(zeros + behind)

    def _spoil(self) -> None:
        r = self.random
        name = r.choice(SPOILED)
        now_s = (self.bench.controller.tick - self.bench.controller.boot_tick) * 1e-3
        text = f"{name}@{now_s + r.choice((0.0, 0.013, 0.4)):.3f}" if r.random() < 0.6 else name
        if r.random() < 0.1:
            text = f"{name}@arm+0.1"
        self.bench.inject(parse_injection(text))
        self._hear()

    def _short(self) -> None:
        """A wire that shorts the gap of a cut for a while."""
        c = self.bench.controller
        if c.state is not m.State.MACHINING:
            return
        now_s = (c.tick - c.boot_tick) * 1e-3
        self.bench.inject(parse_injection(f"WIRE_SHORT@{now_s:.3f}"))
        self._alive(self.random.choice((300, 1200, 1200, 4000)))
        self._repair()

    def _repair(self) -> None:
        self.bench.clear_injections()
        self._hear()

    def _restart(self) -> None:
        r = self.random
        if r.random() < 0.4:
            self._send(m.Reboot(0x0B007EDB if r.random() < 0.8 else 1))
            return
        cause = r.choice(CAUSES)
        self.bench.controller.reset(cause)
        self._hear()

    def _drive(self) -> None:
        """A while with a driven clock: time passes in ADVANCE alone."""
        r = self.random
        self.bench.controller.link.driven = True
        for _ in range(r.randrange(1, 6)):
            if r.random() < 0.5:
                self._beat()
            timeout_us = r.choice((0, 100, 1000, 20_000, 150_000))
            payload = m.Advance(timeout_us).pack() if r.random() < 0.95 else b"\1"
            self.commands += 1
            self._write(encode_frame(m.Advance.ID, r.randrange(256), self.session, 0, payload))
        self.bench.controller.link.driven = False
        self._send(m.Advance(1000))


class WideSchedule(Schedule):
    """Parameters from the whole of their range, slow lines, hosts of another time, readings that cannot be."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        baud = self.random.choice((0, 115_200, 230_400, 500_000))
        scale = self.random.choice((1.0, 1.0, 3.0, 0.25, 1.2345, 0.7071))
        self.bench.controller.baud, self.bench.controller.host_time_scale = baud, scale
        unit = self.bench.plant.unit
        self._sound = {name: getattr(unit, name) for name, _ in FAILED}

    def _any_value(self, param: Param) -> float:
        r = self.random
        low, high = param.minimum, param.maximum
        if param.name == "servo_period_us":
            return 1000.0 * r.choice((1, 2, 7, 200))
        near, far = param.default * r.uniform(0.05, 2.0), low + (high - low) * r.random() ** 4
        return min(high, max(low, r.choice((low, high, param.default, r.uniform(low, high), near, far))))

    def _spoil(self) -> None:
        if self.random.random() < 0.6:
            super()._spoil()
            return
        name, value = self.random.choice(FAILED)
        setattr(self.bench.plant.unit, name, value)
        self._hear()

    def _repair(self) -> None:
        for name, value in self._sound.items():
            setattr(self.bench.plant.unit, name, value)
        super()._repair()


def _view(bench: VirtualBench) -> bytes:
    """State of a controller and its plant."""
    c, plant = bench.controller, bench.plant
    seen = c.seen
    numbers = (
        c.tick,
        c.state.name,
        c.fault,
        c.armed,
        c.boot_count,
        (seen.rx_bad, seen.rx_drop, seen.rx_frames, seen.urgent, seen.due),
        (seen.command_v, seen.displacement_um, seen.slow_displacement_um, seen.gap_v, seen.pulse_no),
        tuple(plant.reported),
        tuple(plant.position_um.tolist()),
    )
    state = deepcopy(plant.state)
    state.random_at = state.noise_at = 0  # where in a block it reads is no property of the plant
    return repr(numbers).encode() + bytes(plant.drive)[: 4 * 8] + bytes(state)


def _size_of(kind: type[Message]) -> int:
    """Payload bytes of a command."""
    import struct

    from edmctl.link.wire import STRUCT_CODES

    types = [word.partition("/")[0] for word in kind.WIRE.split()]
    return struct.calcsize("<" + "".join(STRUCT_CODES[t] for t in types))
