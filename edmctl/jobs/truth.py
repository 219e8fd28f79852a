"""What the virtual machine truly has, for judging measurements, never for making them: channels and wear."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from edmctl.dataclasses import dataclass, field
from edmctl.errors import RunFileError
from edmctl.jobs.plan import Resumption
from edmctl.procedures.job_state import JobState, StateStore
from edmctl.record.rows import Recorder, TruthMap
from edmctl.results.job import ChannelTruth

if TYPE_CHECKING:
    from edmctl.profile.model import Profile
    from edmctl.simulator import VirtualBench

STEP_UM = 5.0
"""The floor is looked at every so often along the path."""


def channel_truth(profile: Profile, bench: VirtualBench, wear_um: float) -> ChannelTruth | None:
    """Look along the path in the height map; None where the recipe has no path or nothing was cut."""
    import numpy as np

    from edmctl.procedures.channel.way import way_of_path

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


def keep_truth_map(recorder: Recorder, bench: VirtualBench) -> None:
    """Write the height map of the work into the run file. A disk that failed is told at the end of the file."""
    with suppress(RunFileError):
        recorder.append(TruthMap(*bench.truth_map()))


LEFT = "left"
"""Stands for a hole that was given up; with a number and a space it is the name of no site."""


@dataclass(slots=True, eq=False)
class TrueWear:
    """A journal on the way to `journal`. `before_um` is the tool's wear when the job begins."""

    bench: VirtualBench
    journal: StateStore
    before_um: float = 0.0
    _at_end_um: dict[str, float] = field(default_factory=dict)
    _given_up_um: float = math.inf

    def __post_init__(self) -> None:
        self.before_um = self.bench.tool_wear_um

    def keep(self, state: JobState, *, urgent: bool = False) -> None:
        """Note the wear at the end of every site that is done by now, and hand the state on."""
        self._look()
        newest_first = (str(site["name"]) for site in reversed(state.done))
        finished = list(takewhile(lambda name: name not in self._at_end_um, newest_first))
        self._at_end_um |= dict.fromkeys(reversed(finished), self.bench.tool_wear_um)
        self.journal.keep(state, urgent=urgent)

    def as_mapping(self) -> dict[str, object]:
        """What a run that goes on with this one has to know."""
        self._look()
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
            self._given_up_um = self.bench.tool_wear_um

    def of_site(self, name: str) -> float:
        """True wear at a site, up to now where the job has not left it."""
        self._look()
        names = list(self._at_end_um)
        if name not in self._at_end_um:
            return self.bench.tool_wear_um - max([self.before_um, *self._at_end_um.values()])
        position = names.index(name)
        begin_um = self._at_end_um[names[position - 1]] if position else self.before_um
        return self._at_end_um[name] - begin_um

    def at_end_of(self, name: str) -> float:
        """All that the tool had lost when it left a site, or by now."""
        return self._at_end_um.get(name, self.bench.tool_wear_um)

    def _look(self) -> None:
        if self.bench.tool_wear_um > self._given_up_um:
            self._at_end_um[f"{LEFT} {len(self._at_end_um)}"] = self._given_up_um
            self._given_up_um = math.inf
