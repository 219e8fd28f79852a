"""A channel as a picture: the height map of the work with the planned path, and the floor along it.

Depths run in one hue from light (the face) to dark (deep), which reads the same printed in grey.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.style import BLACK, BLUE, GREY, PAGE_MM, VERMILLION, house_style, rendered, suffix_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

HEIGHT_MM = 118.0
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
    """What is drawn. `path_um` has shape (n, 2); `touched` are (length, depth) of the program's own touches, µm."""

    title: str
    work: HeightMap
    path_um: Array
    floor: Floor
    touched: Sequence[tuple[float, float]]
    target_um: float
    tolerance_um: float


def draw_channel(channel: Channel, name: str) -> bytes:
    """Return the figure, 180 mm wide, as the file `name` would hold it (.png, .svg or .pdf)."""
    with house_style():
        return rendered(_figure(channel), suffix_of(name))


def _figure(channel: Channel) -> Figure:
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.04, hspace=0.03, wspace=0.03)
    figure = Figure(figsize=(PAGE_MM / 25.4, HEIGHT_MM / 25.4), layout=layout)
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    figure.suptitle(channel.title, fontsize=8.0)
    _draw_map(figure, left, channel)
    _draw_floor(right, channel)
    return figure


def _draw_map(figure: Figure, axes: Axes, channel: Channel) -> None:
    from matplotlib.patheffects import withStroke

    x_um, y_um, depth_um = channel.work.x_um, channel.work.y_um, channel.work.depth_um
    half_x, half_y = (x_um[1] - x_um[0]) / 2.0, (y_um[1] - y_um[0]) / 2.0
    image = axes.imshow(
        depth_um,
        cmap="Blues",
        vmin=0.0,
        vmax=max(float(depth_um.max()), channel.target_um),
        origin="lower",
        extent=(x_um[0] - half_x, x_um[-1] + half_x, y_um[0] - half_y, y_um[-1] + half_y),
        interpolation="nearest",
    )
    outline = [withStroke(linewidth=1.8, foreground="white")]
    xs, ys = channel.path_um.T
    axes.plot(xs, ys, color=BLACK, linewidth=0.8, label="path of the tool's axis", path_effects=outline)
    axes.plot(xs[0], ys[0], "o", color=BLACK, markersize=3.5, label="start", path_effects=outline)
    # The map ends where the cut does; the untouched face goes on about it.
    axes.set_facecolor(image.get_cmap()(0.0))
    margin_um = MARGIN * max(x_um[-1] - x_um[0], y_um[-1] - y_um[0])
    axes.set_xlim(x_um[0] - margin_um, x_um[-1] + margin_um)
    axes.set_ylim(y_um[0] - margin_um, y_um[-1] + margin_um)
    axes.set_aspect("equal")
    axes.locator_params(nbins=6)
    axes.set_xlabel("x (µm)")
    axes.set_ylabel("y (µm)")
    axes.set_title("(a)", loc="left", pad=3.0)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2)
    bar = figure.colorbar(image, ax=axes, shrink=0.8, pad=0.02)
    bar.set_label("depth below the face (µm)")
    bar.outline.set_linewidth(0.6)


def _draw_floor(axes: Axes, channel: Channel) -> None:
    target_um, tolerance_um = channel.target_um, channel.tolerance_um
    low_um, high_um = target_um - tolerance_um, target_um + tolerance_um
    axes.axhspan(low_um, high_um, color="#E8F1F7", label=f"target {target_um:g} ± {tolerance_um:g} µm")
    axes.axhline(target_um, color=GREY, linewidth=0.6)
    s_mm = channel.floor.s_um / 1000.0
    axes.plot(s_mm, channel.floor.depth_um, color=BLUE, linewidth=0.9, label="floor on the path")
    if channel.touched:
        s_um, depth_um = np.array(channel.touched).T
        axes.plot(s_um / 1000.0, depth_um, "o", color=VERMILLION, markersize=3.5, label="touched by the tool")
    half_um = BAND_TOLERANCES * tolerance_um
    lowest_um = min(target_um - half_um, float(channel.floor.depth_um.min()))
    highest_um = max(target_um + half_um, float(channel.floor.depth_um.max()))
    axes.set_ylim(highest_um + 0.1 * half_um, lowest_um - 0.1 * half_um)  # deep is down
    axes.set_xlim(0.0, float(s_mm[-1]))
    axes.set_xlabel("length along the path (mm)")
    axes.set_ylabel("depth of the floor (µm)")
    axes.set_title("(b)", loc="left", pad=3.0)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=1)
