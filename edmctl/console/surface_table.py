"""Where an approach ended."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.wording import coordinates, decimal, duration, length

if TYPE_CHECKING:
    from collections.abc import Mapping


class SurfaceView(Protocol):
    """A spark gap or a contact."""

    @property
    def kind(self) -> str: ...
    @property
    def x_um(self) -> float: ...
    @property
    def y_um(self) -> float: ...
    @property
    def displacement_um(self) -> float: ...
    @property
    def model_um(self) -> float: ...
    @property
    def actuator_v(self) -> float: ...
    @property
    def travel_s(self) -> float: ...
    @property
    def touches(self) -> int: ...
    @property
    def sd_um(self) -> float: ...


def render_surface(found: SurfaceView, style: Style = PLAIN) -> str:
    """Render where the gap or the surface was found."""
    rows = [
        ["displacement", length(found.displacement_um), length(found.model_um)],
        ["actuator", f"{decimal(found.actuator_v)} V"],
        ["way from home", duration(found.travel_s)],
    ]
    if found.touches:
        rows.append(["touches", f"{found.touches} within {length(found.sd_um)} rms"])
    place = f"{found.kind} at {coordinates(found.x_um, found.y_um)}"
    return render_columns([place, "measured", "from voltage"], rows, style)


def render_approach_plan(forecast: Mapping[str, float | str], style: Style = PLAIN) -> str:
    """Render what an approach will do."""
    rows = [
        ["expected", length(float(forecast["expected_um"]))],
        ["gives up after", length(float(forecast["max_travel_um"]))],
        ["speed", f"{float(forecast['speed_um_s']):g} µm/s"],
        ["time", duration(float(forecast["time_s"]))],
    ]
    place = f"{forecast['kind']} at ({float(forecast['x_um']):.0f}, {float(forecast['y_um']):.0f}) µm"
    return render_columns([place, "forecast"], rows, style)
