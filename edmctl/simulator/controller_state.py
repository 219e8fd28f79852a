"""What the controller is told to do, and what it remembers from tick to tick: all that a board could know."""

from __future__ import annotations

from edmctl.array_types import Array
from edmctl.simulator.plant_interface import PATH_LINES
from edmctl.simulator.records import Record, record, series

# What moves.
(
    HOLD,
    RAMP,
    APPROACH,
    SERVO,
    JUMP_UP,
    JUMP_DWELL,
    JUMP_DOWN,
    JUMP_RETURN,
    TOUCH_FAST,
    TOUCH_SLOW,
    TOUCH_HUNT,
    TOUCH_BACK,
    TEST_OFF,
    TEST_ON,
) = range(14)

# What happened.
(
    NOTHING,
    RAMP_DONE,
    SPARK_FOUND,
    CUT_DONE,
    TIME_UP,
    JUMP_RESUMED,
    JUMP_DONE,
    TOUCHED,
    TOUCHES_DONE,
    FAULT_TRAVEL,
    FAULT_NO_CONTACT,
    FAULT_STUCK_CONTACT,
    FAULT_SHORT,
    FAULT_ARC,
    FAULT_NO_SPARK,
    FAULT_COLLISION,
    FAULT_TRACK,
    FAULT_MONITOR,
    FAULT_GAP_SENSOR,
    FAULT_GENERATOR,
    FAULT_MODE_SWITCH,
    TESTED,
    PATH_DONE,
) = range(23)

OPEN, NORMAL, ARC, SHORT = range(4)
PACK = 12  # bits of the count of one pulse class; four of them fit into a float exactly
LOG_OFF, LOG_BLOCKS, LOG_FULL = range(3)
RELAY, PI_LAW = range(2)
DISPLACEMENT_FAILED_UM = 2e6  # what a failed reading counts as: no displacement is that far
HISTORY = 64  # servo decisions remembered, for latency; a power of two


@record
class Settings(Record):
    """What the host has set, made ready for the tick. The first ones are parameters of the link by their names."""

    piezo_max_v: float
    slew_limit_v_s: float
    forward_um_s: float
    back_um_s: float
    short_back_um_s: float
    hysteresis: float
    kp_um_s: float
    ki_um_s2: float
    short_v: float  # a plateau below this is a short
    arc_v: float  # a plateau below this at once after ignition is an arc
    arc_delay_us: float
    open_lost_um: float
    monitor_min_v: float
    monitor_max_v: float
    over_current: float
    v_per_um: float
    sensor_missing: int  # 1: displacements are the mean gain times the voltage applied
    filter_alpha: float
    displacement_alpha: float
    track_v: float
    track_ticks_max: int
    misreads_max: int
    law: int
    servo_ticks: int
    latency_decisions: int  # how old the value is that a decision acts on
    short_ticks_max: int
    arc_run_max: int
    open_ticks_max: int
    # generator
    open_v: float
    pulse_period_ns: int
    nominal_siemens: float
    duty_v: float  # mean gap voltage of an all-open gap: duty × open voltage
    per_duty_v: float
    # telemetry
    block_size: int  # pulses
    pulse_log: int
    tlm_ticks: int


@record
class LoopState(Record):
    """What the controller has measured, judged and begun."""

    # command
    command_v: float
    target_v: float
    ramp_v_s: float
    feeds: int  # 1: a ramp towards the work
    rate_v_s: float  # of the servo
    slewed: int
    limit_ticks: int
    # measured
    displacement_um: float
    slow_displacement_um: float  # low-passed
    gap_v: float  # low-passed mean gap voltage
    tick_gap_v: float  # mean gap voltage of the last millisecond
    shorted: int
    silent_ticks: int  # since the last pulse
    stray_ticks: int  # in a row with pulses although the gate is shut
    sparkless_ticks: int  # since the last millisecond with sparks, while pulses are on
    short_ticks: int
    open_ticks: int
    arc_run: int
    misreads: int  # pulses in a row whose voltage cannot be
    last_spark_um: float
    track_ticks: int
    track_at: int  # last tick with the voltage off its command
    watched: int  # 1 while armed: monitors count
    # motion
    mode: int
    phase: int  # ticks since the mode began
    phase_ticks: int
    dwell_ticks: int
    fast_v_s: float
    slow_v_s: float
    z_max_um: float
    # servo
    gap_ref_v: float
    integral_um_s: float
    servo_count: int
    direction: int
    z_limit_um: float
    time_ticks: int
    start_z_um: float
    history: Array = series(HISTORY)  # normalised gap voltages, a ring
    # jump
    start_v: float
    jump_v: float
    clearance_v: float
    jump_resumes: int
    # touch and self test
    fast_to_um: float
    back_v: float
    touch_v: float
    touch_sum: float
    touch_count: int
    touch_no: int
    touches_left: int
    contact_open_ticks: int  # at rest after a back-off, in a row without contact
    test_off_v: float  # mean gap voltage of a self test, generator off
    # scan: the queue of lines is a ring
    scanning: int  # 1: the cut is held at its limit, and the stages follow the path
    path_at: int  # row of the line that they follow
    path_count: int  # lines in the queue, that one included
    path_x_um: Array = series(PATH_LINES)
    path_y_um: Array = series(PATH_LINES)
    path_speed_um_s: Array = series(PATH_LINES)
    path_z_um: Array = series(PATH_LINES)
    path_last: Array = series(PATH_LINES)  # 1: the path ends with it
    # telemetry
    link_state: int  # as the link names it
    tlm_next: int  # tick at whose end the next sample is due; -1 = none
    tlm_n: int  # samples pending
    contact: int  # 1: the contact circuit was closed in a millisecond of the running sample
    charge_uc: float  # of that sample
    sample_counts: int  # of its pulses, packed as tick_counts
    tick_counts: int  # pulses of the last millisecond: PACK bits a class, in the order of PulseClass
    pulse_no: int
    log_n: int  # pulse or block records pending
    log_pulse_no: int  # of the first one
    log_t0_ns: int
    block_count: int  # pulses in the block begun
    block_counts: int  # of them, packed by class
    delay_sum_us: float
    energy_sum_uj: float
