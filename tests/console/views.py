"""Plain values in the shapes that the renderers take."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Ratios:
    open: float = 0.5
    normal: float = 0.4
    arc: float = 0.02
    short: float = 0.08


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


@dataclass(frozen=True, slots=True)
class Truth:
    depth_um: float = 180.05
    wear_um: float = 70.11


@dataclass(frozen=True, slots=True)
class Site:
    name: str = "site 1"
    depth_um: float = 180.21
    depth_u95_um: float = 0.62
    wear_um: float = 70.03
    wear_u95_um: float = 0.55
    feed_um: float = 250.24
    z1_um: float = 53.1
    z2_um: float = 303.34
    z3_um: float = 123.13
    depth_model_um: float = 180.94
    wear_model_um: float = 70.41
    machining_time_s: float = 902.4
    cuts: int = 3
    pulses: int = 2010334
    ratios: Ratios = field(default_factory=Ratios)


@dataclass(frozen=True, slots=True)
class Job:
    sites: tuple[Site, ...] = (Site(),)
    time_s: float = 1141.0
    tool_wear_total_um: float = 70.03
