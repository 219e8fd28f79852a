"""The places of a job's holes: what the `[[sites]]` of a profile stand for, one by one, CSV files among them."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from pydantic import ValidationError

from edmctl.csv_text import cells_of, span_of
from edmctl.dataclasses import dataclass, field, replace
from edmctl.errors import Diagnostic, Location, ProfileError
from edmctl.failures import Code
from edmctl.files import read_bytes, user_path
from edmctl.profile.folders import is_file
from edmctl.profile.model import CircleSites, GridSites, PointSite, Profile
from edmctl.profile.tables import nearest, permitted_at

MOST_PLACES = 1000  # more holes than any tool lasts for
COLUMNS = ("name", "x_um", "y_um", "theta_deg", "depth_um")
NEEDED = ("x_um", "y_um")
MOST_COMPLAINTS = 20  # of one file: more wrong lines than this are one mistake in all of them
_FORM = "the first line names the columns, x_um,y_um at least; each further line is a place"


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

    A grid goes row by row, a circle from x towards y. Places without a name are numbered, those of a grid or circle
    among themselves. Files are relative to `base_folder`. Raises ProfileError with every wrong line of a file, and
    for more than `MOST_PLACES`.
    """
    found: list[Place] = []
    for entry, site in enumerate(profile.sites):
        if site.kind == "point":
            found.append(_place(site, entry, len(found) + 1))
        elif site.kind == "file":
            rows = read_places_file(user_path(site.path, base_folder))
            found += [_place(row, entry, n, line) for n, (row, line) in enumerate(rows, len(found) + 1)]
        else:
            points = islice(_grid(site) if site.kind == "grid" else _circle(site), MOST_PLACES + 1)
            depth_um = _or_nan(site.depth_um)
            found += [
                Place(f"{site.name}-{n}", x_um, y_um, depth_um=depth_um, entry=entry)
                for n, (x_um, y_um) in enumerate(points, 1)
            ]
        if len(found) > MOST_PLACES:
            message = f"the sites are more than {MOST_PLACES} places"
            raise ProfileError((Diagnostic(Code.SITES, message, "make several jobs of them"),))
    return tuple(found)


def _place(site: PointSite, entry: int, number: int, where: Location | None = None) -> Place:
    name = f"site-{number}" if site.name is None else site.name
    return Place(name, site.x_um, site.y_um, site.theta_deg, _or_nan(site.depth_um), entry, where)


def _or_nan(depth_um: float | None) -> float:
    return math.nan if depth_um is None else depth_um


def _grid(grid: GridSites) -> Iterator[tuple[float, float]]:
    for number in range(grid.columns * grid.rows):
        row, column = divmod(number, grid.columns)
        yield grid.x_um + column * grid.dx_um, grid.y_um + row * grid.dy_um


def _circle(circle: CircleSites) -> Iterator[tuple[float, float]]:
    r = circle.radius_um
    for number in range(circle.count):
        angle = math.radians(circle.start_deg + 360.0 * number / circle.count)
        yield circle.x_um + r * math.cos(angle), circle.y_um + r * math.sin(angle)


def read_places_file(path: Path) -> list[tuple[PointSite, Location]]:
    """Read the places of a CSV file and their lines. Raises ProfileError with every wrong line, or without any."""
    wrong: list[Diagnostic] = []
    found: list[tuple[PointSite, Location]] = []
    columns: list[str] = []
    for line in _lines(path):
        try:
            cells = cells_of(line.source_line, strict=True)
            if cells and columns:
                found.append((_point(line, columns, cells), line))
            elif cells:
                columns = _header(line, cells)
        except csv.Error as error:
            wrong += _refusal(f"no CSV: {error}", _FORM, line).diagnostics
        except ProfileError as error:
            wrong += error.diagnostics
        if wrong and (not columns or len(wrong) >= MOST_COMPLAINTS):
            break
    if wrong:
        raise ProfileError(tuple(wrong))
    if not found:
        raise _refusal(f"{path} holds no places", _FORM, Location(str(path), 1, 1))
    return found


def _refusal(message: str, hint: str, line: Location | None = None, cell: int | None = None) -> ProfileError:
    if line and cell is not None:
        begin, length = span_of(line.source_line, ",", cell)
        line = replace(line, column=begin + 1, length=max(1, length))
    return ProfileError((Diagnostic(Code.PLACES_FILE, message, hint, line),))


def _lines(path: Path) -> list[Location]:
    name = str(path)
    if not is_file(path):
        raise _refusal(f"there is no file {name}", "the name is relative to the profile that holds it")
    try:
        lines = read_bytes(path).decode("utf-8-sig").replace("\r\n", "\n").split("\n")
    except OSError as error:
        raise _refusal(f"cannot read {name}: {error.strerror}", "check its permissions") from error
    except UnicodeDecodeError as error:
        raise _refusal(f"{name} is not UTF-8 text", "save it as CSV in UTF-8") from error
    return [Location(name, number, 1, max(1, len(line)), line) for number, line in enumerate(lines, 1)]


def _header(line: Location, cells: list[str]) -> list[str]:
    if len(cells) == 1 and (";" in cells[0] or "\t" in cells[0]):
        raise _refusal("the columns are not separated by commas", _FORM, line)
    for index, column in enumerate(cells):
        if column not in COLUMNS:
            close = nearest(column, list(COLUMNS))
            hint = f"did you mean {close}?" if close else f"the columns are {', '.join(COLUMNS)}"
            raise _refusal(f"unknown column {column}", hint, line, index)
        if column in cells[:index]:
            raise _refusal(f"there are two columns {column}", "remove one of the two", line, index)
    if missing := [column for column in NEEDED if column not in cells]:
        raise _refusal(f"the column {missing[0]} is missing", _FORM, line)
    return cells


def _point(line: Location, columns: list[str], cells: list[str]) -> PointSite:
    if len(cells) > len(columns):
        message = f"{len(cells)} cells under {len(columns)} columns"
        raise _refusal(message, "write numbers with a point, and one comma from cell to cell", line)
    given = {column: cell for column, cell in zip(columns, cells, strict=False) if cell}
    try:
        return PointSite.model_validate_strings(dict.fromkeys(NEEDED, "") | given)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
    column = str(first["loc"][0])
    what = "is no number" if first["type"] == "float_parsing" else "is out of range"
    what = f"= {given[column]} {what}" if column in given else "is missing"
    hint = f"write {permitted_at(PointSite, (column,))}"
    raise _refusal(f"{column} {what}", hint, line, columns.index(column))
