"""Beliefs of the setup against what touches and rests show: named where they are contradicted, and rarely else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edmctl.labels import Seen
from edmctl.procedures.monitoring.monitors import judge_job
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.reading import SurfaceReading
from edmctl.process.plane import Step
from edmctl.process.touches import (
    LEAST_SCATTER_DOF,
    TOUCH_CHECK_SD_UM,
    Reading,
    TouchScatter,
    reading_of,
)
from edmctl.results.job import Belief
from tests.procedures.conftest import Shop

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
    assert tilt.seen is Seen.CONTRADICTED
    assert belief(touched((0.5, 0.6), 4), "surface.tilt_u_mrad").seen is Seen.HELD
    assert belief(touched((0.9, 0.8), 1), "surface.tilt_u_mrad").seen is Seen.HELD


def test_few_touches_that_agree_by_chance_are_not_believed_to_scatter_so_little() -> None:
    noise = np.random.default_rng(3)
    held, trials = 0, 4000
    for _ in range(trials):
        scatter = TouchScatter()
        for _ in range(LEAST_SCATTER_DOF):
            scatter.add(reading_of(tuple(TOUCH_SD_UM * noise.standard_normal(2))))
        held += abs(TOUCH_SD_UM * noise.standard_normal()) <= 1.96 * scatter.u_um
    assert held >= 0.93 * trials
    assert TouchScatter().u_um == TOUCH_CHECK_SD_UM


@pytest.mark.parametrize(
    ("zero_um", "seen"),
    [
        pytest.param(1.8, Seen.HELD, id="creep may be most of it"),
        pytest.param(4.0, Seen.CONTRADICTED, id="more than creep explains"),
        pytest.param(-2.0, Seen.CONTRADICTED, id="against all creep"),
    ],
)
def test_a_drift_is_judged_without_a_file_with_creep_in_its_uncertainty(zero_um: float, seen: Seen) -> None:
    run = Shop().run()
    run.watch.rests.note(0.0, 0.0)
    run.watch.rests.reach(0.0, 100.0)
    run.watch.rests.note(300.0, zero_um)
    judge_job(run, [])
    drift = belief(run, "sensor.drift_um_per_s")
    assert drift.seen is seen
    assert abs(drift.found - zero_um / 300.0) <= 0.5 / 300.0 + 1e-9
    assert 0.0 < drift.found_u < 0.003


def test_over_a_short_time_rests_tell_no_drift() -> None:
    run = Shop().run()
    judge_job(run, [])
    assert belief(run, "sensor.drift_um_per_s").seen is Seen.NOT
    run.watch.rests.note(0.0, 0.0)
    run.watch.rests.note(50.0, 3.0)
    judge_job(run, [])
    assert belief(run, "sensor.drift_um_per_s").seen is Seen.NOT


def test_beliefs_that_are_right_are_contradicted_once_in_twenty() -> None:
    """Slopes as the setup believes, seen with the scatter of the touches."""
    noise, alarms, trials = np.random.default_rng(5), 0, 300
    for _ in range(trials):
        true_mrad = 0.3 * noise.standard_normal()
        spread_mrad = 1e3 * TOUCH_SD_UM * math.sqrt(1.5) / WAY_UM
        slopes = tuple(true_mrad + spread_mrad * noise.standard_normal(2))
        alarms += belief(touched(slopes, 6), "surface.tilt_u_mrad").seen is Seen.CONTRADICTED
    assert alarms <= 0.07 * trials
