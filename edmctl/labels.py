"""The words that stand beside a result: what it rests on, and whether it is what was wanted."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from enum import StrEnum

from edmctl.wording import UNKNOWN


class Basis(StrEnum):
    """What a depth or a wear is based on, the strongest first.

    `MODEL`: touched without a sensor, by the actuator's model; `ESTIMATED`: from feed and energy, without a touch.
    """

    TOUCHED = "touched"
    MODEL = "model"
    ESTIMATED = "estimated"


class Seen(StrEnum):
    """What a run has shown of a belief of the setup; `NEVER` of one that nothing in a run can show."""

    HELD = "held"
    CONTRADICTED = "contradicted"
    NOT = "not seen"
    NEVER = "cannot be seen"


class Verdict(StrEnum):
    """Whether a hole meets its target, the best first.

    `NOT_SHOWN`: its depth is inside the tolerance, but half its 95 % interval is wider. `MISSED`: outside.
    """

    SHOWN = "shown"
    NOT_SHOWN = "not shown"
    MISSED = "missed"


def is_doubtful(verdict: str | None) -> bool:
    """Whether a hole misses its target or is not shown to meet it."""
    return verdict in (Verdict.MISSED, Verdict.NOT_SHOWN)


PAD, PARKING = "the reference pad", "the parking place"
"""Names of the place where every Z1 and Z3 is touched, and of that beside the workpiece, in tables of holes."""
NOT_SHOWN_CODE = "E7013"
"""Error of a job with a depth that is not shown, and none that is missed."""

_HEADINGS = {Basis.TOUCHED: "measured", Basis.MODEL: "by model", Basis.ESTIMATED: "estimated"}
_MARKS: dict[str, str] = {Basis.MODEL: "≈", Basis.ESTIMATED: "~"}
_MEANINGS = {
    Basis.MODEL: "≈ touched without a sensor, by the actuator's model.",
    Basis.ESTIMATED: "~ estimated by feed and energy, not touched.",
}
_OPEN = {Basis.MODEL: "by the actuator's model", Basis.ESTIMATED: "not touched"}


def is_open(basis: str) -> bool:
    """Whether a mark in a figure is drawn open: the value was not touched with a sensor. Old files do not say."""
    return basis in _OPEN


def open_marks(bases: Iterable[str]) -> str:
    """Return what open marks of these bases mean; empty where there are none."""
    words = " or ".join(text for basis, text in reversed(_OPEN.items()) if basis in set(bases))
    return f"open: {words}" if words else ""


def weakest(bases: Iterable[str]) -> str:
    """Return the basis of a mean: that of its weakest part; empty without any."""
    return _last(Basis, bases)


def worst(verdicts: Iterable[str]) -> str:
    """Return the verdict over several holes: that of the worst; empty where none was judged."""
    return _last(Verdict, verdicts)


def basis_of(name: str, depth_basis: str | None, wear_basis: str | None) -> str:
    """Return the basis of the value `name` of a hole; what follows from depth and wear has the weaker of both.

    The depth of a hole through the sheet has none.
    """
    if name.startswith("wear_ratio") or not name.startswith(("depth", "wear", "mrr")):
        return weakest((depth_basis or "", wear_basis or ""))
    return (wear_basis if name.startswith("wear") else depth_basis) or ""


def heading(bases: Iterable[str | None]) -> str:
    """Return the heading of a column of values with these bases; if they differ, each value has its mark."""
    known = {basis for basis in bases if basis}
    return _HEADINGS[Basis(known.pop())] if len(known) == 1 else "result"


def marked(text: str, basis: str | None, head: str = "result") -> str:
    """Return a value with the mark of its basis before it.

    An unknown value has none, nor has one that was touched, or whose heading `head` states the basis.
    """
    is_bare = text.startswith(UNKNOWN) or head != "result"
    return text if is_bare else f"{_MARKS.get(basis or '', '')}{text}"


def meanings(bases: Collection[str | None], head: str = "result") -> list[str]:
    """Return what the marks of these bases mean, below a heading as in `marked`."""
    return [text for basis, text in _MEANINGS.items() if basis in bases and head == "result"]


def _last(order: type[Basis] | type[Verdict], words: Iterable[str]) -> str:
    found = set(words)
    return next((str(word) for word in reversed(list(order)) if word in found), "")
