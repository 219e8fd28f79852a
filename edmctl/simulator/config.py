"""What stands on the virtual bench: tool, work, discharge constants, sensors. Nothing here ever reaches the host."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class DischargeConstants:
    """Constants of the per-pulse gap process; every value can be changed by the profile's `[sim]` table.

    Orders of magnitude follow Muralidhara et al. 2009 (few hundred µJ a pulse, a gap of a few µm); the
    values are fitted so that its holes (180/70 µm with copper, 240/10 µm with tungsten) come out.
    """

    discharge_v: float = 22.0  # plateau of a normal discharge
    arc_v: float = 17.0
    short_v: float = 1.0
    kappa_um3_per_uj: float = 0.0424  # work volume removed per energy
    scatter: float = 0.3  # sd of the logarithm of the crater volume
    gap_reference_um: float = 2.5  # gap of tau_reference_us at 40 V
    tau_reference_us: float = 60.0  # mean statistical ignition delay there
    gap_exponent: float = 4.0
    formative_us: float = 1.0
    roughness_um: float = 0.20
    debris_gap_factor: float = 1.5  # narrowing of the gap per debris fraction
    flush_time_s: float = 0.5  # debris clearance of a shallow 270 µm gap
    flush_depth_ratio: float = 0.7  # depth/diameter at which clearance takes twice as long
    arc_base: float = 0.01
    arc_debris: float = 3.0
    bridge_base: float = 0.02
    bridge_debris: float = 0.25
    bridge_gap_um: float = 1.5
    bridge_clear: float = 0.02
    side_base: float = 0.03
    side_debris: float = 0.6
    side_gap_um: float = 8.0


@dataclass(frozen=True, slots=True)
class SensorConstants:
    """Inductive displacement sensor, contact and stages. Standard deviations are of the unit-to-unit draw."""

    fitted: bool = True  # without a sensor its input reads noise about zero
    noise_um: float = 0.15  # rms of one 1 kHz sample
    gain_sd: float = 0.003  # calibration error
    nonlinearity_um: float = 0.1
    drift_sd_um_s: float = 1.0 / 600.0  # steady thermal drift
    walk_um: float = 0.008  # random walk, per square root of a second
    contact_sd_um: float = 0.10  # asperities: where continuity closes, touch by touch
    tilt_sd_mrad: float = 0.3
    stage_sd_um: float = 0.5  # 1 µm positional accuracy as ±2 sd
    rotary_sd_deg: float = 0.05


@dataclass(frozen=True, slots=True)
class BenchConfig:
    """One virtual bench: a tool over a work sheet."""

    tool_diameter_um: float = 270.0
    theta: float = 0.337  # volumetric wear of the tool relative to the work
    tool_label: str = "tool"
    tip_rounding_um: float = 0.0  # how far the edge of the tool lies behind its tip
    offset_um: float = 50.0  # gap at 0 V
    thickness_um: float = math.inf  # of the work; below it there is nothing
    cell_um: float = 5.0  # of the map of the work
    discharge: DischargeConstants = field(default_factory=DischargeConstants)
    sensors: SensorConstants = field(default_factory=SensorConstants)
    dielectric_flow_lpm: float = 1.2
    dielectric_temperature_c: float = 22.0
