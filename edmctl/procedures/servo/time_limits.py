"""How long a job may go on: as long as its recipe allows, and not much longer than was forecast."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.profile.forecast import forecast
from edmctl.profile.places import Place

if TYPE_CHECKING:
    from edmctl.procedures.run import Run

LONGEST_SHARE = 3.0
"""Of the forecast machining time: a job that takes longer is not the one that was planned."""
LEAST_S = 120.0
"""A short job is given this much in any case, twice what it takes to find that the tool has stopped advancing."""


@dataclass(frozen=True, slots=True)
class TimeLeft:
    """Seconds until a limit, and which one it is, in words."""

    seconds: float
    limit: str


class TimeLimits:
    """The limits of one run: of the whole job, and of the time in which it machines."""

    def __init__(self, run: Run) -> None:
        self._run = run
        places = [Place(s.name, s.x_um, s.y_um, s.theta_deg, s.depth_um, 0) for s in run.job.sites]
        expected_s = forecast(run.profile, run.setup, places).machining_time_s
        self._machining_s = max(LEAST_S, LONGEST_SHARE * expected_s)
        self._before_s = run.tally.machining_time_s

    def left(self) -> TimeLeft:
        """The limit that comes first, as it stands now."""
        job_s = self._run.profile.limits.max_time_s
        whole = TimeLeft(
            job_s - self._run.machine.time_s,
            f"limits.max_time_s allows the job {job_s:.0f} s",
        )
        machined_s = self._run.tally.machining_time_s - self._before_s
        machining = TimeLeft(
            self._machining_s - machined_s,
            f"the forecast allows {self._machining_s:.0f} s of machining",
        )
        return min(whole, machining, key=lambda left: left.seconds)
