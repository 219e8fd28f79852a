"""Removed volume at the times when a run told the depth of its holes, and the discharge energy that each took."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record import layout
from edmctl.record.told import Told
from edmctl.report.happened import happened
from edmctl.report.planned_path import lengths_um, planned_path
from edmctl.report.stretches import stretches

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]

SAME_HOLE_SHARE = 0.5
"""A cut that begins at less of the depth that the cut before ended with, begins another hole."""


@dataclass(frozen=True, slots=True)
class Removal:
    """What was told of the depths, n times: ndarrays of shape (n,).

    `hole` numbers the holes from 0 in the order in which they were cut; `began_s` are the beginnings of all of them,
    shape (holes,). Volumes are those of one hole, µm³, with half their 95 % interval by that of the depth alone;
    `touched` where the depth was measured, not taken from the energy.
    """

    began_s: Array
    time_s: Array
    hole: NDArray[np.int64]
    volume_um3: Array
    volume_u95_um3: Array
    touched: Flags


@dataclass(frozen=True, slots=True)
class Kappa:
    """Volume per energy in µm³/µJ, half its 95 % interval by that of the depths, and of how many holes it is."""

    value: float
    u95: float
    holes: int


def removal(run: RunFile) -> Removal:
    """Return the volumes of the holes of a run each time that their depth was told."""
    told = happened(run, Told.SITE_MEASURED, Told.SITE_ESTIMATED, Told.CHANNEL_MEASURED)
    section_um2 = _section_um2(run)
    began_s = _beginnings_s(run)
    time_s = np.array([event.time_s for event in told])
    return Removal(
        began_s=began_s,
        time_s=time_s,
        hole=np.maximum(np.searchsorted(began_s, time_s, side="right") - 1, 0),
        volume_um3=section_um2 * np.array([event.number("depth_um") for event in told]),
        volume_u95_um3=section_um2 * np.nan_to_num([event.number("depth_u95_um") for event in told]),
        touched=np.array([event.told is not Told.SITE_ESTIMATED for event in told], np.bool_),
    )


def cumulated(found: Removal) -> tuple[Array, Array]:
    """Return the volume of all holes so far at each time, and half its 95 % interval, shape (n,), µm³."""
    volume_um3, u95_um3 = np.zeros(len(found.time_s)), np.zeros(len(found.time_s))
    for k, hole in enumerate(found.hole):
        latest = {int(other): i for i, other in enumerate(found.hole[: k + 1])}
        latest[int(hole)] = k
        rows = list(latest.values())
        volume_um3[k] = found.volume_um3[rows].sum()
        u95_um3[k] = math.hypot(*found.volume_u95_um3[rows])
    return volume_um3, u95_um3


def kappa(found: Removal, energy_uj: Array) -> Kappa | None:
    """Return volume over energy of the holes that were touched; None where none was.

    energy_uj : ndarray, shape (n,), energy spent on the hole of each row until then
    """
    last = {int(hole): k for k, hole in enumerate(found.hole) if found.touched[k]}
    rows = [k for k in last.values() if energy_uj[k] > 0.0 and found.volume_um3[k] > 0.0]
    if not rows:
        return None
    total_uj = float(energy_uj[rows].sum())
    u95_um3 = math.hypot(*found.volume_u95_um3[rows])
    return Kappa(float(found.volume_um3[rows].sum()) / total_uj, u95_um3 / total_uj, len(rows))


def _section_um2(run: RunFile) -> float:
    """Volume per depth: the tool with the side gap all round, or along a channel its width times its length."""
    values = run.profile_values()
    width_um = float(values["tool.diameter_um"]) + 2.0 * float(values["work.side_gap_um"])
    path_um = planned_path(run)
    if path_um is None:
        return math.pi / 4.0 * width_um**2
    return width_um * float(lengths_um(path_um)[-1])


def _beginnings_s(run: RunFile) -> Array:
    """When each hole was begun: its first estimate of the depth lies far above the last one of the hole before."""
    time_s = run.column(layout.SLOW.path, "time").astype(np.float64)
    depth_um = run.column(layout.SLOW.path, "est_depth").astype(np.float64)
    began: list[float] = []
    before_um = math.inf
    for part in stretches(time_s):
        if depth_um[part][0] < SAME_HOLE_SHARE * before_um:
            began.append(float(time_s[part][0]))
        before_um = float(depth_um[part][-1])
    return np.array(began)
