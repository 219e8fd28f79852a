"""Faults of the machine, whoever detects them: the rows of faults.toml."""

from __future__ import annotations

import tomllib
from enum import IntEnum
from pathlib import Path

from edmctl.dataclasses import dataclass, fields, replace
from edmctl.errors import stages_by_hand


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One fault: who detects it, what to tell, what it leads to.

    code, name : as in FAULT and in CLEAR_FAULT; codes from 7000 on never leave the host.
    who : "controller", "host" or "both".
    message, hint : what happened, what to do. A name in braces stands for the value of that parameter.
    exit_code, error : exit code and error code of the command that it ends.
    pulses_off_s : promised time from the cause to pulses off, in s, with every parameter at its default.
    latched : the controller holds it until CLEAR_FAULT names it.
    inject : injection that brings it about on the virtual machine; in small letters, another way.
    """

    code: int
    name: str
    who: str
    message: str
    hint: str
    exit_code: int
    error: str
    pulses_off_s: float
    latched: bool
    inject: str


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


def _rows() -> dict[int, FaultRow]:
    """Return the rows of faults.toml by their code; its other keys are for the documentation."""
    table = tomllib.loads(Path(__file__).with_name("faults.toml").read_text(encoding="utf-8"))
    keys = [field.name for field in fields(FaultRow)]
    rows = [FaultRow(**{key: row[key] for key in keys}) for row in table["fault"]]
    return {row.code: replace(row, hint=row.hint.replace("{stages}", stages_by_hand())) for row in rows}


FAULTS = _rows()
