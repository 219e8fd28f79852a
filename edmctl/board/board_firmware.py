"""The firmware of a board: which one a connected board runs, and flashing it by an installed program.

Programs that flash run in four steps: identify the chip, write, read back, start. They run in a folder of their own,
where the image is `image.bin`, without input. They write and read a chip that was reset and halted: one that was
only halted is reset by its own watchdog, and what was just written must not run before it has been compared.
Arguments and messages are those of pyOCD 0.46 and OpenOCD 0.12.
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
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.board.image import Image, hexadecimal
from edmctl.core.boards import Board, board_name
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import Diagnostic, LinkLost, ProtocolMismatch, installing
from edmctl.files import lock_holder, open_regular
from edmctl.jobs.connect import line_to
from edmctl.jobs.plan import where_is
from edmctl.link.messages import SCHEMA_HASH
from edmctl.link.ports import same_port, st_links
from edmctl.link.session import Session
from edmctl.profile.setup import Setup
from edmctl.wording import dotted

AT_REST = ("BOOT", "IDLE", "FAULT", "ESTOP")
"""States in which no job runs: pulses are off, and only a retracting tool moves."""
_STARTS_S = 3.0
"""A board starts within this after flashing."""


@dataclass(frozen=True, slots=True)
class BoardFacts:
    """What a controller reports without a session.

    None if it has another schema and does not report that. differing : names that its schema and this program's do
    not share, as far as they are known.
    """

    port: str
    serial: str | None
    board: int | None
    board_name: str
    protocol: tuple[int, int]
    firmware: tuple[int, int, int] | None
    schema: int
    has_same_schema: bool
    state: str | None
    fault: int | None
    boot_count: int | None
    baud: int | None
    differing: tuple[str, ...]

    def as_mapping(self) -> dict[str, Any]:
        return asdict(self) | {
            "protocol": dotted(self.protocol),
            "firmware": dotted(self.firmware) if self.firmware else None,
            "schema": hexadecimal(self.schema),
        }


@contextmanager
def session_at(
    port: str, setup: Setup, wait_s: float, say: Callable[[str], None], environ: Mapping[str, str]
) -> Iterator[Session]:
    """Hold a port, for `introduction` only: no session is opened, and what runs there continues.

    Raises LinkLost, and UsageError E2091 for a virtual machine of this process.
    """
    where = where_is(port, setup, wait_s)
    if where.in_process:
        raise failures.virtual_machine_has_no_board(selector=where.selector)
    session = Session(line_to(where, setup, say, environ))
    try:
        yield session
    finally:
        session.close()


def board_at(
    port: str, setup: Setup, wait_s: float, say: Callable[[str], None], environ: Mapping[str, str]
) -> BoardFacts:
    """Return what the controller at a port reports. Raises as `session_at`, and ProtocolMismatch."""
    with session_at(port, setup, wait_s, say, environ) as session:
        return introduced(session, setup.link.hello_s)


def introduced(session: Session, patience_s: float) -> BoardFacts:
    """Return what the controller reports. Raises LinkLost, ProtocolMismatch."""
    introduction = session.introduction(patience_s)
    known = introduction.fields
    return BoardFacts(
        port=session.transport.name,
        serial=known.get("serial"),
        board=known.get("board"),
        board_name=board_name(known["board"]) if "board" in known else "",
        protocol=introduction.protocol,
        firmware=(known["fw_major"], known["fw_minor"], known["fw_patch"]) if "fw_patch" in known else None,
        schema=introduction.schema_hash,
        has_same_schema=introduction.has_same_schema,
        state=introduction.state or None,
        fault=known.get("fault"),
        boot_count=known.get("boot_count"),
        baud=known.get("baud"),
        differing=introduction.differing,
    )


def check_runs(image: Image, board: BoardFacts) -> None:
    """Compare what a board reports with an image. Raises ProtocolMismatch E5001 to E5003."""
    record = image.record
    for name, code, ours, theirs in (
        ("board", "E5003", record.board, board.board),
        ("schema", "E5001", hexadecimal(record.schema_hash), hexadecimal(board.schema)),
        ("firmware", "E5002", dotted(record.firmware), board.firmware and dotted(board.firmware)),
    ):
        if theirs not in (None, ours):
            raise ProtocolMismatch(
                f"The board at {board.port} does not run {image.path}: {name} {theirs} instead of {ours}.",
                hint="Reset the board and look at `edmctl firmware info PORT`; then flash it again.",
                code=code,
            )


@dataclass(slots=True)
class Flashing:
    """An image to flash, with tool, probe and port; and what was done: tool and chip, the board before and after."""

    image: Image
    tool_name: str | None
    probe: str | None
    port: str | None
    wait_s: float
    tool: str | None = None
    chip: str | None = None
    before: BoardFacts | None = None
    after: BoardFacts | None = None

    def as_mapping(self) -> dict[str, object]:
        return {
            "image": self.image.as_mapping(),
            "tool": self.tool,
            "chip": self.chip,
            "read_back": self.tool is not None,
            "before": self.before.as_mapping() if self.before else None,
            "after": self.after.as_mapping() if self.after else None,
        }


def flash_board(
    job: Flashing,
    setup: Setup,
    say: Callable[[str], None],
    environ: Mapping[str, str],
    confirm: Callable[[Board], None],
) -> None:
    """Flash a board that is at rest; `confirm` raises unless the high voltage is off.

    The port is held meanwhile, so that no job starts.

    Raises LinkLost, ProtocolMismatch, UsageError, and PreconditionError: E8120 to E8122, E8125, E8126 of the tool,
    E8123 if a job runs.
    """
    board, port = job.image.board, job.port
    if board is None:
        raise failures.image_for_unknown_board(facts=job.image.path, board=job.image.record.board)
    tool = find_tool(job.tool_name, job.probe)

    def write() -> None:
        if tool.takes_first and not tool.probe and len(st_links()) > 1:
            raise failures.several_probes(tool=tool.name)
        confirm(board)
        flash(tool, board, job.image.data, say)
        job.tool, job.chip = tool.name, board.chip

    if port is None:
        for link in st_links():  # a job may run behind any of them
            if owner := lock_holder(Path(link.device)):
                raise failures.port_in_use(device=link.device, owner=owner)
        write()
        return
    if port == "auto" or port.startswith("serial:"):
        raise failures.port_not_exact(port=port)
    with session_at(port, setup, job.wait_s, say, environ) as session:
        try:
            job.before = introduced(session, setup.link.hello_s)
        except LinkLost:
            if session.statistics.bytes_received:
                raise
            say(f"No controller answers at {port}; it may be a new board.")
        else:
            _check_before(job.before, board)
        serial = next((link.usb_serial for link in st_links() if same_port(port, link.device)), "")
        if serial and tool.probe and tool.probe.lower() not in serial.lower():
            raise failures.probe_of_another_board(port=port, serial=serial, probe=tool.probe)
        tool.probe = serial or tool.probe
        write()
        say("Started; the board is asked who it is.")
        job.after = introduced(session, setup.link.hello_s + _STARTS_S)
    check_runs(job.image, job.after)


def _check_before(facts: BoardFacts, board: Board) -> None:
    """Refuse a running job, and a board that the image is not for."""
    if facts.state is None:
        raise failures.state_of_controller_unknown(port=facts.port)
    if facts.state not in AT_REST:
        raise failures.controller_busy(port=facts.port, state=facts.state)
    if facts.board is not None and facts.board != board.number:
        chip = f"that of {facts.board_name} at {facts.port}"
        raise failures.image_for_another_board(title=board.title, chip=board.chip, found=chip)


def image_warnings(image: Image) -> list[Diagnostic]:
    """Warn of an image whose board this edmctl will not understand."""
    if image.has_same_schema:
        return []
    hashes = hexadecimal(image.record.schema_hash), hexadecimal(SCHEMA_HASH)
    return [failures.image_of_another_version(image=image.path, schema_hash=hashes[0], own_hash=hashes[1])]


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
