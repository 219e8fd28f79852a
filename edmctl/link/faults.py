"""Faults of the controller.

Made from faults.toml by `python -m edmctl.link.generate`; edit that file, not this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


@dataclass(frozen=True, slots=True)
class FaultRow:
    """One fault: who detects it and how, what happened, what to do.

    A name in braces in `message` stands for the value of that parameter.
    """

    code: int
    name: str
    who: str
    detect: str
    message: str
    hint: str


class FaultCode(IntEnum):
    """Code of a FAULT."""

    HOST_SILENT = 1001
    ABORT_RUN = 1002
    TRAVEL_LIMIT = 2001
    NO_CONTACT = 2005
    STUCK_CONTACT = 2006
    COLLISION = 2007
    SHORT_STUCK = 3001
    ARC_BURN = 3002
    NO_SPARK = 3005
    ESTOP = 4001
    DIELECTRIC = 4003


FAULTS: dict[int, FaultRow] = {
    1001: FaultRow(
        code=1001,
        name="HOST_SILENT",
        who="controller",
        detect="no valid frame of the session for watchdog_s while armed",
        message=(
            "The controller heard nothing from the host for {watchdog_s} s, switched the pulses off and "
            "retracted."
        ),
        hint="Look for a sleeping computer, a killed process or a loose cable.",
    ),
    1002: FaultRow(
        code=1002,
        name="ABORT_RUN",
        who="controller",
        detect="eight or more zero bytes in a row",
        message="The host aborted: pulses off, tool retracted.",
        hint="Nothing is wrong with the machine; start the job again.",
    ),
    2001: FaultRow(
        code=2001,
        name="TRAVEL_LIMIT",
        who="controller",
        detect="servo or approach wants more than piezo_max_v for 0.5 s",
        message="The actuator reached its voltage limit before the target: the stroke is used up.",
        hint=(
            "Lower the depth, start closer (approach.offset_um), or raise limits.stroke_v_max (150 V at "
            "most)."
        ),
    ),
    2005: FaultRow(
        code=2005,
        name="NO_CONTACT",
        who="controller",
        detect="touch: displacement beyond z_max_um without contact",
        message="No contact where the surface was expected.",
        hint="Check the tool (lost or broken?), the continuity wire and the site.",
    ),
    2006: FaultRow(
        code=2006,
        name="STUCK_CONTACT",
        who="controller",
        detect="touch: contact reads closed before the feed, or stays closed after the back-off",
        message="The contact sensor reads closed although the tool is retracted.",
        hint="Look for a chip between tool and work, or a shorted continuity wire.",
    ),
    2007: FaultRow(
        code=2007,
        name="COLLISION",
        who="controller",
        detect="contact while PIEZO_SET moves the tool towards the work",
        message="The tool ran into the work during a plain ramp; it was retracted.",
        hint="Drive the stage to its parking place before full-stroke ramps, and check setup.stage.",
    ),
    3001: FaultRow(
        code=3001,
        name="SHORT_STUCK",
        who="controller",
        detect="continuous short for short_stuck_s although the tool retracts",
        message="A short did not clear while the tool retracted.",
        hint="Look for a debris bridge, a bent tool or a wiring short, and flush the gap.",
    ),
    3002: FaultRow(
        code=3002,
        name="ARC_BURN",
        who="controller",
        detect="arc_run consecutive arcs",
        message="The discharges turned into an arc that stays in one place.",
        hint="Flush better (shorter jump.period_s, greater jump.height_um) or lower pulse.duty.",
    ),
    3005: FaultRow(
        code=3005,
        name="NO_SPARK",
        who="controller",
        detect=(
            "approach: max_travel_um without a spark; machining: open_lost_um or open_lost_s of open pulses"
        ),
        message="No sparks where they were expected.",
        hint="Check the tool (lost or broken?), the generator and the offset to the work.",
    ),
    4001: FaultRow(
        code=4001,
        name="ESTOP",
        who="controller",
        detect="emergency-stop input",
        message="Emergency stop.",
        hint="Release the button.",
    ),
    4003: FaultRow(
        code=4003,
        name="DIELECTRIC",
        who="controller",
        detect="level, flow_min_lpm or temperature_max_c violated while armed",
        message="The dielectric is low, does not flow, or is too hot: fire hazard.",
        hint="Restore level, flow and temperature before anything else.",
    ),
}
