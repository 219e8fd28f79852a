"""Many jumps in few sentences: stretches in which arcs had shortened the period, and those in which they had not."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

from edmctl.wording import duration, plural

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


@dataclass(frozen=True, slots=True)
class Jump:
    """One jump. `is_flushing`: arcs or shorts have made the period shorter.

    `arcs` and `shorts` are their shares since the last jump, NaN where the file does not tell; `asking` are the
    shares of those of them that asked for this one.
    """

    time_s: float
    is_flushing: bool
    arcs: float
    shorts: float = math.nan
    asking: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Stretch:
    """A sentence about jumps of one kind, the first at `begin_s`."""

    begin_s: float
    text: str


def stretches(jumps: Sequence[Jump]) -> list[Stretch]:
    """Group the jumps of one cut, in order of time."""
    groups = [
        (flushing, list(group)) for flushing, group in groupby(jumps, key=lambda jump: jump.is_flushing)
    ]
    return [Stretch(group[0].time_s, _sentence(group, flushing)) for flushing, group in groups]


def _sentence(group: Sequence[Jump], flushing: bool) -> str:
    why = "as its period asks for"
    if flushing:
        most: dict[str, float] = {}
        for jump in group:
            for name, share in jump.asking.items():
                most[name] = max(share, most.get(name, 0.0))
        why = f"because {' and '.join(most) or 'arcs or shorts'} asked for more flushing"
        if most:
            why += ": up to " + " and ".join(f"{100.0 * share:.1f} % {name}" for name, share in most.items())
            why += " within a second"
    between = [
        f"{100.0 * mean:.1f} % {name}"
        for name in ("arcs", "shorts")
        if (mean := sum(getattr(jump, name) for jump in group) / len(group)) >= 0.0005
    ]
    if between:
        why += f"; {' and '.join(between)} between jumps" + (" on average" if flushing else "")
    if len(group) == 1:
        return f"It jumped once, {why}."
    times_s = [jump.time_s for jump in group]
    gaps_s = sorted(later - earlier for earlier, later in pairwise(times_s))
    low, high = f"{gaps_s[0]:.2g}", f"{gaps_s[-1]:.2g}"
    every = f"every {low} s" if low == high else f"every {low}–{high} s"
    return (
        f"From {duration(times_s[0])} to {duration(times_s[-1])} it jumped {plural(len(group), 'time')}, "
        f"{every}, {why}."
    )
