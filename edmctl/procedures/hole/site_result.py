"""The result of a hole, for people, scripts and the run file."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from edmctl.procedures.actuator.tracker import FeedError
from edmctl.procedures.hole.target import target_of
from edmctl.procedures.hole.verdict import judged
from edmctl.procedures.job_state import CutTotals

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut import CutResult
    from edmctl.procedures.job_state import RunningCut
    from edmctl.procedures.run import JobRun
    from edmctl.profile.places import Place


@dataclass(slots=True)
class CutSums:
    """What the cuts of a hole add up to. `before` are those of an earlier run, and one that was broken off.

    So many as `broken_cuts` came to no end: they do not use up what a hole may still take.
    """

    cuts: list[CutResult] = field(default_factory=list)
    before: CutTotals = field(default_factory=CutTotals)
    broken_cuts: int = 0

    def add_broken_off(self, cut: RunningCut) -> None:
        """Add a cut that came to no end."""
        if cut.time_s > 0.0:
            self.before = self.before.plus(cut.counts, cut.energy_j, cut.time_s)
            self.broken_cuts += 1

    @property
    def total(self) -> CutTotals:
        """All of them together."""
        opens, normals, arcs, shorts = (
            sum(column) for column in zip(self.before.counts, *(cut.counts for cut in self.cuts), strict=True)
        )
        return CutTotals(
            self.before.number + len(self.cuts),
            (opens, normals, arcs, shorts),
            self.before.energy_j + sum(cut.energy_j for cut in self.cuts),
            self.before.time_s + sum(cut.time_s for cut in self.cuts),
        )

    @property
    def gap_ratio_mean(self) -> float:
        """Normalised gap voltage while sparking; NaN where no cut sparked."""
        sparking = [cut for cut in self.cuts if not math.isnan(cut.gap_ratio_mean)]
        time_s = sum(cut.time_s for cut in sparking)
        return sum(cut.time_s * cut.gap_ratio_mean for cut in sparking) / time_s if time_s else math.nan


def open_site(run: JobRun, site: Place) -> None:
    """Begin the account of a site; the readings of the one before may teach the actuator's estimator now."""
    tally = run.tally
    tally.depth_um, tally.open_site = 0.0, site.name
    tally.depth_target_um = target_of(run.profile, site).depth_um
    run.watch.feed_error = FeedError()
    tracker = run.watch.tracker()
    if tracker is not None:
        tracker.learn_noted()


def close_site(run: JobRun, *, settled: bool) -> None:
    """End the account of a site; its result goes into the run file once it is settled, or with the next that is."""
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
    """Write what is known of all holes where the job ends early; the one under way is not judged: it may go on."""
    record_results(run)
    tally = run.tally
    if tally.open_site in tally.sites:
        tally.sites[tally.open_site] = replace(tally.sites[tally.open_site], finished=False)
        run.recorder.append(tally.sites[tally.open_site])
