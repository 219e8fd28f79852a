"""The firmware of a board: which one a connected board runs, and flashing it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from edmctl import failures
from edmctl.board.flash_tools import find_tool, flash
from edmctl.board.image import Image, hexadecimal
from edmctl.core.boards import Board, board_name
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import Diagnostic, LinkLost, ProtocolMismatch
from edmctl.files import lock_holder
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
