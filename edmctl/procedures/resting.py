"""Rests that end with samples of the machine as it stands then."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import LinkLost

if TYPE_CHECKING:
    from edmctl.procedures.run import Run

LOOK_S = 0.1
LONGEST_S = 5.0
"""A line that brings no sample for so long, but answers, is not one to lower a tool by."""


def rest_and_look(run: Run, duration_s: float) -> None:
    """Rest for a time, and on until a sample has come that was taken in it.

    Time passes on a host that is held up and on a line that loses frames too, but what the tool did meanwhile is not
    known then, and a ramp that is planned from an older place goes too far. Raises LinkLost E4022 when no sample
    comes.
    """
    begin_s = run.machine.time_s
    run.machine.rest(duration_s)
    looks = 0
    while run.watch.newest_s <= begin_s:
        if looks * LOOK_S > LONGEST_S:
            raise LinkLost(
                f"No samples have come for {run.machine.time_s - run.watch.newest_s:.1f} s, so nobody knows where "
                "the tool stands; it was retracted.",
                hint="Look at the line with `edmctl doctor`, and at what else keeps this computer busy.",
                code="E4022",
            )
        run.machine.rest(LOOK_S)
        looks += 1
