"""Whether the holes of a job, or its channel, are what was wanted, by all that is known of them when it ends.

A depth that lies outside the tolerance by its value is missed. One that lies inside, but whose 95 % interval is
wider than the tolerance, is not shown: it may be right, and nobody knows. Later touches correct earlier holes, so
that a hole is judged when nothing can correct it any more.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.labels import NOT_SHOWN_CODE, Basis, Verdict
from edmctl.procedures.event_codes import RunEvent
from edmctl.procedures.hole.cut_decision import Decision, remedy
from edmctl.procedures.hole.target import target_of, verdict_of
from edmctl.record.rows import EventLevel
from edmctl.wording import length

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.procedures.hole.target import HoleTarget
    from edmctl.procedures.job import Job
    from edmctl.procedures.run import Args, JobRun
    from edmctl.results.job import ChannelResult, SiteResult

MOST_NAMED = 5
"""So many holes a message names; of the others it says how many they are."""
REMEDIES = {
    Basis.TOUCHED: "Allow more (target.tolerance_um): touches tell this depth no better.",
    Basis.ESTIMATED: "Let every hole be touched (wear.remeasure = 1).",
    Basis.MODEL: "Fit a displacement sensor: the gain of a calibrated actuator moves by 2.5 % between days.",
}
"""What narrows an interval, by what the depth rests on."""
IN_DOUBT = "Clean tool and work, and measure the hole again: bottom or face may have been touched wrongly."
"""What narrows one that is wide because touches were not believed."""


def judged(job: Job, result: SiteResult) -> SiteResult:
    """Return the result of a hole with its verdict."""
    verdict = verdict_of(
        _target(job, result.name), result.depth_um, result.depth_u95_um, through=result.through
    )
    return replace(result, verdict=verdict)


def judge_holes(run: JobRun, last: Decision | None) -> Decision | None:
    """Return the end of a job of holes, from their verdicts; None where all are what was wanted.

    `last` is the decision that ended the job short of its last hole or of its objective; it stands, and what else is
    wrong is told behind it.
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
        run.decide(RunEvent.VERDICT, text, args, level=EventLevel.WARNING)
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
    """Say that an interval is wider than the tolerance."""
    return (
        f"{what} is not shown to be right: {length(result.depth_um, result.depth_u95_um)} for "
        f"{target.depth_um:g} ± {target.tolerance_um:g} µm, an interval wider than the tolerance"
    )


def _target(job: Job, name: str) -> HoleTarget:
    return target_of(job.profile, next(site for site in job.sites if site.name == name))


def _remedy(job: Job, site: SiteResult) -> str:
    """Return what to do about a hole: where it is missed, that goes by the side on which it is."""
    if site.verdict is not Verdict.MISSED:
        in_doubt = site.in_doubt and site.depth_basis is not Basis.MODEL
        return IN_DOUBT if in_doubt else REMEDIES[site.depth_basis]
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
    """Name the holes with their numbers, the missed ones first."""
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
