"""Programs that flash a board, each as the commands that are run: which chip is there, write, read back, start.

None of them is part of edmctl. They are run in a folder of their own, where the image is `image.bin`, and nobody
answers their questions. They write and read a chip that was reset and halted: one that was only halted is reset by
its own watchdog, and what was just written shall not run before it has been compared.

Commands and messages are those of pyOCD 0.46 and OpenOCD 0.12.
"""

from __future__ import annotations

import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from edmctl import failures
from edmctl.core.boards import CHIPS, Board
from edmctl.dataclasses import dataclass
from edmctl.errors import PreconditionError, installing
from edmctl.files import open_regular

_IDCODE = 0xE004_2000
"""DBGMCU_IDCODE, RM0090 38.6.1."""
_DEVICE_BITS = 0xFFF
_IMAGE, _BACK = "image.bin", "back.bin"
_SECONDS = 300
_TOLD_LINES = 6
_MOST_SAID = 4_000_000
"""Bytes that a tool may say."""
_NO_PROBE = re.compile(
    r"No connected debug probes|No available debug probes|No target device available|Probe .* not found"
    r"|Error: open failed|No device found|unable to find a matching|Error: Device not found",
    re.IGNORECASE,
)
_NO_RIGHT = re.compile(
    r"LIBUSB_ERROR_ACCESS|access denied|insufficient permissions|permission denied", re.IGNORECASE
)
_SEVERAL = re.compile(r"Enter the number of the debug probe", re.IGNORECASE)
_NO_CHIP = re.compile(
    r"unable to connect to the target|Get IDCODE error|No ACK|Failed to connect to target|Failed to enter SWD mode"
    r"|SWD/JTAG communication failure|Target not available",
    re.IGNORECASE,
)


class Tool:
    """A program for flashing that is installed. Its commands raise PreconditionError E8121, E8125."""

    name = ""
    install = ""
    takes_first = False  # of several boards, without a word

    def __init__(self, command: tuple[str, ...], probe: str | None) -> None:
        self.command = command
        self.probe = probe
        self.folder = Path()

    @classmethod
    def found(cls) -> tuple[str, ...] | None:
        """Return its command if it is installed."""
        path = shutil.which(cls.name)
        return (path,) if path else None

    def device_id(self, board: Board) -> int:
        """Which chip is there, as DBGMCU_IDCODE says; nothing is stopped or written."""
        raise NotImplementedError

    def write(self, board: Board) -> None:
        """Write the image into the flash, without starting it."""
        raise NotImplementedError

    def read_back(self, board: Board, size: int) -> None:
        """Read the flash into the file of what was read back."""
        raise NotImplementedError

    def start(self, board: Board) -> None:
        """Reset the board, so that it runs what was written."""
        raise NotImplementedError

    def run(self, *arguments: str) -> str:
        """Run the tool and return what it said on both streams."""
        command = [*self.command, *arguments]
        try:
            process = subprocess.Popen(
                command,
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
        except OSError as error:
            raise self._unfit(f"does not run: {error}") from error
        timer = threading.Timer(_SECONDS, process.kill)
        with process:
            timer.start()
            try:
                assert process.stdout is not None
                said = process.stdout.read(_MOST_SAID)
                if len(said) == _MOST_SAID:
                    raise self._unfit(f"says more than {_MOST_SAID} bytes")
                process.wait()
            except BaseException:
                process.kill()
                raise
            finally:
                timer.cancel()
        text = said.decode("utf-8", "replace")
        self._check(command, process.returncode, text)
        return text

    def _unfit(self, what: str) -> PreconditionError:
        return failures.flash_tool_unusable(name=self.name, what=what)

    def _check(self, command: Sequence[str], status: int, said: str) -> None:
        if _SEVERAL.search(said):
            raise several_boards(self.name)
        if _NO_RIGHT.search(said):
            raise no_board(
                f"{self.name} may not open the board's USB port.",
                "Install the udev rules of the tool; on Linux its package brings them.",
            )
        if _NO_PROBE.search(said):
            raise no_board(
                f"{self.name} finds no board.",
                "Plug in the USB cable of the ST-LINK.",
            )
        if _NO_CHIP.search(said):
            raise no_board(
                f"{self.name} finds the ST-LINK, and no chip behind it.",
                "Check the supply of the board and its jumpers (on a NUCLEO: both of CN4 closed).",
            )
        if status:
            told = "\n".join(f"  {line}" for line in said.strip().splitlines()[-_TOLD_LINES:])
            raise failures.flash_tool_failed(
                name=self.name, status=status, command=shlex.join(command), told=told
            )


class PyOcd(Tool):
    """https://pyocd.io; it does not look which chip it writes to."""

    name = "pyocd"
    install = installing("pyocd")
    _HALTED = ("--connect", "under-reset", "-O", "resume_on_disconnect=false")

    @classmethod
    def found(cls) -> tuple[str, ...] | None:
        """On the path, or installed where this program runs."""
        is_here = importlib.util.find_spec("pyocd") is not None
        return super().found() or ((sys.executable, "-m", "pyocd") if is_here else None)

    def _at(self, board: Board) -> list[str]:
        return ["--no-wait", "--target", board.pyocd_target, *(("--uid", self.probe) if self.probe else ())]

    def device_id(self, board: Board) -> int:
        said = self.run("commander", *self._at(board), "--connect", "attach", "-c", f"read32 0x{_IDCODE:08x}")
        return _id_in(said, rf"^{_IDCODE:08x}:\s+([0-9a-f]{{8}})", self.name)

    def write(self, board: Board) -> None:
        place = ("--format", "bin", "--base-address", f"0x{board.flash.address:08x}")
        self.run("load", *self._at(board), *self._HALTED, "--no-reset", *place, _IMAGE)

    def read_back(self, board: Board, size: int) -> None:
        command = f"savemem 0x{board.flash.address:08x} {size} {_BACK}"
        self.run("commander", *self._at(board), *self._HALTED, "-c", command)

    def start(self, board: Board) -> None:
        self.run("reset", *self._at(board))


class OpenOcd(Tool):
    """https://openocd.org."""

    name = "openocd"
    install = "`apt install openocd`"
    takes_first = True

    def _do(self, board: Board, *commands: str) -> str:
        quiet = [f"{port} disabled" for port in ("gdb_port", "tcl_port", "telnet_port")]
        chosen = (f"adapter serial {self.probe}",) if self.probe else ()
        every = [*quiet, *chosen, "init", *commands, "shutdown"]
        return self.run("-f", board.openocd_config, *(word for c in every for word in ("-c", c)))

    def device_id(self, board: Board) -> int:
        said = self._do(board, f"mdw 0x{_IDCODE:08x}")
        return _id_in(said, rf"^0x{_IDCODE:08x}:\s+([0-9a-f]{{8}})", self.name)

    def write(self, board: Board) -> None:
        self._do(board, f"program {_IMAGE} 0x{board.flash.address:08x} verify")

    def read_back(self, board: Board, size: int) -> None:
        self._do(board, "reset halt", f"dump_image {_BACK} 0x{board.flash.address:08x} {size}")

    def start(self, board: Board) -> None:
        self._do(board, "reset run")


TOOLS: dict[str, type[Tool]] = {tool.name: tool for tool in (PyOcd, OpenOcd)}
"""In the order in which they are taken."""


@dataclass(frozen=True, slots=True)
class Flashed:
    """What was done: by which tool, on which chip, and that the flash was read back as it was written."""

    tool: str
    command: tuple[str, ...]
    chip: str
    size_bytes: int


def find_tool(named: str | None, probe: str | None = None) -> Tool:
    """Return the tool of that name, else the first that is installed.

    Raises UsageError E2092 for a name that is none, PreconditionError E8120 where it is not installed.
    """
    if named is not None and named not in TOOLS:
        raise failures.flash_tool_unknown(named=named, tools=", ".join(TOOLS))
    for kind in TOOLS.values():
        if named in (None, kind.name) and (command := kind.found()):
            return kind(command, probe)
    if named is None:
        message = f"Neither of {' and '.join(TOOLS)} is installed."
        hint = f"Install pyocd: {PyOcd.install}."
    else:
        message = f"{named} is not installed."
        hint = f"Install it: {TOOLS[named].install}; without --tool any other one is taken."
    raise failures.flash_tool_missing(problem=message, remedy=hint)


def flash(tool: Tool, board: Board, data: bytes, say: Callable[[str], None]) -> Flashed:
    """Write an image to a board of its kind, compare what is there then byte by byte, and start it.

    Raises PreconditionError: E8121 without a board, E8122 for another chip, E8125 where the tool fails, E8126 where
    another image is read back; the board is not started then.
    """
    with (
        tempfile.TemporaryDirectory(prefix="edmctl-flash-") as folder,
        tempfile.TemporaryDirectory(
            prefix="edmctl-flash-"
        ) as folder_back,  # where no image lies to be copied
    ):
        tool.folder = Path(folder)
        (tool.folder / _IMAGE).write_bytes(data)
        found = tool.device_id(board) & _DEVICE_BITS
        chip = CHIPS.get(found, f"device id 0x{found:03X}")
        if found not in board.device_ids:
            raise wrong_chip(board, chip)
        say(f"{tool.name}: {chip} found; {len(data)} bytes are written.")
        tool.write(board)
        say(f"{tool.name}: written; it is read back.")
        tool.folder = Path(folder_back)
        tool.read_back(board, len(data))
        read = _first_bytes(tool.folder / _BACK, len(data) + 1)
        if read != data:
            differences = (at for at, (a, b) in enumerate(zip(read, data, strict=False)) if a != b)
            first = next(differences, min(len(read), len(data)))
            raise failures.flash_differs(read_count=len(read), address=board.flash.address + first)
        tool.start(board)
    return Flashed(tool.name, tool.command, chip, len(data))


def _first_bytes(file: Path, count: int) -> bytes:
    """Return the first bytes of a file; nothing if it is no regular file."""
    with suppress(OSError), open_regular(file) as opened:
        return opened.read(count)
    return b""


def _id_in(said: str, pattern: str, tool: str) -> int:
    if match := re.search(pattern, said, re.IGNORECASE | re.MULTILINE):
        number = int(match[1], 16)
        if number & _DEVICE_BITS not in (0, _DEVICE_BITS):
            return number
        raise no_board(
            f"{tool} finds a probe, and no chip behind it.", "Check supply and jumpers of the board."
        )
    told = "\n".join(f"  {line}" for line in said.strip().splitlines()[-_TOLD_LINES:])
    raise failures.chip_unknown(tool=tool, told=told)


def no_board(message: str, remedy: str) -> PreconditionError:
    """The error of a tool that reaches no board."""
    return failures.probe_not_found(problem=message.replace(" .", "."), remedy=remedy)


def several_boards(tool: str) -> PreconditionError:
    """The error of a choice that nobody made."""
    return no_board(f"{tool} finds several boards.", "Unplug the others, or say which with --probe ID.")


def wrong_chip(board: Board, found: str) -> PreconditionError:
    """The error of another chip than the image is for. Nothing was written."""
    return failures.image_for_another_board(title=board.title, chip=board.chip, found=found)
