"""The way of the tool's axis that the profile of a channel plans, from the values in a run file."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]
    Values = Mapping[str, float | int | str | bool]

CHORD_UM = 5.0
"""Curves are drawn in pieces about so long."""


def planned_path(run: RunFile) -> Array | None:
    """Return points of the way in stage coordinates, shape (n, 2), µm; None where no channel is planned."""
    values = run.profile_values()
    kind = values.get("path.kind")
    if kind == "rectangle":
        half = 0.5 * np.array([_value(values, "width_um"), _value(values, "height_um")])
        points = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    elif kind == "circle":
        points = _turning(_value(values, "radius_um"), 0.0, 1.0)
    elif kind == "spiral":
        points = _turning(_value(values, "radius_um"), _value(values, "pitch_um"), _value(values, "turns"))
    else:
        return None
    whole: Array = points + np.array([_value(values, "x_um"), _value(values, "y_um")])
    return whole


def _value(values: Values, key: str) -> float:
    return float(values[f"path.{key}"])


def _turning(inner_um: float, pitch_um: float, turns: float) -> Array:
    """Turns about the origin from the x axis on, each further out by the pitch."""
    mean_um = inner_um + 0.5 * pitch_um * turns
    pieces = max(8, math.ceil(2.0 * math.pi * mean_um * turns / CHORD_UM))
    turned = turns * np.arange(pieces + 1) / pieces
    radii_um = inner_um + pitch_um * turned
    angles = 2.0 * math.pi * turned
    return np.column_stack([radii_um * np.cos(angles), radii_um * np.sin(angles)])


def lengths_um(points_um: Array) -> Array:
    """Return the length of the way up to each point, shape (n,), for points of shape (n, 2)."""
    steps: Array = np.hypot(*np.diff(points_um, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def along(points_um: Array, step_um: float) -> tuple[Array, Array]:
    """Return lengths every `step_um` along the way, shape (n,), and the places there, shape (n, 2)."""
    up_to_um = lengths_um(points_um)
    s_um = np.arange(0.0, up_to_um[-1], step_um)
    return s_um, np.column_stack([np.interp(s_um, up_to_um, axis) for axis in points_um.T])
