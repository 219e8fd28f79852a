"""The results of a run file: what they rest on, how they are judged, and what is only estimated."""

from __future__ import annotations

import math

import numpy as np

from edmctl.dataclasses import dataclass
from edmctl.labels import Basis
from edmctl.record.events import RecordedCode, recorded_events
from edmctl.record.layout import RESULTS, SLOW, TOUCHES
from edmctl.record.reader import RunFile

_NUMBERS = ("stops", "estimated", "through")
_WORDS = ("depth_basis", "wear_basis", "verdict")


@dataclass(frozen=True, slots=True)
class Labels:
    """What depth and wear of a site rest on, and its verdict; empty without a depth or a verdict."""

    depth_basis: str
    wear_basis: str
    verdict: str


def labels_of(run: RunFile) -> list[Labels]:
    """Return the labels of every site of a run, in the order of its results."""
    rows = run.fields(RESULTS.path, _NUMBERS, _WORDS)
    older = [row for row in rows if not row["wear_basis"]]
    touched = Basis.TOUCHED if not older or has_sensor(run) else Basis.MODEL
    return [_labels(row, touched) for row in rows]


def has_sensor(run: RunFile) -> bool:
    """Whether a displacement sensor took the readings; without one they are estimates from the actuator voltage."""
    touches = run.table(TOUCHES.path)
    return not len(touches) or bool(np.isfinite(touches["z_sensor"]).any())


def _labels(row: np.void, touched: Basis) -> Labels:
    depth, wear, verdict = (row[name].decode(errors="replace") for name in _WORDS)
    if not wear:
        depth = wear = touched if row["stops"] > 0 and not row["estimated"] > 0.0 else Basis.ESTIMATED
    return Labels("" if row["through"] else depth, wear, verdict)


_LAST_ROWS = 100
"""Among so many last rows of the supervisor an estimate is looked for: the very last may have none."""
_SETTLES = (
    RecordedCode.SITE_MEASURED,
    RecordedCode.SITE_ESTIMATED,
    RecordedCode.CHANNEL_MEASURED,
    RecordedCode.LEFT_UNMEASURED,
)


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
    named = [
        str(event.values.get("site", "")) for event in recorded_events(run, RecordedCode.LEFT_UNMEASURED)
    ]
    return named[-1] if named else ""


def _settled_s(run: RunFile) -> float:
    """Return the time of the last depth that is, or may be, a result.

    A hole that was left has one where its estimate has an interval.
    """
    return max(
        (
            event.time_s
            for event in recorded_events(run, *_SETTLES)
            if event.code != RecordedCode.LEFT_UNMEASURED or math.isfinite(event.number("depth_u95_um"))
        ),
        default=math.inf,
    )
