"""A sensor whose zero walks: stages move by the tool's home, and intervals hold how far it may be off."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest

from edmctl.errors import EdmError, Interrupted
from edmctl.jobs.connected_machine import CALENDAR, Now, with_home, with_home_left
from edmctl.link import messages as m
from edmctl.machine.controller import LinkMachine
from edmctl.procedures.job import REPORT_DELAY_S, JobState
from edmctl.procedures.monitoring.drift import (
    CREEP_SHARE,
    CREEP_UM,
    Rests,
    contradicting_between_jobs_um_s,
    first_home_um,
)
from edmctl.procedures.run import JobRun
from edmctl.procedures.stages import Home, _is_home_set, _is_on_a_spot, move_to, retract
from edmctl.procedures.touch.surfaces import drift_between
from edmctl.process.rest_drift import TIME_CONSTANTS_S, DriftModel, Rest
from edmctl.profile.places import Place
from edmctl.quantity import half_width
from edmctl.record.json_rows import site_result_of
from edmctl.record.ledger import HomeSeen, MachineHistory
from edmctl.results.progress import Phase
from edmctl.simulator.plant_records import TICK_S
from tests.procedures.conftest import Kept, Shop, armed, refused
from tests.tiers import tiers

FAST_UM_S = 0.005
"""Three times what the setup states of its sensor: the worst of some hundred machines."""
EITHER_WAY = pytest.mark.parametrize("rate_um_s", tiers(-FAST_UM_S, slow=(FAST_UM_S,)))


def drifting(rate_um_s: float, hours: float = 0.0, overrides: tuple[str, ...] = ()) -> Shop:
    """A shop whose sensor drifts, and has done so for some hours."""
    shop = Shop(overrides)
    shop.bench.plant.unit.sensor_drift_um_s = rate_um_s
    return later(shop, hours)


def later(shop: Shop, hours: float) -> Shop:
    """Let an idle machine be some hours older; only the clock and what drifts with it change."""
    shop.bench.plant.readings.tick += round(hours * 3600.0 / TICK_S)
    controller = shop.bench.controller
    kept, seen = controller.kept(), controller.seen
    controller.count_from(controller.time_us, kept.event_no, kept.boot_count, 0, seen.pulse_no)
    return shop


def known_since(shop: Shop, age_s: float) -> Shop:
    """Let the job know where home was so long ago, as the job ledger does."""
    rate_um_s = shop.bench.plant.unit.sensor_drift_um_s
    home_um = rate_um_s * (shop.bench.plant.readings.tick * TICK_S - age_s)
    shop.job = replace(shop.job, home_um=home_um, home_age_s=age_s)
    return shop


def over_the_pad(shop: Shop) -> Shop:
    """Place the tool over the pad, where every job that touches ends. Meanwhile the sensor does not drift."""
    unit, session, crc = shop.bench.plant.unit, shop.session, m.param_crc({})
    rate_um_s, unit.sensor_drift_um_s = unit.sensor_drift_um_s, 0.0
    for request in (m.CommitProfile(crc), m.Arm(crc), m.StageMove(m.Axis.X, 0, 50_000_000)):
        session.request(request)
        session.pump(0.3)
    session.request(m.StageMove(m.Axis.Y, 0, 50_000_000))
    session.pump(0.3)
    session.request(m.Disarm())
    session.pump(0.1)
    assert shop.bench.plant.reported[:2] == [0.0, 0.0]
    unit.sensor_drift_um_s = rate_um_s
    return shop


def rested(shop: Shop) -> JobRun:
    run = armed(shop)
    run.machine.rest(0.5)
    return run


def home_found_um(shop: Shop) -> float:
    retract(rested(shop))
    return shop.tally.home_um


@EITHER_WAY
def test_a_sensor_that_has_drifted_for_eight_hours_ends_no_job(rate_um_s: float) -> None:
    shop = known_since(drifting(rate_um_s, hours=8.0), 1800.0)
    (site,) = shop.run_job().sites
    assert abs(site.z1_um - 50.0 - rate_um_s * 8.0 * 3600.0) < 15.0
    assert shop.holds(site)
    assert shop.tally.home_um == pytest.approx(rate_um_s * 8.0 * 3600.0, abs=5.0)


@pytest.mark.parametrize("hours", [0.0, 3.0])
def test_the_controller_gets_home_if_the_sensor_has_drifted(hours: float) -> None:
    shop = known_since(drifting(FAST_UM_S, hours=hours), 1200.0) if hours else Shop()
    run = rested(shop)
    move_to(run, run.job.parking)
    home_um = FAST_UM_S * hours * 3600.0
    assert shop.bench.controller.seen.zero_um == (pytest.approx(home_um, abs=1.0) if hours else 0.0)
    assert run.machine.status().x_um == pytest.approx(run.job.parking.x_um)


def test_a_tool_that_creep_holds_low_waits_for_a_controller_that_takes_no_such_home() -> None:
    """SET_ZERO is refused where the tool rests 25 µm from home; a home sent before may still do."""
    shop = drifting(0.0)
    run = armed(shop)
    retract(run)
    low_um = run.watch.displacement_um
    for sent_um, home_um, wanted_um in ((0.0, -3.0, -3.0), (low_um - 26.0, low_um - 28.0, low_um - 26.0)):
        run.machine._zero_um = sent_um  # type: ignore[attr-defined]
        assert _is_home_set(run, Home(home_um), low_um - home_um)
        assert run.machine.zero_um == wanted_um
    run.machine._zero_um = low_um - 60.0  # type: ignore[attr-defined]
    assert not _is_home_set(run, Home(low_um - 28.0), 28.0)


def rest_at(run: JobRun, zero_um: float) -> None:
    run.watch.zero_um = lambda: zero_um  # type: ignore[method-assign]
    retract(run)
    run.watch.rests.note(run.machine.time_s, zero_um)


@pytest.mark.parametrize("zeros_um", [(25.0,), (2.0, 6.0, 10.0, 14.0)])
def test_a_rest_that_jumps_or_comes_out_little_by_little_is_a_held_tool(zeros_um: tuple[float, ...]) -> None:
    run = rested(Shop())
    move_to(run, run.job.parking)
    run.watch.rests.note(run.machine.time_s, 0.0)
    sent_um: list[float] = []
    run.machine.set_zero = sent_um.append  # type: ignore[method-assign,assignment]
    for zero_um in zeros_um[:-1]:
        rest_at(run, zero_um)
    with refused("E8020", rf"has moved by {zeros_um[-1]:.1f} µm".replace(".", r"\.")):
        rest_at(run, zeros_um[-1])
    assert run.machine.status().displacement_um < 10.0
    assert max(sent_um, default=0.0) < 12.0


@pytest.mark.parametrize(("span_s", "way_um"), [(150.0, 50.0), (3600.0, 250.0)])
def test_rests_that_the_setup_explains_widen_no_interval(span_s: float, way_um: float) -> None:
    """Drift of one standard deviation, and creep anywhere in its bounds."""
    for creep_um in (-0.5 * CREEP_UM, CREEP_UM + CREEP_SHARE * way_um):
        rests = Rests()
        rests.note(0.0, 2.0)
        rests.reach(0.0, way_um)
        rests.note(span_s, 2.0 + 0.0017 * span_s + creep_um)
        assert rests.contradicting_um_s(0.0017) == 0.0
    for rest_um, home_um in ((60.0, 54.08), (52.0, 52.0), (-80.0, -80.0)):
        assert first_home_um(rest_um, 50.0, 4.08) == pytest.approx(home_um)


def test_rests_that_drift_faster_than_the_setup_states_widen_intervals() -> None:
    run = Shop().run()
    rests, stated = run.watch.rests, run.setup.sensor.drift_um_per_s
    for time_s, zero_um, faster_um_s in (
        (0.0, 2.0, 0.0),
        (1000.0, 7.0, 0.005),
        (2000.0, 7.0, 0.0),
        (2600.0, 13.0, 6.0 / 600.0),
    ):
        rests.note(time_s, zero_um)
        assert rests.contradicting_um_s(0.0017) == pytest.approx(faster_um_s)
        assert run.uncertainty.drift_u_um_per_s == pytest.approx(max(stated, faster_um_s))


def test_a_drift_between_tool_and_work_that_was_measured_widens_what_no_rest_shows() -> None:
    """By the setup's drift alone a wear was stated within 4 µm, where a file had 10 nm/s; it was off by 13."""
    shop, n = Shop(), len(TIME_CONSTANTS_S)
    shop.job = replace(shop.job, drift=DriftModel(np.zeros(n), np.eye(n) * 1e-6, 1.0, 0.5, 0.01, 0.01))
    run = shop.run()
    stated_um_s = math.hypot(0.01, run.setup.sensor.drift_um_per_s)
    assert run.uncertainty.drift_u_um_per_s == pytest.approx(stated_um_s)
    # Rests that show less than the setup correct nothing, and what is between tool and work stays unknown.
    first = SimpleNamespace(time_s=0.0, rest=Rest(0.0, 0.0, 0.0, np.zeros(n), np.zeros(n)))
    for crept_um, corrects in ((0.0, True), (2000.0, False)):
        later_on = Rest(1000.0, 1.0, 0.0, np.full(n, crept_um), np.zeros(n))
        last = SimpleNamespace(time_s=1000.0, rest=later_on)
        assert (drift_between(run, first, last) is not None) is corrects  # type: ignore[arg-type]


def refuses_to_move(shop: Shop, out_um: float, code: str = "E8020") -> EdmError:
    """Let the actuator hold the tool that far out although its voltage is 0, and run the job; the refusal."""
    shop.bench.plant.unit.actuator_zero_um -= out_um
    before = shop.bench.plant.position_um.copy()
    with refused(code) as caught:
        shop.run_job()
    assert (shop.bench.plant.position_um == before).all()
    return caught.value


@pytest.mark.parametrize("out_um", tiers(35.0, 150.0, slow=(60.0,)))
@pytest.mark.parametrize("hours", tiers(8.0, slow=(0.0, 4.0, 72.0)))
@pytest.mark.parametrize("drift_um_s", tiers(None, FAST_UM_S, slow=(0.0,)))
def test_a_tool_that_stands_out_is_not_moved_however_long_the_sensor_may_have_drifted(
    out_um: float, hours: float, drift_um_s: float | None
) -> None:
    shop = Shop()
    if drift_um_s is not None:
        shop.bench.plant.unit.sensor_drift_um_s = drift_um_s
    error = refuses_to_move(later(shop, hours), out_um)
    if hours:
        assert "could stand" in error.message
        assert "displacement sensor to zero" in error.hint


@pytest.mark.parametrize(("home_um", "age_s"), [(-100.0, 60.0), (0.0, 20_000.0)])
@pytest.mark.parametrize("simulated", [True, False])
def test_a_controller_that_was_started_since_home_was_known_is_named(
    monkeypatch: pytest.MonkeyPatch, *, simulated: bool, home_um: float, age_s: float
) -> None:
    shop = Shop()
    shop.job = replace(shop.job, home_um=home_um, home_age_s=age_s + REPORT_DELAY_S)
    run = rested(shop)
    monkeypatch.setattr(LinkMachine, "identity", replace(run.machine.identity, simulated=simulated))
    with refused("E8020", r"was started 1 min 0\d s ago; home was known before") as caught:
        retract(run)
    assert ("--bench FILE" if simulated else "`edmctl doctor` shows") in caught.value.hint


@pytest.mark.parametrize("hours", tiers(72.0, slow=(8.0,)))
@EITHER_WAY
def test_over_the_pad_a_touch_measures_home(rate_um_s: float, hours: float) -> None:
    shop = over_the_pad(drifting(rate_um_s, hours=hours))
    (site,) = shop.run_job().sites
    assert shop.holds(site)
    assert shop.tally.home_um == pytest.approx(rate_um_s * hours * 3600.0, abs=10.0)


@pytest.mark.parametrize(
    ("rate_um_s", "hours", "out_um", "code"),
    tiers(
        (0.0, 0.0, 42.0, "E8020"),
        (-FAST_UM_S, 8.0, 35.0, "E8020"),
        (-FAST_UM_S, 8.0, 60.0, "E63003"),  # on the pad the controller sees a short
        slow=(
            (0.0, 4.0, 42.0, "E8020"),
            *((-FAST_UM_S, hours, 35.0, "E8020") for hours in (4.0, 72.0)),
            *((-FAST_UM_S, hours, 60.0, "E63003") for hours in (4.0, 72.0)),
        ),
    ),
)
def test_over_the_pad_a_touch_finds_a_tool_that_stands_out(
    rate_um_s: float, hours: float, out_um: float, code: str
) -> None:
    shop = drifting(rate_um_s, hours=hours) if rate_um_s else later(Shop(), hours)
    refuses_to_move(over_the_pad(shop), out_um, code)


TWO_DEEP_HOLES = (
    'sites=[{kind="grid",name="hole",x_um=500,y_um=0,columns=2,rows=1,dx_um=400,dy_um=400}]',
    "target.depth_um=100.0",
    "limits.max_time_s=7200",
)


@lru_cache
def states_on_a_worn_tool() -> tuple[Shop, tuple[JobState, ...]]:
    """A shop that has stopped in its second hole, and all states that its journal has kept."""
    shop, kept = Shop(TWO_DEEP_HOLES), Kept()
    shop.stop_when(lambda p: p.sites_done == 1 and p.depth_um > 50.0)
    with pytest.raises(Interrupted):
        shop.run_job(journal=kept)
    return shop, tuple(kept.states)


def left_between_holes(state: JobState) -> bool:
    return len(state.done) == 1 and not state.site


def left_in_a_hole(state: JobState) -> bool:
    return len(state.done) == 1 and state.begun


@pytest.mark.parametrize("when", [left_between_holes, left_in_a_hole])
@pytest.mark.parametrize("rate_um_s", tiers(FAST_UM_S, slow=(-FAST_UM_S,)))
def test_the_next_morning_a_worn_tool_over_the_pad_finds_its_home(
    rate_um_s: float, when: Callable[[JobState], bool]
) -> None:
    left, states = states_on_a_worn_tool()
    state = next(state for state in reversed(states) if when(state))
    assert left.bench.tool_wear_um > 25.0
    shop = Shop(TWO_DEEP_HOLES)
    done = [site_result_of(one) for one in state.done]
    shop.bench.plant.state.wear_um = state.wear_um + math.fsum(site.wear_um for site in done)
    over_the_pad(shop)
    shop.bench.plant.unit.sensor_drift_um_s = rate_um_s
    later(shop, 12.0)
    shop.job = replace(shop.job, resumed=state, pause_s=12.0 * 3600.0)
    shop.tally.sites.update({site.name: site for site in done})
    assert home_found_um(shop) == pytest.approx(rate_um_s * 12.0 * 3600.0, abs=10.0)


@EITHER_WAY
def test_over_a_place_that_is_not_cut_yet_a_touch_measures_home_too(rate_um_s: float) -> None:
    """Stopped above its first hole, before that began; hours later the sensor's zero is unknown."""
    shop, kept = Shop(), Kept()
    shop.told.when[Phase.APPROACHING] = lambda: shop.stop.request(signal.SIGINT)
    with pytest.raises(Interrupted):
        shop.run_job(journal=kept)
    assert not kept.states[-1].begun
    shop.bench.plant.unit.sensor_drift_um_s = rate_um_s
    after = later(shop, 6.0).taken_up(kept.states[-1], 6.0 * 3600.0)
    (site,) = after.run_job().sites
    assert after.holds(site)


@pytest.mark.parametrize(
    ("home_age_s", "pause_s", "known_age_s", "used"),
    [
        (20.0, 60.0, 30000.0, True),
        (math.nan, 60.0, 30000.0, False),
        (20.0, math.inf, 30000.0, False),
        (20.0, 60.0, 300.0, False),
    ],
)
def test_a_home_of_the_journal_is_used_unless_it_is_older_or_unknown(
    home_age_s: float, pause_s: float, known_age_s: float, *, used: bool
) -> None:
    state = JobState("machining", 100.0, "tool", home_um=33.0, home_age_s=home_age_s)
    job = replace(Shop().job, resumed=state, pause_s=pause_s, home_um=7.0, home_age_s=known_age_s)
    assert with_home_left(job).home_um == (33.0 if used else 7.0)


def test_a_home_of_the_ledger_from_the_future_has_no_age_and_is_not_used() -> None:
    """The clock was set back meanwhile: a night may have passed. How fast home moved is known all the same."""
    shop, now_s = Shop(), time.time()
    job, history = shop.job, MachineHistory(homes=[HomeSeen(2.0, now_s - 7200.0, 0.0)])
    assert with_home(job, history, CALENDAR).home_age_s == pytest.approx(7200.0 + REPORT_DELAY_S, abs=5.0)
    history.homes = [HomeSeen(2.0, now_s + 7200.0, 0.0)]
    assert with_home(job, history, CALENDAR) == job
    assert with_home(job, history, Now(10.0)).home_age_s == 10.0 + REPORT_DELAY_S
    history.homes = [HomeSeen(2.0, now_s, math.nan)]
    assert with_home(job, history, Now(10.0)) == job
    # Either way: creep hides a sensor that drifts back, as it enlarges one that drifts on.
    for rate_um_s in (-0.0045, 0.0045):
        history.homes = [HomeSeen(rate_um_s * at_s, now_s + at_s, at_s) for at_s in (2000.0, 4000.0, 6000.0)]
        shop.job = with_home(job, history, CALENDAR)
        assert shop.job.drift_seen_um_s == pytest.approx(0.0045)
        assert math.isnan(shop.job.home_age_s) == math.isnan(job.home_age_s)
        assert half_width(shop.run().uncertainty.drift_u_um_per_s) >= 0.0045


def test_homes_show_a_drift_only_over_time_and_before_a_break_until_there_are_enough_after_it() -> None:
    for homes in (
        [(0.0, 1.0), (1200.0, 0.2), (2400.0, 1.1), (3600.0, 0.4)],  # no drift
        [(0.0, 1.0)],
        [(0.0, 1.0), (300.0, 3.0)],  # too short a time
        [(0.0, 80.0), (2000.0, 79.0), (3000.0, 0.5), (5000.0, 0.3)],  # set anew
        [(0.0, 80.0), (2000.0, 79.0), (1000.0, 0.5), (5000.0, 0.3)],  # clock set back
    ):
        assert contradicting_between_jobs_um_s(homes, 1.0 / 600.0) == 0.0
    homes = [(0.0, 0.0), (3600.0, 6.0), (7200.0, 12.0)]
    before_um_s = contradicting_between_jobs_um_s(homes, 0.0005)
    assert before_um_s > 0.0015
    for new in ((2000.0, 12.5), (7300.0, 80.0), (math.nan, 12.0)):
        assert contradicting_between_jobs_um_s([*homes, new], 0.0005) == before_um_s


@pytest.mark.parametrize("deeper_um", tiers(18.0, slow=(0.0, 6.0)))
def test_home_by_a_hole_that_was_left_includes_how_much_deeper_that_may_be(deeper_um: float) -> None:
    shop = Shop()
    state = shop.left(lambda p: p.depth_um > 6.0)
    shop.bench.plant.unit.sensor_drift_um_s = FAST_UM_S
    drifted_um = FAST_UM_S * TICK_S * shop.bench.plant.readings.tick + FAST_UM_S * 12.0 * 3600.0
    expected = replace(state, depth_um=state.depth_um - deeper_um, feed_u_um=deeper_um / 2.0)
    after = later(shop, 12.0).taken_up(expected, 12.0 * 3600.0)
    run = rested(after)
    retract(run)
    hidden_um = run.watch.rests.hidden_um
    assert abs(after.tally.home_um - drifted_um) < 5.0 + hidden_um
    assert deeper_um < hidden_um < 3.0 * deeper_um + 15.0


def test_a_tool_that_touches_something_at_rest_is_not_moved() -> None:
    shop = Shop()
    run = rested(shop)
    shop.bench.plant.obstacle_um = -1.0
    shop.bench.plant.set_surface()
    run.machine.rest(0.5)
    with refused("E8021"):
        move_to(run, run.job.parking)


def test_a_spot_beside_a_place_is_known_face_and_nothing_else_is() -> None:
    shop = Shop()
    shop.job = replace(shop.job, sites=(Place("a", 500.0, 0.0), Place("b", 1100.0, 0.0)))
    beside_um, run = shop.job.spot_distance_um, shop.run()
    for here, is_spot in (
        ((500.0, beside_um), True),
        ((1100.0, -beside_um), True),
        ((500.0, 0.0), False),
        ((500.0, 0.5 * beside_um), False),
        ((-5000.0, 0.0), False),
    ):
        assert _is_on_a_spot(run, here) is is_spot
    shop.job = replace(shop.job, sites=(*shop.job.sites, Place("c", 500.0, beside_um + 20.0)))
    assert not _is_on_a_spot(shop.run(), (500.0, beside_um))
