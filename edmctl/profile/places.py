"""The places of a job's holes: what the `[[sites]]` of a profile stand for, one by one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic, ProfileError
from edmctl.profile.codes import Code
from edmctl.profile.places_file import read_places_file

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from edmctl.errors import Location
    from edmctl.profile.model import Profile
    from edmctl.profile.sites import CircleSites, GridSites, PointSite

MOST_PLACES = 1000
"""More holes than any tool lasts for."""


@dataclass(frozen=True, slots=True)
class Place:
    """One hole to be: a name of its own, where in stage coordinates, and how deep; NaN where the target says it.

    `entry` is the item of `[[sites]]` that it comes from, counted from 0; `where` its line where that is a file.
    """

    name: str
    x_um: float
    y_um: float
    theta_deg: float = 0.0
    depth_um: float = math.nan
    entry: int = 0
    where: Location | None = field(default=None, compare=False)


def places(profile: Profile, base_folder: Path) -> tuple[Place, ...]:
    """Every place of a job in the order of the profile, none where it has no `[[sites]]`.

    A grid goes row by row, each row in the same direction; a circle goes from x towards y. Places without a name
    of their own are numbered, those of a grid or circle among themselves. Files are relative to `base_folder`.

    Raises ProfileError for a file that cannot be read, with every wrong line of it, and for more than
    `MOST_PLACES`.
    """
    found: list[Place] = []
    for entry, site in enumerate(profile.sites):
        if site.kind == "point":
            found.append(_place(site, entry, len(found) + 1))
        elif site.kind == "grid":
            found += _grid(site, entry)
        elif site.kind == "circle":
            found += _circle(site, entry)
        else:
            rows = read_places_file(base_folder / site.path)
            found += [
                replace(_place(row, entry, len(found) + number), where=line)
                for number, (row, line) in enumerate(rows, 1)
            ]
        if len(found) > MOST_PLACES:
            message = f"the sites are more than {MOST_PLACES} places"
            raise ProfileError((Diagnostic(Code.SITES, message, "make several jobs of them"),))
    return tuple(found)


def _place(site: PointSite, entry: int, number: int) -> Place:
    return Place(
        name=f"site-{number}" if site.name is None else site.name,
        x_um=site.x_um,
        y_um=site.y_um,
        theta_deg=site.theta_deg,
        depth_um=_or_nan(site.depth_um),
        entry=entry,
    )


def _grid(grid: GridSites, entry: int) -> Iterator[Place]:
    if grid.columns * grid.rows > MOST_PLACES:
        grid = grid.model_copy(update={"columns": MOST_PLACES + 1, "rows": 1})
    for number in range(grid.columns * grid.rows):
        row, column = divmod(number, grid.columns)
        yield Place(
            name=f"{grid.name}-{number + 1}",
            x_um=grid.x_um + column * grid.dx_um,
            y_um=grid.y_um + row * grid.dy_um,
            theta_deg=0.0,
            depth_um=_or_nan(grid.depth_um),
            entry=entry,
        )


def _circle(circle: CircleSites, entry: int) -> Iterator[Place]:
    for number in range(circle.count):
        angle = math.radians(circle.start_deg + 360.0 * number / circle.count)
        yield Place(
            name=f"{circle.name}-{number + 1}",
            x_um=circle.x_um + circle.radius_um * math.cos(angle),
            y_um=circle.y_um + circle.radius_um * math.sin(angle),
            theta_deg=0.0,
            depth_um=_or_nan(circle.depth_um),
            entry=entry,
        )


def _or_nan(depth_um: float | None) -> float:
    return math.nan if depth_um is None else depth_um
