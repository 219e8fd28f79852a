"""What the plan of a job refuses, and what a resumed job still has to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from edmctl.errors import ProfileError
from edmctl.failures import Code
from edmctl.jobs.plan import JobRequest, Plan, Resumption, check, with_resumed
from edmctl.procedures.job import JobState, job_of
from edmctl.profile.setup import Setup
from edmctl.simulator.work_under_tool import EDGE_X_UM

GRID = 'sites=[{kind="grid",x_um=600,columns=2,rows=2,dx_um=400,dy_um=400}]'


def resumed(done: int, *overrides: str) -> Plan:
    """The plan of a job whose first holes are finished."""
    plan = check(JobRequest("cu270", ("target.depth_um=20", *overrides), None, None))
    names = [site.name for site in job_of(plan.loaded.profile, plan.setup, plan.loaded.places).sites]
    job: Any = SimpleNamespace(run_id="j1", places=[(name,) for name in names])
    state = JobState("moving", 0.0, "Cu", done=tuple({"name": name} for name in names[:done]))
    journal: Any = SimpleNamespace(job=job)
    return with_resumed(plan, Resumption(Path("j1.journal"), journal, state, homed=False))


@pytest.mark.parametrize(("done", "overrides"), [(1, ()), (4, (GRID,))])
def test_nothing_is_left_of_a_job_whose_holes_are_finished(done: int, overrides: tuple[str, ...]) -> None:
    plan = resumed(done, *overrides, "limits.max_time_s=150")
    assert plan.forecast_remaining() is None
    assert plan.loaded.warnings == ()
    assert plan.resumed is not None
    assert plan.resumed.message().endswith("Nothing is left.")


def test_the_time_limit_is_judged_by_what_remains() -> None:
    whole_s = resumed(0, GRID).forecast.time_s
    limit = f"limits.max_time_s={0.5 * whole_s:.0f}"
    (warning,) = resumed(0, GRID, limit).loaded.warnings
    assert f"about {whole_s:.0f} s" in warning.message
    plan = resumed(3, GRID, limit)
    left = plan.forecast_remaining()
    assert left is not None
    assert left.holes == 1
    assert plan.loaded.warnings == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("reference_x_um = 2000.0\nreference_y_um = 1000.0\npark_x_um = 9000.0\n", "the parking place at"),
        ("reference_x_um = -3000.0\n", "the reference pad at"),
        ("park_x_um = -20000.0\n", "site-1 at"),
    ],
)
def test_a_setup_that_does_not_fit_the_virtual_workpiece_is_refused(
    tmp_path: Path, text: str, words: str
) -> None:
    file = tmp_path / "setup.toml"
    file.write_text(f"[stage]\n{text}")
    request = JobRequest("cu270", ("sites=[{x_um=-2500.0}]",) if "site" in words else (), file, None)
    with pytest.raises(ProfileError, match=words) as caught:
        check(request)
    assert caught.value.diagnostics[0].code == Code.OUT_OF_REACH
    assert check(replace(request, port="/dev/ttyACM0")).setup.file == file


def test_the_virtual_workpiece_is_that_of_the_stock_machine() -> None:
    (edge,) = Setup().workpiece_limits()
    assert (edge.ux, edge.uy, -edge.um) == (-1.0, 0.0, EDGE_X_UM)
