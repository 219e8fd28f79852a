"""A scan through the port: lines, a full queue, its ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.errors import PreconditionError
from edmctl.machine.interface import Axis, CutRequest, EventCode, MachineEvent, MachineState, ScanLine
from tests.machine.conftest import REFERENCE_V, Rig

if TYPE_CHECKING:
    from .conftest import MakeRig


def scanning(rig: MakeRig, max_time_s: float = 1000.0) -> Rig:
    """A scan far above the work, without lines."""
    r = rig().ready()
    r.machine.move_stage(Axis.X, 0.0, 5000.0)
    r.machine.start_scan(CutRequest(REFERENCE_V, 5.0, max_time_s))
    return r


def line(x_um: float, *, last: bool = False) -> ScanLine:
    return ScanLine(x_um, 0.5 * x_um, 100.0, 5.0, last)


def end_of(r: Rig) -> MachineEvent:
    for _ in range(600):
        event = r.machine.watch_cut(0.1)
        if event is not None:
            return event
    raise AssertionError("the scan does not end")


def test_the_stages_follow_the_lines_to_the_last_one(rig: MakeRig) -> None:
    r = scanning(rig)
    assert r.machine.path_move(line(20.0))
    assert r.machine.path_move(line(-10.0, last=True))
    assert end_of(r).code is EventCode.PATH_DONE
    status = r.machine.status()
    assert status.state is MachineState.ARMED
    assert (status.x_um, status.y_um) == pytest.approx((-10.0, -5.0))
    r.machine.move_stage(Axis.X, 0.0, 500.0)


def test_a_full_queue_is_told_and_takes_the_line_later(rig: MakeRig) -> None:
    r = scanning(rig)
    taken = 0
    while r.machine.path_move(line(10.0 if taken % 2 else 0.0)):
        taken += 1
        assert taken < 30
    assert taken >= 16
    r.machine.rest(1.0)
    assert r.machine.path_move(line(0.0, last=True))
    assert end_of(r).code is EventCode.PATH_DONE


def test_a_line_outside_a_scan_is_a_precondition(rig: MakeRig) -> None:
    r = rig().ready()
    with pytest.raises(PreconditionError, match="refused PATH_MOVE: BAD_STATE"):
        r.machine.path_move(line(10.0))


def test_a_scan_ends_by_time_and_by_command(rig: MakeRig) -> None:
    assert end_of(scanning(rig, max_time_s=0.5)).code is EventCode.TIME_UP
    r = scanning(rig)
    assert r.machine.path_move(line(100.0))
    r.machine.watch_cut(0.3)
    assert r.machine.stop_cut().code is EventCode.STOPPED
    stopped_um = r.machine.status().x_um
    assert 5.0 < stopped_um < 60.0
    r.machine.rest(0.5)
    assert r.machine.status().x_um == stopped_um
