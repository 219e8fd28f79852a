"""Run files whose every number is known beforehand."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record.events import RecordedCode
from edmctl.record.rows import EventLevel, EventRow, SlowRow
from edmctl.record.run_meta import profile_leaves
from edmctl.record.writer import RunWriter
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain
from tests.record.samples import a_meta

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

PROFILE = {
    "target": {"kind": "depth", "depth_um": 20.0, "tolerance_um": 2.0},
    "tool": {"diameter_um": 100.0},
    "work": {"side_gap_um": 5.0},
    "pulse": {
        "current_a": 0.1,
        "open_voltage_v": 40.0,
        "discharge_voltage_v": 20.0,
        "duty": 0.3,
        "frequency_hz": 2000.0,
    },
}
HZ = 2000.0
CUT_S = 20.0
ON_TIME_US = 150.0


def new_run(
    folder: Path, profile: dict[str, dict[str, object]] | None = None, name: str = "run.h5"
) -> RunWriter:
    """Create a run file of `PROFILE`, with tables of `profile` in the place of its own."""
    leaves = profile_leaves({**PROFILE, **(profile or {})})
    return RunWriter.create(folder / name, replace(a_meta(), profile_leaves=leaves), monotonic_s=lambda: 0.0)


def cut(writer: RunWriter, start_s: float, from_um: float = 0.0, to_um: float = 20.0) -> None:
    """Rows of the supervisor of a cut of `CUT_S`, whose depth grows evenly; wear is a tenth of it."""
    for k in range(int(10 * CUT_S)):
        depth_um = from_um + (to_um - from_um) * k / (10 * CUT_S - 1)
        writer.append(
            SlowRow(
                start_s + 0.1 * k, 1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0, depth_um, 0.1 * depth_um, 0.1,
                jump_period_s=5.0, depth_u95_um=0.5,
            )
        )  # fmt: skip


def measured(
    writer: RunWriter, time_s: float, depth_um: float, told: RecordedCode = RecordedCode.SITE_MEASURED
) -> None:
    """Tell a depth, with 0.4 µm as half its 95 % interval."""
    values = {"depth_um": depth_um, "wear_um": 0.1 * depth_um, "depth_u95_um": 0.4, "wear_u95_um": 0.1}
    writer.append(EventRow(time_s, told, EventLevel.INFO, "Depth.", values))


def pulses(
    writer: RunWriter,
    start_s: float,
    kinds: NDArray[np.integer],
    delay_us: NDArray[np.floating],
    arc_v: float = 20.0,
) -> None:
    """Pulses of known class and delay at `HZ`; their plateau is 20 V, that of arcs `arc_v`."""
    discharge_us = np.where(kinds == 0, 0.0, ON_TIME_US - delay_us)
    plateau_v = np.where(kinds == 2, arc_v, 20.0)
    first = round(start_s * HZ)
    writer.append(PulseTrain(first, start_s, 1.0 / HZ, kinds, delay_us, discharge_us, plateau_v))


def blocks(
    writer: RunWriter, start_s: float, counts: tuple[int, int, int, int], energy_uj: float, rows: int
) -> None:
    """Blocks of 10 ms that are all alike."""
    opens, normals, arcs, shorts = (np.full(rows, count) for count in counts)
    time_s = start_s + 0.01 * np.arange(rows)
    writer.append(
        PulseBlockBatch(time_s, opens, normals, arcs, shorts, np.zeros(rows), np.full(rows, energy_uj))
    )
