"""What a job has reached so far, and what the cut under way has done."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from edmctl.results.job import JobResult, Reached
from edmctl.results.progress import Phase

if TYPE_CHECKING:
    from edmctl.results.channel import ChannelResult
    from edmctl.results.job import SiteResult
    from edmctl.results.link import LinkReport


@dataclass(frozen=True, slots=True)
class RunningCut:
    """What the cut under way has done so far, pulses by class; `displacement_um` is where it last sparked."""

    counts: tuple[int, int, int, int] = (0, 0, 0, 0)
    energy_j: float = 0.0
    time_s: float = 0.0
    displacement_um: float = math.nan


@dataclass(slots=True)
class JobTally:
    """What a job has reached so far; still there when the job ends with an error.

    `depth_um` is the best present knowledge of the hole under way: estimated while cutting, then measured.
    `open_site` names that hole until it is finished, `unmeasured_site` from the begin of a cut
    until it is measured; `unwritten` names finished holes whose results later touches may still correct.
    `home_um` is what the sensor showed of the tool at home, at the last rest at 0 V, which was at `home_s`. `cut` is
    the cut under way, `phase` what is being done, `warning` what was last warned of, at `warned_s`.
    `time_s` and `machining_time_s` count those of the runs before this one too.
    """

    sites: dict[str, SiteResult] = field(default_factory=dict)
    depth_um: float = 0.0
    depth_target_um: float = math.nan
    open_site: str = ""
    unmeasured_site: str = ""
    unwritten: list[str] = field(default_factory=list)
    cut: RunningCut = field(default_factory=lambda: RunningCut())
    phase: Phase = Phase.MOVING
    warning: str = ""
    warned_s: float = math.nan
    time_s: float = 0.0
    machining_time_s: float = 0.0
    earlier_time_s: float = 0.0
    pause_s: float = 0.0
    link: LinkReport | None = None
    channel: ChannelResult | None = None
    home_um: float = 0.0
    home_s: float = math.nan

    @property
    def sites_done(self) -> int:
        """How many places are finished: the one under way may have a first result."""
        return len(self.sites) - (self.open_site in self.sites)

    @property
    def wear_um(self) -> float:
        """What the tool has lost at all sites so far."""
        return math.fsum(site.wear_um for site in self.sites.values())

    @property
    def reached(self) -> Reached | None:
        """The hole or channel whose last cut is not measured."""
        if not self.unmeasured_site:
            return None
        left = self.sites.get(self.unmeasured_site, self.channel)
        u95_um = math.nan if left is None else left.depth_u95_um
        return Reached(self.unmeasured_site, self.depth_um, self.depth_target_um, u95_um)

    def result(self) -> JobResult:
        """The measured sites and the times up to now."""
        wears_um = [site.wear_um for site in self.sites.values()]
        if self.channel is not None:
            wears_um.append(self.channel.wear_um)
        return JobResult(
            sites=tuple(self.sites.values()),
            time_s=self.time_s,
            machining_time_s=self.machining_time_s,
            measuring_time_s=self.time_s - self.machining_time_s,
            tool_wear_total_um=sum(wears_um) if wears_um else math.nan,
            reached=self.reached,
            link=self.link,
            channel=self.channel,
            home_um=self.home_um if math.isfinite(self.home_s) else math.nan,
            earlier_time_s=self.earlier_time_s,
            pause_s=self.pause_s,
        )
