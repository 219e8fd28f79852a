"""Events of a run file with their names, and as sentences in order of time.

Many jumps come to few sentences: intervals in which arcs had shortened the period, and those in which they had not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

from edmctl.dataclasses import dataclass, field
from edmctl.labels import PAD
from edmctl.link.faults import FAULTS
from edmctl.record.events import recorded_events
from edmctl.record.rows import RunEvent
from edmctl.results.run_file import FileEvent, Sentence
from edmctl.wording import duration, plural

if TYPE_CHECKING:
    from edmctl.record.reader import RunFile

LEFT_OUT = frozenset({"READING", "LINK", "STAGE_MOVED", "CONTROLLER_LOG", "JUMP_PERIOD", "APPROACHED"})
"""Single steps that the sentences about readings, jumps and cuts stand for."""
OF_A_HOLE = frozenset(
    {
        *("CUT_PLANNED", "CUT_ENDED", "CUT_DECIDED", "CUT_GIVEN_UP", "SITE_MEASURED", "SITE_ESTIMATED"),
        *("TARGET_REACHED", "TARGET_MISSED", "LEFT_UNMEASURED", "BREAKTHROUGH"),
    }
)
"""What happens to a hole: where there are several, these sentences begin with its name."""
DEBUG = 0


@dataclass(frozen=True, slots=True)
class Jump:
    """One jump. `is_flushing`: arcs or shorts have made the period shorter.

    `arcs` and `shorts` are their shares since the last jump, NaN where the file has none; `asking` are the
    shares of those of them that asked for this one.
    """

    time_s: float
    is_flushing: bool
    arcs: float
    shorts: float = math.nan
    asking: Mapping[str, float] = field(default_factory=dict)


def events_of(opened: RunFile, start: int = 0) -> list[FileEvent]:
    """The events of the file from row `start` on, in the order in which they were written."""
    from edmctl.machine.interface import EventCode

    names = {int(code): code.name for code in (*EventCode, *RunEvent)}
    found = []
    for event in recorded_events(opened, start=start):
        name, args = names.get(event.code, str(event.code)), dict(event.values)
        if name == RunEvent.ENDED_EARLY.name and not args.get("hint"):
            code = str(args.get("code", ""))
            args["hint"] = next((row.hint for row in FAULTS.values() if row.error == code), "")
        found.append(FileEvent(event.time_s, name, event.level, event.message, args))
    return found


def event_sentences(
    events: Sequence[FileEvent], period_s: float, *, names_holes: bool = False
) -> list[Sentence]:
    """Describe the events: jumps by intervals with their reason, hints where there are some, all else as recorded.

    period_s : jump period of the recipe
    names_holes : the job has several holes, so say which one it is about
    """
    sentences: list[Sentence] = []
    jumps: list[Jump] = []
    for event, hole in zip(events, holes_of(events), strict=True):
        if event.code == "JUMPED":
            jumps.append(_jump(event, period_s))
            continue
        if event.level == DEBUG or event.code in LEFT_OUT:
            continue
        if event.code == "CUT_ENDED" or event.code.endswith("_CHANGED") or event.code == "ENDED_EARLY":
            sentences += jump_sentences(jumps)
            jumps.clear()
        name = f"{hole}: " if names_holes and hole and event.code in OF_A_HOLE else ""
        sentences.append(Sentence(event.time_s, f"{name}{event.message}", event.code))
        hint = event.args.get("hint")
        if isinstance(hint, str) and hint:
            sentences.append(Sentence(event.time_s, hint, "HINT"))
    sentences += jump_sentences(jumps)
    return sorted(sentences, key=lambda sentence: sentence.time_s)


def holes_of(events: Sequence[FileEvent]) -> list[str]:
    """Return the hole that each event belongs to, empty where it is none; between holes the tool is nowhere."""
    found, hole = [], ""
    for event in events:
        if event.code == "STAGE_MOVED":
            place = event.message.removeprefix("At ").rpartition(" (")[0]
            hole = hole if place == PAD else place
        elif event.code == "FACE_FITTED":
            hole = ""
        found.append(hole)
        if event.code in ("TARGET_REACHED", "TARGET_MISSED"):
            hole = ""
    return found


def _jump(event: FileEvent, period_s: float) -> Jump:
    def figure(name: str, default: float) -> float:
        value = event.args.get(name)
        return float(value) if isinstance(value, int | float) else default

    # Older files say only whether they asked.
    flushing = bool(event.args.get("asked")) or figure("period_s", period_s) < period_s
    asking = {name: figure(f"asking_{name}", math.nan) for name in ("arcs", "shorts")}
    known = {name: share for name, share in asking.items() if math.isfinite(share)}
    return Jump(event.time_s, flushing, figure("arcs", 0.0), figure("shorts", math.nan), known)


def jump_sentences(jumps: Sequence[Jump]) -> list[Sentence]:
    """Describe the jumps of one cut, in order of time, by intervals with and without a shortened period."""
    groups = [
        (flushing, list(group)) for flushing, group in groupby(jumps, key=lambda jump: jump.is_flushing)
    ]
    return [Sentence(group[0].time_s, _sentence(group, flushing), "JUMPED") for flushing, group in groups]


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
