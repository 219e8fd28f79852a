"""Asking an armed controller who it is: it tells, and nothing else happens."""

from __future__ import annotations

from edmctl.link import messages as m
from edmctl.link.session import Session
from edmctl.simulator import BenchConfig, open_bench


def test_who_asks_ends_no_session_and_leaves_the_machine_armed() -> None:
    bench = open_bench(BenchConfig(), 1)
    host = Session(bench.transport)
    host.open()
    host.request(m.CommitProfile(m.param_crc({})))
    host.request(m.Arm(m.param_crc({})))
    told = Session(bench.transport).introduction()
    assert (told.state, told.has_same_schema, told.fields["serial"]) == ("ARMED", True, host.hello.serial)
    host.pump(1.0)
    status = host.request(m.GetStatus())
    assert (m.State(status.state), status.fault) == (m.State.ARMED, 0)


def test_a_common_hello_ends_it() -> None:
    """The reason for asking otherwise (docs/decisions/0028)."""
    bench = open_bench(BenchConfig(), 1)
    host = Session(bench.transport)
    host.open()
    host.request(m.CommitProfile(m.param_crc({})))
    host.request(m.Arm(m.param_crc({})))
    assert Session(bench.transport).open().fault == 1001
