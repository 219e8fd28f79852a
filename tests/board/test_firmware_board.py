"""`edmctl firmware info`, `verify` and `flash`, and what `doctor` says of a board's firmware.

The board at the port is a virtual controller behind a pty; the tools are programs on the path that do as those do.
"""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edmctl.board.board_firmware import board_at, check_runs
from edmctl.board.image import read_image
from edmctl.core.build import source_version
from edmctl.errors import ProtocolMismatch
from edmctl.link.messages import (
    SCHEMA_HASH,
    Arm,
    Axis,
    CommitProfile,
    HelloReply,
    PulseEnable,
    ServoStart,
    StageMove,
    State,
    TouchOff,
    param_crc,
)
from edmctl.link.opening import open_line
from edmctl.link.ports import PortInfo
from edmctl.link.session import Session
from edmctl.link.wire import Request
from edmctl.profile.setup import Setup
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from tests.cli.commands import Here, Said, command, environment
from tests.firmware.image_bytes import image_bytes
from tests.needs import BOARD_COMPILERS
from tests.serving import serving

FAKE = Path(__file__).parents[1] / "firmware" / "fake_flash_tool.py"
TOOLS = ("pyocd", "openocd")
F429, F405 = "20036419", "10076413"
OFF = "--yes-high-voltage-is-off"


@pytest.fixture
def bench() -> VirtualBench:
    """Return a controller that says that it is the board of the images."""
    bench = open_bench(BenchConfig(), 1)
    bench.controller.board = 0x0429
    return bench


def brought_to(state: State, bench: VirtualBench) -> None:
    """Let a host bring the machine into a state, and say no more."""
    session = Session(bench.transport)
    session.open()
    crc = param_crc({})
    requests: dict[State, Request[object]] = {
        State.MOVING: StageMove(Axis.X, 0, 1_000_000),
        State.TOUCH: TouchOff(20.0, 40.0, 5.0, 90.0, 5.0, 0.1, 1),
        State.MACHINING: ServoStart(9.6, 500.0, 100.0),
    }
    for request in (CommitProfile(crc), Arm(crc), PulseEnable(1)):
        session.request(request)
    if state in requests:
        session.request(requests[state])
    assert bench.controller.state is state


@pytest.fixture
def port(bench: VirtualBench) -> Iterator[str]:
    with serving(bench) as port:
        yield port


@pytest.fixture
def image(tmp_path: Path) -> str:
    file = tmp_path / "image.bin"
    file.write_bytes(image_bytes())
    return str(file)


class FakeBoard:
    """A board that tools find: a folder."""

    def __init__(self, folder: Path, tools: Path) -> None:
        self.folder, self.tools = folder, tools
        folder.mkdir()
        tools.mkdir()
        self.plug(F429)

    def plug(self, chip: str) -> None:
        (self.folder / "chip").write_text(chip)

    def unplug(self) -> None:
        (self.folder / "chip").unlink()

    def trouble(self, what: str) -> None:
        (self.folder / "trouble").write_text(what)

    def install(self, *names: str) -> None:
        """Put tools on the path."""
        for name in names:
            file = self.tools / name
            file.write_text(f"#!{sys.executable}\n" + FAKE.read_text(encoding="utf-8"))
            file.chmod(0o755)

    @property
    def flash(self) -> bytes | None:
        file = self.folder / "flash"
        return file.read_bytes() if file.exists() else None

    @property
    def is_started(self) -> bool:
        return (self.folder / "started").exists()

    @property
    def log(self) -> list[str]:
        file = self.folder / "log"
        return file.read_text().splitlines() if file.exists() else []


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FakeBoard:
    """Return a board that is plugged in, and a path on which no tool is yet."""
    board = FakeBoard(tmp_path / "board", tmp_path / "tools")
    monkeypatch.setenv("PATH", str(board.tools))
    monkeypatch.setenv("FAKE_BOARD", str(board.folder))
    return board


class Flash:
    """`edmctl firmware flash` of the image, at the board that tools find."""

    def __init__(self, here: Here, image: str) -> None:
        self._here, self._image = here, image

    def __call__(self, *options: str) -> Said:
        return self._here("firmware", "flash", self._image, OFF, *options, "--json")

    def refused(self, code: str, *options: str) -> dict[str, str]:
        """The error with this code, whose first digit is the exit code."""
        said = self(*options)
        error: dict[str, str] = said.document["error"]
        assert (said.exit_code, error["code"]) == (int(code[1]), code), said.err
        return error


@pytest.fixture
def flash(here: Here, image: str) -> Flash:
    return Flash(here, image)


def test_info_says_what_an_image_is(here: Here, image: str) -> None:
    said = here("firmware", "info", image, "--json")
    found = said.document["result"]["image"]
    assert said.exit_code == 0
    assert (found["board_name"], found["firmware"], found["kind"]) == ("NUCLEO-F429ZI", "1.0.0", "BIN")
    assert found["schema"] == f"0x{SCHEMA_HASH:08X}"
    assert "NUCLEO-F429ZI" in here("firmware", "info", image).out


def test_info_warns_of_an_image_that_this_edmctl_does_not_understand(here: Here, image: str) -> None:
    Path(image).write_bytes(image_bytes(schema_hash=7))
    said = here("firmware", "info", image, "--json")
    assert (said.exit_code, [w["code"] for w in said.document["warnings"]]) == (0, ["W5001"])


def test_info_asks_a_board_and_leaves_what_runs_there_alone(
    here: Here, bench: VirtualBench, port: str
) -> None:
    brought_to(State.ARMED, bench)
    said = here("firmware", "info", port, "--json")
    found = said.document["result"]["board"]
    assert said.exit_code == 0, said.err
    assert (found["state"], found["serial"], found["board_name"]) == ("ARMED", "SIM-1", "NUCLEO-F429ZI")
    assert (bench.controller.state, bench.controller.fault) == (State.ARMED, 0)
    assert "ARMED" in here("firmware", "info", port).out


@pytest.mark.parametrize(
    ("what", "code"),
    [("none.bin", "E3680"), ("/dev/nothing-of-the-kind", "E4001"), ("sim:", "E2091"), (".", "E3680")],
)
def test_info_of_nothing_is_told(here: Here, what: str, code: str) -> None:
    said = here("firmware", "info", what, "--json")
    assert said.document["error"]["code"] == code
    assert said.exit_code == int(code[1])


def test_a_board_that_runs_another_image_is_reported(port: str, image: str) -> None:
    read = read_image(Path(image))
    board = board_at(port, Setup(), 0.0, print, os.environ)
    board = replace(board, firmware=read.record.firmware)
    check_runs(read, board)
    check_runs(read, replace(board, board=None, firmware=None))
    for differs, code in (
        ({"board": 2}, "E5003"),
        ({"schema": 7}, "E5001"),
        ({"firmware": (1, 0, 1)}, "E5002"),
    ):
        with pytest.raises(ProtocolMismatch, match="does not run") as caught:
            check_runs(read, replace(board, **differs))
        assert caught.value.code == code


@pytest.mark.parametrize("tool", TOOLS)
def test_flash_writes_reads_back_and_starts(flash: Flash, board: FakeBoard, tool: str) -> None:
    board.install(tool)
    said = flash()
    assert said.exit_code == 0, said.err + "\n".join(board.log)
    result = said.document["result"]
    assert (result["tool"], result["read_back"], result["chip"]) == (tool, True, "STM32F42x/43x")
    assert board.flash == image_bytes()
    assert board.is_started


def test_flash_takes_the_tool_that_is_named(flash: Flash, board: FakeBoard) -> None:
    board.install(*TOOLS)
    assert flash("--tool", "openocd", "--probe", "0671").exit_code == 0
    assert {line.split()[0] for line in board.log} == {"openocd"}
    assert all("adapter serial 0671" in line for line in board.log)


def test_flash_says_what_was_set_in_the_image(here: Here, board: FakeBoard, image: str) -> None:
    """A board does not tell it, and an image of another machine looks the same."""
    board.install("openocd")
    assert "Settings of the image: as in the sources." in here("firmware", "flash", image, OFF).out
    Path(image).write_bytes(image_bytes(settings="EDM_GAP_FULL_A=1.2 EDM_GAP_FULL_V=331.2345"))
    said = here("firmware", "flash", image, OFF)
    assert "Settings of the image: EDM_GAP_FULL_A 1.2, EDM_GAP_FULL_V 331.2345." in said.out


def test_flash_without_a_tool_says_how_to_install_one(flash: Flash, board: FakeBoard) -> None:
    assert "pip install pyocd" in flash.refused("E8120")["hint"]
    board.install("pyocd")
    assert "apt install openocd" in flash.refused("E8120", "--tool", "openocd")["hint"]
    assert flash("--tool", "avrdude").exit_code == 2


TROUBLES = {
    "unplugged": ("E8121", ""),
    "no chip": ("E8121", "no chip behind it"),
    "another chip": ("E8122", ""),
    "write": ("E8125", "fail|error"),
    "half": ("E8126", f"0x{0x08000000 + 4099 // 2:08X}"),
    "copies": ("E8126", ""),
    "huge": ("E8126", ""),
    "talks": ("E8125", ""),
}
"""What goes wrong with a board or its tool, by the error and words of its message."""
OF_ONE_TOOL = ("copies", "huge", "talks")


@pytest.mark.parametrize(
    ("tool", "trouble"),
    [(tool, what) for what in TROUBLES for tool in TOOLS if tool == "pyocd" or what not in OF_ONE_TOOL],
)
def test_what_goes_wrong_is_told_and_the_board_not_started(
    flash: Flash, board: FakeBoard, tool: str, trouble: str
) -> None:
    code, words = TROUBLES[trouble]
    board.install(tool)
    if trouble == "unplugged":
        board.unplug()
    elif trouble == "another chip":
        board.plug(F405)
    else:
        board.trouble(trouble)
    assert re.search(words, flash.refused(code)["message"], re.IGNORECASE)
    assert not board.is_started
    assert board.flash is None or code in ("E8125", "E8126")


def test_flash_refuses_a_choice_that_nobody_made(flash: Flash, board: FakeBoard) -> None:
    board.install("pyocd")
    board.trouble("several")
    flash.refused("E8121")
    assert board.flash is None
    assert flash("--probe", "0671FF343056363043090732").exit_code == 0


@pytest.mark.parametrize(
    ("content", "code"),
    [(image_bytes()[:-1], "E3682"), (bytes(5000), "E3681"), (image_bytes(board=77), "E8122")],
)
def test_what_is_no_whole_image_of_a_board_is_not_flashed(
    flash: Flash, board: FakeBoard, image: str, content: bytes, code: str
) -> None:
    board.install("pyocd")
    Path(image).write_bytes(content)
    flash.refused(code)
    assert board.log == []


def test_nothing_runs_while_the_high_voltage_may_be_on(here: Here, board: FakeBoard, image: str) -> None:
    board.install("pyocd")
    said = here("firmware", "flash", image, "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8124")
    assert board.log == []


@pytest.mark.parametrize(("answer", "exit_code"), [("off", 0), ("yes", 8), ("", 8)])
def test_a_person_is_asked_about_the_high_voltage(
    board: FakeBoard, image: str, tmp_path: Path, answer: str, exit_code: int
) -> None:
    board.install("pyocd")
    ours, theirs = pty.openpty()
    env = environment(PATH=str(board.tools), FAKE_BOARD=str(board.folder))
    arguments = command("firmware", "flash", image)
    with subprocess.Popen(
        arguments, cwd=tmp_path, env=env, stdin=theirs, stdout=theirs, stderr=theirs
    ) as job:
        os.close(theirs)
        heard = b""
        end_s = time.monotonic() + 60
        while b"`off`" not in heard and time.monotonic() < end_s:
            if select.select([ours], [], [], 1.0)[0]:
                heard += os.read(ours, 4096)
        assert board.log == []
        os.write(ours, f"{answer}\n".encode())
        assert job.wait(60) == exit_code
    os.close(ours)
    assert (board.flash is not None) == (exit_code == 0)


def test_flash_asks_the_board_before_and_after(flash: Flash, board: FakeBoard, port: str) -> None:
    board.install("pyocd")
    said = flash("--port", port)
    assert said.exit_code == 0, said.err
    result = said.document["result"]
    assert (result["before"]["state"], result["after"]["serial"]) == ("IDLE", "SIM-1")


@pytest.mark.parametrize("state", [State.ARMED, State.MACHINING, State.MOVING, State.TOUCH])
def test_flash_refuses_while_a_job_runs_and_leaves_it_alone(
    flash: Flash, board: FakeBoard, bench: VirtualBench, port: str, state: State
) -> None:
    board.install("pyocd")
    brought_to(state, bench)
    assert state.name in flash.refused("E8123", "--port", port)["message"]
    assert (bench.controller.state, bench.controller.fault) == (state, 0)
    assert board.log == []


def test_flash_refuses_a_board_that_it_cannot_ask(
    flash: Flash, board: FakeBoard, bench: VirtualBench, port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    board.install("pyocd")
    for selector in ("auto", "serial:SIM-1"):  # which are found by HELLO
        flash.refused("E2091", "--port", selector)
    bench.controller.board = 2
    flash.refused("E8122", "--port", port)
    line = open_line(port)
    flash.refused("E4006", "--port", port)
    line.close()
    # Its schema is another one, and it does not hand it out.
    monkeypatch.setattr("edmctl.link.session.SCHEMA_HASH", 7)
    monkeypatch.setattr("edmctl.link.compatibility.SCHEMA_HASH", 7)
    monkeypatch.setattr("edmctl.link.compatibility.fetch_schema", int)  # a TypeError
    assert "does not tell its state" in flash.refused("E8123", "--port", port)["message"]
    assert board.log == []


NUCLEO, FIRST, OTHER = "0483:374b", "066DFF485550755187123543", "0671FF343056363043090732"


@pytest.fixture
def st_links(monkeypatch: pytest.MonkeyPatch, port: str) -> None:
    """Two boards at this computer; the port is that of the second one."""
    listed = [
        PortInfo("/dev/none-of-these", usb_id=NUCLEO, usb_serial=FIRST),
        PortInfo(port, usb_id=NUCLEO, usb_serial=OTHER),
    ]
    monkeypatch.setattr("edmctl.link.ports.listed_ports", lambda: listed)


@pytest.mark.usefixtures("st_links")
@pytest.mark.parametrize(("tool", "option"), [("pyocd", "--uid"), ("openocd", "adapter serial")])
def test_flash_takes_the_board_that_was_asked(
    flash: Flash, board: FakeBoard, port: str, tool: str, option: str
) -> None:
    """Another one may be at a job, and some tools take the first that they find."""
    board.install(tool)
    board.trouble("several")
    said = flash("--port", port)
    assert said.exit_code == 0, said.err
    assert board.log
    assert all(f"{option} {OTHER}" in line for line in board.log)


@pytest.mark.usefixtures("st_links")
def test_flash_leaves_no_choice_to_a_tool_that_takes_the_first_board(
    flash: Flash, board: FakeBoard, port: str
) -> None:
    board.install("openocd")
    flash.refused("E8121")
    flash.refused("E8121", "--port", port, "--probe", FIRST)
    assert board.log == []
    assert flash("--port", port, "--probe", OTHER.lower()).exit_code == 0
    assert flash("--probe", FIRST).exit_code == 0


def test_a_new_board_that_says_nothing_is_flashed_and_asked_afterwards(
    flash: Flash, board: FakeBoard, tmp_path: Path
) -> None:
    board.install("pyocd")
    setup = tmp_path / "setup.toml"
    setup.write_text("[link]\nhello_s = 0.2\n")
    ours, theirs = pty.openpty()
    said = flash("--port", os.ttyname(theirs), "--setup", str(setup))
    os.close(ours)
    os.close(theirs)
    assert (said.exit_code, said.document["error"]["code"]) == (4, "E4011")
    assert said.document["result"]["read_back"] is True
    assert board.is_started
    assert "may be a new board" in said.err


def test_doctor_says_that_a_board_is_older_and_how_to_flash_it(
    here: Here, bench: VirtualBench, port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def firmware() -> dict[str, str]:
        said = here("doctor", "--port", port, "--json")
        return next(c for c in said.document["result"]["checks"] if c["name"] == "firmware")

    assert firmware()["status"] == "ok"
    told = HelloReply.unpack

    def older(payload: bytes) -> HelloReply:
        return replace(told(payload), fw_major=0, fw_minor=9)

    monkeypatch.setattr(HelloReply, "unpack", older)
    check = firmware()
    assert check["status"] == "warn"
    assert "0.9.0, older than the 1.0.0" in check["message"]
    assert f"edmctl firmware flash edmctl-stm32f4.bin --port {port}" in check["fix"]


def test_doctor_says_that_a_board_speaks_another_schema_and_how_to_flash_it(
    here: Here, port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edmctl.link.session.SCHEMA_HASH", 7)
    monkeypatch.setattr("edmctl.link.compatibility.SCHEMA_HASH", 7)
    said = here("doctor", "--port", port, "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (5, "E5000")
    check = next(c for c in said.document["result"]["checks"] if c["name"] == "protocol")
    assert "edmctl firmware flash" in check["fix"]


@pytest.mark.parametrize(
    "options",
    [
        ("--board", "arduino"),
        ("--compiler", "tcc"),
        ("--output", "image.elf"),
        ("--board", "stm32f4", "--real", "float"),
        ("--board", "stm32f4", "--output", "image.txt"),
    ],
)
def test_options_of_build_that_do_not_fit_are_refused(here: Here, options: tuple[str, ...]) -> None:
    said = here("firmware", "build", *options, "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (2, "E2090")


@pytest.mark.parametrize("compiler", BOARD_COMPILERS)
def test_the_board_is_built_as_an_image_of_this_edmctl(here: Here, compiler: str) -> None:
    Path("images.d").mkdir()
    settings = ("--set", "gap_full_a=12.5", "--set", "baud=1234567")
    options = ("--board", "stm32f4", "--compiler", compiler, "-o", "images.d", *settings)
    said = here("firmware", "build", *options, "--json")
    assert said.exit_code == 0, said.err
    built = said.document["result"]
    assert set(built["files"].values()) == {f"images.d/edmctl-stm32f4.{kind}" for kind in ("elf", "bin")}
    assert [path.name for path in Path.cwd().iterdir()] == ["images.d"]
    assert (built["board_name"], built["has_same_schema"]) == ("NUCLEO-F429ZI", True)
    assert built["firmware"] == ".".join(map(str, source_version()))
    assert 30_000 < built["used_bytes"]["flash"] <= built["size_bytes"] <= 96 * 1024
    assert built["used_bytes"]["RAM"] + built["used_bytes"]["CCM"] <= 220 * 1024
    assert "elsewhere" not in built["used_bytes"]
    for name in built["files"].values():
        found = here("firmware", "info", name, "--json").document["result"]["image"]
        assert (found["crc32"], found["size_bytes"]) == (built["crc32"], built["size_bytes"])
        assert found["settings"] == pytest.approx({"EDM_GAP_FULL_A": 12.5, "EDM_BAUD": 1234567.0}, rel=1e-5)
    binary = Path(built["files"]["bin"])
    reset = int.from_bytes(binary.read_bytes()[4:8], "little")
    assert 0x0800_0000 < reset < 0x0800_0000 + binary.stat().st_size
    assert reset & 1, "the reset vector leads to Thumb code"
