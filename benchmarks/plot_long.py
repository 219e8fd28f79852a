"""How long figures of a long run take: `python benchmarks/plot_long.py [--hours 8] [--servo-hz 1000] [--kind gap]`.

Machines a short hole on the virtual machine with every pulse logged, writes its rows again and again into one
file until that is so long, and draws each kind from it with `edmctl run plot`, a process each. Prints wall time,
processor time, largest memory of the process (no less than that of this one), and size of the figure.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl.record.layout import (
    EVENTS,
    PULSE_BLOCKS,
    PULSES,
    RESULTS,
    SEGMENTS,
    SERVO,
    SLOW,
    TOUCHES,
    Column,
    Table,
)
from edmctl.record.reader import RunFile, open_run
from edmctl.record.rows import EventLevel, EventRow, ServoBlock, SlowRow, Summary, TouchRow
from edmctl.record.run_meta import Leaf, RunMeta
from edmctl.record.writer import RunWriter
from edmctl.report.kinds import NAMES
from edmctl.results.job import SiteResult, site_result_of
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

COLUMNS = 10
"""Holes in a row of the array that the repetitions are."""
PITCH_UM = 500.0


def a_short_run(folder: Path, servo_hz: float) -> Path:
    """Machine one hole, with every pulse."""
    command = (
        *(sys.executable, "-m", "edmctl", "machine", "--profile", "cu270", "--seed", "1", "--quiet"),
        *("--set", "target.depth_um=60", "--set", 'log.pulses="full"', "--set", f"log.servo_hz={servo_hz:g}"),
        *("--out", str(folder), "--run-id", "short"),
    )
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder / "short.h5"


def repeated(short: RunFile, path: Path, hours: float) -> int:
    """Write the rows of the run until `hours` are full; return how often."""
    values = {key: value for key, value in short.profile_values().items() if key != "NX_class"}
    writer = RunWriter.create(
        path,
        RunMeta(
            run_id="long",
            title="a long run",
            start_time=short.text("/entry/start_time"),
            command=("edmctl", "machine"),
            host="host",
            simulated=True,
            seed=1,
            profile_text="",
            profile_sha256="",
            edmctl_version=short.text("/entry/software/version"),
            profile_leaves=tuple(
                Leaf(key, value, str(values.get(f"{key}_units", "")))
                for key, value in values.items()
                if not key.endswith("_units")
            ),
            work_material="Cu",
            tool_material="Cu",
            tool_diameter_um=270.0,
        ),
    )
    groups = {
        table.path: short.columns(table.path) for table in (SERVO, SLOW, PULSE_BLOCKS, PULSES, SEGMENTS)
    }
    length_s = float(groups[SERVO.path]["time"][-1]) + 1.0
    times = int(hours * 3600.0 / length_s) + 1
    for number in range(times):
        write_once(writer, short, groups, number, number * length_s)
    writer.append(Summary(f'{{"time_s": {times * length_s}}}'))
    writer.finish("done", 0)
    return times


def write_once(
    writer: RunWriter, short: RunFile, groups: dict[str, dict[str, NDArray[Any]]], number: int, later_s: float
) -> None:
    """Write the rows of the run once, `later_s` later and as hole `number`."""
    writer.append(ServoBlock(**fields(SERVO, groups[SERVO.path], later_s)))
    slow = fields(SLOW, groups[SLOW.path], later_s)
    for row in range(len(slow["time_s"])):
        writer.append(SlowRow(**{name: column[row].item() for name, column in slow.items()}))
    writer.append(PulseBlockBatch(**fields(PULSE_BLOCKS, groups[PULSE_BLOCKS.path], later_s)))
    pulses, segments = fields(PULSES, groups[PULSES.path], 0.0), groups[SEGMENTS.path]
    bounds = [*segments["first_row"].astype(int), len(pulses["pulse_class"])]
    for i, (first, stop) in enumerate(pairwise(bounds)):
        first_pulse = int(segments["first_pulse"][i]) + 10_000_000 * number
        start_s, period_s = float(segments["t0"][i]) + later_s, float(segments["period"][i])
        parts = {name: column[first:stop] for name, column in pulses.items()}
        writer.append(PulseTrain(first_pulse, start_s, period_s, **parts))
    for row in short.table(EVENTS.path):
        args = row["args"].decode()
        writer.append(
            EventRow(
                float(row["time"]) + later_s,
                int(row["code"]),
                EventLevel(int(row["level"])),
                row["message"].decode(),
                parsed(args),
            )
        )
    site = f"hole-{number + 1}"
    for row in short.table(TOUCHES.path):
        touch = {**entries(TOUCHES, row), "site": site}
        touch["time_s"] += later_s
        writer.append(TouchRow(**touch))
    for row in short.table(RESULTS.path):
        place = {"x_um": PITCH_UM * (number % COLUMNS), "y_um": PITCH_UM * (number // COLUMNS)}
        writer.append(site_of(entries(RESULTS, row) | place | {"name": site}))


def site_of(row: dict[str, Any]) -> SiteResult:
    """The result of a site out of a row of the results, which has not all of it."""
    names = {field.name for field in dataclasses.fields(SiteResult)}
    ratios = {name: row[f"ratios.{name}"] for name in ("open", "normal", "arc", "short")}
    unknown = dict.fromkeys(("theta_deg", "gap_ratio_mean", "working_gap_um"), math.nan)
    known = {name: value for name, value in row.items() if name in names}
    return site_result_of({**unknown, **known, "ratios": ratios})


def parsed(args: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(args or "{}")
    return found


def fields(table: Table, columns: dict[str, NDArray[Any]], later_s: float) -> dict[str, NDArray[Any]]:
    """Columns under the names of the rows' fields."""
    found = {column.field: columns[column.name] for column in table.columns}
    if "time_s" in found:
        found["time_s"] = found["time_s"] + later_s
    return found


def entries(table: Table, row: np.void) -> dict[str, Any]:
    """One row of a compound table under the names of the row's fields."""

    def plain(column: Column) -> Any:
        value = row[column.name].item()
        return value.decode() if isinstance(value, bytes) else value

    return {column.field: plain(column) for column in table.columns}


def drawn(path: Path, kind: str, folder: Path) -> str:
    """Draw one kind in a process of its own; time, memory and size."""
    command = (sys.executable, "-m", "edmctl", "run", "plot", str(path), "--kind", kind, "--out", str(folder))
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert process.stderr
    said = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    cpu_s = usage.ru_utime + usage.ru_stime
    took = f"{time.perf_counter() - start:5.1f} s   {cpu_s:5.1f} s   {usage.ru_maxrss / 1024:5.0f} MB"
    made = list(folder.glob(f"*-{kind}.*"))
    return f"{kind:<13} {took}   " + (
        f"{made[0].stat().st_size / 1e6:.2f} MB" if made else said.split("\n")[0][:90]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=8.0)
    parser.add_argument("--servo-hz", type=float, action="append")
    parser.add_argument("--kind", action="append", choices=NAMES)
    chosen = parser.parse_args()
    for servo_hz in chosen.servo_hz or (100.0, 1000.0):
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            path = folder / "long.h5"
            start = time.perf_counter()
            with open_run(a_short_run(folder, servo_hz)) as short:
                times = repeated(short, path, chosen.hours)
            with open_run(path) as run:
                rows = f"{run.rows(SERVO.path):,} servo rows, {run.rows(PULSES.path):,} pulses, {times} holes"
            took_s = time.perf_counter() - start
            print(
                f"{chosen.hours:g} h at {servo_hz:g} Hz: {rows}, {path.stat().st_size / 1e6:.0f} MB ({took_s:.0f} s)"
            )
            for kind in chosen.kind or NAMES:
                print(drawn(path, kind, folder), flush=True)


if __name__ == "__main__":
    main()
