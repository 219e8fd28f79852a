"""What a resumed job still has to do, as its dry run states it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from edmctl.jobs.plan import JobRequest, Plan, Resumption, check, with_resumed
from edmctl.procedures.job import job_of
from edmctl.procedures.job_state import JobState

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
    assert plan.forecast_left() is None
    assert plan.loaded.warnings == ()
    assert plan.resumed is not None
    assert plan.resumed.message().endswith("Nothing is left.")


def test_the_time_limit_is_judged_by_what_remains() -> None:
    whole_s = resumed(0, GRID).forecast.time_s
    limit = f"limits.max_time_s={0.5 * whole_s:.0f}"
    (warning,) = resumed(0, GRID, limit).loaded.warnings
    assert f"about {whole_s:.0f} s" in warning.message
    plan = resumed(3, GRID, limit)
    left = plan.forecast_left()
    assert left is not None
    assert left.holes == 1
    assert plan.loaded.warnings == ()
