"""Many jumps in few sentences: stretches in which arcs had shortened the period, and those in which they had not."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

from edmctl.console.text import duration, plural

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class Jump:
    """One jump. `is_flushing`: arcs or shorts have made the period shorter; `arcs` is their share since the last."""

    time_s: float
    is_flushing: bool
    arcs: float


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
    arcs = [jump.arcs for jump in group]
    mean, most = 100.0 * sum(arcs) / len(arcs), 100.0 * max(arcs)
    why = "as its period asks for"
    if flushing:
        why = (
            "because arcs or shorts asked for more flushing: "
            f"{mean:.1f} % arcs between jumps on average, {most:.1f} % at most"
        )
    elif most > 0.0:
        why += f"; {mean:.1f} % arcs between jumps"
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
