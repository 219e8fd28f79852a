"""The main job on the virtual bench: its results, and how it ends when something comes between."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from edmctl.errors import Interrupted, MachineFault, RunFileError
from edmctl.labels import Basis, Verdict
from edmctl.machine.interface import EventCode, MachineState
from edmctl.procedures.settings import controller_settings
from edmctl.record.rows import EventLevel, Row, RunEvent, ServoBlock
from edmctl.results.job import ObjectiveMissed
from edmctl.results.progress import Phase

from .conftest import Done, Seen, Shop


def assert_safe(shop: Shop) -> None:
    status = shop.machine.status()
    assert (status.state, status.actuator_v) == (MachineState.IDLE, 0.0)


def test_depth_wear_and_feed_are_as_wanted_and_hold_the_truth(done: Done) -> None:
    (site,) = done.result.sites
    truth_um = done.shop.bench.truth()[0].depth_um
    assert (site.depth_um, truth_um) == pytest.approx((12.0, 12.0), abs=2.0)
    (row,) = done.shop.seen.sites
    assert (site.depth_basis, site.wear_basis, site.estimated_um) == (Basis.TOUCHED, Basis.TOUCHED, 0.0)
    assert (site.verdict, row.verdict, row.depth_basis) == (Verdict.SHOWN, "shown", "touched")
    assert abs(truth_um - site.depth_um) <= site.depth_u95_um
    assert site.feed_um == pytest.approx(site.depth_um + site.wear_um, abs=1e-9)
    assert site.feed_um == pytest.approx(site.z2_um - site.z1_um, abs=1e-9)
    assert site.wear_um == pytest.approx(done.shop.bench.tool_wear_um, abs=1.0)
    assert site.depth_model_um == pytest.approx(site.depth_um, abs=2.0)
    assert site.depth_model_um != site.depth_um
    assert all(np.isfinite(touch.model_um) for touch in done.shop.seen.touches)
    assert_safe(done.shop)


def test_times_pulses_energy_and_volumes_add_up(done: Done) -> None:
    """Energy per discharge, because the first sparks of an approach come before the cut; 4 % are shorts."""
    result, (site,), ratios = done.result, done.result.sites, done.result.sites[0].ratios
    assert result.machining_time_s == pytest.approx(site.machining_time_s)
    assert result.time_s == pytest.approx(result.machining_time_s + result.measuring_time_s)
    assert result.time_s == pytest.approx(done.shop.bench.transport.now_s(), abs=1.0)
    assert result.reached is None
    assert site.pulses == pytest.approx(2300 * site.machining_time_s, rel=0.02)
    assert ratios.open + ratios.normal + ratios.arc + ratios.short == pytest.approx(1.0)
    assert ratios.normal > 0.4
    blocks = done.shop.seen.pulses
    pulses_uj = sum(float(block.energy_uj.sum()) for block in blocks)
    discharges = sum(int(block.n_normal.sum() + block.n_arc.sum()) for block in blocks)
    counted = site.pulses * (ratios.normal + ratios.arc)
    assert site.energy_j == pytest.approx(1e-6 * pulses_uj / discharges * counted, rel=0.01)
    row, side_um = done.shop.seen.sites[-1], done.shop.profile.work.side_gap_um
    assert row.energy_j == site.energy_j
    tool_um2, hole_um2 = math.pi / 4.0 * 270.0**2, math.pi / 4.0 * (270.0 + 2.0 * side_um) ** 2
    assert row.wear_ratio_lin == pytest.approx(site.wear_um / site.depth_um)
    assert row.wear_ratio_vol == pytest.approx(site.wear_um * tool_um2 / (site.depth_um * hole_um2))
    assert row.mrr_mm3_min == pytest.approx(6e-8 * site.depth_um * hole_um2 / site.machining_time_s)
    assert row.depth_model_error_um == pytest.approx(site.depth_model_um - site.depth_um)
    assert row.wear_model_error_um == pytest.approx(site.wear_model_um - site.wear_um)


def test_the_stages_only_move_with_the_tool_up_and_every_sample_is_recorded_once(done: Done) -> None:
    safe_um = controller_settings(done.shop.profile, done.shop.job.setup).safe_z_um
    moves = done.shop.seen.args(EventCode.STAGE_DONE)
    assert len(moves) >= 4
    assert max(float(args["displacement_um"]) for args in moves) < safe_um
    assert max(float(args["actuator_v"]) for args in moves) == 0.0
    times, states, direction = map(done.shop.seen.column, ("time_s", "state", "direction"))
    assert np.diff(times) == pytest.approx(0.01, abs=1e-6)
    machining = states == MachineState.MACHINING
    assert set(np.unique(direction[machining])) == {-1, 1}
    assert set(np.unique(direction[~machining])) <= {0, 1}


def test_the_supervisor_writes_two_rows_a_second_of_virtual_time(done: Done) -> None:
    (site,), rows = done.result.sites, done.shop.seen.slow
    assert len(rows) >= 1.9 * site.machining_time_s
    steps_s = [after.time_s - before.time_s for before, after in pairwise(rows)]
    assert max(step_s for step_s in steps_s if step_s < 5.0) <= 0.501  # longer ones are measuring stops
    last = rows[-1]
    assert (last.depth_um, last.wear_um) == pytest.approx((site.depth_um, site.wear_um), abs=1.0)
    assert (last.dielectric_c, last.flow_lpm) == pytest.approx((22.0, 1.2))
    assert math.isnan(last.jump_period_s)
    assert last.link_errors == 0


def test_readings_decisions_and_the_line_are_recorded(done: Done) -> None:
    seen, (site,) = done.shop.seen, done.result.sites
    assert [touch.kind for touch in seen.touches] == ["Z1"] * 2 + ["Z2", "Z3", "Z3"] * site.measuring_stops
    expected = {RunEvent.CONDITIONED, RunEvent.CUT_PLANNED, RunEvent.CUT_ENDED, RunEvent.TARGET_REACHED}
    assert expected <= set(seen.codes)
    assert seen.sites[-1].depth_um == site.depth_um
    for text in ("from the target", "(feed reached)"):
        assert any(text in note for note in done.shop.told.notes)
    codes = [seen.codes.index(code) for code in (RunEvent.ARMED, RunEvent.SELF_TESTED, RunEvent.STAGE_MOVED)]
    assert codes == sorted(codes)
    assert seen.codes.count(RunEvent.LINK) == 1
    assert done.result.link is not None
    assert done.result.link.lost_frames == 0


def test_a_job_on_a_line_without_frames_is_the_job_on_a_line_with_them(done: Done) -> None:
    direct = Shop(direct=True)
    result = direct.run_job()
    assert (result.sites, result.time_s) == (done.result.sites, done.result.time_s)
    for name in ("time_s", "displacement_um", "model_um", "gap_v", "state"):
        np.testing.assert_array_equal(direct.seen.column(name), done.shop.seen.column(name), err_msg=name)


def interrupt(_: Shop) -> None:
    raise KeyboardInterrupt


def ask(number: int) -> Callable[[Shop], None]:
    return lambda s: s.stop.request(number)


@pytest.mark.parametrize(
    ("phase", "act", "error"),
    [
        (Phase.MOVING, ask(signal.SIGINT), Interrupted),
        (Phase.APPROACHING, ask(signal.SIGTERM), Interrupted),
        (Phase.MACHINING, ask(signal.SIGTERM), Interrupted),
        (Phase.MACHINING, interrupt, KeyboardInterrupt),
    ],
)
def test_an_interrupt_in_any_phase_ends_retracted_and_idle(
    phase: Phase, act: Callable[[Shop], None], error: type[BaseException]
) -> None:
    s = Shop()
    s.told.when[phase] = lambda: act(s)
    with pytest.raises(error) as caught:
        s.run_job()
    assert_safe(s)
    result = s.tally.result()
    if phase is not Phase.MACHINING:
        assert result.reached is None
    elif isinstance(caught.value, Interrupted):
        assert caught.value.signal_number == signal.SIGTERM
        assert s.tally.time_s > 20.0
        (site,) = result.sites
        assert (site.depth_basis, site.cuts, site.finished) == (Basis.ESTIMATED, 1, False)
        assert s.holds(site)


def test_a_job_stopped_in_the_middle_of_a_cut_says_how_far_it_came() -> None:
    s = Shop()
    s.stop_when(lambda p: p.depth_um >= 6.0, signal.SIGTERM)
    with pytest.raises(Interrupted):
        s.run_job()
    result = s.tally.result()
    machining_s = s.seen.slow[-1].time_s - s.seen.slow[0].time_s
    assert result.machining_time_s == pytest.approx(machining_s, abs=0.5)
    assert result.machining_time_s > 2.0
    assert result.measuring_time_s == pytest.approx(result.time_s - machining_s, abs=0.5)
    assert result.tool_wear_total_um == result.sites[0].wear_um > 0.5
    assert result.reached is not None
    assert result.reached.site == s.job.sites[0].name
    assert result.reached.depth_estimated_um == pytest.approx(s.bench.truth()[0].depth_um, abs=1.0)
    assert result.reached.depth_target_um == 12.0
    assert s.told.notes[-1] == "Stopped at about 6 µm of 12 µm, not measured."
    assert (s.seen.events[-2][1], s.seen.events[-2][3]) == (RunEvent.LEFT_UNMEASURED, s.told.notes[-1])


def test_no_cut_begins_when_no_time_is_left_for_it() -> None:
    s = Shop(("limits.max_time_s=40.0",))
    with pytest.raises(ObjectiveMissed, match="No time is left for cut 1") as caught:
        s.run_job()
    assert "limits.max_time_s allows the job 40 s" in caught.value.message
    assert "a depth of 0.00 of 12 µm" in caught.value.message
    assert not any(p.phase is Phase.MACHINING for p in s.told.states)
    assert s.bench.truth() == () or s.bench.truth()[0].depth_um < 1.0
    assert_safe(s)


def test_no_second_cut_begins_when_the_time_is_up_after_the_first() -> None:
    s = Shop(("wear.first_fraction=0.5", "limits.max_time_s=84.0"))
    with pytest.raises(ObjectiveMissed, match="No time is left for cut 2") as caught:
        s.run_job()
    (site,) = caught.value.result.sites
    assert site.cuts == 1
    assert f"a depth of {site.depth_um:.2f} of 12 µm" in caught.value.message
    assert [row.depth_um for row in s.seen.sites] == [site.depth_um]
    assert caught.value.result.reached is None


def test_an_interrupt_in_the_second_cut_keeps_what_the_first_one_reached() -> None:
    s = Shop(("wear.first_fraction=0.5",))

    def at_the_next_approach() -> None:
        s.told.when[Phase.APPROACHING] = lambda: s.stop.request(signal.SIGINT)

    s.told.when[Phase.JUMPING] = s.told.when[Phase.MACHINING] = at_the_next_approach
    with pytest.raises(Interrupted):
        s.run_job()
    (site,) = s.tally.result().sites
    assert site.depth_um == pytest.approx(5.5, abs=1.5)
    assert (site.depth_basis, site.verdict, site.finished) == (Basis.TOUCHED, None, False)
    assert [row.depth_um for row in s.seen.sites] == [site.depth_um]
    assert_safe(s)


def test_a_fault_in_the_second_cut_leaves_an_estimate_and_no_verdict() -> None:
    s = Shop(("wear.first_fraction=0.5",))

    def look() -> None:
        p = s.told.states[-1]
        if p.step == "cut 2" and p.depth_um > 8.0:
            s.bench.plant.estop = True
        else:
            s.told.when[Phase.MACHINING] = look

    s.told.when[Phase.MACHINING] = look
    with pytest.raises(MachineFault) as caught:
        s.run_job()
    (site,), (row,), (hole,) = s.tally.result().sites, s.seen.sites, s.bench.truth()
    assert hole.depth_um > 7.5
    assert (site.depth_basis, site.wear_basis, site.verdict) == (Basis.ESTIMATED, Basis.ESTIMATED, None)
    assert abs(site.depth_um - hole.depth_um) <= site.depth_u95_um < 6.0
    assert abs(site.wear_um - s.bench.tool_wear_um) <= site.wear_u95_um < 4.0
    assert site.estimated_um == pytest.approx(site.depth_um - 5.5, abs=1.5)
    assert (site.cuts, site.measuring_stops) == (2, 1)
    assert site.machining_time_s == pytest.approx(s.tally.machining_time_s)
    assert (row.depth_um, row.depth_basis, row.verdict) == (site.depth_um, Basis.ESTIMATED, None)
    reached = s.tally.result().reached
    assert reached is not None
    assert (reached.depth_estimated_um, reached.depth_estimated_u95_um) == (site.depth_um, site.depth_u95_um)
    assert caught.value.fault == 4001
    _, code, level, message, args = s.seen.events[-1]
    assert (code, level) == (RunEvent.ENDED_EARLY, EventLevel.ERROR)
    assert (message, args["code"]) == (caught.value.message, "E64001")
    status = s.machine.status()
    assert (status.state, status.actuator_v) == (MachineState.ESTOP, 0.0)


def test_a_full_disk_in_the_middle_of_a_cut_ends_retracted() -> None:
    class FullDisk(Seen):
        def append(self, row: Row) -> None:
            if isinstance(row, ServoBlock) and row.state[-1] == MachineState.MACHINING:
                raise RunFileError("no space left", code="E9003")

    s = Shop()
    with pytest.raises(RunFileError):
        s.run_job(FullDisk())
    assert_safe(s)


@pytest.mark.parametrize(
    ("overrides", "message", "hint", "depth_um"),
    [
        (["limits.max_time_s=52.0"], "a depth of", "limits.max_time_s", (0.5, 10.0)),
        ([], "stopped advancing", "", (-1.0, 1.0)),
        (
            ["wear.expected_ratio=1.0", "wear.max_cuts=1"],
            "from the target",
            "wear.expected_ratio",
            (14.0, 40.0),
        ),
    ],
    ids=["time is up", "stalled", "too deep"],
)
def test_a_job_that_misses_its_target_is_measured_and_ends_in_order(
    overrides: list[str], message: str, hint: str, depth_um: tuple[float, float]
) -> None:
    s = Shop(overrides)
    if not overrides:  # nothing sparks any more
        s.told.when[Phase.MACHINING] = lambda: setattr(s.bench.plant.unit, "threshold_uj", 1e9)
    with pytest.raises(ObjectiveMissed, match=message) as caught:
        s.run_job()
    (site,) = caught.value.result.sites
    assert caught.value.exit_code == 7
    assert hint in caught.value.hint
    assert (site.cuts, len(s.seen.sites)) == (1, 1)
    assert depth_um[0] < site.depth_um < depth_um[1]
    assert site.depth_um == pytest.approx(s.bench.truth()[0].depth_um, abs=1.0)
    assert overrides or site.machining_time_s == pytest.approx(60.0, abs=3.0)
    assert_safe(s)
