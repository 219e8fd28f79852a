"""Run files whose every number is known beforehand, to the last sample of the servo."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from edmctl.record.rows import EventLevel, EventRow, RunEvent, ServoBlock, SlowRow, TouchRow, profile_leaves
from edmctl.record.writer import RunWriter
from edmctl.results.telemetry import PulseBlockBatch, PulseTrain
from tests.record.samples import a_meta, a_site_row

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from edmctl.results.job import SiteResult

    Array = NDArray[np.float64]

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
    return RunWriter.create(folder / name, replace(a_meta(), profile_leaves=leaves))


def cut(writer: RunWriter, start_s: float, from_um: float = 0.0, to_um: float = 20.0) -> None:
    """Rows of the supervisor of a cut of `CUT_S`, whose depth grows evenly; wear is a tenth of it."""
    for k in range(int(10 * CUT_S)):
        depth_um = from_um + (to_um - from_um) * k / (10 * CUT_S - 1)
        writer.append(
            SlowRow(
                start_s + 0.1 * k, 1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0,
                depth_um=depth_um, depth_u95_um=0.5, wear_um=0.1 * depth_um, jump_period_s=5.0, power_w=0.1,
            )
        )  # fmt: skip


def measured(
    writer: RunWriter, time_s: float, depth_um: float, told: RunEvent = RunEvent.SITE_MEASURED
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


MACHINING, JUMP, TOUCH, IDLE = 4, 5, 6, 1


@dataclass(frozen=True)
class Signals:
    """Samples of the servo, shape (n,), at 100 Hz from 0 s on."""

    gap_v: Array
    sensor_um: Array
    model_um: Array
    state: NDArray[np.uint8]

    @property
    def time_s(self) -> Array:
        return 0.01 * np.arange(float(len(self.state)))

    def block(self) -> ServoBlock:
        n = len(self.state)
        return ServoBlock(
            self.time_s, self.sensor_um / 3.0, self.sensor_um, self.model_um, self.gap_v, self.gap_v / 12.0,
            np.zeros(n), np.zeros(n, np.int8), self.state,
        )  # fmt: skip


def a_cut(seconds: float, swing_hz: float = 6.25) -> Signals:
    """A cut from 50 µm on at 1 µm/s with a swing about 9.6 V; the estimate is 2 µm too long."""
    time_s = 0.01 * np.arange(round(100 * seconds))
    swing = np.sin(2.0 * np.pi * swing_hz * time_s)
    noise = np.random.default_rng(1).normal(0.0, 0.1, len(time_s))
    sensor_um = 50.0 + time_s + 0.05 * swing
    state = np.full(len(time_s), MACHINING, np.uint8)
    return Signals(9.6 + 0.5 * swing + noise, sensor_um, sensor_um + 2.0, state)


def finished(
    folder: Path, *rows: Any, profile: dict[str, dict[str, object]] | None = None, name: str = "run.h5"
) -> Path:
    """Write a run of rows: of `Signals`, results, touches and others."""
    writer = new_run(folder, profile, name)
    for row in rows:
        writer.append(row.block() if isinstance(row, Signals) else row)
    return writer.finish("done", 0)


def a_touch(kind: str, time_s: float = 1.0, sensor_um: float = 50.0, site: str = "A1") -> TouchRow:
    """A reading whose estimate is 2 µm below the sensor, 48 µm without one."""
    model_um = sensor_um - 2.0 if math.isfinite(sensor_um) else 48.0
    return TouchRow(time_s, kind, site, 16.0, sensor_um, model_um, 3, 0.1, 0.0, 1.0)


def sites(count: int) -> list[SiteResult]:
    """Results of so many holes."""
    return [replace(a_site_row(), name=f"A{k + 1}") for k in range(count)]
