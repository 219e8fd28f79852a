"""The depths and the tool wear that a run told of its holes, each at its time, and as its results correct them.

What was estimated before a later touch is corrected by it: events tell what was known then, the results what is
known at the end. So the last value of each hole is that of its result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from edmctl.labels import Basis
from edmctl.record import layout
from edmctl.record.event_names import Told
from edmctl.record.event_reader import happened
from edmctl.report.cutting_intervals import ROW_S, stretches
from edmctl.report.numbers import numbers_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile
    from edmctl.report.numbers import SiteNumbers

    Array = NDArray[np.float64]

_TELL = (Told.SITE_MEASURED, Told.SITE_ESTIMATED, Told.CHANNEL_MEASURED, Told.LEFT_UNMEASURED)
_ESTIMATES = (Told.SITE_ESTIMATED, Told.LEFT_UNMEASURED)
SAME_HOLE_SHARE = 0.5
"""A cut that begins at less of the depth that the cut before ended with, begins another hole."""


@dataclass(frozen=True, slots=True)
class ToldDepth:
    """Depth and wear of a hole at a time, µm, NaN where unknown: a hole through the sheet has no depth to tell.

    `hole` numbers the holes from 0 in the order in which they were cut; `touched` and `wear_touched` are whether
    depth and wear were touched, not taken from feed and energy.
    """

    time_s: float
    hole: int
    touched: bool
    wear_touched: bool
    depth_um: float
    depth_u95_um: float
    wear_um: float
    wear_u95_um: float


def told_depths(run: RunFile, began_s: Array) -> list[ToldDepth]:
    """Return what was told, in order of time; `began_s` are the beginnings of the holes, by `beginnings_s`."""
    told = [
        ToldDepth(
            event.time_s,
            _hole(began_s, event.time_s),
            event.told not in _ESTIMATES,
            event.told not in _ESTIMATES,
            *(event.number(name) for name in ("depth_um", "depth_u95_um", "wear_um", "wear_u95_um")),
        )
        for event in happened(run, *_TELL)
        if event.told != Told.LEFT_UNMEASURED or math.isfinite(event.number("depth_u95_um"))
    ]
    sites = numbers_of(run).sites
    if not told:
        return _of_results(run, sites, began_s)
    last = {depth.hole: k for k, depth in enumerate(told)}
    if len(last) == len(sites):
        for (hole, k), site in zip(sorted(last.items()), sites, strict=True):
            told[k] = _result(site, told[k].time_s, hole)
    return told


def beginnings_s(run: RunFile) -> Array:
    """When each hole was begun: its first estimate of the depth lies far above the last one of the hole before."""
    time_s = run.column(layout.SLOW.path, "time").astype(np.float64)
    depth_um = run.column(layout.SLOW.path, "est_depth").astype(np.float64)
    began: list[float] = []
    before_um = math.inf
    for part in stretches(time_s):
        if depth_um[part][0] < SAME_HOLE_SHARE * before_um:
            began.append(max(float(time_s[part][0]) - ROW_S, 0.0))
        before_um = float(depth_um[part][-1])
    return np.array(began)


def _of_results(run: RunFile, sites: Sequence[SiteNumbers], began_s: Array) -> list[ToldDepth]:
    """Results at the last touch of their sites; holes through the sheet have no bottom that was touched."""
    last_s = {
        row["site"].decode(errors="ignore"): float(row["time"]) for row in run.table(layout.TOUCHES.path)
    }
    found = [
        replace(
            _result(site, last_s[site.name], _hole(began_s, last_s[site.name])),
            depth_um=math.nan,
            depth_u95_um=math.nan,
        )
        for site in sites
        if site.name in last_s
    ]
    return sorted(found, key=lambda depth: depth.time_s)


def _result(site: SiteNumbers, time_s: float, hole: int) -> ToldDepth:
    values = (site.depth_um, site.depth_u95_um, site.wear_um, site.wear_u95_um)
    depth, wear = (basis != Basis.ESTIMATED for basis in (site.depth_basis, site.wear_basis))
    return ToldDepth(time_s, hole, depth, wear, *values)


def _hole(began_s: Array, time_s: float) -> int:
    return max(0, int(np.searchsorted(began_s, time_s, side="right")) - 1)
