"""The main job: all places one after the other, or a channel; the machine is left retracted and idle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from edmctl.machine.interface import Machine
from edmctl.planning.forecast import hole_time_s, working_order
from edmctl.planning.measuring import FACE_LIMIT_UM
from edmctl.planning.removal import hole
from edmctl.procedures.hole import decision as decisions
from edmctl.procedures.hole.decision import Decision
from edmctl.procedures.hole.knowledge import JobKnowledge
from edmctl.procedures.hole.procedure import HoleProcedure
from edmctl.procedures.job import Job, JobTally, StateStore, target_of
from edmctl.procedures.monitoring.monitors import judge_job
from edmctl.procedures.run import MOVING, JobRun
from edmctl.procedures.servo.limits import TimeLimits, rise_um
from edmctl.procedures.servo.supervisor import TOUCH_RESERVE_UM
from edmctl.procedures.session import running
from edmctl.process.plane import TOUCHES_FOR_A_PLANE
from edmctl.profile.places import Place
from edmctl.record.rows import Recorder, RunEvent
from edmctl.results.job import JobResult, ObjectiveMissed
from edmctl.results.progress import Observer

STROKE_CODE = "E7011"
STROKE_HINT = (
    "Machine the holes that are left in a job of their own, with the tool set closer, or allow more stroke "
    "(limits.stroke_v_max)."
)


def run_job(
    machine: Machine,
    job: Job,
    *,
    recorder: Recorder,
    observer: Observer,
    tally: JobTally | None = None,
    store: StateStore | None = None,
) -> JobResult:
    """Run a whole job on an idle machine.

    The recorder takes every sample, decision and result; the tally has what was reached, also after an error; the
    store keeps the state that a resumed job needs. Raises ObjectiveMissed, with the result, if the job ended in
    order but short of its target; MachineFault, LinkLost, PreconditionError, RunFileError and Interrupted after the
    safe state was reached, by the controller alone if the link is lost.
    """
    tally = tally or JobTally()
    if job.profile.path is None:
        begun = job.resumed.site if job.resumed is not None and job.resumed.begun else ""
        ordered = working_order(job.profile, job.setup, job.sites)
        tally.ordered = tuple(site.name for site in ordered if site.name != begun)
    with running(
        machine,
        job,
        tally,
        recorder=recorder,
        observer=observer,
        pulses=True,
        store=store,
        self_test=True,
        record_left=_record_left,
    ) as run:
        if job.profile.path is None:
            last = machine_sites(run)
            decisions.record_results(run)
            last = decisions.judge_holes(run, last)
        else:
            from edmctl.procedures.channel.procedure import machine_path  # most jobs make holes

            last = machine_path(run)
    if last is not None:
        raise ObjectiveMissed(last.missed, hint=last.hint, result=tally.result(), code=last.code)
    return tally.result()


def _record_left(run: JobRun) -> None:
    decisions.record_left(run)
    if run.profile.path is not None:
        from edmctl.procedures.channel.procedure import record_left_channel

        record_left_channel(run)


def machine_sites(run: JobRun) -> Decision | None:
    """Machine every place that is not done yet; return the first decision that misses its target, else None."""
    knowledge = JobKnowledge(run)
    last = _machine_left(run, knowledge)
    judge_job(run, knowledge.pads)
    return last


def _machine_left(run: JobRun, knowledge: JobKnowledge) -> Decision | None:
    limits, resumed, done = TimeLimits(run), run.job.resumed, set(run.tally.sites)
    left = [site for site in working_order(run.profile, run.setup, run.job.sites) if site.name not in done]
    if resumed is not None and not resumed.begun and left:
        from edmctl.procedures.hole.resuming import check_last_hole  # only resumed jobs need it

        check_last_hole(run, knowledge)
    for number, site in enumerate(left):
        used_up = _used_up(run, knowledge, left[number:])
        if used_up is not None:
            return used_up
        decisions.open_site(run, site)
        decision = None
        if resumed is not None and resumed.begun and resumed.site == site.name:
            from edmctl.procedures.hole.resuming import ResumedHole

            decision = ResumedHole(run, site, knowledge, limits).resume()
        if decision is None:
            _touch_surface(run, site, knowledge, left[number:])
            hole = knowledge.next_hole(site)
            hole.keep()
            decision = HoleProcedure(run, hole, knowledge, limits).machine(is_last=site is left[-1])
        run.keeper.keep(MOVING, None)
        if decision.missed:
            return _of_several(run, decision, site)
    return None


def _touch_surface(run: JobRun, site: Place, knowledge: JobKnowledge, left: Sequence[Place]) -> None:
    if knowledge.tool is None:
        knowledge.touch_pad_first(site.name)
    assert knowledge.tool is not None
    surface = knowledge.surface
    is_plane = run.profile.array.surface == "plane" and len(left) >= TOUCHES_FOR_A_PLANE
    if is_plane and not surface.touched:
        surface.touch_plane(left, knowledge.tool)
    elif run.profile.target.kind != "through" and surface.height_u_um(site) > FACE_LIMIT_UM:
        surface.touch(site, knowledge.tool)
    else:
        return
    surface.keep()


def _of_several(run: JobRun, decision: Decision, site: Place) -> Decision:
    """Return the end after a hole that missed its target, with the holes that were not begun."""
    why, hint, names = decision.missed, decision.hint, run.tally.not_begun
    if len(run.job.sites) > 1:
        why = f"{site.name}: {why}"
    if names:
        text = f"Not begun: {', '.join(names)}."
        run.warn(RunEvent.SITES_LEFT, text, {"left": len(names)})
        why = f"{why} {text}"
    if decision.code == STROKE_CODE and run.tally.sites_done > 1:
        hint = STROKE_HINT
    return replace(decision, missed=why, hint=hint, site=site.name)


def _used_up(run: JobRun, knowledge: JobKnowledge, left: Sequence[Place]) -> Decision | None:
    """Return the end before a place for which wear limit or stroke do not suffice; None if they do.

    The stroke is compared with the one to the end of the hole within its tolerance. It is unknown before the first
    touch of the tool, without a model of the actuator, and in several regimes.
    """
    profile, target, name = run.profile, target_of(run.profile, left[0]), left[0].name
    estimator, ratio = run.watch.estimator(), knowledge.estimate.wear_ratio
    feed_um = target.feed_um if target.kind == "feed" else target.depth_um * (1.0 + ratio)
    lost_um, next_um = run.job.tool_wear_before_um + run.tally.wear_um, feed_um * ratio / (1.0 + ratio)
    needed_um = stroke_um = 0.0
    if knowledge.tool is not None and estimator is not None and not profile.regimes:
        spare_um = 0.0 if target.kind == "feed" else target.tolerance_um
        surface_um = knowledge.tool.pad_um + knowledge.surface.height_um(left[0])
        needed_um = surface_um + feed_um - spare_um + target.completion_um - knowledge.gap.value
        needed_um += TOUCH_RESERVE_UM
        time_s = hole_time_s(profile, hole(profile, target.depth_um))
        stroke_um = run.watch.displacement_um + rise_um(estimator, profile.limits.stroke_v_max, time_s)
    if lost_um + next_um > profile.tool.max_wear_um:
        code, hint = "E7010", "Dress or change the tool, and machine the places that are left."
        why = (
            f"The tool has lost {lost_um:.0f} µm and {name} would take {next_um:.0f} µm more; "
            f"tool.max_wear_um is {profile.tool.max_wear_um:.0f} µm."
        )
    elif needed_um > stroke_um:
        code, hint = STROKE_CODE, STROKE_HINT
        why = f"{name} needs {needed_um:.1f} µm of stroke with the worn tool; there are {stroke_um:.1f} µm."
    else:
        return None
    message = f"{why} Done: {len(run.tally.sites)}; left: {', '.join(run.tally.not_begun)}."
    run.warn(RunEvent.SITES_LEFT, message, {"left": len(left), "hint": hint})
    return decisions.missed(message, hint, code)
