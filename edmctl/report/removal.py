"""Removed volume at the times when a run told the depth of its holes, and the discharge energy that each took."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from edmctl.report.depth_history import beginnings_s, told_depths
from edmctl.report.planned_path import lengths_um, planned_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]
    Flags = NDArray[np.bool_]


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
    began_s = beginnings_s(run)
    told = [depth for depth in told_depths(run, began_s) if math.isfinite(depth.depth_um)]
    section_um2 = _section_um2(run)
    return Removal(
        began_s=began_s,
        time_s=np.array([depth.time_s for depth in told]),
        hole=np.array([depth.hole for depth in told], np.int64),
        volume_um3=section_um2 * np.array([depth.depth_um for depth in told]),
        volume_u95_um3=section_um2 * np.nan_to_num([depth.depth_u95_um for depth in told]),
        touched=np.array([depth.touched for depth in told], np.bool_),
    )


def in_this_run(found: Removal, energy_uj: Array) -> Removal:
    """Return the volumes less what earlier runs of the job had removed: that was told before any spark of this one.

    energy_uj : ndarray, shape (n,), energy spent on the hole of each row until then
    """
    before = {int(hole): k for k, hole in reversed(list(enumerate(found.hole))) if energy_uj[k] <= 0.0}
    kept = np.array([k not in before.values() for k in range(len(found.hole))], np.bool_)
    earlier_um3 = np.array([found.volume_um3[before[h]] if h in before else 0.0 for h in found.hole.tolist()])
    earlier_u95_um3 = np.array(
        [found.volume_u95_um3[before[h]] if h in before else 0.0 for h in found.hole.tolist()]
    )
    return replace(
        found,
        time_s=found.time_s[kept],
        hole=found.hole[kept],
        volume_um3=(found.volume_um3 - earlier_um3)[kept],
        volume_u95_um3=np.hypot(found.volume_u95_um3, earlier_u95_um3)[kept],
        touched=found.touched[kept],
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
