"""Tells how gap and tool stand while nothing is machined: conditioning, touching, on the way to the gap."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.procedures.settings import gap_reference_v
from edmctl.results.progress import Phase, Progress
from edmctl.results.pulses import pulse_shares

if TYPE_CHECKING:
    from edmctl.machine.port import TelemetryBlock
    from edmctl.procedures.run import Run

TELL_EVERY_S = 0.1


class Standing:
    """Hears every block of a run. While machining, whoever follows the cut or pass knows more and tells that."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._reference_v = gap_reference_v(run.profile)
        self._due_s = -math.inf
        self._gap_low_v = self._low_um = math.inf
        self._gap_high_v = self._high_um = -math.inf
        self._counts = [0, 0, 0, 0]

    def take(self, block: TelemetryBlock) -> None:
        """Add the samples of a block, and tell when it is time."""
        if self._run.tally.phase is Phase.MACHINING:
            return
        gaps_v, heights_um = block.gap_v.tolist(), block.displacement_um.tolist()
        self._gap_low_v = min(self._gap_low_v, *gaps_v)
        self._gap_high_v = max(self._gap_high_v, *gaps_v)
        self._low_um = min(self._low_um, *heights_um)
        self._high_um = max(self._high_um, *heights_um)
        for i, numbers in enumerate((block.n_open, block.n_normal, block.n_arc, block.n_short)):
            self._counts[i] += sum(numbers.tolist())
        now_s = float(block.time_s[-1])
        if now_s >= self._due_s:
            self._due_s = now_s + TELL_EVERY_S
            self._tell(now_s, sum(gaps_v) / len(gaps_v), sum(heights_um) / len(heights_um))
            self._clear()

    def _clear(self) -> None:
        self._gap_low_v = self._low_um = math.inf
        self._gap_high_v = self._high_um = -math.inf
        self._counts = [0, 0, 0, 0]

    def _tell(self, now_s: float, gap_v: float, displacement_um: float) -> None:
        run, tally = self._run, self._run.tally
        run.observer.progress(
            Progress(
                phase=tally.phase,
                time_s=now_s,
                gap_v=gap_v,
                reference_v=self._reference_v,
                ratios=pulse_shares(*self._counts),
                depth_um=tally.depth_um,
                depth_target_um=tally.depth_target_um,
                displacement_um=displacement_um,
                time_left_s=math.nan,
                site=run.site_among_many,
                gap_low_v=self._gap_low_v,
                gap_high_v=self._gap_high_v,
                displacement_low_um=self._low_um,
                displacement_high_um=self._high_um,
                sites_done=tally.sites_done,
                sites_total=len(run.job.sites),
                warning=tally.warning,
                warned_s=tally.warned_s,
            )
        )
