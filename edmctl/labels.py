"""The words that stand beside a result: what it rests on, and whether it meets what was wanted."""

from __future__ import annotations

from enum import StrEnum


class Basis(StrEnum):
    """What a depth or a wear rests on.

    `TOUCHED` by the tool, with a displacement sensor; `MODEL` touched likewise where no sensor is fitted, so that
    the displacement is that of the actuator's model; `ESTIMATED` from feed and energy, without a touch of its own.
    """

    TOUCHED = "touched"
    ESTIMATED = "estimated"
    MODEL = "model"


class Verdict(StrEnum):
    """Whether a hole is what was wanted.

    `MISSED`: its value lies outside the tolerance. `NOT_SHOWN`: it lies inside, but half its 95 % interval is wider
    than the tolerance, so that nobody knows.
    """

    SHOWN = "shown"
    MISSED = "missed"
    NOT_SHOWN = "not shown"


MARKS = {Basis.TOUCHED: "", Basis.ESTIMATED: "~", Basis.MODEL: "≈"}
"""What a number begins with in a table of several bases."""
MARKS_TOLD = {
    Basis.ESTIMATED: "~: estimated by feed and energy, not touched.",
    Basis.MODEL: "≈: touched without a sensor, by the actuator's model.",
}
NOT_SHOWN_CODE = "E7013"
"""Of a job whose depth is not shown to be within its tolerance."""
