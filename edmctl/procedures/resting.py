"""Rests that end with samples of the machine as it stands then."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmctl.procedures.run import Run

LOOK_S = 0.1


def rest_and_look(run: Run, duration_s: float) -> None:
    """Rest for a time, and on until a sample has come that was taken in it.

    Time passes on a host that is held up and on a line that loses frames too, but what the tool did meanwhile is not
    known then, and a ramp that is planned from an older place goes too far. Where no sample comes at all the rest
    raises LinkLost E4022, as every wait does.
    """
    begin_s = run.machine.time_s
    run.machine.rest(duration_s)
    while run.watch.newest_s <= begin_s:
        run.machine.rest(LOOK_S)
