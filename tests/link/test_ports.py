"""Which ports there are, which of them may be asked, and which one `auto` and `serial:ID` mean."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from serial.tools import list_ports

from edmctl.errors import LinkLost
from edmctl.link import opening
from edmctl.link import ports as link_ports
from edmctl.link.opening import open_line
from edmctl.link.ports import PortInfo, listed_ports, probable_ports
from edmctl.link.probing import find, open_selector, probe
from edmctl.simulator import BenchConfig, open_bench
from tests.serving import serving

BAUD = 500_000
HELLO_S = 5.0
"""A busy computer may take its time; nothing waits for so long where somebody answers."""
SHORT_S = 0.1
MEGA = "2341:0042"
OTHER = PortInfo("/dev/ttyS9", "somebody's milling machine", "dead:beef", "X1")


@pytest.fixture
def lists(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that makes the computer list some ports."""

    def set_ports(*ports: PortInfo) -> None:
        monkeypatch.setattr(link_ports, "listed_ports", lambda: list(ports))

    set_ports()
    return set_ports


@contextmanager
def controllers(*seeds: int) -> Iterator[list[str]]:
    """Serve a controller for each seed; the names of their ports."""
    with ExitStack() as stack:
        yield [stack.enter_context(serving(open_bench(BenchConfig(), seed))) for seed in seeds]


@contextmanager
def silent() -> Iterator[str]:
    """A port where nobody answers."""
    ours, theirs = os.openpty()
    try:
        yield os.ttyname(theirs)
    finally:
        os.close(theirs)
        os.close(ours)


def test_the_ports_of_the_computer_are_listed_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def port(device: str, **told: object) -> SimpleNamespace:
        unknown = {"description": "n/a", "vid": None, "pid": None, "serial_number": None}
        return SimpleNamespace(device=device, **{**unknown, **told})

    mega = port("/dev/ttyACM0", description="Mega", vid=0x2341, pid=0x42, serial_number="7573")
    monkeypatch.setattr(list_ports, "comports", lambda: [port("/dev/ttyS0"), mega])
    assert listed_ports() == [PortInfo("/dev/ttyACM0", "Mega", MEGA, "7573"), PortInfo("/dev/ttyS0")]


def test_only_known_ids_and_named_ports_may_be_asked(lists: Callable[..., None]) -> None:
    mega = PortInfo("/dev/ttyACM0", "Mega", MEGA, "7573")
    lists(OTHER, mega)
    assert probable_ports([MEGA.upper()], []) == [mega]
    assert probable_ports([], ["/dev/ttyAMA0"]) == [PortInfo("/dev/ttyAMA0")]
    assert probable_ports([], [OTHER.device]) == [OTHER]


def test_a_port_under_two_names_is_asked_once(lists: Callable[..., None], tmp_path: Path) -> None:
    link = tmp_path / "edm"
    link.symlink_to("/dev/ttyACM0")
    mega = PortInfo("/dev/ttyACM0", "Mega", MEGA, "7573")
    lists(mega)
    assert probable_ports([MEGA], [str(link), "/dev/ttyACM0"]) == [mega]


def test_a_probe_tells_who_answers_and_why_others_do_not(lists: Callable[..., None], tmp_path: Path) -> None:
    with controllers(1, 2) as (free, held), silent() as nobody:
        line = open_line(held)
        try:
            there, busy, absent = probe(
                [PortInfo(p) for p in (free, held, str(tmp_path / "x"))], BAUD, HELLO_S
            )
        finally:
            line.close()
        (quiet,) = probe([PortInfo(nobody)], BAUD, SHORT_S)
    assert there.hello is not None
    assert there.hello.serial == "SIM-1"
    assert [answer.hello for answer in (busy, absent, quiet)] == [None] * 3
    assert "is held by process" in busy.error
    assert "There is no port" in absent.error
    assert "No controller answered" in quiet.error


def test_nothing_is_asked_where_nothing_is_known() -> None:
    assert probe([], BAUD) == []


def test_auto_is_the_one_that_answers(lists: Callable[..., None]) -> None:
    with controllers(1) as (port,), silent() as nobody:
        lists(PortInfo(port, "Mega", MEGA, "7573"), OTHER)
        assert find("auto", [MEGA], [], BAUD, HELLO_S) == port
        lists()
        assert find("auto", [MEGA], [nobody, port], BAUD, 0.5) == port


def test_auto_without_an_answer_says_what_was_asked(lists: Callable[..., None]) -> None:
    with silent() as nobody, pytest.raises(LinkLost, match="No controller answers") as error:
        find("auto", [MEGA], [nobody], BAUD, SHORT_S)
    assert error.value.code == "E4001"
    assert nobody in error.value.message
    with pytest.raises(LinkLost, match="the setup names none") as error:
        find("auto", [MEGA], [], BAUD, SHORT_S)
    assert "--port" in error.value.hint


def test_auto_refuses_to_choose_between_two(lists: Callable[..., None]) -> None:
    with controllers(1, 2) as names, pytest.raises(LinkLost, match="2 controllers answer") as error:
        find("auto", [], names, BAUD, HELLO_S)
    assert error.value.code == "E4007"
    for serial, name in zip(("SIM-1", "SIM-2"), names, strict=True):
        assert f"--port serial:{serial} ({name})" in error.value.hint


def test_a_serial_number_is_that_of_a_controller(lists: Callable[..., None]) -> None:
    with controllers(1, 2) as (one, two):
        assert find("serial:SIM-2", [], [one, two], BAUD, HELLO_S) == two
        with pytest.raises(LinkLost, match="No controller SIM-3 answers") as error:
            find("serial:SIM-3", [], [one, two], BAUD, HELLO_S)
    assert error.value.code == "E4001"
    assert "SIM-1" in error.value.message


def test_a_serial_number_of_usb_needs_no_question(
    lists: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "open_port", None)
    lists(PortInfo("/dev/ttyACM0", "Mega", MEGA, "7573"), OTHER)
    assert find("serial:7573", [MEGA], [], BAUD, HELLO_S) == "/dev/ttyACM0"


def test_an_empty_serial_number_is_that_of_no_port(lists: Callable[..., None]) -> None:
    lists(PortInfo("/dev/ttyS0"))
    with pytest.raises(LinkLost) as error:
        find("serial:", [], [], BAUD, SHORT_S)
    assert error.value.code == "E4002"


def test_two_controllers_of_one_serial_number_are_told_apart_by_their_ports(
    lists: Callable[..., None],
) -> None:
    with controllers(1, 1) as names, pytest.raises(LinkLost) as error:
        find("serial:SIM-1", [], names, BAUD, HELLO_S)
    assert error.value.code == "E4007"
    assert all(f"--port {name}" in error.value.hint for name in names)


def test_auto_without_anything_to_ask_lists_the_ports_there_are(lists: Callable[..., None]) -> None:
    lists(OTHER)
    with pytest.raises(LinkLost) as error:
        find("auto", [MEGA], [], BAUD, SHORT_S)
    assert error.value.code == "E4001"
    assert OTHER.device in error.value.message


@pytest.mark.parametrize("selector", ["auto", "serial:SIM-1"])
def test_a_controller_that_has_to_be_found_can_be_waited_for(
    selector: str, lists: Callable[..., None], tmp_path: Path
) -> None:
    link, said = tmp_path / "edm", []

    with controllers(1) as (name,):

        def plug_in(text: str) -> None:
            said.append(text)
            link.symlink_to(name)

        open_selector(selector, [], [str(link)], BAUD, HELLO_S, 60.0, plug_in).close()
    assert len(said) == 1


def test_a_selector_that_finds_nobody_ends_in_time(lists: Callable[..., None]) -> None:
    with pytest.raises(LinkLost) as error:
        open_selector("serial:SIM-1", [MEGA], [], BAUD, HELLO_S, 0.01)
    assert error.value.code == "E4001"


def test_ports_that_are_not_known_are_never_opened(
    lists: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    touched: list[str] = []

    def refuse(url: str, baud: int) -> None:
        touched.append(url)
        raise OSError("not in this test")

    monkeypatch.setattr(opening, "open_port", refuse)
    lists(OTHER, PortInfo("/dev/ttyACM7", "Mega", MEGA, "7573"), PortInfo("/dev/ttyS0"))
    for selector in ("auto", "serial:SIM-1"):
        touched.clear()
        with pytest.raises(LinkLost):
            find(selector, [MEGA], ["socket://127.0.0.1:1"], BAUD, SHORT_S)
        assert sorted(touched) == ["/dev/ttyACM7", "socket://127.0.0.1:1"]
