"""The verdicts of holes and channels, and when their results go into the run file.

A depth whose value is outside the tolerance is missed. One inside, whose 95 % interval is wider than the tolerance,
is not verified. Later touches correct earlier holes, so a hole is judged when nothing can correct it any more.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from edmctl.labels import NOT_SHOWN_CODE, Basis, Verdict
from edmctl.procedures.actuator.tracker import FeedError
from edmctl.procedures.hole.decision import Decision, remedy
from edmctl.procedures.job import HoleTarget, Job, target_of, verdict_of
from edmctl.procedures.run import Args, JobRun
from edmctl.profile.places import Place
from edmctl.record.rows import RunEvent
from edmctl.results.job import ChannelResult, SiteResult
from edmctl.wording import length

MOST_NAMED = 5
"""Holes that a message names; of the others it states the number."""
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
    """Return the result of a hole with its verdict."""
    verdict = verdict_of(
        _target(job, result.name), result.depth_um, result.depth_u95_um, through=result.through
    )
    return replace(result, verdict=verdict)


def judge_holes(run: JobRun, last: Decision | None) -> Decision | None:
    """Return the end of a job of holes, from their verdicts; None if all are within their tolerance.

    `last` is the decision that ended the job early; other holes that are not right are appended to its message.
    """
    reported = "" if last is None else last.site
    doubtful = [
        site
        for site in run.tally.sites.values()
        if site.verdict in (Verdict.MISSED, Verdict.NOT_SHOWN) and site.name != reported
    ]
    if not doubtful:
        return last
    missed = [site for site in doubtful if site.verdict is Verdict.MISSED]
    hint = _remedy(run.job, (missed or doubtful)[0])
    for site in doubtful:
        text = f"{site.name}: {_sentence(run.job, site)}."
        args: Args = {"verdict": str(site.verdict), "depth_um": site.depth_um}
        if site is doubtful[-1] and last is None:
            args = {"hint": hint, **args}
        run.warn(RunEvent.VERDICT, text, args)
    message = _message(run.job, doubtful)
    if last is not None:
        return replace(last, missed=f"{last.missed} {message}")
    return Decision(None, message, message, hint, *([] if missed else [NOT_SHOWN_CODE]))


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


def _message(job: Job, doubtful: Sequence[SiteResult]) -> str:
    if len(job.sites) == 1:
        sentence = _sentence(job, doubtful[0])
        return f"{sentence[0].upper()}{sentence[1:]}."
    parts = []
    for verdict, how in (
        (Verdict.MISSED, "outside the tolerance"),
        (Verdict.NOT_SHOWN, "not shown to be right"),
    ):
        some = [site for site in doubtful if site.verdict is verdict]
        if some:
            named = "; ".join(_numbers(job, site) for site in some[:MOST_NAMED])
            more = f"; and {len(some) - MOST_NAMED} more" if len(some) > MOST_NAMED else ""
            parts.append(f"{len(some)} of {len(job.sites)} holes {how}: {named}{more}.")
    return " ".join(parts)


def _numbers(job: Job, site: SiteResult) -> str:
    target = _target(job, site.name)
    tolerance = "" if target.kind == "through" else f" ± {target.tolerance_um:g}"
    return f"{site.name} is {length(site.depth_um, site.depth_u95_um)} for {target.depth_um:g}{tolerance} µm"
