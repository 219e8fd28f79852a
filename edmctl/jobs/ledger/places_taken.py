"""Where a hole may go beside those that are there."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from edmctl.errors import PreconditionError, UsageError
from edmctl.planning.rules.sites import unreachable
from edmctl.procedures.job import Job
from edmctl.profile.findings import PAD_MARGIN_UM
from edmctl.record.ledger import SiteMachined
from edmctl.wording import coordinates, length

WALL_UM = 50.0
"""Left standing between two holes that are placed one after the other: several times what the stages and the rim of
a hole take of it. Our choice."""

Place = tuple[str, float, float]
"""Name, x and y of an axis, µm."""


def next_free_x_um(
    reference_x_um: float, y_um: float, step_um: float, radius_um: float, holes: Sequence[SiteMachined]
) -> float:
    """Return the first x in steps from the pad where a hole of `radius_um` is clear of all others.

    Without a step the first place is the pad itself, and the next ones lie a hole and a wall further.
    """
    x_um, stride_um = reference_x_um + step_um, step_um or 2.0 * radius_um + WALL_UM
    while ends_um := [
        hole.x_um + math.sqrt(clear_um**2 - (hole.y_um - y_um) ** 2)
        for hole in holes
        if math.hypot(hole.x_um - x_um, hole.y_um - y_um) < (clear_um := hole.radius_um + radius_um + WALL_UM)
    ]:
        x_um += stride_um * max(1, math.ceil((max(ends_um) - x_um) / stride_um))
    return x_um


def refuse_taken(
    places: Iterable[Place], radius_um: float, holes: Sequence[SiteMachined], folder: Path
) -> None:
    """Raise PreconditionError E8042 where a hole would run into one that is there."""
    for name, x_um, y_um in places:
        for hole in holes:
            if math.hypot(hole.x_um - x_um, hole.y_um - y_um) < hole.radius_um + radius_um:
                raise PreconditionError(
                    f"{name} at {coordinates(x_um, y_um)} would run into {hole_in_words(hole, folder)}.",
                    hint="Give it another place, or keep the run files of new work in another folder with --out; "
                    "`edmctl machine --resume` finishes an interrupted hole or channel.",
                    code="E8042",
                )


def refuse_unreachable(place: Place, job: Job) -> None:
    """Raise PreconditionError E8042 for a place beyond the stages' travel or the workpiece."""
    half_um = job.profile.tool.diameter_um / 2.0 + job.profile.work.side_gap_um
    if found := unreachable(*place, job.setup, half_um):
        message, hint = found
        raise PreconditionError(f"{message}.", hint=f"{hint[0].upper()}{hint[1:]}.", code="E8042")


def refuse_pad(place: Place, job: Job) -> None:
    """Raise PreconditionError E8042 where sparks would be made on the pad, which all touches count from."""
    name, x_um, y_um = place
    tool, pad = job.profile.tool, job.pad
    clear_um = tool.diameter_um + job.profile.work.side_gap_um + PAD_MARGIN_UM
    away_um = math.hypot(x_um - pad.x_um, y_um - pad.y_um)
    if away_um < clear_um:
        raise PreconditionError(
            f"{name} at {coordinates(x_um, y_um, 1)} is {length(away_um)} from the reference pad; sparks there "
            "would spoil what Z1 and Z3 are touched on.",
            hint=f"Keep {clear_um:.0f} µm away, or touch it with --contact.",
            code="E8042",
        )


def hole_in_words(hole: SiteMachined, folder: Path) -> str:
    """A hole in words: name, depth, place, and the run file in `folder` that tells of it."""
    depth = "of unknown depth" if math.isnan(hole.depth_um) else f"{length(hole.depth_um)} deep"
    if hole.through:
        depth = "through the sheet"
    where = coordinates(hole.x_um, hole.y_um)
    return f"{hole.name}, {depth} at {where}, {hole.status}, recorded in {folder / hole.run_file}"


def place_of(text: str | None) -> tuple[float, float] | None:
    """Return the stage coordinates that are named, None where none are. Raises UsageError E2061."""
    place = None if text is None else coordinates_in(text)
    if text is not None and place is None:
        raise no_place(text)
    return place


def coordinates_in(text: str) -> tuple[float, float] | None:
    """Return x and y in µm where the text is two numbers with a comma between them."""
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        return None
    if len(numbers) != 2 or not all(map(math.isfinite, numbers)):
        return None
    return numbers[0], numbers[1]


def no_place(text: str) -> UsageError:
    """Return the error of a text that names no place."""
    return UsageError(
        f"--site {text} is no X,Y in µm.", hint="Say two numbers, e.g. --site 500,0.", code="E2061"
    )
