"""Rows and provenance of a made-up run."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from edmctl.record.rows import (
    Recorder,
    Row,
    RunMeta,
    ServoBlock,
    SlowRow,
    SourceText,
    Summary,
    TouchRow,
    profile_leaves,
)
from edmctl.record.writer import RunWriter
from edmctl.results.job import SiteResult
from edmctl.results.telemetry import PulseBlockBatch, PulseShares, PulseTrain, TelemetryBlock

PROFILE = {"servo": {"reference": 0.8, "forward_um_s": 5.0}, "meta": {"name": "cu270"}, "jump": {"on": True}}


def a_meta() -> RunMeta:
    return RunMeta(
        run_id="run-1",
        title="cu270",
        start_time="2025-01-01T12:00:00+01:00",
        command=("edmctl", "machine"),
        host="bench",
        simulated=True,
        seed=7,
        profile_text="# a comment\n[servo]\nreference = 0.80\n",
        profile_sha256="ab" * 32,
        sim_sha256="cd" * 32,
        profile_parents=(SourceText("/p/base.toml", "# parent\n[servo]\nreference = 0.75\n"),),
        setup_toml="[sensor]\nnoise_um = 0.15\n",
        edmctl_version="0.1.0",
        profile_leaves=profile_leaves(PROFILE),
        profile_overrides=("servo.reference = 0.82 (was 0.80, --set)",),
        work_thickness_um=1000.0,
        tool_diameter_um=270.0,
    )


def servo_block(first: int, rows: int) -> ServoBlock:
    """Samples whose every column follows from their number."""
    k = np.arange(first, first + rows)
    return ServoBlock(0.01 * k, k + 0.1, k + 0.2, k + 0.3, k + 0.4, k + 0.5, k + 0.6, k % 3 - 1, k % 10)


def slow_row(k: int) -> SlowRow:
    """One row of the supervisor's view."""
    return SlowRow(
        0.1 * k, 1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0, depth_um=0.1 * k, wear_um=0.05 * k, power_w=0.1
    )


def train(first_pulse: int, pulses: int, start_s: float, period_s: float = 4e-4) -> PulseTrain:
    k = np.arange(first_pulse, first_pulse + pulses)
    return PulseTrain(first_pulse, start_s, period_s, k % 4, 0.1 * k, 0.2 * k, np.full(pulses, 22.5))


def black_box(rows: int) -> TelemetryBlock:
    """Samples of a black box whose every column follows from their number."""
    k, x = np.arange(rows), np.arange(rows, dtype=np.float64)
    return TelemetryBlock(
        0.001 * x, x + 0.2, x + 0.1, x + 0.3, x + 0.4, k % 2, k % 3, k % 4, k % 5, k % 10, k % 32, 0
    )


def a_site_row() -> SiteResult:
    """The result at one site."""
    return SiteResult(
        name="A1", x_um=0.0, y_um=1500.0, theta_deg=0.0,
        depth_um=180.0, depth_u95_um=0.9, wear_um=70.0, wear_u95_um=1.1, feed_um=250.0,
        z1_um=50.0, z2_um=300.0, z3_um=120.0, face_um=0.0, measuring_stops=3, estimated_um=0.0,
        depth_model_um=178.0, wear_model_um=69.0, zero_drift_um=math.nan,
        feed_model_error_max_um=math.nan, feed_model_error_rms_um=math.nan,
        feed_model_error_max_pct=math.nan, feed_model_error_rms_pct=math.nan,
        machining_time_s=870.0, cuts=3, pulses=2_000_000, ratios=PulseShares(0.2, 0.7, 0.1, 0.0),
        gap_ratio_mean=0.8, working_gap_um=3.4, energy_j=610.0,
        wear_ratio_lin=0.39, wear_ratio_vol=0.34, mrr_mm3_min=0.7,
    )  # fmt: skip


def fill(writer: Recorder, rows: int = 10_000, block: int = 100) -> None:
    """Everything that a run may hold."""
    for first in range(0, rows, block):
        writer.append(servo_block(first, block))
    for k in range(30):
        writer.append(slow_row(k))
    counts = np.array([5, 6])
    writer.append(
        PulseBlockBatch(np.array([0.0, 0.01]), counts, counts, counts, counts, counts * 1.0, counts * 2.0)
    )
    writer.append(train(0, 300, 0.0))
    writer.append(black_box(2048))
    writer.append(a_touch())
    writer.append(a_site_row())
    writer.append(Summary('{"ok": true}'))


def a_touch(time_s: float = 1.0) -> TouchRow:
    """An accepted reading of the pad."""
    return TouchRow(time_s, "Z1", "A1", 20.0, 50.0, 49.0, 3, 0.3, 0.0, 1.0)


def finished(path: Path, *rows: Row, meta: RunMeta | None = None, end: tuple[str, int] = ("done", 0)) -> Path:
    """A run file with these rows, which has come to its end."""
    writer = RunWriter.create(path, meta or a_meta())
    for row in rows:
        writer.append(row)
    return writer.finish(*end)
