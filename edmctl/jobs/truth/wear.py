"""What a virtual tool truly loses at each site: its wear is looked at whenever the job is between two of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from edmctl.procedures.job_state import JobState, StateStore
    from edmctl.simulator import VirtualBench
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
        for site in state.done:
            self._at_end_um.setdefault(str(site["name"]), self.bench.tool_wear_um)
        self.journal.keep(state, urgent=urgent)

    def as_mapping(self) -> dict[str, object]:
        """What a run that goes on with this one has to know."""
        self._look()
        return {"tool_wear_um": self.before_um, "at_end_um": dict(self._at_end_um)}

    def go_on_from(self, truth: Mapping[str, Any]) -> None:
        """Count from where the run before began, with the sites that it finished."""
        self.before_um = float(truth["tool_wear_um"])
        self._at_end_um = {str(name): float(wear_um) for name, wear_um in truth["at_end_um"].items()}

    def leave_hole(self) -> None:
        """What was worn since the last finished site is no site's once its hole is made anew and sparks."""
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

    def _look(self) -> None:
        if self.bench.tool_wear_um > self._given_up_um:
            self._at_end_um[f"{LEFT} {len(self._at_end_um)}"] = self._given_up_um
            self._given_up_um = math.inf
