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
from edmctl.record.reader import RecordedEvent, RunFile, error_code_of, reading, recorded_events
from edmctl.record.rows import RunEvent
from edmctl.results.declared import ONLY_JSON, quantities
from edmctl.results.job import SiteResult, SiteTruth
from edmctl.results.run_file import RecordedSite, RunHead, Sites, Unreadable
from edmctl.results.telemetry import PulseShares
from edmctl.wording import plain_number

ENDINGS = (".h5", f".h5{PARTIAL}")
RUNNING, INTERRUPTED = "running", "interrupted"
DEPTH_EVENTS = (
    RunEvent.SITE_MEASURED,
    RunEvent.SITE_ESTIMATED,
    RunEvent.CHANNEL_MEASURED,
    RunEvent.LEFT_UNMEASURED,
)
"""Events with the depth of a hole or channel; that of one left unmeasured counts if it has an interval."""
_ONLY_JSON = [name for name, one in quantities(SiteResult).items() if one.group == ONLY_JSON]
_UNKNOWN: dict[str, Any] = {"f": math.nan, "u": 0, "S": ""}
"""Values of columns that the file does not have, by type: columns are added without a new version of the layout."""
_LAST_ROWS = 100
"""An estimate is searched in so many last rows of the supervisor: the very last may have none."""
_LENGTHS = ("depth", "depth_u95", "wear", "wear_u95")
_TEXTS = ("run_id", "parent_run", "title", "start_time", "end_time")
_WORDS = ("depth_basis", "wear_basis", "verdict")


def sites_of(run: RunFile) -> Sites:
    """Return the results of a run: the row of each site in its table, and the rest from its summary."""
    summary = run.summary() or {}
    sites = summary.get("sites")
    places = [*(sites if isinstance(sites, list) else ()), summary.get("channel")]
    by_name = {str(place.get("name")): place for place in places if isinstance(place, Mapping)}
    thickness_um = run.number("/entry/sample/thickness")
    return Sites(_site(row, by_name, thickness_um) for row in run.table(RESULTS.path))


def _site(row: np.void, places: Mapping[str, Mapping[str, object]], thickness_um: float) -> RecordedSite:
    present = row.dtype.names or ()
    stored = {
        one.field: row[one.name].item() if one.name in present else _UNKNOWN[one.dtype[0]]
        for one in RESULTS.columns
    }
    values = {name: v.decode(errors="ignore") if isinstance(v, bytes) else v for name, v in stored.items()}
    place = places.get(str(values["name"]), {})
    truth = place.get("truth")
    known = {name: values[name] for name in quantities(SiteResult) if name in values}
    known |= {name: bool(values[name]) for name in ("through", "drift_by_rests")}
    known |= {name: values[name] or None for name in ("depth_basis", "verdict")}
    known |= {name: place[name] for name in _ONLY_JSON if name in place}
    known |= {
        "wear_basis": values["wear_basis"] or Basis.ESTIMATED,
        "ratios": {name: values[f"ratios.{name}"] for name in quantities(PulseShares)},
        "length_um": thickness_um if values["through"] else values["depth_um"],
        "truth": {name: v for name, v in truth.items() if name in quantities(SiteTruth)}
        if isinstance(truth, Mapping)
        else {},
    }
    return record_of(RecordedSite, known)


def has_sensor(run: RunFile) -> bool:
    """Return whether a displacement sensor took the readings; without one they are estimates from the voltage."""
    touches = run.table(TOUCHES.path)
    return not len(touches) or bool(np.isfinite(touches["z_sensor"]).any())


@dataclass(frozen=True, slots=True)
class Estimated:
    """Depth and half its 95 % interval, µm, NaN if unknown."""

    depth_um: float = math.nan
    depth_u95_um: float = math.nan


def estimated_depth(run: RunFile) -> Estimated:
    """Return the last estimate for a hole or channel that has no result, NaN if every one has."""
    if run.is_finished and int(run.number("/entry/exit_code")) == 0:
        return Estimated()
    stop = run.rows(SLOW.path)
    start = max(0, stop - _LAST_ROWS)
    columns = [run.column(SLOW.path, name, start, stop) for name in ("time", "est_depth", "est_depth_u95")]
    known = [row for row in zip(*columns, strict=False) if np.isfinite(row[1])]
    if not known:
        return Estimated()
    time_s, depth_um, u95_um = map(float, known[-1])
    if run.rows(RESULTS.path):
        # Depths that are, or may be, results.
        events = recorded_events(run, *DEPTH_EVENTS)
        if time_s <= max((event.time_s for event in events if has_depth(event)), default=math.inf):
            return Estimated()
    return Estimated(depth_um, u95_um)


def has_depth(event: RecordedEvent) -> bool:
    """Return whether an event of `DEPTH_EVENTS` has a depth."""
    return event.code != RunEvent.LEFT_UNMEASURED or math.isfinite(event.number("depth_u95_um"))


def heads_of(folder: Path) -> Iterator[RunHead | Unreadable]:
    """Read the heads of run files by name, except of recovered killed runs. Raises RunFileError E9005."""
    heads: list[RunHead | Unreadable] = []
    for path in run_files(folder):
        try:
            heads.append(read_head(path))
        except RunFileError as error:
            size_bytes, changed_s = 0, 0.0
            with suppress(OSError):
                size_bytes, changed_s = path.lstat().st_size, path.lstat().st_mtime
            heads.append(Unreadable(path, size_bytes, changed_s, error))
    complete = {(head.path.name, head.run_id) for head in heads if isinstance(head, RunHead)}
    for head in heads:
        is_recovered = (
            isinstance(head, RunHead)
            and head.path.suffix == PARTIAL
            and head.status != RUNNING
            and (head.path.stem, head.run_id) in complete
        )
        if not is_recovered:
            yield head


def run_files(folder: Path) -> list[Path]:
    """Return what is named like a run file in `folder`, by name. Raises RunFileError E9005."""
    try:
        return sorted(path for path in folder.iterdir() if path.name.endswith(ENDINGS))
    except OSError as error:
        raise failures.folder_unreadable(folder=folder, reason=error.strerror) from error


def read_head(path: Path) -> RunHead:
    """Read the head of a run file. Its check sum is not compared. Raises RunFileError E9005–E9007."""
    with reading(path, verify=False) as run:
        return _head(run)


def _head(run: RunFile) -> RunHead:
    exit_code = int(run.number("/entry/exit_code"))
    results = run.fields(RESULTS.path, (*_LENGTHS, "machining_time", "through"), ("site", *_WORDS))
    machining_time_s = float(np.sum(results["machining_time"])) if len(results) else math.nan
    if exit_code and len(results) > 1:
        # Means are of finished holes: a hole that was under way when the job ended may have a row.
        abandoned = [
            str(event.values.get("site", "")) for event in recorded_events(run, RunEvent.LEFT_UNMEASURED)
        ]
        if abandoned and abandoned[-1]:
            results = results[results["site"] != abandoned[-1].encode()]
    words = {name: [one.decode(errors="replace") for one in results[name]] for name in _WORDS}
    values: dict[str, Any] = {name: weakest(words[name]) for name in ("depth_basis", "wear_basis")}
    if len(results):
        of_lengths = dict.fromkeys(_LENGTHS[:2], results[results["through"] == 0])
        of_lengths |= dict.fromkeys(_LENGTHS[2:], results)
        values |= {f"{name}_um": _mean(rows[name]) for name, rows in of_lengths.items()}
    else:
        summary = run.summary() or {}
        values = {name: str(summary.get(name) or "") for name in values}
        values |= {f"{name}_um": plain_number(summary.get(f"{name}_um")) for name in _LENGTHS}
    estimated = estimated_depth(run)
    texts: dict[str, Any] = {name: run.text(f"/entry/{name}") for name in _TEXTS}
    return RunHead(
        path=run.path,
        size_bytes=run.path.stat().st_size,
        **texts,
        name=str(run.profile_value("meta.name") or run.path.stem),
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
        **values,
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
