"""What the plant is and what state it is in: known to the plant alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.simulator.plant_interface import PATH_LINES
from edmctl.simulator.records import Record, record, series

if TYPE_CHECKING:
    from edmctl.simulator.records import Floats

PLAYS = 40
CREEP_TERMS = 12
SCOPE_PULSES = 64  # newest pulses remembered, for waveforms; a power of two


@record
class Unit(Record):
    """What one unit is made of: constants as its seed drew them, tool, generator, and what is broken in it."""

    # tool and hole
    tool_area_um2: float
    per_tool_area: float  # 1/µm²
    per_disc_area: float  # of the whole disc that discharges reach, 1/µm²
    annulus_area_um2: float
    theta: float  # volume of tool worn per volume of work removed
    # discharge
    kappa_um3_per_uj: float
    discharge_v: float
    arc_plateau_v: float
    short_plateau_v: float
    tau_reference_us: float
    gap_exponent: float
    formative_us: float
    roughness_um: float
    debris_gap_factor: float
    flush_time_s: float  # of this tool's gap while shallow
    per_flush_depth: float  # one over the depth at which clearance takes twice as long
    arc_base: float
    arc_debris: float
    bridge_base: float
    per_bridge_debris: float
    per_bridge_gap: float  # 1/µm
    bridge_clear: float
    side_base: float
    side_debris: float
    # generator
    open_v: float
    on_time_us: float
    discharge_set_us: float
    siemens: float  # of the generator's series resistor
    nominal_siemens: float  # the same as it is set
    per_open_gap: float  # one over the reference gap at this open voltage, 1/µm
    pulse_period_ns: int
    # actuator
    amplifier_decay: float
    envelope_um: float
    envelope_centre_um: float
    envelope_steepness: float  # 1/µm
    actuator_zero_um: float
    mode_a11: float
    mode_a12: float
    mode_a21: float
    mode_a22: float
    play_threshold_v: Floats = series(PLAYS)  # ascending
    play_um_per_v: Floats = series(PLAYS)
    creep_decay: Floats = series(CREEP_TERMS)  # over a tick
    creep_share: Floats = series(CREEP_TERMS)
    # sensors
    contact_compliance: float
    contact_sd_um: float
    sensor_gain: float
    sensor_bend_um: float
    sensor_drift_um_s: float
    sensor_noise_um: float
    sensor_walk_um: float
    monitor_gain: float
    monitor_zero_v: float
    # what is broken (injection.py)
    amplifier_gain: float  # 1, or 0 with a dead amplifier
    stroke_share: float  # of the actuator's displacement that is left
    gap_stuck_v: float  # what the gap sensor reads whatever there is; negative: nothing is wrong
    off_time_a: float  # current that goes on into the off-time
    stray_pulses: int  # seen in measure mode


@record
class PlantState(Record):
    """What changes in the plant from tick to tick."""

    # actuator
    amplifier_v: float  # after the amplifier's lag
    play_sum_um: float  # weighted sum of the plays
    mode_velocity_um_s: float  # of the output-side mode
    free_z_um: float  # where the tool would be without contact
    true_z_um: float
    play_v: Floats = series(PLAYS)
    creep_um: Floats = series(CREEP_TERMS)
    # work under the tool
    surface_um: float  # gap at z = 0 with a new tool over the untouched surface here
    depth_um: float  # least depth under the tool's face
    wear_um: float
    per_hole_area: float  # of what sinks of the disc now, 1/µm²
    rarity: float  # of ignition: the tool's face over what of the sheet is left under it
    next_level_um: float  # depth from which on the area that sinks is another
    level_at: int  # column of that level in the table of what lies under the tool
    asperity_um: float
    # gap
    debris_um3: float
    clearing: float  # share of the debris that stays over a pulse period, and over a tick
    tick_clearing: float
    bridge_until_um: float  # gap at which the bridge breaks; 0 = none
    carbon: float
    true_arc_run: int  # what builds up carbon
    opening_um: float  # of the gap beyond FREE_GAP_UM
    # generator, sensors, stages
    next_pulse_ns: int
    pulse_starts: int  # of the drive, as far as they were followed
    contact_tests: int
    walk_um: float
    stage_error_x_um: float  # where the stages really are, less where they report to be
    stage_error_y_um: float
    stage_way_um: float  # gone since the plant last looked
    line_error_x_um: Floats = series(PATH_LINES)  # at the end of each line
    line_error_y_um: Floats = series(PATH_LINES)
    # places in the blocks of random numbers
    random_at: int
    noise_at: int


@record
class Scope(Record):
    """The newest pulses, as an oscilloscope at the gap would know them; a ring."""

    at: int  # pulses so far
    start_ns: Floats = series(SCOPE_PULSES)
    delay_us: Floats = series(SCOPE_PULSES)
    discharge_us: Floats = series(SCOPE_PULSES)
    plateau_v: Floats = series(SCOPE_PULSES)
    siemens: Floats = series(SCOPE_PULSES)
    leak_a: Floats = series(SCOPE_PULSES)
    stuck_v: Floats = series(SCOPE_PULSES)
