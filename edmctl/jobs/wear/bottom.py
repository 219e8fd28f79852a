"""Which hole `measure-wear` touches the bottom of."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError
from edmctl.jobs.resume.way_on import command_to_go_on
from edmctl.jobs.site_option import coordinates
from edmctl.procedures.measure_wear import Bottom
from edmctl.process.next_cut import COVERAGE
from edmctl.record.ledger_entries import UNFINISHED
from edmctl.wording import length

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.record.ledger_entries import SiteMachined
    from edmctl.record.tool_account import Books, ToolAccount

MOST_NAMES = 8
"""More of them nobody reads in a message."""


def bottom_of(
    asked: str | None, books: Books, account: ToolAccount, diameter_um: float, folder: Path
) -> Bottom | None:
    """Return the hole that was asked for, or else the last one that the tool made and measured; None without any.

    `folder` holds the run files.

    Raises PreconditionError: E8045 no such hole, or one of unknown depth; E8046 the tool does not go into it.
    """
    if asked is None:
        made = [hole for hole in account.holes if hole.status != UNFINISHED]
        return _bottom(made[-1]) if made else None
    hole = _asked(asked, books.holes)
    if hole is None:
        names = "; ".join(_told(hole) for hole in books.holes[-MOST_NAMES:]) or "none"
        raise PreconditionError(
            f"The ledger knows no hole {asked!r}; it knows: {names}.",
            hint="Name one of them, its run id, or say --site X,Y within its rim.",
            code="E8045",
        )
    if math.isnan(hole.depth_um):
        run_file = folder / hole.run_file
        command = command_to_go_on(run_file)
        raise PreconditionError(
            f"Nobody knows how deep {hole.name} is: {run_file} ended before it was measured.",
            hint=f"Finish it with `{command}`, or name another hole with --site."
            if command
            else "Name another hole with --site.",
            code="E8045",
        )
    if diameter_um >= 2.0 * hole.radius_um:
        raise PreconditionError(
            f"A tool of {length(diameter_um)} does not go into {hole.name}, which is {length(2.0 * hole.radius_um)} "
            "wide.",
            hint="Name a hole that this tool made, or leave --site out.",
            code="E8046",
        )
    return _bottom(hole)


def _asked(asked: str, holes: list[SiteMachined]) -> SiteMachined | None:
    """The last hole of that name or else of that run, or the one around that place."""
    place = coordinates(asked)
    if place is None:
        named = [hole for hole in holes if hole.name == asked]
        of_run = [hole for hole in holes if hole.run_file.removesuffix(".h5") == asked.removesuffix(".h5")]
        return next(reversed(named or of_run), None)
    x_um, y_um = place
    return next(
        (
            hole
            for hole in reversed(holes)
            if math.hypot(hole.x_um - x_um, hole.y_um - y_um) <= hole.radius_um
        ),
        None,
    )


def _told(hole: SiteMachined) -> str:
    run_id = hole.run_file.removesuffix(".h5")
    return f"{hole.name} at {hole.x_um:.0f},{hole.y_um:.0f} of {run_id}"


def _bottom(hole: SiteMachined) -> Bottom:
    known = Bottom(hole.name, hole.x_um, hole.y_um, hole.depth_um)
    return known if math.isnan(hole.depth_u95_um) else replace(known, depth_u_um=hole.depth_u95_um / COVERAGE)
