"""What a motion does that meets the work, millisecond by millisecond."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from edmctl.link import messages as m
from edmctl.link.faults import FaultCode
from edmctl.simulator import BenchConfig
from tests.simulator.conftest import Rig

CONTROLLERS = pytest.mark.parametrize("controller", ["firmware", "firmware-float"])
FAST_UM_S = 20.0
JUMP_RETURN, TOUCH_BACK = 7, 11  # `mode` of the core: enum edm_mode in firmware/core/controller.h
ROUNDING = (0, 1)
"""A ramp may have a last step that the converter does not show."""


def rests(controller: str, back_off_um: float, closed: Callable[[int], bool]) -> tuple[int, int, Rig]:
    """Let a touch go back; `closed` says of each millisecond since the begin of that whether contact reads closed.

    Returns how many the ramp took, and in which the next touch began or a fault came.
    """
    r = Rig(BenchConfig(offset_um=20.0, controller=controller), 1).arm().to_pad()
    r.session.request(m.TouchOff(FAST_UM_S, -100.0, 5.0, 60.0, back_off_um, 0.1, 2))
    bench, controls = r.bench, r.bench.controller
    before_v, since, ramp = -1.0, 0, 0
    for _ in range(20_000):
        controls.host_heard()
        in_back_off = controls.loop.mode == TOUCH_BACK
        if since and (not in_back_off or controls.fault):
            return ramp, since, r
        if in_back_off:
            since += 1
            voltage_v = bench.plant.drive.actuator_v
            ramp = since - 2 if not ramp and voltage_v == before_v else ramp
            before_v = voltage_v
        inverted = in_back_off and closed(since)
        bench.plant.unit.contact_inverted = int(inverted)
        controls.advance(1)
    raise AssertionError("no back-off")


@CONTROLLERS
@pytest.mark.parametrize("back_off_um", [1.0, 3.5, 12.0])
def test_a_touch_goes_on_once_contact_has_been_open_at_rest(controller: str, back_off_um: float) -> None:
    ramp, end, r = rests(controller, back_off_um, lambda since: False)
    assert ramp == pytest.approx(1000.0 * back_off_um / FAST_UM_S, abs=3.0)
    assert end - max(200, ramp + 50) in ROUNDING
    assert not r.bench.controller.fault


@CONTROLLERS
@pytest.mark.parametrize("back_off_um", [1.0, 3.5, 12.0])
@pytest.mark.parametrize("every", [1, 2, 40])
def test_a_contact_that_comes_and_goes_after_the_back_off_is_a_fault(
    controller: str, back_off_um: float, every: int
) -> None:
    """However long the way back was; not only in the millisecond in which the next touch would begin."""
    ramp, end, r = rests(controller, back_off_um, lambda since: since % every == 0)
    assert r.bench.controller.fault == FaultCode.STUCK_CONTACT
    assert end - max(200, ramp + 50) - 100 in ROUNDING


@CONTROLLERS
@pytest.mark.parametrize("back_off_um", [1.0, 12.0])
def test_a_single_disturbance_after_the_back_off_costs_50_ms(controller: str, back_off_um: float) -> None:
    _ramp, end, _r = rests(controller, back_off_um, lambda since: False)
    _ramp, later, r = rests(controller, back_off_um, lambda since: since == end - 10)
    assert later == end - 10 + 50
    assert not r.bench.controller.fault


@CONTROLLERS
@pytest.mark.parametrize("counts", [2802, 2803, 40022])
def test_a_ramp_to_the_voltage_applied_feeds_nothing(controller: str, counts: int) -> None:
    """Whatever float makes of the voltage of the wire and of that of the converter."""
    r = Rig(BenchConfig(offset_um=20.0, controller=controller), 1).arm()
    for target in (counts + 400, counts):
        r.session.request(m.PiezoSet(target / 400.0, 300.0))
        r.wait(m.EventCode.MOVE_DONE, 5.0)
        r.bench.plant.unit.contact_inverted = 1
    r.session.request(m.PiezoSet(counts / 400.0, 300.0))
    r.wait(m.EventCode.MOVE_DONE, 1.0)
    r.session.request(m.PiezoSet((counts + 1) / 400.0, 300.0))
    assert r.wait_fault(1.0).code == FaultCode.COLLISION


@CONTROLLERS
def test_a_jump_comes_back_to_a_short_and_not_into_the_work(controller: str) -> None:
    """Though the reference is below the voltage of a short, and the clearance is great."""
    r = Rig(BenchConfig(offset_um=20.0, controller=controller), 1).arm().to_pad().start_sparking()
    r.session.pump(1.0)
    r.session.request(m.ServoStop())
    r.session.request(m.ServoStart(0.0, 500.0, 100.0))
    r.session.pump(0.5)
    bench = r.bench
    for _ in range(3):
        r.session.request(m.Jump(60.0, 2000.0, 0.05, 20.0))
        shorts = 0
        for _ in range(1000):
            bench.controller.host_heard()
            bench.controller.advance(1)
            if bench.controller.state != m.State.JUMP:
                break
            returns = bench.controller.loop.mode == JUMP_RETURN and bench.plant.readings.pulses > 0
            shorts += returns and bench.plant.readings.gap_v < 1.0
        assert bench.controller.state == m.State.MACHINING
        assert shorts == 0
        r.session.pump(0.2)
