"""The results in a run file, the estimate of a hole without one, and an overview of the run files in a folder."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import RunFileError
from edmctl.labels import Basis, weakest, worst
from edmctl.record.disk import PARTIAL
from edmctl.record.json_rows import record_of
from edmctl.record.layout import NO_EXIT_CODE, RESULTS, SLOW, TOUCHES
from edmctl.record.locks import is_live
from edmctl.record.reader import RunFile, error_code_of, reading, recorded_events
from edmctl.record.rows import RunEvent
from edmctl.results.declared import ONLY_JSON, quantities
from edmctl.results.job import SiteResult, SiteTruth
from edmctl.results.run_file import RecordedSite, RunHead, Sites, Unreadable
from edmctl.results.telemetry import PulseShares
from edmctl.wording import plain_number


def sites_of(run: RunFile) -> Sites:
    """Return the results of a run: what its table has of each site, and the rest as its summary has it."""
    places = dict(_places(run.summary() or {}))
    thickness_um = run.number("/entry/sample/thickness")
    return Sites(_site(row, places, thickness_um) for row in run.table(RESULTS.path))


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
    RunEvent.SITE_MEASURED,
    RunEvent.SITE_ESTIMATED,
    RunEvent.CHANNEL_MEASURED,
    RunEvent.LEFT_UNMEASURED,
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
    named = [str(event.values.get("site", "")) for event in recorded_events(run, RunEvent.LEFT_UNMEASURED)]
    return named[-1] if named else ""


def _settled_s(run: RunFile) -> float:
    """Return the time of the last depth that is, or may be, a result.

    A hole that was left has one where its estimate has an interval.
    """
    return max(
        (
            event.time_s
            for event in recorded_events(run, *_SETTLES)
            if event.code != RunEvent.LEFT_UNMEASURED or math.isfinite(event.number("depth_u95_um"))
        ),
        default=math.inf,
    )


ENDINGS = (".h5", f".h5{PARTIAL}")
RUNNING, INTERRUPTED = "running", "interrupted"
_RESULTS = ("depth", "depth_u95", "wear", "wear_u95", "machining_time", "through")
_WORDS = ("depth_basis", "wear_basis", "verdict")


def heads_of(folder: Path) -> Iterator[RunHead | Unreadable]:
    """Read the heads of the run files in `folder`, by name. The file of a killed run that was recovered is left out.

    Raises RunFileError E9005 when the folder cannot be read.
    """
    found: list[RunHead | Unreadable] = [_looked_at(path) for path in run_files(folder)]
    complete = {(head.path.name, head.run_id) for head in found if isinstance(head, RunHead)}
    for head in found:
        recovered = head.path.name.removesuffix(PARTIAL)
        if not (
            isinstance(head, RunHead)
            and head.path.suffix == PARTIAL
            and head.status != RUNNING
            and (recovered, head.run_id) in complete
        ):
            yield head


def run_files(folder: Path) -> list[Path]:
    """Return what is called like a run file in `folder`, by name. Raises RunFileError E9005."""
    try:
        return sorted(path for path in folder.iterdir() if path.name.endswith(ENDINGS))
    except OSError as error:
        raise failures.folder_unreadable(folder=folder, reason=error.strerror) from error


def read_head(path: Path) -> RunHead:
    """Read the head of a run file. Its check sum is not compared. Raises RunFileError E9005–E9007."""
    with reading(path, verify=False) as run:
        return _head(run)


def _looked_at(path: Path) -> RunHead | Unreadable:
    try:
        return read_head(path)
    except RunFileError as error:
        size_bytes, changed_s = 0, 0.0
        with suppress(OSError):
            size_bytes, changed_s = path.lstat().st_size, path.lstat().st_mtime
        return Unreadable(path, size_bytes, changed_s, error)


def _head(run: RunFile) -> RunHead:
    exit_code = int(run.number("/entry/exit_code"))
    results = run.fields(RESULTS.path, _RESULTS, ("site", *_WORDS))
    machining_time_s = float(np.sum(results["machining_time"])) if len(results) else math.nan
    if exit_code and len(results) > 1 and (left := left_site(run)):
        # The means are of finished holes, where there are some.
        finished = [row["site"] != left.encode()[:32] for row in results]
        results = results[finished]
    words = {name: [one.decode(errors="replace") for one in results[name]] for name in _WORDS}
    found: dict[str, Any] = {name: weakest(words[name]) for name in ("depth_basis", "wear_basis")}
    if len(results):
        blind = results[results["through"] == 0]
        found |= {f"{name}_um": _mean(blind[name]) for name in ("depth", "depth_u95")}
        found |= {f"{name}_um": _mean(results[name]) for name in ("wear", "wear_u95")}
    else:
        touched = run.summary() or {}
        found = {name: str(touched.get(name) or "") for name in found}
        found |= {f"{name}_um": plain_number(touched.get(f"{name}_um")) for name in _RESULTS[:4]}
    estimated = estimated_depth(run)
    return RunHead(
        path=run.path,
        size_bytes=run.path.stat().st_size,
        run_id=run.text("/entry/run_id"),
        parent_run=run.text("/entry/parent_run"),
        name=str(run.profile_value("meta.name") or run.path.stem),
        title=run.text("/entry/title"),
        start_time=run.text("/entry/start_time"),
        end_time=run.text("/entry/end_time"),
        status=status_of(run),
        exit_code=None if exit_code == NO_EXIT_CODE else exit_code,
        error_code=error_code_of(run) if exit_code else "",
        simulated=run.is_simulated,
        seed=run.seed,
        work=run.text("/entry/sample/material"),
        tool=run.text("/entry/tool/material"),
        sites=len(results),
        through=int(np.sum(results["through"])),
        est_depth_um=estimated.depth_um,
        est_depth_u95_um=estimated.depth_u95_um,
        machining_time_s=machining_time_s,
        **found,
        verdict=worst(words["verdict"]),
    )


def status_of(run: RunFile) -> str:
    """Return how the run ended, `running` while its writer lives, or `interrupted` when that was killed."""
    if run.is_finished:
        return run.text("/entry/status")
    return RUNNING if is_live(run.path) else INTERRUPTED


def _mean(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(np.mean(known)) if len(known) else math.nan
