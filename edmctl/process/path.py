"""Ways of the tool's axis in the plane of the stages, as points on them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CHORD_UM = 20.0
"""Curves are cut into pieces about so long: at a radius of 300 µm a chord lies 0.2 µm beside its arc."""


def rectangle(x_um: float, y_um: float, width_um: float, height_um: float) -> Floats:
    """Closed rectangle about a centre, shape (5, 2), beginning and ending at its lower left corner."""
    half_w, half_h = width_um / 2.0, height_um / 2.0
    corners = [(-half_w, -half_h), (half_w, -half_h), (half_w, half_h), (-half_w, half_h), (-half_w, -half_h)]
    return np.array([(x_um + dx, y_um + dy) for dx, dy in corners])


def circle(x_um: float, y_um: float, radius_um: float) -> Floats:
    """Closed circle about a centre, shape (n + 1, 2), beginning and ending on the x axis."""
    n = max(8, math.ceil(2.0 * math.pi * radius_um / CHORD_UM))
    angles = 2.0 * math.pi * np.arange(n + 1) / n
    return np.column_stack([x_um + radius_um * np.cos(angles), y_um + radius_um * np.sin(angles)])


def spiral(x_um: float, y_um: float, inner_um: float, pitch_um: float, turns: float) -> Floats:
    """Spiral of Archimedes from the inner radius outwards, shape (n + 1, 2), beginning on the x axis."""
    mean_radius_um = inner_um + 0.5 * pitch_um * turns
    n = max(8, math.ceil(2.0 * math.pi * mean_radius_um * turns / CHORD_UM))
    angles = 2.0 * math.pi * turns * np.arange(n + 1) / n
    radii = inner_um + pitch_um * angles / (2.0 * math.pi)
    return np.column_stack([x_um + radii * np.cos(angles), y_um + radii * np.sin(angles)])


def lengths_um(points: Floats) -> Floats:
    """Way from the first point to each, shape (n,), for points of shape (n, 2)."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])
