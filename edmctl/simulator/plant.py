"""The machine's body: actuator, gap, work, stages, sensors. Its truth stays here; the controller reads sensors.

The actuator is deliberately richer than any estimator of this project: forty play operators on thresholds of no
one's grid, a tanh envelope on their sum, twelve creep time constants, an amplifier's lag and an output-side mode
(class of Kuhnen's modified Prandtl-Ishlinskii operator with linear creep). It is scaled to the 445 µm at 150 V
of Muralidhara et al. 2009, §2.1.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmctl.simulator import kernel as k
from edmctl.simulator.random_blocks import BLOCK as BLOCK
from edmctl.simulator.random_blocks import RandomBlocks

if TYPE_CHECKING:
    from edmctl.simulator.config import BenchConfig

Floats = NDArray[np.float64]

PLAYS = 40
PLAY_SPAN_V = 62.0
REVERSIBLE_SHARE = 0.48
PLAY_DENSITY_V = 26.0  # e-folding of the weights over the threshold
GAIN_UM_PER_V = 2.70  # sum of the weights: 445 µm peak to peak from 0 to 150 V in 100 s
CREEP_TERMS = 12
CREEP_FIRST_S = 0.0063
CREEP_RATIO = 3.17
CREEP_PER_DECADE = 0.030
ENVELOPE_UM, ENVELOPE_CENTRE_UM, ENVELOPE_WIDTH_UM = 22.0, 190.0, 120.0
AMPLIFIER_LAG_S = 0.002
MODE_HZ, MODE_DAMPING = 320.0, 0.04  # loaded output-side resonance [assumed]
CONTACT_COMPLIANCE = (
    0.1  # travel of the tool end into the work per µm of free travel beyond contact [assumed]
)
EDGE_X_UM = -2000.0  # the work begins here; the parking place lies beyond
PARK_X_UM = -5000.0
CLEAR_UM = 1e6

REFERENCE_V = 40.0  # open voltage at which gap_reference_um holds; the gap grows in proportion
FLUSH_DIAMETER_UM = 270.0  # tool diameter at which flush_time_s holds; it grows with the square

SERIAL_LENGTH = 12  # bytes in the reply to HELLO


@dataclass(slots=True)
class Hole:
    """A hole in the work: where its axis is, how deep it is."""

    x_um: float
    y_um: float
    depth_um: float


class Plant:
    """State and parameters of the body; the kernel advances them. Same config and seed, same machine."""

    def __init__(self, config: BenchConfig, seed: int) -> None:
        build_seed, run_seed, stage_seed = np.random.SeedSequence(seed).spawn(3)
        build = np.random.default_rng(build_seed)
        self.config = config
        self.serial = serial_number(seed)
        self.par = np.zeros(k.PAR_SIZE)
        self.st = np.zeros(k.ST_SIZE)
        self.ist = np.zeros(k.IST_SIZE, dtype=np.int64)
        self.ist[k.TLM_NEXT] = -1
        self.random = RandomBlocks(run_seed, config.discharge.scatter)
        self._stage_noise = np.random.default_rng(stage_seed)
        self._tilt_mrad = config.sensors.tilt_sd_mrad * build.standard_normal(2)
        self._offset_um = config.offset_um + build.normal(0.0, 1.0)
        self._set_discharge()
        self._set_sensors(build)
        self.plays, self.creep = _actuator(build)
        self._rest_actuator()
        self.holes: list[Hole] = []
        self._here: Hole | None = None
        self.position_um = np.array([PARK_X_UM, 0.0])
        self.theta_deg = 0.0
        self.reported = [PARK_X_UM, 0.0, 0.0]  # x, y in µm and theta in degrees, as the stages tell
        self.dielectric_level_ok = True
        self.dielectric_flow_lpm = config.dielectric_flow_lpm
        self.dielectric_temperature_c = config.dielectric_temperature_c
        self.estop = self.door_open = self.limit_switch = False
        self.hv_supply_ok = True
        self.tool_lost_um = 0.0  # broken off; not wear
        self.obstacle_um = math.inf  # something that the tool meets there, wherever the stage stands
        self.current_factor = 1.0  # of the generator's current, above 1 where its limit has failed
        self.set_generator(130.435, 304.348, 40.0, 0.12, 0.0)
        self.arrive()

    @property
    def tool_wear_um(self) -> float:
        """Length lost by the tool so far, µm."""
        return float(self.st[k.WEAR])

    def true_holes(self) -> tuple[Hole, ...]:
        """Every hole with its present depth."""
        self._store_depth()
        return tuple(self.holes)

    def stage_lands(self, axis: int, target: float) -> None:
        """Put an axis (0 x, 1 y in µm; 2 theta in degrees) where the stage really stops; it reports `target`."""
        self.leave()
        self.reported[axis] = target
        s = self.config.sensors
        if axis == 2:
            self.theta_deg = target + s.rotary_sd_deg * self._stage_noise.standard_normal()
        else:
            self.position_um[axis] = target + s.stage_sd_um * self._stage_noise.standard_normal()
        self.arrive()

    def leave(self) -> None:
        """Remember the hole under the tool before the stage moves."""
        self._store_depth()
        self._here = None

    def arrive(self) -> None:
        """Set what lies under the tool: a hole that it fits into, the face of the work, or nothing."""
        x, y = self._xy()
        clearance = self.config.discharge.side_gap_um
        self._here = next((h for h in self.holes if math.hypot(h.x_um - x, h.y_um - y) <= clearance), None)
        self.st[k.DEPTH] = self._here.depth_um if self._here else 0.0
        self.st[k.DEBRIS] = 0.0
        self.st[k.BRIDGE_UNTIL] = self.st[k.CARBON] = 0.0
        self.set_surface()

    def set_surface(self) -> None:
        """Set how far the tool is from what lies under it: the tilted face, nothing, or what should not be there."""
        x, y = self._xy()
        tilt = (self._tilt_mrad[0] * x + self._tilt_mrad[1] * y) * 1e-3
        surface = self._offset_um + tilt if x >= EDGE_X_UM else CLEAR_UM
        self.st[k.SURFACE] = min(surface + self.tool_lost_um, self.obstacle_um)

    def _xy(self) -> tuple[float, float]:
        return float(self.position_um[0]), float(self.position_um[1])

    def set_generator(
        self, on_time_us: float, off_time_us: float, open_v: float, peak_a: float, set_us: float
    ) -> None:
        """Wire the pulse generator: its series resistance gives the peak current in a normal discharge."""
        self.par[k.OPEN_V], self.par[k.ON_TIME], self.par[k.DISCHARGE_SET] = open_v, on_time_us, set_us
        self.par[k.NOMINAL_SIEMENS] = peak_a / max(open_v - self.par[k.DISCHARGE_V], 0.1)
        self.set_current_factor(self.current_factor)
        self.par[k.PER_OPEN_GAP] = REFERENCE_V / (self.config.discharge.gap_reference_um * open_v)
        self.par[k.DUTY_V] = open_v * on_time_us / (on_time_us + off_time_us)
        self.par[k.PER_DUTY_V] = 1.0 / self.par[k.DUTY_V]
        self.ist[k.PULSE_PERIOD] = round((on_time_us + off_time_us) * 1000.0)

    def set_current_factor(self, factor: float) -> None:
        """Let the generator give `factor` times the current that it is set to."""
        self.current_factor = factor
        self.par[k.SIEMENS] = factor * self.par[k.NOMINAL_SIEMENS]

    def _store_depth(self) -> None:
        depth = float(self.st[k.DEPTH])
        if self._here is not None:
            self._here.depth_um = depth
        elif depth > 0.0:
            self._here = Hole(float(self.position_um[0]), float(self.position_um[1]), depth)
            self.holes.append(self._here)

    def _set_discharge(self) -> None:
        c, d = self.config, self.config.discharge
        radius, outer = c.tool_diameter_um / 2.0, c.tool_diameter_um / 2.0 + d.side_gap_um
        values = {
            k.TOOL_AREA: math.pi * radius**2,
            k.PER_TOOL_AREA: 1.0 / (math.pi * radius**2),
            k.PER_HOLE_AREA: 1.0 / (math.pi * outer**2),
            k.ANNULUS_AREA: math.pi * (outer**2 - radius**2),
            k.THETA: c.theta,
            k.KAPPA: d.kappa_um3_per_uj,
            k.DISCHARGE_V: d.discharge_v,
            k.ARC_PLATEAU_V: d.arc_v,
            k.SHORT_PLATEAU_V: d.short_v,
            k.TAU_REFERENCE: d.tau_reference_us,
            k.GAP_EXPONENT: d.gap_exponent,
            k.FORMATIVE: d.formative_us,
            k.ROUGHNESS: d.roughness_um,
            k.DEBRIS_GAP_FACTOR: d.debris_gap_factor,
            k.FLUSH_TIME: d.flush_time_s * (c.tool_diameter_um / FLUSH_DIAMETER_UM) ** 2,
            k.PER_FLUSH_DEPTH: 1.0 / (d.flush_depth_ratio * c.tool_diameter_um),
            k.ARC_BASE: d.arc_base,
            k.ARC_DEBRIS: d.arc_debris,
            k.BRIDGE_BASE: d.bridge_base,
            k.PER_BRIDGE_DEBRIS: 1.0 / d.bridge_debris,
            k.PER_BRIDGE_GAP: 1.0 / d.bridge_gap_um,
            k.BRIDGE_CLEAR: d.bridge_clear,
            k.SIDE_BASE: d.side_base,
            k.SIDE_DEBRIS: d.side_debris,
        }
        for index, value in values.items():
            self.par[index] = value

    def _set_sensors(self, build: np.random.Generator) -> None:
        s, p = self.config.sensors, self.par
        p[k.SENSOR_GAIN] = 1.0 + build.normal(0.0, s.gain_sd)
        p[k.SENSOR_BEND] = s.nonlinearity_um
        p[k.SENSOR_DRIFT] = build.normal(0.0, s.drift_sd_um_s)
        p[k.SENSOR_NOISE] = s.noise_um
        if not s.fitted:
            p[k.SENSOR_GAIN] = p[k.SENSOR_BEND] = p[k.SENSOR_DRIFT] = 0.0
        p[k.SENSOR_WALK] = s.walk_um if s.fitted else 0.0
        p[k.CONTACT_SD] = s.contact_sd_um
        p[k.CONTACT_COMPLIANCE] = CONTACT_COMPLIANCE
        p[k.DRIVE] = p[k.STROKE] = p[k.MONITOR_GAIN] = 1.0
        p[k.GAP_STUCK] = -1.0
        p[k.AMPLIFIER_DECAY] = math.exp(-k.TICK_S / AMPLIFIER_LAG_S)
        p[k.ENVELOPE_UM], p[k.ENVELOPE_CENTRE] = ENVELOPE_UM, ENVELOPE_CENTRE_UM
        p[k.ENVELOPE_STEEPNESS] = 2.0 / ENVELOPE_WIDTH_UM
        omega, zeta = 2.0 * math.pi * MODE_HZ, MODE_DAMPING
        damped = omega * math.sqrt(1.0 - zeta**2)
        decay = math.exp(-zeta * omega * k.TICK_S)
        cos, sin = math.cos(damped * k.TICK_S), math.sin(damped * k.TICK_S)
        p[k.MODE_A11] = decay * (cos + zeta * omega / damped * sin)
        p[k.MODE_A12] = decay * sin / damped
        p[k.MODE_A21] = -decay * omega**2 / damped * sin
        p[k.MODE_A22] = decay * (cos - zeta * omega / damped * sin)

    def _rest_actuator(self) -> None:
        """Leave the actuator as after yesterday's work: cycled over the full range, at 0 V, creep gone."""
        thresholds, states = self.plays[0], self.plays[2]
        for u in (150.0, 0.0, 150.0, 0.0):
            np.clip(states, u - thresholds, u + thresholds, out=states)
        y = float(self.plays[1] @ states)
        self.st[k.PLAY_SUM] = y
        y += ENVELOPE_UM * math.tanh((y - ENVELOPE_CENTRE_UM) / ENVELOPE_WIDTH_UM)
        self.creep[2] = y
        self.par[k.ACTUATOR_ZERO] = y * (1.0 + float(self.creep[1].sum()))


def serial_number(seed: int) -> str:
    """Serial of the machine that a seed makes, at most 12 ASCII characters: every seed is another actuator."""
    serial = f"SIM-{seed}"
    return serial if len(serial) <= SERIAL_LENGTH else f"SIM-x{zlib.crc32(serial.encode()) & 0xFFFFFFF:07x}"


def _actuator(build: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw this unit's play bank (threshold, weight, state) and creep bank (decay, weight, state)."""
    thresholds = PLAY_SPAN_V * ((np.arange(PLAYS) + 0.37) / PLAYS) ** 1.35
    thresholds *= 1.0 + 0.03 * build.standard_normal(PLAYS)
    weights = np.exp(-thresholds / PLAY_DENSITY_V) * (1.0 + 0.1 * build.standard_normal(PLAYS))
    weights *= (1.0 - REVERSIBLE_SHARE) / weights.sum()
    thresholds.sort()
    thresholds[0] = 0.013
    weights[0] += REVERSIBLE_SHARE
    weights *= GAIN_UM_PER_V * (1.0 + 0.01 * build.standard_normal())
    taus = CREEP_FIRST_S * CREEP_RATIO ** np.arange(CREEP_TERMS)
    creep_weights = (
        CREEP_PER_DECADE * math.log10(CREEP_RATIO) * (1.0 + 0.1 * build.standard_normal(CREEP_TERMS))
    )
    plays = np.stack([thresholds, weights, np.zeros(PLAYS)])
    creep = np.stack([np.exp(-k.TICK_S / taus), creep_weights, np.zeros(CREEP_TERMS)])
    return plays, creep
