"""The job ledger: what was done on which machine with which tool, line by line, beside the run files.

A line of `ledger.jsonl` is one JSON object and is never changed. The present state (holes, the pad height of each
tool, its wear) follows from reading all lines of a machine in order: `history_of`.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TypeAlias

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, field, fields, replace
from edmctl.errors import RunFileError
from edmctl.files import json_of, lock_holder, open_descriptor, read_bytes, refuse_locked
from edmctl.jsonout import to_json_value
from edmctl.record.disk import exclusive_lock, retried
from edmctl.record.json_rows import record_of, typed, write_through

VERSION = 4
"""Since 2 touches of the pad have `home_um`, the sensor reading of a tool at home. Since 3 lines of a virtual bench
have its own time, `bench_s`. Since 4 references and jobs state their setup."""
UNFINISHED = "unfinished"
LARGEST = 1e12
"""Of any number in a line: in µm or s it is beyond all machines, and results computed from it stay finite."""
LEDGER_BYTES = 200_000_000
FILE_NAME = "ledger.jsonl"
LONGEST_WAIT_S = 10.0
"""Longest wait to add the result of a job: a slow disk must not cost it."""
OPENING_WAIT_S = 1.0
"""Longest wait to open: a ledger that stays locked is refused before anything moves."""
SAME_PLACE_UM = 1.0
"""Two holes of one name so close together are one hole that was resumed: stages repeat to within this."""


@dataclass(frozen=True, slots=True)
class ToolChanged:
    """A new electrode under this name: nothing that was known of an earlier one applies."""

    tool: str


@dataclass(frozen=True, slots=True)
class ToolNamed:
    """The tool that was called `before` has this name from now on, and keeps its reference."""

    tool: str
    before: str


@dataclass(frozen=True, slots=True)
class ReferenceTouched:
    """Z1: the height of the reference pad at `x_um`, `y_um` by sensor (`z_um`) and actuator model (`model_um`).

    Without a sensor `z_um` is the model's too. `time_s` counts in the run. `doubt_u_um` is the additional standard
    uncertainty of suspect touches, `truth` the true values of a virtual bench. The tool is parked at `park_x_um`,
    `park_y_um`, NaN before version 4. `setup_sha256` is the hash of the setup's values.
    """

    tool: str
    run_file: str
    z_um: float
    sd_um: float
    touches: int
    model_um: float
    sensor: bool
    x_um: float
    y_um: float
    speed_um_s: float
    time_s: float
    temperature_c: float = math.nan
    home_um: float = math.nan
    doubt_u_um: float = 0.0
    truth: Mapping[str, float] | None = None
    park_x_um: float = math.nan
    park_y_um: float = math.nan
    setup_sha256: str = ""


@dataclass(frozen=True, slots=True)
class JobBegun:
    """A job is about to cut holes of `radius_um` at `places` (name, x, y in µm), with an expected `wear_um`."""

    tool: str
    run_file: str
    radius_um: float
    places: tuple[tuple[str, float, float], ...]
    wear_um: float = math.nan
    setup_sha256: str = ""


@dataclass(frozen=True, slots=True)
class SiteMachined:
    """A hole. If `status` is "unfinished", depth and wear are estimates, or NaN. A hole `through` has no depth."""

    tool: str
    run_file: str
    name: str
    x_um: float
    y_um: float
    radius_um: float
    status: str
    depth_um: float
    wear_um: float
    wear_u95_um: float = math.nan
    z1_um: float = math.nan
    z2_um: float = math.nan
    z3_um: float = math.nan
    home_um: float = math.nan
    depth_u95_um: float = math.nan
    depth_u_um: float = math.nan
    through: bool = False


@dataclass(frozen=True, slots=True)
class WearMeasured:
    """Result of `measure-wear`: the pad at `z_um`, and the wear since the tool's reference."""

    tool: str
    run_file: str
    z_um: float
    wear_um: float
    wear_u95_um: float
    home_um: float = math.nan


@dataclass(frozen=True, slots=True)
class RunEnded:
    """The run ended after `time_s`; earlier lines have its holes."""

    run_file: str
    status: str
    time_s: float


Entry: TypeAlias = (
    ToolChanged | ToolNamed | ReferenceTouched | JobBegun | SiteMachined | WearMeasured | RunEnded
)

_KINDS: dict[str, type[Entry]] = {
    "tool": ToolChanged,
    "named": ToolNamed,
    "reference": ReferenceTouched,
    "job": JobBegun,
    "site": SiteMachined,
    "wear": WearMeasured,
    "end": RunEnded,
}
_NAMES = {entry: name for name, entry in _KINDS.items()}
_KNOWN = {"utc_s", "x_um", "y_um", "radius_um"}
"""Place and width of every hole are known: others may not run into it."""


@dataclass(frozen=True, slots=True)
class Line:
    """One entry of a machine, at a UTC time (s since 1970) and the time of a virtual bench that a file keeps."""

    serial: str
    utc_s: float
    entry: Entry
    bench_s: float = math.nan


def line_of(row: bytes, path: Path, number: int) -> Line:
    """Read one line. Raises RunFileError E9032 for a later version; ValueError, TypeError, KeyError if damaged."""
    values = json_of(row)
    if not isinstance(values, dict):
        raise TypeError("it is no object")
    version = values.pop("v")
    if not isinstance(version, int) or version < 1:
        raise ValueError("its version is no number")
    if version > VERSION:
        raise failures.ledger_line_of_later_version(path=path, number=number, later=version, version=VERSION)
    kind = _KINDS.get(values.pop("kind"))
    if kind is None:
        raise ValueError("its kind is unknown")
    serial = typed(str, values.pop("serial"), "serial")
    utc_s, bench_s = (typed(float, values.pop(name, math.nan), name) for name in ("utc_s", "bench_s"))
    line = Line(serial, utc_s, record_of(kind, values), bench_s)
    _refuse_absurd(line)
    return line


def _refuse_absurd(line: Line) -> None:
    """Raise TypeError for a number beyond any machine, an unknown time or place, or a hole without depth."""
    entry = line.entry
    match entry:
        case SiteMachined(through=False) if entry.status != UNFINISHED and math.isnan(entry.depth_um):
            raise TypeError("its hole is measured, but has no depth_um")
    numbers = {one.name: getattr(entry, one.name) for one in fields(entry)}
    numbers |= {"utc_s": line.utc_s, "bench_s": line.bench_s}
    for name, x_um, y_um in numbers.pop("places", ()):
        numbers |= {f"x of {name}": x_um, f"y of {name}": y_um}
    numbers |= numbers.pop("truth", None) or {}
    for name, value in numbers.items():
        is_known = name in _KNOWN or name.startswith(("x of", "y of"))
        if type(value) is float and (abs(value) > LARGEST or (is_known and math.isnan(value))):
            raise TypeError(f"{name} is no number, or one beyond any machine")
        if type(value) is int and not 0 < value <= LARGEST:
            raise TypeError(f"{name} is no count")


def text_of(line: Line) -> str:
    """Return the line as it is in the file, with its end."""
    head = {"v": VERSION, "kind": _NAMES[type(line.entry)], "serial": line.serial, "utc_s": line.utc_s}
    values = to_json_value(head | {"bench_s": line.bench_s} | asdict(line.entry), is_exact=True)
    return json.dumps(values, ensure_ascii=False) + "\n"


class Ledger:
    """The ledger of a folder of run files."""

    def __init__(self, path: Path, lines: tuple[Line, ...]) -> None:
        self.path = path
        self.lines = lines

    @classmethod
    def open(cls, folder: Path) -> Ledger:
        """Read the ledger of a folder, without an incomplete last line. Raises RunFileError E9030, E9031, E9032."""
        path = folder / FILE_NAME
        try:
            retried(lambda: refuse_locked(path), OPENING_WAIT_S)
            data = read_bytes(path, LEDGER_BYTES)
        except FileNotFoundError:
            return cls(path, ())
        except OSError as refused:
            raise failures.ledger_unreadable(path=path, reason=refused.strerror) from refused
        return cls(path, tuple(_lines(path, data)))

    def append(self, serial: str, *entries: Entry, bench_s: float = math.nan) -> None:
        """Add entries; they are on the disk when the call returns. Raises RunFileError E9033 if that fails."""
        if not entries:
            return
        new = tuple(Line(serial, time.time(), entry, bench_s) for entry in entries)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with ExitStack() as stack:
                descriptor = open_descriptor(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
                stack.callback(os.close, descriptor)
                retried(lambda: stack.enter_context(exclusive_lock(descriptor)), LONGEST_WAIT_S)
                _complete_last_line(descriptor)
                write_through(descriptor, "".join(map(text_of, new)).encode())
        except OSError as refused:
            holder = lock_holder(self.path) if isinstance(refused, BlockingIOError) else ""
            why = f"{holder} has locked it" if holder else refused.strerror or refused
            raise failures.ledger_not_written(path=self.path, why=why) from refused
        self.lines += new


def _lines(path: Path, data: bytes) -> Iterator[Line]:
    """Yield every line; the last one if it is complete, even without its end of line."""
    rows = data.split(b"\n")
    for number, row in enumerate(rows, start=1):
        is_last = number == len(rows)
        if is_last and not row:
            return
        try:
            yield line_of(row, path, number)
        except (ValueError, TypeError, KeyError) as error:
            if is_last:
                return
            raise failures.ledger_line_damaged(path=path, number=number, error=error) from error


def _complete_last_line(descriptor: int) -> None:
    """Give a complete last line its end of line, and remove an incomplete one: nothing may be appended to it."""
    size = os.fstat(descriptor).st_size
    last = os.pread(descriptor, size, 0).rpartition(b"\n")[2]
    if not last:
        return
    try:
        with suppress(RunFileError):  # of a later version
            line_of(last, Path(), 0)
        write_through(descriptor, b"\n")
    except (ValueError, TypeError, KeyError):
        os.ftruncate(descriptor, size - len(last))


@dataclass(slots=True)
class ToolAccount:
    """One tool: its reference, the pad height it would touch now, its holes and its wear.

    `pad_um` counts from the tool's home at 0 V, NaN before the first touch. `holes` are all of the tool, `since`
    those after its reference; `lost_before_um` is its wear up to then. `reference_utc_s` and `reference_bench_s` are
    times as in `Line`. `killed` are its jobs since its last touch that never ended, with an unknown wear.
    `replaced_by` is the tool for which it was taken out of the machine after its last reference, "" if it was not:
    clamped again it has another length, so `reference` is None and `pad_um` NaN then.
    """

    label: str
    reference: ReferenceTouched | None = None
    reference_utc_s: float = math.nan
    reference_bench_s: float = math.nan
    pad_um: float = math.nan
    lost_before_um: float = 0.0
    holes: list[SiteMachined] = field(default_factory=list)
    since: list[SiteMachined] = field(default_factory=list)
    killed: list[JobBegun] = field(default_factory=list)
    replaced_by: str = ""

    @property
    def worn_um(self) -> float:
        """Sum of the wears since the reference."""
        return math.fsum(_known(hole.wear_um) for hole in self.since)

    @property
    def worn_u95_um(self) -> float:
        """Half-width of its 95 % interval, without holes that have no estimate."""
        return math.hypot(*(_known(hole.wear_u95_um) for hole in self.since))

    @property
    def lost_um(self) -> float:
        """Sum of the wears since the tool was new."""
        return self.lost_before_um + self.worn_um


@dataclass(frozen=True, slots=True)
class HomeSeen:
    """The sensor reading of a tool at home when the pad was touched, and its times, as in `Line`."""

    um: float
    utc_s: float
    bench_s: float


@dataclass(slots=True)
class MachineHistory:
    """Holes, tools, the tool last in use ("" before the first), its home readings, and the last reference."""

    holes: list[SiteMachined] = field(default_factory=list)
    tools: dict[str, ToolAccount] = field(default_factory=dict)
    tool: str = ""
    homes: list[HomeSeen] = field(default_factory=list)
    reference: ReferenceTouched | None = None

    def account(self, label: str) -> ToolAccount:
        """Return the account of a tool, a new one if nothing is known of it."""
        return self.tools.setdefault(label, ToolAccount(label))


def history_of(lines: Iterable[Line], serial: str) -> MachineHistory:
    """Replay the lines of a machine. Places of a job without an end count as holes of unknown depth."""
    history, open_jobs = MachineHistory(), dict[str, JobBegun]()
    for line in lines:
        if line.serial != serial:
            continue
        entry = line.entry
        if not isinstance(entry, RunEnded):
            _take_tool(history, entry.before if isinstance(entry, ToolNamed) else entry.tool)
            history.tool = entry.tool
        if isinstance(entry, ReferenceTouched | SiteMachined | WearMeasured) and math.isfinite(entry.home_um):
            history.homes.append(HomeSeen(entry.home_um, line.utc_s, line.bench_s))
        match entry:
            case ToolChanged():
                history.tools[entry.tool] = ToolAccount(entry.tool)
            case ToolNamed():
                history.tools[entry.tool] = replace(history.account(entry.before), label=entry.tool)
                del history.tools[entry.before]
            case ReferenceTouched():
                _take_reference(history, entry, line)
            case JobBegun():
                open_jobs[entry.run_file] = entry
                history.account(entry.tool).killed.append(entry)
            case SiteMachined():
                _take_site(history, entry)
            case WearMeasured():
                account = history.account(entry.tool)
                account.pad_um = _from_home_um(entry.z_um, entry.home_um)
                account.killed.clear()
            case RunEnded():
                if (ended := open_jobs.pop(entry.run_file, None)) is not None:
                    history.account(ended.tool).killed.clear()
    for job in open_jobs.values():
        for place in job.places:
            if not any(_is_same(hole, *place) for hole in history.holes):
                unknown = (UNFINISHED, math.nan, math.nan)
                history.holes.append(SiteMachined(job.tool, job.run_file, *place, job.radius_um, *unknown))
    return history


def _take_tool(history: MachineHistory, tool: str) -> None:
    """Drop the reference of the tool that was in the machine if `tool` is another one."""
    if history.tool in ("", tool):
        return
    account = history.account(history.tool)
    account.reference, account.pad_um, account.replaced_by = None, math.nan, tool
    account.lost_before_um = account.lost_um
    account.since.clear()


def _take_reference(history: MachineHistory, entry: ReferenceTouched, line: Line) -> None:
    account = history.account(entry.tool)
    history.reference = account.reference = entry
    account.replaced_by = ""
    account.reference_utc_s, account.reference_bench_s = line.utc_s, line.bench_s
    account.lost_before_um = account.lost_um
    account.pad_um = _from_home_um(entry.z_um, entry.home_um)
    account.since.clear()
    account.killed = [job for job in account.killed if job.run_file == entry.run_file]


def _take_site(history: MachineHistory, entry: SiteMachined) -> None:
    """Add a hole; a resumed one replaces its first part and wear, an unchanged one is no news of the tool."""

    def outcome(hole: SiteMachined) -> tuple[str, float, float]:
        return hole.status, _known(hole.depth_um), _known(hole.wear_um)

    account = history.account(entry.tool)
    worn_before_um = account.lost_um
    earlier = [hole for hole in account.holes if _is_same(hole, entry.name, entry.x_um, entry.y_um)]
    if entry.status != UNFINISHED and any(outcome(hole) == outcome(entry) for hole in earlier):
        return
    account.lost_before_um -= math.fsum(_known(hole.wear_um) for hole in earlier if hole not in account.since)
    for holes in (history.holes, account.holes, account.since):
        holes[:] = [hole for hole in holes if not _is_same(hole, entry.name, entry.x_um, entry.y_um)]
        holes.append(entry)
    if math.isnan(entry.z3_um):
        account.pad_um += account.lost_um - worn_before_um
    else:
        account.pad_um = _from_home_um(entry.z3_um, entry.home_um)


def _from_home_um(z_um: float, home_um: float) -> float:
    """Return a touch relative to the tool's home, which is assumed to be 0 if the line does not have it."""
    return z_um - _known(home_um)


def _known(value: float) -> float:
    return 0.0 if math.isnan(value) else value


def _is_same(hole: SiteMachined, name: str, x_um: float, y_um: float) -> bool:
    return hole.name == name and math.hypot(hole.x_um - x_um, hole.y_um - y_um) <= SAME_PLACE_UM
