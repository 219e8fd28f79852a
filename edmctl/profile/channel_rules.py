"""Cross-field rules of a channel."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from edmctl.profile.codes import Code
from edmctl.profile.findings import PAD_MARGIN_UM, WALL_UM, Finding, Job, rounded_down, rounded_up

if TYPE_CHECKING:
    from collections.abc import Iterator

    from edmctl.profile.sites import PathTable

NEEDED = {
    "rectangle": ("width_um", "height_um"),
    "circle": ("radius_um",),
    "spiral": ("radius_um", "pitch_um", "turns"),
}
"""Keys of `[path]` by its kind; the others of these do not go with it."""


def path_keys(job: Job) -> Iterator[Finding]:
    """Rule 25: a path has the sizes of its kind, and no others."""
    path = job.profile.path
    if path is None:
        return
    for key in dict.fromkeys(key for keys in NEEDED.values() for key in keys):
        given, needed = getattr(path, key) is not None, key in NEEDED[path.kind]
        if needed and not given:
            message, hint = f"a {path.kind} needs path.{key}", f"add {key} to [path]"
            yield Finding(Code.PATH_KEYS, ("path",), message, hint)
        elif given and not needed:
            wanted = " and ".join(NEEDED[path.kind])
            message, hint = (
                f"path.{key} does not go with a {path.kind}",
                f"remove it; a {path.kind} has {wanted}",
            )
            yield Finding(Code.PATH_KEYS, ("path", key), message, hint)


def channel_depth(job: Job) -> Iterator[Finding]:
    """Rule 23: a channel is cut to a depth."""
    if job.profile.path is not None and job.profile.target.kind != "depth":
        yield Finding(
            Code.TARGET_KIND,
            ("target", "kind"),
            f'a channel is cut to a depth, and target.kind is "{job.profile.target.kind}"',
            'use kind = "depth", with depth_um',
        )


def walls(job: Job) -> Iterator[Finding]:
    """Rule 28: the walls of a channel stand, and it keeps clear of the reference pad."""
    path = job.profile.path
    if path is None:
        return
    profile, stage = job.profile, job.setup.stage
    gap_um = profile.work.side_gap_um
    least_um = profile.tool.diameter_um + 2.0 * gap_um + WALL_UM
    for key, across_um in _widths_um(path).items():
        if across_um < least_um:
            yield Finding(
                Code.OVERLAP,
                ("path", key),
                f"the channel runs into itself: its sides are {across_um:g} µm apart by path.{key}, and tool "
                f"{profile.tool.diameter_um:g} + 2 x side gap {gap_um:g} + wall {WALL_UM:g} = {least_um:g} µm",
                f"make them {rounded_up(least_um)} µm apart or more, or use a thinner tool",
            )
    clear_um = profile.tool.diameter_um + gap_um + PAD_MARGIN_UM
    found_um = _distance_um(path, stage.reference_x_um, stage.reference_y_um)
    if found_um < clear_um:
        yield Finding(
            Code.OVERLAP,
            ("path", "x_um"),
            f"the channel passes {found_um:.0f} µm from the reference pad at ({stage.reference_x_um:g}, "
            f"{stage.reference_y_um:g}) µm and overlaps it or its rim",
            f"keep {rounded_up(clear_um)} µm away or more",
        )


def layer(job: Job) -> Iterator[Finding]:
    """Rule 31: a layer is thinner than the working gap, so that the tool never runs against its step."""
    path, gap_um = job.profile.path, job.profile.measure.expected_gap_um
    if path is not None and path.layer_um > gap_um:
        yield Finding(
            Code.LAYER,
            ("path", "layer_um"),
            f"a layer of {path.layer_um:g} µm is thicker than the working gap, {gap_um:g} µm: moving sideways the "
            "tool runs into the step before it is eroded",
            f"use at most {rounded_down(gap_um)} µm",
        )


def _widths_um(path: PathTable) -> dict[str, float]:
    """Least distances between the sides of a channel, axis to axis, by the key that sets them."""
    if path.kind == "rectangle":
        return {"width_um": path.width_um or 0.0, "height_um": path.height_um or 0.0}
    if path.kind == "circle":
        return {"radius_um": 2.0 * (path.radius_um or 0.0)}
    inner_um, pitch_um, turns = path.radius_um or 0.0, path.pitch_um or 0.0, path.turns or 0.0
    across = {"radius_um": 2.0 * inner_um + pitch_um / 2.0} if turns >= 0.5 else {}
    return across | ({"pitch_um": pitch_um} if turns > 1.0 else {})


def _distance_um(path: PathTable, x_um: float, y_um: float) -> float:
    """Least distance of the channel's axis from a point."""
    dx_um, dy_um = abs(x_um - path.x_um), abs(y_um - path.y_um)
    away_um = math.hypot(dx_um, dy_um)
    if path.kind == "circle":
        return abs(away_um - (path.radius_um or 0.0))
    if path.kind == "rectangle":
        half_w, half_h = (path.width_um or 0.0) / 2.0, (path.height_um or 0.0) / 2.0
        beyond_x, beyond_y = dx_um - half_w, dy_um - half_h
        if beyond_x <= 0.0 and beyond_y <= 0.0:
            return min(-beyond_x, -beyond_y)
        return math.hypot(max(beyond_x, 0.0), max(beyond_y, 0.0))
    return _distance_from_spiral_um(path, x_um - path.x_um, y_um - path.y_um)


def _distance_from_spiral_um(path: PathTable, x_um: float, y_um: float) -> float:
    inner_um, pitch_um, turns = path.radius_um or 0.0, path.pitch_um or 0.0, path.turns or 0.0
    steps = math.ceil(_STEPS_PER_TURN * turns)
    least_um = math.inf
    for step in range(steps + 1):
        angle = 2.0 * math.pi * turns * step / steps
        radius_um = inner_um + pitch_um * angle / (2.0 * math.pi)
        least_um = min(
            least_um, math.hypot(radius_um * math.cos(angle) - x_um, radius_um * math.sin(angle) - y_um)
        )
    return least_um


_STEPS_PER_TURN = 360
