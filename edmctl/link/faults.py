"""Faults of the machine, whoever detects them.

Made from faults.toml by `python -m tools.generate`; edit that file, not this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


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


FAULTS = {
    row.code: row
    for row in (
        FaultRow(
            code=1001,
            name="HOST_SILENT",
            who="controller",
            message=(
                "The host fell silent for {watchdog_s} s or another took its place: pulses off, tool "
                "retracted."
            ),
            hint="Look for a sleeping computer, a killed process or a loose cable.",
            exit_code=6,
            error="E61001",
            pulses_off_s=0.255,
            latched=True,
            inject="SILENCE",
        ),
        FaultRow(
            code=1002,
            name="ABORT_RUN",
            who="controller",
            message="The host aborted: pulses off, tool retracted.",
            hint="Nothing is wrong with the machine.",
            exit_code=6,
            error="E61002",
            pulses_off_s=0.005,
            latched=True,
            inject="ABORT_RUN",
        ),
        FaultRow(
            code=1003,
            name="LINE_NOISE",
            who="controller",
            message="The line is disturbed: {bad_frames:.0f} damaged frames arrived within a second.",
            hint=(
                "Lay the cable away from the generator, use a shielded one with a ferrite, and check the "
                "ground of the machine."
            ),
            exit_code=6,
            error="E61003",
            pulses_off_s=1.005,
            latched=True,
            inject="LINE_NOISE",
        ),
        FaultRow(
            code=2001,
            name="TRAVEL_LIMIT",
            who="controller",
            message="The actuator reached its voltage limit before the target: the stroke is used up.",
            hint=(
                "Lower the depth, start closer (approach.offset_um), or raise limits.stroke_v_max (150 V at"
                " most)."
            ),
            exit_code=6,
            error="E62001",
            pulses_off_s=0.505,
            latched=True,
            inject="ACTUATOR_WEAK",
        ),
        FaultRow(
            code=2002,
            name="PIEZO_TRACK",
            who="controller",
            message=(
                "The actuator's voltage did not follow its command for {track_s} s: the amplifier is off, "
                "overloaded, or its cable is out."
            ),
            hint=(
                "Switch the amplifier on, check its cable to the actuator and its monitor output, then let "
                "it cool down."
            ),
            exit_code=6,
            error="E62002",
            pulses_off_s=0.06,
            latched=True,
            inject="AMPLIFIER_DEAD",
        ),
        FaultRow(
            code=2003,
            name="PIEZO_OV",
            who="controller",
            message="The voltage on the actuator left its range of {monitor_min_v} to {monitor_max_v} V.",
            hint=(
                "Do not go on with this amplifier: measure its output with the actuator unplugged, and "
                "check the monitor's cable."
            ),
            exit_code=6,
            error="E62003",
            pulses_off_s=0.005,
            latched=True,
            inject="MONITOR_HIGH",
        ),
        FaultRow(
            code=2004,
            name="STAGE_LIMIT",
            who="controller",
            message="A stage ran onto its limit switch.",
            hint=(
                "Drive the stage off the switch by hand, then check setup.stage and the sites of the profile."
            ),
            exit_code=6,
            error="E62004",
            pulses_off_s=0.005,
            latched=True,
            inject="STAGE_LIMIT",
        ),
        FaultRow(
            code=2005,
            name="NO_CONTACT",
            who="controller",
            message="No contact where the surface was expected.",
            hint="Check the tool (lost or broken?), the continuity wire and the site.",
            exit_code=6,
            error="E62005",
            pulses_off_s=0.005,
            latched=True,
            inject="TOOL_LOST@touch+0",
        ),
        FaultRow(
            code=2006,
            name="STUCK_CONTACT",
            who="controller",
            message="The contact sensor reads closed although the tool is retracted.",
            hint="Look for a chip between tool and work, or a shorted continuity wire.",
            exit_code=6,
            error="E62006",
            pulses_off_s=0.005,
            latched=True,
            inject="STUCK_CONTACT",
        ),
        FaultRow(
            code=2007,
            name="COLLISION",
            who="controller",
            message="The tool ran into the work during a plain ramp; it was retracted.",
            hint=("Drive the stage to its parking place before full-stroke ramps, and check setup.stage."),
            exit_code=6,
            error="E62007",
            pulses_off_s=0.005,
            latched=True,
            inject="OBSTACLE",
        ),
        FaultRow(
            code=3001,
            name="SHORT_STUCK",
            who="controller",
            message="A short did not clear while the tool retracted.",
            hint="Look for a debris bridge, a bent tool or a wiring short, and flush the gap.",
            exit_code=6,
            error="E63001",
            pulses_off_s=3.01,
            latched=True,
            inject="WIRE_SHORT",
        ),
        FaultRow(
            code=3002,
            name="ARC_BURN",
            who="controller",
            message="The discharges turned into an arc that stays in one place.",
            hint="Flush better (shorter jump.period_s, greater jump.height_um) or lower pulse.duty.",
            exit_code=6,
            error="E63002",
            pulses_off_s=0.25,
            latched=True,
            inject="CARBON",
        ),
        FaultRow(
            code=3003,
            name="GAP_SENSOR",
            who="controller",
            message=(
                "The gap voltage reading is wrong: it contradicts the generator, the current or the contact."
            ),
            hint=(
                "Check the wires of the gap voltage divider at tool and work; a loose one reads 0 V, one "
                "without its work side the open voltage."
            ),
            exit_code=6,
            error="E63003",
            pulses_off_s=0.1,
            latched=True,
            inject="GAP_SENSOR_HIGH",
        ),
        FaultRow(
            code=3004,
            name="GEN_FAULT",
            who="controller",
            message=(
                "The generator does not switch off, or gives more than {over_current} times the current set."
            ),
            hint=(
                "Switch the generator off at its mains switch; its power transistor or its current limit "
                "has failed."
            ),
            exit_code=6,
            error="E63004",
            pulses_off_s=0.005,
            latched=True,
            inject="GENERATOR_LEAK",
        ),
        FaultRow(
            code=3005,
            name="NO_SPARK",
            who="controller",
            message="No sparks where they were expected.",
            hint="Check the tool (lost or broken?), the generator and the offset to the work.",
            exit_code=6,
            error="E63005",
            pulses_off_s=10.005,
            latched=True,
            inject="TOOL_LOST",
        ),
        FaultRow(
            code=3006,
            name="MODE_SWITCH",
            who="controller",
            message=(
                "The generator came through in measure mode: the switch between machining and measuring "
                "hangs."
            ),
            hint=(
                "Switch the high voltage off, then check the changeover relay; its contacts may be welded."
            ),
            exit_code=6,
            error="E63006",
            pulses_off_s=0.005,
            latched=True,
            inject="MODE_SWITCH",
        ),
        FaultRow(
            code=4001,
            name="ESTOP",
            who="controller",
            message="Emergency stop.",
            hint="Release the button when the reason is gone.",
            exit_code=6,
            error="E64001",
            pulses_off_s=0.005,
            latched=True,
            inject="ESTOP",
        ),
        FaultRow(
            code=4002,
            name="DOOR",
            who="controller",
            message="The door of the machine was opened.",
            hint="Close the door.",
            exit_code=6,
            error="E64002",
            pulses_off_s=0.005,
            latched=True,
            inject="DOOR",
        ),
        FaultRow(
            code=4003,
            name="DIELECTRIC",
            who="controller",
            message="The dielectric is low, does not flow, or is too hot: fire hazard.",
            hint="Restore level, flow and temperature before anything else.",
            exit_code=6,
            error="E64003",
            pulses_off_s=0.005,
            latched=True,
            inject="DIELECTRIC_LEVEL",
        ),
        FaultRow(
            code=4004,
            name="HV_SUPPLY",
            who="controller",
            message="The high-voltage supply of the generator is off or reports a failure.",
            hint="Switch the supply on, and look at its own display and fuse.",
            exit_code=6,
            error="E64004",
            pulses_off_s=0.005,
            latched=True,
            inject="HV_SUPPLY",
        ),
        FaultRow(
            code=5001,
            name="RESET",
            who="both",
            message="The controller restarted by itself: a brown-out of its supply, or its program hung.",
            hint="Look for a weak 5 V supply, a loose plug or a relay on the same supply.",
            exit_code=4,
            error="E4005",
            pulses_off_s=0.005,
            latched=True,
            inject="WATCHDOG",
        ),
        FaultRow(
            code=7001,
            name="Z_MISMATCH",
            who="host",
            message="The displacement sensor and the actuator's model disagree.",
            hint=("Check the sensor's fixing and cable; if both are sound, run `edmctl calibrate` again."),
            exit_code=6,
            error="E67001",
            pulses_off_s=2.5,
            latched=False,
            inject="SENSOR_DRIFT",
        ),
        FaultRow(
            code=7002,
            name="STROKE_END",
            who="host",
            message="The cut came to the end of its depth, feed or stroke.",
            hint=(
                "Start closer (approach.offset_um), lower the target, or allow more stroke "
                "(limits.stroke_v_max)."
            ),
            exit_code=7,
            error="E7011",
            pulses_off_s=0.5,
            latched=False,
            inject="ACTUATOR_WEAK",
        ),
        FaultRow(
            code=7003,
            name="STALL",
            who="host",
            message="The tool has stopped advancing.",
            hint=(
                "Flush better (shorter jump.period_s), look at the tool, or check pulse.polarity and "
                "pulse.current_a."
            ),
            exit_code=7,
            error="E7010",
            pulses_off_s=90.0,
            latched=False,
            inject="STALL",
        ),
        FaultRow(
            code=7004,
            name="TIMEOUT",
            who="host",
            message="The job took longer than it may.",
            hint="Flush better, lower servo.reference, or raise limits.max_time_s.",
            exit_code=7,
            error="E7012",
            pulses_off_s=0.5,
            latched=False,
            inject="profile",
        ),
        FaultRow(
            code=7005,
            name="SETUP",
            who="host",
            message=(
                "The tool wears far faster than expected: polarity, material or the expected wear is wrong."
            ),
            hint=(
                "Check the polarity of the generator, tool.material against the tool in the holder, and "
                "wear.expected_ratio."
            ),
            exit_code=6,
            error="E67005",
            pulses_off_s=0.0,
            latched=False,
            inject="WEAR_FAST",
        ),
        FaultRow(
            code=7006,
            name="LOG",
            who="host",
            message="The run file could not be written any more.",
            hint="Free some space, or say --out with a folder on another disk.",
            exit_code=9,
            error="E9003",
            pulses_off_s=5.0,
            latched=False,
            inject="disk",
        ),
        FaultRow(
            code=7007,
            name="POWER_LOSS",
            who="host",
            message="The controller lost its power and started again.",
            hint="Look at the supply and the plug of the controller.",
            exit_code=4,
            error="E4005",
            pulses_off_s=0.005,
            latched=False,
            inject="POWER_LOSS",
        ),
        FaultRow(
            code=7008,
            name="SAMPLES_LOST",
            who="host",
            message=(
                "The controller answers, but its samples do not come any more: nobody knows where the tool "
                "stands."
            ),
            hint="Look at the line with `edmctl doctor`, and at what else keeps the controller busy.",
            exit_code=4,
            error="E4022",
            pulses_off_s=1.2,
            latched=False,
            inject="SAMPLES_LOST",
        ),
        FaultRow(
            code=7009,
            name="TELEMETRY_WRONG",
            who="host",
            message="The controller says what cannot be.",
            hint=(
                "Nothing that it says can be relied on: restart it, and update its firmware or have its "
                "sensors looked at if it says so again."
            ),
            exit_code=6,
            error="E67009",
            pulses_off_s=0.3,
            latched=False,
            inject="SAMPLES_FROZEN",
        ),
    )
}
