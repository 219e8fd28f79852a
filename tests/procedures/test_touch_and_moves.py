"""Readings, stage moves and approaches, one at a time on the virtual bench."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from edmctl.errors import ObjectiveNotReached, PreconditionError
from edmctl.machine.interface import EventCode, TelemetryBlock, TelemetryFlag
from edmctl.procedures.stages import move_to
from edmctl.procedures.touch.approach import ABOVE_BOTTOM_UM, find_gap, lower_to, raise_by
from edmctl.procedures.touch.reading import take_reading
from edmctl.record.rows import RunEvent
from edmctl.simulator.plant_records import TICK_S
from tests.tiers import tiers

from .conftest import Shop, armed, refused


@pytest.mark.parametrize("conditioned", [False, True])
def test_a_reading_is_the_mean_of_its_touches_beside_the_model_if_there_is_one(*, conditioned: bool) -> None:
    s = Shop(("measure.touches=3",))
    run = armed(s, conditioned=conditioned)
    move_to(run, run.job.pad)
    found = take_reading(run, "Z1", "hole", 50.0, 10.0)
    touched = s.seen.args(EventCode.TOUCH)
    assert found.z_um == pytest.approx(np.mean([args["displacement_um"] for args in touched]))
    assert found.reading.touches == 3
    assert s.seen.touches[-1].accepted
    model = f" (model {found.model_um:.1f} µm)" if conditioned else ""
    assert found.model_um == pytest.approx(found.z_um if conditioned else math.nan, abs=4.0, nan_ok=True)
    assert s.told.notes[-1].startswith(f"Z1 = {found.z_um:.2f} µm{model}, ")


@pytest.mark.parametrize("held_s", tiers(0.5, slow=(0.2, 2.0)))
def test_a_touch_is_judged_by_its_dwell_however_late_it_is_heard_of(
    monkeypatch: pytest.MonkeyPatch, held_s: float
) -> None:
    """Samples of the way back, or of the next touch, are in by then."""
    s = Shop(("measure.touches=2",), seed=1101)
    run = armed(s, conditioned=True)
    move_to(run, run.job.pad)
    pump_until = s.session.pump_until

    def late(predicate: Callable[[], bool], timeout_s: float, *, wakes: bool = False) -> bool:
        came = pump_until(predicate, timeout_s, wakes=wakes)
        if came:
            pump_until(lambda: False, held_s)
        return came

    monkeypatch.setattr(s.session, "pump_until", late)
    take_reading(run, "Z1", "hole", 50.0, 10.0)
    assert [row.accepted for row in s.seen.touches] == [True]


def test_where_the_tool_is_now_is_not_where_it_was_while_the_host_was_held_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A block of seconds, with the end of a ramp in it, tells the present place by its own end."""
    s = Shop(seed=1102)
    run = armed(s, conditioned=True)
    s.machine.ramp(60.0, 200.0)
    move_to(run, run.job.parking)
    at_home_um = run.watch.zero_um()
    s.machine.ramp(60.0, 200.0)
    pump_until = s.session.pump_until

    def once_in_a_while(predicate: Callable[[], bool], timeout_s: float, *, wakes: bool = False) -> bool:
        pump_until(lambda: False, 0.9)
        return predicate()

    monkeypatch.setattr(s.session, "pump_until", once_in_a_while)
    s.machine.ramp(0.0, 200.0)
    block = run.watch.latest
    assert block is not None
    assert block.displacement_um[0] > 50.0
    assert run.watch.displacement_um == pytest.approx(block.displacement_um[-5:].mean(), abs=0.3)
    assert run.watch.zero_um() == pytest.approx(at_home_um, abs=2.0)


def test_touches_that_scatter_are_rejected_after_one_repeat() -> None:
    s = Shop(("measure.touches=3",))
    strict = s.profile.measure.model_copy(update={"max_sd_um": 1e-4})
    s.job = type(s.job)(s.profile.model_copy(update={"measure": strict}), s.job.setup, s.job.sites)
    run = armed(s)
    move_to(run, run.job.pad)
    with pytest.raises(ObjectiveNotReached, match="scatter") as caught:
        take_reading(run, "Z1", "hole", 50.0, 10.0)
    assert "measure.max_sd_um" in caught.value.hint
    assert [row.accepted for row in s.seen.touches] == [False, False]


def test_a_closed_contact_before_the_feed_is_refused() -> None:
    s = Shop()
    run = armed(s)
    move_to(run, run.job.pad)
    s.bench.plant.state.asperity_um = 1e3  # a chip between tool and work
    s.machine.rest(0.2)
    with pytest.raises(PreconditionError, match="contact sensor"):
        take_reading(run, "Z1", "hole", 50.0)
    latest = run.watch.latest
    assert latest is not None
    assert latest.flags[-1] & TelemetryFlag.CONTACT


def test_a_move_retracts_first_and_arrives_from_below() -> None:
    s = Shop()
    run = armed(s)
    s.machine.ramp(40.0, 200.0)
    move_to(run, run.job.pad)
    move_to(run, run.job.parking)
    stages = [time_s for time_s, code, _, _, _ in s.seen.events if code == EventCode.STAGE_DONE]
    assert len(stages) == 3  # one to the pad; two back, because that is against the direction
    volts = s.seen.column("actuator_v")
    times = s.seen.column("time_s")
    assert volts[times > stages[0] - 0.05].max() == 0.0
    assert s.machine.status().x_um == pytest.approx(-5000.0, abs=3.0)


def test_lowering_stops_short_of_its_goal_and_never_beyond() -> None:
    s = Shop()
    run = armed(s)
    lower_to(run, 200.0)
    heights_um = s.seen.column("displacement_um")
    assert heights_um.max() < 201.0
    assert run.watch.displacement_um == pytest.approx(200.0, abs=ABOVE_BOTTOM_UM / 3)
    raise_by(run, 60.0)
    s.machine.rest(0.2)
    assert run.watch.displacement_um < 180.0


def test_conditioning_identifies_the_model_and_starts_it_where_the_actuator_is() -> None:
    s = Shop()
    armed(s, conditioned=True)
    (said,) = s.seen.args(RunEvent.CONDITIONED)
    assert 0.0 < float(said["rms_um"]) < 3.0
    s.machine.ramp(60.0, 60.0)
    s.machine.rest(0.5)
    model_um = s.seen.column("model_um")
    sensor_um = s.seen.column("displacement_um")
    assert np.isnan(model_um[:100]).all()
    assert np.abs(model_um - sensor_um)[-30:].max() < 5.0
    assert sensor_um.max() > 300.0  # the whole stroke, beside the work


def test_an_approach_slower_than_erosion_ends_at_the_first_sparks() -> None:
    """Waiting for the servo's reference it would cut for long: 11 µm here."""
    s = Shop(("approach.speed_um_s=0.5",))
    run = armed(s)
    find_gap(run, s.job.sites[0])
    assert s.bench.truth()[0].depth_um < 2.0


def test_a_tool_is_not_lowered_by_samples_from_before_the_last_ramp(monkeypatch: pytest.MonkeyPatch) -> None:
    """All samples get lost for a while from the beginning of each ramp."""
    s = Shop()
    run = armed(s, conditioned=True)
    move_to(run, run.job.pad)
    hear, ramp, until_s = run.watch.telemetry, s.machine.ramp, 0.0

    def telemetry(block: TelemetryBlock) -> None:
        if block.time_s[0] > until_s:
            hear(block)

    def deafening(actuator_v: float, slew_v_s: float) -> None:
        nonlocal until_s
        until_s = s.machine.time_s + 2.0
        ramp(actuator_v, slew_v_s)

    monkeypatch.setattr(run.watch, "telemetry", telemetry)
    monkeypatch.setattr(s.machine, "ramp", deafening)
    lower_to(run, 30.0)
    assert run.watch.displacement_um == pytest.approx(30.0, abs=4.0)
    assert float(s.bench.controller.loop.displacement_um) < 31.0


def test_a_line_without_samples_ends_the_lowering() -> None:
    s = Shop()
    run = armed(s, conditioned=True)
    move_to(run, run.job.pad)
    s.inject(f"SAMPLES_LOST@{s.bench.controller.tick * TICK_S}")
    with refused("E4022"):
        lower_to(run, 30.0)
    assert float(s.bench.controller.loop.displacement_um) < 31.0
