"""The firmware of a board: what runs on a connected one, whether an image is the same, and putting one on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from edmctl import failures
from edmctl.board.flash_tools import Flashed, Tool, find_tool, flash, no_board, several_boards, wrong_chip
from edmctl.board.image import Image
from edmctl.board.results import BoardFacts, ImageFacts, hexadecimal, settings_text
from edmctl.core.boards import Board, board_name, board_of
from edmctl.dataclasses import dataclass
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
"""States in which no job runs: pulses are off, and nothing moves but a tool that is taken back."""
_STARTS_S = 3.0
"""A board that was flashed needs less to come up."""
_CODES = {"board": "E5003", "schema": "E5001", "firmware": "E5002"}
_BUILD = "`edmctl firmware build --board stm32f4`"


@dataclass(frozen=True, slots=True)
class Asked:
    """A port whose controller was asked who it is, held until the block ends. `board` is None for silence."""

    session: Session
    board: BoardFacts | None


@contextmanager
def board_at(
    port: str,
    setup: Setup,
    wait_s: float,
    say: Callable[[str], None],
    environ: Mapping[str, str],
    *,
    may_be_silent: bool = False,
) -> Iterator[Asked]:
    """Hold a port, and ask the controller there who it is; no session is opened, and what runs there goes on.

    Raises LinkLost, ProtocolMismatch, and UsageError E2091 for a virtual machine of this process.
    """
    where = where_is(port, setup, wait_s)
    if where.in_process:
        raise failures.virtual_machine_has_no_board(selector=where.selector)
    session = Session(line_to(where, setup, say, environ))
    try:
        yield Asked(session, _asked(session, setup.link.hello_s, may_be_silent=may_be_silent))
    finally:
        session.close()


def _asked(session: Session, patience_s: float, *, may_be_silent: bool = False) -> BoardFacts | None:
    try:
        told = session.introduction(patience_s)
    except LinkLost:
        if may_be_silent and not session.statistics.bytes_received:
            return None
        raise
    known = told.fields
    return BoardFacts(
        port=session.transport.name,
        protocol=told.protocol,
        schema_hash=told.schema_hash,
        has_same_schema=told.has_same_schema,
        firmware=(known["fw_major"], known["fw_minor"], known["fw_patch"]) if "fw_patch" in known else None,
        board=known.get("board"),
        board_name=board_name(known["board"]) if "board" in known else "",
        serial=known.get("serial"),
        state=told.state or None,
        fault=known.get("fault"),
        boot_count=known.get("boot_count"),
        baud=known.get("baud"),
        differing=told.differing,
    )


def compared(image: ImageFacts, board: BoardFacts) -> list[Check]:
    """Whether a board runs what an image holds, one thing after the other, with the remedy beside what differs."""
    flash_it = f"`edmctl firmware flash {image.path} --port {board.port}`"
    checks = []
    if board.board is None:
        checks.append(
            warn("board", f"the image is for {image.board_name}; the controller does not tell", flash_it)
        )
    elif board.board != image.board:
        fix = f"Name an image for {board.board_name}; `edmctl firmware info FILE` says what one is for."
        if board.board == 0:  # no image is for one
            fix = "Name the port of a board; `edmctl ports` lists them. Virtual and emulated ones are none."
        checks.append(fail("board", f"the image is for {image.board_name}, this is {board.board_name}", fix))
    else:
        checks.append(ok("board", board.board_name))
    older, fix = _older(image, board, flash_it)
    sides = f"{hexadecimal(image.schema_hash)} in the image, {hexadecimal(board.schema_hash)} on the board"
    if image.schema_hash == board.schema_hash:
        checks.append(ok("schema", f"{hexadecimal(board.schema_hash)}, protocol {dotted(board.protocol)}"))
    else:
        versions = f"protocol {dotted(image.protocol)} and {dotted(board.protocol)}"
        checks.append(fail("schema", f"{sides} ({versions}): {older}", fix))
    if board.firmware is None:
        checks.append(
            warn("firmware", f"{dotted(image.firmware)} in the image; the controller does not tell", flash_it)
        )
    elif image.firmware != board.firmware:
        sides = f"{dotted(image.firmware)} in the image, {dotted(board.firmware)} on the board"
        checks.append(fail("firmware", f"{sides}: {older}", fix))
    else:
        checks.append(ok("firmware", dotted(board.firmware)))
    checks.append(_this_program(image, board))
    return checks


def settings_not_compared(image: ImageFacts, board: BoardFacts) -> Check:
    """What no question at the port tells: the ranges, steps and limits that were --set for the board."""
    return warn(
        "settings",
        f"not compared, a board does not tell them; of the image: {settings_text(image.settings)}",
        f"`edmctl firmware flash {image.path} --port {board.port}` puts these on it.",
    )


def _older(image: ImageFacts, board: BoardFacts, flash_it: str) -> tuple[str, str]:
    """Return which side is older, and the remedy."""
    ours, theirs = (image.protocol, image.firmware), (board.protocol, board.firmware or image.firmware)
    if ours > theirs:
        return "the board is older", f"Flash it: {flash_it}."
    if ours < theirs:
        return "the image is older", f"Build a new one: {_BUILD}; or flash the older one: {flash_it}."
    return (
        "both claim the same version, so one is an unreleased build",
        f"Put the board on this one: {flash_it}.",
    )


def _this_program(image: ImageFacts, board: BoardFacts) -> Check:
    ours = f"protocol {PROTO_MAJOR}.{PROTO_MINOR}, schema {hexadecimal(SCHEMA_HASH)}"
    odd = [name for name, facts in (("image", image), ("board", board)) if not facts.has_same_schema]
    if not odd:
        return ok("edmctl", f"speaks the same: {ours}")
    fix = f"Build the image of this edmctl with {_BUILD}, and flash that; or use the edmctl of the board."
    return warn("edmctl", f"speaks {ours}; {' and '.join(odd)} another", fix)


def mismatch(image: ImageFacts, board: BoardFacts, checks: Sequence[Check]) -> ProtocolMismatch | None:
    """The error of a board that does not run the image; None where it does, as far as the line tells."""
    failed = [check for check in checks if check.status is CheckStatus.FAIL]
    if not failed:
        return None
    first = failed[0]
    return ProtocolMismatch(
        f"The board at {board.port} does not run {image.path}: {first.name}: {first.message}.",
        hint=first.fix,
        code=_CODES[first.name],
    )


@dataclass(slots=True)
class FlashReport:
    """What flashing has reached so far: `before` and `after` are what the board said at its port."""

    image: ImageFacts
    flashed: Flashed | None = None
    before: BoardFacts | None = None
    after: BoardFacts | None = None
    checks: Sequence[Check] = ()

    def as_mapping(self) -> dict[str, object]:
        """All of it as plain values."""
        done = self.flashed
        return {
            "image": self.image.as_mapping(),
            "tool": done.tool if done else None,
            "chip": done.chip if done else None,
            "read_back": done is not None,
            "before": self.before.as_mapping() if self.before else None,
            "after": self.after.as_mapping() if self.after else None,
        }


@dataclass(frozen=True, slots=True)
class FlashRequest:
    """What to flash, by which tool and probe, and at which port the board is asked before and after."""

    image: Image
    tool: str | None
    probe: str | None
    port: str | None
    wait_s: float


def flash_board(
    request: FlashRequest,
    report: FlashReport,
    setup: Setup,
    say: Callable[[str], None],
    environ: Mapping[str, str],
    confirm: Callable[[Board], None],
) -> None:
    """Flash a board, unless a job runs there, and fill the report; `confirm` raises unless the high voltage is off.

    The port is held meanwhile, so that no job begins.

    Raises LinkLost, ProtocolMismatch, UsageError, and PreconditionError: E8120 to E8122, E8125, E8126 of the tool,
    E8123 for a job that runs.
    """
    board = board_of(request.image.facts.board)
    if board is None:
        raise failures.image_for_unknown_board(
            facts=request.image.facts.path, board=request.image.facts.board
        )
    tool = find_tool(request.tool, request.probe)
    if request.port is None:
        _refuse_held_ports()
        _refuse_to_guess(tool)
        confirm(board)
        report.flashed = flash(tool, board, request.image.data, say)
        return
    if request.port == "auto" or request.port.startswith("serial:"):
        raise failures.port_not_exact(port=request.port)
    with board_at(request.port, setup, request.wait_s, say, environ, may_be_silent=True) as asked:
        report.before = asked.board
        if asked.board is None:
            say(f"No controller answers at {request.port}; it may be a new board.")
        else:
            _refuse(asked.board, board)
        _take_st_link_of(request.port, tool)
        _refuse_to_guess(tool)
        confirm(board)
        report.flashed = flash(tool, board, request.image.data, say)
        say("Started; the board is asked who it is.")
        report.after = _asked(asked.session, setup.link.hello_s + _STARTS_S)
    assert report.after is not None
    report.checks = compared(report.image, report.after)
    if error := mismatch(report.image, report.after, report.checks):
        raise error


def _refuse(found: BoardFacts, board: Board) -> None:
    """Refuse a running job, and a board that the image is not for."""
    if found.state is None:
        raise failures.state_of_controller_unknown(port=found.port)
    if found.state not in AT_REST:
        raise failures.controller_busy(port=found.port, state=found.state)
    if found.board is not None and found.board != board.number:
        raise wrong_chip(board, f"that of {found.board_name} at {found.port}")


def _refuse_held_ports() -> None:
    """Refuse if another program holds the port of an ST-LINK: a job may run there."""
    for port in st_links():
        if owner := lock_holder(Path(port.device)):
            raise failures.port_in_use(device=port.device, owner=owner)


def _take_st_link_of(port: str, tool: Tool) -> None:
    """Have the tool use the ST-LINK that the port belongs to."""
    serial = next((one.usb_serial for one in st_links() if same_port(port, one.device)), "")
    if serial and tool.probe and tool.probe.lower() not in serial.lower():
        raise no_board(
            f"{port} is of the ST-LINK {serial}, and --probe names {tool.probe}: another board than was asked.",
            "Leave --probe out, or name the port of that board.",
        )
    tool.probe = serial or tool.probe


def _refuse_to_guess(tool: Tool) -> None:
    """Refuse a tool that would take the first of several boards."""
    if tool.takes_first and not tool.probe and len(st_links()) > 1:
        raise several_boards(tool.name)


def image_doubts(image: ImageFacts) -> list[Diagnostic]:
    """What is doubtful about an image that is whole: this edmctl will not understand it."""
    if image.has_same_schema:
        return []
    return [
        failures.image_of_another_version(
            image=image.path, schema_hash=hexadecimal(image.schema_hash), own_hash=hexadecimal(SCHEMA_HASH)
        )
    ]
