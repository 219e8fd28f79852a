"""Messages of EDM Link 1.5.

Made from edmlink1.toml by `python -m edmctl.link.generate`; edit that file, not this one.
Fields carry physical values; the comment beside each says type and size of one count on the wire.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import cache
from struct import Struct
from typing import TYPE_CHECKING, ClassVar, Self
from zlib import crc32

from edmctl.link.wire import (
    MISFIT,
    Message,
    ascii_bytes,
    checked_records,
    checked_text,
    misfit,
    wrong_length,
)
from edmctl.link.wire import Param as Param

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np

PROTO_MAJOR = 1
PROTO_MINOR = 5
SCHEMA_HASH = 0x55BBB4D4

_HELLO = Struct("<BBII")
_HELLO_REPLY = Struct("<BBIIBBBI12sHHHBIBHBBI")
_HEARTBEAT = Struct("<QH")
_HEARTBEAT_REPLY = Struct("<QQBHHH")
_GET_SCHEMA = Struct("<H")
_GET_SCHEMA_REPLY = Struct("<HB")
_ADVANCE = Struct("<I")
_ADVANCE_REPLY = Struct("<Q")
_GET_STATUS_REPLY = Struct("<BHHiiiiHHhHhB")
_ARM = Struct("<I")
_CLEAR_FAULT = Struct("<H")
_SET_PARAM = Struct("<Hi")
_GET_PARAM = Struct("<H")
_GET_PARAM_REPLY = Struct("<i")
_COMMIT_PROFILE = Struct("<I")
_PIEZO_SET = Struct("<HI")
_STAGE_MOVE = Struct("<BiI")
_SET_ZERO = Struct("<i")
_APPROACH = Struct("<IIH")
_SERVO_START = Struct("<HiI")
_JUMP = Struct("<IIHI")
_TOUCH_OFF = Struct("<IiIiIHB")
_SCAN_START = Struct("<HiI")
_PATH_MOVE = Struct("<iiIiB")
_PULSE_CONFIG = Struct("<IIHHBI")
_PULSE_ENABLE = Struct("<B")
_TLM_START = Struct("<HBB")
_BLACKBOX_READ = Struct("<H")
_BLACKBOX_READ_REPLY = Struct("<HIB")
_WAVEFORM_READ = Struct("<I")
_WAVEFORM_READ_REPLY = Struct("<IIIB")
_REBOOT = Struct("<I")
_TLM = Struct("<HIHBB")
_EVENT = Struct("<HIHiiH")
_FAULT = Struct("<HIHiiH")
_LOG = Struct("<B")
_BOOT = Struct("<BI")
_PULSE_BLOCKS = Struct("<HIIIBB")
_PULSES = Struct("<HIIIB")
_PARAM = Struct("<Hi")


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


@dataclass(frozen=True, slots=True)
class Hello:
    """Opens a session. Allowed in every state; the session byte of the frame becomes the session."""

    ID: ClassVar[int] = 0x01
    NAME: ClassVar[str] = "HELLO"

    proto_major: int  # u8
    proto_minor: int  # u8
    host_nonce: int  # u32: echoed
    schema_hash: int  # u32: CRC-32 of the canonical schema

    def pack(self) -> bytes:
        try:
            return _HELLO.pack(self.proto_major, self.proto_minor, self.host_nonce, self.schema_hash)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 10:
            raise wrong_length("HELLO", 10, len(payload))
        return cls(*_HELLO.unpack(payload))

    def unpack_reply(self, payload: bytes) -> HelloReply:
        return HelloReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class HelloReply:
    """Reply to HELLO."""

    ID: ClassVar[int] = 0x01
    NAME: ClassVar[str] = "HELLO_REPLY"

    proto_major: int  # u8
    proto_minor: int  # u8
    host_nonce: int  # u32
    schema_hash: int  # u32
    fw_major: int  # u8
    fw_minor: int  # u8
    fw_patch: int  # u8
    git: int  # u32
    serial: str  # s12: ASCII, zero padded
    board: int  # u16: 0 = virtual controller
    servo_hz: int  # u16 Hz
    tlm_max_hz: int  # u16 Hz
    rx_window: int  # u8: commands that may be outstanding
    boot_count: int  # u32
    reset_cause: int  # u8: ResetCause
    fault: int  # u16: latched fault, 0 = none
    state: int  # u8: State
    clock: int  # u8: Clock
    baud: int  # u32 Bd: of the line, 0 = the line has none

    def pack(self) -> bytes:
        try:
            return _HELLO_REPLY.pack(
                self.proto_major,
                self.proto_minor,
                self.host_nonce,
                self.schema_hash,
                self.fw_major,
                self.fw_minor,
                self.fw_patch,
                self.git,
                ascii_bytes(self.serial, 12),
                self.board,
                self.servo_hz,
                self.tlm_max_hz,
                self.rx_window,
                self.boot_count,
                self.reset_cause,
                self.fault,
                self.state,
                self.clock,
                self.baud,
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 49:
            raise wrong_length("HELLO_REPLY", 49, len(payload))
        (
            proto_major,
            proto_minor,
            host_nonce,
            schema_hash,
            fw_major,
            fw_minor,
            fw_patch,
            git,
            serial,
            board,
            servo_hz,
            tlm_max_hz,
            rx_window,
            boot_count,
            reset_cause,
            fault,
            state,
            clock,
            baud,
        ) = _HELLO_REPLY.unpack(payload)
        return cls(
            proto_major,
            proto_minor,
            host_nonce,
            schema_hash,
            fw_major,
            fw_minor,
            fw_patch,
            git,
            serial.rstrip(b"\0").decode("ascii"),
            board,
            servo_hz,
            tlm_max_hz,
            rx_window,
            boot_count,
            reset_cause,
            fault,
            state,
            clock,
            baud,
        )


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """Feeds the watchdog if t_host_us is later than in every one before, and acknowledges events up to
    last_event. Never retried.
    """

    ID: ClassVar[int] = 0x02
    NAME: ClassVar[str] = "HEARTBEAT"

    t_host_us: int  # u64 us
    last_event: int  # u16

    def pack(self) -> bytes:
        try:
            return _HEARTBEAT.pack(self.t_host_us, self.last_event)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 10:
            raise wrong_length("HEARTBEAT", 10, len(payload))
        return cls(*_HEARTBEAT.unpack(payload))

    def unpack_reply(self, payload: bytes) -> HeartbeatReply:
        return HeartbeatReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class HeartbeatReply:
    """Reply to HEARTBEAT."""

    ID: ClassVar[int] = 0x02
    NAME: ClassVar[str] = "HEARTBEAT_REPLY"

    t_host_us: int  # u64 us: echoed
    t_dev_us: int  # u64 us: controller time
    state: int  # u8: State
    fault: int  # u16
    rx_bad: int  # u16: frames dropped for a bad check
    rx_drop: int  # u16: frames dropped for another session

    def pack(self) -> bytes:
        try:
            return _HEARTBEAT_REPLY.pack(
                self.t_host_us,
                self.t_dev_us,
                self.state,
                self.fault,
                self.rx_bad,
                self.rx_drop,
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 23:
            raise wrong_length("HEARTBEAT_REPLY", 23, len(payload))
        return cls(*_HEARTBEAT_REPLY.unpack(payload))


@dataclass(frozen=True, slots=True)
class GetSchema:
    """Part of the canonical schema from `offset` on: JSON compressed with zlib. This layout never changes, so
    that hosts of any version can tell what differs.
    """

    ID: ClassVar[int] = 0x03
    NAME: ClassVar[str] = "GET_SCHEMA"

    offset: int  # u16: bytes

    def pack(self) -> bytes:
        try:
            return _GET_SCHEMA.pack(self.offset)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 2:
            raise wrong_length("GET_SCHEMA", 2, len(payload))
        return cls(*_GET_SCHEMA.unpack(payload))

    def unpack_reply(self, payload: bytes) -> GetSchemaReply:
        return GetSchemaReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class GetSchemaReply:
    """Reply to GET_SCHEMA."""

    ID: ClassVar[int] = 0x03
    NAME: ClassVar[str] = "GET_SCHEMA_REPLY"

    total: int  # u16: bytes of the whole
    n: int  # u8: bytes in this reply, 0 behind the end
    records: bytes  # n × 1 bytes, see RECORD_FIELDS

    def pack(self) -> bytes:
        try:
            return _GET_SCHEMA_REPLY.pack(self.total, self.n) + checked_records(self.records, self.n, 1, 243)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) < 3:
            raise wrong_length("GET_SCHEMA_REPLY", 3, len(payload))
        if len(payload) != 3 + 1 * payload[2]:
            raise wrong_length("GET_SCHEMA_REPLY", 3 + 1 * payload[2], len(payload))
        total, n = _GET_SCHEMA_REPLY.unpack_from(payload)
        return cls(total, n, payload[3:])


@dataclass(frozen=True, slots=True)
class Advance:
    """Lets time pass on a controller whose Clock is DRIVEN, until it has something to send that cannot wait,
    at most timeout_us. What it has to send goes before the reply. Other controllers answer UNKNOWN_TYPE.
    Never retried.
    """

    ID: ClassVar[int] = 0x05
    NAME: ClassVar[str] = "ADVANCE"

    timeout_us: int  # u32 us

    def pack(self) -> bytes:
        try:
            return _ADVANCE.pack(self.timeout_us)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 4:
            raise wrong_length("ADVANCE", 4, len(payload))
        return cls(*_ADVANCE.unpack(payload))

    def unpack_reply(self, payload: bytes) -> AdvanceReply:
        return AdvanceReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class AdvanceReply:
    """Reply to ADVANCE."""

    ID: ClassVar[int] = 0x05
    NAME: ClassVar[str] = "ADVANCE_REPLY"

    t_dev_us: int  # u64 us: controller time

    def pack(self) -> bytes:
        try:
            return _ADVANCE_REPLY.pack(self.t_dev_us)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 8:
            raise wrong_length("ADVANCE_REPLY", 8, len(payload))
        return cls(*_ADVANCE_REPLY.unpack(payload))


@dataclass(frozen=True, slots=True)
class GetStatus:
    """Everything the controller can see now."""

    ID: ClassVar[int] = 0x04
    NAME: ClassVar[str] = "GET_STATUS"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("GET_STATUS", 0, len(payload))
        return cls()

    def unpack_reply(self, payload: bytes) -> GetStatusReply:
        return GetStatusReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class GetStatusReply:
    """Reply to GET_STATUS."""

    ID: ClassVar[int] = 0x04
    NAME: ClassVar[str] = "GET_STATUS_REPLY"

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

    def pack(self) -> bytes:
        try:
            return _GET_STATUS_REPLY.pack(
                self.state,
                self.fault,
                self.interlocks,
                round(self.displacement_um * 1000),
                round(self.x_um * 1000),
                round(self.y_um * 1000),
                round(self.theta_deg * 1000),
                round(self.actuator_v * 400),
                round(self.gap_v * 200),
                round(self.temperature_c * 10),
                round(self.flow_lpm * 100),
                round(self.monitor_v * 100),
                self.flags,
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 32:
            raise wrong_length("GET_STATUS_REPLY", 32, len(payload))
        (
            state,
            fault,
            interlocks,
            displacement_um,
            x_um,
            y_um,
            theta_deg,
            actuator_v,
            gap_v,
            temperature_c,
            flow_lpm,
            monitor_v,
            flags,
        ) = _GET_STATUS_REPLY.unpack(payload)
        return cls(
            state,
            fault,
            interlocks,
            displacement_um / 1000,
            x_um / 1000,
            y_um / 1000,
            theta_deg / 1000,
            actuator_v / 400,
            gap_v / 200,
            temperature_c / 10,
            flow_lpm / 100,
            monitor_v / 100,
            flags,
        )


@dataclass(frozen=True, slots=True)
class Arm:
    """IDLE to ARMED: starts the watchdog. Refused unless param_crc equals that of the committed parameters
    and every interlock is closed.
    """

    ID: ClassVar[int] = 0x08
    NAME: ClassVar[str] = "ARM"

    param_crc: int  # u32

    def pack(self) -> bytes:
        try:
            return _ARM.pack(self.param_crc)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 4:
            raise wrong_length("ARM", 4, len(payload))
        return cls(*_ARM.unpack(payload))

    def unpack_reply(self, payload: bytes) -> ArmReply:
        return ArmReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class ArmReply:
    """Reply to ARM."""

    ID: ClassVar[int] = 0x08
    NAME: ClassVar[str] = "ARM_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("ARM_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class Disarm:
    """Pulses off, actuator ramped to 0 V, then IDLE. Answered at once; MOVE_DONE follows."""

    ID: ClassVar[int] = 0x09
    NAME: ClassVar[str] = "DISARM"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("DISARM", 0, len(payload))
        return cls()

    def unpack_reply(self, payload: bytes) -> DisarmReply:
        return DisarmReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class DisarmReply:
    """Reply to DISARM."""

    ID: ClassVar[int] = 0x09
    NAME: ClassVar[str] = "DISARM_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("DISARM_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class ClearFault:
    """Leaves FAULT for IDLE; must name the latched code."""

    ID: ClassVar[int] = 0x0A
    NAME: ClassVar[str] = "CLEAR_FAULT"

    fault: int  # u16

    def pack(self) -> bytes:
        try:
            return _CLEAR_FAULT.pack(self.fault)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 2:
            raise wrong_length("CLEAR_FAULT", 2, len(payload))
        return cls(*_CLEAR_FAULT.unpack(payload))

    def unpack_reply(self, payload: bytes) -> ClearFaultReply:
        return ClearFaultReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class ClearFaultReply:
    """Reply to CLEAR_FAULT."""

    ID: ClassVar[int] = 0x0A
    NAME: ClassVar[str] = "CLEAR_FAULT_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("CLEAR_FAULT_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class SetParam:
    """Stages one parameter. IDLE only."""

    ID: ClassVar[int] = 0x0B
    NAME: ClassVar[str] = "SET_PARAM"

    param: int  # u16
    value: int  # i32: in the parameter's own unit

    def pack(self) -> bytes:
        try:
            return _SET_PARAM.pack(self.param, self.value)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 6:
            raise wrong_length("SET_PARAM", 6, len(payload))
        return cls(*_SET_PARAM.unpack(payload))

    def unpack_reply(self, payload: bytes) -> SetParamReply:
        return SetParamReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class SetParamReply:
    """Reply to SET_PARAM."""

    ID: ClassVar[int] = 0x0B
    NAME: ClassVar[str] = "SET_PARAM_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("SET_PARAM_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class GetParam:
    """Reads one parameter."""

    ID: ClassVar[int] = 0x0C
    NAME: ClassVar[str] = "GET_PARAM"

    param: int  # u16

    def pack(self) -> bytes:
        try:
            return _GET_PARAM.pack(self.param)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 2:
            raise wrong_length("GET_PARAM", 2, len(payload))
        return cls(*_GET_PARAM.unpack(payload))

    def unpack_reply(self, payload: bytes) -> GetParamReply:
        return GetParamReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class GetParamReply:
    """Reply to GET_PARAM."""

    ID: ClassVar[int] = 0x0C
    NAME: ClassVar[str] = "GET_PARAM_REPLY"

    value: int  # i32

    def pack(self) -> bytes:
        try:
            return _GET_PARAM_REPLY.pack(self.value)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 4:
            raise wrong_length("GET_PARAM_REPLY", 4, len(payload))
        return cls(*_GET_PARAM_REPLY.unpack(payload))


@dataclass(frozen=True, slots=True)
class CommitProfile:
    """Makes the staged parameters current if the CRC-32 over all parameters (id u16, value i32, ascending id)
    agrees.
    """

    ID: ClassVar[int] = 0x0D
    NAME: ClassVar[str] = "COMMIT_PROFILE"

    crc: int  # u32

    def pack(self) -> bytes:
        try:
            return _COMMIT_PROFILE.pack(self.crc)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 4:
            raise wrong_length("COMMIT_PROFILE", 4, len(payload))
        return cls(*_COMMIT_PROFILE.unpack(payload))

    def unpack_reply(self, payload: bytes) -> CommitProfileReply:
        return CommitProfileReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class CommitProfileReply:
    """Reply to COMMIT_PROFILE."""

    ID: ClassVar[int] = 0x0D
    NAME: ClassVar[str] = "COMMIT_PROFILE_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("COMMIT_PROFILE_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class PiezoSet:
    """Ramps the actuator. ARMED only; ends with MOVE_DONE."""

    ID: ClassVar[int] = 0x10
    NAME: ClassVar[str] = "PIEZO_SET"

    actuator_v: float  # u16 × 0.0025 V
    slew_v_s: float  # u32 × 0.001 V/s

    def pack(self) -> bytes:
        try:
            return _PIEZO_SET.pack(round(self.actuator_v * 400), round(self.slew_v_s * 1000))
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 6:
            raise wrong_length("PIEZO_SET", 6, len(payload))
        actuator_v, slew_v_s = _PIEZO_SET.unpack(payload)
        return cls(actuator_v / 400, slew_v_s / 1000)

    def unpack_reply(self, payload: bytes) -> PiezoSetReply:
        return PiezoSetReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class PiezoSetReply:
    """Reply to PIEZO_SET."""

    ID: ClassVar[int] = 0x10
    NAME: ClassVar[str] = "PIEZO_SET_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("PIEZO_SET_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class StageMove:
    """Absolute stage move. ARMED only, tool retracted below safe_z_um; ends with STAGE_DONE."""

    ID: ClassVar[int] = 0x11
    NAME: ClassVar[str] = "STAGE_MOVE"

    axis: int  # u8: Axis
    target: int  # i32: nm, or millidegrees for THETA
    speed: int  # u32: nm/s, or millidegrees/s

    def pack(self) -> bytes:
        try:
            return _STAGE_MOVE.pack(self.axis, self.target, self.speed)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 9:
            raise wrong_length("STAGE_MOVE", 9, len(payload))
        return cls(*_STAGE_MOVE.unpack(payload))

    def unpack_reply(self, payload: bytes) -> StageMoveReply:
        return StageMoveReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class StageMoveReply:
    """Reply to STAGE_MOVE."""

    ID: ClassVar[int] = 0x11
    NAME: ClassVar[str] = "STAGE_MOVE_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("STAGE_MOVE_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class StageStop:
    """Stops a stage that moves; GET_STATUS tells where. Ends with STOPPED."""

    ID: ClassVar[int] = 0x12
    NAME: ClassVar[str] = "STAGE_STOP"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("STAGE_STOP", 0, len(payload))
        return cls()

    def unpack_reply(self, payload: bytes) -> StageStopReply:
        return StageStopReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class StageStopReply:
    """Reply to STAGE_STOP."""

    ID: ClassVar[int] = 0x12
    NAME: ClassVar[str] = "STAGE_STOP_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("STAGE_STOP_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class SetZero:
    """From now until the next ARM safe_z_um counts from this displacement, which is where the host takes the
    tool's home at 0 V to be. ARMED with the actuator at rest at 0 V; OUT_OF_RANGE where the controller's own
    reading is more than 5 um below or 25 um above.
    """

    ID: ClassVar[int] = 0x13
    NAME: ClassVar[str] = "SET_ZERO"

    zero_um: float  # i32 × 0.001 um

    def pack(self) -> bytes:
        try:
            return _SET_ZERO.pack(round(self.zero_um * 1000))
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 4:
            raise wrong_length("SET_ZERO", 4, len(payload))
        (zero_um,) = _SET_ZERO.unpack(payload)
        return cls(zero_um / 1000)

    def unpack_reply(self, payload: bytes) -> SetZeroReply:
        return SetZeroReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class SetZeroReply:
    """Reply to SET_ZERO."""

    ID: ClassVar[int] = 0x13
    NAME: ClassVar[str] = "SET_ZERO_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("SET_ZERO_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class Approach:
    """Pulses on, actuator advances until the filtered mean gap voltage falls to gap_ref_v. Ends with
    APPROACH_DONE, pulses off, tool held.
    """

    ID: ClassVar[int] = 0x18
    NAME: ClassVar[str] = "APPROACH"

    speed_um_s: float  # u32 × 0.001 um/s
    max_travel_um: float  # u32 × 0.001 um: further without a spark: fault 3005
    gap_ref_v: float  # u16 × 0.005 V

    def pack(self) -> bytes:
        try:
            return _APPROACH.pack(
                round(self.speed_um_s * 1000),
                round(self.max_travel_um * 1000),
                round(self.gap_ref_v * 200),
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 10:
            raise wrong_length("APPROACH", 10, len(payload))
        speed_um_s, max_travel_um, gap_ref_v = _APPROACH.unpack(payload)
        return cls(speed_um_s / 1000, max_travel_um / 1000, gap_ref_v / 200)

    def unpack_reply(self, payload: bytes) -> ApproachReply:
        return ApproachReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class ApproachReply:
    """Reply to APPROACH."""

    ID: ClassVar[int] = 0x18
    NAME: ClassVar[str] = "APPROACH_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("APPROACH_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class ServoStart:
    """Gap servo until the filtered displacement reaches z_limit_um (CUT_DONE) or max_time_s passes (TIME_UP);
    then pulses off, tool held.
    """

    ID: ClassVar[int] = 0x19
    NAME: ClassVar[str] = "SERVO_START"

    gap_ref_v: float  # u16 × 0.005 V
    z_limit_um: float  # i32 × 0.001 um
    max_time_s: float  # u32 × 0.001 s

    def pack(self) -> bytes:
        try:
            return _SERVO_START.pack(
                round(self.gap_ref_v * 200),
                round(self.z_limit_um * 1000),
                round(self.max_time_s * 1000),
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 10:
            raise wrong_length("SERVO_START", 10, len(payload))
        gap_ref_v, z_limit_um, max_time_s = _SERVO_START.unpack(payload)
        return cls(gap_ref_v / 200, z_limit_um / 1000, max_time_s / 1000)

    def unpack_reply(self, payload: bytes) -> ServoStartReply:
        return ServoStartReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class ServoStartReply:
    """Reply to SERVO_START."""

    ID: ClassVar[int] = 0x19
    NAME: ClassVar[str] = "SERVO_START_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("SERVO_START_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class ServoStop:
    """Ends approach, servo, jump or touch: pulses off, tool held, ARMED. Ends with STOPPED."""

    ID: ClassVar[int] = 0x1A
    NAME: ClassVar[str] = "SERVO_STOP"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("SERVO_STOP", 0, len(payload))
        return cls()

    def unpack_reply(self, payload: bytes) -> ServoStopReply:
        return ServoStopReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class ServoStopReply:
    """Reply to SERVO_STOP."""

    ID: ClassVar[int] = 0x1A
    NAME: ClassVar[str] = "SERVO_STOP_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("SERVO_STOP_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class Jump:
    """Pulses off, retract by height, dwell, return to clearance above the start point, then the servo goes
    on. MACHINING (or ARMED, without a servo). Ends with JUMP_DONE. Lengths and speed are volts by
    gain_um_per_v: a host with an actuator model sends the volts of the jump it wants times that gain.
    """

    ID: ClassVar[int] = 0x1B
    NAME: ClassVar[str] = "JUMP"

    height_um: float  # u32 × 0.001 um
    speed_um_s: float  # u32 × 0.001 um/s
    dwell_s: float  # u16 × 0.001 s
    clearance_um: float  # u32 × 0.001 um

    def pack(self) -> bytes:
        try:
            return _JUMP.pack(
                round(self.height_um * 1000),
                round(self.speed_um_s * 1000),
                round(self.dwell_s * 1000),
                round(self.clearance_um * 1000),
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 14:
            raise wrong_length("JUMP", 14, len(payload))
        height_um, speed_um_s, dwell_s, clearance_um = _JUMP.unpack(payload)
        return cls(height_um / 1000, speed_um_s / 1000, dwell_s / 1000, clearance_um / 1000)

    def unpack_reply(self, payload: bytes) -> JumpReply:
        return JumpReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class JumpReply:
    """Reply to JUMP."""

    ID: ClassVar[int] = 0x1B
    NAME: ClassVar[str] = "JUMP_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("JUMP_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class TouchOff:
    """Measure mode. Fast to fast_to_um, then slow until contact; on contact the slope flips and the tool
    hunts for dwell_s; n touches with a back-off between. One TOUCH event each, then TOUCH_DONE and a retract
    by back-off.
    """

    ID: ClassVar[int] = 0x1C
    NAME: ClassVar[str] = "TOUCH_OFF"

    fast_um_s: float  # u32 × 0.001 um/s
    fast_to_um: float  # i32 × 0.001 um: displacement where the fast leg ends
    speed_um_s: float  # u32 × 0.001 um/s
    z_max_um: float  # i32 × 0.001 um: no contact up to here: fault 2005
    back_off_um: float  # u32 × 0.001 um
    dwell_s: float  # u16 × 0.001 s
    touches: int  # u8

    def pack(self) -> bytes:
        try:
            return _TOUCH_OFF.pack(
                round(self.fast_um_s * 1000),
                round(self.fast_to_um * 1000),
                round(self.speed_um_s * 1000),
                round(self.z_max_um * 1000),
                round(self.back_off_um * 1000),
                round(self.dwell_s * 1000),
                self.touches,
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 23:
            raise wrong_length("TOUCH_OFF", 23, len(payload))
        (
            fast_um_s,
            fast_to_um,
            speed_um_s,
            z_max_um,
            back_off_um,
            dwell_s,
            touches,
        ) = _TOUCH_OFF.unpack(payload)
        return cls(
            fast_um_s / 1000,
            fast_to_um / 1000,
            speed_um_s / 1000,
            z_max_um / 1000,
            back_off_um / 1000,
            dwell_s / 1000,
            touches,
        )

    def unpack_reply(self, payload: bytes) -> TouchOffReply:
        return TouchOffReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class TouchOffReply:
    """Reply to TOUCH_OFF."""

    ID: ClassVar[int] = 0x1C
    NAME: ClassVar[str] = "TOUCH_OFF_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("TOUCH_OFF_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class SelfTest:
    """Tests the gap sensor with the tool retracted: the mean gap voltage must be zero with the generator off,
    and duty x open voltage with it on, within test_error of the latter; else fault 3003. ARMED with the
    actuator at 0 V and pulses enabled; ends with TEST_DONE.
    """

    ID: ClassVar[int] = 0x1D
    NAME: ClassVar[str] = "SELF_TEST"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("SELF_TEST", 0, len(payload))
        return cls()

    def unpack_reply(self, payload: bytes) -> SelfTestReply:
        return SelfTestReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class SelfTestReply:
    """Reply to SELF_TEST."""

    ID: ClassVar[int] = 0x1D
    NAME: ClassVar[str] = "SELF_TEST_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("SELF_TEST_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class ScanStart:
    """Gap servo as in SERVO_START, but a tool that reaches z_limit_um is held there and the cut goes on,
    while the stages follow the lines of PATH_MOVE. Ends after the line marked last (PATH_DONE) or when
    max_time_s passes (TIME_UP); then pulses off, tool held.
    """

    ID: ClassVar[int] = 0x1E
    NAME: ClassVar[str] = "SCAN_START"

    gap_ref_v: float  # u16 × 0.005 V
    z_limit_um: float  # i32 × 0.001 um
    max_time_s: float  # u32 × 0.001 s

    def pack(self) -> bytes:
        try:
            return _SCAN_START.pack(
                round(self.gap_ref_v * 200),
                round(self.z_limit_um * 1000),
                round(self.max_time_s * 1000),
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 10:
            raise wrong_length("SCAN_START", 10, len(payload))
        gap_ref_v, z_limit_um, max_time_s = _SCAN_START.unpack(payload)
        return cls(gap_ref_v / 200, z_limit_um / 1000, max_time_s / 1000)

    def unpack_reply(self, payload: bytes) -> ScanStartReply:
        return ScanStartReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class ScanStartReply:
    """Reply to SCAN_START."""

    ID: ClassVar[int] = 0x1E
    NAME: ClassVar[str] = "SCAN_START_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("SCAN_START_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class PathMove:
    """Appends a straight line of the X and Y stages together, from where the line before it ends, to a queue
    of 16; BUSY when the queue is full. MACHINING after SCAN_START only, and not after the line marked last.
    On the way the limit of the scan goes linearly to z_limit_um. The stages stand still while the gap is
    shorted or a JUMP runs.
    """

    ID: ClassVar[int] = 0x1F
    NAME: ClassVar[str] = "PATH_MOVE"

    x_um: float  # i32 × 0.001 um: end of the line
    y_um: float  # i32 × 0.001 um
    speed_um_s: float  # u32 × 0.001 um/s: along the line
    z_limit_um: float  # i32 × 0.001 um: limit of the displacement at its end
    last: int  # u8: 1: the scan ends with this line

    def pack(self) -> bytes:
        try:
            return _PATH_MOVE.pack(
                round(self.x_um * 1000),
                round(self.y_um * 1000),
                round(self.speed_um_s * 1000),
                round(self.z_limit_um * 1000),
                self.last,
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 17:
            raise wrong_length("PATH_MOVE", 17, len(payload))
        x_um, y_um, speed_um_s, z_limit_um, last = _PATH_MOVE.unpack(payload)
        return cls(x_um / 1000, y_um / 1000, speed_um_s / 1000, z_limit_um / 1000, last)

    def unpack_reply(self, payload: bytes) -> PathMoveReply:
        return PathMoveReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class PathMoveReply:
    """Reply to PATH_MOVE."""

    ID: ClassVar[int] = 0x1F
    NAME: ClassVar[str] = "PATH_MOVE_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("PATH_MOVE_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class PulseConfig:
    """Sets the generator. Pulses must be off."""

    ID: ClassVar[int] = 0x20
    NAME: ClassVar[str] = "PULSE_CONFIG"

    on_time_us: float  # u32 × 0.001 us
    off_time_us: float  # u32 × 0.001 us
    open_voltage_v: float  # u16 × 0.005 V
    peak_current_a: float  # u16 × 0.001 A
    mode: int  # u8: PulseMode
    discharge_us: float  # u32 × 0.001 us: isopulse only

    def pack(self) -> bytes:
        try:
            return _PULSE_CONFIG.pack(
                round(self.on_time_us * 1000),
                round(self.off_time_us * 1000),
                round(self.open_voltage_v * 200),
                round(self.peak_current_a * 1000),
                self.mode,
                round(self.discharge_us * 1000),
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 17:
            raise wrong_length("PULSE_CONFIG", 17, len(payload))
        (
            on_time_us,
            off_time_us,
            open_voltage_v,
            peak_current_a,
            mode,
            discharge_us,
        ) = _PULSE_CONFIG.unpack(payload)
        return cls(
            on_time_us / 1000,
            off_time_us / 1000,
            open_voltage_v / 200,
            peak_current_a / 1000,
            mode,
            discharge_us / 1000,
        )

    def unpack_reply(self, payload: bytes) -> PulseConfigReply:
        return PulseConfigReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class PulseConfigReply:
    """Reply to PULSE_CONFIG."""

    ID: ClassVar[int] = 0x20
    NAME: ClassVar[str] = "PULSE_CONFIG_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("PULSE_CONFIG_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class PulseEnable:
    """Permits pulses. They flow in APPROACH and MACHINING only."""

    ID: ClassVar[int] = 0x21
    NAME: ClassVar[str] = "PULSE_ENABLE"

    on: int  # u8

    def pack(self) -> bytes:
        try:
            return _PULSE_ENABLE.pack(self.on)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 1:
            raise wrong_length("PULSE_ENABLE", 1, len(payload))
        return cls(*_PULSE_ENABLE.unpack(payload))

    def unpack_reply(self, payload: bytes) -> PulseEnableReply:
        return PulseEnableReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class PulseEnableReply:
    """Reply to PULSE_ENABLE."""

    ID: ClassVar[int] = 0x21
    NAME: ClassVar[str] = "PULSE_ENABLE_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("PULSE_ENABLE_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class TlmStart:
    """Starts telemetry; refused with RATE_TOO_HIGH where the line cannot carry it, OUT_OF_RANGE where a
    period holds more than 255 pulses.
    """

    ID: ClassVar[int] = 0x28
    NAME: ClassVar[str] = "TLM_START"

    period_us: int  # u16 us
    batch: int  # u8: samples per frame, 1..14
    pulse_log: int  # u8: PulseLog

    def pack(self) -> bytes:
        try:
            return _TLM_START.pack(self.period_us, self.batch, self.pulse_log)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 4:
            raise wrong_length("TLM_START", 4, len(payload))
        return cls(*_TLM_START.unpack(payload))

    def unpack_reply(self, payload: bytes) -> TlmStartReply:
        return TlmStartReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class TlmStartReply:
    """Reply to TLM_START."""

    ID: ClassVar[int] = 0x28
    NAME: ClassVar[str] = "TLM_START_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("TLM_START_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class TlmStop:
    """Stops telemetry; what is pending is sent first."""

    ID: ClassVar[int] = 0x29
    NAME: ClassVar[str] = "TLM_STOP"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("TLM_STOP", 0, len(payload))
        return cls()

    def unpack_reply(self, payload: bytes) -> TlmStopReply:
        return TlmStopReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class TlmStopReply:
    """Reply to TLM_STOP."""

    ID: ClassVar[int] = 0x29
    NAME: ClassVar[str] = "TLM_STOP_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("TLM_STOP_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class BlackboxRead:
    """Servo samples of every millisecond up to the latched fault, frozen by it, oldest first. Without a
    fault: up to now. Samples are those of TLM.
    """

    ID: ClassVar[int] = 0x30
    NAME: ClassVar[str] = "BLACKBOX_READ"

    offset: int  # u16: samples

    def pack(self) -> bytes:
        try:
            return _BLACKBOX_READ.pack(self.offset)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 2:
            raise wrong_length("BLACKBOX_READ", 2, len(payload))
        return cls(*_BLACKBOX_READ.unpack(payload))

    def unpack_reply(self, payload: bytes) -> BlackboxReadReply:
        return BlackboxReadReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class BlackboxReadReply:
    """Reply to BLACKBOX_READ."""

    ID: ClassVar[int] = 0x30
    NAME: ClassVar[str] = "BLACKBOX_READ_REPLY"

    total: int  # u16: samples held, at most 2048
    t0_us: int  # u32 us: time of the first sample of this reply, modulo 2^32
    n: int  # u8: samples in this reply, 0 behind the end
    records: bytes  # n × 16 bytes, see RECORD_FIELDS

    def pack(self) -> bytes:
        try:
            return _BLACKBOX_READ_REPLY.pack(
                self.total,
                self.t0_us,
                self.n,
            ) + checked_records(self.records, self.n, 16, 239)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) < 7:
            raise wrong_length("BLACKBOX_READ_REPLY", 7, len(payload))
        if len(payload) != 7 + 16 * payload[6]:
            raise wrong_length("BLACKBOX_READ_REPLY", 7 + 16 * payload[6], len(payload))
        total, t0_us, n = _BLACKBOX_READ_REPLY.unpack_from(payload)
        return cls(total, t0_us, n, payload[7:])


@dataclass(frozen=True, slots=True)
class WaveformRead:
    """Gap voltage and gap current about the latched fault, sample by sample, oldest first: from up to 64
    pulses before it to 16 pulse periods after it. BUSY until those have passed. total is 0 without a fault,
    where no pulse came shortly before it, and from controllers that keep no waveforms.
    """

    ID: ClassVar[int] = 0x31
    NAME: ClassVar[str] = "WAVEFORM_READ"

    offset: int  # u32: samples

    def pack(self) -> bytes:
        try:
            return _WAVEFORM_READ.pack(self.offset)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 4:
            raise wrong_length("WAVEFORM_READ", 4, len(payload))
        return cls(*_WAVEFORM_READ.unpack(payload))

    def unpack_reply(self, payload: bytes) -> WaveformReadReply:
        return WaveformReadReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class WaveformReadReply:
    """Reply to WAVEFORM_READ."""

    ID: ClassVar[int] = 0x31
    NAME: ClassVar[str] = "WAVEFORM_READ_REPLY"

    total: int  # u32: samples held
    t0_us: int  # u32 us: time of sample 0, modulo 2^32
    period_ns: int  # u32 ns: from one sample to the next, at most 1000
    n: int  # u8: samples in this reply, at most 58, 0 behind the end
    records: bytes  # n × 4 bytes, see RECORD_FIELDS

    def pack(self) -> bytes:
        try:
            return _WAVEFORM_READ_REPLY.pack(
                self.total,
                self.t0_us,
                self.period_ns,
                self.n,
            ) + checked_records(self.records, self.n, 4, 233)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) < 13:
            raise wrong_length("WAVEFORM_READ_REPLY", 13, len(payload))
        if len(payload) != 13 + 4 * payload[12]:
            raise wrong_length("WAVEFORM_READ_REPLY", 13 + 4 * payload[12], len(payload))
        total, t0_us, period_ns, n = _WAVEFORM_READ_REPLY.unpack_from(payload)
        return cls(total, t0_us, period_ns, n, payload[13:])


@dataclass(frozen=True, slots=True)
class Reboot:
    """Restarts the controller as a reset does, after the reply; BOOT follows. Refused while armed."""

    ID: ClassVar[int] = 0x3F
    NAME: ClassVar[str] = "REBOOT"

    magic: int  # u32: 0x0B007EDB

    def pack(self) -> bytes:
        try:
            return _REBOOT.pack(self.magic)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 4:
            raise wrong_length("REBOOT", 4, len(payload))
        return cls(*_REBOOT.unpack(payload))

    def unpack_reply(self, payload: bytes) -> RebootReply:
        return RebootReply.unpack(payload)


@dataclass(frozen=True, slots=True)
class RebootReply:
    """Reply to REBOOT."""

    ID: ClassVar[int] = 0x3F
    NAME: ClassVar[str] = "REBOOT_REPLY"

    def pack(self) -> bytes:
        return b""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if payload:
            raise wrong_length("REBOOT_REPLY", 0, len(payload))
        return cls()


@dataclass(frozen=True, slots=True)
class Tlm:
    """Servo samples. counter counts frames, so gaps are exact."""

    ID: ClassVar[int] = 0x80
    NAME: ClassVar[str] = "TLM"

    counter: int  # u16
    t0_us: int  # u32 us: time of the first sample, modulo 2^32
    period_us: int  # u16 us
    n: int  # u8
    dropped: int  # u8
    records: bytes  # n × 16 bytes, see RECORD_FIELDS

    def pack(self) -> bytes:
        try:
            return _TLM.pack(
                self.counter,
                self.t0_us,
                self.period_us,
                self.n,
                self.dropped,
            ) + checked_records(self.records, self.n, 16, 236)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) < 10:
            raise wrong_length("TLM", 10, len(payload))
        if len(payload) != 10 + 16 * payload[8]:
            raise wrong_length("TLM", 10 + 16 * payload[8], len(payload))
        counter, t0_us, period_us, n, dropped = _TLM.unpack_from(payload)
        return cls(counter, t0_us, period_us, n, dropped, payload[10:])


@dataclass(frozen=True, slots=True)
class Event:
    """Repeated until acknowledged by HEARTBEAT.last_event."""

    ID: ClassVar[int] = 0x81
    NAME: ClassVar[str] = "EVENT"

    event_no: int  # u16
    t_us: int  # u32 us: modulo 2^32
    code: int  # u16: EventCode
    # i32: TOUCH: number of the touch; TEST_DONE: mean gap voltage with the generator on, mV; otherwise 0
    arg: int
    # i32 × 0.001 um: TOUCH: mean of the sensor while hunting; otherwise the sensor now
    displacement_um: float
    actuator_v: float  # u16 × 0.0025 V: TOUCH: peak command at first contact

    def pack(self) -> bytes:
        try:
            return _EVENT.pack(
                self.event_no,
                self.t_us,
                self.code,
                self.arg,
                round(self.displacement_um * 1000),
                round(self.actuator_v * 400),
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 18:
            raise wrong_length("EVENT", 18, len(payload))
        event_no, t_us, code, arg, displacement_um, actuator_v = _EVENT.unpack(payload)
        return cls(event_no, t_us, code, arg, displacement_um / 1000, actuator_v / 400)


@dataclass(frozen=True, slots=True)
class Fault:
    """Repeated until acknowledged by HEARTBEAT.last_event."""

    ID: ClassVar[int] = 0x82
    NAME: ClassVar[str] = "FAULT"

    event_no: int  # u16
    t_us: int  # u32 us
    code: int  # u16
    detail: int  # i32
    displacement_um: float  # i32 × 0.001 um
    gap_v: float  # u16 × 0.005 V

    def pack(self) -> bytes:
        try:
            return _FAULT.pack(
                self.event_no,
                self.t_us,
                self.code,
                self.detail,
                round(self.displacement_um * 1000),
                round(self.gap_v * 200),
            )
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 18:
            raise wrong_length("FAULT", 18, len(payload))
        event_no, t_us, code, detail, displacement_um, gap_v = _FAULT.unpack(payload)
        return cls(event_no, t_us, code, detail, displacement_um / 1000, gap_v / 200)


@dataclass(frozen=True, slots=True)
class Log:
    """Text for people."""

    ID: ClassVar[int] = 0x83
    NAME: ClassVar[str] = "LOG"

    level: int  # u8
    text: str  # utf8: to the end of the payload

    def pack(self) -> bytes:
        try:
            return _LOG.pack(self.level) + checked_text(self.text, 245)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) < 1:
            raise wrong_length("LOG", 1, len(payload))
        (level,) = _LOG.unpack_from(payload)
        return cls(level, payload[1:].decode("utf-8", "replace"))


@dataclass(frozen=True, slots=True)
class Boot:
    """Sent once after a reset; every session is gone."""

    ID: ClassVar[int] = 0x84
    NAME: ClassVar[str] = "BOOT"

    reset_cause: int  # u8: ResetCause
    boot_count: int  # u32

    def pack(self) -> bytes:
        try:
            return _BOOT.pack(self.reset_cause, self.boot_count)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) != 5:
            raise wrong_length("BOOT", 5, len(payload))
        return cls(*_BOOT.unpack(payload))


@dataclass(frozen=True, slots=True)
class PulseBlocks:
    """Sums over blocks of block_pulses pulses."""

    ID: ClassVar[int] = 0x85
    NAME: ClassVar[str] = "PULSE_BLOCKS"

    counter: int  # u16
    pulse_no: int  # u32: number of the first pulse
    t0_us: int  # u32 us: time of the first pulse, modulo 2^32
    period_ns: int  # u32 ns: pulse period
    block_pulses: int  # u8
    n: int  # u8: blocks
    records: bytes  # n × 12 bytes, see RECORD_FIELDS

    def pack(self) -> bytes:
        try:
            return _PULSE_BLOCKS.pack(
                self.counter,
                self.pulse_no,
                self.t0_us,
                self.period_ns,
                self.block_pulses,
                self.n,
            ) + checked_records(self.records, self.n, 12, 230)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) < 16:
            raise wrong_length("PULSE_BLOCKS", 16, len(payload))
        if len(payload) != 16 + 12 * payload[15]:
            raise wrong_length("PULSE_BLOCKS", 16 + 12 * payload[15], len(payload))
        counter, pulse_no, t0_us, period_ns, block_pulses, n = _PULSE_BLOCKS.unpack_from(payload)
        return cls(counter, pulse_no, t0_us, period_ns, block_pulses, n, payload[16:])


@dataclass(frozen=True, slots=True)
class Pulses:
    """Every pulse."""

    ID: ClassVar[int] = 0x86
    NAME: ClassVar[str] = "PULSES"

    counter: int  # u16
    pulse_no: int  # u32: number of the first pulse
    t0_us: int  # u32 us: time of the first pulse, modulo 2^32
    period_ns: int  # u32 ns: pulse period
    n: int  # u8
    records: bytes  # n × 6 bytes, see RECORD_FIELDS

    def pack(self) -> bytes:
        try:
            return _PULSES.pack(
                self.counter,
                self.pulse_no,
                self.t0_us,
                self.period_ns,
                self.n,
            ) + checked_records(self.records, self.n, 6, 231)
        except MISFIT as error:
            raise misfit(self, error) from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        if len(payload) < 15:
            raise wrong_length("PULSES", 15, len(payload))
        if len(payload) != 15 + 6 * payload[14]:
            raise wrong_length("PULSES", 15 + 6 * payload[14], len(payload))
        counter, pulse_no, t0_us, period_ns, n = _PULSES.unpack_from(payload)
        return cls(counter, pulse_no, t0_us, period_ns, n, payload[15:])


REQUESTS: dict[int, type[Message]] = {
    0x01: Hello,
    0x02: Heartbeat,
    0x03: GetSchema,
    0x05: Advance,
    0x04: GetStatus,
    0x08: Arm,
    0x09: Disarm,
    0x0A: ClearFault,
    0x0B: SetParam,
    0x0C: GetParam,
    0x0D: CommitProfile,
    0x10: PiezoSet,
    0x11: StageMove,
    0x12: StageStop,
    0x13: SetZero,
    0x18: Approach,
    0x19: ServoStart,
    0x1A: ServoStop,
    0x1B: Jump,
    0x1C: TouchOff,
    0x1D: SelfTest,
    0x1E: ScanStart,
    0x1F: PathMove,
    0x20: PulseConfig,
    0x21: PulseEnable,
    0x28: TlmStart,
    0x29: TlmStop,
    0x30: BlackboxRead,
    0x31: WaveformRead,
    0x3F: Reboot,
}
"""Commands by id."""

REPLIES: dict[int, type[Message]] = {
    0x01: HelloReply,
    0x02: HeartbeatReply,
    0x03: GetSchemaReply,
    0x05: AdvanceReply,
    0x04: GetStatusReply,
    0x08: ArmReply,
    0x09: DisarmReply,
    0x0A: ClearFaultReply,
    0x0B: SetParamReply,
    0x0C: GetParamReply,
    0x0D: CommitProfileReply,
    0x10: PiezoSetReply,
    0x11: StageMoveReply,
    0x12: StageStopReply,
    0x13: SetZeroReply,
    0x18: ApproachReply,
    0x19: ServoStartReply,
    0x1A: ServoStopReply,
    0x1B: JumpReply,
    0x1C: TouchOffReply,
    0x1D: SelfTestReply,
    0x1E: ScanStartReply,
    0x1F: PathMoveReply,
    0x20: PulseConfigReply,
    0x21: PulseEnableReply,
    0x28: TlmStartReply,
    0x29: TlmStopReply,
    0x30: BlackboxReadReply,
    0x31: WaveformReadReply,
    0x3F: RebootReply,
}
"""Replies by the id of their command; on the wire the type is id | 0x40."""

UNSOLICITED: dict[int, type[Message]] = {
    0x80: Tlm,
    0x81: Event,
    0x82: Fault,
    0x83: Log,
    0x84: Boot,
    0x85: PulseBlocks,
    0x86: Pulses,
}
"""What the controller sends by itself, by id."""

FIELD_ENUMS: dict[tuple[str, str], type[IntEnum | IntFlag]] = {
    ("HELLO_REPLY", "reset_cause"): ResetCause,
    ("HELLO_REPLY", "state"): State,
    ("HELLO_REPLY", "clock"): Clock,
    ("HEARTBEAT_REPLY", "state"): State,
    ("GET_STATUS_REPLY", "state"): State,
    ("GET_STATUS_REPLY", "interlocks"): Interlocks,
    ("GET_STATUS_REPLY", "flags"): TlmFlags,
    ("STAGE_MOVE", "axis"): Axis,
    ("PULSE_CONFIG", "mode"): PulseMode,
    ("TLM_START", "pulse_log"): PulseLog,
    ("EVENT", "code"): EventCode,
    ("BOOT", "reset_cause"): ResetCause,
}
"""Enumeration of a field, by message name and field name."""

RECORD_FIELDS: dict[str, tuple[tuple[str, str], ...]] = {
    "GetSchemaReply": (("data", "u1"),),
    "BlackboxReadReply": (
        ("displacement_um", "<i4"),
        ("actuator_v", "<u2"),
        ("gap_v", "<u2"),
        ("current_a", "<u2"),
        ("n_normal", "u1"),
        ("n_arc", "u1"),
        ("n_short", "u1"),
        ("n_open", "u1"),
        ("state", "u1"),
        ("flags", "u1"),
    ),
    "WaveformReadReply": (("gap_v", "<i2"), ("current_a", "<i2")),
    "Tlm": (
        ("displacement_um", "<i4"),
        ("actuator_v", "<u2"),
        ("gap_v", "<u2"),
        ("current_a", "<u2"),
        ("n_normal", "u1"),
        ("n_arc", "u1"),
        ("n_short", "u1"),
        ("n_open", "u1"),
        ("state", "u1"),
        ("flags", "u1"),
    ),
    "PulseBlocks": (
        ("n_open", "u1"),
        ("n_normal", "u1"),
        ("n_arc", "u1"),
        ("n_short", "u1"),
        ("delay_us", "<u4"),
        ("energy_uj", "<u4"),
    ),
    "Pulses": (("pulse_class", "u1"), ("delay_us", "<u2"), ("discharge_us", "<u2"), ("plateau_v", "u1")),
}
"""Fields of one record, in wire order, as numpy reads them."""

RECORD_SCALES: dict[str, dict[str, float]] = {
    "GetSchemaReply": {"data": 1},
    "BlackboxReadReply": {
        "displacement_um": 0.001,
        "actuator_v": 0.0025,
        "gap_v": 0.005,
        "current_a": 0.001,
        "n_normal": 1,
        "n_arc": 1,
        "n_short": 1,
        "n_open": 1,
        "state": 1,
        "flags": 1,
    },
    "WaveformReadReply": {"gap_v": 0.01, "current_a": 0.001},
    "Tlm": {
        "displacement_um": 0.001,
        "actuator_v": 0.0025,
        "gap_v": 0.005,
        "current_a": 0.001,
        "n_normal": 1,
        "n_arc": 1,
        "n_short": 1,
        "n_open": 1,
        "state": 1,
        "flags": 1,
    },
    "PulseBlocks": {"n_open": 1, "n_normal": 1, "n_arc": 1, "n_short": 1, "delay_us": 0.1, "energy_uj": 0.1},
    "Pulses": {"pulse_class": 1, "delay_us": 0.1, "discharge_us": 0.1, "plateau_v": 0.5},
}
"""Value in the unit of the field's name = wire integer × scale."""


@cache
def record_dtype(name: str) -> np.dtype[np.void]:
    """Return the dtype of one record of a message in RECORD_FIELDS: packed wire integers."""
    import numpy as np

    return np.dtype(list(RECORD_FIELDS[name]))


PARAMS: dict[str, Param] = {
    "piezo_max_v": Param(1, "piezo_max_v", "V", 0.001, 120, 0, 150, "soft limit of the command"),
    "slew_limit_v_s": Param(2, "slew_limit_v_s", "V/s", 0.001, 1000, 1, 20000, "limit of every ramp"),
    "gain_um_per_v": Param(
        3,
        "gain_um_per_v",
        "um/V",
        1e-06,
        2.967,
        0.1,
        20,
        "turns commanded um/s into V/s",
    ),
    "safe_z_um": Param(
        4,
        "safe_z_um",
        "um",
        0.001,
        20,
        -100,
        500,
        "stages may move below this displacement, counted from the zero of SET_ZERO",
    ),
    "retract_v_s": Param(
        5,
        "retract_v_s",
        "V/s",
        0.001,
        337,
        1,
        20000,
        "ramp to 0 V on disarm and on any fault",
    ),
    "sensor_fitted": Param(
        6,
        "sensor_fitted",
        "",
        1,
        1,
        0,
        1,
        "0: no displacement sensor; every displacement is gain_um_per_v x volts applied",
    ),
    "servo_law": Param(10, "servo_law", "", 1, 0, 0, 1, "ServoLaw"),
    "forward_um_s": Param(11, "forward_um_s", "um/s", 0.001, 5, 0.05, 500, "+ slope"),
    "back_um_s": Param(12, "back_um_s", "um/s", 0.001, 5, 0.05, 500, "- slope"),
    "short_back_um_s": Param(13, "short_back_um_s", "um/s", 0.001, 50, 0.05, 5000, "- slope while shorted"),
    "filter_hz": Param(14, "filter_hz", "Hz", 0.001, 20, 0.1, 1000, "low-pass of the mean gap voltage"),
    "hysteresis": Param(15, "hysteresis", "", 0.0001, 0.02, 0, 0.2, "of duty x open voltage"),
    "kp_um_s": Param(16, "kp_um_s", "um/s", 0.001, 20, 0, 1000, "PI: per unit of normalised voltage"),
    "ki_um_s2": Param(17, "ki_um_s2", "um/s2", 0.001, 20, 0, 10000, "PI"),
    "servo_period_us": Param(
        18,
        "servo_period_us",
        "us",
        1,
        1000,
        500,
        200000,
        "period of the servo decision",
    ),
    "servo_latency": Param(19, "servo_latency", "", 1, 1, 0, 50, "decisions of latency"),
    "short_v": Param(20, "short_v", "V", 0.001, 6, 0.1, 60, "plateau below: SHORT"),
    "arc_v": Param(
        21,
        "arc_v",
        "V",
        0.001,
        19.5,
        0.1,
        120,
        "plateau below, with a delay under arc_delay_us: ARC",
    ),
    "arc_delay_us": Param(22, "arc_delay_us", "us", 0.001, 3, 0, 1000, ""),
    "block_pulses": Param(23, "block_pulses", "", 1, 23, 1, 255, "pulses per PULSE_BLOCKS record"),
    "short_stuck_s": Param(30, "short_stuck_s", "s", 0.001, 3, 0.05, 60, "continuous short: fault 3001"),
    "arc_run": Param(31, "arc_run", "", 1, 60, 5, 10000, "consecutive arcs: fault 3002"),
    "open_lost_um": Param(
        32,
        "open_lost_um",
        "um",
        0.001,
        15,
        1,
        500,
        "advance in all-open beyond the last spark: fault 3005",
    ),
    "open_lost_s": Param(
        33,
        "open_lost_s",
        "s",
        0.001,
        10,
        0.1,
        3600,
        "time in all-open beyond the last spark: fault 3005",
    ),
    "watchdog_s": Param(40, "watchdog_s", "s", 0.001, 0.25, 0.1, 1, "host silent while armed: fault 1001"),
    "dielectric_required": Param(41, "dielectric_required", "", 1, 1, 0, 1, ""),
    "flow_min_lpm": Param(42, "flow_min_lpm", "L/min", 0.001, 0.5, 0, 100, ""),
    "temperature_max_c": Param(43, "temperature_max_c", "degC", 0.001, 30, 0, 100, ""),
    "monitor_min_v": Param(50, "monitor_min_v", "V", 0.001, -5, -50, 0, "voltage monitor below: fault 2003"),
    "monitor_max_v": Param(
        51,
        "monitor_max_v",
        "V",
        0.001,
        150.5,
        1,
        200,
        "voltage monitor above: fault 2003",
    ),
    "track_error": Param(
        52,
        "track_error",
        "",
        0.0001,
        0.03,
        0.001,
        1,
        "of 150 V: voltage monitor off the command by more for track_s: fault 2002",
    ),
    "track_s": Param(53, "track_s", "s", 0.001, 0.05, 0.001, 10, ""),
    "misread_pulses": Param(
        54,
        "misread_pulses",
        "",
        1,
        50,
        5,
        10000,
        "consecutive discharges at the open voltage: fault 3003",
    ),
    "over_current": Param(
        55,
        "over_current",
        "",
        0.01,
        1.5,
        1.05,
        10,
        "of the peak current set, or any current in the off-time: fault 3004",
    ),
    "bad_frames": Param(
        56,
        "bad_frames",
        "",
        1,
        10,
        2,
        1000,
        "frames with a bad check within 1 s while armed: fault 1003",
    ),
    "test_error": Param(57, "test_error", "", 0.001, 0.05, 0.001, 1, "SELF_TEST: of duty x open voltage"),
}


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
        crc = crc32(_PARAM.pack(param.id, param.to_wire(values.get(param.name, param.default))), crc)
    return crc
