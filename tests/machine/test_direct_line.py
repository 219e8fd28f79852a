"""Samples come without frames on the line of a machine in this process: the same ones, and the same faults."""

from __future__ import annotations

from dataclasses import fields
from random import Random

import numpy as np
import pytest

from edmctl.errors import EdmError, LinkLost
from edmctl.link.messages import PulseLog, Tlm, TlmStart
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.results.telemetry import TelemetryBlock, joined
from edmctl.simulator.injection import parse_injection
from tests.machine.conftest import Rig

COLUMNS = [one.name for one in fields(TelemetryBlock) if one.name != "missing_frames"]


def samples_of(*, direct: bool) -> TelemetryBlock:
    """Samples of an approach, a cut and a jump."""
    r = Rig(direct=direct).ready().sparking()
    for _ in range(4):
        r.machine.rest(1.0)
    r.machine.safe_stop()
    assert sum(block.missing_frames for block in r.heard.blocks) == 0
    return joined(r.heard.blocks)


def test_samples_without_frames_are_those_of_the_frames() -> None:
    framed, direct = samples_of(direct=False), samples_of(direct=True)
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(framed, name), getattr(direct, name), err_msg=name)


def test_the_watchdog_hears_a_host_that_waits_and_no_other() -> None:
    r = Rig(direct=True).ready()
    r.machine.rest(5.0)
    assert r.bench.controller.fault == 0
    r.bench.controller.advance(600)  # nobody reads
    assert r.bench.controller.fault == 1001


@pytest.mark.parametrize("inject", ["SILENCE@5", "UNPLUG@5"])
def test_a_line_that_breaks_while_the_host_waits_trips_the_watchdog_in_time(inject: str) -> None:
    r = Rig(direct=True)
    r.bench.inject(parse_injection(inject))
    r.ready()
    with pytest.raises(EdmError):
        r.machine.rest(10.0)
    controller = r.bench.controller
    ((_, applied),) = controller.injector.applied
    while controller.fault == 0:
        controller.advance(1)
    assert controller.fault == 1001
    assert controller.tick - applied <= controller.seen.watchdog_ticks + 1


@pytest.mark.parametrize("first", ["SAMPLES_LOST", "LINE_NOISE"])
def test_interlocks_are_judged_at_once_whatever_else_is_wrong(first: str) -> None:
    r = Rig(direct=True).ready()
    now_s = r.bench.controller.time_us * 1e-6
    for inject in (f"{first}@{now_s + 0.9003}", f"ESTOP@{now_s + 1.2373}"):
        r.bench.inject(parse_injection(inject))
    with pytest.raises(EdmError):
        r.machine.rest(5.0)
    controller = r.bench.controller
    applied = controller.injector.applied[-1][1]
    assert controller.black_box.frozen_tick == applied


def test_a_host_that_falls_silent_is_not_heard() -> None:
    r = Rig(direct=True).ready()
    r.session.fall_silent(0.2)
    assert r.bench.controller.fault == 0
    r.session.fall_silent(0.3)
    assert r.bench.controller.fault == 1001


def test_a_closed_line_is_lost() -> None:
    r = Rig(direct=True)
    r.session.close()
    with pytest.raises(LinkLost):
        r.session.pump(0.1)


def test_a_new_session_gets_no_samples_of_the_one_before() -> None:
    r = Rig(direct=True)
    r.session.request(TlmStart(1000, 10, PulseLog.OFF))
    r.session.pump(0.5)
    r.session = Session(r.bench.direct_line(), Random(2))
    r.session.open()
    r.machine = LinkMachine(r.session, r.stop)
    r.ready()
    r.machine.rest(1.0)
    assert joined(r.heard.blocks).time_s[0] == 0.0


def test_samples_of_a_long_wait_come_in_order() -> None:
    r = Rig(direct=True)
    counters = []
    r.session.subscribe(Tlm, lambda tlm: counters.append(tlm.counter))
    r.session.request(TlmStart(1000, 10, PulseLog.OFF))
    r.session.pump(25.0)
    r.session.take_samples()
    assert counters == sorted(counters)
    assert counters[-1] >= 2490


def test_a_wait_that_is_interrupted_is_over_for_the_watchdog() -> None:
    r = Rig(direct=True).ready()

    def interrupt(timeout_s: float) -> None:
        raise KeyboardInterrupt

    r.bench.controller.host_wait.wait = interrupt  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        r.machine.rest(1.0)
    r.bench.controller.advance(600)
    assert r.bench.controller.fault == 1001
