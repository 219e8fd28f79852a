"""A channel: its planned path on the height map of the work, and the floor along it.

Colours show how far the floor lies from its target, light where it lies right, over one tolerance to both sides or
as far as it goes. Only the virtual machine knows a height map; without one the places that the tool touched stand
in its stead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmctl.dataclasses import dataclass
from edmctl.report.removal import along, lengths_um, planned_path
from edmctl.report.style import (
    BLACK,
    BLUE,
    DEVIATIONS,
    GREY,
    PAGE_MM,
    VERMILION,
    NothingToDraw,
    draw_points,
    letter_panels,
    new_figure,
    shared_legend,
)
from edmctl.wording import plain_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    from edmctl.array_types import Array
    from edmctl.record.reader import RunFile

HEIGHT_MM = 92.0
STEP_UM = 5.0
"""The floor is looked at every so often along the path."""
FACE = "#EEEEEE"
"""What was not cut."""
FLOOR_SHARE = 0.5
"""What is less than so deep is wall or face, and has no target."""
MARGIN = 0.06
"""Of the map, shown about it."""
BAND_TOLERANCES = 1.6
"""The floor is shown this many tolerances to both sides of the target at least."""


@dataclass(frozen=True, slots=True)
class HeightMap:
    """Depths below the face, shape (rows, columns), µm; the centres of columns and rows in x and y, µm."""

    x_um: Array
    y_um: Array
    depth_um: Array


@dataclass(frozen=True, slots=True)
class Floor:
    """Depth of the floor along the path: ndarrays of shape (n,), µm."""

    s_um: Array
    depth_um: Array


@dataclass(frozen=True, slots=True)
class Channel:
    """What is drawn. `path_um` has shape (n, 2); `touched` are (length, depth) of the program's own touches, µm,
    and `touched_u95_um` half the 95 % interval of their mean depth, NaN where unknown.

    `work` and `floor` are what the virtual machine knows, None of a real one.
    """

    work: HeightMap | None
    path_um: Array
    floor: Floor | None
    touched: Sequence[tuple[float, float]]
    touched_u95_um: float
    target_um: float
    tolerance_um: float


def draw(run: RunFile) -> Figure:
    """Draw what is known of the channel; depths are below the face that was touched, or of the truth."""
    path_um = planned_path(run)
    if path_um is None:
        raise NothingToDraw("The run made no channel: its profile has no [path].")
    work, touched = _work(run), _touched(run)
    if work is None and not touched:
        raise NothingToDraw(
            "The floor of the channel was not measured: the run ended before its first layers were."
        )
    values = run.profile_values()
    return channel_figure(
        Channel(
            work=work,
            path_um=path_um,
            floor=None if work is None else _floor(work, path_um),
            touched=touched,
            touched_u95_um=plain_number(_result(run).get("depth_u95_um")),
            target_um=float(values["target.depth_um"]),
            tolerance_um=float(values["target.tolerance_um"]),
        )
    )


def _work(run: RunFile) -> HeightMap | None:
    truth = run.truth_map()
    if truth is None:
        return None
    return HeightMap(*(values.astype(np.float64) for values in (truth.x_um, truth.y_um, truth.depth_um)))


def _result(run: RunFile) -> Mapping[str, object]:
    result = (run.summary() or {}).get("channel")
    return result if isinstance(result, dict) else {}


def _touched(run: RunFile) -> list[tuple[float, float]]:
    """Length along the path and depth of the touches of the last measuring stop, µm."""
    floor = _result(run).get("floor")
    return [
        (plain_number(place.get("s_um")), plain_number(place.get("depth_um")))
        for place in (floor if isinstance(floor, list) else ())
    ]


def _floor(work: HeightMap, path_um: Array) -> Floor:
    """Depth of the map under the path, at the nearest cells."""
    s_um, places_um = along(path_um, STEP_UM)
    column, row = (
        np.clip(
            np.rint((at_um - axis_um[0]) / (axis_um[1] - axis_um[0])).astype(np.int64), 0, len(axis_um) - 1
        )
        for at_um, axis_um in ((places_um[:, 0], work.x_um), (places_um[:, 1], work.y_um))
    )
    return Floor(s_um, work.depth_um[row, column])


def channel_figure(channel: Channel) -> Figure:
    """Draw the figure, 180 mm wide, within `house_style()`."""
    figure = new_figure(HEIGHT_MM, PAGE_MM)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    _draw_map(figure, left, channel)
    _draw_floor(right, channel)
    letter_panels((left, right))
    shared_legend(figure, (left, right), ncols=3)
    return figure


def _draw_map(figure: Figure, axes: Axes, channel: Channel) -> None:
    from matplotlib.patheffects import withStroke

    if channel.work is None:
        coloured, label = _draw_touches(axes, channel), "depth − target, touched (µm)"
    else:
        coloured, label = _draw_work(axes, channel, channel.work), "depth − target, simulated truth (µm)"
    outline = [withStroke(linewidth=1.8, foreground="white")]
    xs, ys = channel.path_um.T
    axes.plot(
        xs, ys, color=BLACK, linewidth=0.8, label="planned path of the tool's axis", path_effects=outline
    )
    axes.plot(xs[0], ys[0], "o", color=BLACK, markersize=3.5, label="start", path_effects=outline)
    axes.set_aspect("equal")
    axes.locator_params(nbins=6)
    axes.set_xlabel("x (µm)")
    axes.set_ylabel("y (µm)")
    axes.grid(visible=False)
    if coloured is not None:
        bar = figure.colorbar(coloured, cax=axes.inset_axes((1.03, 0.0, 0.04, 1.0)))
        bar.set_label(label)
        bar.outline.set_linewidth(0.6)


def _draw_work(axes: Axes, channel: Channel, work: HeightMap) -> ScalarMappable:
    x_um, y_um, depth_um = work.x_um, work.y_um, work.depth_um
    half_x, half_y = (x_um[1] - x_um[0]) / 2.0, (y_um[1] - y_um[0]) / 2.0
    cut = _within(depth_um > FLOOR_SHARE * min(channel.target_um, float(depth_um.max())))
    image = axes.imshow(
        np.where(cut, depth_um - channel.target_um, np.nan),
        cmap=DEVIATIONS,
        norm=_deviations(channel, depth_um if channel.floor is None else channel.floor.depth_um),
        origin="lower",
        extent=(x_um[0] - half_x, x_um[-1] + half_x, y_um[0] - half_y, y_um[-1] + half_y),
        interpolation="nearest",
    )
    axes.set_facecolor(FACE)
    margin_um = MARGIN * max(x_um[-1] - x_um[0], y_um[-1] - y_um[0])
    axes.set_xlim(x_um[0] - margin_um, x_um[-1] + margin_um)
    axes.set_ylim(y_um[0] - margin_um, y_um[-1] + margin_um)
    return image


def _draw_touches(axes: Axes, channel: Channel) -> ScalarMappable | None:
    if not channel.touched:
        return None
    s_um, depth_um = np.array(channel.touched).T
    up_to_um = lengths_um(channel.path_um)
    x_um, y_um = (np.interp(s_um, up_to_um, axis) for axis in channel.path_um.T)
    axes.margins(0.15)
    return axes.scatter(
        x_um,
        y_um,
        c=depth_um - channel.target_um,
        cmap=DEVIATIONS,
        norm=_deviations(channel, depth_um),
        s=22.0,
        edgecolor=BLACK,
        linewidth=0.5,
        zorder=4,
    )


def _within(cut: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return what was cut but for its rim, whose cells are half wall."""
    about = np.pad(cut, 1)
    return cut & about[:-2, 1:-1] & about[2:, 1:-1] & about[1:-1, :-2] & about[1:-1, 2:]


def _deviations(channel: Channel, floor_um: Array) -> Normalize:
    """A scale symmetric about the target, over the tolerance at least."""
    from matplotlib.colors import Normalize

    span_um = max(channel.tolerance_um, float(np.abs(floor_um - channel.target_um).max()))
    return Normalize(-span_um, span_um)


def _draw_floor(axes: Axes, channel: Channel) -> None:
    target_um, tolerance_um = channel.target_um, channel.tolerance_um
    low_um, high_um = target_um - tolerance_um, target_um + tolerance_um
    axes.axhspan(low_um, high_um, color="#E8F1F7", label=f"target {target_um:g} ± {tolerance_um:g} µm")
    axes.axhline(target_um, color=GREY, linewidth=0.6)
    drawn_um = [
        np.array([target_um - BAND_TOLERANCES * tolerance_um, target_um + BAND_TOLERANCES * tolerance_um])
    ]
    if channel.floor is not None:
        s_mm = channel.floor.s_um / 1000.0
        axes.plot(
            s_mm,
            channel.floor.depth_um,
            color=BLUE,
            linewidth=0.9,
            label="floor on the path, simulated truth",
        )
        drawn_um.append(channel.floor.depth_um)
    if channel.touched:
        s_um, depth_um = np.array(channel.touched).T
        known = np.isfinite(channel.touched_u95_um)
        label = "touched by the tool" + (", 95 % of the mean" if known else "")
        u95_um = channel.touched_u95_um if known else None
        draw_points(axes, s_um / 1000.0, depth_um, u95_um, VERMILION, label=label)
        drawn_um.append(depth_um)
    all_um, edge_um = np.concatenate(drawn_um), 0.1 * BAND_TOLERANCES * tolerance_um
    axes.set_ylim(float(all_um.max()) + edge_um, float(all_um.min()) - edge_um)  # deep is down
    axes.set_xlim(0.0, float(lengths_um(channel.path_um)[-1]) / 1000.0)
    axes.set_xlabel("length along the path (mm)")
    axes.set_ylabel("depth of the floor (µm)")
