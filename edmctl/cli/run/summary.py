"""What a run file says, gathered for people and as JSON."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.console.story import Sentence

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from edmctl.cli.run.explain import FileEvent
    from edmctl.record.reader import RunFile
    from edmctl.report.numbers import RunNumbers, SiteNumbers

TIME_LINE = frozenset(
    {
        *("TOUCHED", "FACE_FITTED", "RESUMED", "CUT_ENDED", "CUT_GIVEN_UP", "BREAKTHROUGH", "PASS_ENDED"),
        *("SITE_MEASURED", "SITE_ESTIMATED", "TARGET_REACHED", "TARGET_MISSED", "VERDICT", "LEFT_UNMEASURED"),
        *("CHANNEL_MEASURED", "WEAR_MEASURED", "SURFACE_FOUND", "JUMP_MEASURED", "ENDED_EARLY"),
    }
)
"""Kinds of sentences that a time line is made of; `run explain` tells all."""
WARNING_LEVEL = 2


@dataclass(frozen=True, slots=True)
class Jumps:
    """Every jump that the tool made, also those out of a short, and the times between those of one cut, s.

    The times are NaN with fewer than two.
    """

    count: int
    shortest_s: float
    median_s: float
    longest_s: float


@dataclass(frozen=True, slots=True)
class Totals:
    """Sums over all sites; unknown values are NaN."""

    pulses: int
    ratios: dict[str, float]
    energy_j: float
    mrr_mm3_min: float
    wear_ratio_lin: float
    wear_ratio_vol: float


@dataclass(frozen=True, slots=True)
class RunSummary:
    """Everything that `run show` tells. `rows` are those of each table, `summary` is the result of the command.

    Times are those of the job: `earlier_time_s` of `time_s` passed in the runs that it goes on with, 0 without any.
    The pauses between them are left out; they were `pause_s`, NaN where nobody knows.
    `way_on` is the command that takes up the job; empty where there is nothing to take up.
    `est_depth_um` is how deep the hole is that was left without a result; NaN where there is none.
    """

    file: str
    size_bytes: int
    run_id: str
    parent_run: str
    title: str
    wanted: str
    command: tuple[str, ...]
    user: str
    start_time: str
    end_time: str
    status: str
    exit_code: int | None
    error_code: str
    recovery: str
    way_on: str
    simulated: bool
    seed: int | None
    time_s: float
    machining_time_s: float
    earlier_time_s: float
    pause_s: float
    sites: tuple[SiteNumbers, ...]
    est_depth_um: float
    est_depth_u95_um: float
    totals: Totals
    jumps: Jumps
    touches: tuple[dict[str, object], ...]
    moments: tuple[Sentence, ...]
    warnings: tuple[Sentence, ...]
    machine: dict[str, str]
    software: dict[str, str]
    profile: dict[str, object]
    overrides: tuple[str, ...]
    rows: dict[str, int]
    summary: dict[str, object] | None


def summary_of(opened: RunFile) -> RunSummary:
    """Read what is told of an open run file, also of one without an end."""
    from edmctl.cli.run.explain import events_of, sentences_of, wanted
    from edmctl.jobs.resume.way_on import command_to_go_on
    from edmctl.record.create import NO_EXIT_CODE
    from edmctl.record.events import error_code_of
    from edmctl.record.results import estimated_depth
    from edmctl.record.run_index import status_of
    from edmctl.report.numbers import numbers_of

    numbers, events = numbers_of(opened), events_of(opened)
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
        machining_time_s=numbers.total("machining_time_s"),
        earlier_time_s=_earlier_s(opened),
        pause_s=_pause_s(summary),
        sites=numbers.sites,
        est_depth_um=estimated.depth_um,
        est_depth_u95_um=estimated.depth_u95_um,
        totals=_totals(numbers),
        jumps=jumps_of(events),
        touches=tuple(_touches(opened)),
        moments=tuple(sentence for sentence in sentences if sentence.code in TIME_LINE),
        warnings=tuple(_warnings(events)),
        machine={
            name: opened.text(f"/entry/machine/{name}")
            for name in ("host", "serial", "firmware", "protocol", "calibration")
        },
        software=_software(opened),
        profile={"path": opened.text("/entry/profile/path"), "values": opened.profile_values()},
        overrides=tuple(opened.text("/entry/profile/overrides").splitlines()),
        rows=_rows(opened),
        summary=summary,
    )


def _software(opened: RunFile) -> dict[str, str]:
    names = {"edmctl": "version", "Python": "python", "h5py": "h5py", "HDF5": "hdf5"}
    return {name: opened.text(f"/entry/software/{source}") for name, source in names.items()}


def _time_s(opened: RunFile, summary: Mapping[str, object] | None, events: Sequence[FileEvent]) -> float:
    """How long the job took; of one without an end, to its last row."""
    told = (summary or {}).get("time_s")
    if isinstance(told, int | float):
        return float(told)
    servo = opened.rows("/entry/servo")
    last = opened.column("/entry/servo", "time", servo - 1, servo).tolist() if servo else []
    return _earlier_s(opened) + max([*last, *(event.time_s for event in events[-1:])], default=math.nan)


def _earlier_s(opened: RunFile) -> float:
    """Time of the job in the runs before; files of older versions do not tell."""
    earlier_s = opened.number("/entry/parent_time")
    return earlier_s if math.isfinite(earlier_s) else 0.0


def _pause_s(summary: Mapping[str, object] | None) -> float:
    told = (summary or {}).get("pause_s", 0.0)
    return float(told) if isinstance(told, int | float) else math.nan


def _totals(numbers: RunNumbers) -> Totals:
    pulses = numbers.total("pulses")
    return Totals(
        pulses=int(pulses) if math.isfinite(pulses) else 0,
        ratios={name: numbers.ratio(name) for name in ("open", "normal", "arc", "short")},
        energy_j=numbers.total("energy_j"),
        mrr_mm3_min=numbers.mrr_mm3_min,
        wear_ratio_lin=numbers.wear_ratio_lin,
        wear_ratio_vol=numbers.wear_ratio_vol,
    )


def jumps_of(events: Sequence[FileEvent]) -> Jumps:
    """Count the jumps, whatever asked for them, and the times from one to the next of the same cut."""
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
        return Jumps(count, math.nan, math.nan, math.nan)
    return Jumps(count, min(apart_s), median(apart_s), max(apart_s))


def _touches(opened: RunFile) -> list[dict[str, object]]:
    from edmctl.record.layout import TOUCHES
    from edmctl.report.export_tables import named

    names = {column.name: named(column) for column in TOUCHES.columns}
    found = []
    for row in opened.table(TOUCHES.path):
        values = {names[name]: row[name].item() for name in row.dtype.names if name in names}
        found.append(
            {key: v.decode(errors="replace") if isinstance(v, bytes) else v for key, v in values.items()}
        )
    return found


def _warnings(events: Sequence[FileEvent]) -> list[Sentence]:
    found = []
    for event in events:
        if event.level >= WARNING_LEVEL:
            hint = event.args.get("hint")
            text = f"{event.message} {hint}" if isinstance(hint, str) and hint else event.message
            found.append(Sentence(event.time_s, text, event.code))
    return found


def _rows(opened: RunFile) -> dict[str, int]:
    from edmctl.report.export_tables import TABLES

    return {name: opened.rows(table.path) for name, table in TABLES.items()}
