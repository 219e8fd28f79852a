"""Part 1, with the high voltage off and nothing armed: link, inputs, contact, sensors at rest."""

from __future__ import annotations

from functools import partial
from statistics import fmean, pstdev

from edmctl.board.first_start.checklist import (
    ACTS,
    NETS,
    NOT_FITTED,
    Checklist,
    Finding,
    ItemStatus,
    Skip,
    check,
    mistake,
    wrong,
)
from edmctl.dataclasses import dataclass
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.messages import SCHEMA_HASH, ResetCause
from edmctl.machine.faults import INTERLOCKS
from edmctl.machine.interface import Interlock, TelemetryFlag
from edmctl.wording import decimal

LINE_S, TEMPERATURES_C = 0.5, (5.0, 45.0)
GAP_ZERO_V, MONITOR_ZERO_V = 1.0, 1.5
BATTERY_SHARE, BATTERY_V = 0.1, 0.3
"""Tolerance of a battery's reading, relative and absolute: divider of 1 % resistors, and converter."""
USUAL_BATTERY_V, APART_V = 9.0, 2.0
REST_UM, NOISE_UM = 60.0, 2.0
UNREADABLE_UM = 2000.0
"""A controller reports a displacement beyond this if its reading has failed."""


@check("ready")
def ready(c: Checklist) -> Finding:
    return c.allow("ready")


@check("link")
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
    causes = [mistake("line_damaged")] if damaged or repeated else []
    if fault == FaultCode.RESET:
        causes.append(mistake("board_restarted", fault=fault))
    elif fault and fault != FaultCode.ESTOP:
        message = FAULTS[fault].message if fault in FAULTS else "an unknown one"
        causes.append(mistake("fault_before", fault=fault, message=message))
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
    """An interlock input that a person can open and close; its item has the key of its net."""

    key: str
    bit: Interlock
    open_by: str
    close_by: str


SWITCHES = (
    Switch("estop", Interlock.ESTOP, "estop-press", "estop-release"),
    Switch("door", Interlock.DOOR, "door-open", "door-close"),
    Switch("level", Interlock.DIELECTRIC_LEVEL, "level-low", "level-ok"),
    Switch("flow", Interlock.DIELECTRIC_FLOW, "pump-off", "pump-on"),
)
NETS_OF = {switch.bit: NETS[switch.key] for switch in SWITCHES} | {
    Interlock.HV_SUPPLY: NETS["supply_ok"],
    Interlock.DIELECTRIC_HOT: NETS["temperature"],
}


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


def _switch(c: Checklist, switch: Switch) -> Finding:
    """Open and close a switch. Raises Skip if its wire is exchanged with that of an earlier one."""
    rest, net = open_inputs(c), NETS[switch.key]
    during = _operate(c, switch, switch.open_by, rest)
    back = _operate(c, switch, switch.close_by, during)
    read = f"open inputs at rest: {names_of(rest)}; then: {names_of(during)}; at the end: {names_of(back)}"
    is_open, has_changed = switch.bit in rest, switch.bit in rest ^ during
    others = [bit for bit in Interlock if bit in rest ^ during and bit != switch.bit]
    if others:
        crossed = [NETS_OF[bit] for bit in others]
        if not has_changed and c.kept.get(f"crossed {crossed[0]}") == net:
            raise Skip(f"reported at: {crossed[0]}")
        c.kept[f"crossed {net}"] = crossed[0]
        name = "switch_bridged" if has_changed else "switch_exchanged"
        return wrong(read, name, net, *crossed, net=net, crossed=" and ".join(crossed))
    if has_changed and not is_open and back == rest:
        return Finding(read)
    if has_changed:
        name = "switch_inverted" if is_open else "switch_sticks"
    elif switch.bit is Interlock.DIELECTRIC_FLOW:
        name = "flow_low" if is_open else "flow_constant"
    else:
        name = "switch_open" if is_open else "switch_closed"
    return wrong(read, name, net)


for _row in SWITCHES:
    _done = f"{ACTS[_row.open_by].text} {ACTS[_row.close_by].text}"
    check(_row.key, done=_done)(partial(_switch, switch=_row))


@check("supply-off")
def supply_off(c: Checklist) -> Finding:
    bits = open_inputs(c)
    read = f"open inputs: {names_of(bits)}"
    return Finding(read) if Interlock.HV_SUPPLY in bits else wrong(read, "supply_reads_on")


@check("temperature", low=TEMPERATURES_C[0], high=TEMPERATURES_C[1])
def temperature(c: Checklist) -> Finding:
    value_c = c.mean("temperature_c")
    read, (low_c, high_c) = f"{decimal(value_c, 1)} °C", TEMPERATURES_C
    return Finding(read) if low_c <= value_c <= high_c else wrong(read, "temperature_wrong")


@check("break-chain")
def break_chain(c: Checklist) -> Finding:
    if c.machine.identity.simulated:
        raise Skip("a virtual machine has no chain that acts without its controller", absent=True)
    if c.ask("break-chain") == "yes":
        return Finding("as expected, according to the operator")
    return wrong("not as expected, according to the operator", "chain_wrong")


@check("contact")
def contact(c: Checklist) -> Finding:
    rest = _is_closed(c)
    c.act("contact-close")
    bridged = _is_closed(c)
    c.act("contact-open")
    states = (rest, bridged, _is_closed(c))
    words = {None: "chatters", True: "closed", False: "open"}
    read = ", ".join(words[state] for state in states)
    if states == (False, True, False):
        return Finding(read)
    if None in states:
        return wrong(read, "contact_chatters")
    if rest:
        return wrong(read, "contact_closed" if bridged else "contact_inverted")
    return wrong(read, "contact_sticks" if bridged else "contact_open")


def _is_closed(c: Checklist) -> bool | None:
    """Return whether the contact is closed; None if readings differ."""
    flags = {TelemetryFlag.CONTACT in status.flags for status in c.read()}
    return flags.pop() if len(flags) == 1 else None


@check("gap-battery", share=BATTERY_SHARE, volts=BATTERY_V)
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
        return wrong(read, "gap_scale", share=value_v / battery_v)
    c.act("battery-turn")
    turned_v = c.mean("gap_v")
    c.act("battery-off")
    read += f", {decimal(turned_v)} V with the battery turned round"
    return wrong(read, "gap_reversed" if abs(turned_v - before_v) >= GAP_ZERO_V else "gap_open")


@check("gap-rest", volts=GAP_ZERO_V)
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
    return wrong(read, "gap_offset")


@check("monitor-rest", volts=MONITOR_ZERO_V)
def monitor_rest(c: Checklist) -> Finding:
    value_v = c.mean("monitor_v")
    read = f"{decimal(value_v)} V"
    return Finding(read) if abs(value_v) <= MONITOR_ZERO_V else wrong(read, "monitor_rest")


@check("displacement-rest", rest=REST_UM, noise=NOISE_UM)
def displacement_rest(c: Checklist) -> Finding:
    if not c.setup.sensor.fitted:
        raise Skip(NOT_FITTED, absent=True)
    values_um = [status.displacement_um for status in c.read()]
    if max(map(abs, values_um)) >= UNREADABLE_UM:
        return wrong("none", "displacement_none")
    value_um, noise_um = fmean(values_um), pstdev(values_um)
    read = f"{decimal(value_um)} µm, noise {decimal(noise_um)} µm rms"
    if abs(value_um) > REST_UM:
        return wrong(read, "displacement_far")
    if noise_um > NOISE_UM:
        return wrong(read, "displacement_noisy")
    return Finding(read) if noise_um else wrong(read, "displacement_constant")
