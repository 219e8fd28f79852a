"""Results as the renderers take them, made up; what a test is about is changed by name."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, cast

from edmctl.actuator.acceptance import Noise
from edmctl.actuator.validation import Bands, ErrorFigures
from edmctl.jobs.calibrate import CalibrationReport, FileFigures, LeverFound
from edmctl.labels import Basis, Verdict
from edmctl.results.job import ChannelResult, ChannelTruth, JobResult, SiteResult, SiteTruth
from edmctl.results.progress import Phase, Progress
from edmctl.results.telemetry import PulseShares

RATIOS = PulseShares(0.5, 0.4, 0.02, 0.08)
TRUTH = SiteTruth(180.05, 70.11)
CHANNEL_TRUTH = ChannelTruth(24.7, 0.81, 0.9, 40.0)


def made_state(**changes: Any) -> Progress:
    """The state of a job whose tool sparks."""
    known = Progress(
        phase=Phase.APPROACHING,
        time_s=125.0,
        gap_v=9.4,
        reference_v=9.6,
        ratios=RATIOS,
        depth_um=42.25,
        depth_target_um=180.0,
        displacement_um=110.0,
        time_left_s=480.0,
    )
    return replace(known, **changes)


def made_site(**changes: Any) -> SiteResult:
    """A hole that was touched."""
    known = SiteResult(
        name="site 1",
        x_um=0.0,
        y_um=0.0,
        theta_deg=0.0,
        depth_um=180.21,
        depth_u95_um=0.62,
        wear_um=70.03,
        wear_u95_um=0.55,
        feed_um=250.24,
        z1_um=53.1,
        z2_um=303.34,
        z3_um=123.13,
        face_um=0.0,
        measuring_stops=3,
        estimated_um=0.0,
        depth_model_um=180.94,
        wear_model_um=70.41,
        depth_model_u95_um=1.6,
        wear_model_u95_um=2.1,
        zero_drift_um=0.0,
        feed_model_error_max_um=math.nan,
        feed_model_error_rms_um=math.nan,
        feed_model_error_max_pct=math.nan,
        feed_model_error_rms_pct=math.nan,
        machining_time_s=902.4,
        cuts=3,
        pulses=2_010_334,
        ratios=RATIOS,
        gap_ratio_mean=0.8,
        working_gap_um=3.0,
        energy_j=300.0,
        wear_ratio_lin=0.389,
        wear_ratio_vol=0.3,
        mrr_mm3_min=8e-4,
        verdict=Verdict.SHOWN,
    )
    return replace(known, **changes)


def made_channel(**changes: Any) -> ChannelResult:
    """A channel that was touched."""
    known = ChannelResult(
        name="spiral",
        length_um=8123.0,
        width_um=160.0,
        layers=12,
        passes=19,
        depth_um=25.1,
        depth_u95_um=0.6,
        floor_sd_um=0.4,
        wear_um=41.2,
        wear_u95_um=2.0,
        feed_um=66.3,
        z1_um=53.1,
        z3_um=94.3,
        machining_time_s=2400.0,
        pulses=5_000_000,
        ratios=RATIOS,
        energy_j=600.0,
        working_gap_um=3.0,
        measuring_stops=4,
        floor=(),
        depth_basis=Basis.TOUCHED,
        wear_basis=Basis.TOUCHED,
        verdict=Verdict.SHOWN,
    )
    return replace(known, **changes)


def made_job(**changes: Any) -> JobResult:
    """A job of one hole."""
    return replace(JobResult((made_site(),), 1141.0, 902.4, 238.6, 70.03), **changes)


def made_figures(**changes: Any) -> ErrorFigures:
    """Errors of a model."""
    return replace(ErrorFigures(2.26, 0.438, 0.5, 0.097, 451.3), **changes)


def made_file(name: str, max_um: float = 2.26) -> FileFigures:
    """Errors on a validation file."""
    return FileFigures(name, 0.0, max_um, 0.438, 0.5, 0.097, 451.3, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Model:
    """What tables show of an actuator model."""

    stroke_um: float = 446.25
    delay_s: float = 0.0006
    lag_s: float = 0.0
    low_v: float = 0.0
    high_v: float = 150.0


@dataclass(frozen=True, slots=True)
class Found:
    """What tables show of an identification."""

    model: Model = field(default_factory=Model)
    bands: Bands = field(default_factory=lambda: Bands(0.1, 0.4, 2.975, 0.001, 0.125, 0.001, 0.028, 0.0005))
    problems: tuple[str, ...] = ()
    restrictions: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    noise: Noise = field(default_factory=lambda: Noise(0.15, 0.7))
    train: ErrorFigures = field(default_factory=lambda: made_figures())
    held_out_model: ErrorFigures = field(default_factory=lambda: made_figures(max_um=1.9, rms_um=0.41))


BASELINES = {
    "line": ErrorFigures(44.07, 16.39, 9.77, 3.63, 451.3),
    "maxwell": ErrorFigures(26.29, 4.92, 5.83, 1.09, 451.3),
}


@dataclass(frozen=True, slots=True)
class _Findings:
    identification: Found = field(default_factory=Found)
    held_out: ErrorFigures = field(default_factory=made_figures)
    held_out_baselines: dict[str, ErrorFigures] = field(default_factory=lambda: BASELINES)
    validated: ErrorFigures | None = None
    validated_baselines: dict[str, ErrorFigures] = field(default_factory=dict)
    files: tuple[FileFigures, ...] = ()
    refit: tuple[str, ...] = ("zero",)


def made_findings(**changes: Any) -> CalibrationReport:
    """What tables show of a calibration."""
    return cast("CalibrationReport", replace(_Findings(), **changes))


LEVER = LeverFound(18.02, 0.05, 0.0, 100)


class HandClock:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s
