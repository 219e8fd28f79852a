"""What the host finds by itself: the line, the sensor against the model, a wrong or doubtful setup, the time."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from edmctl import labels
from edmctl.errors import MachineFault
from edmctl.link.faults import FaultCode
from edmctl.link.frame import FrameDecoder
from edmctl.link.messages import WaveformRead
from edmctl.machine.interface import Machine, MachineState
from edmctl.planning.forecast import forecast, stroke_um
from edmctl.procedures.hole.decision import refuse_wrong_setup
from edmctl.procedures.monitoring.monitors import LinkMonitor, SensorMonitor, judge_job, record_link
from edmctl.procedures.run import JobRun
from edmctl.procedures.servo.limits import LEAST_S, LONGEST_SHARE, TimeLimits
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.process.plane import Step
from edmctl.process.touches import (
    DepthAndWear,
    Reading,
)
from edmctl.quantity import Value
from edmctl.record.rows import Row, RunEvent
from edmctl.results.job import Belief
from edmctl.results.progress import Phase
from edmctl.results.telemetry import LinkReport, TelemetryBlock, WaveformBatch

from .conftest import Seen, Shop, refused
from .test_supervisor import a_slice

REPORT = LinkReport(
    frames_sent=12_345_678,
    frames_received=98_765_432,
    bad_frames=1234,
    retries=1234,
    lost_frames=1234,
    controller_bad_frames=65535,
    controller_dropped_frames=65535,
    rtt_p50_ms=1.2345,
    rtt_p99_ms=12.3456,
    clock_offset_s=-123456.789012,
    clock_rate_ppm=-123.456,
    clock_residual_us=123.456,
)


class Line:
    def __init__(self) -> None:
        self.bad_frames = 0
        self.time_s = 0.0

    def link_report(self) -> LinkReport:
        return REPORT


def watched() -> tuple[Shop, Line, LinkMonitor]:
    s, line = Shop(), Line()
    return s, line, LinkMonitor(replace(s.run(), machine=cast("Machine", line)))


@pytest.mark.parametrize(("bad", "warnings"), [(lambda i: i in (2, 4, 6), 1), (lambda i: i % 10 == 0, 0)])
def test_three_damaged_frames_in_a_second_are_reported_and_ten_end_the_job_once(
    bad: Callable[[int], bool], warnings: int
) -> None:
    s, line, watch = watched()
    for i in range(100):
        line.bad_frames += bad(i)
        watch.on_telemetry(a_slice(i, 50.0))
    found = s.seen.messages(RunEvent.LINE_NOISE)
    assert len(found) == warnings
    assert all(one.startswith("The line is disturbed: 3 damaged frames") for one in found)
    line.bad_frames += 10
    with pytest.raises(MachineFault, match=r"1[01] damaged frames") as caught:
        watch.on_telemetry(a_slice(100, 50.0))
    assert (caught.value.code, caught.value.fault) == ("E61003", FaultCode.LINE_NOISE)
    watch.on_telemetry(a_slice(101, 50.0))


def test_the_line_is_recorded_every_ten_seconds() -> None:
    s, _, watch = watched()
    for i in range(1250):
        watch.on_telemetry(a_slice(i, 50.0))
    times_s = [row.time_s for row in s.seen.links]
    assert times_s == pytest.approx(10.0 * np.arange(1, len(times_s) + 1), abs=0.11)
    assert len(times_s) == 12
    assert s.seen.links[0].report == REPORT
    assert RunEvent.LINK not in s.seen.codes


def test_the_end_of_a_run_sums_the_line_up_in_an_event() -> None:
    s, line = Shop(), Line()
    record_link(replace(s.run(), machine=cast("Machine", line)))
    (message,) = s.seen.messages(RunEvent.LINK)
    assert message.startswith(f"Link: {REPORT.frames_received} frames in, {REPORT.bad_frames} damaged")
    assert len(s.seen.links) == 1


def compared() -> tuple[Shop, SensorMonitor, float]:
    s = Shop()
    return s, SensorMonitor(s.run()), 0.15 * stroke_um(s.profile)


def both(i: int, sensor_um: float, model_um: float) -> tuple[TelemetryBlock, np.ndarray]:
    return a_slice(i, sensor_um), np.full(10, model_um)


def test_a_sensor_off_the_model_is_told_at_once_and_stops_after_two_seconds() -> None:
    s, watch, limit_um = compared()
    watch.update(*both(0, 50.0, 50.0 - 0.9 * limit_um))
    assert RunEvent.Z_MISMATCH not in s.seen.codes
    watch.update(*both(1, 50.0, 50.0 - 1.1 * limit_um))
    (message,) = s.seen.messages(RunEvent.Z_MISMATCH)
    assert "shows 50.0 µm and the model" in message
    for i in range(2, 20):
        watch.update(*both(i, 50.0, 50.0 - 1.1 * limit_um))
    with pytest.raises(MachineFault) as caught:
        watch.update(*both(21, 50.0, 50.0 - 1.1 * limit_um))
    assert (caught.value.code, caught.value.exit_code) == ("E67001", 6)
    assert "edmctl calibrate" in caught.value.hint
    watch.update(*both(30, 50.0, 0.0))


def test_a_mismatch_that_passes_stops_nothing() -> None:
    s, watch, limit_um = compared()
    for i in range(100):
        watch.update(*both(i, 50.0, 50.0 - (1.1 * limit_um if i % 20 < 15 else 0.0)))
    assert s.seen.codes.count(RunEvent.Z_MISMATCH) == 5


@pytest.mark.parametrize(
    ("depth_um", "wear_um", "wrong"),
    [
        (20.0, 8.0, False),
        (20.0, 24.0, False),  # 3 times 0.389 of 20 µm is 23.3 µm; the measurement is not that good
        (-0.5, 0.5, False),
        (0.0, 0.5, False),
        (20.0, 26.0, True),
        (-1.5, 8.0, True),
    ],
)
def test_wear_far_too_fast_or_a_hill_is_a_wrong_setup_as_far_as_the_measurement_shows_it(
    depth_um: float, wear_um: float, *, wrong: bool
) -> None:
    s = Shop()
    found = DepthAndWear(Value(depth_um, 0.5), Value(wear_um, 0.5), Value(depth_um + wear_um, 0.5), 0.1)
    with refused("E67005", f"a wear of {wear_um:.2f} µm") if wrong else nullcontext():
        refuse_wrong_setup(s.run(), found)
    assert s.seen.codes.count(RunEvent.SETUP_WRONG) == wrong


def test_a_long_job_has_three_times_its_forecast_unless_the_recipe_limits_it() -> None:
    s = Shop(('target={kind="depth",depth_um=150.0,tolerance_um=2.0}', "pulse.current_a=0.12"))
    most_s = LONGEST_SHARE * forecast(s.profile, s.job.setup).machining_time_s
    assert most_s > LEAST_S
    limits = TimeLimits(s.run())
    s.tally.machining_time_s += most_s - 7.0
    assert limits.left().seconds == pytest.approx(7.0)
    assert "the forecast allows" in limits.left().limit
    left = TimeLimits(Shop(("limits.max_time_s=60.0",)).run()).left()
    assert (round(left.seconds, 6), left.limit) == (60.0, "limits.max_time_s allows the job 60 s")


def test_a_job_beyond_its_forecast_is_ended_and_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edmctl.procedures.servo.limits.LEAST_S", 0.0)
    monkeypatch.setattr("edmctl.procedures.servo.limits.LONGEST_SHARE", 0.3)
    s = Shop()
    with refused("E7012", r"the forecast allows \d s of machining"):
        s.run_job()
    (site,) = s.tally.result().sites
    assert site.depth_um == pytest.approx(s.bench.truth()[0].depth_um, abs=1.0)


def test_a_dead_gap_sensor_refuses_the_start() -> None:
    s = Shop()
    s.inject("GAP_SENSOR_LOW@arm+0")
    with refused("E63003"):
        s.run_job()
    assert RunEvent.STAGE_MOVED not in s.seen.codes


class Box(Seen):
    def append(self, row: Row) -> None:
        if isinstance(row, TelemetryBlock):
            self.box = row
        elif isinstance(row, WaveformBatch):
            self.gap = row
        else:
            super().append(row)


def test_a_latched_fault_brings_the_black_box_into_the_run_file() -> None:
    s, seen = Shop(), Box()
    s.inject("ESTOP")
    with pytest.raises(MachineFault):
        s.run_job(seen)
    assert len(seen.box.time_s) == 2048
    assert seen.box.state[-1] == MachineState.MACHINING
    fault_s = seen.box.time_s[-1]
    assert seen.gap.time_s[0] < fault_s - 0.02
    assert seen.gap.time_s[-1] > fault_s + 0.005
    burning_a = seen.gap.current_a[(seen.gap.time_s < fault_s) & (seen.gap.current_a > 0.1)]
    assert np.median(burning_a) == pytest.approx(0.5, rel=0.1)
    assert seen.gap.current_a[seen.gap.time_s > fault_s + 1e-5].max() < 0.01
    retreat = seen.column("time_s")
    assert retreat[-1] > fault_s
    assert RunEvent.LINK in seen.codes


def test_a_fault_of_the_host_has_no_black_box() -> None:
    s, seen = Shop(), Box()

    def press() -> None:
        raise MachineFault("made up", code="E67001", fault=7001)

    s.told.when[Phase.MACHINING] = press
    with pytest.raises(MachineFault):
        s.run_job(seen)
    assert not hasattr(seen, "box")
    assert not hasattr(seen, "gap")


@pytest.mark.parametrize("dies_after", [0, 1, 200])
def test_a_line_that_dies_while_a_fault_is_read_does_not_hide_the_fault(
    dies_after: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    s, seen, asked = Shop(), Box(), [0]
    write = s.bench.transport.write

    def mute(data: bytes) -> None:
        write(data)
        asked[0] += sum(frame.type_id == WaveformRead.ID for frame in FrameDecoder().feed(data))
        s.bench.line.silent = s.bench.line.unplugged = asked[0] > dies_after

    monkeypatch.setattr(s.bench.transport, "write", mute)
    s.inject("ESTOP")
    with refused("E64001", "Emergency stop"):
        s.run_job(seen)
    assert len(seen.box.time_s) == 2048
    assert not hasattr(seen, "gap")
    assert asked[0] == dies_after + 1
    assert seen.events[-1][1] == RunEvent.ENDED_EARLY


def test_swings_too_fast_to_learn_from_are_a_precondition() -> None:

    s = Shop()
    actuator = s.job.setup.actuator.model_copy(
        update={"conditioning_cycles": 1, "conditioning_slew_v_s": 1000.0}
    )
    s.job = replace(s.job, setup=s.job.setup.model_copy(update={"actuator": actuator}))
    with refused("E8036", "conditioning swings tell too little"):
        s.run_job()


TOUCH_SD_UM = 0.06
"""Of one touch on the virtual machine."""
WAY_UM = 300.0
"""Between the spots of the pad."""


def touched(slopes_mrad: tuple[float, ...], scatter_dof: int) -> JobRun:
    """A run with readings of the pad that show such slopes, and with so many touches besides."""
    run = Shop().run()
    run.tally.scatter.add(Reading(0.0, TOUCH_SD_UM, scatter_dof + 1))
    pads = [
        SurfaceReading(
            "Z1", Reading(0.0, 0.0, 3), 0.0, 0.0, 200.0 * i, math.nan, step=Step((WAY_UM, 0.0), um, (2, 1))
        )
        for i, um in enumerate(1e-3 * WAY_UM * slope for slope in slopes_mrad)
    ]
    judge_job(run, pads)
    return run


def belief(run: JobRun, name: str) -> Belief:
    return next(one for one in run.tally.beliefs if one.name == name)


def test_a_tilt_that_the_touches_of_a_job_show_contradicts_its_belief() -> None:
    """Two readings with a spread of 0.06 µm know it within 0.2 mrad, whatever was expected of them beforehand."""
    tilt = belief(touched((0.9, 0.8), 4), "surface.tilt_u_mrad")
    assert tilt.found == pytest.approx(0.85)
    assert tilt.found_u < 0.25
    assert tilt.seen is labels.Seen.CONTRADICTED
    assert belief(touched((0.5, 0.6), 4), "surface.tilt_u_mrad").seen is labels.Seen.HELD
    assert belief(touched((0.9, 0.8), 1), "surface.tilt_u_mrad").seen is labels.Seen.HELD


@pytest.mark.parametrize(
    ("span_s", "zero_um", "seen"),
    [
        pytest.param(300.0, 1.8, labels.Seen.HELD, id="creep may be most of it"),
        pytest.param(300.0, 4.0, labels.Seen.CONTRADICTED, id="more than creep explains"),
        pytest.param(300.0, -2.0, labels.Seen.CONTRADICTED, id="against all creep"),
        pytest.param(50.0, 3.0, labels.Seen.NOT, id="too short a time"),
        pytest.param(math.nan, 0.0, labels.Seen.NOT, id="no rests"),
    ],
)
def test_a_drift_is_judged_without_a_file_with_creep_in_its_uncertainty(
    span_s: float, zero_um: float, seen: labels.Seen
) -> None:
    run = Shop().run()
    if math.isfinite(span_s):
        run.watch.rests.note(0.0, 0.0)
        run.watch.rests.reach(0.0, 100.0)
        run.watch.rests.note(span_s, zero_um)
    judge_job(run, [])
    drift = belief(run, "sensor.drift_um_per_s")
    assert drift.seen is seen
    if seen is not labels.Seen.NOT:
        assert abs(drift.found - zero_um / 300.0) <= 0.5 / 300.0 + 1e-9
        assert 0.0 < drift.found_u < 0.003
