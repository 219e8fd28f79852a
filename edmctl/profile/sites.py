"""Where a job machines: the `[[sites]]` of holes, how they are worked off, and the `[path]` of a channel."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Discriminator, Tag

from edmctl.profile.tables import ONE_LINE, Coordinate, FileName, Name, Table, entry


class PointSite(Table):
    """One place to machine, in stage coordinates."""

    kind: Literal["point"] = "point"
    name: Name | None = entry(None, "numbered when not given")
    x_um: Coordinate = entry(..., "stage coordinate, µm")
    y_um: Coordinate = entry(0.0, "stage coordinate, µm")
    theta_deg: float = entry(0.0, "of the rotary table, degrees", ge=-360.0, le=360.0)
    depth_um: float | None = entry(None, "instead of target.depth_um, µm", gt=0.0, le=2000.0)


class GridSites(Table):
    """Rows and columns of places."""

    kind: Literal["grid"]
    name: str = entry("grid", "prefix of the names", min_length=1, max_length=32, pattern=ONE_LINE)
    x_um: Coordinate = entry(..., "first place, µm")
    y_um: Coordinate = entry(0.0, "first place, µm")
    columns: int = entry(..., "places along x", ge=1, le=1000)
    rows: int = entry(1, "places along y", ge=1, le=1000)
    dx_um: float = entry(..., "from column to column, µm", ge=-1e5, le=1e5)
    dy_um: float = entry(0.0, "from row to row, µm", ge=-1e5, le=1e5)
    depth_um: float | None = entry(None, "instead of target.depth_um, µm", gt=0.0, le=2000.0)


class CircleSites(Table):
    """Places on a circle."""

    kind: Literal["circle"]
    name: str = entry("circle", "prefix of the names", min_length=1, max_length=32, pattern=ONE_LINE)
    x_um: Coordinate = entry(..., "centre, µm")
    y_um: Coordinate = entry(0.0, "centre, µm")
    radius_um: float = entry(..., "from the centre, µm", gt=0.0, le=1e6)
    count: int = entry(..., "number of places", ge=1, le=1000)
    start_deg: float = entry(0.0, "direction of the first place, from x towards y", ge=-360.0, le=360.0)
    depth_um: float | None = entry(None, "instead of target.depth_um, µm", gt=0.0, le=2000.0)


class FileSites(Table):
    """Places from a CSV file with the columns x_um and y_um, and name, theta_deg and depth_um where wanted."""

    kind: Literal["file"]
    path: FileName = entry(..., "relative to the profile that names it")


class Array(Table):
    """How the places of `[[sites]]` are worked off."""

    order: Literal["nearest", "given"] = entry("nearest", "shortest way, or as written")
    surface: Literal["plane", "pad"] = entry(
        "plane", "touch three places first and fit a plane, or trust the pad's height"
    )


class PathTable(Table):
    """A channel: a way of the tool's axis in stage coordinates, cut in layers to target.depth_um."""

    kind: Literal["rectangle", "circle", "spiral"]
    x_um: Coordinate = entry(..., "centre, µm")
    y_um: Coordinate = entry(0.0, "centre, µm")
    width_um: float | None = entry(None, "rectangle: along x, µm", gt=0.0, le=1e5)
    height_um: float | None = entry(None, "rectangle: along y, µm", gt=0.0, le=1e5)
    radius_um: float | None = entry(None, "circle: its radius; spiral: the inner one, µm", gt=0.0, le=1e5)
    pitch_um: float | None = entry(None, "spiral: from turn to turn, µm", gt=0.0, le=1e5)
    turns: float | None = entry(None, "spiral: number of turns", gt=0.0, le=100.0)
    layer_um: float = entry(2.0, "depth of one layer, µm", gt=0.0, le=50.0)
    speed_um_s: float = entry(100.0, "along the path, µm/s", ge=1.0, le=5000.0)


def _kind_of(site: object) -> str:
    """The kind that an item of `[[sites]]` states; one that states none is a point."""
    kind = site.get("kind", "point") if isinstance(site, dict) else getattr(site, "kind", "point")
    return kind if isinstance(kind, str) else repr(kind)


SiteTable: TypeAlias = Annotated[
    Annotated[PointSite, Tag("point")]
    | Annotated[GridSites, Tag("grid")]
    | Annotated[CircleSites, Tag("circle")]
    | Annotated[FileSites, Tag("file")],
    Discriminator(_kind_of),
]
"""One item of `[[sites]]`."""
