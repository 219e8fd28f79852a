"""The job as the ledger permits it: places of its holes, and the tool as earlier jobs left it."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import Diagnostic
from edmctl.jobs.connected_machine import with_home
from edmctl.jobs.ledger.tool import (
    ToolIdentity,
    account_of,
    left_to_finish,
    on_worn_tool,
    other_tool,
    refuse_other_setup,
    refuse_too_short,
    refuse_unknown_length,
    refuse_worn_out,
)
from edmctl.jobs.plan import Plan
from edmctl.jobs.run_header import RunName
from edmctl.planning.forecast import forecast
from edmctl.planning.removal import PAD_MARGIN_UM
from edmctl.planning.rules.sites import unreachable
from edmctl.procedures.job import CalibratedActuator, Job, job_of
from edmctl.profile.model import Profile
from edmctl.record.ledger import Ledger, MachineHistory, SiteMachined, ToolAccount, history_of
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
    """Raise PreconditionError E8042 if a hole would overlap an existing one."""
    for name, x_um, y_um in places:
        for hole in holes:
            if math.hypot(hole.x_um - x_um, hole.y_um - y_um) < hole.radius_um + radius_um:
                where, taken = coordinates(x_um, y_um), hole_in_words(hole, folder)
                raise failures.place_taken(name=name, x_um=where, hole=taken)


def refuse_unreachable(place: Place, job: Job) -> None:
    """Raise PreconditionError E8042 for a place beyond the stages' travel or the workpiece."""
    if found := unreachable(*place, job.setup, hole_radius_um(job.profile)):
        message, hint = found
        raise failures.place_unreachable(problem=message, remedy=hint[0].upper() + hint[1:])


def refuse_pad(place: Place, job: Job) -> None:
    """Raise PreconditionError E8042 where sparks would be made on the pad, which all touches count from."""
    name, x_um, y_um = place
    tool, pad = job.profile.tool, job.pad
    clear_um = tool.diameter_um + job.profile.work.side_gap_um + PAD_MARGIN_UM
    away_um = math.hypot(x_um - pad.x_um, y_um - pad.y_um)
    if away_um < clear_um:
        raise failures.place_near_pad(
            name=name, x_um=coordinates(x_um, y_um, 1), away_um=length(away_um), clear_um=clear_um
        )


def hole_in_words(hole: SiteMachined, folder: Path) -> str:
    """Describe a hole: name, depth, place, and its run file in `folder`."""
    depth = "of unknown depth" if math.isnan(hole.depth_um) else f"{length(hole.depth_um)} deep"
    if hole.through:
        depth = "through the sheet"
    where = coordinates(hole.x_um, hole.y_um)
    return f"{hole.name}, {depth} at {where}, {hole.status}, recorded in {folder / hole.run_file}"


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


def ledger_of(plan: Plan, name: RunName | None) -> Ledger | None:
    """Return the ledger next to the run file; None without a run file.

    A new virtual bench has none: its workpiece and tool end with the command, and a ledger entry of the same
    serial number would be about another bench.
    """
    return Ledger.open(name.path.parent) if name is not None and plan.where.lasting else None


def hole_radius_um(profile: Profile) -> float:
    """Radius of the holes that the profile's tool makes."""
    return profile.tool.diameter_um / 2.0 + profile.work.side_gap_um


@dataclass(frozen=True, slots=True)
class PreparedJob:
    """A job for the present tool: machine, places, account of the tool, and the other holes."""

    job: Job
    serial: str
    account: ToolAccount
    places: tuple[Place, ...] = ()
    holes: tuple[SiteMachined, ...] = ()
    history: MachineHistory = field(default_factory=MachineHistory)

    def refuse(self, plan: Plan, folder: Path, resuming: Collection[str] = ()) -> list[Diagnostic]:
        """Return warnings about the tool; `folder` contains the run files.

        Raises PreconditionError: E8042 a place is taken, E8043 the tool is worn out, E8044 too short, E8048 of
        unknown length.
        """
        job, account = self.job, self.account
        warnings: list[Diagnostic] = []
        if job.profile.approach is not plan.loaded.profile.approach:
            stroke_um = forecast(job.profile, job.setup, plan.loaded.places).stroke_um
            refuse_too_short(job.profile, job.setup, stroke_um, account, plan)
        if not resuming:
            refuse_unknown_length(account, folder, plan)
            warnings += refuse_worn_out(job.profile, job.setup, plan, account)
            warnings += other_tool(plan, account, self.history)
            warnings += left_to_finish(account.label, self.serial, folder)
        if not plan.loaded.places and self.places and job.profile.path is None:
            refuse_unreachable(self.places[0], job)
        refuse_taken(self.places, hole_radius_um(job.profile), self.holes, folder)
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
    loaded, setup = plan.loaded, plan.setup
    if ledger is None:
        job = job_of(loaded.profile, setup, loaded.places, actuator)
        return PreparedJob(job, identity.serial, ToolAccount(loaded.profile.tool.label))
    history = history_of(ledger.lines, identity.serial)
    account = account_of(plan, identity, history)
    if plan.resumed is None:
        refuse_other_setup(account, history, plan, ledger.path.parent)
    left = plan.resumed.state if plan.resumed else None
    # A job that has touched knows its pad from the journal, and the stroke was enough when it began.
    touched = left is not None and (left.site or left.done)
    profile = loaded.profile if touched else on_worn_tool(loaded.profile, account)
    own = [hole for hole in history.holes if hole.run_file in resuming]
    holes = tuple(hole for hole in history.holes if hole not in own)
    stage, radius_um = setup.stage, hole_radius_um(profile)
    x_um = next_free_x_um(
        stage.reference_x_um, stage.reference_y_um, profile.measure.site_dx_um, radius_um, holes
    )
    job = job_of(profile, setup, loaded.places, actuator, start_x_um=own[0].x_um if own else x_um)
    own_um = math.fsum(hole.wear_um for hole in own if not math.isnan(hole.wear_um))
    job = with_home(job, history, identity.now)
    job = replace(job, tool_wear_before_um=account.lost_um - own_um)
    return PreparedJob(job, identity.serial, account, _places(job, radius_um), holes, history)


def forewarned(plan: Plan, name: RunName, identity: ToolIdentity) -> list[Diagnostic]:
    """Return the ledger's warnings for a dry run. Raises as the job would."""
    ledger = Ledger.open(name.path.parent)
    return prepared_job(plan, identity, None, ledger).refuse(plan, ledger.path.parent)


def _places(job: Job, radius_um: float) -> tuple[Place, ...]:
    """Return the axes of all holes, or points on the path of a channel so close that nothing fits between them."""
    if job.profile.path is None:
        return tuple((site.name, site.x_um, site.y_um) for site in job.sites)
    from edmctl.planning.channel import PIECE_UM, way_of_path

    stride = max(1, int(radius_um // PIECE_UM))
    way = way_of_path(job.profile.path)
    points = way.points[:-1] if way.closed else way.points
    return tuple((job.profile.meta.name, float(x_um), float(y_um)) for x_um, y_um in points[::stride])
