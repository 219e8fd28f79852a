"""True values beside the results of a job on a virtual machine: they evaluate measurements and never make them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from edmctl.dataclasses import dataclass, field, replace
from edmctl.jobs.plan import Resumption
from edmctl.procedures.job import JobState, StateStore
from edmctl.process.erosion import corner_radius_um, roughness_rz_um
from edmctl.profile.model import Profile
from edmctl.results.job import ChannelTruth, SiteResult, SiteTruth

if TYPE_CHECKING:  # a job on hardware loads no simulator
    from edmctl.simulator import VirtualBench
    from edmctl.simulator.bench import HoleTruth

SAME_HOLE_UM = 50.0
"""Larger than the stage error, smaller than the distance of two holes: a hole farther away is not the site's."""
STEP_UM = 5.0
"""The floor is looked at every so often along the path."""


def channel_truth(profile: Profile, bench: VirtualBench, wear_um: float) -> ChannelTruth | None:
    """Return the floor of the channel in the height map; None if the recipe has no path or nothing was cut."""
    import numpy as np

    from edmctl.planning.channel import way_of_path

    path, target = profile.path, profile.target
    x_um, y_um, depth_um = bench.truth_map()
    if path is None or target.kind != "depth" or len(x_um) < 2 or len(y_um) < 2:
        return None
    way = way_of_path(path)
    places = np.array([way.at(s_um) for s_um in np.arange(0.0, way.length_um, STEP_UM)])
    columns = np.rint((places[:, 0] - x_um[0]) / (x_um[1] - x_um[0])).astype(np.int64)
    rows = np.rint((places[:, 1] - y_um[0]) / (y_um[1] - y_um[0])).astype(np.int64)
    floor_um = depth_um[np.clip(rows, 0, len(y_um) - 1), np.clip(columns, 0, len(x_um) - 1)]
    error_um = math.sqrt(float(np.mean((floor_um - target.depth_um) ** 2)))
    return ChannelTruth(float(floor_um.mean()), float(floor_um.std()), error_um, wear_um)


ABANDONED = "left"
"""Name of an abandoned hole; with a number and a space it cannot be the name of a site."""


@dataclass(slots=True, eq=False)
class TrueWear:
    """Notes the true wear at each site, and passes job states to `journal`.

    `before_um` is the tool's wear when the job begins.
    """

    bench: VirtualBench
    journal: StateStore
    before_um: float = 0.0
    _at_end_um: dict[str, float] = field(default_factory=dict)
    _abandoned_um: float = math.inf

    def __post_init__(self) -> None:
        self.before_um = self.bench.tool_wear_um

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Note the wear at the end of every site that is done by now, and pass the state on."""
        self._note_abandoned()
        newest_first = (str(site["name"]) for site in reversed(state.done))
        finished = list(takewhile(lambda name: name not in self._at_end_um, newest_first))
        self._at_end_um |= dict.fromkeys(reversed(finished), self.bench.tool_wear_um)
        self.journal.keep(state, urgent=urgent)

    def as_mapping(self) -> dict[str, object]:
        """Return the state that a resumed run needs."""
        self._note_abandoned()
        return {"tool_wear_um": self.before_um, "at_end_um": dict(self._at_end_um)}

    def resume(self, resumed: Resumption) -> None:
        """Count from where the interrupted run began, with the sites that it finished.

        Wear since the last finished site belongs to no site if the interrupted hole is made from the start.
        """
        truth: Mapping[str, Any] | None = resumed.journal.truth
        if truth is None:
            return
        self.before_um = float(truth["tool_wear_um"])
        self._at_end_um = {str(name): float(wear_um) for name, wear_um in truth["at_end_um"].items()}
        if resumed.restart_hole:
            self._abandoned_um = self.bench.tool_wear_um

    def of_site(self, name: str) -> float:
        """Return the true wear at a site, up to now if the job has not left it."""
        self._note_abandoned()
        names = list(self._at_end_um)
        if name not in self._at_end_um:
            return self.bench.tool_wear_um - max([self.before_um, *self._at_end_um.values()])
        position = names.index(name)
        begin_um = self._at_end_um[names[position - 1]] if position else self.before_um
        return self._at_end_um[name] - begin_um

    def at_end_of(self, name: str) -> float:
        """Return the wear of the tool when it left a site, or by now."""
        return self._at_end_um.get(name, self.bench.tool_wear_um)

    def _note_abandoned(self) -> None:
        if self.bench.tool_wear_um > self._abandoned_um:
            self._at_end_um[f"{ABANDONED} {len(self._at_end_um)}"] = self._abandoned_um
            self._abandoned_um = math.inf


def truths_of(
    sites: Sequence[SiteResult], holes: Sequence[HoleTruth], true_wear: TrueWear, tool_um: float = math.nan
) -> tuple[SiteTruth, ...]:
    """Return the true hole of each site, in µm: the nearest hole, and the tool wear at the site.

    A hole through the foil has no depth. `tool_um` is the diameter of the tool.
    """

    def truth_of(site: SiteResult) -> SiteTruth:
        wear_um = true_wear.of_site(site.name)
        truth = SiteTruth(
            wear_um=wear_um, corner_um=corner_radius_um(true_wear.at_end_of(site.name), tool_um)
        )
        distances_um = [math.dist((site.x_um, site.y_um), (hole.x_um, hole.y_um)) for hole in holes]
        if min(distances_um, default=math.inf) > SAME_HOLE_UM:
            return truth
        hole = holes[distances_um.index(min(distances_um))]
        return replace(
            truth,
            depth_um=math.nan if site.through else hole.depth_um,
            side_gap_um=hole.side_gap_um,
            taper_um=hole.taper_um,
            ra_um=hole.ra_um,
            rz_um=roughness_rz_um(hole.ra_um),
        )

    return tuple(map(truth_of, sites))
