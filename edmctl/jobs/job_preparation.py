"""A job as the ledger lets it be done: where its holes go, on the tool as earlier jobs have left it."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path

from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import Diagnostic
from edmctl.jobs.ledger.elapsed import with_home
from edmctl.jobs.ledger.places_taken import Place, next_free_x_um, refuse_taken, refuse_unreachable
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
from edmctl.procedures.job import CalibratedActuator, Job, job_of
from edmctl.profile.model import Profile
from edmctl.record.ledger import Ledger, SiteMachined
from edmctl.record.tool_account import MachineHistory, ToolAccount, history_of


def ledger_of(plan: Plan, name: RunName | None) -> Ledger | None:
    """Return the ledger beside the run file; None where there is neither.

    A fresh virtual bench has none either: its work and its tool are gone with the command, and what a ledger said
    of them would be about another bench of the same serial number.
    """
    return Ledger.open(name.path.parent) if name is not None and plan.where.lasting else None


def hole_radius_um(profile: Profile) -> float:
    """Radius of the holes that the profile's tool makes."""
    return profile.tool.diameter_um / 2.0 + profile.work.side_gap_um


@dataclass(frozen=True, slots=True)
class PreparedJob:
    """A job as it can be done now, on which machine, where it cuts, the account of its tool, and the other holes."""

    job: Job
    serial: str
    account: ToolAccount
    places: tuple[Place, ...] = ()
    holes: tuple[SiteMachined, ...] = ()
    history: MachineHistory = field(default_factory=MachineHistory)

    def refuse(self, plan: Plan, folder: Path, resuming: Collection[str] = ()) -> list[Diagnostic]:
        """Return what is doubtful about the tool; `folder` has the run files.

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
    """Return the job for the tool as earlier jobs have left it, its single hole clear of all others.

    `resuming` are the file names of the runs that are taken up again: their holes are those of this job.
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
    """Return what the ledger makes doubtful, for a dry run. Raises what the job would."""
    ledger = Ledger.open(name.path.parent)
    return prepared_job(plan, identity, None, ledger).refuse(plan, ledger.path.parent)


def _places(job: Job, radius_um: float) -> tuple[Place, ...]:
    """Axes of all holes; of a channel, points on its way that lie so close that nothing fits between them."""
    if job.profile.path is None:
        return tuple((site.name, site.x_um, site.y_um) for site in job.sites)
    from edmctl.procedures.channel.way import PIECE_UM, way_of_path

    stride = max(1, int(radius_um // PIECE_UM))
    way = way_of_path(job.profile.path)
    points = way.points[:-1] if way.closed else way.points
    return tuple((job.profile.meta.name, float(x_um), float(y_um)) for x_um, y_um in points[::stride])
