"""Fuzz target: the virtual controller under frames with a good check but any content, at any time.

The input is a script: each step sends a command with a usual, a recorded, a changed or a random payload, lets time
pass, sends noise, breaks the machine, or reconnects. Run it as fuzz_decoder.py, with the options of libFuzzer:
`python tests/fuzz/fuzz_controller.py -max_total_time=600`.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.fuzz.driver import coverage_guided, fuzz, recorded_frames

with coverage_guided(__name__ == "__main__"):
    from edmctl.link import messages as m
    from edmctl.link.frame import ABORT, Frame, FrameDecoder, encode_frame
    from edmctl.simulator import BenchConfig, open_bench
    from edmctl.simulator.injection import INJECTIONS, parse_injection

STEPS, SECONDS = 60, 4.0
LEAST_V, GREATEST_V = -5.0, 150.5
UNARMED = (m.State.BOOT, m.State.IDLE, m.State.FAULT, m.State.ESTOP)
PAYLOADS = {
    frame.type_id: frame.payload
    for data in recorded_frames()
    for frame in FrameDecoder().feed(data)
    if frame.type_id in m.REQUESTS
}
COMMANDS = sorted(PAYLOADS)
SPOILS = sorted(INJECTIONS)
# Commands that lead somewhere come up more often than chance would have them.
LIKELY = [
    m.Arm.ID,
    m.PulseEnable.ID,
    m.StageMove.ID,
    m.Approach.ID,
    m.ServoStart.ID,
    m.TouchOff.ID,
    m.Jump.ID,
    m.TlmStart.ID,
]
USUAL = {
    m.PulseEnable.ID: m.PulseEnable(1).pack(),
    m.StageMove.ID: m.StageMove(0, 0, 50_000_000).pack(),
    m.Approach.ID: m.Approach(20.0, 100.0, 10.8).pack(),
    m.ServoStart.ID: m.ServoStart(9.6, 60.0, 2.0).pack(),
    m.TouchOff.ID: m.TouchOff(100.0, 10.0, 20.0, 90.0, 5.0, 0.05, 1).pack(),
    m.Jump.ID: m.Jump(10.0, 500.0, 0.1, 1.0).pack(),
    m.TlmStart.ID: m.TlmStart(1000, 14, m.PulseLog.FULL).pack(),
    m.PiezoSet.ID: m.PiezoSet(5.0, 500.0).pack(),
}


class Script:
    """Bytes of the input, one after another; zeros once they are used up."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    @property
    def over(self) -> bool:
        return self.at >= len(self._data)

    def byte(self) -> int:
        self.at += 1
        return self._data[self.at - 1] if self.at <= len(self._data) else 0

    def take(self, size: int) -> bytes:
        return bytes(self.byte() for _ in range(size))


class Run:
    """One controller under one script."""

    def __init__(self, script: Script) -> None:
        self.script = script
        self.bench = open_bench(BenchConfig(offset_um=20.0), seed=1)
        self.session, self.seq = 7, 0
        self.decoder = FrameDecoder(watch_for_abort=False)
        self.hello()

    def hello(self) -> None:
        self.send(m.Hello.ID, m.Hello(1, m.PROTO_MINOR, 1, m.SCHEMA_HASH).pack())

    def send(self, type_id: int, payload: bytes) -> None:
        self.bench.controller.receive(encode_frame(type_id, self.seq, self.session, 0, payload))
        self.seq = (self.seq + 1) % 256

    def command(self, type_id: int) -> None:
        """A command with a sensible, a recorded, a changed or a random payload."""
        how = self.script.byte() % 8
        payload = bytearray(PAYLOADS[type_id])
        if type_id == m.Arm.ID and how != 0:
            payload[:] = m.Arm(self.bench.controller.seen.param_crc).pack()
        elif how < 4:
            payload[:] = USUAL.get(type_id, bytes(payload))
        if how == 5 and payload:
            payload[self.script.byte() % len(payload)] = self.script.byte()
        elif how == 6:
            payload[:] = self.script.take(len(payload))
        elif how == 7:
            payload[:] = self.script.take(self.script.byte() % 30)
        self.send(type_id, bytes(payload))

    def step(self) -> None:
        """Do what the next byte of the script says."""
        what = self.script.byte()
        if what < 96:
            self.command(LIKELY[what % len(LIKELY)])
        elif what < 160:
            self.command(COMMANDS[what % len(COMMANDS)])
        elif what < 200:
            self.send(
                m.Heartbeat.ID, m.Heartbeat(1000 * self.bench.controller.tick, self.script.byte()).pack()
            )
            self.bench.controller.advance(1 + what % 50)
        elif what < 226:
            self.bench.controller.advance(1 + self.script.byte())
        elif what < 230:
            self.spoil()
        elif what < 240:
            self.bench.controller.receive(self.script.take(self.script.byte() % 40))
        elif what < 244:
            self.bench.controller.receive(ABORT)
        elif what < 248:
            self.clear()
        elif what < 252:
            self.seq = (self.seq - self.script.byte()) % 256
        else:
            self.session = 1 + self.script.byte() % 255
            self.hello()

    def spoil(self) -> None:
        """Break something on the machine, or repair everything."""
        number = self.script.byte()
        if number >= 2 * len(SPOILS):
            self.bench.clear_injections()
        else:
            when = "" if number < len(SPOILS) else "@0"
            self.bench.inject(parse_injection(SPOILS[number % len(SPOILS)] + when))

    def clear(self) -> None:
        """Wait for the retreat and clear the fault, so that a script can go on."""
        self.bench.controller.advance(600)
        self.send(m.ClearFault.ID, m.ClearFault(self.bench.controller.fault).pack())

    def check(self) -> None:
        """What must hold at any time."""
        controller, plant = self.bench.controller, self.bench.plant
        pulses_on = bool(plant.drive.pulses_on)
        assert not (pulses_on and controller.state in UNARMED), f"pulses on in {controller.state!r}"
        for name, volts in (("command", controller.loop.command_v), ("applied", plant.drive.actuator_v)):
            assert LEAST_V <= volts <= GREATEST_V, f"{name}: {volts} V"
        assert not (controller.fault and controller.armed), f"armed with fault {controller.fault}"
        frames: list[Frame] = self.decoder.feed(controller.link.take_output())
        assert self.decoder.bad == 0, "the controller sent what is no frame"
        for frame in frames:
            self.check_frame(frame)

    def check_frame(self, frame: Frame) -> None:
        if frame.type_id in m.UNSOLICITED:
            m.UNSOLICITED[frame.type_id].unpack(frame.payload)
        elif frame.flags == m.Status.OK and frame.type_id ^ 0x40 in m.REQUESTS:
            m.REQUESTS[frame.type_id ^ 0x40].REPLY.unpack(frame.payload)
        else:
            m.Status(frame.flags)


def one_input(data: bytes) -> None:
    """Run the script; whatever it does, pulses stay off unarmed and the actuator within its range."""
    run = Run(Script(data))
    for _ in range(STEPS):
        if run.script.over or run.bench.controller.tick > SECONDS * 1000:
            break
        run.step()
        run.check()
    # Then the host dies.
    controller = run.bench.controller
    controller.advance(1100)
    run.check()
    assert not controller.armed, "the watchdog did not act"
    controller.advance(1500)
    run.check()


def seeds() -> list[bytes]:
    """Scripts of whole jobs, and the recorded frames as they are."""
    go = [LIKELY.index(type_id) for type_id in (m.Arm.ID, m.PulseEnable.ID, m.StageMove.ID)]
    wait = [164, 0] * 40
    cut = [LIKELY.index(m.Approach.ID), 1, *wait, LIKELY.index(m.ServoStart.ID), 1, *wait]
    job = [x for step in go for x in (step, 1)]
    touch = [LIKELY.index(m.TouchOff.ID), 1]
    jump = [LIKELY.index(m.Jump.ID), 1]
    return [
        bytes([*job, *wait, *cut]),
        bytes([*job, *wait, *touch, *wait]),
        bytes([*job, *cut, *jump, *wait, 241, 245, *job]),
        bytes([LIKELY.index(m.TlmStart.ID), 1, *job, *cut]),
        *(bytes([227, number, *job, *cut, 228, 255, 245, *job]) for number in range(len(SPOILS))),
        *recorded_frames(),
    ]


if __name__ == "__main__":
    fuzz(one_input, seeds(), sys.argv)
