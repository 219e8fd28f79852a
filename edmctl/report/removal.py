"""What a run removed: the depths of its holes as they became known, the volumes, and the path of a channel.

A later touch corrects an earlier estimate: events hold the knowledge of their time, the results that of the end. So
the last value of each hole is that of its result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from edmctl.array_types import Array, Flags
from edmctl.dataclasses import dataclass, replace
from edmctl.labels import Basis
from edmctl.record import layout
from edmctl.record.reader import DEPTH_EVENTS, RunFile, has_depth, recorded_events, sites_of
from edmctl.record.rows import RunEvent
from edmctl.report.signals import ROW_S, floats, intervals
from edmctl.results.run_file import RecordedSite
from edmctl.wording import plain_number

_ESTIMATES = (RunEvent.SITE_ESTIMATED, RunEvent.LEFT_UNMEASURED)
SAME_HOLE_SHARE = 0.5
"""A cut that begins at less of the depth that the cut before ended with, begins another hole."""
CHORD_UM = 5.0
"""Curves are drawn in pieces about so long."""


@dataclass(frozen=True, slots=True)
class KnownDepth:
    """Depth and wear of a hole at a time, µm, NaN if unknown: a hole through the sheet has no depth.

    `hole` numbers the holes from 0 in the order of cutting; `touched` and `wear_touched` are whether depth and wear
    were measured by contact, not estimated from feed and energy.
    """

    time_s: float
    hole: int
    touched: bool
    wear_touched: bool
    depth_um: float
    depth_u95_um: float
    wear_um: float
    wear_u95_um: float


def known_depths(run: RunFile, began_s: Array) -> list[KnownDepth]:
    """Return the depths in order of time; `began_s` are the starts of the holes, by `hole_starts_s`."""

    def hole_at(time_s: float) -> int:
        return max(0, int(np.searchsorted(began_s, time_s, side="right")) - 1)

    names = ("depth_um", "depth_u95_um", "wear_um", "wear_u95_um")
    known = []
    for event in filter(has_depth, recorded_events(run, *DEPTH_EVENTS)):
        touched = (event.code not in _ESTIMATES,) * 2
        known.append(KnownDepth(event.time_s, hole_at(event.time_s), *touched, *map(event.number, names)))
    sites = sites_of(run)
    if known:
        last = {depth.hole: k for k, depth in enumerate(known)}
        if len(last) == len(sites):
            for (hole, k), site in zip(sorted(last.items()), sites, strict=True):
                known[k] = _of_result(site, known[k].time_s, hole)
        return known
    # Without events, at the last touch of each site: holes through the sheet, whose bottom was not touched.
    touches = run.table(layout.TOUCHES.path)
    last_s = {row["site"].decode(errors="ignore"): float(row["time"]) for row in touches}
    through = [
        _of_result(site, last_s[site.name], hole_at(last_s[site.name]))
        for site in sites
        if site.name in last_s
    ]
    without_depth = [replace(depth, depth_um=math.nan, depth_u95_um=math.nan) for depth in through]
    return sorted(without_depth, key=lambda depth: depth.time_s)


def hole_starts_s(run: RunFile) -> Array:
    """Return when each hole began: its first estimate of depth lies far above the last one of the hole before."""
    time_s, depth_um = floats(run, layout.SLOW.path, ("time", "est_depth")).values()
    began: list[float] = []
    before_um = math.inf
    for part in intervals(time_s):
        if depth_um[part][0] < SAME_HOLE_SHARE * before_um:
            began.append(max(float(time_s[part][0]) - ROW_S, 0.0))
        before_um = float(depth_um[part][-1])
    return np.array(began)


def _of_result(site: RecordedSite, time_s: float, hole: int) -> KnownDepth:
    values = (site.depth_um, site.depth_u95_um, site.wear_um, site.wear_u95_um)
    depth, wear = (basis in (Basis.TOUCHED, Basis.MODEL) for basis in (site.depth_basis, site.wear_basis))
    return KnownDepth(time_s, hole, depth, wear, *values)


@dataclass(frozen=True, slots=True)
class Removal:
    """Volumes at the n times at which a depth became known: ndarrays of shape (n,).

    `hole` numbers the holes from 0 in the order of cutting; `began_s` are the beginnings of all of them, shape
    (holes,). Volumes are those of one hole, µm³, with half their 95 % interval by that of the depth alone; `touched`
    if the depth was measured by contact, not estimated from the energy.
    """

    began_s: Array
    time_s: Array
    hole: NDArray[np.int64]
    volume_um3: Array
    volume_u95_um3: Array
    touched: Flags


@dataclass(frozen=True, slots=True)
class Kappa:
    """Volume per energy in µm³/µJ, half its 95 % interval by that of the depths, and the number of holes in it."""

    value: float
    u95: float
    holes: int


def removal(run: RunFile) -> Removal:
    """Return volumes: depths times the section of tool and side gap, along a channel its width times the length."""
    values, path_um = run.profile_values(), planned_path(run)
    width_um = float(values["tool.diameter_um"]) + 2.0 * float(values["work.side_gap_um"])
    section_um2 = math.pi / 4.0 * width_um**2
    if path_um is not None:
        section_um2 = width_um * float(lengths_um(path_um)[-1])
    began_s = hole_starts_s(run)
    known = [depth for depth in known_depths(run, began_s) if math.isfinite(depth.depth_um)]
    return Removal(
        began_s=began_s,
        time_s=np.array([depth.time_s for depth in known]),
        hole=np.array([depth.hole for depth in known], np.int64),
        volume_um3=section_um2 * np.array([depth.depth_um for depth in known]),
        volume_u95_um3=section_um2 * np.nan_to_num([depth.depth_u95_um for depth in known]),
        touched=np.array([depth.touched for depth in known], np.bool_),
    )


def in_this_run(removed: Removal, energy_uj: Array) -> Removal:
    """Return volumes less those before any spark of this run; `energy_uj`, shape (n,), is spent on each hole."""
    before = {int(hole): k for k, hole in reversed(list(enumerate(removed.hole))) if energy_uj[k] <= 0.0}
    kept = np.array([k not in before.values() for k in range(len(removed.hole))], np.bool_)
    earlier_um3, earlier_u95_um3 = (
        np.array([values[before[hole]] if hole in before else 0.0 for hole in removed.hole.tolist()])
        for values in (removed.volume_um3, removed.volume_u95_um3)
    )
    return replace(
        removed,
        time_s=removed.time_s[kept],
        hole=removed.hole[kept],
        volume_um3=(removed.volume_um3 - earlier_um3)[kept],
        volume_u95_um3=np.hypot(removed.volume_u95_um3, earlier_u95_um3)[kept],
        touched=removed.touched[kept],
    )


def cumulated(removed: Removal) -> tuple[Array, Array]:
    """Return the volume of all holes so far at each time, and half its 95 % interval, shape (n,), µm³."""
    volume_um3, u95_um3 = np.zeros(len(removed.time_s)), np.zeros(len(removed.time_s))
    latest: dict[int, int] = {}
    for k, hole in enumerate(removed.hole.tolist()):
        latest[hole] = k
        rows = list(latest.values())
        volume_um3[k] = removed.volume_um3[rows].sum()
        u95_um3[k] = math.hypot(*removed.volume_u95_um3[rows])
    return volume_um3, u95_um3


def kappa(removed: Removal, energy_uj: Array) -> Kappa | None:
    """Return volume over `energy_uj` as in `in_this_run`, of holes with a measured depth; None without any."""
    last = {int(hole): k for k, hole in enumerate(removed.hole) if removed.touched[k]}
    rows = [k for k in last.values() if energy_uj[k] > 0.0 and removed.volume_um3[k] > 0.0]
    if not rows:
        return None
    total_uj = float(energy_uj[rows].sum())
    u95_um3 = math.hypot(*removed.volume_u95_um3[rows])
    return Kappa(float(removed.volume_um3[rows].sum()) / total_uj, u95_um3 / total_uj, len(rows))


def planned_path(run: RunFile) -> Array | None:
    """Return points of the path in stage coordinates, shape (n, 2), µm; None if no channel is planned."""
    values = run.profile_values()

    def value(name: str) -> float:
        return float(values[f"path.{name}"])

    match values.get("path.kind"):
        case "rectangle":
            half = 0.5 * np.array([value("width_um"), value("height_um")])
            points: Array = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
        case "circle":
            points = _turns(value("radius_um"), 0.0, 1.0)
        case "spiral":
            points = _turns(value("radius_um"), value("pitch_um"), value("turns"))
        case _:
            return None
    points += np.array([value("x_um"), value("y_um")])
    return points


def _turns(inner_um: float, pitch_um: float, turns: float) -> Array:
    """Return turns about the origin from the x axis on, each further out by the pitch."""
    mean_um = inner_um + 0.5 * pitch_um * turns
    pieces = max(8, math.ceil(2.0 * math.pi * mean_um * turns / CHORD_UM))
    turned = turns * np.arange(pieces + 1) / pieces
    radii_um, angles = inner_um + pitch_um * turned, 2.0 * math.pi * turned
    return np.column_stack([radii_um * np.cos(angles), radii_um * np.sin(angles)])


def lengths_um(points_um: Array) -> Array:
    """Return the length of the path up to each point, shape (n,), for points of shape (n, 2)."""
    steps: Array = np.hypot(*np.diff(points_um, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)])


def along(points_um: Array, step_um: float) -> tuple[Array, Array]:
    """Return lengths every `step_um` along the path, shape (n,), and the places there, shape (n, 2)."""
    up_to_um = lengths_um(points_um)
    s_um = np.arange(0.0, up_to_um[-1], step_um)
    return s_um, np.column_stack([np.interp(s_um, up_to_um, axis) for axis in points_um.T])


def target_depths_um(values: Mapping[str, object]) -> tuple[float, float] | None:
    """Return depth and tolerance that a profile asks for; None if it asks for something else."""
    if values.get("target.kind") != "depth":
        return None
    return plain_number(values.get("target.depth_um")), plain_number(values.get("target.tolerance_um"))
