"""Part 1, with the high voltage off and nothing armed: link, inputs, contact, sensors at rest."""

from __future__ import annotations

from statistics import fmean, pstdev

from edmctl.board.first_start import nets
from edmctl.board.first_start.checklist import (
    NOT_FITTED,
    Cause,
    Check,
    Checklist,
    Finding,
    ItemStatus,
    Part,
    Skip,
    cause,
    wrong,
)
from edmctl.board.first_start.person import ACTS, CHAIN_HIGH_V, CHAIN_LOW_V
from edmctl.dataclasses import dataclass
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.messages import SCHEMA_HASH, ResetCause
from edmctl.machine.faults import INTERLOCKS
from edmctl.machine.interface import Interlock, TelemetryFlag
from edmctl.wording import decimal

LINE_S = 0.5
TEMPERATURES_C = (5.0, 45.0)
GAP_ZERO_V = 1.0
BATTERY_SHARE, BATTERY_V = 0.1, 0.3
"""Tolerance of a battery's reading, relative and absolute: divider of 1 % resistors, and converter."""
USUAL_BATTERY_V, APART_V = 9.0, 2.0
MONITOR_ZERO_V = 1.5
REST_UM, NOISE_UM = 60.0, 2.0
UNREADABLE_UM = 2000.0
"""A controller reports a displacement beyond this if its reading has failed."""
PART = Part("high voltage off")


@PART.check("ready", "ready", "The state of the machine was asked for.", "as it is to begin with")
def ready(c: Checklist) -> Finding:
    return c.allow("ready")


@PART.check(
    "link",
    "link and identity",
    "The controller was identified; the line was watched for half a second.",
    "the schema of this program, a serial number, no damaged frame, no fault but that of the e-stop",
)
def link(c: Checklist) -> Finding:
    hello, identity = c.machine.hello, c.machine.identity
    before = c.machine.link_report()
    c.machine.pass_time(LINE_S)
    report, fault = c.machine.link_report(), c.machine.readings().fault
    damaged = report.bad_frames - before.bad_frames
    damaged += report.controller_bad_frames - before.controller_bad_frames
    repeated = report.retries - before.retries
    reset = hello.reset_cause
    why = ResetCause(reset).name.lower().replace("_", " ") if reset in list(ResetCause) else f"cause {reset}"
    read = (
        f"{identity.serial or 'no serial number'}, board {hello.board}, firmware {identity.firmware}, protocol "
        f"{identity.protocol}, schema 0x{SCHEMA_HASH:08X}, boot {hello.boot_count} by {why}; {damaged} damaged and "
        f"{repeated} repeated frames; fault {fault or 'none'}"
    )
    causes = []
    if damaged or repeated:
        text = "frames are damaged: no common ground, a long or unshielded cable, another baud"
        causes.append(cause(text, nets.LINE))
    if fault == FaultCode.RESET:
        text = f"the board has restarted by itself: 5 V supply or watchdog; clear it: `edmctl reset --ack {fault}`"
        causes.append(cause(text, "5 V"))
    elif fault and fault != FaultCode.ESTOP:
        message = FAULTS[fault].message if fault in FAULTS else "an unknown one"
        causes.append(cause(f"a fault is latched from before: {message} `edmctl reset --ack {fault}`"))
    return Finding(read, tuple(causes))


def open_inputs(c: Checklist) -> Interlock:
    """Return the open inputs. An input that chatters counts as open."""
    bits = Interlock(0)
    for status in c.read():
        bits |= status.interlocks
    return bits


def names_of(bits: Interlock) -> str:
    return ", ".join(name for bit, (name, _, _) in INTERLOCKS.items() if bit in bits) or "none"


@dataclass(frozen=True, slots=True)
class Switch:
    """An interlock input that a person can open and close."""

    key: str
    title: str
    bit: Interlock
    net: str
    open_by: str
    close_by: str


SWITCHES = (
    Switch("estop", "e-stop", Interlock.ESTOP, nets.ESTOP, "estop-press", "estop-release"),
    Switch("door", "door", Interlock.DOOR, nets.DOOR, "door-open", "door-close"),
    Switch("level", "dielectric level", Interlock.DIELECTRIC_LEVEL, nets.LEVEL, "level-low", "level-ok"),
    Switch("flow", "dielectric flow", Interlock.DIELECTRIC_FLOW, nets.FLOW, "pump-off", "pump-on"),
)
NETS_OF = {switch.bit: switch.net for switch in SWITCHES} | {
    Interlock.HV_SUPPLY: nets.SUPPLY_OK,
    Interlock.DIELECTRIC_HOT: nets.TEMPERATURE,
}
COLD = f"link break-chain supply-off temperature {' '.join(switch.key for switch in SWITCHES)}"
"""What must be right before anything is energised."""


@dataclass(frozen=True, slots=True)
class Cycle:
    """Open inputs before, while and after a switch is open."""

    rest: Interlock
    during: Interlock
    back: Interlock

    @property
    def changed(self) -> Interlock:
        return self.rest ^ self.during


def _declare(switch: Switch) -> Check:
    def look(c: Checklist) -> Finding:
        if "switches" not in c.kept:
            c.kept["switches"] = _operate_switches(c)
        outcome = c.kept["switches"][switch.key]
        if isinstance(outcome, Skip):
            raise outcome
        return outcome  # type: ignore[no-any-return]

    done = f"{ACTS[switch.open_by].text} {ACTS[switch.close_by].text} Every input was read at each."
    expected = "its own input opens and closes again, and no other"
    return PART.check(switch.key, switch.title, done, expected)(look)


for _switch in SWITCHES:
    _declare(_switch)


def _operate_switches(c: Checklist) -> dict[str, Finding | Skip]:
    """Open and close every switch before evaluating: exchanged wires show in two of them."""
    cycles: dict[Interlock, Cycle] = {}
    outcomes: dict[str, Finding | Skip] = {}
    for switch in SWITCHES:
        rest = open_inputs(c)
        try:
            during = _operate(c, switch, switch.open_by, rest)
            cycles[switch.bit] = Cycle(rest, during, _operate(c, switch, switch.close_by, during))
        except Skip as skip:
            outcomes[switch.key] = skip
    for switch in SWITCHES:
        if switch.key in outcomes:
            continue
        causes, explained = _evaluate(switch, cycles)
        for other in SWITCHES:
            if other.bit in explained:
                outcomes[other.key] = Skip(f"reported at: {switch.title}")
        cycle = cycles[switch.bit]
        read = (
            f"open inputs at rest: {names_of(cycle.rest)}; then: {names_of(cycle.during)}; at the end: "
            f"{names_of(cycle.back)}"
        )
        outcomes[switch.key] = Finding(read, causes)
    return outcomes


def _operate(c: Checklist, switch: Switch, key: str, before: Interlock) -> Interlock:
    """Have a switch operated, report what changed, and return the open inputs."""
    c.act(key)
    after = open_inputs(c)
    changes = [
        f"{INTERLOCKS[bit][0]} {'opens' if bit in after else 'closes'}"
        for bit in Interlock
        if bit in before ^ after
    ]
    expected = f"{INTERLOCKS[switch.bit][0]} {'opens' if key == switch.open_by else 'closes'}"
    note = "" if changes == [expected] else f"; expected: {expected}"
    c.say(f"{'read':10}{', '.join(changes) or 'no input changed'}{note}")
    return after


def _evaluate(switch: Switch, cycles: dict[Interlock, Cycle]) -> tuple[tuple[Cause, ...], list[Interlock]]:
    """Return the likely mistakes of a switch, and the other switches that they explain."""
    cycle, bit, net = cycles[switch.bit], switch.bit, switch.net
    others = [other for other in Interlock if other in cycle.changed and other != bit]
    if others:
        crossed = " and ".join(NETS_OF[other] for other in others)
        affected = (net, *(NETS_OF[other] for other in others))
        if bit in cycle.changed:
            text = (
                f"{net} and {crossed} change together: bridged, or the one switches the supply of the other"
            )
            return (cause(text, *affected),), []
        exchanged = [other for other in others if other in cycles and cycles[other].changed == bit]
        if exchanged:
            return (cause(f"{net} and {crossed} are exchanged", *affected),), exchanged
        return (cause(f"the wire of {net} goes to {crossed}", *affected),), []
    if bit in cycle.changed:
        if bit in cycle.rest:
            text = "the input is inverted: a contact of the other kind, or the wrong level"
        elif cycle.back != cycle.rest:
            text = "the input does not come back: a contact that sticks, or one that latches"
        else:
            return (), []
    elif bit is Interlock.DIELECTRIC_FLOW:
        if bit in cycle.rest:
            text = (
                "the flow always reads too low: wire off, sensor without supply, or fitted against the flow"
            )
        else:
            text = "the flow does not stop with the pump: the wire is bridged, or its scale is wrong"
    elif bit in cycle.rest:
        text = "the input always reads open: wire off, or its contacts have no 3.3 V"
    else:
        text = "the input always reads closed: bridged, or shorted to 3.3 V"
    return (cause(text, net),), []


@PART.check(
    "supply-off",
    "high voltage ok",
    "The supply is off; the input was read.",
    "the input reads that it is off",
)
def supply_off(c: Checklist) -> Finding:
    bits = open_inputs(c)
    read = f"open inputs: {names_of(bits)}"
    if Interlock.HV_SUPPLY in bits:
        return Finding(read)
    text = "the input reads ok with the supply off: bridged, shorted to 3.3 V, or the supply is on"
    return wrong(read, text, nets.SUPPLY_OK)


@PART.check(
    "temperature",
    "temperature",
    "The temperature of the dielectric was read.",
    f"{TEMPERATURES_C[0]:g} to {TEMPERATURES_C[1]:g} °C",
)
def temperature(c: Checklist) -> Finding:
    value_c = c.mean("temperature_c")
    read = f"{decimal(value_c, 1)} °C"
    if TEMPERATURES_C[0] <= value_c <= TEMPERATURES_C[1]:
        return Finding(read)
    text = "not the temperature of a workshop: wire off or shorted, or the wrong divider"
    return wrong(read, text, nets.TEMPERATURE)


@PART.check(
    "break-chain",
    "break chain",
    "The voltage of the break chain was measured by hand.",
    f"above {CHAIN_HIGH_V:g} V with e-stop released and door closed, below {CHAIN_LOW_V:g} V with either open",
)
def break_chain(c: Checklist) -> Finding:
    if c.machine.identity.simulated:
        raise Skip("a virtual machine has no chain that acts without its controller", absent=True)
    if c.ask("break-chain") == "yes":
        return Finding("as expected, according to the operator")
    text = (
        "not healthy, or not broken by e-stop and door: they have to be in series, with the over-current comparator "
        "in the same chain"
    )
    return wrong("not as expected, according to the operator", text, nets.BREAK)


@PART.check(
    "contact",
    "contact input",
    "Tool and workpiece were connected with a wire, and the wire was taken off.",
    "open, closed, open, without chatter",
)
def contact(c: Checklist) -> Finding:
    rest = _is_closed(c)
    c.act("contact-close")
    bridged = _is_closed(c)
    c.act("contact-open")
    after = _is_closed(c)
    words = {None: "chatters", True: "closed", False: "open"}
    read = ", ".join(words[state] for state in (rest, bridged, after))
    if (rest, bridged, after) == (False, True, False):
        return Finding(read)
    if None in (rest, bridged, after):
        text = "contact input chatters: a loose wire, or no pull-down"
    elif rest and not bridged:
        text = "contact input reads closed with nothing connected and open with the wire: input inverted"
    elif rest:
        text = (
            "contact input reads closed with nothing connected: shorted to 3.3 V, or tool and workpiece touch"
        )
    elif not bridged:
        text = (
            "contact input does not close: wire off, tool or workpiece not connected, the circuit has no supply, or "
            "the mode switch stands at the generator (then a meter across the open gap shows 0 V, else 0.8 V)"
        )
        return wrong(read, text, nets.CONTACT, nets.MODE)
    else:
        text = "contact input does not open again: something still connects tool and workpiece"
    return wrong(read, text, nets.CONTACT)


def _is_closed(c: Checklist) -> bool | None:
    """Return whether the contact is closed; None if readings differ."""
    flags = {TelemetryFlag.CONTACT in status.flags for status in c.read()}
    return flags.pop() if len(flags) == 1 else None


@PART.check(
    "gap-battery",
    "gap sensor on a battery",
    "A battery was connected to the gap.",
    f"its voltage within {100.0 * BATTERY_SHARE:.0f} % and {BATTERY_V:g} V",
)
def gap_battery(c: Checklist) -> Finding:
    before_v = c.mean("gap_v")
    kind = "battery" if abs(before_v - USUAL_BATTERY_V) >= APART_V else "low-battery"
    battery_v = float(c.ask(f"{kind}-volts"))
    if abs(before_v - battery_v) < APART_V:
        raise Skip(
            f"{battery_v:g} V is too close to the {decimal(before_v)} V that the controller still shows"
        )
    c.act(f"{kind}-on")
    value_v = c.mean("gap_v")
    read = f"{decimal(before_v)} V before, {decimal(value_v)} V of {decimal(battery_v)} V"
    if abs(value_v - battery_v) <= BATTERY_SHARE * battery_v + BATTERY_V:
        c.kept["battery_v"] = value_v
        c.act("battery-off")
        return Finding(read)
    if abs(value_v - before_v) >= GAP_ZERO_V:
        c.act("battery-off")
        text = f"gap sensor reads {value_v / battery_v:.2f} of the voltage: a wrong resistor in its divider"
        return wrong(read, text, nets.GAP)
    c.act("battery-turn")
    turned_v = c.mean("gap_v")
    c.act("battery-off")
    read += f", {decimal(turned_v)} V with the battery turned round"
    if abs(turned_v - before_v) >= GAP_ZERO_V:
        text = "gap voltage is reversed: plus and minus of the sensor are exchanged"
    else:
        text = "gap voltage is not connected: wire off between gap, divider and input"
    return wrong(read, text, nets.GAP)


@PART.check(
    "gap-rest",
    "gap sensor at rest",
    "The gap voltage was read, without the battery.",
    f"less than {GAP_ZERO_V:g} V",
)
def gap_rest(c: Checklist) -> Finding:
    """Without pulses a controller keeps its last gap voltage until there is something to read (docs/protocol.md)."""
    battery = c.status_of("gap-battery")
    if battery is ItemStatus.FAIL:
        raise Skip("needs: gap sensor on a battery")
    value_v = c.mean("gap_v")
    read = f"{decimal(value_v)} V"
    if value_v < GAP_ZERO_V:
        return Finding(read)
    if battery is not ItemStatus.PASS:
        raise Skip(f"the controller may show {read} of an earlier reading, which only a battery can tell")
    if abs(value_v - c.kept["battery_v"]) < GAP_ZERO_V:
        return Finding(f"{read}, the last reading of the battery: the sensor reads nothing now")
    text = "gap sensor reads a voltage without one: its ground is off, or its amplifier's offset; or a supply is on"
    return wrong(read, text, nets.GAP)


@PART.check(
    "monitor-rest",
    "actuator monitor at rest",
    "The monitor was read with the amplifier off.",
    f"0 V within {MONITOR_ZERO_V:g} V",
)
def monitor_rest(c: Checklist) -> Finding:
    value_v = c.mean("monitor_v")
    if abs(value_v) <= MONITOR_ZERO_V:
        return Finding(f"{decimal(value_v)} V")
    text = "actuator monitor reads a voltage with the amplifier off: wire off or shorted, or its offset"
    return wrong(f"{decimal(value_v)} V", text, nets.MONITOR)


@PART.check(
    "displacement-rest",
    "displacement sensor at rest",
    "The sensor was read.",
    f"within {REST_UM:g} µm of 0, noise below {NOISE_UM:g} µm rms and not none",
)
def displacement_rest(c: Checklist) -> Finding:
    if not c.setup.sensor.fitted:
        raise Skip(NOT_FITTED, absent=True)
    values_um = [status.displacement_um for status in c.read()]
    if max(map(abs, values_um)) >= UNREADABLE_UM:
        text = "displacement sensor gives no reading: wire off, or at the end of its range"
        return wrong("none", text, nets.DISPLACEMENT)
    value_um, noise_um = fmean(values_um), pstdev(values_um)
    read = f"{decimal(value_um)} µm, noise {decimal(noise_um)} µm rms"
    if abs(value_um) > REST_UM:
        text = "displacement sensor is far from its zero: not adjusted, or its scale is wrong"
    elif noise_um > NOISE_UM:
        text = "displacement sensor is noisy: its shield is off, or a loose wire"
    elif noise_um == 0.0:
        text = "displacement sensor does not change by a digit: wire off, or the converter has stopped"
    else:
        return Finding(read)
    return wrong(read, text, nets.DISPLACEMENT)
