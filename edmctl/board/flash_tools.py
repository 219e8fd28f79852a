"""Programs that flash a board, each as the arguments of four steps: identify the chip, write, read back, start.

They run in a folder of their own, where the image is `image.bin`, without input. They write and read a chip that
was reset and halted: one that was only halted is reset by its own watchdog, and what was just written must not run
before it has been compared. Arguments and messages are those of pyOCD 0.46 and OpenOCD 0.12.
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
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from edmctl import failures
from edmctl.core.boards import Board
from edmctl.dataclasses import dataclass
from edmctl.errors import installing
from edmctl.files import open_regular

_IDCODE = 0xE004_2000
"""DBGMCU_IDCODE, RM0090 38.6.1."""
_DEVICE_BITS = 0xFFF
_IMAGE, _BACK = "image.bin", "back.bin"
_SECONDS = 300
_SHOWN_LINES = 6
_MOST_BYTES = 4_000_000
"""Of a tool's output."""
_ID = re.compile(rf"^(?:0x)?{_IDCODE:08x}:\s+([0-9a-f]{{8}})", re.IGNORECASE | re.MULTILINE)
_TROUBLES = [
    (re.compile(pattern, re.IGNORECASE), failure)
    for pattern, failure in (
        (r"Enter the number of the debug probe", failures.several_probes),
        (
            r"LIBUSB_ERROR_ACCESS|access denied|insufficient permissions|permission denied",
            failures.probe_access_denied,
        ),
        (
            r"No connected debug probes|No available debug probes|No target device available|Probe .* not found"
            r"|Error: open failed|No device found|unable to find a matching|Error: Device not found",
            failures.probe_not_found,
        ),
        (
            r"unable to connect to the target|Get IDCODE error|No ACK|Failed to connect to target"
            r"|Failed to enter SWD mode|SWD/JTAG communication failure|Target not available",
            failures.chip_not_found,
        ),
    )
]


def _pyocd(board: Board, probe: str | None, size: int) -> dict[str, list[str]]:
    """https://pyocd.io; it does not check which chip it writes to."""
    at = ["--no-wait", "--target", board.pyocd_target, *(["--uid", probe] if probe else [])]
    halted = [*at, "--connect", "under-reset", "-O", "resume_on_disconnect=false"]
    flash = f"0x{board.flash.address:08x}"
    return {
        "identify": ["commander", *at, "--connect", "attach", "-c", f"read32 0x{_IDCODE:08x}"],
        "write": ["load", *halted, "--no-reset", "--format", "bin", "--base-address", flash, _IMAGE],
        "read back": ["commander", *halted, "-c", f"savemem {flash} {size} {_BACK}"],
        "start": ["reset", *at],
    }


def _openocd(board: Board, probe: str | None, size: int) -> dict[str, list[str]]:
    """https://openocd.org"""
    before = [f"{port} disabled" for port in ("gdb_port", "tcl_port", "telnet_port")]
    before += [f"adapter serial {probe}"] if probe else []
    flash = f"0x{board.flash.address:08x}"
    steps = {
        "identify": [f"mdw 0x{_IDCODE:08x}"],
        "write": [f"program {_IMAGE} {flash} verify"],
        "read back": ["reset halt", f"dump_image {_BACK} {flash} {size}"],
        "start": ["reset run"],
    }
    return {
        step: [
            "-f",
            board.openocd_config,
            *(word for c in (*before, "init", *commands, "shutdown") for word in ("-c", c)),
        ]
        for step, commands in steps.items()
    }


@dataclass(slots=True)
class Tool:
    """A program for flashing. takes_first : of several boards, without a message."""

    name: str
    steps: Callable[[Board, str | None, int], dict[str, list[str]]]
    install: str
    takes_first: bool = False
    command: tuple[str, ...] = ()
    probe: str | None = None

    def find(self) -> bool:
        """Set its command; return whether it is installed, on the path or as a package of this Python."""
        if path := shutil.which(self.name):
            self.command = (path,)
        elif self.name == "pyocd" and importlib.util.find_spec("pyocd") is not None:
            self.command = (sys.executable, "-m", "pyocd")
        return bool(self.command)

    def run(self, arguments: list[str], folder: Path) -> str:
        """Run the tool and return its output on both streams. Raises PreconditionError E8121, E8125."""
        command = [*self.command, *arguments]
        try:
            process = subprocess.Popen(
                command,
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
        except OSError as error:
            raise failures.flash_tool_unusable(name=self.name, what=f"does not run: {error}") from error
        timer = threading.Timer(_SECONDS, process.kill)
        with process:
            timer.start()
            try:
                assert process.stdout is not None
                output = process.stdout.read(_MOST_BYTES)
                if len(output) == _MOST_BYTES:
                    raise failures.flash_tool_unusable(
                        name=self.name, what=f"prints more than {_MOST_BYTES} bytes"
                    )
                process.wait()
            except BaseException:
                process.kill()
                raise
            finally:
                timer.cancel()
        text = output.decode("utf-8", "replace")
        for pattern, failure in _TROUBLES:
            if pattern.search(text):
                raise failure(tool=self.name)
        if process.returncode:
            raise failures.flash_tool_failed(
                name=self.name,
                status=process.returncode,
                command=shlex.join(command),
                output=_last_lines(text),
            )
        return text


def tools() -> list[Tool]:
    """Return the known tools in the order in which they are tried."""
    return [
        Tool("pyocd", _pyocd, installing("pyocd")),
        Tool("openocd", _openocd, "`apt install openocd`", takes_first=True),
    ]


def find_tool(named: str | None, probe: str | None = None) -> Tool:
    """Return the tool of that name, else the first that is installed.

    Raises UsageError E2092 for an unknown name, PreconditionError E8120 if it is not installed.
    """
    names = [tool.name for tool in tools()]
    if named is not None and named not in names:
        raise failures.flash_tool_unknown(named=named, tools=", ".join(names))
    candidates = [tool for tool in tools() if named in (None, tool.name)]
    for tool in candidates:
        if tool.find():
            tool.probe = probe
            return tool
    missing = " and ".join(tool.name for tool in candidates)
    raise failures.flash_tool_missing(missing=missing, tool=candidates[0].name, install=candidates[0].install)


def flash(tool: Tool, board: Board, data: bytes, say: Callable[[str], None]) -> None:
    """Write an image to a board of its kind, compare it byte by byte, and start it.

    Raises PreconditionError: E8121 without a board, E8122 for another chip, E8125 if the tool fails, E8126 if
    another image is read back; the board is not started then.
    """
    steps = tool.steps(board, tool.probe, len(data))
    with (
        tempfile.TemporaryDirectory(prefix="edmctl-flash-") as work,
        tempfile.TemporaryDirectory(prefix="edmctl-flash-") as back,  # without an image that could be copied
    ):
        (Path(work) / _IMAGE).write_bytes(data)
        output = tool.run(steps["identify"], Path(work))
        if (match := _ID.search(output)) is None:
            raise failures.chip_unknown(tool=tool.name, output=_last_lines(output))
        device = int(match[1], 16) & _DEVICE_BITS
        if device in (0, _DEVICE_BITS):
            raise failures.chip_not_found(tool=tool.name)
        if device not in board.device_ids:
            found = f"one with device id 0x{device:03X}"
            raise failures.image_for_another_board(title=board.title, chip=board.chip, found=found)
        say(f"{tool.name}: {board.chip} found; {len(data)} bytes are written.")
        tool.run(steps["write"], Path(work))
        say(f"{tool.name}: written; it is read back.")
        tool.run(steps["read back"], Path(back))
        read = b""
        with suppress(OSError), open_regular(Path(back) / _BACK) as file:
            read = file.read(len(data) + 1)
        if read != data:
            differences = (at for at, (a, b) in enumerate(zip(read, data, strict=False)) if a != b)
            first = next(differences, min(len(read), len(data)))
            raise failures.flash_differs(read_count=len(read), address=board.flash.address + first)
        tool.run(steps["start"], Path(back))


def _last_lines(output: str) -> str:
    return "\n".join(f"  {line}" for line in output.strip().splitlines()[-_SHOWN_LINES:])
