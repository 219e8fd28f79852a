"""Records of the plant that Python and C share: between controller and plant, and what only the plant knows.

A controller is called once a millisecond with `Readings` and `Drive`: it reads the one and sets the other.
"""

from __future__ import annotations

from edmctl.array_types import Array
from edmctl.core.library import Record, address, record, series

TICK_S = 0.001
TICK_NS = 1_000_000
DAC_V = 0.0025  # least step of the actuator voltage, about 7 nm of tool travel
STEPS_PER_V = 400.0
MOST_PULSES = 64  # room for those of one tick: 50 kHz is the highest frequency
PATH_LINES = 16  # lines of a path that wait


@record
class Drive(Record):
    """What the controller tells the machine, for the millisecond that comes."""

    actuator_v: float  # on the converter's grid
    pulses_on: int  # the gate of the generator
    generator: int  # mode switch, 1: generator at the gap; 0: contact circuit there
    pulse_starts: int  # so often the gate was opened: with another one the period of the pulses begins anew
    contact_tests: int  # further touches of a touch-off for which the contact circuit was set
    stage_x_um: float  # where the stages are to report to be
    stage_y_um: float
    stage_moves: int  # 1: the stages went along the path in the millisecond that ends
    stage_line: int  # row of the line that they began it on
    stage_lines_done: int  # lines that they came to the end of
    stage_share: float  # share that they went of what was left of the next one
    stage_way_um: float  # way that they went


@record
class Readings(Record):
    """What the machine shows the controller of the millisecond that ended."""

    tick: int  # milliseconds since the machine was set up, with that one
    sensor_um: float  # displacement sensor
    contact: int  # 1: the contact circuit is closed
    monitor_v: float  # voltage monitor of the actuator's amplifier
    gap_v: float  # gap voltage, mean over the pulses; NaN where there is none to measure
    charge_uc: float  # that went through the gap
    generator_siemens: float  # conductance of the generator: current over voltage drop in a discharge
    off_time_a: float  # current that goes on into the off-time
    stray_pulses: int  # that come although the gate is shut
    first_pulse_ns: int  # when the first of the pulses began, since the machine was set up
    pulses: int  # so many entries of the series are of this millisecond
    delay_us: Array = series(MOST_PULSES)  # ignition delay
    discharge_us: Array = series(MOST_PULSES)  # time of current; 0: none
    plateau_v: Array = series(MOST_PULSES)  # gap voltage of the discharge, or of the open gap
    energy_uj: Array = series(MOST_PULSES)  # of the discharge


PLAYS = 40
CREEP_TERMS = 12
TABLE = 1024  # values in each table of a distribution
BURNING = 256  # steps of the burning time in tables of what a discharge does
SCOPE_PULSES = 64  # newest pulses remembered, for waveforms; a power of two


STUCK_AT_GENERATOR, STUCK_AT_CONTACT = 1, 2  # Unit.mode_stuck


@record
class Unit(Record):
    """What one unit is made of: constants as its seed drew them, tool, generator, and what is broken in it."""

    # tool and hole
    tool_area_um2: float
    per_tool_area: float  # 1/µm²
    per_disc_area: float  # of the whole disc that discharges reach, 1/µm²
    annulus_area_um2: float
    per_rim_um: float  # one over the hole's circumference, 1/µm
    work_factor: float  # erosion of the work over that of copper, of this unit
    tool_factor: float  # and of the tool
    # discharge
    work_um3_per_uj: Array = series(BURNING)  # removed per molten energy, over the burning time, copper
    tool_um3_per_uj: Array = series(BURNING)
    threshold_uj: float
    per_redeposition: float  # one over the debris fraction at which half of the removal stays
    arc_work: float  # of an arc over a discharge of its energy
    arc_tool: float
    deionisation_us: Array = series(BURNING)  # over the burning time of the discharge before
    deionisation_debris: float
    deionisation_after_arc: float
    longest_memory_us: float  # off-time from which on nothing is left of the discharge before
    discharge_v: float
    arc_plateau_v: float
    short_plateau_v: float
    tau_reference_us: float
    gap_exponent: float
    formative_us: float
    roughness_um: float
    debris_gap_factor: float
    flush_time_s: float  # of this tool's gap while shallow
    working_gap_um: float  # at which that holds; wider clears faster
    free_gap_um: float  # opening beyond this draws clean oil in
    per_flush_depth: float  # one over the depth at which clearance takes twice as long
    arc_base: float
    arc_debris: float  # per debris fraction squared
    arc_delay_us: float  # delay in which that fades; twice as long after an arc
    arc_pause: float  # share of that left by this off-time
    bridge_base: float
    particle_um: float
    bridge_clear: float
    side_base: float
    side_debris: float
    # generator
    open_v: float
    on_time_us: float
    off_time_us: float
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
    play_threshold_v: Array = series(PLAYS)  # ascending
    play_um_per_v: Array = series(PLAYS)
    creep_decay: Array = series(CREEP_TERMS)  # over a tick
    creep_share: Array = series(CREEP_TERMS)
    # sensors
    contact_compliance: float
    contact_sd_um: float
    sensor_gain: float
    sensor_bend_um: float
    sensor_drift_um_s: float
    sensor_noise_um: float
    sensor_walk_um: float
    machine_drift_um_s: float  # of the work, away from the tool
    monitor_gain: float
    monitor_zero_v: float
    # what is broken (injection.py)
    amplifier_gain: float  # 1, or 0 with a dead amplifier
    stroke_share: float  # of the actuator's displacement that is left
    gap_stuck_v: float  # what the gap sensor reads whatever there is; negative: nothing is wrong
    gap_closed_um: float  # by what lies across the gap
    off_time_a: float  # current that goes on into the off-time
    stray_pulses: int  # seen in measure mode
    # how it is wired (`Wiring` in plant.py), and what somebody has put across the gap
    dac_open: int
    contact_inverted: int
    contact_open: int
    sensor_wire: float  # 1, reversed -1, NaN where its wire is off
    gap_wire: float  # share of the gap voltage that is read; reversed -1, 0 where its wire is off
    gate_stuck: int  # the generator is on whatever the gate says
    gate_open: int  # and this one never
    mode_stuck: int  # position of a stuck mode switch: STUCK_AT_GENERATOR or _AT_CONTACT, or 0
    supply_off: int  # of the high voltage
    battery_v: float


@record
class PlantState(Record):
    """What changes in the plant from tick to tick."""

    # actuator
    amplifier_v: float  # after the amplifier's lag
    play_sum_um: float  # weighted sum of the plays
    mode_velocity_um_s: float  # of the output-side mode
    free_z_um: float  # where the tool would be without contact
    true_z_um: float
    play_v: Array = series(PLAYS)
    creep_um: Array = series(CREEP_TERMS)
    # work under the tool
    surface_um: float  # gap at z = 0 with a new tool over the untouched surface here
    machine_um: float  # by which it has drifted since the bench was built
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
    opening_um: float  # of the gap beyond where it draws oil in
    previous_burning: float  # table step of the discharge before, -1 where there was none
    previous_arc: float  # whether it was an arc
    # surface of the hole
    wall_um: float  # taken from the wall, over its area at that time: what tapers
    crater_um3: float  # of the newest craters: sums of their volume, of its square, and of arcs' volume
    crater_um6: float
    arc_um3: float
    crater_depth_um: float  # up to which older ones have been forgotten
    # generator, sensors, stages
    next_pulse_ns: int
    pulse_starts: int  # of the drive, as far as they were followed
    contact_tests: int
    walk_um: float
    stage_error_x_um: float  # where the stages really are, less where they report to be
    stage_error_y_um: float
    stage_way_um: float  # gone since the plant last looked
    line_error_x_um: Array = series(PATH_LINES)  # at the end of each line
    line_error_y_um: Array = series(PATH_LINES)
    # places in the blocks of random numbers
    random_at: int
    noise_at: int


@record
class Machine(Record):
    """Where everything is that the plant in C needs. A copy has no addresses: its parts are elsewhere."""

    unit: int = address("const struct unit *")
    plant: int = address("struct plant *")
    scope: int = address("struct scope *")
    drive: int = address("struct drive *")
    readings: int = address("struct readings *")
    decide: int = address("const double *")  # random numbers, one a pulse
    shape: int = address("const double *")
    delay: int = address("const double *")
    noise: int = address("const double *")  # of the sensors
    half_normal: int = address("const double *")  # equally likely values
    lognormal: int = address("const double *")
    level_um: int = address("const double *")  # what lies under the tool: the table of a footprint
    level_share: int = address("const double *")
    level_rarity: int = address("const double *")

    def __deepcopy__(self, _: object) -> Machine:
        return Machine()


@record
class Cells(Record):
    """Cells of the work under a tool, square arrays of `size` rows."""

    size: int
    thickness_um: float
    cells: int = address("double *")  # depths
    effective: int = address("double *")
    weights: int = address("double *")
    under: int = address("double *")


@record
class Scope(Record):
    """The newest pulses, as an oscilloscope at the gap would know them; a ring."""

    at: int  # pulses so far
    start_ns: Array = series(SCOPE_PULSES)
    delay_us: Array = series(SCOPE_PULSES)
    discharge_us: Array = series(SCOPE_PULSES)
    plateau_v: Array = series(SCOPE_PULSES)
    siemens: Array = series(SCOPE_PULSES)
    leak_a: Array = series(SCOPE_PULSES)
    stuck_v: Array = series(SCOPE_PULSES)
