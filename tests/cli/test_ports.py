"""`edmctl ports`: what there is, who holds it, who answers; and the files that help to get to it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from edmctl.link import ports as link_ports
from edmctl.link.faults import FaultCode
from edmctl.link.opening import open_line
from edmctl.link.ports import ST_LINK_IDS, PortInfo
from edmctl.profile.setup import Link
from edmctl.simulator import BenchConfig, open_bench
from tests.cli.commands import ROOT, Here, Said
from tests.serving import serving

MEGA = PortInfo("/dev/ttyACM77", "Arduino Mega", "2341:0042", "7573")
OTHER = PortInfo("/dev/ttyS99")
NUCLEO = PortInfo("/dev/ttyACM78", "STLINK-V3", "0483:374e", "0043")
KEYS = "device description usb_id usb_serial held_by in_setup known controller error"


@pytest.mark.parametrize("selector", [None, "sim:", "auto", "serial:SIM-1"])
def test_no_ports_are_no_error_and_a_selector_names_none(
    here: Here, tmp_path: Path, selector: str | None
) -> None:
    setup = ("--setup", setup_file(tmp_path, port=selector)) if selector else ()
    said = here("ports", *setup, "--probe")
    assert (said.exit_code, said.err) == (0, "")
    assert said.out.startswith("This computer lists no serial ports")
    assert "edmctl simulate serve" in said.out
    assert ports_of(here("ports", *setup, "--json")) == []


def test_ports_are_listed_with_what_is_known_of_them(
    here: Here, listed: list[PortInfo], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed += [MEGA, OTHER]
    lines = here("ports").out.splitlines()
    assert lines[0].split("   ")[0] == "port"
    assert re.split(r" {3,}", lines[1]) == ["/dev/ttyACM77", "Arduino Mega", "2341:0042", "7573", "–", "–"]
    assert lines[2].split() == ["/dev/ttyS99", "–", "–", "–", "–", "–"]
    mega, other = ports_of(here("ports", "--json"))
    assert list(mega) == KEYS.split()
    assert (mega["known"], other["known"], mega["in_setup"]) == (True, False, False)
    assert mega["controller"] is mega["error"] is None
    (tmp_path / "by-name").symlink_to(OTHER.device)
    setup = setup_file(tmp_path, port=str(tmp_path / "by-name"), candidates=["/dev/ttyAMA99"])
    said = here("ports", "--setup", setup, "--json")
    marks = {port["device"]: (port["in_setup"], port["known"]) for port in ports_of(said)}
    named = (True, True)
    assert marks == {MEGA.device: (False, True), OTHER.device: named, "/dev/ttyAMA99": named}
    assert "named" in here("ports", "--setup", setup).out
    # A probe leaves other ports alone.
    listed.remove(MEGA)
    monkeypatch.setattr("edmctl.link.opening.open_port", None)
    (other,) = ports_of(here("ports", "--probe", "--json"))
    assert other["controller"] is other["error"] is None


@pytest.fixture(autouse=True)
def listed(monkeypatch: pytest.MonkeyPatch) -> list[PortInfo]:
    """Return the ports that the computer lists; none until a test adds some."""
    ports: list[PortInfo] = []
    monkeypatch.setattr(link_ports, "listed_ports", lambda: list(ports))
    return ports


def setup_file(folder: Path, **settings: object) -> str:
    """Write a setup that names ports."""
    file = folder / "setup.toml"
    port = f"port = {json.dumps(settings.pop('port'))}\n" if "port" in settings else ""
    link = "".join(f"{key} = {json.dumps(value)}\n" for key, value in settings.items())
    file.write_text(f"{port}[link]\n{link}")
    return str(file)


def ports_of(said: Said) -> list[dict[str, Any]]:
    assert said.exit_code == 0, said.err
    found: list[dict[str, Any]] = said.document["result"]["ports"]
    return found


def test_a_probe_shows_who_answers_and_who_holds_a_port(here: Here, tmp_path: Path) -> None:
    bench = open_bench(BenchConfig(), 1)
    bench.controller.raise_fault(FaultCode.DOOR)
    with serving(bench) as free, serving(open_bench(BenchConfig(), 2)) as held:
        setup = setup_file(tmp_path, candidates=[free, held])
        line = open_line(held)
        try:
            said = here("ports", "--setup", setup, "--probe")
            there, busy = ports_of(here("ports", "--setup", setup, "--probe", "--json"))
        finally:
            line.close()
    assert there["controller"] == {
        "serial": "SIM-1",
        "firmware": there["controller"]["firmware"],
        "protocol": there["controller"]["protocol"],
        "state": "FAULT",
        "fault": 4002,
        "fault_name": "DOOR",
        "simulated": True,
    }
    assert there["error"] is None
    assert busy["controller"] is None
    assert "is held by process" in busy["error"]
    assert busy["held_by"].startswith("process ")
    assert f"{free}: virtual controller SIM-1, firmware " in said.out
    assert "in state FAULT, fault 4002 DOOR latched" in said.out
    assert f"{held}: no, {held} is held by process" in said.out


def test_auto_asks_no_st_link_of_itself_and_says_how_it_would(
    here: Here, listed: list[PortInfo], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edmctl.link.opening.open_port", None)  # whoever opens one fails
    listed += [NUCLEO, OTHER]
    said = here("doctor", "--port", "auto", "--json")
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (4, "E4001")
    assert f"{NUCLEO.device} is an ST-LINK" in error["hint"]
    for line in ('usb_ids = ["0483:374e"]', "baud = 921600"):
        assert line in error["hint"]
    setup = setup_file(tmp_path, usb_ids=["0483:374e"], baud=921600)
    known = {port["device"]: port["known"] for port in ports_of(here("ports", "--setup", setup, "--json"))}
    assert known == {NUCLEO.device: True, OTHER.device: False}


def test_the_udev_rule_knows_the_boards_of_the_setup_and_every_st_link() -> None:
    rules = (ROOT / "docs/70-edmctl.rules").read_text(encoding="utf-8")
    for parents in ("", "S"):
        pattern = rf'ATTR{parents}{{idVendor}}=="(\w+)", ATTR{parents}{{idProduct}}=="(\w+)"'
        found = [f"{vendor}:{product}" for vendor, product in re.findall(pattern, rules)]
        assert sorted(found) == sorted((*Link().usb_ids, *ST_LINK_IDS))
    for line in rules.splitlines():
        assert not line or line.startswith("#") or re.fullmatch(r'(\S+=\S*"[^"]*"(, )?)+', line), line


def test_the_page_names_every_error_of_the_line() -> None:
    page = (ROOT / "docs/serial-port.md").read_text(encoding="utf-8")
    sources = [p for room in ("link", "cli", "machine") for p in (ROOT / "edmctl" / room).glob("*.py")]
    used = {code for p in sources for code in re.findall(r'"(E40[0-9]{2})"', p.read_text(encoding="utf-8"))}
    assert used
    explained = set(re.findall(r"^\| (E40[0-9]{2}) \|", page, flags=re.MULTILINE))
    assert used <= explained
