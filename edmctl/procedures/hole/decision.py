"""What follows a measurement cycle, and the verdicts of holes and channels.

A depth outside the tolerance is missed; one inside, whose 95 % interval is wider than the tolerance, is not
verified. Later touches correct earlier holes, so a hole is judged when nothing can correct it any more.
"""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.dataclasses import dataclass
from edmctl.labels import NOT_SHOWN_CODE, Basis, Verdict
from edmctl.machine.faults import host_fault
from edmctl.planning.measuring import cut_budget
from edmctl.procedures.displacement_estimate import FeedError
from edmctl.procedures.hole.cut import CutEnd, CutResult
from edmctl.procedures.hole.cut_planning import CutPlan, CutStart, following_plan
from edmctl.procedures.job import HoleTarget, Job, target_of, verdict_of
from edmctl.procedures.run import Args, JobRun
from edmctl.process.live_erosion import ErosionEstimate
from edmctl.process.next_cut import is_done
from edmctl.process.touches import DepthAndWear
from edmctl.profile.model import Profile
from edmctl.profile.places import Place
from edmctl.record.rows import EventLevel, RunEvent
from edmctl.results.job import ChannelResult, SiteResult
from edmctl.wording import decimal, length, plural, signed

MOST_RATIO = 5.0  # upper bound of wear.expected_ratio in a recipe
LARGEST_FACTOR = 3.0  # times the expected wear ratio; the other polarity wears the tool several times as fast
LEAST_EXPECTED = 0.02  # wear ratio that is assumed for recipes that expect less: every tool wears


@dataclass(frozen=True, slots=True)
class Decision:
    """What follows, and the next cut; or why (`missed`) and by which `code` and `site` the objective was missed."""

    message: str
    plan: CutPlan | None = None
    missed: str = ""
    hint: str = ""
    code: str = "E7010"
    site: str = ""


def missed(message: str, hint: str, code: str = "E7010") -> Decision:
    """Return the end of a hole, channel or job that misses its objective."""
    return Decision(message, missed=message, hint=hint, code=code)


def missed_by_fault(row: str, message: str) -> Decision:
    """Return the end by a row of the faults."""
    error = host_fault(row, message)
    return missed(error.message, error.hint, error.code)


def report_end(run: JobRun, decision: Decision, depth_um: float) -> None:
    code = RunEvent.TARGET_MISSED if decision.missed else RunEvent.TARGET_REACHED
    level = EventLevel.WARNING if decision.missed else EventLevel.INFO
    run.decide(code, decision.message, {"depth_um": depth_um, "hint": decision.hint}, level=level)


def decide(
    profile: Profile,
    target: HoleTarget,
    number: int,
    cut: CutResult | None,
    found: DepthAndWear,
    start: CutStart,
    estimate: ErosionEstimate,
    *,
    touch_final: bool = False,
    broken_cuts: int = 0,
) -> Decision:
    """Decide from the measured lengths after `number` cuts; another cut would begin from `start`.

    `cut` is None if an earlier run made it. `touch_final` measures the last cut however small. The `broken_cuts` of
    the hole do not use up its budget.
    """
    if cut is not None and cut.end is not CutEnd.REACHED:
        return unfinished(target, cut, found.depth_um, found.feed_um)
    if target.kind == "feed" and cut is not None:
        return Decision(f"Feed {found.feed_um:.2f} µm of {target.feed_um:.0f} µm.")
    remaining_um = target.depth_um - found.depth_um
    done = is_done(remaining_um, target.tolerance_um, found.depth_noise_um)
    if done or number >= cut_budget(profile) + broken_cuts:
        off = signed(found.depth_um - target.depth_um)
        depth = f"{decimal(found.depth_um)} µm, {off} µm from the target, after {plural(number, 'cut')}"
        if verdict_of(target, found.depth_um, found.depth.u95, through=False) is not Verdict.MISSED:
            return Decision(f"Depth {depth}.")
        why = f"The depth is {depth}; target.tolerance_um is {target.tolerance_um:.1f} µm."
        hint = remedy(profile, found.depth_um - target.depth_um, found.wear_ratio)
        return Decision(f"Depth {depth}.", missed=why, hint=hint)
    plan = following_plan(profile, target, number + 1, start, estimate, touch_final=touch_final)
    after = "measured" if plan.measured else "known well enough not to be measured"
    message = f"{remaining_um:.2f} µm are left: next cut feeds {plan.feed_um:.2f} µm, then {after}."
    return Decision(message, plan)


def unfinished(target: HoleTarget, cut: CutResult, depth_um: float, feed_um: float) -> Decision:
    """Return the end after a cut that did not reach its limit."""
    reached = target.reached(depth_um, feed_um)
    if cut.fault:
        return missed_by_fault(cut.fault, f" The cut ended early ({cut.message}) at {reached}.")
    hint = "Flush better (shorter jump.period_s, greater jump.height_um), or raise servo.reference."
    return missed(f"The cut ended early ({cut.reason}) at {reached}.", hint)


def remedy(profile: Profile, off_um: float, wear_ratio: float = math.nan) -> str:
    """Return the remedy for a depth that misses its target by `off_um`; an unmeasured `wear_ratio` is NaN."""
    if off_um < 0.0:
        key = "max_cuts" if cut_budget(profile) == profile.wear.max_cuts else "remeasure"
        return f"Allow more cuts (wear.{key})."
    if 0.0 < wear_ratio <= MOST_RATIO:
        return f"Set wear.expected_ratio to {wear_ratio:.3f}, as measured."
    return "Cut less before the first measuring stop (wear.first_fraction)."


def refuse_wrong_setup(run: JobRun, found: DepthAndWear) -> None:
    """Raise MachineFault E67005 if the first cut wore the tool far too fast, or left no hole, beyond uncertainty."""
    expected = max(run.profile.wear.expected_ratio, LEAST_EXPECTED)
    least_wear_um, most_depth_um = found.wear.interval()[0], found.depth.interval()[1]
    if most_depth_um >= 0.0 and least_wear_um <= LARGEST_FACTOR * expected * most_depth_um:
        return
    error = host_fault(
        "SETUP",
        f" The first cut has a depth of {found.depth_um:.2f} µm and a wear of {found.wear_um:.2f} µm; "
        f"{expected:g} µm per µm were expected.",
    )
    args = {"depth_um": found.depth_um, "wear_um": found.wear_um, "expected_ratio": expected}
    run.decide(RunEvent.SETUP_WRONG, error.message, args, level=EventLevel.ERROR)
    raise error


MOST_NAMED = 5  # holes that a message names; of the others it states the number
REMEDIES = {
    Basis.TOUCHED: "Allow more (target.tolerance_um): touches tell this depth no better.",
    Basis.ESTIMATED: "Let every hole be touched (wear.remeasure = 1).",
    Basis.MODEL: "Fit a displacement sensor: the gain of a calibrated actuator moves by 2.5 % between days.",
}
"""Remedy for a wide interval, by what the depth is based on."""
IN_DOUBT = "Clean tool and work, and measure the hole again: bottom or face may have been touched wrongly."
"""The same for one that is wide because of doubted touches."""


def open_site(run: JobRun, site: Place) -> None:
    """Begin a site; the actuator's estimator may now learn from the readings of the one before."""
    tally = run.tally
    tally.depth_um, tally.open_site = 0.0, site.name
    tally.depth_target_um = target_of(run.job.profile, site).depth_um
    run.watch.feed_error = FeedError()
    tracker = run.watch.tracker()
    if tracker is not None:
        tracker.learn_noted()


def close_site(run: JobRun, *, settled: bool) -> None:
    """End a site; its result goes into the run file when no later touch can correct it (`settled`)."""
    tally = run.tally
    if tally.open_site in tally.sites:
        tally.unwritten.append(tally.open_site)
    tally.open_site = ""
    if settled:
        record_results(run)


def record_results(run: JobRun) -> None:
    """Judge and write the results that are not in the run file yet."""
    tally = run.tally
    for name in tally.unwritten:
        tally.sites[name] = judged(run.job, tally.sites[name])
        run.recorder.append(tally.sites[name])
    tally.unwritten.clear()


def record_left(run: JobRun) -> None:
    """Write the results when the job ends early; the hole under way is not judged, because it may be resumed."""
    record_results(run)
    tally = run.tally
    if tally.open_site in tally.sites:
        tally.sites[tally.open_site] = replace(tally.sites[tally.open_site], finished=False)
        run.recorder.append(tally.sites[tally.open_site])


def judged(job: Job, result: SiteResult) -> SiteResult:
    verdict = verdict_of(
        _target(job, result.name), result.depth_um, result.depth_u95_um, through=result.through
    )
    return replace(result, verdict=verdict)


def judge_holes(run: JobRun, last: Decision | None) -> Decision | None:
    """Return the end of a job of holes by their verdicts, or after `last`; None if all are right."""
    last_name = "" if last is None else last.site
    wrong = [
        site
        for site in run.tally.sites.values()
        if site.verdict in (Verdict.MISSED, Verdict.NOT_SHOWN) and site.name != last_name
    ]
    if not wrong:
        return last
    by_weight = sorted(wrong, key=lambda site: site.verdict is not Verdict.MISSED)
    hint = _remedy(run.job, by_weight[0])
    for site in wrong:
        args: Args = {"verdict": str(site.verdict), "depth_um": site.depth_um}
        if site is wrong[-1] and last is None:
            args = {"hint": hint, **args}
        run.warn(RunEvent.VERDICT, f"{site.name}: {_sentence(run.job, site)}.", args)
    if len(run.job.sites) == 1:
        sentence = _sentence(run.job, wrong[0])
        message = f"{sentence[0].upper()}{sentence[1:]}."
    else:
        sentences = [f"{site.name}: {_sentence(run.job, site)}" for site in by_weight[:MOST_NAMED]]
        if len(wrong) > MOST_NAMED:
            sentences.append(f"and {len(wrong) - MOST_NAMED} more")
        message = f"{len(wrong)} of {len(run.job.sites)} holes are not right. {'; '.join(sentences)}."
    if last is not None:
        return replace(last, missed=f"{last.missed} {message}")
    return missed(message, hint, "E7010" if by_weight[0].verdict is Verdict.MISSED else NOT_SHOWN_CODE)


def judged_channel(target: HoleTarget, result: ChannelResult) -> ChannelResult:
    """Return the result of a channel with its verdict: its floor must lie within the tolerance, root mean square."""
    verdict = verdict_of(target, result.depth_um, result.depth_u95_um, through=False)
    if result.floor_rms_um(target.depth_um) > target.tolerance_um:
        verdict = Verdict.MISSED
    return replace(result, verdict=verdict)


def not_shown(what: str, target: HoleTarget, result: ChannelResult | SiteResult) -> str:
    """Return the sentence about an interval that is wider than the tolerance."""
    return (
        f"{what} is not shown to be right: {length(result.depth_um, result.depth_u95_um)} for "
        f"{target.depth_um:g} ± {target.tolerance_um:g} µm, an interval wider than the tolerance"
    )


def _target(job: Job, name: str) -> HoleTarget:
    return target_of(job.profile, next(site for site in job.sites if site.name == name))


def _remedy(job: Job, site: SiteResult) -> str:
    if site.verdict is not Verdict.MISSED:
        in_doubt = site.in_doubt and site.depth_basis is not Basis.MODEL
        return IN_DOUBT if in_doubt else REMEDIES[site.depth_basis or Basis.ESTIMATED]
    target = _target(job, site.name)
    if target.kind == "through":
        return "Check work.thickness_um; a thicker sheet needs more stroke."
    wear_ratio = math.nan if site.wear_basis is Basis.ESTIMATED else site.wear_ratio_lin
    return remedy(job.profile, site.depth_um - target.depth_um, wear_ratio)


def _sentence(job: Job, site: SiteResult) -> str:
    target = _target(job, site.name)
    if site.verdict is Verdict.NOT_SHOWN:
        return not_shown("the depth", target, site)
    if target.kind == "through":
        return f"not through the sheet of {target.depth_um:g} µm"
    return (
        f"the depth is outside the tolerance: {length(site.depth_um, site.depth_u95_um)} for "
        f"{target.depth_um:g} ± {target.tolerance_um:g} µm"
    )
