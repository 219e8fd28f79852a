"""The first part, with the high voltage off and nothing armed: who answers, inputs, contact, sensors at rest."""

from __future__ import annotations

from functools import partial
from statistics import pstdev

from edmctl.board.first_start import nets
from edmctl.board.first_start.checklist import Checklist, Found, Skip, Spec, mean, wrong
from edmctl.board.first_start.nets import cause
from edmctl.board.first_start.person import ACTS, CHAIN_HIGH_V, CHAIN_LOW_V
from edmctl.board.results import Cause, ItemStatus
from edmctl.dataclasses import dataclass
from edmctl.link.faults import FAULTS, FaultCode
from edmctl.link.messages import SCHEMA_HASH, ResetCause
from edmctl.machine.faults import INTERLOCKS
from edmctl.machine.interface import Interlock, TelemetryFlag
from edmctl.wording import decimal

PART = "high voltage off"
LINE_S = 0.5
TEMPERATURES_C = (5.0, 45.0)
GAP_ZERO_V = 1.0
BATTERY_SHARE, BATTERY_V = 0.1, 0.3
"""Of its own voltage, and besides: what a divider of 1 % resistors and a converter may be off."""
USUAL_BATTERY_V, APART_V = 9.0, 2.0
MONITOR_ZERO_V = 1.5
REST_UM, NOISE_UM = 60.0, 2.0
UNREADABLE_UM = 2000.0
"""A displacement beyond this is what a controller tells of a reading that has failed."""

READY = Spec("ready", "ready", "The state of the machine was asked for.", "as it is to begin with")
LINK = Spec(
    "link",
    "link and identity",
    "The controller said who it is; the line was watched for half a second.",
    "the schema of this program, a serial number, no damaged frame, no fault but that of the e-stop",
)
BREAK = Spec(
    "break-chain",
    "break chain",
    "The voltage of the break chain was measured by hand.",
    f"above {CHAIN_HIGH_V:g} V with e-stop released and door closed, below {CHAIN_LOW_V:g} V with either open",
)
SUPPLY_OFF = Spec(
    "supply-off",
    "high voltage ok",
    "The supply is off; the input was read.",
    "the input tells that it is off",
)
TEMPERATURE = Spec(
    "temperature",
    "temperature",
    "The temperature of the dielectric was read.",
    f"{TEMPERATURES_C[0]:g} to {TEMPERATURES_C[1]:g} °C",
)
CONTACT = Spec(
    "contact",
    "contact input",
    "Tool and work were connected with a wire, and the wire was taken off.",
    "open, closed, open, without chatter",
)
GAP_BATTERY = Spec(
    "gap-battery",
    "gap sensor on a battery",
    "A battery was connected to the gap.",
    f"its voltage within {100.0 * BATTERY_SHARE:.0f} % and {BATTERY_V:g} V",
)
GAP_REST = Spec(
    "gap-rest",
    "gap sensor at rest",
    "The gap voltage was read, without the battery.",
    f"nothing from {GAP_ZERO_V:g} V on",
)
MONITOR_REST = Spec(
    "monitor-rest",
    "actuator monitor at rest",
    "The monitor was read with the amplifier off.",
    f"0 V within {MONITOR_ZERO_V:g} V",
)
DISPLACEMENT_REST = Spec(
    "displacement-rest",
    "displacement sensor at rest",
    "The sensor was read.",
    f"within {REST_UM:g} µm of 0, noise below {NOISE_UM:g} µm rms and not none",
)


@dataclass(frozen=True, slots=True)
class Switch:
    """An interlock input that a person can open and close."""

    key: str
    title: str
    bit: Interlock
    net: str
    open_by: str
    close_by: str

    @property
    def spec(self) -> Spec:
        """The item of it."""
        return Spec(
            self.key,
            self.title,
            f"{ACTS[self.open_by].text} {ACTS[self.close_by].text} Every input was read at each.",
            "its own input opens and closes again, and no other",
        )


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
COLD = ("link", "break-chain", "supply-off", "temperature", *(switch.key for switch in SWITCHES))
"""What must be right before anything is energised."""


@dataclass(frozen=True, slots=True)
class Seen:
    """Open inputs before, while and after a switch is open."""

    rest: Interlock
    during: Interlock
    back: Interlock

    @property
    def changed(self) -> Interlock:
        """Inputs that the switch has changed."""
        return self.rest ^ self.during


def look(c: Checklist) -> bool:
    """Do the part; whether the machine is as it has to be for it."""
    c.part = PART
    if not c.item(READY, partial(c.allow, "ready")):
        return False
    c.item(LINK, partial(_link, c))
    _switches(c)
    c.item(SUPPLY_OFF, partial(_supply_off, c))
    c.item(TEMPERATURE, partial(_temperature, c))
    c.item(BREAK, partial(_break_chain, c))
    c.item(CONTACT, partial(_contact, c))
    if c.item(GAP_BATTERY, partial(_gap_battery, c)) or not c.has_failed(GAP_BATTERY.key):
        c.item(GAP_REST, partial(_gap_rest, c))
    else:
        c.skip(GAP_REST, f"needs: {GAP_BATTERY.title}")
    c.item(MONITOR_REST, partial(_monitor_rest, c))
    c.item(DISPLACEMENT_REST, partial(_displacement_rest, c))
    return True


def _link(c: Checklist) -> Found:
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
        causes.append(
            cause("frames are damaged: no common ground, a long or unshielded cable, another baud", nets.LINE)
        )
    if fault == FaultCode.RESET:
        causes.append(
            cause(
                "the board has restarted by itself: a weak 5 V supply, or its watchdog; clear it with "
                f"`edmctl reset --ack {fault}`",
                "5 V",
            )
        )
    elif fault and fault != FaultCode.ESTOP:
        told = FAULTS[fault].message if fault in FAULTS else "an unknown one"
        causes.append(cause(f"a fault is latched from before: {told} `edmctl reset --ack {fault}`"))
    return Found(read, tuple(causes))


def _inputs(c: Checklist) -> Interlock:
    """Return the open inputs. An input that chatters counts as open."""
    bits = Interlock(0)
    for status in c.read():
        bits |= status.interlocks
    return bits


def _in_words(bits: Interlock) -> str:
    return ", ".join(name for bit, (name, _, _) in INTERLOCKS.items() if bit in bits) or "none"


def _switches(c: Checklist) -> None:
    """Open and close every switch before evaluating: exchanged wires show in two of them."""
    seen: dict[Interlock, Seen] = {}
    left_out: dict[Interlock, Skip] = {}
    for switch in SWITCHES:
        rest = _inputs(c)
        try:
            during = _acted(c, switch, switch.open_by, rest)
            back = _acted(c, switch, switch.close_by, during)
        except Skip as skip:
            left_out[switch.bit] = skip
            continue
        seen[switch.bit] = Seen(rest, during, back)
    explained: dict[Interlock, str] = {}
    for switch in SWITCHES:
        if switch.bit in left_out:
            c.skip(switch.spec, left_out[switch.bit].reason)
            continue
        if switch.bit in explained:
            c.skip(switch.spec, f"told at: {explained[switch.bit]}")
            continue
        found = seen[switch.bit]
        causes, others = _judge(switch, seen)
        explained |= dict.fromkeys(others, switch.title)
        read = (
            f"open inputs at rest: {_in_words(found.rest)}; then: {_in_words(found.during)}; at the end: "
            f"{_in_words(found.back)}"
        )
        c.judge(switch.spec, Found(read, causes))


def _acted(c: Checklist, switch: Switch, key: str, before: Interlock) -> Interlock:
    """Have a switch operated, report what changed, and return the open inputs."""
    c.act(key)
    after = _inputs(c)
    changes = [
        f"{INTERLOCKS[bit][0]} {'opens' if bit in after else 'closes'}"
        for bit in Interlock
        if bit in before ^ after
    ]
    expected = f"{INTERLOCKS[switch.bit][0]} {'opens' if key == switch.open_by else 'closes'}"
    read = ", ".join(changes) or "no input changed"
    c.say(f"{'read':10}{read}" + ("" if changes == [expected] else f"; expected: {expected}"))
    return after


def _judge(switch: Switch, all_seen: dict[Interlock, Seen]) -> tuple[tuple[Cause, ...], list[Interlock]]:
    """Return the likely mistakes of a switch, and the other switches that they explain."""
    seen, own = all_seen[switch.bit], switch.bit
    others = [bit for bit in Interlock if bit in seen.changed and bit != own]
    net = switch.net
    if not others:
        if own not in seen.changed:
            return (_never(switch, is_open=own in seen.rest),), []
        if own in seen.rest:
            text = "the input is inverted: it reads open while all is well, and closed when it is not"
            return (cause(f"{text} (a contact of the other kind, or the wrong level)", net),), []
        if seen.back != seen.rest:
            return (
                cause("the input does not come back: a contact that sticks, or one that latches", net),
            ), []
        return (), []
    crossed = " and ".join(NETS_OF[bit] for bit in others)
    every = (net, *(NETS_OF[bit] for bit in others))
    if own in seen.changed:
        text = f"{net} and {crossed} change together: bridged, or the one switches the supply of the other"
        return (cause(text, *every),), []
    exchanged = [bit for bit in others if bit in all_seen and all_seen[bit].changed == own]
    if exchanged:
        return (cause(f"{net} and {crossed} are exchanged", *every),), exchanged
    return (cause(f"the wire of {net} goes to {crossed}", *every),), []


def _never(switch: Switch, *, is_open: bool) -> Cause:
    if switch.bit is Interlock.DIELECTRIC_FLOW:
        text = (
            "the flow reads too low, pump on or off: wire off, sensor without supply, or put in against the flow"
            if is_open
            else "the flow does not stop with the pump: the wire is bridged, or its scale is wrong"
        )
    elif is_open:
        text = "the input reads open whatever is done: wire off, or its contacts have no 3.3 V"
    else:
        text = "the input reads closed whatever is done: bridged, or shorted to 3.3 V"
    return cause(text, switch.net)


def _supply_off(c: Checklist) -> Found:
    bits = _inputs(c)
    read = f"open inputs: {_in_words(bits)}"
    if Interlock.HV_SUPPLY in bits:
        return Found(read)
    text = "the input reads ok with the supply off: bridged, shorted to 3.3 V, or the supply is on"
    return wrong(read, text, nets.SUPPLY_OK)


def _temperature(c: Checklist) -> Found:
    value_c = mean([status.temperature_c for status in c.read()])
    low_c, high_c = TEMPERATURES_C
    read = f"{decimal(value_c, 1)} °C"
    if low_c <= value_c <= high_c:
        return Found(read)
    text = "no temperature of a workshop: wire off or shorted, or the wrong divider"
    return wrong(read, text, nets.TEMPERATURE)


def _break_chain(c: Checklist) -> Found:
    if c.machine.identity.simulated:
        raise Skip("a virtual machine has no chain that acts without its controller", absent=True)
    if c.answer("break-chain") == "yes":
        return Found("as expected, by the person")
    text = (
        "not healthy, or not broken by e-stop and door: they are to stand in series, and the over-current "
        "comparator in the same chain"
    )
    return wrong("not as expected, by the person", text, nets.BREAK)


def _contact(c: Checklist) -> Found:
    rest = _closed(c)
    c.act("contact-close")
    bridged = _closed(c)
    c.act("contact-open")
    after = _closed(c)
    read = ", ".join(
        "chatters" if one is None else "closed" if one else "open" for one in (rest, bridged, after)
    )
    if (rest, bridged, after) == (False, True, False):
        return Found(read)
    if None in (rest, bridged, after):
        text = "contact input chatters: a loose wire, or no pull-down"
    elif rest and not bridged:
        text = "contact input reads closed with nothing connected and open with the wire: input inverted"
    elif rest:
        text = "contact input reads closed with nothing connected: shorted to 3.3 V, or tool and work touch"
    elif not bridged:
        text = (
            "contact input does not close: wire off, tool or work not connected, the circuit has no supply, or the "
            "mode switch stands at the generator (then a meter across the open gap shows 0 V, else 0.8 V)"
        )
        return wrong(read, text, nets.CONTACT, nets.MODE)
    else:
        text = "contact input does not open again: something still connects tool and work"
    return wrong(read, text, nets.CONTACT)


def _closed(c: Checklist) -> bool | None:
    """Whether the contact is closed; None if readings differ."""
    flags = {TelemetryFlag.CONTACT in status.flags for status in c.read()}
    return flags.pop() if len(flags) == 1 else None


def gap_v(c: Checklist) -> float:
    """The mean gap voltage now."""
    return mean([status.gap_v for status in c.read()])


def _gap_battery(c: Checklist) -> Found:
    before_v = gap_v(c)
    kind = "battery" if abs(before_v - USUAL_BATTERY_V) >= APART_V else "low-battery"
    battery_v = float(c.answer(f"{kind}-volts"))
    if abs(before_v - battery_v) < APART_V:
        raise Skip(
            f"{battery_v:g} V is too near the {decimal(before_v)} V that the controller shows of before"
        )
    c.act(f"{kind}-on")
    value_v = gap_v(c)
    read = f"{decimal(before_v)} V before, {decimal(value_v)} V of {decimal(battery_v)} V"
    if abs(value_v - battery_v) <= BATTERY_SHARE * battery_v + BATTERY_V:
        c.battery_v = value_v
        c.act("battery-off")
        return Found(read)
    if abs(value_v - before_v) >= GAP_ZERO_V:
        c.act("battery-off")
        text = f"gap sensor reads {value_v / battery_v:.2f} of the voltage: a wrong resistor in its divider"
        return wrong(read, text, nets.GAP)
    c.act("battery-turn")
    turned_v = gap_v(c)
    c.act("battery-off")
    read += f", {decimal(turned_v)} V with the battery turned round"
    text = (
        "gap voltage is reversed: plus and minus of the sensor are exchanged"
        if abs(turned_v - before_v) >= GAP_ZERO_V
        else "gap voltage is not connected: wire off between gap, divider and input"
    )
    return wrong(read, text, nets.GAP)


def _gap_rest(c: Checklist) -> Found:
    """Without pulses a controller keeps its last gap voltage until there is something to read (docs/protocol.md)."""
    value_v, battery_v = gap_v(c), _battery_left(c)
    read = f"{decimal(value_v)} V"
    if value_v < GAP_ZERO_V:
        return Found(read)
    if battery_v is None:
        raise Skip(f"the controller shows {read} of before, and only a battery tells whether it reads that")
    if abs(value_v - battery_v) < GAP_ZERO_V:
        return Found(f"{read} as the battery has left it: the sensor reads nothing now")
    text = "gap sensor reads a voltage without one: its ground is off, or its amplifier's offset; or a supply is on"
    return wrong(read, text, nets.GAP)


def _battery_left(c: Checklist) -> float | None:
    """Return the last reading of the battery; None if there was none."""
    item = next(item for item in c.items if item.key == GAP_BATTERY.key)
    return None if item.status is not ItemStatus.PASS else c.battery_v


def _monitor_rest(c: Checklist) -> Found:
    value_v = mean([status.monitor_v for status in c.read()])
    read = f"{decimal(value_v)} V"
    if abs(value_v) <= MONITOR_ZERO_V:
        return Found(read)
    text = "actuator monitor reads a voltage with the amplifier off: wire off or shorted, or its offset"
    return wrong(read, text, nets.MONITOR)


def _displacement_rest(c: Checklist) -> Found:
    if not c.setup.sensor.fitted:
        raise Skip("no sensor is fitted by the setup", absent=True)
    values_um = [status.displacement_um for status in c.read()]
    if max(map(abs, values_um)) >= UNREADABLE_UM:
        text = "displacement sensor gives no reading: wire off, or at the end of its range"
        return wrong("none", text, nets.DISPLACEMENT)
    value_um, noise_um = mean(values_um), pstdev(values_um)
    read = f"{decimal(value_um)} µm, noise {decimal(noise_um)} µm rms"
    if abs(value_um) > REST_UM:
        text = "displacement sensor is far from its zero: not adjusted, or its scale is wrong"
    elif noise_um > NOISE_UM:
        text = "displacement sensor is noisy: its shield is off, or a loose wire"
    elif noise_um == 0.0:
        text = "displacement sensor does not change by a digit: wire off, or the converter stands"
    else:
        return Found(read)
    return wrong(read, text, nets.DISPLACEMENT)
