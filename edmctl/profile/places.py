"""The places of a job's holes: what the `[[sites]]` of a profile stand for, one by one, CSV files among them."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from edmctl.csv_text import cells_of, span_of
from edmctl.errors import Diagnostic, Location, ProfileError
from edmctl.files import read_bytes, user_path
from edmctl.profile.findings import Code
from edmctl.profile.folders import is_file
from edmctl.profile.model import Profile
from edmctl.profile.sites import CircleSites, GridSites, PointSite

MOST_PLACES = 1000
"""More holes than any tool lasts for."""
COLUMNS = ("name", "x_um", "y_um", "theta_deg", "depth_um")
NEEDED = ("x_um", "y_um")
MOST_COMPLAINTS = 20
"""Of one file: more wrong lines than this are one mistake in all of them."""
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
            rows = read_places_file(user_path(site.path, base_folder))
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


def read_places_file(path: Path) -> list[tuple[PointSite, Location]]:
    """Read the places of a CSV file and their lines, UTF-8 with commas; an empty cell stands for what is not given.

    Raises ProfileError with every wrong line, or when there is no such file or no place in it.
    """
    wrong: list[Diagnostic] = []
    found: list[tuple[PointSite, Location]] = []
    columns: list[str] = []
    for line in _lines(path):
        try:
            cells = line.cells()
            if not any(cells):
                continue
            if columns:
                found.append((_point(line, columns, cells), line.location()))
            else:
                columns = _header(line, cells)
        except ProfileError as error:
            wrong += error.diagnostics
            if not columns or len(wrong) >= MOST_COMPLAINTS:
                break
    if not wrong and not found:
        wrong.append(
            Diagnostic(Code.PLACES_FILE, f"{path} holds no places", _FORM, Location(str(path), 1, 1))
        )
    if wrong:
        raise ProfileError(tuple(wrong))
    return found


@dataclass(frozen=True, slots=True)
class _Line:
    """A line of the file; lines count from 1."""

    file: str
    number: int
    text: str

    def cells(self) -> list[str]:
        """Its cells; raises ProfileError where it is no CSV."""
        try:
            return cells_of(self.text, strict=True)
        except csv.Error as error:
            raise self.wrong(f"no CSV: {error}", _FORM) from error

    def location(self, cell: int | None = None) -> Location:
        """Return where the line is, or one of its cells."""
        begin, length = (0, len(self.text)) if cell is None else span_of(self.text, ",", cell)
        return Location(self.file, self.number, begin + 1, max(1, length), self.text)

    def wrong(self, message: str, hint: str, cell: int | None = None) -> ProfileError:
        """Return a complaint about the line, or about one of its cells."""
        return ProfileError((Diagnostic(Code.PLACES_FILE, message, hint, self.location(cell)),))


def _lines(path: Path) -> list[_Line]:
    name = str(path)
    if not is_file(path):
        raise _unreadable(f"there is no file {name}", "the name is relative to the profile that holds it")
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except OSError as error:
        raise _unreadable(f"cannot read {name}: {error.strerror}", "check its permissions") from error
    except UnicodeDecodeError as error:
        raise _unreadable(f"{name} is not UTF-8 text", "save it as CSV in UTF-8") from error
    return [_Line(name, number, line.rstrip("\r")) for number, line in enumerate(text.split("\n"), 1)]


def _unreadable(message: str, hint: str) -> ProfileError:
    return ProfileError((Diagnostic(Code.PLACES_FILE, message, hint),))


def _header(line: _Line, cells: list[str]) -> list[str]:
    """The names of the columns."""
    from edmctl.profile.tables import nearest

    if len(cells) == 1 and (";" in line.text or "\t" in line.text):
        raise line.wrong("the columns are not separated by commas", _FORM)
    for index, column in enumerate(cells):
        if column not in COLUMNS:
            close = nearest(column, list(COLUMNS))
            hint = f"did you mean {close}?" if close else f"the columns are {', '.join(COLUMNS)}"
            raise line.wrong(f"unknown column {column}", hint, index)
        if column in cells[:index]:
            raise line.wrong(f"the column {column} stands twice", "remove one of the two", index)
    for column in NEEDED:
        if column not in cells:
            raise line.wrong(f"the column {column} is missing", _FORM)
    return cells


def _point(line: _Line, columns: list[str], cells: list[str]) -> PointSite:
    """The place of a line."""
    from pydantic import ValidationError

    from edmctl.profile.sites import PointSite

    if len(cells) > len(columns):
        message = f"{len(cells)} cells under {len(columns)} columns"
        raise line.wrong(message, "write numbers with a point, and one comma from cell to cell")
    given = {column: cell for column, cell in zip(columns, cells, strict=False) if cell}
    values: dict[str, str | float] = dict(given)
    for column in columns:
        if column in NEEDED and column not in given:
            raise line.wrong(f"{column} is missing", _hint(column), columns.index(column))
        if column != "name" and column in given:
            try:
                values[column] = float(given[column])
            except ValueError as error:
                message = f"{column} = {given[column]} is no number"
                raise line.wrong(message, _hint(column), columns.index(column)) from error
    try:
        return PointSite.model_validate(values)
    except ValidationError as error:
        column = str(error.errors(include_url=False, include_context=False)[0]["loc"][0])
        message = f"{column} = {given[column]} is out of range"
        raise line.wrong(message, _hint(column), columns.index(column)) from error


def _hint(column: str) -> str:
    from edmctl.profile.sites import PointSite
    from edmctl.profile.tables import field_at, permitted

    info = field_at(PointSite, (column,))
    return f"write {permitted(info)}" if info else ""
