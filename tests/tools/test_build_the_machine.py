"""docs/build-the-machine.md: pins, circuits and diagram follow the firmware's sources, and the sums are right."""

from __future__ import annotations

import re
from dataclasses import replace
from math import exp
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from edmctl.board.first_start.checklist import NETS
from tools.generate import machine_diagram, machine_page
from tools.generate.board_source import FIRMWARE, numbers, pins, wired_together
from tools.generate.circuits import (
    CIRCUITS,
    actuator,
    break_chain,
    charge_pump,
    circuits,
    gap_current,
    gap_voltage,
    generator,
    outputs,
    references,
    touching,
)
from tools.generate.circuits import materials as bill
from tools.generate.circuits.common import SAFE_V, STRAY_F, Needs
from tools.generate.circuits.wiring import wirings
from tools.generate.nucleo import MORPHO, ON_THE_BOARD, ZIO

PAGE = Path(__file__).parents[2] / "docs" / "build-the-machine.md"
NEEDS = Needs()


def failing(needs: Needs) -> set[str]:
    return {circuit.name for circuit in circuits(needs) if not all(check.ok for check in circuit.checks)}


# Pins


def test_every_row_of_the_board_is_read() -> None:
    text = (FIRMWARE / "board" / "stm32f4" / "pins.h").read_text(encoding="utf-8")
    rows = pins()
    assert len(rows) == len(re.findall(r"^    PIN\(", text, re.MULTILINE))
    assert len({pin.name for pin in rows}) == len({pin.net for pin in rows}) == len(rows)


def test_every_pin_has_its_place_on_the_connectors() -> None:
    used = {pin.name for pin in pins()}
    assert set(MORPHO) == used
    assert set(ZIO) | {"PF6", "PG4", *ON_THE_BOARD} == used
    assert len(set(MORPHO.values())) == len(MORPHO)
    assert len(set(ZIO.values())) == len(ZIO)
    assert all(re.fullmatch(r"CN1[12]-([1-9]|[1-6]\d|70)", place) for place in MORPHO.values())
    assert all(re.fullmatch(r"CN(7|8|9|10)-([1-9]|[12]\d|3[0-4])", place) for place in ZIO.values())


def test_pins_that_share_a_wire_name_each_other() -> None:
    assert wired_together(pins()) == {
        "DISCHARGE_END": ["PC7"],
        "DISCHARGE_TIMER": ["PE7"],
        "IGNITION": ["PC6"],
        "IGNITION_TIMER": ["PA0"],
    }


def test_ranges_in_the_notes_of_the_board_are_those_of_the_scale() -> None:
    analogue = {pin.net: pin for pin in pins() if pin.mode == "ANALOG"}
    assert set(analogue) == set(machine_page.RANGES)
    for net, pin in analogue.items():
        low, high, _ = machine_page.ends(net, NEEDS.scale)
        noted = re.search(r"0 to 3\.3 V = (-?[\d.]+) to (-?[\d.]+)", pin.note)
        assert noted is not None
        assert (float(noted[1]), float(noted[2])) == (low, high), net


def test_what_must_not_float_has_its_resistor() -> None:
    rows = pins()
    down, up = outputs.pulled(rows, "down"), outputs.pulled(rows, "up")
    stages = {f"{what}_{axis}" for what in ("STEP", "DIRECTION") for axis in ("X", "Y", "THETA")}
    assert set(down) == {"GATE", "MODE", "ALIVE", "OPEN_VOLTAGE", "PEAK_CURRENT"} | stages
    assert up == ["DAC_SELECT"]
    assert outputs.unnamed(rows) == []
    assert set(outputs.NO_PULL) <= {pin.net for pin in rows}
    assert not set(outputs.NO_PULL) & {*down, *up}


@pytest.mark.parametrize("net", [pin.net for pin in pins() if pin.external])
def test_an_output_without_its_resistor_stops_the_generator(
    net: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        replace(pin, note=re.sub("external pull-(up|down)", "", pin.note)) if pin.net == net else pin
        for pin in pins()
    ]
    assert outputs.unnamed(rows) == [net]
    monkeypatch.setattr(outputs, "pins", lambda: rows)
    assert failing(NEEDS) == {"outputs"}
    with pytest.raises(ValueError, match="outputs"):
        machine_page.tables()


def test_the_checklist_names_the_same_pins() -> None:
    by_pin = {pin.name for pin in pins()}
    told = {
        name
        for value in NETS.values()
        for text in (value if isinstance(value, tuple) else (value,))
        if isinstance(text, str)
        for name in re.findall(r"\bP[A-G]\d+\b", text)
    }
    assert len(told) > 20
    assert told <= by_pin


# Circuits


def test_every_circuit_does_what_the_firmware_needs() -> None:
    assert failing(NEEDS) == set()
    assert len({circuit.name for circuit in circuits()}) == len(CIRCUITS)


@pytest.mark.parametrize(
    ("where", "name", "value", "circuit"),
    [
        ("scale", "EDM_GAP_FULL_V", 300.0, "divider"),
        ("limits", "EDM_OPEN_V_MAX", 325.0, "divider"),
        ("measure", "SETTLE_COUNTS", 2.0, "divider"),
        ("measure", "SAME_OPEN", 0.005, "divider"),
        ("params", "test_error", 0.005, "divider"),
        ("scale", "EDM_GAP_FULL_A", 10.0, "current"),
        ("limits", "EDM_CURRENT_A_MAX", 11.0, "current"),
        ("measure", "LEAST_A", 0.01, "current"),
        ("measure", "LEAST_A", 0.005, "divider"),
        ("limits", "EDM_OPEN_V_MAX", 400.0, "gate"),
        ("limits", "EDM_OPEN_V_MAX", 390.0, "generator"),
        ("scale", "EDM_OPEN_FULL_V", 400.0, "generator"),
        ("limits", "EDM_OPEN_V_MAX", 320.0, "setpoints"),
        ("limits", "DAC_V", 0.002, "actuator"),
        ("params", "slew_limit_v_s", 5000.0, "actuator"),
        ("scale", "EDM_MONITOR_LEAST_V", -10.0, "monitor"),
        ("scale", "EDM_MONITOR_MOST_V", 170.0, "monitor"),
        ("params", "track_error", 0.002, "monitor"),
        ("scale", "EDM_SENSOR_MOST_UM", 200.0, "displacement"),
        ("measure", "LEAST_GAP_V", 0.5, "contact"),
        ("params", "misread_pulses", 5.0, "mode"),
        ("scale", "EDM_STEP_UM", 0.005, "stages"),
    ],
)
def test_a_figure_that_changes_fails_the_circuit_that_goes_by_it(
    where: str, name: str, value: float, circuit: str
) -> None:
    before = getattr(NEEDS, where)
    assert name in before
    assert circuit in failing(replace(NEEDS, **{where: {**before, name: value}}))


@pytest.mark.parametrize(
    ("module", "name", "value", "circuit"),
    [
        (break_chain, "FILTER_F", 2.2e-9, "chain"),
        (break_chain, "FILTER_F", 0.47e-9, "chain"),
        (break_chain, "LOOP_W", 0.1, "chain"),
        (touching, "SWITCHES", (("relay", 12e-3), ("semiconductors", 0.1e-3)), "mode"),
        (touching, "SWITCHES", (("relay", 5e-3), ("semiconductors", 0.6e-3)), "mode"),
        (references, "CONTACT_OHM", 6.98e3, "references"),
        (references, "IGNITION_OHM", (590.0, 1.69e3), "references"),
        (references, "OVER_OHM", (2.2e3, 10e3), "references"),
    ],
)
def test_a_part_of_another_value_fails_its_circuit(
    module: object, name: str, value: object, circuit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, name, value)
    assert circuit in failing(NEEDS)


def test_the_charge_pump_step_by_step() -> None:
    """Ideal switches and diodes, edge by edge, the charge of the coupling capacitor followed for itself."""
    swing, drop, c1, c2, ohm = 5.0, 0.3, 220e-9, 470e-9, 47e3
    coupling_v, store_v = -drop, 0.0  # of the capacitor: driver less the far side; the lower diode holds it
    rises = []
    for _ in range(60):
        far_v = swing - coupling_v
        if far_v > store_v + drop:
            moved = (far_v - drop - store_v) / (1 / c1 + 1 / c2)
            coupling_v += moved / c1
            store_v += moved / c2
        rises.append(store_v)
        store_v *= exp(-1e-3 / (c2 * ohm))
        coupling_v = min(coupling_v, drop)  # falling edge: the far side is held at a drop below ground
        store_v *= exp(-1e-3 / (c2 * ohm))
    model = charge_pump.pump(swing, drop, c1, c2, ohm)
    coupled = [volt for _, volt in zip(rises, model, strict=False)]
    assert rises[-1] == pytest.approx(coupled[-1], rel=0.02)
    assert sum(volt < 2.5 for volt in rises) == sum(volt < 2.5 for volt in coupled)


def test_an_alive_pin_that_stands_or_toggles_slowly_enables_nothing() -> None:
    first = next(charge_pump.pump(5.25, 0.2, 242e-9, 423e-9, 47470.0))
    assert first < 0.98 * charge_pump.PUMP_THRESHOLD_V


def test_the_filter_of_the_break_chain_step_by_step() -> None:
    """The node pulled to ground behind 680 Ω, the pin's capacitor discharged in steps of 0.1 ns."""
    pin_v = 3.3 * 1.02
    node_v, step_s, passed_s = pin_v * 10.0 / 690.0, 1e-10, 0.0
    while pin_v > 0.8:
        pin_v -= (pin_v - node_v) / 1010.0 * step_s / 1.1e-9
        passed_s += step_s
    assert passed_s == pytest.approx(break_chain.filter_s(), rel=1e-3)


def test_a_loop_does_not_burn_its_resistor_away() -> None:
    """26.4 V at 4.7 kΩ, contacts closed for years: 5.6 mA, 0.148 W, and the bill asks for more than twice that."""
    assert pytest.approx(break_chain.loop_w()) == 26.4 * 26.4 / 4700.0
    bill_says = re.search(r"7 optocouplers, each with 4\.7 kΩ, ([\d.]+) W:", PAGE.read_text(encoding="utf-8"))
    assert bill_says is not None
    assert float(bill_says[1]) > 2 * 0.148


def test_contacts_that_are_asked_for_are_those_that_are_used() -> None:
    text = PAGE.read_text(encoding="utf-8")
    estop, door = break_chain.contacts()
    assert (estop, door) == (4, 3)
    assert f"| e-stop | {estop} contacts" in text
    assert f"| door switch | {door} contacts" in text
    loops = {"break chain", "enable"} | {pin.net for pin in pins() if pin.mode == "INPUT"} - {"CONTACT"}
    assert set(break_chain.LOOPS) == loops


def test_the_blanking_is_long_enough_for_any_resistor() -> None:
    """The longest time over all resistors is what the page says."""
    from math import log

    for open_v, threshold_a in ((300.0, 0.05), (100.0, 0.015)):
        times = [
            ohm * STRAY_F * log(open_v / (ohm * threshold_a)) for ohm in range(10, int(open_v / threshold_a))
        ]
        assert max(times) == pytest.approx(gap_current.blank_s(open_v, threshold_a), rel=1e-3)
        assert max(times) < gap_current.BLANK_S


def test_resistors_give_their_current_at_the_normal_plateau() -> None:
    plateau_v = NEEDS.scale["EDM_NORMAL_PLATEAU_V"]
    for open_v, peak_a in generator.SETTINGS:
        assert (open_v - plateau_v) / generator.series_ohm(NEEDS, open_v, peak_a) == pytest.approx(peak_a)


# Netlists


def solved(name: str, known: dict[str, float], *more: tuple[str, str, float]) -> dict[str, float]:
    """Voltages of the nodes that a circuit's resistors join, by the currents into each; GND is 0 V."""
    resistors = [(*wired.ends, wired.ohm) for wired in wirings()[name] if wired.ohm] + list(more)
    fixed = {"GND": 0.0} | known
    free = sorted({node for a, b, _ in resistors for node in (a, b)} - set(fixed))
    matrix, right = np.zeros((len(free), len(free))), np.zeros(len(free))
    for a, b, ohm in resistors:
        for node, other in ((a, b), (b, a)):
            if node in fixed:
                continue
            row = free.index(node)
            matrix[row, row] += 1 / ohm
            if other in fixed:
                right[row] += fixed[other] / ohm
            else:
                matrix[row, free.index(other)] -= 1 / ohm
    return dict(zip(free, np.linalg.solve(matrix, right), strict=True))


def reached(name: str, what: str) -> str:
    """What a check of a circuit says that it reaches."""
    (check,) = (c for circuit in circuits() if circuit.name == name for c in circuit.checks if what in c.what)
    return check.reached


def test_the_divider_as_it_is_wired() -> None:
    assert solved("divider", {"GAP+": 330.0, "BUF": 0.0})["TAP"] == pytest.approx(3.3)


def test_the_monitor_as_it_is_wired() -> None:
    for volt, node_v in zip(actuator.monitor_ends(actuator.MONITOR_OHM), (0.0, 3.3), strict=True):
        found = solved("monitor", {"PLUG+": volt, "3.3 V": 3.3, "BUF": 0.0})
        assert found["SUM"] == pytest.approx(node_v, abs=1e-9)


def test_the_break_chain_as_it_is_wired() -> None:
    pin = ("BREAK_CHAIN", "GND", 30e3)
    from_v = 3.3 * 0.98 - break_chain.OPTO_V
    closed = solved("chain", {"LOOP": from_v, "OVER": 0.0, "G": 0.0}, pin)["BREAK_CHAIN"]
    assert f"{closed:.2f} V" == reached("chain", "healthy is high")
    over = ("NODE", "GND", break_chain.MOSFET_OHM)
    assert solved("chain", {"LOOP": from_v, "OVER": 3.3, "G": 3.3}, pin, over)["BREAK_CHAIN"] < 0.8


def test_the_contact_circuit_as_it_is_wired() -> None:
    levels = []
    for out_v in (0.0, 3.3):
        found = solved("contact", {"3.3 V": 3.3, "2.5 V": 2.5, "CONTACT": out_v})
        levels.append(found["LEVEL"])
    assert levels[0] == pytest.approx(touching.CONTACT_THRESHOLD_V, abs=0.005)
    assert levels[1] - levels[0] == pytest.approx(0.030, abs=0.001)
    supplies = {"3.3 V": 3.3, "2.5 V": 2.5, "CONTACT": 0.0}
    gap = ("TOUCH", "GND", 1e6)
    opened = solved("contact", supplies | {"3.3 V": 3.3 * 1.02}, gap)
    assert f"{opened['TOUCH']:.2f} V" == reached("contact", "open gap")
    assert opened["IN"] > levels[1]
    for ohm, high in ((0.1, True), (7.5e3, True), (9.5e3, False)):
        assert (solved("contact", supplies, ("TOUCH", "GND", ohm))["IN"] < levels[0]) == high
    battery = solved("contact", supplies | {"BATTERY": 9.0}, ("BATTERY", "TOUCH", 1e3))
    assert f"{battery['TOUCH']:.2f} V" == reached("contact", "battery")


def test_the_power_of_the_contact_circuit_at_the_generator() -> None:
    """A mode switch that bridges puts the greatest open voltage at TOUCH; clamps hold the other ends."""
    volt = NEEDS.limits["EDM_OPEN_V_MAX"]
    watts = {
        wired.part: (volt - 3.3) ** 2 / wired.ohm for wired in wirings()["contact"] if "TOUCH" in wired.ends
    }
    assert len(watts) == 2
    for part, watt in watts.items():
        assert watt < float(re.search(r"(\d+) W", part)[1])  # type: ignore[index]


def test_every_net_of_a_wiring_is_there() -> None:
    """Capitals alone stand for a net of the board or for a node that two parts have."""
    nets_of_board = {pin.net for pin in pins()}
    whole = " ".join(wired.nodes for wiring in wirings().values() for wired in wiring)
    elsewhere = {"GND", "GAP", "RESERVOIR", "PLUG"}
    for name, wiring in wirings().items():
        text = " ".join(wired.nodes for wired in wiring)
        for node in set(re.findall(r"\b[A-Z][A-Z_]+\d?\b", re.sub(r"BAV199|LED|XOR", "", text))):
            shared = len(re.findall(rf"\b{node}\b", text)) > 1 or len(re.findall(rf"\b{node}\b", whole)) > 1
            assert node in nets_of_board | elsewhere or shared, (name, node)


# The bill of materials


def test_every_part_of_a_circuit_is_in_the_bill_by_kind() -> None:
    asked = {f"{circuit.name}: {part}" for circuit in circuits() for part, _ in circuit.parts}
    told = {place for material in bill.materials(NEEDS) for place in material.places}
    assert told | set(bill.NO_PART) == asked
    assert not told & set(bill.NO_PART)
    assert set(bill.TITLES) == {circuit.name for circuit in circuits()}


def test_every_value_of_a_circuit_is_in_the_bill() -> None:
    """Read from the page, by a pattern of its own."""
    page = PAGE.read_text(encoding="utf-8")
    listed = {
        kind: set(re.findall(r"(\d[\d.]* \S+) \(", row))
        for kind, row in re.findall(r"^\| (resistors|capacitors) \| (.+)$", page, re.MULTILINE)
    }
    for circuit in circuits():
        text = " ".join(" ".join(row) for row in circuit.parts)
        for kind, unit in (("resistors", "[kM]?Ω"), ("capacitors", "[pnµ]F")):
            for value in re.findall(rf"(?<!below )(?<!bears )(?<!at most )\b(\d[\d.]* {unit})", text):
                assert re.sub(r"\.0 ", " ", value) in listed[kind], (circuit.name, value)


# The page


def monitor_mv() -> tuple[float, float]:
    """What a volt of the actuator is at the pin of the monitor, and its 0 V, by conductances at the node."""
    signal, offset, ground = (1.0 / ohm for ohm in actuator.MONITOR_OHM)
    whole = signal + offset + ground
    return 1e3 * signal / whole, 1e3 * 3.3 * offset / whole


def test_figures_in_the_text_are_those_of_the_sums() -> None:
    text = " ".join(PAGE.read_text(encoding="utf-8").split())
    tau_us = 9.9e3 * gap_voltage.TAP_F * 1e6
    full_v = NEEDS.scale["EDM_OPEN_FULL_V"]
    reservoir_f, bleeder_ohm = generator.RESERVOIR_F * 1.1, generator.BLEEDER_OHM * 1.05
    safe_s = generator.discharge_s(full_v, reservoir_f, bleeder_ohm)
    corners = charge_pump.pump_corners()
    for sentence in (
        f"Of a step by 18 V, from 40 V to a plateau, {18.0 * exp(-0.5 / tau_us):.1f} V are left",
        f"reservoir of the generator, {0.5 * generator.RESERVOIR_F * full_v**2:.1f} J at {full_v:g} V",
        f"below {SAFE_V:g} V after {safe_s:.0f} s",
        f"across it, always: below {SAFE_V:g} V after {actuator.piezo_discharge_s():.0f} s",
        f"{actuator.PIEZO_BLEEDER_OHM / 1e3:g} kΩ across it, always",
        f"short behind the transistor last {1e6 * break_chain.filter_s():.1f} µs longer",
        f"from 300 to 40 V takes {generator.discharge_s(300.0, reservoir_f, bleeder_ohm, 40.0):.1f} s",
        f"may ask for up to {generator.BUFFERED_DAC_V / 3.3 * full_v:.0f} V whatever is set below",
        f"nor above {3.3 - generator.BUFFERED_DAC_V:.1f} V",
        f"and up to {touching.settled_s(NEEDS, 1.0) / touching.SWITCHES[0][1] / 1e3:g} kHz",
        f"{generator.CREEPAGE_MM:g} mm or more",
        f"holds {1e3 * 0.5 * actuator.PIEZO_F * 150.0**2:.0f} mJ",
        f"converter would be {actuator.drive_v(65535):.0f} V",
        f"at 40 V with every plateau above {generator.plateau_limit_v(NEEDS, 40.0):.0f} V",
        f"drops {1e3 * min(h for h, _ in corners):.0f} to {1e3 * max(h for h, _ in corners):.0f} ms after",
        f"enables after {min(n for _, n in corners)} to {max(n for _, n in corners)} rises",
        f"(open voltage − {NEEDS.scale['EDM_NORMAL_PLATEAU_V']:g} V) / resistance",
        f"`misread_pulses` ({NEEDS.params['misread_pulses']:g})",
        f"`over_current` ({NEEDS.params['over_current']:g})",
        f"below {NEEDS.params['monitor_min_v']:g} V and above {NEEDS.params['monitor_max_v']:g} V".replace(
            "-", "−"
        ),
        f"a peak current below {0.2 / 3.3 * NEEDS.scale['EDM_PEAK_FULL_A']:.2f} A",
        "{:.1f} mV/V and {:.0f} mV at 0 V at the monitor".format(*monitor_mv()),
        f"0.275 V/A ({10 * 5.5 * 0.05:.2f} in the finer range)",
    ):
        assert sentence in text, sentence


def test_what_the_page_says_of_the_gate_is_so() -> None:
    """MODE and the gate go high in one call; the DAC's buffer is on, and is what limits a set point."""
    gate = (FIRMWARE / "board" / "stm32f4" / "gate.c").read_text(encoding="utf-8")
    opening = gate[gate.index("void hal_gate(") : gate.index("/* The least divider")]
    assert opening.index("inputs_put_mode(true)") < opening.index("|= TIM_BDTR_MOE")
    assert "DAC->CR = DAC_CR_EN1 | DAC_CR_EN2;" in gate


def test_the_settings_of_the_owner_are_names_of_the_sources() -> None:
    defined = {*NEEDS.scale, *NEEDS.limits, *numbers("board", "stm32f4", "board.h")}
    named = set(re.findall(r"\bEDM_[A-Z_]+[A-Z]\b", PAGE.read_text(encoding="utf-8")))
    assert named
    assert named <= defined


# The diagram


def test_every_net_is_on_the_diagram_with_its_pin() -> None:
    text = machine_diagram.picture()
    assert machine_diagram.nets_shown() == {pin.net for pin in pins()}
    assert all(re.search(rf"\b{pin.name}\b", text) for pin in pins())


def test_the_diagram_is_sound_and_its_text_fits() -> None:
    root = ElementTree.fromstring(machine_diagram.picture())
    assert root.get("viewBox") == f"0 0 {machine_diagram.WIDTH} {machine_diagram.HEIGHT}"
    for block in machine_diagram.BLOCKS:
        room = block.column[1] - block.column[0] - 8
        assert 6.8 * len(block.title) < room, block.title
        assert 6.1 * len(block.small) < room, block.small
    taken = {(block.column, block.row + i) for block in machine_diagram.BLOCKS for i in range(block.rows)}
    assert len(taken) == sum(block.rows for block in machine_diagram.BLOCKS)
