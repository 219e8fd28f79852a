"""What stands on the virtual bench: tool, work, discharge constants, sensors. None of it reaches the host."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeVar

from edmctl.core.library import library
from edmctl.dataclasses import dataclass, field, fields, replace
from edmctl.process.erosion import ARC_V, BRIDGE_CLEAR, GAP_LAW, LAW, SHORT_V, ErosionLaw, GapLaw

if TYPE_CHECKING:
    import numpy as np

_Law = TypeVar("_Law", ErosionLaw, GapLaw)


@dataclass(frozen=True, slots=True)
class DischargeConstants:
    """Constants of the per-pulse gap process; every value can be changed by the profile's `[sim]` table.

    Orders of magnitude follow Muralidhara et al. 2009 (few hundred µJ a pulse, a gap of a few µm); the
    values are fitted so that its holes (180/70 µm with copper, 240/10 µm with tungsten) come out.
    """

    discharge_v: float = 22.0  # plateau of a normal discharge
    arc_v: float = ARC_V
    short_v: float = SHORT_V
    scatter: float = 0.3  # sd of the logarithm of the crater volume
    formative_us: float = 1.0
    roughness_um: float = 0.20  # sd of the surface's asperities at a usual pulse; grows as craters do
    bridge_clear: float = BRIDGE_CLEAR
    erosion: ErosionLaw = LAW
    gap: GapLaw = GAP_LAW


def drawn(book: DischargeConstants, spread: float, draw: np.random.Generator) -> DischargeConstants:
    """Draw the process of one machine: every constant of the laws is off by some of `spread`, relative sd."""

    def off(law: _Law) -> _Law:
        exp, normal = library().exp, draw.standard_normal
        return replace(law, **{f.name: getattr(law, f.name) * exp(spread * normal()) for f in fields(law)})

    return replace(book, erosion=off(book.erosion), gap=off(book.gap))


@dataclass(frozen=True, slots=True)
class SensorConstants:
    """Inductive displacement sensor, contact and stages. Standard deviations are of the unit-to-unit draw.

    A job takes them from the setup, so that a machine is drawn as the setup states it.
    """

    fitted: bool = True  # without a sensor its input reads noise about zero
    noise_um: float = 0.15  # rms of one 1 kHz sample
    gain_sd: float = 0.003  # calibration error
    nonlinearity_um: float = 0.2  # of its characteristic, a cubic over the stroke
    drift_sd_um_s: float = 1.0 / 600.0  # steady thermal drift
    machine_drift_sd_um_s: float = 0.0  # the same of the work against the tool, which no sensor sees
    walk_um: float = 0.008  # random walk, per square root of a second
    contact_sd_um: float = 0.10  # asperities: where continuity closes, touch by touch
    tilt_sd_mrad: float = 0.3
    stage_sd_um: float = 0.5  # 1 µm positional accuracy as ±2 sd
    rotary_sd_deg: float = 0.05


FIRMWARE, FIRMWARE_FLOAT, STM32 = CONTROLLERS = ("firmware", "firmware-float", "stm32")
"""Controllers of a bench: in C; in C with a board's arithmetic; a board's image on an emulated chip."""


@dataclass(frozen=True, slots=True)
class BenchConfig:
    """One virtual bench: a tool over a work sheet."""

    tool_diameter_um: float = 270.0
    work_removal: float = 1.0  # erosion of the work over that of copper
    tool_wear: float = 1.0  # of the tool
    tool_negative: bool = True
    spread: float = 0.0  # relative sd of what a seed draws around these figures
    tool_label: str = "tool"
    tip_rounding_um: float = 0.0  # how far the edge of the tool lies behind its tip
    offset_um: float = 50.0  # gap at 0 V
    thickness_um: float = math.inf  # of the work; below it there is nothing
    cell_um: float = 5.0  # of the map of the work
    discharge: DischargeConstants = field(default_factory=DischargeConstants)
    sensors: SensorConstants = field(default_factory=SensorConstants)
    controller: str = FIRMWARE  # what drives it: one of CONTROLLERS
    dielectric_flow_lpm: float = 1.2
    dielectric_temperature_c: float = 22.0
