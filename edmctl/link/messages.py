"""Messages of EDM Link 1.5.

Made from tools/generate/edmlink1.toml and faults.toml by `python -m tools.generate`; edit those files.
Fields carry physical values; the comment beside each says type and size of one count on the wire.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from struct import pack
from zlib import crc32

from edmctl.dataclasses import dataclass
from edmctl.link.wire import Ack, Message, Param, Request

PROTO_MAJOR = 1
PROTO_MINOR = 5
SCHEMA_HASH = 0x55BBB4D4


class State(IntEnum):
    """State of the controller."""

    BOOT = 0
    IDLE = 1
    ARMED = 2
    APPROACH = 3
    MACHINING = 4
    JUMP = 5
    TOUCH = 6
    MOVING = 7
    FAULT = 8
    ESTOP = 9


class Status(IntEnum):
    """Status byte of a reply."""

    OK = 0
    BUSY = 1
    BAD_STATE = 2
    UNKNOWN_TYPE = 3
    BAD_LENGTH = 4
    OUT_OF_RANGE = 5
    NOT_CALIBRATED = 6
    INTERLOCK = 7
    PROFILE_MISMATCH = 8
    RATE_TOO_HIGH = 9
    BAD_SESSION = 10
    VERSION = 11
    NO_CONTACT = 12
    INTERNAL = 255


class PulseClass(IntEnum):
    """Class of one pulse, judged by the controller from ignition delay and plateau voltage."""

    OPEN = 0
    NORMAL = 1
    ARC = 2
    SHORT = 3


class Axis(IntEnum):
    """Stage axis; linear targets are nm, the rotary target is millidegrees."""

    X = 0
    Y = 1
    THETA = 2


class ServoLaw(IntEnum):
    """Law of the gap servo."""

    RELAY = 0
    PI = 1


class PulseMode(IntEnum):
    """Isofrequency: fixed on-time. Isopulse: fixed discharge time after ignition."""

    ISOFREQUENCY = 0
    ISOPULSE = 1


class PulseLog(IntEnum):
    """What TLM_START sends of the pulses."""

    OFF = 0
    BLOCKS = 1
    FULL = 2


class EventCode(IntEnum):
    """Code of an EVENT."""

    MOVE_DONE = 1
    STAGE_DONE = 2
    APPROACH_DONE = 3
    CUT_DONE = 4
    JUMP_DONE = 5
    TOUCH = 6
    TOUCH_DONE = 7
    TIME_UP = 8
    STOPPED = 9
    TEST_DONE = 10
    PATH_DONE = 11


class ResetCause(IntEnum):
    """Why the controller started."""

    POWER_ON = 0
    COMMANDED = 1
    WATCHDOG = 2
    BROWN_OUT = 3
    EXTERNAL = 4


class Clock(IntEnum):
    """What the controller's time follows: a clock as on every board, or the host's ADVANCE (simulated ones only)."""

    RUNNING = 0
    DRIVEN = 1


class TlmFlags(IntFlag):
    """Flags of a TLM sample."""

    PULSES_ON = 1
    CONTACT = 2
    ADVANCING = 4
    SHORTED = 8
    AT_LIMIT = 16
    SLEW_LIMITED = 32


class Interlocks(IntFlag):
    """Interlock inputs; a set bit stops the machine."""

    ESTOP = 1
    DOOR = 2
    DIELECTRIC_LEVEL = 4
    DIELECTRIC_FLOW = 8
    DIELECTRIC_HOT = 16
    HV_SUPPLY = 32


class FaultCode(IntEnum):
    """Code of a fault; those from 7000 on are the host's own."""

    HOST_SILENT = 1001
    ABORT_RUN = 1002
    LINE_NOISE = 1003
    TRAVEL_LIMIT = 2001
    PIEZO_TRACK = 2002
    PIEZO_OV = 2003
    STAGE_LIMIT = 2004
    NO_CONTACT = 2005
    STUCK_CONTACT = 2006
    COLLISION = 2007
    SHORT_STUCK = 3001
    ARC_BURN = 3002
    GAP_SENSOR = 3003
    GEN_FAULT = 3004
    NO_SPARK = 3005
    MODE_SWITCH = 3006
    ESTOP = 4001
    DOOR = 4002
    DIELECTRIC = 4003
    HV_SUPPLY = 4004
    RESET = 5001
    Z_MISMATCH = 7001
    STROKE_END = 7002
    STALL = 7003
    TIMEOUT = 7004
    SETUP = 7005
    LOG = 7006
    POWER_LOSS = 7007
    SAMPLES_LOST = 7008
    TELEMETRY_WRONG = 7009


@dataclass(slots=True)
class HelloReply(Message):
    ID, NAME = 0x01, "HELLO_REPLY"
    WIRE = "u8 u8 u32 u32 u8 u8 u8 u32 s12 u16 u16 u16 u8 u32 u8 u16 u8 u8 u32"
    proto_major: int  # u8
    proto_minor: int  # u8
    host_nonce: int  # u32
    schema_hash: int  # u32
    fw_major: int  # u8
    fw_minor: int  # u8
    fw_patch: int  # u8
    git: int  # u32: first eight digits of the commit, 0 where unknown
    serial: str  # s12: ASCII, zero padded
    board: int  # u16: 0 = virtual controller
    servo_hz: int  # u16 Hz: ticks of the servo a second
    tlm_max_hz: int  # u16 Hz
    rx_window: int  # u8: commands that may be outstanding
    boot_count: int  # u32
    reset_cause: int  # u8: ResetCause
    fault: int  # u16: latched fault, 0 = none
    state: int  # u8: State
    clock: int  # u8: Clock
    baud: int  # u32 Bd: of the line, 0 = the line has none


@dataclass(slots=True)
class Hello(Request[HelloReply]):
    """Opens a session. Allowed in every state; the session byte of the frame becomes the session."""

    ID, NAME = 0x01, "HELLO"
    REPLY = HelloReply
    WIRE = "u8 u8 u32 u32"
    proto_major: int  # u8
    proto_minor: int  # u8
    host_nonce: int  # u32: echoed
    schema_hash: int  # u32: CRC-32 of the canonical schema


@dataclass(slots=True)
class HeartbeatReply(Message):
    ID, NAME = 0x02, "HEARTBEAT_REPLY"
    WIRE = "u64 u64 u8 u16 u16 u16"
    t_host_us: int  # u64 us: echoed
    t_dev_us: int  # u64 us: controller time
    state: int  # u8: State
    fault: int  # u16
    rx_bad: int  # u16: frames dropped for a bad check, modulo 65536
    rx_drop: int  # u16: frames dropped for another session or as no command, modulo 65536


@dataclass(slots=True)
class Heartbeat(Request[HeartbeatReply]):
    """Feeds the watchdog if t_host_us is later than in every one before, and acknowledges events up to
    last_event. Never retried.
    """

    ID, NAME = 0x02, "HEARTBEAT"
    REPLY = HeartbeatReply
    WIRE = "u64 u16"
    t_host_us: int  # u64 us
    last_event: int  # u16


@dataclass(slots=True)
class GetSchemaReply(Message):
    ID, NAME = 0x03, "GET_SCHEMA_REPLY"
    WIRE = "u16 u8 records"
    RECORD = (("data", "u8", 1),)
    total: int  # u16: bytes of the whole
    n: int  # u8: bytes in this reply, 0 behind the end
    records: bytes  # n × 1 bytes, see RECORD


@dataclass(slots=True)
class GetSchema(Request[GetSchemaReply]):
    """Part of the canonical schema from `offset` on: JSON compressed with zlib. This layout never changes, so
    that hosts of any version can tell what differs.
    """

    ID, NAME = 0x03, "GET_SCHEMA"
    REPLY = GetSchemaReply
    WIRE = "u16"
    offset: int  # u16: bytes


@dataclass(slots=True)
class AdvanceReply(Message):
    ID, NAME = 0x05, "ADVANCE_REPLY"
    WIRE = "u64"
    t_dev_us: int  # u64 us: controller time


@dataclass(slots=True)
class Advance(Request[AdvanceReply]):
    """Lets time pass on a controller whose Clock is DRIVEN, until it has something to send that cannot wait,
    at most timeout_us. What it has to send goes before the reply. Other controllers answer UNKNOWN_TYPE.
    Never retried.
    """

    ID, NAME = 0x05, "ADVANCE"
    REPLY = AdvanceReply
    WIRE = "u32"
    timeout_us: int  # u32 us


@dataclass(slots=True)
class GetStatusReply(Message):
    ID, NAME = 0x04, "GET_STATUS_REPLY"
    WIRE = "u8 u16 u16 i32/1000 i32/1000 i32/1000 i32/1000 u16/400 u16/200 i16/10 u16/100 i16/100 u8"
    state: int  # u8: State
    fault: int  # u16
    interlocks: int  # u16: Interlocks bits
    displacement_um: float  # i32 × 0.001 um: inductive sensor, + towards the work
    x_um: float  # i32 × 0.001 um
    y_um: float  # i32 × 0.001 um
    theta_deg: float  # i32 × 0.001 deg
    actuator_v: float  # u16 × 0.0025 V
    gap_v: float  # u16 × 0.005 V: filtered mean gap voltage
    temperature_c: float  # i16 × 0.1 degC: dielectric
    flow_lpm: float  # u16 × 0.01 L/min: dielectric
    monitor_v: float  # i16 × 0.01 V: voltage monitor of the actuator's amplifier
    flags: int  # u8: TlmFlags


class GetStatus(Request[GetStatusReply]):
    """Everything the controller can see now."""

    ID, NAME = 0x04, "GET_STATUS"
    REPLY = GetStatusReply


@dataclass(slots=True)
class Arm(Request[Ack]):
    """IDLE to ARMED: starts the watchdog. Refused unless param_crc equals that of the committed parameters
    and every interlock is closed.
    """

    ID, NAME = 0x08, "ARM"
    WIRE = "u32"
    param_crc: int  # u32


class Disarm(Request[Ack]):
    """Pulses off, actuator ramped to 0 V, then IDLE. Answered at once; MOVE_DONE follows."""

    ID, NAME = 0x09, "DISARM"


@dataclass(slots=True)
class ClearFault(Request[Ack]):
    """Leaves FAULT for IDLE; must name the latched code. BUSY until the retreat has ended, and while more
    than 30 events wait.
    """

    ID, NAME = 0x0A, "CLEAR_FAULT"
    WIRE = "u16"
    fault: int  # u16


@dataclass(slots=True)
class SetParam(Request[Ack]):
    """Stages one parameter. IDLE only."""

    ID, NAME = 0x0B, "SET_PARAM"
    WIRE = "u16 i32"
    param: int  # u16
    value: int  # i32: in the parameter's own unit


@dataclass(slots=True)
class GetParamReply(Message):
    ID, NAME = 0x0C, "GET_PARAM_REPLY"
    WIRE = "i32"
    value: int  # i32


@dataclass(slots=True)
class GetParam(Request[GetParamReply]):
    """Reads one parameter."""

    ID, NAME = 0x0C, "GET_PARAM"
    REPLY = GetParamReply
    WIRE = "u16"
    param: int  # u16


@dataclass(slots=True)
class CommitProfile(Request[Ack]):
    """Makes the staged parameters current if the CRC-32 over all parameters (id u16, value i32, ascending id)
    agrees.
    """

    ID, NAME = 0x0D, "COMMIT_PROFILE"
    WIRE = "u32"
    crc: int  # u32


@dataclass(slots=True)
class PiezoSet(Request[Ack]):
    """Ramps the actuator. ARMED only; ends with MOVE_DONE."""

    ID, NAME = 0x10, "PIEZO_SET"
    WIRE = "u16/400 u32/1000"
    actuator_v: float  # u16 × 0.0025 V
    slew_v_s: float  # u32 × 0.001 V/s


@dataclass(slots=True)
class StageMove(Request[Ack]):
    """Absolute stage move. ARMED only, tool retracted below safe_z_um; ends with STAGE_DONE."""

    ID, NAME = 0x11, "STAGE_MOVE"
    WIRE = "u8 i32 u32"
    axis: int  # u8: Axis
    target: int  # i32: nm, or millidegrees for THETA
    speed: int  # u32: nm/s, or millidegrees/s


class StageStop(Request[Ack]):
    """Stops a stage that moves; GET_STATUS tells where. Ends with STOPPED."""

    ID, NAME = 0x12, "STAGE_STOP"


@dataclass(slots=True)
class SetZero(Request[Ack]):
    """From now until the next ARM safe_z_um counts from this displacement, which is where the host takes the
    tool's home at 0 V to be. ARMED with the actuator at rest at 0 V; OUT_OF_RANGE where the controller's own
    reading is more than 5 um below or 25 um above.
    """

    ID, NAME = 0x13, "SET_ZERO"
    WIRE = "i32/1000"
    zero_um: float  # i32 × 0.001 um


@dataclass(slots=True)
class Approach(Request[Ack]):
    """Pulses on, actuator advances until the filtered mean gap voltage falls to gap_ref_v. Ends with
    APPROACH_DONE, pulses off, tool held.
    """

    ID, NAME = 0x18, "APPROACH"
    WIRE = "u32/1000 u32/1000 u16/200"
    speed_um_s: float  # u32 × 0.001 um/s
    max_travel_um: float  # u32 × 0.001 um: further without a spark: fault 3005
    gap_ref_v: float  # u16 × 0.005 V


@dataclass(slots=True)
class ServoStart(Request[Ack]):
    """Gap servo until the filtered displacement reaches z_limit_um (CUT_DONE) or max_time_s passes (TIME_UP);
    then pulses off, tool held.
    """

    ID, NAME = 0x19, "SERVO_START"
    WIRE = "u16/200 i32/1000 u32/1000"
    gap_ref_v: float  # u16 × 0.005 V
    z_limit_um: float  # i32 × 0.001 um
    max_time_s: float  # u32 × 0.001 s


class ServoStop(Request[Ack]):
    """Ends approach, servo, jump or touch: pulses off, tool held, ARMED. Ends with STOPPED."""

    ID, NAME = 0x1A, "SERVO_STOP"


@dataclass(slots=True)
class Jump(Request[Ack]):
    """Pulses off, retract by height, dwell, return to clearance above the start point, then the servo goes
    on. MACHINING (or ARMED, without a servo). Ends with JUMP_DONE. Lengths and speed are volts by
    gain_um_per_v: a host with an actuator model sends the volts of the jump it wants times that gain.
    """

    ID, NAME = 0x1B, "JUMP"
    WIRE = "u32/1000 u32/1000 u16/1000 u32/1000"
    height_um: float  # u32 × 0.001 um
    speed_um_s: float  # u32 × 0.001 um/s
    dwell_s: float  # u16 × 0.001 s
    clearance_um: float  # u32 × 0.001 um


@dataclass(slots=True)
class TouchOff(Request[Ack]):
    """Measure mode. Fast to fast_to_um, then slow until contact; on contact the slope flips and the tool
    hunts for dwell_s; n touches with a back-off between. One TOUCH event each, then TOUCH_DONE and a retract
    by back-off.
    """

    ID, NAME = 0x1C, "TOUCH_OFF"
    WIRE = "u32/1000 i32/1000 u32/1000 i32/1000 u32/1000 u16/1000 u8"
    fast_um_s: float  # u32 × 0.001 um/s
    fast_to_um: float  # i32 × 0.001 um: displacement where the fast leg ends
    speed_um_s: float  # u32 × 0.001 um/s
    z_max_um: float  # i32 × 0.001 um: no contact up to here: fault 2005
    back_off_um: float  # u32 × 0.001 um
    dwell_s: float  # u16 × 0.001 s
    touches: int  # u8


class SelfTest(Request[Ack]):
    """Tests the gap sensor with the tool retracted: the mean gap voltage must be zero with the generator off,
    and duty x open voltage with it on, within test_error of the latter; else fault 3003. ARMED with the
    actuator at 0 V and pulses enabled; ends with TEST_DONE.
    """

    ID, NAME = 0x1D, "SELF_TEST"


@dataclass(slots=True)
class ScanStart(Request[Ack]):
    """Gap servo as in SERVO_START, but a tool that reaches z_limit_um is held there and the cut goes on,
    while the stages follow the lines of PATH_MOVE. Ends after the line marked last (PATH_DONE) or when
    max_time_s passes (TIME_UP); then pulses off, tool held.
    """

    ID, NAME = 0x1E, "SCAN_START"
    WIRE = "u16/200 i32/1000 u32/1000"
    gap_ref_v: float  # u16 × 0.005 V
    z_limit_um: float  # i32 × 0.001 um
    max_time_s: float  # u32 × 0.001 s


@dataclass(slots=True)
class PathMove(Request[Ack]):
    """Appends a straight line of the X and Y stages together, from where the line before it ends, to a queue
    of 16; BUSY when the queue is full. MACHINING after SCAN_START only, and not after the line marked last.
    On the way the limit of the scan goes linearly to z_limit_um. The stages stand still while the gap is
    shorted or a JUMP runs.
    """

    ID, NAME = 0x1F, "PATH_MOVE"
    WIRE = "i32/1000 i32/1000 u32/1000 i32/1000 u8"
    x_um: float  # i32 × 0.001 um: end of the line
    y_um: float  # i32 × 0.001 um
    speed_um_s: float  # u32 × 0.001 um/s: along the line
    z_limit_um: float  # i32 × 0.001 um: limit of the displacement at its end
    last: int  # u8: 1: the scan ends with this line


@dataclass(slots=True)
class PulseConfig(Request[Ack]):
    """Sets the generator. Pulses must be off. OUT_OF_RANGE for a period below 20 us or above 1 s, and for
    what the generator cannot do.
    """

    ID, NAME = 0x20, "PULSE_CONFIG"
    WIRE = "u32/1000 u32/1000 u16/200 u16/1000 u8 u32/1000"
    on_time_us: float  # u32 × 0.001 us
    off_time_us: float  # u32 × 0.001 us
    open_voltage_v: float  # u16 × 0.005 V
    peak_current_a: float  # u16 × 0.001 A
    mode: int  # u8: PulseMode
    discharge_us: float  # u32 × 0.001 us: ISOPULSE only, and not 0 there


@dataclass(slots=True)
class PulseEnable(Request[Ack]):
    """Permits pulses. They flow in APPROACH and MACHINING only. DISARM, faults and resets end the permission,
    the end of a cut does not.
    """

    ID, NAME = 0x21, "PULSE_ENABLE"
    WIRE = "u8"
    on: int  # u8


@dataclass(slots=True)
class TlmStart(Request[Ack]):
    """Starts telemetry; refused with RATE_TOO_HIGH where the line cannot carry it, OUT_OF_RANGE where a
    period holds more than 255 pulses.
    """

    ID, NAME = 0x28, "TLM_START"
    WIRE = "u16 u8 u8"
    period_us: int  # u16 us
    batch: int  # u8: samples per frame, 1..14
    pulse_log: int  # u8: PulseLog


class TlmStop(Request[Ack]):
    """Stops telemetry; what is pending is sent first."""

    ID, NAME = 0x29, "TLM_STOP"


@dataclass(slots=True)
class BlackboxReadReply(Message):
    ID, NAME = 0x30, "BLACKBOX_READ_REPLY"
    WIRE = "u16 u32 u8 records"
    RECORD = (
        ("displacement_um", "i32", 0.001),
        ("actuator_v", "u16", 0.0025),
        ("gap_v", "u16", 0.005),
        ("current_a", "u16", 0.001),
        ("n_normal", "u8", 1),
        ("n_arc", "u8", 1),
        ("n_short", "u8", 1),
        ("n_open", "u8", 1),
        ("state", "u8", 1),
        ("flags", "u8", 1),
    )
    total: int  # u16: samples held, at most 2048; 500 at least after 0.5 s
    t0_us: int  # u32 us: time of the first sample of this reply, modulo 2^32
    n: int  # u8: samples in this reply, 0 behind the end
    records: bytes  # n × 16 bytes, see RECORD


@dataclass(slots=True)
class BlackboxRead(Request[BlackboxReadReply]):
    """Servo samples of every millisecond up to the latched fault, frozen by it, oldest first. Without a
    fault: up to now. Samples are those of TLM. CLEAR_FAULT begins anew.
    """

    ID, NAME = 0x30, "BLACKBOX_READ"
    REPLY = BlackboxReadReply
    WIRE = "u16"
    offset: int  # u16: samples


@dataclass(slots=True)
class WaveformReadReply(Message):
    ID, NAME = 0x31, "WAVEFORM_READ_REPLY"
    WIRE = "u32 u32 u32 u8 records"
    RECORD = (
        ("gap_v", "i16", 0.01),
        ("current_a", "i16", 0.001),
    )
    total: int  # u32: samples held
    t0_us: int  # u32 us: time of sample 0, modulo 2^32
    period_ns: int  # u32 ns: from one sample to the next, at most 1000
    n: int  # u8: samples in this reply, at most 58, 0 behind the end
    records: bytes  # n × 4 bytes, see RECORD


@dataclass(slots=True)
class WaveformRead(Request[WaveformReadReply]):
    """Gap voltage and gap current about the latched fault, sample by sample, oldest first: from up to 64
    pulses before it to 16 pulse periods after it. BUSY until those have passed. A memory that is shorter
    holds less, a fifth of it after the fault. total is 0 without a fault, where no pulse came shortly before
    it, and from controllers that keep no waveforms.
    """

    ID, NAME = 0x31, "WAVEFORM_READ"
    REPLY = WaveformReadReply
    WIRE = "u32"
    offset: int  # u32: samples


@dataclass(slots=True)
class Reboot(Request[Ack]):
    """Restarts the controller as a reset does, after the reply; BOOT follows. Refused while armed."""

    ID, NAME = 0x3F, "REBOOT"
    WIRE = "u32"
    magic: int  # u32: 0x0B007EDB


@dataclass(slots=True)
class Tlm(Message):
    """Servo samples. counter counts frames, so gaps are exact."""

    ID, NAME = 0x80, "TLM"
    WIRE = "u16 u32 u16 u8 u8 records"
    RECORD = (
        ("displacement_um", "i32", 0.001),
        ("actuator_v", "u16", 0.0025),
        ("gap_v", "u16", 0.005),
        ("current_a", "u16", 0.001),
        ("n_normal", "u8", 1),
        ("n_arc", "u8", 1),
        ("n_short", "u8", 1),
        ("n_open", "u8", 1),
        ("state", "u8", 1),
        ("flags", "u8", 1),
    )
    counter: int  # u16
    t0_us: int  # u32 us: time of the first sample, modulo 2^32
    period_us: int  # u16 us
    n: int  # u8
    dropped: int  # u8
    records: bytes  # n × 16 bytes, see RECORD


@dataclass(slots=True)
class Event(Message):
    """Repeated until acknowledged by HEARTBEAT.last_event."""

    ID, NAME = 0x81, "EVENT"
    WIRE = "u16 u32 u16 i32 i32/1000 u16/400"
    event_no: int  # u16
    t_us: int  # u32 us: modulo 2^32
    code: int  # u16: EventCode
    # i32: TOUCH: number of the touch; TEST_DONE: mean gap voltage with the generator on, mV; otherwise 0
    arg: int
    # i32 × 0.001 um: TOUCH: mean of the sensor while hunting; otherwise the sensor now
    displacement_um: float
    actuator_v: float  # u16 × 0.0025 V: TOUCH: peak command at first contact


@dataclass(slots=True)
class Fault(Message):
    """Repeated until acknowledged by HEARTBEAT.last_event."""

    ID, NAME = 0x82, "FAULT"
    WIRE = "u16 u32 u16 i32 i32/1000 u16/200"
    event_no: int  # u16
    t_us: int  # u32 us
    code: int  # u16: of the table of faults
    detail: int  # i32: as the page says
    displacement_um: float  # i32 × 0.001 um
    gap_v: float  # u16 × 0.005 V


@dataclass(slots=True)
class Log(Message):
    """Text for people."""

    ID, NAME = 0x83, "LOG"
    WIRE = "u8 utf8"
    level: int  # u8: 0 information, 1 warning, 2 error
    text: str  # utf8: to the end of the payload


@dataclass(slots=True)
class Boot(Message):
    """Sent once after a reset; every session is gone."""

    ID, NAME = 0x84, "BOOT"
    WIRE = "u8 u32"
    reset_cause: int  # u8: ResetCause
    boot_count: int  # u32


@dataclass(slots=True)
class PulseBlocks(Message):
    """Sums over blocks of block_pulses pulses."""

    ID, NAME = 0x85, "PULSE_BLOCKS"
    WIRE = "u16 u32 u32 u32 u8 u8 records"
    RECORD = (
        ("n_open", "u8", 1),
        ("n_normal", "u8", 1),
        ("n_arc", "u8", 1),
        ("n_short", "u8", 1),
        ("delay_us", "u32", 0.1),
        ("energy_uj", "u32", 0.1),
    )
    counter: int  # u16
    pulse_no: int  # u32: number of the first pulse
    t0_us: int  # u32 us: time of the first pulse, modulo 2^32
    period_ns: int  # u32 ns: pulse period
    block_pulses: int  # u8
    n: int  # u8: blocks
    records: bytes  # n × 12 bytes, see RECORD


@dataclass(slots=True)
class Pulses(Message):
    """Every pulse."""

    ID, NAME = 0x86, "PULSES"
    WIRE = "u16 u32 u32 u32 u8 records"
    RECORD = (
        ("pulse_class", "u8", 1),
        ("delay_us", "u16", 0.1),
        ("discharge_us", "u16", 0.1),
        ("plateau_v", "u8", 0.5),
    )
    counter: int  # u16
    pulse_no: int  # u32: number of the first pulse
    t0_us: int  # u32 us: time of the first pulse, modulo 2^32
    period_ns: int  # u32 ns: pulse period
    n: int  # u8
    records: bytes  # n × 6 bytes, see RECORD


REQUESTS: dict[int, type[Request[Message]]] = {
    kind.ID: kind
    for kind in (
        Hello,
        Heartbeat,
        GetSchema,
        Advance,
        GetStatus,
        Arm,
        Disarm,
        ClearFault,
        SetParam,
        GetParam,
        CommitProfile,
        PiezoSet,
        StageMove,
        StageStop,
        SetZero,
        Approach,
        ServoStart,
        ServoStop,
        Jump,
        TouchOff,
        SelfTest,
        ScanStart,
        PathMove,
        PulseConfig,
        PulseEnable,
        TlmStart,
        TlmStop,
        BlackboxRead,
        WaveformRead,
        Reboot,
    )
}
"""Commands by id; on the wire the type of a reply is that id | 0x40."""

UNSOLICITED: dict[int, type[Message]] = {
    kind.ID: kind for kind in (Tlm, Event, Fault, Log, Boot, PulseBlocks, Pulses)
}
"""What the controller sends by itself, by id."""

PARAMS = {
    param.name: param
    for param in (
        Param(1, "piezo_max_v", "V", 0.001, 120, 0, 150),
        Param(2, "slew_limit_v_s", "V/s", 0.001, 1000, 1, 20000),
        Param(3, "gain_um_per_v", "um/V", 1e-06, 2.967, 0.1, 20),
        Param(4, "safe_z_um", "um", 0.001, 20, -100, 500),
        Param(5, "retract_v_s", "V/s", 0.001, 337, 1, 20000),
        Param(6, "sensor_fitted", "", 1, 1, 0, 1),
        Param(10, "servo_law", "", 1, 0, 0, 1),
        Param(11, "forward_um_s", "um/s", 0.001, 5, 0.05, 500),
        Param(12, "back_um_s", "um/s", 0.001, 5, 0.05, 500),
        Param(13, "short_back_um_s", "um/s", 0.001, 50, 0.05, 5000),
        Param(14, "filter_hz", "Hz", 0.001, 20, 0.1, 1000),
        Param(15, "hysteresis", "", 0.0001, 0.02, 0, 0.2),
        Param(16, "kp_um_s", "um/s", 0.001, 20, 0, 1000),
        Param(17, "ki_um_s2", "um/s2", 0.001, 20, 0, 10000),
        Param(18, "servo_period_us", "us", 1, 1000, 500, 200000),
        Param(19, "servo_latency", "", 1, 1, 0, 50),
        Param(20, "short_v", "V", 0.001, 6, 0.1, 60),
        Param(21, "arc_v", "V", 0.001, 19.5, 0.1, 120),
        Param(22, "arc_delay_us", "us", 0.001, 3, 0, 1000),
        Param(23, "block_pulses", "", 1, 23, 1, 255),
        Param(30, "short_stuck_s", "s", 0.001, 3, 0.05, 60),
        Param(31, "arc_run", "", 1, 60, 5, 10000),
        Param(32, "open_lost_um", "um", 0.001, 15, 1, 500),
        Param(33, "open_lost_s", "s", 0.001, 10, 0.1, 3600),
        Param(40, "watchdog_s", "s", 0.001, 0.25, 0.1, 1),
        Param(41, "dielectric_required", "", 1, 1, 0, 1),
        Param(42, "flow_min_lpm", "L/min", 0.001, 0.5, 0, 100),
        Param(43, "temperature_max_c", "degC", 0.001, 30, 0, 100),
        Param(50, "monitor_min_v", "V", 0.001, -5, -50, 0),
        Param(51, "monitor_max_v", "V", 0.001, 150.5, 1, 200),
        Param(52, "track_error", "", 0.0001, 0.03, 0.001, 1),
        Param(53, "track_s", "s", 0.001, 0.05, 0.001, 10),
        Param(54, "misread_pulses", "", 1, 50, 5, 10000),
        Param(55, "over_current", "", 0.01, 1.5, 1.05, 10),
        Param(56, "bad_frames", "", 1, 10, 2, 1000),
        Param(57, "test_error", "", 0.001, 0.05, 0.001, 1),
    )
}
"""Parameters of the controller by name."""


def param_crc(values: Mapping[str, float]) -> int:
    """Return the CRC-32 over all parameters (id u16, value i32, ascending id) that the controller checks.

    Parameters missing from `values` count with their defaults. An unknown name or a value out of range raises
    ValueError.
    """
    unknown = sorted(values.keys() - PARAMS.keys())
    if unknown:
        raise ValueError(f"no such parameter: {', '.join(unknown)}")
    crc = 0
    for param in sorted(PARAMS.values(), key=lambda p: p.id):
        crc = crc32(pack("<Hi", param.id, param.to_wire(values.get(param.name, param.default))), crc)
    return crc
