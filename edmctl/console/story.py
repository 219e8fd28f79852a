"""A run told in sentences, in order, from the events of its file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from edmctl.console.jump_intervals import Jump, stretches
from edmctl.console.style import PLAIN, Ink, Style
from edmctl.wording import duration

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

LEFT_OUT = frozenset({"READING", "LINK", "STAGE_MOVED", "CONTROLLER_LOG", "JUMP_PERIOD", "APPROACHED"})
"""Single steps that the sentences about readings, jumps and cuts stand for."""
OF_A_HOLE = frozenset(
    {
        *("CUT_PLANNED", "CUT_ENDED", "CUT_DECIDED", "CUT_GIVEN_UP", "SITE_MEASURED", "SITE_ESTIMATED"),
        *("TARGET_REACHED", "TARGET_MISSED", "LEFT_UNMEASURED", "BREAKTHROUGH"),
    }
)
"""What happens to a hole: where there are several, these sentences begin with its name."""
PAD = "the reference pad"
DEBUG = 0


@dataclass(frozen=True, slots=True)
class Sentence:
    """One sentence of the story; `code` names the kind of event that it tells."""

    time_s: float
    text: str
    code: str


class EventView(Protocol):
    """An event of a run file. `code` is its name, `args` are its figures."""

    @property
    def time_s(self) -> float: ...
    @property
    def code(self) -> str: ...
    @property
    def level(self) -> int: ...
    @property
    def message(self) -> str: ...
    @property
    def args(self) -> Mapping[str, object]: ...


def story(events: Sequence[EventView], period_s: float, *, names_holes: bool = False) -> list[Sentence]:
    """Tell the events: jumps in stretches with their reason, hints where there are some, all else as recorded.

    period_s : jump period of the recipe
    names_holes : the job has several holes, so say which one it is about
    """
    told: list[Sentence] = []
    jumps: list[Jump] = []
    for event, hole in zip(events, holes_of(events), strict=True):
        if event.code == "JUMPED":
            jumps.append(_jump(event, period_s))
            continue
        if event.level == DEBUG or event.code in LEFT_OUT:
            continue
        if event.code == "CUT_ENDED" or event.code.endswith("_CHANGED") or event.code == "ENDED_EARLY":
            told += [Sentence(s.begin_s, s.text, "JUMPED") for s in stretches(jumps)]
            jumps.clear()
        name = f"{hole}: " if names_holes and hole and event.code in OF_A_HOLE else ""
        told.append(Sentence(event.time_s, f"{name}{event.message}", event.code))
        hint = event.args.get("hint")
        if isinstance(hint, str) and hint:
            told.append(Sentence(event.time_s, hint, "HINT"))
    told += [Sentence(s.begin_s, s.text, "JUMPED") for s in stretches(jumps)]
    return sorted(told, key=lambda sentence: sentence.time_s)


def holes_of(events: Sequence[EventView]) -> list[str]:
    """The hole that each event belongs to, empty where it is none; between holes the tool is nowhere."""
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


def render_story(sentences: Sequence[Sentence], style: Style = PLAIN) -> str:
    """Render a line per sentence, its time first."""
    times = [duration(sentence.time_s) for sentence in sentences]
    width = max((len(time) for time in times), default=0)
    return "\n".join(
        f"{style.paint(f'{time:>{width}}', Ink.FAINT)}  {sentence.text}"
        for time, sentence in zip(times, sentences, strict=True)
    )


def _jump(event: EventView, period_s: float) -> Jump:
    def figure(name: str, default: float) -> float:
        value = event.args.get(name)
        return float(value) if isinstance(value, int | float) else default

    # Older files say only whether they asked.
    flushing = bool(event.args.get("asked")) or figure("period_s", period_s) < period_s
    asking = {name: figure(f"asking_{name}", math.nan) for name in ("arcs", "shorts")}
    told = {name: share for name, share in asking.items() if math.isfinite(share)}
    return Jump(event.time_s, flushing, figure("arcs", 0.0), figure("shorts", math.nan), told)
