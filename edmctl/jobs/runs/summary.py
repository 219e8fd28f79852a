"""The summary of a run from its file, for people and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence

from edmctl.jobs.runs.explanation import events_of, sentences_of, wanted
from edmctl.jobs.runs.opening import command_to_go_on
from edmctl.record.layout import NO_EXIT_CODE, TOUCHES
from edmctl.record.reader import RunFile, error_code_of
from edmctl.record.run_index import estimated_depth, sites_of, status_of
from edmctl.results.run_file import FileEvent, JumpTimes, RunSummary, Sentence
from edmctl.wording import plain_number

TIME_LINE = frozenset(
    {
        *("TOUCHED", "FACE_FITTED", "RESUMED", "CUT_ENDED", "CUT_GIVEN_UP", "BREAKTHROUGH", "PASS_ENDED"),
        *("SITE_MEASURED", "SITE_ESTIMATED", "TARGET_REACHED", "TARGET_MISSED", "VERDICT", "LEFT_UNMEASURED"),
        *("CHANNEL_MEASURED", "WEAR_MEASURED", "SURFACE_FOUND", "JUMP_MEASURED", "ENDED_EARLY"),
    }
)
"""Kinds of sentences in a time line; `run explain` has all."""
SOFTWARE = {"edmctl": "version", "Python": "python", "h5py": "h5py", "HDF5": "hdf5"}
WARNING_LEVEL = 2


def summary_of(opened: RunFile) -> RunSummary:
    """Read the summary of an open run file, also of one without an end."""
    from edmctl.report.export import TABLES

    sites, events = sites_of(opened), events_of(opened)
    summary = opened.summary()
    exit_code = int(opened.number("/entry/exit_code"))
    sentences = sentences_of(opened)
    estimated = estimated_depth(opened)
    return RunSummary(
        file=str(opened.path),
        size_bytes=opened.path.stat().st_size,
        run_id=opened.text("/entry/run_id"),
        parent_run=opened.text("/entry/parent_run"),
        title=opened.text("/entry/title"),
        wanted=wanted(opened),
        command=tuple(json.loads(opened.text("/entry/command") or "[]")),
        user=opened.text("/entry/user/name"),
        start_time=opened.text("/entry/start_time"),
        end_time=opened.text("/entry/end_time"),
        status=status_of(opened),
        exit_code=None if exit_code == NO_EXIT_CODE else exit_code,
        error_code=error_code_of(opened),
        recovery=opened.text("/entry/recovery"),
        way_on=command_to_go_on(opened.path),
        simulated=opened.is_simulated,
        seed=opened.seed,
        time_s=_time_s(opened, summary, events),
        machining_time_s=sites.total("machining_time_s"),
        earlier_time_s=opened.number("/entry/parent_time"),
        pause_s=plain_number((summary or {}).get("pause_s", 0.0)),
        sites=sites,
        est_depth_um=estimated.depth_um,
        est_depth_u95_um=estimated.depth_u95_um,
        totals=sites.totals,
        jumps=jumps_of(events),
        touches=tuple(_touches(opened)),
        moments=tuple(sentence for sentence in sentences if sentence.code in TIME_LINE),
        warnings=tuple(_warnings(events)),
        machine={
            name: opened.text(f"/entry/machine/{name}")
            for name in ("host", "serial", "firmware", "protocol", "calibration")
        },
        software={name: opened.text(f"/entry/software/{source}") for name, source in SOFTWARE.items()},
        profile={"path": opened.text("/entry/profile/path"), "values": opened.profile_values()},
        overrides=tuple(opened.text("/entry/profile/overrides").splitlines()),
        rows={name: opened.rows(table.path) for name, table in TABLES.items()},
        summary=summary,
    )


def _time_s(opened: RunFile, summary: Mapping[str, object] | None, events: Sequence[FileEvent]) -> float:
    """Return how long the job took; of one without an end, to its last row."""
    time_s = plain_number((summary or {}).get("time_s"))
    if math.isfinite(time_s):
        return time_s
    servo = opened.rows("/entry/servo")
    last = opened.column("/entry/servo", "time", servo - 1, servo).tolist() if servo else []
    return opened.number("/entry/parent_time") + max(
        [*last, *(event.time_s for event in events[-1:])], default=math.nan
    )


def jumps_of(events: Sequence[FileEvent]) -> JumpTimes:
    """Count all jumps, and the times between jumps of the same cut."""
    from statistics import median

    apart_s: list[float] = []
    count, last_s = 0, math.nan
    for event in events:
        if event.code == "JUMP_DONE":
            count += 1
            if math.isfinite(last_s):
                apart_s.append(event.time_s - last_s)
            last_s = event.time_s
        elif event.code == "CUT_ENDED":
            last_s = math.nan
    if not apart_s:
        return JumpTimes(count, math.nan, math.nan, math.nan)
    return JumpTimes(count, min(apart_s), median(apart_s), max(apart_s))


def _touches(opened: RunFile) -> list[dict[str, object]]:
    from edmctl.report.export import named

    names = {column.name: named(column) for column in TOUCHES.columns}
    found: list[dict[str, object]] = []
    for row in opened.table(TOUCHES.path):
        values = {names[name]: row[name].item() for name in row.dtype.names if name in names}
        texts = {name: v.decode(errors="replace") for name, v in values.items() if isinstance(v, bytes)}
        found.append(values | texts)
    return found


def _warnings(events: Sequence[FileEvent]) -> list[Sentence]:
    found = []
    for event in events:
        if event.level >= WARNING_LEVEL:
            hint = event.args.get("hint")
            text = f"{event.message} {hint}" if isinstance(hint, str) and hint else event.message
            found.append(Sentence(event.time_s, text, event.code))
    return found
