"""Samples that stay away while everything else arrives: nothing goes on without them for more than a second."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import TYPE_CHECKING

import pytest

from edmctl.errors import LinkLost
from edmctl.link.frame import FrameDecoder, encode_frame
from edmctl.link.messages import Tlm
from edmctl.link.session import Session
from edmctl.link.transport import Transport
from edmctl.machine.controller import LinkMachine
from edmctl.machine.inbox import OLDEST_SAMPLE_S
from edmctl.machine.interface import Axis, JumpRequest, MachineState, TouchRequest
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.plant_records import TICK_S

from .conftest import TELEMETRY, Heard

if TYPE_CHECKING:
    from .conftest import MakeRig, Rig

FOUND_S = OLDEST_SAMPLE_S + 0.2
"""A heartbeat and a slice later than samples become too old, a host has seen it."""


def lose(r: Rig) -> float:
    """Lose every sample from now on; the time."""
    now_s = r.bench.transport.now_s()
    r.bench.inject(parse_injection(f"SAMPLES_LOST@{now_s}"))
    return now_s


def watch_on(r: Rig, duration_s: float) -> None:
    """Watch a cut, which must not end meanwhile."""
    for _ in range(round(duration_s / 0.1)):
        assert r.machine.watch_cut(0.1) is None


def test_a_cut_without_samples_ends_within_a_second(rig: MakeRig) -> None:
    r = rig().ready().sparking()
    r.machine.watch_cut(1.0)
    lost_s = lose(r)
    with pytest.raises(LinkLost, match=r"the newest is 1\.\d s old") as caught:
        watch_on(r, 10.0)
    assert caught.value.code == "E4022"
    assert r.bench.transport.now_s() - lost_s <= FOUND_S
    r.machine.safe_stop()
    assert not r.bench.controller.plant.drive.pulses_on
    assert r.bench.is_safe


TOUCH = TouchRequest(20.0, 5.0, 1.0, 150.0, 5.0, 0.3, 1)
JUMP = JumpRequest(height_um=20.0, speed_um_s=100.0, dwell_s=5.0, clearance_um=0.0)
MOTIONS: dict[str, Callable[[LinkMachine], object]] = {
    "approach": lambda machine: machine.approach(1.0, 120.0, 9.0),
    "touch": lambda machine: machine.touch(TOUCH),
    "ramp": lambda machine: machine.ramp(100.0, 5.0),
    "jump": lambda machine: machine.jump(JUMP),
    "stage": lambda machine: machine.move_stage(Axis.Y, 9000.0, 500.0),
}


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_no_motion_goes_on_without_samples(rig: MakeRig, motion: Callable[[LinkMachine], object]) -> None:
    r = rig().ready()
    lost_s = lose(r)
    with pytest.raises(LinkLost) as caught:
        motion(r.machine)
    assert caught.value.code == "E4022"
    assert r.bench.transport.now_s() - lost_s <= FOUND_S


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_no_motion_begins_without_samples(rig: MakeRig, motion: Callable[[LinkMachine], object]) -> None:
    r = rig().ready()
    lose(r)
    with pytest.raises(LinkLost):
        r.machine.rest(3.0)
    lost_s = r.bench.transport.now_s()
    with pytest.raises(LinkLost) as caught:
        motion(r.machine)
    assert caught.value.code == "E4022"
    assert r.bench.transport.now_s() == lost_s
    assert r.bench.controller.state is MachineState.ARMED
    assert r.bench.controller.loop.command_v == 0.0


def test_without_telemetry_nobody_waits_for_samples(rig: MakeRig) -> None:
    r = rig().ready()
    r.machine.stop_telemetry()
    r.machine.ramp(10.0, 5.0)
    r.machine.rest(3.0)
    r.machine.disarm()


class Thinned:
    """A line that loses a share of the frames with samples."""

    live = False

    def __init__(self, line: Transport, share: float) -> None:
        self.name = line.name
        self._line, self._share, self._random = line, share, Random(1)
        self.lost = 0
        self.now_s, self.write, self.close = line.now_s, line.write, line.close

    def read(self, timeout_s: float) -> bytes:
        return b"".join(map(self._passed, FrameDecoder().feed(self._line.read(timeout_s))))

    def _passed(self, frame: tuple[int, int, int, int, bytes]) -> bytes:
        if frame[0] == Tlm.ID and self._random.random() < self._share:
            self.lost += 1
            return b""
        return encode_frame(*frame)


class HeldUp:
    """A line of the computer's clock, which the test moves; what came while the host was away waits in order."""

    name, live = "held up", True

    def __init__(self, r: Rig) -> None:
        self._controller = r.bench.controller
        self._waiting = b""
        self.now = 0.0

    def now_s(self) -> float:
        return self.now

    def write(self, data: bytes) -> None:
        self._controller.receive(data)

    def close(self) -> None:
        return

    def read(self, timeout_s: float) -> bytes:
        self.pass_by(min(timeout_s, 0.01))
        data, self._waiting = self._waiting, b""
        return data

    def pass_by(self, duration_s: float) -> None:
        self.now += duration_s
        self._controller.advance(max(0, round(self.now / TICK_S) - self._controller.tick))
        self._waiting += self._controller.link.take_output()


class NoThread:
    """Heartbeats when the test says so."""

    def __init__(self, beat: Callable[[], None], *_: object) -> None:
        self.beat = beat

    def start(self) -> None:
        return

    def stop(self) -> None:
        return


def test_a_host_that_was_held_up_reads_what_waits_and_goes_on(
    rig: MakeRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    beats: list[NoThread] = []

    def make(*args: Callable[[], None]) -> NoThread:
        beats.append(NoThread(*args))
        return beats[-1]

    monkeypatch.setattr("edmctl.link.session.HeartbeatThread", make)
    r = rig()
    line = HeldUp(r)
    r.session = Session(line, Random(2))
    r.session.open()
    r.machine = LinkMachine(r.session, r.stop)
    r.heard = Heard()

    def let_pass(duration_s: float, *, hearing: bool) -> None:
        for _ in range(round(duration_s / 0.05)):
            beats[-1].beat()
            if hearing:
                r.machine.rest(0.05)
            else:
                line.pass_by(0.05)

    r.ready()
    let_pass(1.0, hearing=True)
    let_pass(0.9, hearing=False)
    r.machine.rest(0.01)
    let_pass(1.0, hearing=True)
    times_s = [float(t) for block in r.heard.blocks for t in block.time_s]
    assert times_s[-1] - times_s[0] > 2.7
    lose_s = line.now
    r.bench.inject(parse_injection(f"SAMPLES_LOST@{TICK_S * r.bench.controller.tick}"))
    with pytest.raises(LinkLost, match="do not come any more"):
        let_pass(3.0, hearing=True)
    assert line.now - lose_s <= FOUND_S


def test_a_fifth_of_all_frames_lost_ends_no_cut(rig: MakeRig) -> None:
    r = rig()
    line = Thinned(r.bench.transport, 0.2)
    r.session = Session(line, Random(2))
    r.session.open()
    r.machine = LinkMachine(r.session, r.stop)
    r.heard = Heard()
    r.ready()
    r.sparking()
    watch_on(r, 60.0)
    assert line.lost > 60
    assert TELEMETRY.batch * sum(b.missing_frames for b in r.heard.blocks) == pytest.approx(
        10 * line.lost, abs=20
    )
    r.machine.safe_stop()
