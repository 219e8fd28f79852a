"""The machine's body: actuator, gap, work, stages, sensors. Its truth stays here; the controller reads sensors.

A seed draws one unit of it. `VirtualActuator` is its actuator alone.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from edmctl.array_types import Array
from edmctl.core.library import library
from edmctl.dataclasses import dataclass
from edmctl.link.messages import PARAMS
from edmctl.process.erosion import (
    MOST_DEBRIS,
    USUAL_OPEN_V,
    crater_scale,
    deionisation_us,
    flush_time_s,
    pulse_energy_uj,
    removal_um3_per_uj,
    side_gap_um,
    working_gap_um,
)
from edmctl.simulator.config import BenchConfig, DischargeConstants, drawn
from edmctl.simulator.plant_records import (
    BURNING,
    CREEP_TERMS,
    PLAYS,
    TABLE,
    TICK_NS,
    TICK_S,
    Drive,
    Machine,
    PlantState,
    Readings,
    Scope,
    Unit,
)
from edmctl.simulator.work_under_tool import Chips, WorkUnderTool

BLOCK = 32768
"""Random numbers that are drawn at once."""

PLAY_SPAN_V = 62.0
REVERSIBLE_SHARE = 0.48
PLAY_DENSITY_V = 26.0  # e-folding of the weights over the threshold
GAIN_UM_PER_V = 2.70  # sum of the weights: 445 µm peak to peak from 0 to 150 V in 100 s
CREEP_FIRST_S = 0.0063
CREEP_RATIO = 3.17
CREEP_PER_DECADE = 0.030
ENVELOPE_UM, ENVELOPE_CENTRE_UM, ENVELOPE_WIDTH_UM = 22.0, 190.0, 120.0
AMPLIFIER_LAG_S = 0.002
MODE_HZ, MODE_DAMPING = 320.0, 0.04  # loaded output-side resonance [assumed]

CONTACT_COMPLIANCE = 0.1  # travel of the tool end into the work per µm of free travel beyond [assumed]
PARK_X_UM = -5000.0
CLEAR_UM = 1e6

FREE_GAP_UM = 5.0  # a gap beyond this draws clean oil in; the dither of the servo stays below [assumed]
FORGOTTEN = 9.0  # time constants after which a channel ignites again in one of 8000 cases

USUAL_PULSES = (130.435, 304.348, 40.0, 0.12, 0.0)
"""Until the generator is set: on and off time, µs, open voltage, peak current, discharge time (0: as it comes)."""

_OF_THE_GAP = (
    *("tau_reference_us", "gap_exponent", "debris_gap_factor", "arc_base", "arc_delay_us", "bridge_base"),
    *("deionisation_debris", "deionisation_after_arc", "side_base", "side_debris"),
)
"""Constants of the gap's law that the library takes as they are."""

SERIAL_LENGTH = 12  # bytes in the reply to HELLO
STAGE_X, STAGE_Y = 0, 1
RATE_HZ = 1.0 / TICK_S
LOW_V, HIGH_V = PARAMS["piezo_max_v"].minimum, PARAMS["piezo_max_v"].maximum
SLEW_V_S = PARAMS["slew_limit_v_s"].default

_TICKS_AT_ONCE = BLOCK // 2


class Inputs(NamedTuple):
    """Switches and slow sensors, as a controller reads them."""

    estop: bool
    door_open: bool
    hv_supply_ok: bool
    level_ok: bool
    limit_switch: bool
    flow_lpm: float
    temperature_c: float
    monitor_v: float


@dataclass(slots=True)
class Wiring:
    """What is wired wrongly between machine and controller; nothing at first.

    Mistakes of analog wires and of the contact are in `Unit`, which the plant reads.
    """

    estop_door_swapped: bool = False
    estop_open: bool = False  # its wire is off: pressed, whatever the button does
    door_bridged: bool = False
    level_inverted: bool = False
    supply_bridged: bool = False  # "high voltage ok" is tied to ok
    flow_open: bool = False
    x_share: float = 1.0  # way of the X stage over the way asked for: reversed -1, 0 without steps
    xy_swapped: bool = False


class Plant:
    """State and parameters of the body, which the library in C advances. Same config and seed, same machine."""

    def __init__(self, config: BenchConfig, seed: int) -> None:
        seeds = np.random.SeedSequence(seed).spawn(5)
        build_seed, run_seed, stage_seed, process_seed, frame_seed = seeds
        build = np.random.default_rng(build_seed)
        self.config = config
        self.serial = serial_number(seed)
        self.unit, self.state, self.scope = Unit(), PlantState(), Scope()
        self._machine, self._levels = Machine(), np.zeros((3, 1))
        self.drive, self.readings = Drive(), Readings()
        self.random = RandomBlocks(run_seed, config.discharge.scatter)
        self._stage_noise = np.random.default_rng(stage_seed)
        self._tilt_mrad = config.sensors.tilt_sd_mrad * build.standard_normal(2)
        self._offset_um = config.offset_um + build.normal(0.0, 1.0)
        self.discharge = drawn(config.discharge, config.spread, np.random.default_rng(process_seed))
        self._set_discharge()
        self._set_sensors(build)
        frame = np.random.default_rng(frame_seed)
        self.unit.sensor_bend_um *= frame.standard_normal()
        self.unit.machine_drift_um_s = frame.normal(0.0, config.sensors.machine_drift_sd_um_s)
        draw_actuator(self.unit, build)
        set_actuator(self.unit, self.state)
        self.work_under_tool = WorkUnderTool(config, self.unit, self.state)
        self.tools_worn_um: dict[str, float] = {}  # those that lie beside the machine
        self.position_um = np.array([PARK_X_UM, 0.0])
        self.theta_deg = 0.0
        self._scanning = False
        self.reported = [PARK_X_UM, 0.0, 0.0]  # x, y in µm and theta in degrees, as the stages tell
        self.dielectric_level_ok = True
        self.dielectric_flow_lpm = config.dielectric_flow_lpm
        self.dielectric_temperature_c = config.dielectric_temperature_c
        self.estop = self.door_open = self.limit_switch = False
        self.wiring = Wiring()
        self.tool_lost_um = 0.0  # broken off; not wear
        self.obstacle_um = math.inf  # something that the tool meets there, wherever the stage stands
        self.chips = Chips(self.serial, self.position_um, self.state, self.drive, self.set_surface)
        self.chips.tool_diameter_um = config.tool_diameter_um
        self.current_factor = 1.0  # of the generator's current, above 1 where its limit has failed
        self.set_generator(*USUAL_PULSES)
        self.arrive()

    def advance(self, controller: Callable[[Readings, Drive], object], ticks: int) -> None:
        """Let milliseconds pass under any controller, which is called before each of them."""
        run = library().plant_run
        for _ in range(ticks):
            controller(self.readings, self.drive)
            self.random.provide(self.state, TICK_NS // self.unit.pulse_period_ns + 2, 4)
            if run(self.in_c().place):
                self.look()

    def in_c(self) -> Machine:
        """Return where everything is, for the library in C; `look` moves some of it."""
        machine, levels = self._machine, self.work_under_tool.levels
        if machine.unit == 0 or self._levels is not levels:
            self._levels, random = levels, self.random
            records = (self.unit, self.state, self.scope, self.drive, self.readings)
            rows = (*random.pulse, random.noise, *random.tables, *levels)
            addresses = (*(one.place for one in records), *(row.ctypes.data for row in rows))
            for name, place in zip(Machine.pointers, addresses, strict=True):
                setattr(machine, name, place)
        return machine

    def fit_tool(self, label: str, diameter_um: float, tool_wear: float, tip_rounding_um: float) -> None:
        """Put a tool in, as long as its gauge says unless it was here before; the one that is in keeps its wear."""
        before = self.config
        self.config = replace(
            before,
            tool_label=label,
            tool_diameter_um=diameter_um,
            tool_wear=tool_wear,
            tip_rounding_um=tip_rounding_um,
        )
        if self.config == before:
            return
        self.leave()
        if label != before.tool_label:
            self.tools_worn_um[before.tool_label] = self.state.wear_um
            self.state.wear_um = self.tools_worn_um.pop(label, 0.0)
        self._set_tool()
        self._set_hole()
        self.work_under_tool.config = self.config
        self.chips.tool_diameter_um = diameter_um
        self.arrive()

    def stage_lands(self, axis: int, target: float) -> None:
        """Put an axis (0 x, 1 y in µm; 2 theta in degrees) where the stage really stops; it reports `target`."""
        self.leave()
        way = target - self.reported[axis]
        self.reported[axis] = target
        s, wiring = self.config.sensors, self.wiring
        share = wiring.x_share if axis == STAGE_X else 1.0
        if axis == 2:
            self.theta_deg = target + s.rotary_sd_deg * self._stage_noise.standard_normal()
        elif wiring.xy_swapped or share != 1.0:
            self.position_um[STAGE_X + STAGE_Y - axis if wiring.xy_swapped else axis] += share * way
        else:
            self.position_um[axis] = target + s.stage_sd_um * self._stage_noise.standard_normal()
        self.arrive()

    def draw_line_error(self, row: int) -> None:
        """Draw how far from the place asked for the stages will be at the end of a line."""
        error = self.config.sensors.stage_sd_um * self._stage_noise.standard_normal(2)
        self.state.line_error_x_um[row], self.state.line_error_y_um[row] = error

    def begin_scan(self) -> None:
        self._scanning = True
        self.work_under_tool.set_moving()
        self.drive.stage_x_um, self.drive.stage_y_um = self.reported[:2]
        self.state.stage_error_x_um, self.state.stage_error_y_um = self.position_um - self.reported[:2]
        self.state.stage_way_um = 0.0

    def follow_stages(self, *, scan_goes_on: bool) -> None:
        """Take note of where a scan has brought the stages, and of its end."""
        if not self._scanning:
            return
        self.reported[:2] = self.drive.stage_x_um, self.drive.stage_y_um
        if not scan_goes_on:
            self.look()
            self._scanning = False

    def leave(self) -> None:
        """Remember the work under the tool before the stage moves."""
        self.work_under_tool.leave()

    def arrive(self) -> None:
        """Set what lies under the tool: a hole that it fits into, the face of the work, or nothing."""
        self.work_under_tool.arrive(*self._xy())
        self.state.debris_um3 = self.state.bridge_until_um = self.state.carbon = 0.0
        self.set_surface()

    def look(self) -> None:
        """Look again what lies under the tool: it has moved in its cut, or the sheet has given way."""
        if self._scanning:
            self.state.stage_way_um = 0.0
            self.position_um[0] = self.drive.stage_x_um + self.state.stage_error_x_um
            self.position_um[1] = self.drive.stage_y_um + self.state.stage_error_y_um
        self.work_under_tool.look(*self._xy())
        self.set_surface()

    def set_surface(self) -> None:
        """Set how far the tool is from what lies under it: the tilted face, nothing, or what should not be there."""
        x, y = self._xy()
        tilt = (self._tilt_mrad[0] * x + self._tilt_mrad[1] * y) * 1e-3
        surface = (
            self._offset_um + tilt - self.chips.under_tool_um() if self.work_under_tool.solid else CLEAR_UM
        )
        self.state.surface_um = min(surface + self.state.machine_um + self.tool_lost_um, self.obstacle_um)

    def _xy(self) -> tuple[float, float]:
        return float(self.position_um[0]), float(self.position_um[1])

    def set_generator(
        self, on_time_us: float, off_time_us: float, open_v: float, peak_a: float, set_us: float
    ) -> None:
        """Wire the pulse generator: its series resistance gives the peak current in a normal discharge."""
        unit, d, power = self.unit, self.discharge, library().pow
        unit.open_v, unit.discharge_set_us = open_v, set_us
        unit.on_time_us, unit.off_time_us = on_time_us, off_time_us
        unit.nominal_siemens = peak_a / max(open_v - unit.discharge_v, 0.1)
        self.set_current_factor(self.current_factor)
        unit.per_open_gap = USUAL_OPEN_V / (d.gap.gap_reference_um * open_v)
        unit.pulse_period_ns = round((on_time_us + off_time_us) * 1000.0)
        by_time = _by_burning_time(d, on_time_us, peak_a, tool_negative=self.config.tool_negative)
        for name, values in zip(
            ("work_um3_per_uj", "tool_um3_per_uj", "deionisation_us"), by_time, strict=True
        ):
            unit.array(name)[:] = values
        dirtiest = (1.0 + d.gap.deionisation_debris * MOST_DEBRIS) * d.gap.deionisation_after_arc
        unit.longest_memory_us = FORGOTTEN * dirtiest * by_time[2][-1]
        unit.arc_pause = 1.0 / (1.0 + off_time_us / d.gap.arc_pause_us)
        full_uj = pulse_energy_uj(d.discharge_v, peak_a, set_us or on_time_us)
        scale = crater_scale(full_uj, power)
        unit.particle_um = d.gap.particle_um * scale
        unit.roughness_um = d.roughness_um * scale
        unit.working_gap_um = working_gap_um(d.gap, open_v)
        unit.free_gap_um = max(FREE_GAP_UM, 1.5 * unit.working_gap_um)
        wall_um = side_gap_um(d.gap, open_v, full_uj, power)
        if wall_um != self.work_under_tool.side_gap_um:
            self.work_under_tool.side_gap_um = wall_um
            self._set_hole()
            self.look()

    def set_current_factor(self, factor: float) -> None:
        """Let the generator give `factor` times the current that it is set to."""
        self.current_factor = factor
        self.unit.siemens = factor * self.unit.nominal_siemens

    @property
    def hv_supply_ok(self) -> bool:
        return not self.unit.supply_off

    @hv_supply_ok.setter
    def hv_supply_ok(self, on: bool) -> None:
        self.unit.supply_off = int(not on)

    def inputs(self) -> Inputs:
        """What the controller sees of switches and slow sensors now, as they are wired."""
        wiring, switches = self.wiring, (self.estop, self.door_open)
        estop, door_open = reversed(switches) if wiring.estop_door_swapped else switches
        return Inputs(
            estop=estop or wiring.estop_open,
            door_open=door_open and not wiring.door_bridged,
            hv_supply_ok=self.hv_supply_ok or wiring.supply_bridged,
            level_ok=self.dielectric_level_ok != wiring.level_inverted,
            limit_switch=self.limit_switch,
            flow_lpm=0.0 if wiring.flow_open else self.dielectric_flow_lpm,
            temperature_c=self.dielectric_temperature_c,
            monitor_v=self.unit.monitor_gain * self.state.amplifier_v + self.unit.monitor_zero_v,
        )

    def _set_discharge(self) -> None:
        unit, d = self.unit, self.discharge
        unit.discharge_v = d.discharge_v
        unit.arc_plateau_v = d.arc_v
        unit.short_plateau_v = d.short_v
        unit.formative_us = d.formative_us
        unit.threshold_uj = d.erosion.threshold_uj
        unit.per_redeposition = 1.0 / d.gap.redeposition
        unit.arc_debris = 1.0 / d.gap.arc_debris**2
        unit.arc_work = d.gap.arc_work * d.arc_v / d.discharge_v
        unit.arc_tool = d.gap.arc_tool * d.arc_v / d.discharge_v
        unit.bridge_clear = d.bridge_clear
        for name in _OF_THE_GAP:
            setattr(unit, name, getattr(d.gap, name))
        self._set_tool()

    def _set_tool(self) -> None:
        unit, c, d = self.unit, self.config, self.discharge
        radius = c.tool_diameter_um / 2.0
        unit.tool_area_um2 = math.pi * radius**2
        unit.per_tool_area = 1.0 / unit.tool_area_um2
        unit.work_factor = c.work_removal
        unit.tool_factor = c.tool_wear
        unit.flush_time_s = flush_time_s(d.gap, c.tool_diameter_um, 0.0)
        unit.per_flush_depth = 1.0 / (d.gap.flush_depth_ratio * c.tool_diameter_um)

    def _set_hole(self) -> None:
        unit = self.unit
        outer = self.config.tool_diameter_um / 2.0 + self.work_under_tool.side_gap_um
        unit.per_disc_area = 1.0 / (math.pi * outer**2)
        unit.per_rim_um = 1.0 / (2.0 * math.pi * outer)
        unit.annulus_area_um2 = math.pi * outer**2 - unit.tool_area_um2

    def _set_sensors(self, build: np.random.Generator) -> None:
        s, unit = self.config.sensors, self.unit
        unit.sensor_gain = 1.0 + build.normal(0.0, s.gain_sd)
        unit.sensor_bend_um = s.nonlinearity_um
        unit.sensor_drift_um_s = build.normal(0.0, s.drift_sd_um_s)
        unit.sensor_noise_um = s.noise_um
        if not s.fitted:
            unit.sensor_gain = unit.sensor_bend_um = unit.sensor_drift_um_s = 0.0
        unit.sensor_walk_um = s.walk_um if s.fitted else 0.0
        unit.contact_sd_um = s.contact_sd_um
        unit.contact_compliance = CONTACT_COMPLIANCE
        unit.amplifier_gain = unit.stroke_share = unit.monitor_gain = 1.0
        unit.gap_stuck_v = -1.0
        unit.sensor_wire = unit.gap_wire = 1.0


@lru_cache(16)
def _by_burning_time(
    d: DischargeConstants, on_time_us: float, peak_a: float, *, tool_negative: bool
) -> tuple[tuple[float, ...], ...]:
    """Work and tool removed per molten energy, and the gap's memory, over the burning time in BURNING steps."""
    power, rows = library().pow, []
    for i in range(BURNING):
        time_us = (i + 0.5) / BURNING * on_time_us
        memory_us = deionisation_us(d.gap, pulse_energy_uj(d.discharge_v, peak_a, time_us), power)
        removed = removal_um3_per_uj(d.erosion, time_us, peak_a, power, tool_negative=tool_negative)
        rows.append((*removed, memory_us))
    return tuple(zip(*rows, strict=True))


def serial_number(seed: int) -> str:
    """Serial of the machine that a seed makes, at most 12 ASCII characters: every seed is another actuator."""
    serial = f"SIM-{seed}"
    return serial if len(serial) <= SERIAL_LENGTH else f"SIM-x{zlib.crc32(serial.encode()) & 0xFFFFFFF:07x}"


def draw_actuator(unit: Unit, build: np.random.Generator) -> None:
    """Draw this unit's plays and creep.

    The actuator is deliberately richer than any estimator of this project: forty play operators on an uneven grid, a
    tanh envelope on their sum, twelve creep time constants, an amplifier's lag and an output-side mode (class of
    Kuhnen's modified Prandtl-Ishlinskii operator with linear creep). It is scaled to the 445 µm at 150 V of
    Muralidhara et al. 2009, §2.1. The library's functions give the same bytes on every computer.
    """
    c = library()
    thresholds = PLAY_SPAN_V * np.array([c.pow((k + 0.37) / PLAYS, 1.35) for k in range(PLAYS)])
    thresholds *= 1.0 + 0.03 * build.standard_normal(PLAYS)
    weights = np.array([c.exp(-v / PLAY_DENSITY_V) for v in thresholds])
    weights *= 1.0 + 0.1 * build.standard_normal(PLAYS)
    weights *= (1.0 - REVERSIBLE_SHARE) / weights.sum()
    thresholds.sort()
    thresholds[0] = 0.013
    weights[0] += REVERSIBLE_SHARE
    weights *= GAIN_UM_PER_V * (1.0 + 0.01 * build.standard_normal())
    taus_s = [CREEP_FIRST_S * c.pow(CREEP_RATIO, k) for k in range(CREEP_TERMS)]
    decades = c.log(CREEP_RATIO) / c.log(10.0)
    creep_shares = CREEP_PER_DECADE * decades * (1.0 + 0.1 * build.standard_normal(CREEP_TERMS))
    unit.array("play_threshold_v")[:] = thresholds
    unit.array("play_um_per_v")[:] = weights
    unit.array("creep_decay")[:] = [c.exp(-TICK_S / tau_s) for tau_s in taus_s]
    unit.array("creep_share")[:] = creep_shares


def set_actuator(unit: Unit, state: PlantState) -> None:
    """Set its constants, and leave it as after yesterday's work: cycled over the full range, at 0 V, creep gone."""
    c = library()
    unit.amplifier_decay = c.exp(-TICK_S / AMPLIFIER_LAG_S)
    unit.envelope_um, unit.envelope_centre_um = ENVELOPE_UM, ENVELOPE_CENTRE_UM
    unit.envelope_steepness = 2.0 / ENVELOPE_WIDTH_UM
    omega, zeta = 2.0 * math.pi * MODE_HZ, MODE_DAMPING
    damped = omega * math.sqrt(1.0 - zeta**2)
    decay = c.exp(-zeta * omega * TICK_S)
    cos, sin = c.cos(damped * TICK_S), c.sin(damped * TICK_S)
    unit.mode_a11 = decay * (cos + zeta * omega / damped * sin)
    unit.mode_a12 = decay * sin / damped
    unit.mode_a21 = -decay * omega**2 / damped * sin
    unit.mode_a22 = decay * (cos - zeta * omega / damped * sin)
    thresholds, plays = unit.array("play_threshold_v"), state.array("play_v")
    for u in (150.0, 0.0, 150.0, 0.0):
        np.clip(plays, u - thresholds, u + thresholds, out=plays)
    y = math.fsum(unit.array("play_um_per_v") * plays)
    state.play_sum_um = y
    y += ENVELOPE_UM * (1.0 - 2.0 / (c.exp((y - ENVELOPE_CENTRE_UM) * unit.envelope_steepness) + 1.0))  # tanh
    state.array("creep_um")[:] = y
    unit.actuator_zero_um = y * (1.0 + float(unit.array("creep_share").sum()))


class RandomBlocks:
    """Random numbers in blocks, one stream a quantity, so that results do not depend on where blocks end."""

    def __init__(self, seed: np.random.SeedSequence, scatter: float) -> None:
        streams = [np.random.Generator(np.random.SFC64(s)) for s in seed.spawn(4)]
        self._decide, self._shape, self._delay, self._noise = streams
        self.pulse = np.empty((3, BLOCK))
        self.noise = np.empty(BLOCK)
        self.tables = _tables(scatter).copy()
        self._fill_pulse(0)
        self._fill_noise(0)

    def _fill_pulse(self, start: int) -> None:
        self._decide.random(out=self.pulse[0, start:])
        self._shape.random(out=self.pulse[1, start:])
        self._delay.standard_exponential(out=self.pulse[2, start:])

    def _fill_noise(self, start: int) -> None:
        self._noise.standard_normal(out=self.noise[start:])

    def provide(self, state: PlantState, pulses: int, noises: int) -> None:
        """Make sure that so many numbers lie ahead of the places up to which they are used."""
        at = state.random_at
        if at + pulses > BLOCK:
            rest = BLOCK - at
            self.pulse[:, :rest] = self.pulse[:, at:].copy()
            self._fill_pulse(rest)
            state.random_at = 0
        at = state.noise_at
        if at + noises > BLOCK:
            rest = BLOCK - at
            self.noise[:rest] = self.noise[at:].copy()
            self._fill_noise(rest)
            state.noise_at = 0


@lru_cache(16)
def _tables(scatter: float) -> Array:
    """Equally likely values of |N(0, 1)| and of a lognormal of mean one: the middles of TABLE equal steps.

    Quantiles lack the digits in which C libraries differ; none is near a tie.
    """
    steps, quantile, exp = (np.arange(TABLE) + 0.5) / TABLE, NormalDist().inv_cdf, library().exp
    half = [round(quantile(0.5 + 0.5 * p), 10) for p in steps]
    volume = np.array([exp(scatter * round(quantile(p), 10)) for p in steps])
    return np.stack([half, volume / volume.mean()])


class DrivenTicks(NamedTuple):
    """Consecutive ticks of 1 ms, ndarrays of shape (n,).

    t_s : since the actuator was set up. applied_v : after slew limit, range and converter.
    truth_um : position of the tool, which only the simulator knows. sensor_um : reading of the displacement sensor.
    """

    t_s: Array
    applied_v: Array
    truth_um: Array
    sensor_um: Array


class VirtualActuator:
    """One unit, at rest at 0 V after full swings long ago."""

    def __init__(self, seed: int) -> None:
        self._plant = Plant(BenchConfig(), seed)
        self._command_v = 0.0

    @property
    def serial(self) -> str:
        """Serial number of the virtual machine with this actuator."""
        return self._plant.serial

    def drive(self, command_v: Array) -> DrivenTicks:
        """Apply a voltage sampled every millisecond; calls continue one another.

        command_v : ndarray, shape (n,), finite. Range and slew limit are those of the controller.
        """
        plant = self._plant
        command_v = np.ascontiguousarray(command_v, dtype=np.float64)
        t_s = (plant.readings.tick + np.arange(command_v.size)) / RATE_HZ
        applied_v, truth_um, sensor_um = (np.empty(command_v.size) for _ in range(3))
        for start in range(0, command_v.size, _TICKS_AT_ONCE):
            part = slice(start, start + _TICKS_AT_ONCE)
            plant.random.provide(plant.state, 0, 2 * command_v[part].size)
            self._command_v = library().actuator_run(
                plant.in_c().place,
                command_v[part].size,
                command_v[part].ctypes.data,
                self._command_v,
                SLEW_V_S,
                HIGH_V,
                *(one[part].ctypes.data for one in (applied_v, truth_um, sensor_um)),
            )
        return DrivenTicks(t_s, applied_v, truth_um, sensor_um)
