"""Whatever the line does, a command acts once, or fails cleanly and acts at most once."""

from __future__ import annotations

from edmctl.link import messages as m
from edmctl.link.frame import encode_frame
from edmctl.simulator import BenchConfig, open_bench
from tests.link.lossy import Faults
from tests.link.schedules import Tally, run_schedule


def test_a_command_acts_once_or_fails_cleanly() -> None:
    tally = Tally()
    for seed in range(60):
        run_schedule(seed, tally)
    assert tally.breaches == []
    assert tally.done > 100
    assert tally.lost > 0
    assert tally.retries > 20


def test_a_good_line_needs_no_repetition() -> None:
    tally = Tally()
    for seed in range(3):
        run_schedule(seed, tally, Faults())
    assert (tally.breaches, tally.retries) == ([], 0)


def test_a_late_copy_of_hello_opens_nothing_after_a_restart() -> None:
    bench = open_bench(BenchConfig(), 1)
    controller = bench.controller
    hello = m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 77, m.SCHEMA_HASH)
    opening = encode_frame(m.Hello.ID, 0, 9, 0, hello.pack())
    command = encode_frame(m.Arm.ID, 1, 9, 0, m.Arm(m.param_crc({})).pack())
    controller.receive(opening + command)
    assert controller.state is m.State.ARMED
    controller.reset(m.ResetCause.POWER_ON)
    controller.receive(opening + command)
    assert controller.state is not m.State.ARMED
    fresh = encode_frame(m.Hello.ID, 0, 9, 0, m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 78, m.SCHEMA_HASH).pack())
    controller.receive(fresh + command)
    assert controller.state is m.State.ARMED
