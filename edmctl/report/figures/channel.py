"""A channel: its planned path on the height map of the workpiece, and the floor along it.

Colours show the deviation of the floor from its target, light for none, over at least one tolerance to both sides.
Only the virtual machine has a height map; without one the places that the tool touched are shown.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from edmctl.array_types import Array
from edmctl.dataclasses import dataclass
from edmctl.record.reader import RunFile
from edmctl.record.rows import TruthMap
from edmctl.report import panels
from edmctl.report.panels import BLACK, BLUE, GREY, VERMILION, NothingToDraw
from edmctl.report.removal import along, lengths_um, planned_path
from edmctl.wording import plain_number

BAR_MM = 18.0
"""Width of the scale of colours."""
STEP_UM = 5.0
"""Distance of the places along the path at which the floor is drawn."""
FACE = "#EEEEEE"
"""The surface that was not cut."""
FLOOR_SHARE = 0.5
"""A place less deep than this share of the target is wall or face, and has no target."""
MARGIN = 0.06
"""Of the map, shown about it."""
BAND_TOLERANCES = 1.6
"""The floor is shown this many tolerances to both sides of the target at least."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A channel as it is drawn; lengths in µm.

    path_um : ndarray, shape (n, 2)
    touched : ndarray, shape (m, 2), length along the path and depth of the job's own touches
    touched_u95_um : half the 95 % interval of their mean depth, NaN if unknown
    work : the true height map of the virtual machine, None for a real one
    """

    work: TruthMap | None
    path_um: Array
    touched: Array
    touched_u95_um: float
    target_um: float
    tolerance_um: float

    def floor(self) -> tuple[Array, Array] | None:
        """Return lengths along the path and the true depths there, shape (n,), at the nearest cells of the map."""
        if self.work is None:
            return None
        s_um, places_um = along(self.path_um, STEP_UM)
        cells = []
        for at_um, axis_um in zip(places_um.T, (self.work.x_um, self.work.y_um), strict=True):
            nearest = np.rint((at_um - axis_um[0]) / (axis_um[1] - axis_um[0])).astype(int)
            cells.append(np.clip(nearest, 0, len(axis_um) - 1))
        return s_um, self.work.depth_um[cells[1], cells[0]].astype(np.float64)

    def colours(self, floor_um: Array) -> Normalize:
        """Return a scale that is symmetric about the target, over the tolerance at least."""
        span_um = max(self.tolerance_um, float(np.abs(floor_um - self.target_um).max()))
        return Normalize(-span_um, span_um)


def draw_channel(run: RunFile) -> Figure:
    """Draw the channel; depths are below the touched face, or of the truth. Raises NothingToDraw."""
    path_um, work, values = planned_path(run), run.truth_map(), run.profile_values()
    if path_um is None:
        raise NothingToDraw("The run made no channel: its profile has no [path].")
    channel = (run.summary() or {}).get("channel")
    result: Mapping[str, object] = channel if isinstance(channel, dict) else {}
    floor = result.get("floor")
    touched = [
        [plain_number(place.get(name)) for name in ("s_um", "depth_um")]
        for place in (floor if isinstance(floor, list) else ())
    ]
    if work is None and not touched:
        raise NothingToDraw(
            "The floor of the channel was not measured: the run ended before its first layers were."
        )
    u95_um = plain_number(result.get("depth_u95_um"))
    target_um, tolerance_um = (float(values[f"target.{name}_um"]) for name in ("depth", "tolerance"))
    points = np.array(touched).reshape(-1, 2)
    return channel_figure(Channel(work, path_um, points, u95_um, target_um, tolerance_um))


def channel_figure(channel: Channel) -> Figure:
    """Draw the figure, 180 mm wide, within `house_style()`."""
    figure, (left, right) = panels.panels(
        panels.Block("x (µm)", {"y (µm)": 2.4}, (1.15, 1.0)),
        width_mm=panels.PAGE_MM,
        gap_mm=panels.LEFT_MM + BAR_MM,
    )
    _draw_map(left, channel)
    _draw_floor(right, channel)
    panels.shared_legend(figure, (left, right), ncols=3)
    return figure


def _draw_map(axes: Axes, channel: Channel) -> None:
    outline = [withStroke(linewidth=1.8, foreground="white")]
    axes.plot(*channel.path_um.T, color=BLACK, label="planned path of the tool's axis", path_effects=outline)
    axes.plot(*channel.path_um[0], "o", color=BLACK, markersize=3.5, label="start", path_effects=outline)
    if channel.work is not None:
        coloured = _draw_work(axes, channel, channel.work)
        panels.add_colours(axes, coloured, "depth − target, simulated truth (µm)")
    elif len(channel.touched):
        panels.add_colours(axes, _draw_touches(axes, channel), "depth − target, touched (µm)")
    axes.set_aspect("equal")
    axes.locator_params(nbins=6)
    axes.grid(visible=False)


def _draw_work(axes: Axes, channel: Channel, work: TruthMap) -> ScalarMappable:
    x_um, y_um, depth_um = (values.astype(np.float64) for values in (work.x_um, work.y_um, work.depth_um))
    half_x, half_y = (x_um[1] - x_um[0]) / 2.0, (y_um[1] - y_um[0]) / 2.0
    floor = channel.floor()
    # Without its rim, whose cells are half wall.
    about = np.pad(depth_um > FLOOR_SHARE * min(channel.target_um, float(depth_um.max())), 1)
    cut = about[1:-1, 1:-1] & about[:-2, 1:-1] & about[2:, 1:-1] & about[1:-1, :-2] & about[1:-1, 2:]
    image = axes.imshow(
        np.where(cut, depth_um - channel.target_um, np.nan),
        cmap=panels.DEVIATIONS,
        norm=channel.colours(depth_um if floor is None else floor[1]),
        origin="lower",
        extent=(x_um[0] - half_x, x_um[-1] + half_x, y_um[0] - half_y, y_um[-1] + half_y),
        interpolation="nearest",
    )
    axes.set_facecolor(FACE)
    margin_um = MARGIN * max(x_um[-1] - x_um[0], y_um[-1] - y_um[0])
    axes.set_xlim(x_um[0] - margin_um, x_um[-1] + margin_um)
    axes.set_ylim(y_um[0] - margin_um, y_um[-1] + margin_um)
    return image


def _draw_touches(axes: Axes, channel: Channel) -> ScalarMappable:
    s_um, depth_um = channel.touched.T
    up_to_um = lengths_um(channel.path_um)
    x_um, y_um = (np.interp(s_um, up_to_um, axis) for axis in channel.path_um.T)
    axes.margins(0.15)
    return axes.scatter(
        x_um, y_um, c=depth_um - channel.target_um, cmap=panels.DEVIATIONS, norm=channel.colours(depth_um),
        s=22.0, edgecolor=BLACK, linewidth=0.5, zorder=4,
    )  # fmt: skip


def _draw_floor(axes: Axes, channel: Channel) -> None:
    target_um, tolerance_um, floor = channel.target_um, channel.tolerance_um, channel.floor()
    band_um = np.array([-1.0, 1.0]) * tolerance_um
    label = f"target {target_um:g} ± {tolerance_um:g} µm"
    axes.axhspan(*(target_um + band_um), color=panels.TOLERANCE, label=label)
    axes.axhline(target_um, color=GREY, linewidth=0.6)
    drawn_um = [target_um + BAND_TOLERANCES * band_um, channel.touched[:, 1]]
    if floor is not None:
        s_um, depth_um = floor
        label = "floor on the path, simulated truth"
        axes.plot(s_um / 1000.0, depth_um, color=BLUE, linewidth=0.9, label=label)
        drawn_um.append(depth_um)
    if len(channel.touched):
        s_um, depth_um = channel.touched.T
        u95_um = channel.touched_u95_um if np.isfinite(channel.touched_u95_um) else None
        label = "touched by the tool" + ("" if u95_um is None else ", 95 % of the mean")
        panels.draw_points(axes, s_um / 1000.0, depth_um, u95_um, VERMILION, label=label)
    all_um, edge_um = np.concatenate(drawn_um), 0.1 * BAND_TOLERANCES * tolerance_um
    axes.set_ylim(float(all_um.max()) + edge_um, float(all_um.min()) - edge_um)  # deep is down
    axes.set_xlim(0.0, float(lengths_um(channel.path_um)[-1]) / 1000.0)
    axes.set_xlabel("length along the path (mm)")
    axes.set_ylabel("depth of the floor (µm)")
