"""A channel: its planned path, the floor along it by touches, and of the virtual machine the true height map."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.height_map import Channel, Floor, HeightMap, channel_figure
from edmctl.report.planned_path import along, planned_path
from edmctl.report.style import NothingToDraw

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]

STEP_UM = 5.0
"""The floor is looked at every so often along the path."""


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
            touched_u95_um=_um(_result(run), "depth_u95_um"),
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
        (_um(place, "s_um"), _um(place, "depth_um")) for place in (floor if isinstance(floor, list) else ())
    ]


def _um(place: Mapping[str, object], name: str) -> float:
    value = place.get(name)
    return float(value) if isinstance(value, int | float) else math.nan


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
