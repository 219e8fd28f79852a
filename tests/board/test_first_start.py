"""`edmctl first-start`: a sound machine passes; a wiring mistake is named by its net, and nothing else is blamed."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest

from edmctl.board.commands.first_start import Terminal
from edmctl.board.first_start import checklist, generator, run  # noqa: F401
from edmctl.board.first_start.checklist import ACTS, DECLARED, PROMPTS, QUESTIONS
from edmctl.board.first_start.run import VirtualHands
from edmctl.machine.controller import LinkMachine
from edmctl.profile.setup import Setup
from edmctl.simulator import BenchConfig, VirtualBench
from edmctl.simulator.injection import WIRING_MISTAKES, parse_injection
from tests.cli.commands import ROOT, Here, Said
from tests.needs import EMULATOR
from tools.generate.circuits.break_chain import hardware_break
from tools.generate.circuits.common import Needs

NAMED = {
    "ESTOP_DOOR_SWAPPED": ("estop", {"e-stop (PG0)", "door (PG1)"}, "exchanged"),
    "ESTOP_OPEN": ("estop", {"e-stop (PG0)"}, "wire off"),
    "DOOR_BRIDGED": ("door", {"door (PG1)"}, "bridged"),
    "LEVEL_INVERTED": ("level", {"dielectric level (PG3)"}, "inverted"),
    "FLOW_OPEN": ("flow", {"flow (PF4)"}, "wire off"),
    "SUPPLY_BRIDGED": ("supply-off", {"high voltage ok (PG2)"}, "bridged"),
    "CONTACT_INVERTED": ("contact", {"contact (PF13)"}, "inverted"),
    "CONTACT_OPEN": ("contact", {"contact (PF13)", "mode switch (PF14)"}, "wire off"),
    "MONITOR_OPEN": ("monitor", {"actuator monitor (PF3)"}, "wire off"),
    "MONITOR_HALF": ("monitor", {"actuator monitor (PF3)"}, "reads 0.50 of the voltage"),
    "MONITOR_REVERSED": ("monitor", {"actuator monitor (PF3)"}, "reversed"),
    "SENSOR_REVERSED": ("displacement", {"displacement (PF5)"}, "reversed"),
    "SENSOR_OPEN": ("displacement-rest", {"displacement (PF5)"}, "wire off"),
    "GAP_OPEN": ("gap-battery", {"gap voltage (PC0)"}, "not connected"),
    "GAP_REVERSED": ("gap-battery", {"gap voltage (PC0)"}, "reversed"),
    "GAP_HALF": ("gap-battery", {"gap voltage (PC0)"}, "reads 0.50 of the voltage"),
    "GATE_STUCK": ("self-test", {"gate (PE9)"}, "stuck on"),
    "GATE_OPEN": ("self-test", {"gate (PE9)"}, "wire from gate to driver is off"),
    "MODE_STUCK": ("contact", {"contact (PF13)", "mode switch (PF14)"}, "stands at the generator"),
    "MODE_OPEN": (
        "self-test",
        {"mode switch (PF14)", "alive (PF15)", "open voltage set (PA4)"},
        "stays at the contact circuit",
    ),
    "DAC_OPEN": ("drive", {"actuator DAC (PE2, PE6, PE4)"}, "nothing follows"),
    "X_REVERSED": ("x-direction", {"X direction (PF0)"}, "inverted"),
    "X_OPEN": ("x-direction", {"X step (PF6)"}, "no steps"),
    "XY_SWAPPED": ("x-direction", {"X step (PF6)", "Y step (PF7)"}, "exchanged"),
}
"""Of each mistake the item that fails, the nets that are blamed, and what is said."""
PARTS = ("actuator", "generator")
DANGEROUS = [key for key, question in QUESTIONS.items() if question.danger]


class Bench:
    """Stands in for `open_bench`: a machine that is wired wrongly, and that can be looked at afterwards."""

    def __init__(self, *mistakes: str) -> None:
        self._mistakes = mistakes
        self.made: list[VirtualBench] = []

    def __call__(self, config: BenchConfig, seed: int) -> VirtualBench:
        bench = VirtualBench(config, seed)
        for mistake in self._mistakes:
            bench.inject(parse_injection(mistake))
        self.made.append(bench)
        return bench

    def is_off(self) -> bool:
        bench = self.made[-1]
        return bench.is_safe and not bench.plant.drive.pulses_on


@pytest.fixture
def wired(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a maker of machines."""

    def make(*mistakes: str) -> Bench:
        bench = Bench(*mistakes)
        monkeypatch.setattr("edmctl.simulator.open_bench", bench)
        return bench

    return make


def items(said: Said) -> dict[str, dict[str, Any]]:
    return {item["key"]: item for item in said.document["result"]["first_start"]["items"]}


def statuses(said: Said, status: str) -> list[str]:
    return [key for key, item in items(said).items() if item["status"] == status]


def write_answers(path: Path, **changes: str) -> str:
    """All that a person with a virtual machine would say, with changes."""
    given = dict.fromkeys(ACTS, "done") | {k: "yes" for k, q in QUESTIONS.items() if "yes" in q.options}
    given |= {key: "plus" for key in QUESTIONS if key.endswith("-direction")} | {"battery-volts": "9"}
    given |= {key.replace("_", "-"): value for key, value in changes.items()}
    path.write_text("".join(f"{key} = {json.dumps(value)}\n" for key, value in given.items() if value))
    return str(path)


def test_every_mistake_is_in_the_table() -> None:
    assert set(NAMED) == set(WIRING_MISTAKES)


def test_every_declared_mistake_and_item_is_used() -> None:
    code = "".join(path.read_text() for path in (ROOT / "edmctl/board/first_start").glob("*.py"))
    assert [name for name in DECLARED["mistakes"] if f'"{name}"' not in code] == []
    keys = [key for items in DECLARED["items"].values() for key in items]
    assert sorted(keys) == sorted(checklist._LOOKS)


QUICK = ("GATE_STUCK", "MODE_STUCK")
"""Mistakes that are soon found with a board's image."""
CASES = [
    *((mistake, "firmware", "1") for mistake in NAMED),
    *(pytest.param(mistake, "stm32", "4", marks=EMULATOR) for mistake in QUICK),
    *(pytest.param(mistake, "firmware", "2", marks=pytest.mark.slow) for mistake in NAMED),
    *(pytest.param(mistake, "firmware-float", "7", marks=pytest.mark.slow) for mistake in NAMED),
    *(pytest.param(m, "stm32", "4", marks=[EMULATOR, pytest.mark.slow]) for m in NAMED if m not in QUICK),
]
"""Mistakes with controller and seed."""


@pytest.mark.parametrize(
    "controller",
    ["firmware", "firmware-float", pytest.param("stm32", marks=[EMULATOR, pytest.mark.slow])],
)
def test_a_sound_machine_passes_under_every_controller(here: Here, wired: Any, controller: str) -> None:
    bench = wired()
    said = here("first-start", "--yes", "--json", "--seed", "3", "--controller", controller)
    assert said.exit_code == 0, said.err
    assert statuses(said, "fail") == statuses(said, "skipped") == []
    assert statuses(said, "absent") == ["break-chain"]
    assert said.document["result"]["first_start"]["complete"]
    assert bench.is_off()


@pytest.mark.parametrize(("mistake", "controller", "seed"), CASES)
def test_a_mistake_is_named_and_nothing_else_is_blamed(
    here: Here, wired: Any, mistake: str, controller: str, seed: str
) -> None:
    key, nets, words = NAMED[mistake]
    bench = wired(mistake)
    said = here("first-start", "--yes", "--json", "--quiet", "--seed", seed, "--controller", controller)
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8049"), said.err
    assert statuses(said, "fail") == [key]
    found = items(said)[key]
    assert {net for cause in found["causes"] for net in cause["nets"]} == nets
    assert words in " ".join(cause["text"] for cause in found["causes"])
    assert bench.is_off()


def test_readings_tell_what_is_judged(here: Here, wired: Any) -> None:
    wired()
    said = here("first-start", "--yes", "--json", "--seed", "1")
    found = items(said)
    assert found["limit"]["read"] == "refused, fault 2004"
    assert statuses(said, "answered") == ["ready", "stages"]
    (report,) = Path("runs").glob("*.txt")
    assert f"{len(statuses(said, 'pass'))} pass, 2 answered, 1 absent." in report.read_text()
    for key, low, high in (("displacement", 0.25, 1.6), ("range", 0.5, 1.4)):
        gain = Setup().actuator.gain_um_per_v
        assert f"{low:g} to {high:g} of the setup's {gain:g} µm/V" in found[key]["expected"]
        numbers = re.search(r"\+([0-9.]+) µm/V, ([0-9.]+) of the setup's", found[key]["read"])
        assert numbers is not None
        assert float(numbers[2]) == pytest.approx(float(numbers[1]) / gain, abs=0.01)
        assert low < float(numbers[2]) < high
    assert found["self-test"]["read"] == "gate off: less than 0.50 V; gate on: 10.00 V of 10.00 V"


@pytest.mark.parametrize("share", [1.0, 4.0])
def test_a_transistor_that_is_a_short_is_named_by_the_duty_or_by_the_open_voltage(share: float) -> None:
    assert "shorted" in generator.self_test_cause(share).text
    assert "scale" in generator.self_test_cause(2.0).text


def test_a_driver_that_switches_by_itself_is_found_in_measure_mode(here: Here, wired: Any) -> None:
    wired("MODE_SWITCH")
    said = here("first-start", "--yes", "--json", "--seed", "1")
    assert statuses(said, "fail") == ["measure-mode"], said.err
    (cause,) = items(said)["measure-mode"]["causes"]
    assert set(cause["nets"]) == {"gate (PE9)", "gate sense (PA3)"}


def test_the_guard_of_the_mode_switch_is_named(
    here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It opens the loop of the supply's input, which is all that a controller sees of it."""
    bench, real = wired(), LinkMachine.self_test

    def guarded(machine: LinkMachine) -> float:
        bench.made[-1].inject(parse_injection("HV_SUPPLY@0"))
        return real(machine)

    monkeypatch.setattr(LinkMachine, "self_test", guarded)
    said = here("first-start", "--yes", "--json", "--seed", "1")
    assert statuses(said, "fail") == ["self-test"], said.err
    (cause,) = items(said)["self-test"]["causes"]
    assert set(cause["nets"]) == {"high voltage ok (PG2)", "mode switch (PF14)"}


@pytest.mark.parametrize("controller", ["firmware", "firmware-float", pytest.param("stm32", marks=EMULATOR)])
def test_five_mistakes_at_once_are_all_named(here: Here, wired: Any, controller: str) -> None:
    five = ("ESTOP_DOOR_SWAPPED", "LEVEL_INVERTED", "CONTACT_INVERTED", "GAP_REVERSED", "SENSOR_OPEN")
    bench = wired(*five)
    said = here("first-start", "--yes", "--json", "--seed", "1", "--controller", controller)
    assert sorted(statuses(said, "fail")) == sorted(NAMED[name][0] for name in five), said.err
    for name in five:
        causes = items(said)[NAMED[name][0]]["causes"]
        assert {net for cause in causes for net in cause["nets"]} == NAMED[name][1]
    assert bench.made[-1].plant.drive.pulse_starts == 0
    assert bench.is_off()


@pytest.mark.parametrize("call", ["ramp", "start_cut"])
def test_an_emergency_stop_ends_it(
    here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    bench, real = wired(), getattr(LinkMachine, call)

    def pressed(*arguments: Any) -> Any:
        bench.made[-1].inject(parse_injection("ESTOP@0"))
        return real(*arguments)

    monkeypatch.setattr(LinkMachine, call, pressed)
    said = here("first-start", "--yes", "--json", "--seed", "1")
    assert (said.exit_code, said.document["error"]["code"]) == (6, "E64001")
    assert list(items(said))[-1] == ("drive" if call == "ramp" else "open-voltage")
    assert bench.is_off()


def test_the_report_is_left_as_text_and_as_json(here: Here, wired: Any) -> None:
    wired("CONTACT_INVERTED")
    said = here("first-start", "--yes", "--seed", "1", "--out", "reports")
    text, document = (Path(name) for name in sorted(Path("reports").iterdir(), reverse=True))
    assert "likely    contact input reads closed with nothing connected" in text.read_text()
    assert "net contact (PF13)" in text.read_text()
    assert text.read_text().strip() in said.out
    report = json.loads(document.read_text())["first_start"]
    assert (report["machine"].split()[0], report["complete"]) == ("SIM-1", False)
    again = here("first-start", "--yes", "--seed", "1", "--out", "reports")
    assert again.exit_code == 8
    assert len(list(Path("reports").iterdir())) == 4


@pytest.mark.parametrize("missing", DANGEROUS)
def test_a_dangerous_step_is_never_taken_for_granted(here: Here, wired: Any, missing: str) -> None:
    bench = wired()
    for answer in ("", "no"):
        answers = write_answers(Path("answers.toml"), **{missing: answer})
        said = here("first-start", "--answers", answers, "--json", "--seed", "1")
        assert (said.exit_code, said.document["error"]["code"]) == (7, "E7050"), said.err
        assert statuses(said, "fail") == []
        skipped = {part: [i for i in items(said).values() if i["part"] == part] for part in PARTS}
        plant = bench.made[-1].plant
        if missing == "stages":  # nothing builds on how they move
            continue
        assert plant.drive.pulse_starts == 0
        if missing in ("high-voltage", "actuator"):
            assert {item["status"] for item in skipped["generator"]} == {"skipped"}
            assert {item["status"] for item in skipped["actuator"]} == {"skipped"}
            assert plant.state.amplifier_v == pytest.approx(0.0, abs=0.01)
        assert plant.hv_supply_ok == (missing != "high-voltage")
        assert bench.is_off()


@pytest.mark.parametrize("is_done", [True, False])
@pytest.mark.parametrize(
    ("key", "item", "fault"),
    [
        ("estop-release", "armed-estop", 4001),
        ("door-close", "armed-door", 4002),
        ("limit-open", "limit", 2004),
    ],
)
def test_a_provoked_fault_is_cleared_though_its_end_is_skipped(
    here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch, key: str, item: str, fault: int, is_done: bool
) -> None:
    bench, asked, real = wired(), list[str](), VirtualHands.ask

    def ask(hands: VirtualHands, prompt: str) -> str:
        asked.append(prompt)
        if asked.count(key) < (1 if key == "limit-open" else 2) or prompt != key:
            return real(hands, prompt)
        if is_done:
            real(hands, prompt)
        return ""

    monkeypatch.setattr(VirtualHands, "ask", ask)
    said = here("first-start", "--yes", "--json", "--seed", "1")
    found = items(said)[item]
    assert found["status"] == "skipped"
    controller = bench.made[-1].controller
    if is_done:
        assert found["reason"] == f"{key}: skipped"
        assert controller.fault == 0
        assert "fail" not in {one["status"] for one in items(said).values()}
    elif key == "limit-open":  # a limit switch forbids moves alone
        assert statuses(said, "fail") == ["x-direction", "y-direction", "theta-direction"]
    else:
        assert f"Fault {fault} cannot be cleared" in found["reason"]
        assert f"edmctl reset --ack {fault}" in found["reason"]
        assert controller.fault == fault
    told = [one["reason"] for one in items(said).values() if "still holds" in one["reason"]]
    assert told == [] or not is_done
    assert bench.is_off()


def test_the_meter_at_the_chain_is_asked_for_what_the_circuit_gives() -> None:
    checks = {check.what: check for check in hardware_break(Needs()).checks}
    healthy = checks["healthy is high"]
    (broken,) = (check for what, check in checks.items() if what.startswith("contacts open"))
    needed_v, reached_v, broken_v = (
        float(re.sub(r"[^0-9.]", "", text)) for text in (healthy.need, healthy.reached, broken.reached)
    )
    texts = QUESTIONS["break-chain"].text, DECLARED["items"]["high voltage off"]["break-chain"]["expected"]
    for text in texts:
        high_v, low_v = (float(value) for value in re.findall(r"(?:above|below) ([0-9.]+) V", text))
        assert needed_v < high_v < reached_v
        assert broken_v < low_v


MAY_BE_ABSENT = {"limit-close", "x-direction", "y-direction", "theta-direction"}
NEEDED = [key for key in ACTS if key not in MAY_BE_ABSENT]
NOT_ASKED = ("low-battery-on", "battery-turn", "limit-open")
"""Of a sound new machine, or with another end: a limit switch that stays closed."""


@pytest.mark.parametrize("key", [key for key in NEEDED if key not in NOT_ASKED])
def test_what_no_machine_may_do_without_is_not_absent(
    here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch, key: str
) -> None:
    """Whoever says so all the same has skipped it, and nothing that builds on it is energised."""
    bench, real = wired(), VirtualHands.ask
    monkeypatch.setattr(VirtualHands, "ask", lambda hands, act: "absent" if act == key else real(hands, act))
    said = here("first-start", "--yes", "--json", "--seed", "1")
    assert said.exit_code == 7, said.err
    assert statuses(said, "absent") == said.document["result"]["first_start"]["absent"] == ["break-chain"]
    plant = bench.made[-1].plant
    assert "self-test" in statuses(said, "skipped")
    assert plant.drive.pulse_starts == 0
    if key not in ("contact-close", "contact-open", "amplifier-on", "battery-on", "battery-off"):
        assert {"supply-on", "armed-estop", "amplifier-on", "range"} <= set(statuses(said, "skipped"))
        assert not plant.hv_supply_ok
        assert plant.state.amplifier_v == pytest.approx(0.0, abs=0.01)
    assert bench.is_off()


@pytest.mark.parametrize("key", NEEDED)
def test_answers_that_do_without_a_protection_are_refused(here: Here, wired: Any, key: str) -> None:
    bench = wired()
    Path("answers.toml").write_text(f'{key} = "absent"\n')
    said = here("first-start", "--answers", "answers.toml", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (2, "E2065")
    assert "A machine without it is not used" in said.document["error"]["message"]
    assert bench.made == []


def test_what_may_be_absent_is_named_at_the_end(
    here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    wired()
    real, keys = VirtualHands.ask, ("limit-close", "theta-direction")
    monkeypatch.setattr(
        VirtualHands, "ask", lambda hands, what: "absent" if what in keys else real(hands, what)
    )
    said = here("first-start", "--yes", "--json", "--seed", "1")
    assert said.exit_code == 0, said.err
    absent = ["break-chain", "limit", "theta-direction"]
    assert statuses(said, "absent") == said.document["result"]["first_start"]["absent"] == absent
    (report,) = Path("runs").glob("*.txt")
    (line,) = [line for line in report.read_text().splitlines() if line.startswith("Absent, not checked: ")]
    assert "limit switches (the machine has none, according to the operator); theta direction (" in line


class Patient:
    """Stands in for a machine while a person is asked."""

    def wait_for(self, done: Callable[[], bool]) -> None:
        while not done():
            pass


def test_absent_is_offered_only_where_it_may_be(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for key in ACTS:
        monkeypatch.setattr(sys, "stdin", Typed("a\ns\n"))
        answer = Terminal(cast("LinkMachine", Patient())).ask(key)
        may_be_absent = key in MAY_BE_ABSENT
        assert answer == ("absent" if may_be_absent else "")
        asked = capsys.readouterr().err
        assert ("Enter when done, absent; s skips" in asked) == may_be_absent
        assert ("'a' is none of these: Enter when done; s skips." in asked) == (not may_be_absent)


def test_what_is_skipped_keeps_everything_that_builds_on_it_off(here: Here, wired: Any) -> None:
    bench = wired()
    answers = write_answers(Path("answers.toml"), ready="no")
    said = here("first-start", "--answers", answers, "--json", "--seed", "1")
    assert (said.exit_code, list(items(said))) == (7, ["ready"])
    assert bench.is_off()


def test_answers_count_at_a_virtual_machine_too(here: Here, wired: Any) -> None:
    bench = wired()
    for key in ("estop-press", "door-close"):
        for word in ("skip", ""):
            Path("answers.toml").write_text(f'{key} = "{word}"\nready = "yes"\nhigh-voltage = "yes"\n')
            said = here("first-start", "--answers", "answers.toml", "--json", "--seed", "1")
            assert said.exit_code == 7, said.err
            assert items(said)[key.split("-")[0]]["reason"] == f"{key}: skipped"
            assert items(said)["supply-on"]["status"] == "skipped"
            assert not bench.made[-1].plant.hv_supply_ok
    answers = write_answers(
        Path("answers.toml"), limit_close="absent", x_direction="minus", battery_volts="5"
    )
    said = here("first-start", "--answers", answers, "--json", "--seed", "1")
    assert statuses(said, "absent") == ["break-chain", "limit"]
    assert statuses(said, "fail") == ["gap-battery", "x-direction"]
    Path("answers.toml").write_text("".join(f'{key} = "yes"\n' for key in ("ready", *DANGEROUS)))
    said = here("first-start", "--answers", "answers.toml", "--json", "--seed", "1")
    assert said.exit_code == 0, said.err  # the program's hands and eyes do what nobody speaks of


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (("--yes", "--answers", "answers.toml"), "E2067"),
        (("--yes", "--port", "/dev/nothing"), "E2067"),
        ((), "E2068"),  # nobody is at a terminal
        (("--answers", "none.toml"), "E2065"),
    ],
)
def test_options_that_cannot_be_are_refused_before_anything_is_opened(
    here: Here, wired: Any, options: tuple[str, ...], code: str
) -> None:
    bench = wired()
    write_answers(Path("answers.toml"))
    said = here("first-start", *options, "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (2, code)
    assert bench.made == []


def test_answers_that_are_none_are_refused_before_anything_is_opened(here: Here, wired: Any) -> None:
    bench = wired()
    for line in ('estop-press = "perhaps"', 'sing = "yes"', "battery-volts = 'much'", "x-direction = 3", "?"):
        Path("wrong.toml").write_text(line)
        said = here("first-start", "--answers", "wrong.toml", "--json")
        assert (said.exit_code, said.document["error"]["code"]) == (2, "E2065"), line
    assert bench.made == []


STOPPED_AT = ["ask", "ramp", "move_stage", "arm", "self_test", "start_cut", "fall_silent", "touch"]


@pytest.mark.parametrize("call", STOPPED_AT)
def test_ctrl_c_at_any_point_leaves_everything_off(
    here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    bench, owner = wired(), VirtualHands if call == "ask" else LinkMachine
    real = getattr(owner, call)

    def interrupted(*arguments: Any, **options: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return real(*arguments, **options)

    monkeypatch.setattr(owner, call, interrupted)
    said = here("first-start", "--yes", "--json", "--seed", "1")
    assert said.exit_code == 130, said.err
    assert said.document["result"]["first_start"]["ended"] == "Stopped by SIGINT."
    assert statuses(said, "fail") == []
    assert bench.is_off()
    assert len(list(Path("runs").iterdir())) == 2


class Typed(io.StringIO):
    """A terminal at which somebody has typed ahead."""

    def isatty(self) -> bool:
        return True


def test_a_person_at_a_terminal_is_asked(here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = wired()
    typed = ["ja", "y", "y", "yes", "y", "yes", "yes", "no"]  # a dangerous step takes the whole word
    monkeypatch.setattr(sys, "stdin", Typed("".join(f"{line}\n" for line in typed)))
    said = here("first-start", "--json", "--seed", "1")
    assert said.exit_code == 7, said.err
    assert statuses(said, "fail") == []
    assert said.err.count("DANGER") == 6
    assert items(said)["range"]["status"] == "pass"
    assert items(said)["self-test"]["reason"] == "generator: not allowed"
    assert bench.is_off()


def test_a_person_at_a_terminal_is_told_how_to_stop_and_which_words_there_are(
    here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    wired()
    monkeypatch.setattr(sys, "stdin", Typed("ja\ny\n\ny\nno\n"))
    said = here("first-start", "--seed", "1")
    told = said.err.splitlines()
    assert said.err.count("Ctrl-C stops") == 1
    (first,) = [n for n, line in enumerate(told) if "Ctrl-C stops" in line]
    assert first < min(n for n, line in enumerate(told) if "s skips" in line)
    assert "'ja' is none of these: yes, no; s skips." in said.err
    whole = "yes, no; s skips; a dangerous step takes the whole word."
    assert f"'' is none of these: {whole}" in said.err
    assert f"'y' is none of these: {whole}" in said.err


@pytest.mark.parametrize("mistake", ["", "ESTOP_OPEN", "DOOR_BRIDGED", "ESTOP_DOOR_SWAPPED"])
def test_what_an_act_has_changed_is_told_at_once(
    here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch, mistake: str
) -> None:
    wired(*filter(None, [mistake]))
    real = VirtualHands.ask

    def ask(hands: VirtualHands, key: str) -> str:
        print(f"act {key}", file=sys.stderr)
        return real(hands, key)

    monkeypatch.setattr(VirtualHands, "ask", ask)
    lines = here("first-start", "--yes", "--seed", "1").err.splitlines()
    after = {key: lines[lines.index(f"act {key}") + 1].split(maxsplit=1) for key in list(ACTS)[:8]}
    assert {word for word, _ in after.values()} == {"read"}
    read = {key: text for key, (_, text) in after.items()}
    own = {"estop": "emergency stop", "door": "door", "level": "level", "pump": "flow"}
    for key, text in read.items():
        name, end = (
            own[key.split("-")[0]],
            "opens" if key.split("-")[1] in ("press", "open", "low", "off") else "closes",
        )
        if key.startswith({"ESTOP_OPEN": "estop", "DOOR_BRIDGED": "door"}.get(mistake, "none")):
            assert text == f"no input changed; expected: {name} {end}"
        elif mistake == "ESTOP_DOOR_SWAPPED" and key.startswith(("estop", "door")):
            other = {"emergency stop": "door", "door": "emergency stop"}[name]
            assert text == f"{other} {end}; expected: {name} {end}"
        else:
            assert text == f"{name} {end}"


def test_a_terminal_that_is_closed_ends_it(here: Here, wired: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = wired()
    monkeypatch.setattr(sys, "stdin", Typed("y\n"))
    said = here("first-start", "--json", "--seed", "1")
    assert (said.exit_code, said.document["error"]["code"]) == (2, "E2068")
    assert bench.is_off()


def test_the_page_has_every_key_and_every_mistake() -> None:
    page = (ROOT / "docs/first-start.md").read_text(encoding="utf-8")
    assert [key for key in PROMPTS if f"`{key}`" not in page] == []
    assert [name for name in WIRING_MISTAKES if name not in page] == []
