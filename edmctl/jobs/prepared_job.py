"""The job as the ledger permits it, and the ledger entries of the job: places of its holes, and the tool."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic
from edmctl.jobs.connected_machine import with_home
from edmctl.jobs.plan import Plan
from edmctl.jobs.tool import MachineTool, ToolIdentity
from edmctl.planning.forecast import forecast
from edmctl.planning.removal import PAD_MARGIN_UM
from edmctl.planning.rules.sites import unreachable
from edmctl.procedures.job import CalibratedActuator, Job, job_of
from edmctl.profile.model import Profile
from edmctl.record.ledger import (
    Ledger,
    SiteMachined,
)
from edmctl.wording import coordinates, length

WALL_UM = 50.0
"""Wall between two holes of successive jobs: several times the errors of stages and rim. Our choice."""

Place = tuple[str, float, float]
"""Name, x and y of an axis, µm."""


def next_free_x_um(
    reference_x_um: float, y_um: float, step_um: float, radius_um: float, holes: Sequence[SiteMachined]
) -> float:
    """Return the first x in steps from the reference pad at which a hole of `radius_um` is clear of all others.

    Without a step the first place is the pad itself, and the next ones are a hole and a wall apart.
    """
    x_um, stride_um = reference_x_um + step_um, step_um or 2.0 * radius_um + WALL_UM
    while ends_um := [
        hole.x_um + math.sqrt(clear_um**2 - (hole.y_um - y_um) ** 2)
        for hole in holes
        if math.hypot(hole.x_um - x_um, hole.y_um - y_um) < (clear_um := hole.radius_um + radius_um + WALL_UM)
    ]:
        x_um += stride_um * max(1, math.ceil((max(ends_um) - x_um) / stride_um))
    return x_um


def refuse_taken(
    places: Iterable[Place], radius_um: float, holes: Sequence[SiteMachined], folder: Path
) -> None:
    """Raise PreconditionError E8042 if a hole would overlap an existing one; `folder` contains the run files."""
    for name, x_um, y_um in places:
        for hole in holes:
            if math.hypot(hole.x_um - x_um, hole.y_um - y_um) < hole.radius_um + radius_um:
                depth = "of unknown depth" if math.isnan(hole.depth_um) else f"{length(hole.depth_um)} deep"
                if hole.through:
                    depth = "through the sheet"
                at = coordinates(hole.x_um, hole.y_um)
                taken = f"{hole.name}, {depth} at {at}, {hole.status}, recorded in {folder / hole.run_file}"
                raise failures.place_taken(name=name, x_um=coordinates(x_um, y_um), hole=taken)


def refuse_unreachable(place: Place, job: Job) -> None:
    """Raise PreconditionError E8042 for a place beyond the stages' travel or the workpiece."""
    if found := unreachable(*place, job.setup, hole_radius_um(job.profile)):
        message, hint = found
        raise failures.place_unreachable(problem=message, remedy=hint[0].upper() + hint[1:])


def refuse_pad(place: Place, job: Job) -> None:
    """Raise PreconditionError E8042 if sparks would be made on the pad, which all touches count from."""
    (name, x_um, y_um), profile = place, job.profile
    clear_um = profile.tool.diameter_um + profile.work.side_gap_um + PAD_MARGIN_UM
    away_um = math.hypot(x_um - job.pad.x_um, y_um - job.pad.y_um)
    if away_um < clear_um:
        raise failures.place_near_pad(
            name=name, x_um=coordinates(x_um, y_um, 1), away_um=length(away_um), clear_um=clear_um
        )


def place_of(text: str | None) -> tuple[float, float] | None:
    """Return the named stage coordinates; None if none are named. Raises UsageError E2061."""
    if text is None:
        return None
    place = coordinates_in(text)
    if place is None:
        raise failures.site_unreadable(text=text)
    return place


def coordinates_in(text: str) -> tuple[float, float] | None:
    """Return x and y in µm if the text is two numbers separated by a comma."""
    try:
        x_um, y_um = map(float, text.split(","))
    except ValueError:
        return None
    return (x_um, y_um) if math.isfinite(x_um) and math.isfinite(y_um) else None


def hole_radius_um(profile: Profile) -> float:
    """Radius of the holes that the profile's tool makes."""
    return profile.tool.diameter_um / 2.0 + profile.work.side_gap_um


@dataclass(frozen=True, slots=True)
class PreparedJob:
    """A job for the present tool, its places, and the other holes in the workpiece."""

    job: Job
    tool: MachineTool
    places: tuple[Place, ...] = ()
    holes: tuple[SiteMachined, ...] = ()

    def refuse(self, resuming: Collection[str] = ()) -> list[Diagnostic]:
        """Return warnings about the tool."""
        job, tool, loaded = self.job, self.tool, self.tool.plan.loaded
        warnings: list[Diagnostic] = []
        if job.profile.approach is not loaded.profile.approach:
            tool.refuse_too_short(job.profile, forecast(job.profile, job.setup, loaded.places).stroke_um)
        if not resuming:
            tool.refuse_unknown_length()
            warnings += tool.refuse_worn_out(job.profile)
            warnings += tool.other_tool_warning()
            warnings += tool.unfinished_warnings()
        if not loaded.places and self.places and job.profile.path is None:
            refuse_unreachable(self.places[0], job)
        refuse_taken(self.places, hole_radius_um(job.profile), self.holes, tool.folder)
        return warnings


def prepared_job(
    plan: Plan,
    identity: ToolIdentity,
    actuator: CalibratedActuator | None,
    ledger: Ledger | None,
    resuming: Collection[str] = (),
) -> PreparedJob:
    """Return the job for the tool as earlier jobs left it, its single hole clear of all others.

    `resuming` are the file names of the interrupted runs of this job: their holes belong to it.
    """
    loaded, tool = plan.loaded, MachineTool(plan, identity, ledger)
    if ledger is None:
        return PreparedJob(job_of(loaded.profile, plan.setup, loaded.places, actuator), tool)
    if plan.resumed is None:
        tool.refuse_other_setup()
    state = plan.resumed.state if plan.resumed else None
    # A job that has touched knows its pad from the journal, and the stroke was enough when it began.
    has_touched = state is not None and (state.site or state.done)
    profile = loaded.profile if has_touched else tool.worn(loaded.profile)
    own = [hole for hole in tool.history.holes if hole.run_file in resuming]
    others = tuple(hole for hole in tool.history.holes if hole not in own)
    stage, radius_um = plan.setup.stage, hole_radius_um(profile)
    x_um = next_free_x_um(
        stage.reference_x_um, stage.reference_y_um, profile.measure.site_dx_um, radius_um, others
    )
    job = job_of(profile, plan.setup, loaded.places, actuator, start_x_um=own[0].x_um if own else x_um)
    own_um = math.fsum(hole.wear_um for hole in own if not math.isnan(hole.wear_um))
    job = replace(
        with_home(job, tool.history, identity.now), tool_wear_before_um=tool.account.lost_um - own_um
    )
    return PreparedJob(job, tool, _places(job, radius_um), others)


def forewarned(plan: Plan, folder: Path, identity: ToolIdentity) -> list[Diagnostic]:
    """Return the ledger's warnings for a dry run. Raises as the job would."""
    return prepared_job(plan, identity, None, Ledger.open(folder)).refuse()


def _places(job: Job, radius_um: float) -> tuple[Place, ...]:
    """Return the axes of all holes, or points on the path of a channel so close that nothing fits between them."""
    if job.profile.path is None:
        return tuple((site.name, site.x_um, site.y_um) for site in job.sites)
    from edmctl.planning.channel import PIECE_UM, way_of_path

    stride = max(1, int(radius_um // PIECE_UM))
    way = way_of_path(job.profile.path)
    points = way.points[:-1] if way.closed else way.points
    return tuple((job.profile.meta.name, float(x_um), float(y_um)) for x_um, y_um in points[::stride])
