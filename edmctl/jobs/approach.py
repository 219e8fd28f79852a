"""`approach` on a connected machine: to the spark gap or the surface, clear of every hole."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from edmctl.forecasts.forecast import STROKE_RESERVE_UM
from edmctl.jobs.job_preparation import hole_radius_um, logbook_of, prepared_job
from edmctl.jobs.ledger.places_taken import refuse_pad, refuse_taken
from edmctl.jobs.ledger.tool_identity import tool_identity
from edmctl.jobs.ledger.tool_life import refuse_too_short
from edmctl.procedures.touch.approach import find_contact, find_gap
from edmctl.profile.places import Place

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from edmctl.jobs.job_preparation import Prepared
    from edmctl.jobs.plan import Plan
    from edmctl.jobs.procedure_command import Warn
    from edmctl.jobs.run_header import RunName
    from edmctl.jobs.session import MachineSession
    from edmctl.procedures.job import Job
    from edmctl.procedures.run import JobRun
    from edmctl.results.measurements import SurfaceFound


def checked_site(
    prepared: Prepared, place: tuple[float, float] | None, folder: Path, port: str, *, contact: bool
) -> Place:
    """Return the place to approach.

    Raises PreconditionError: E8042 a hole is there, or the pad where sparks would be made, E8044 the tool does not
    reach the surface.
    """
    job = prepared.job
    first = job.sites[0]
    site = Place("the place", *place) if place else replace(first, name="the next place")
    own_way_um = job.profile.approach.offset_um + STROKE_RESERVE_UM
    if not math.isnan(prepared.account.pad_um):
        refuse_too_short(job.profile, job.setup, own_way_um, prepared.account, port)
    if not contact:
        refuse_pad((site.name, site.x_um, site.y_um), job)
    refuse_taken([(site.name, site.x_um, site.y_um)], hole_radius_um(job.profile), prepared.holes, folder)
    return site


@dataclass(slots=True)
class Approach:
    """One approach."""

    plan: Plan
    place: tuple[float, float] | None
    contact: bool
    found: SurfaceFound | None = None
    _site: Place | None = None
    name: str = "approach"

    @property
    def pulses(self) -> bool:
        """A touch makes none."""
        return not self.contact

    def job(self, session: MachineSession, name: RunName, warn: Warn) -> Job:
        """Return the job of the machine's tool as it is by now, at the place of its first hole."""
        actuator = session.choice.actuator if session.choice else None
        prepared = prepared_job(self.plan, tool_identity(session), actuator, logbook_of(self.plan, name))
        self._site = checked_site(
            prepared, self.place, name.path.parent, self.plan.where.selector, contact=self.contact
        )
        return prepared.job

    def act(self, run: JobRun) -> None:
        """Find gap or surface."""
        assert self._site is not None
        self.found = find_contact(run, self._site) if self.contact else find_gap(run, self._site)

    def close(self, time_s: float) -> None:
        """Some sparks leave no hole: there is nothing to keep."""

    def result(self) -> Mapping[str, object] | None:
        """Where it is."""
        return asdict(self.found) if self.found else None
