"""The firmware of a board: which one a connected board runs, whether an image is the same, and flashing it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.board.flash_tools import find_tool, flash
from edmctl.board.image import Image, hexadecimal
from edmctl.board.settings import settings_text
from edmctl.core.boards import Board, board_name
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import Diagnostic, LinkLost, ProtocolMismatch
from edmctl.files import lock_holder
from edmctl.jobs.connect import line_to
from edmctl.jobs.doctor import fail, ok, warn
from edmctl.jobs.plan import where_is
from edmctl.link.messages import PROTO_MAJOR, PROTO_MINOR, SCHEMA_HASH
from edmctl.link.ports import same_port, st_links
from edmctl.link.session import Session
from edmctl.profile.setup import Setup
from edmctl.results.equipment import Check, CheckStatus
from edmctl.wording import dotted

AT_REST = ("BOOT", "IDLE", "FAULT", "ESTOP")
"""States in which no job runs: pulses are off, and only a retracting tool moves."""
_STARTS_S = 3.0
"""A board starts within this after flashing."""
_CODES = {"board": "E5003", "schema": "E5001", "firmware": "E5002"}
_BUILD = "`edmctl firmware build --board stm32f4`"


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

    @property
    def is_simulated(self) -> bool | None:
        return None if self.board is None else self.board == 0

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


def compared(image: Image, board: BoardFacts) -> list[Check]:
    """Return whether a board runs an image, one check for each property, with the remedy of a difference."""
    record = image.record
    flash_it = f"`edmctl firmware flash {image.path} --port {board.port}`"
    ours = record.protocol, record.firmware
    theirs = board.protocol, board.firmware or record.firmware
    if ours > theirs:
        older, fix = "the board is older", f"Flash it: {flash_it}."
    elif ours < theirs:
        older = "the image is older"
        fix = f"Build a new one: {_BUILD}; or flash the older one: {flash_it}."
    else:
        older = "both have the same version, so one is an unreleased build"
        fix = f"Flash this one: {flash_it}."
    checks = []
    if board.board is None:
        message = f"the image is for {image.board_name}; the controller does not report its board"
        checks.append(warn("board", message, flash_it))
    elif board.board == record.board:
        checks.append(ok("board", board.board_name))
    else:
        message = f"the image is for {image.board_name}, this is {board.board_name}"
        remedy = f"Name an image for {board.board_name}; `edmctl firmware info FILE` shows its board."
        if board.board == 0:
            remedy = "Name the port of a board; `edmctl ports` lists them. This is a virtual controller."
        checks.append(fail("board", message, remedy))
    if record.schema_hash == board.schema:
        checks.append(ok("schema", f"{hexadecimal(board.schema)}, protocol {dotted(board.protocol)}"))
    else:
        message = (
            f"{hexadecimal(record.schema_hash)} (protocol {dotted(record.protocol)}) in the image, "
            f"{hexadecimal(board.schema)} ({dotted(board.protocol)}) on the board: {older}"
        )
        checks.append(fail("schema", message, fix))
    firmware = dotted(record.firmware)
    if board.firmware is None:
        message = f"{firmware} in the image; the controller does not report its version"
        checks.append(warn("firmware", message, flash_it))
    elif board.firmware == record.firmware:
        checks.append(ok("firmware", firmware))
    else:
        message = f"{firmware} in the image, {dotted(board.firmware)} on the board: {older}"
        checks.append(fail("firmware", message, fix))
    ours_text = f"protocol {PROTO_MAJOR}.{PROTO_MINOR}, schema {hexadecimal(SCHEMA_HASH)}"
    if image.has_same_schema and board.has_same_schema:
        checks.append(ok("edmctl", f"has the same: {ours_text}"))
    else:
        remedy = f"Build the image of this edmctl with {_BUILD} and flash it; or use the edmctl of the board."
        checks.append(warn("edmctl", f"has {ours_text}, unlike image or board", remedy))
    return checks


def settings_not_compared(image: Image, port: str) -> Check:
    """Return the check for ranges, steps and limits of --set, which a board does not report."""
    message = f"not compared, a board does not report them; in the image: {settings_text(image.settings)}"
    fix = f"`edmctl firmware flash {image.path} --port {port}` writes these."
    return warn("settings", message, fix)


def mismatch(image: Image, board: BoardFacts, checks: Sequence[Check]) -> ProtocolMismatch | None:
    """Return the error of the first failed check; None if the board runs the image, as far as it reports."""
    first = next((check for check in checks if check.status is CheckStatus.FAIL), None)
    if first is None:
        return None
    message = f"The board at {board.port} does not run {image.path}: {first.name}: {first.message}."
    return ProtocolMismatch(message, hint=first.fix, code=_CODES[first.name])


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
    if error := mismatch(job.image, job.after, compared(job.image, job.after)):
        raise error


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
