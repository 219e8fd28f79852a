"""The likely mistakes behind an error that the machine, or the host, raises in an item."""

from __future__ import annotations

from edmctl.errors import EdmError, LinkLost, MachineFault
from edmctl.jobs.first_start import nets
from edmctl.jobs.first_start.nets import cause
from edmctl.link.faults import FaultCode
from edmctl.results.first_start import Cause


def cause_of(error: EdmError) -> tuple[Cause, ...]:
    """Return the likely mistakes behind an error that the machine, or the host, has raised in an item."""
    if isinstance(error, LinkLost):
        return (
            cause("the line broke, or the board restarted: its supply, its plug, or noise", nets.LINE, "5 V"),
        )
    code = error.fault if isinstance(error, MachineFault) else 0
    by_fault = {
        FaultCode.ESTOP: cause("e-stop came while nobody pressed it: a loose contact, or noise", nets.ESTOP),
        FaultCode.DOOR: cause("door came while nobody opened it: a loose contact, or noise", nets.DOOR),
        FaultCode.HV_SUPPLY: cause(
            "the supply does not hold, its input is loose, or the guard of the mode switch: it does not go where "
            "it is told",
            nets.SUPPLY_OK,
            nets.MODE,
        ),
        FaultCode.DIELECTRIC: cause("the dielectric does not hold", nets.LEVEL, nets.FLOW, nets.TEMPERATURE),
        FaultCode.PIEZO_TRACK: cause("actuator monitor does not follow the command", nets.MONITOR, nets.DAC),
        FaultCode.PIEZO_OV: cause("actuator monitor is out of its range", nets.MONITOR),
        FaultCode.COLLISION: cause("the contact closed while the tool moved in the air", nets.CONTACT),
        FaultCode.STUCK_CONTACT: cause("the contact is closed in the air", nets.CONTACT),
        FaultCode.GAP_SENSOR: cause(
            "gap voltage and generator do not agree, and the sensor reads a battery right: gate, mode switch or "
            "enable of the high voltage",
            nets.GATE,
            nets.MODE,
            nets.ALIVE,
        ),
        FaultCode.NO_SPARK: cause(
            "no pulse comes: the wire from gate to driver is off, or the driver has no supply", nets.GATE
        ),
        FaultCode.GEN_FAULT: cause(
            "current where there is none, or pulses while the gate is off: the current sensor's offset or sign, the "
            "gate, or the break chain",
            nets.CURRENT,
            nets.GATE,
            nets.BREAK,
        ),
        FaultCode.MODE_SWITCH: cause(
            "the driver switches though its gate is off: noise on the gate's wire, no pull-down, or edges that the "
            "sense wire picks up",
            nets.GATE,
            nets.GATE_SENSE,
        ),
        FaultCode.STAGE_LIMIT: cause("a limit switch is closed: on the way, or wired wrongly", nets.LIMITS),
        FaultCode.SHORT_STUCK: cause("tool and work are connected", nets.GAP),
        FaultCode.HOST_SILENT: cause("this program was not heard: the line, or a busy computer", nets.LINE),
    }
    if code in by_fault:
        return (by_fault[FaultCode(code)],)
    return (cause(f"not one of the usual mistakes: {error.hint or error.message}"),)
