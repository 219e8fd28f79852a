"""The machine's body: actuator, gap, work, stages, sensors. Its truth stays here; the controller reads sensors."""

from __future__ import annotations

import math
import zlib
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edmctl.simulator import kernel as k
from edmctl.simulator.chips import Chips
from edmctl.simulator.ground import Ground
from edmctl.simulator.random_blocks import BLOCK as BLOCK
from edmctl.simulator.random_blocks import RandomBlocks
from edmctl.simulator.unit import build_actuator, set_actuator

if TYPE_CHECKING:
    from edmctl.simulator.config import BenchConfig
    from edmctl.simulator.ground import Hole

Floats = NDArray[np.float64]

CONTACT_COMPLIANCE = (
    0.1  # travel of the tool end into the work per µm of free travel beyond contact [assumed]
)
PARK_X_UM = -5000.0
CLEAR_UM = 1e6

REFERENCE_V = 40.0  # open voltage at which gap_reference_um holds; the gap grows in proportion
FLUSH_DIAMETER_UM = 270.0  # tool diameter at which flush_time_s holds; it grows with the square

SERIAL_LENGTH = 12  # bytes in the reply to HELLO


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
        self.plays, self.creep = build_actuator(build)
        set_actuator(self.par, self.st, self.plays, self.creep)
        self.ground = Ground(config, self.par, self.st, self.ist)
        self.tools_worn_um: dict[str, float] = {}  # those that lie beside the machine
        self.position_um = np.array([PARK_X_UM, 0.0])
        self.theta_deg = 0.0
        self._scanning = False
        self.reported = [PARK_X_UM, 0.0, 0.0]  # x, y in µm and theta in degrees, as the stages tell
        self.dielectric_level_ok = True
        self.dielectric_flow_lpm = config.dielectric_flow_lpm
        self.dielectric_temperature_c = config.dielectric_temperature_c
        self.estop = self.door_open = self.limit_switch = False
        self.hv_supply_ok = True
        self.tool_lost_um = 0.0  # broken off; not wear
        self.obstacle_um = math.inf  # something that the tool meets there, wherever the stage stands
        self.chips = Chips(self)
        self.current_factor = 1.0  # of the generator's current, above 1 where its limit has failed
        self.set_generator(130.435, 304.348, 40.0, 0.12, 0.0)
        self.arrive()

    @property
    def tool_wear_um(self) -> float:
        """Length lost by the tool so far, µm."""
        return float(self.st[k.WEAR])

    def fit_tool(self, label: str, diameter_um: float, theta: float, tip_rounding_um: float) -> None:
        """Put a tool in, as long as its gauge says unless it was here before; the one that is in keeps its wear."""
        before = self.config
        self.config = replace(
            before,
            tool_label=label,
            tool_diameter_um=diameter_um,
            theta=theta,
            tip_rounding_um=tip_rounding_um,
        )
        if self.config == before:
            return
        self.leave()
        if label != before.tool_label:
            self.tools_worn_um[before.tool_label] = self.tool_wear_um
            self.st[k.WEAR] = self.tools_worn_um.pop(label, 0.0)
        self._set_tool()
        self.ground.set_tool(self.config)
        self.arrive()

    def true_holes(self) -> tuple[Hole, ...]:
        """Every hole with its present depth."""
        return self.ground.true_holes()

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

    def stage_errors_um(self) -> tuple[float, float]:
        """Draw how far from the place asked for the stages will be, x and y."""
        x, y = self.config.sensors.stage_sd_um * self._stage_noise.standard_normal(2)
        return float(x), float(y)

    def begin_scan(self) -> None:
        """Hand the stages over to the kernel."""
        self._scanning = True
        self.ground.set_moving()
        st = self.st
        st[k.STAGE_X], st[k.STAGE_Y] = self.reported[:2]
        st[k.STAGE_ERROR_X], st[k.STAGE_ERROR_Y] = self.position_um - self.reported[:2]
        st[k.STAGE_WAY] = 0.0

    def follow_stages(self) -> None:
        """Take note of where a scan has brought the stages, and of its end."""
        if not self._scanning:
            return
        self.reported[:2] = self.st[k.STAGE_X].item(), self.st[k.STAGE_Y].item()
        if not self.ist[k.SCANNING]:
            self.look()
            self._scanning = False

    def leave(self) -> None:
        """Remember the work under the tool before the stage moves."""
        self.ground.leave()

    def arrive(self) -> None:
        """Set what lies under the tool: a hole that it fits into, the face of the work, or nothing."""
        self.ground.arrive(*self._xy())
        self.st[k.DEBRIS] = 0.0
        self.st[k.BRIDGE_UNTIL] = self.st[k.CARBON] = 0.0
        self.set_surface()

    def look(self) -> None:
        """Look again what lies under the tool: it has moved in its cut, or the sheet has given way."""
        if self._scanning:
            st = self.st
            st[k.STAGE_WAY] = 0.0
            self.position_um[0] = st[k.STAGE_X] + st[k.STAGE_ERROR_X]
            self.position_um[1] = st[k.STAGE_Y] + st[k.STAGE_ERROR_Y]
        self.ground.look(*self._xy())
        self.set_surface()

    def set_surface(self) -> None:
        """Set how far the tool is from what lies under it: the tilted face, nothing, or what should not be there."""
        x, y = self._xy()
        tilt = (self._tilt_mrad[0] * x + self._tilt_mrad[1] * y) * 1e-3
        surface = self._offset_um + tilt - self.chips.under_tool_um() if self.ground.solid else CLEAR_UM
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

    def _set_discharge(self) -> None:
        d = self.config.discharge
        values = {
            k.KAPPA: d.kappa_um3_per_uj,
            k.DISCHARGE_V: d.discharge_v,
            k.ARC_PLATEAU_V: d.arc_v,
            k.SHORT_PLATEAU_V: d.short_v,
            k.TAU_REFERENCE: d.tau_reference_us,
            k.GAP_EXPONENT: d.gap_exponent,
            k.FORMATIVE: d.formative_us,
            k.ROUGHNESS: d.roughness_um,
            k.DEBRIS_GAP_FACTOR: d.debris_gap_factor,
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
        self._set_tool()

    def _set_tool(self) -> None:
        c, d = self.config, self.config.discharge
        radius, outer = c.tool_diameter_um / 2.0, c.tool_diameter_um / 2.0 + d.side_gap_um
        values = {
            k.TOOL_AREA: math.pi * radius**2,
            k.PER_TOOL_AREA: 1.0 / (math.pi * radius**2),
            k.PER_DISC_AREA: 1.0 / (math.pi * outer**2),
            k.ANNULUS_AREA: math.pi * (outer**2 - radius**2),
            k.THETA: c.theta,
            k.FLUSH_TIME: d.flush_time_s * (c.tool_diameter_um / FLUSH_DIAMETER_UM) ** 2,
            k.PER_FLUSH_DEPTH: 1.0 / (d.flush_depth_ratio * c.tool_diameter_um),
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


def serial_number(seed: int) -> str:
    """Serial of the machine that a seed makes, at most 12 ASCII characters: every seed is another actuator."""
    serial = f"SIM-{seed}"
    return serial if len(serial) <= SERIAL_LENGTH else f"SIM-x{zlib.crc32(serial.encode()) & 0xFFFFFFF:07x}"
