"""The results in a run file, and the estimate of a hole without one."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from edmctl.dataclasses import dataclass
from edmctl.labels import Basis
from edmctl.record.events import RecordedCode, recorded_events
from edmctl.record.layout import RESULTS, SLOW, TOUCHES
from edmctl.record.plain_values import record_of
from edmctl.record.reader import RunFile
from edmctl.results.declared import ONLY_JSON, quantities
from edmctl.results.job import SiteResult, SiteTruth
from edmctl.results.run_file import RecordedSite
from edmctl.results.telemetry import PulseShares


def sites_of(run: RunFile) -> tuple[RecordedSite, ...]:
    """Return the results of a run: what its table has of each site, and the rest as its summary has it."""
    places = dict(_places(run.summary() or {}))
    thickness_um = run.number("/entry/sample/thickness")
    return tuple(_site(row, places, thickness_um) for row in run.table(RESULTS.path))


def _places(summary: Mapping[str, object]) -> Iterator[tuple[str, Mapping[str, object]]]:
    """Each hole or channel of the summary, under the name that a result's row has room for."""
    sites = summary.get("sites")
    for place in (*(sites if isinstance(sites, list) else ()), summary.get("channel")):
        if isinstance(place, Mapping):
            yield str(place.get("name")), place


_ONLY_JSON = [name for name, one in quantities(SiteResult).items() if one.group == ONLY_JSON]


_UNKNOWN: dict[str, Any] = {"f": math.nan, "u": 0, "S": ""}
"""Values of columns that the file does not have, by type: columns are added without a new version of the layout."""


def _site(row: np.void, places: Mapping[str, Mapping[str, object]], thickness_um: float) -> RecordedSite:
    there = row.dtype.names or ()
    stored = {
        one.field: row[one.name].item() if one.name in there else _UNKNOWN[one.dtype[0]]
        for one in RESULTS.columns
    }
    values = {name: v.decode(errors="ignore") if isinstance(v, bytes) else v for name, v in stored.items()}
    place = places.get(str(values["name"]), {})
    truth = place.get("truth")
    known = {name: values[name] for name in quantities(SiteResult) if name in values}
    known |= {name: bool(values[name]) for name in ("through", "drift_by_rests")}
    known |= {name: values[name] or None for name in ("depth_basis", "verdict")}
    return record_of(
        RecordedSite,
        known
        | {name: place[name] for name in _ONLY_JSON if name in place}
        | {
            "wear_basis": values["wear_basis"] or Basis.ESTIMATED,
            "ratios": {name: values[f"ratios.{name}"] for name in quantities(PulseShares)},
            "length_um": thickness_um if values["through"] else values["depth_um"],
            "truth": {k: v for k, v in truth.items() if k in quantities(SiteTruth)}
            if isinstance(truth, Mapping)
            else {},
        },
    )


def has_sensor(run: RunFile) -> bool:
    """Return whether a displacement sensor took the readings; without one they are estimates from the voltage."""
    touches = run.table(TOUCHES.path)
    return not len(touches) or bool(np.isfinite(touches["z_sensor"]).any())


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
