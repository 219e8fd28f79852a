"""How deep a run got that has no measured end: the last estimate of the hole or channel that it was at."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record.event_names import Told
from edmctl.record.event_reader import happened
from edmctl.record.layout import RESULTS, SLOW

if TYPE_CHECKING:
    from edmctl.record.reader import RunFile

_LAST_ROWS = 100
"""Among so many last rows of the supervisor an estimate is looked for: the very last may have none."""
_SETTLES = (Told.SITE_MEASURED, Told.SITE_ESTIMATED, Told.CHANNEL_MEASURED, Told.LEFT_UNMEASURED)


@dataclass(frozen=True, slots=True)
class Estimated:
    """Depth and half its 95 % interval, µm, NaN where unknown."""

    depth_um: float
    depth_u95_um: float


NOTHING = Estimated(math.nan, math.nan)


def estimated_depth(run: RunFile) -> Estimated:
    """Return the last estimate for a hole or channel that has no result, NaN where every one has."""
    if run.is_finished and int(run.number("/entry/exit_code")) == 0:
        return NOTHING
    rows = run.rows(SLOW.path)
    last = slice(max(0, rows - _LAST_ROWS), rows)
    time_s, depth_um = (
        run.column(SLOW.path, name, last.start, last.stop).astype(np.float64)
        for name in ("time", "est_depth")
    )
    known = np.flatnonzero(np.isfinite(depth_um[: len(time_s)]))
    if not len(known) or (run.rows(RESULTS.path) and time_s[known[-1]] <= _settled_s(run)):
        return NOTHING
    u95_um = run.column(SLOW.path, "est_depth_u95", last.start, last.stop).astype(np.float64)
    k = int(known[-1])
    return Estimated(float(depth_um[k]), float(u95_um[k]) if k < len(u95_um) else math.nan)


def left_site(run: RunFile) -> str:
    """Name of the hole that was under way when the job ended, where it has a row of results; else empty."""
    named = [str(event.values.get("site", "")) for event in happened(run, Told.LEFT_UNMEASURED)]
    return named[-1] if named else ""


def _settled_s(run: RunFile) -> float:
    """When the last depth was told that became, or may have become, a result.

    A hole that was left has one where its estimate was told with an interval.
    """
    return max(
        (
            event.time_s
            for event in happened(run, *_SETTLES)
            if event.told != Told.LEFT_UNMEASURED or math.isfinite(event.number("depth_u95_um"))
        ),
        default=math.inf,
    )
