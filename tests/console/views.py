"""Plain values in the shapes that the renderers take."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Ratios:
    open: float = 0.5
    normal: float = 0.4
    arc: float = 0.02
    short: float = 0.08


@dataclass(frozen=True, slots=True)
class Extremes:
    time_s: float
    gap_low_v: float = math.nan
    gap_high_v: float = math.nan
    displacement_low_um: float = math.nan
    displacement_high_um: float = math.nan


@dataclass(frozen=True, slots=True)
class State:
    phase: str = "cut 1"
    time_s: float = 125.0
    gap_v: float = 9.4
    reference_v: float = 9.6
    ratios: Ratios = field(default_factory=Ratios)
    depth_um: float = 42.25
    depth_target_um: float = 180.0
    displacement_um: float = 110.0
    time_left_s: float = 480.0
    depth_u95_um: float = math.nan
    site: str = ""
    step: str = ""
    feed_um: float = math.nan
    feed_target_um: float = math.nan
    feed_um_s: float = math.nan
    wear_um: float = math.nan
    wear_u95_um: float = math.nan
    gap_low_v: float = math.nan
    gap_high_v: float = math.nan
    displacement_low_um: float = math.nan
    displacement_high_um: float = math.nan
    past: tuple[Extremes, ...] = ()
    jumps: int = 0
    jump_period_s: float = math.nan
    last_jump_s: float = math.nan
    sites_done: int = 0
    sites_total: int = 0
    warning: str = ""
    warned_s: float = math.nan


@dataclass(frozen=True, slots=True)
class Truth:
    depth_um: float = 180.05
    wear_um: float = 70.11


@dataclass(frozen=True, slots=True)
class Site:
    name: str = "site 1"
    depth_basis: str = "touched"
    wear_basis: str = "touched"
    verdict: str | None = "shown"
    depth_um: float = 180.21
    depth_u95_um: float = 0.62
    wear_um: float = 70.03
    wear_u95_um: float = 0.55
    feed_um: float = 250.24
    z1_um: float = 53.1
    z2_um: float = 303.34
    z3_um: float = 123.13
    face_um: float = 0.0
    measuring_stops: int = 3
    estimated_um: float = 0.0
    through: bool = False
    depth_model_um: float = 180.94
    wear_model_um: float = 70.41
    machining_time_s: float = 902.4
    cuts: int = 3
    pulses: int = 2010334
    ratios: Ratios = field(default_factory=Ratios)


@dataclass(frozen=True, slots=True)
class ChannelTruth:
    depth_um: float = 24.7
    floor_sd_um: float = 0.81
    wear_um: float = 40.0


@dataclass(frozen=True, slots=True)
class Channel:
    name: str = "spiral"
    depth_basis: str = "touched"
    wear_basis: str = "touched"
    verdict: str | None = "shown"
    length_um: float = 8123.0
    layers: int = 12
    passes: int = 19
    depth_um: float = 25.1
    depth_u95_um: float = 0.6
    floor_sd_um: float = 0.4
    wear_um: float = 41.2
    wear_u95_um: float = 2.0
    machining_time_s: float = 2400.0
    pulses: int = 5_000_000
    ratios: Ratios = field(default_factory=Ratios)


@dataclass(frozen=True, slots=True)
class Job:
    sites: tuple[Site, ...] = (Site(),)
    channel: Channel | None = None
    time_s: float = 1141.0
    tool_wear_total_um: float = 70.03
    earlier_time_s: float = 0.0
    pause_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Figures:
    max_um: float = 2.26
    rms_um: float = 0.438
    max_pct: float = 0.5
    rms_pct: float = 0.097
    range_um: float = 451.3
    name: str = ""


@dataclass(frozen=True, slots=True)
class Bands:
    displacement_sd_um: float = 0.1
    displacement_sd_max_um: float = 0.4
    gain_um_per_v: float = 2.975
    gain_sd_um_per_v: float = 0.001
    loop_width: float = 0.125
    loop_width_sd: float = 0.001
    gamma_per_decade: float = 0.028
    gamma_sd_per_decade: float = 0.0005


@dataclass(frozen=True, slots=True)
class Model:
    stroke_um: float = 446.25
    delay_s: float = 0.0006
    low_v: float = 0.0
    high_v: float = 150.0


@dataclass(frozen=True, slots=True)
class Found:
    model: Model = field(default_factory=Model)
    bands: Bands = field(default_factory=Bands)
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


BASELINES = {"line": Figures(44.07, 16.39, 9.77, 3.63), "maxwell": Figures(26.29, 4.92, 5.83, 1.09)}


@dataclass(frozen=True, slots=True)
class Findings:
    identification: Found = field(default_factory=Found)
    train: Figures = field(default_factory=Figures)
    held_out: Figures = field(default_factory=Figures)
    held_out_baselines: dict[str, Figures] = field(default_factory=lambda: BASELINES)
    validated: Figures | None = None
    validated_baselines: dict[str, Figures] = field(default_factory=dict)
    files: tuple[Figures, ...] = ()
    refit: tuple[str, ...] = ("zero",)


@dataclass(frozen=True, slots=True)
class Lever:
    factor: float = 18.02
    u95: float = 0.05


@dataclass(frozen=True, slots=True)
class Leg:
    u_v: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Plan:
    legs: tuple[Leg, ...] = (Leg(150.0, 2.0), Leg(0.0, 0.5))
    high_v: float = 150.0
    duration_s: float = 62.0
    samples: int = 12400
