"""Where a job machines: the `[[sites]]` of holes, how they are worked off, and the `[path]` of a channel."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Discriminator, Field, Tag

from edmctl.profile.tables import ONE_LINE, FileName, Table


class PointSite(Table):
    """One place to machine, in stage coordinates."""

    kind: Literal["point"] = "point"
    name: str | None = Field(
        None, min_length=1, max_length=40, pattern=ONE_LINE, description="numbered when not given"
    )
    x_um: float = Field(ge=-1e6, le=1e6, description="stage coordinate, µm")
    y_um: float = Field(0.0, ge=-1e6, le=1e6, description="stage coordinate, µm")
    theta_deg: float = Field(0.0, ge=-360.0, le=360.0, description="of the rotary table, degrees")
    depth_um: float | None = Field(None, gt=0.0, le=2000.0, description="instead of target.depth_um, µm")


class GridSites(Table):
    """Rows and columns of places."""

    kind: Literal["grid"]
    name: str = Field(
        "grid", min_length=1, max_length=32, pattern=ONE_LINE, description="prefix of the names"
    )
    x_um: float = Field(ge=-1e6, le=1e6, description="first place, µm")
    y_um: float = Field(0.0, ge=-1e6, le=1e6, description="first place, µm")
    columns: int = Field(ge=1, le=1000, description="places along x")
    rows: int = Field(1, ge=1, le=1000, description="places along y")
    dx_um: float = Field(description="from column to column, µm", ge=-1e5, le=1e5)
    dy_um: float = Field(0.0, description="from row to row, µm", ge=-1e5, le=1e5)
    depth_um: float | None = Field(None, gt=0.0, le=2000.0, description="instead of target.depth_um, µm")


class CircleSites(Table):
    """Places on a circle."""

    kind: Literal["circle"]
    name: str = Field(
        "circle", min_length=1, max_length=32, pattern=ONE_LINE, description="prefix of the names"
    )
    x_um: float = Field(ge=-1e6, le=1e6, description="centre, µm")
    y_um: float = Field(0.0, ge=-1e6, le=1e6, description="centre, µm")
    radius_um: float = Field(gt=0.0, le=1e6, description="from the centre, µm")
    count: int = Field(ge=1, le=1000, description="number of places")
    start_deg: float = Field(
        0.0, ge=-360.0, le=360.0, description="direction of the first place, from x towards y"
    )
    depth_um: float | None = Field(None, gt=0.0, le=2000.0, description="instead of target.depth_um, µm")


class FileSites(Table):
    """Places from a CSV file with the columns x_um and y_um, and name, theta_deg and depth_um where wanted."""

    kind: Literal["file"]
    path: FileName = Field(description="relative to the profile that names it")


class Array(Table):
    """How the places of `[[sites]]` are worked off."""

    order: Literal["nearest", "given"] = Field("nearest", description="shortest way, or as written")
    surface: Literal["plane", "pad"] = Field(
        "plane", description="touch three places first and fit a plane, or trust the pad's height"
    )


class PathTable(Table):
    """A channel: a way of the tool's axis in stage coordinates, cut in layers to target.depth_um."""

    kind: Literal["rectangle", "circle", "spiral"]
    x_um: float = Field(ge=-1e6, le=1e6, description="centre, µm")
    y_um: float = Field(0.0, ge=-1e6, le=1e6, description="centre, µm")
    width_um: float | None = Field(None, gt=0.0, le=1e5, description="rectangle: along x, µm")
    height_um: float | None = Field(None, gt=0.0, le=1e5, description="rectangle: along y, µm")
    radius_um: float | None = Field(
        None, gt=0.0, le=1e5, description="circle: its radius; spiral: the inner one, µm"
    )
    pitch_um: float | None = Field(None, gt=0.0, le=1e5, description="spiral: from turn to turn, µm")
    turns: float | None = Field(None, gt=0.0, le=100.0, description="spiral: number of turns")
    layer_um: float = Field(2.0, gt=0.0, le=50.0, description="depth of one layer, µm")
    speed_um_s: float = Field(100.0, ge=1.0, le=5000.0, description="along the path, µm/s")


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
