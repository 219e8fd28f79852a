"""The job ledger: what was done on which machine with which tool, line by line, beside the run files.

A line of `ledger.jsonl` is one JSON object and is never changed. What holds now (where there are holes, where a tool
would touch, how much it has lost) follows from reading all lines of a machine in order: `tool_account`.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TypeAlias

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.files import json_of, lock_holder, open_descriptor, read_bytes, refuse_locked
from edmctl.record.locks import exclusive, retried
from edmctl.record.plain_values import record_of

VERSION = 4
"""Since 2 touches of the pad come with `home_um`: what the sensor showed then of a tool at home. Since 3 lines of a
virtual bench have its own time, `bench_s`. Since 4 references and jobs state their setup."""
UNFINISHED = "unfinished"
LARGEST = 1e12
"""Of any number in a line: in µm or s it is beyond all machines, and what is reckoned from it stays finite."""


@dataclass(frozen=True, slots=True)
class ToolChanged:
    """A new electrode under this name: whatever was known of an earlier one is over."""

    tool: str


@dataclass(frozen=True, slots=True)
class ToolNamed:
    """The tool that was called `before` has this name from now on, its reference and all."""

    tool: str
    before: str


@dataclass(frozen=True, slots=True)
class ReferenceTouched:
    """Z1: where a tool met the reference pad at `x_um`, `y_um`, by sensor (`z_um`) and actuator model (`model_um`).

    Without a sensor `z_um` is the model's too. `time_s` counts in the run. `doubt_u_um` is a standard uncertainty on
    top, of touches that were in doubt; `truth` what a virtual bench knows. `park_x_um` and `park_y_um` are where the
    tool is parked, NaN before version 4, `setup_sha256` the hash of the setup's values.
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
    """A job is about to cut holes of `radius_um` at `places`: name, x and y of the axis in µm.

    `wear_um` is what the tool is expected to lose by it.
    """

    tool: str
    run_file: str
    radius_um: float
    places: tuple[tuple[str, float, float], ...]
    wear_um: float = math.nan
    setup_sha256: str = ""


@dataclass(frozen=True, slots=True)
class SiteMachined:
    """A hole. Where `status` is "unfinished" its depth and wear are estimates; NaN where nothing is known.

    A hole `through` the sheet has no depth.
    """

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

    @property
    def lacks_depth(self) -> bool:
        """Whether it should have a depth and has none."""
        return self.status != UNFINISHED and not self.through and math.isnan(self.depth_um)


@dataclass(frozen=True, slots=True)
class WearMeasured:
    """What `measure-wear` found: the pad at `z_um`, and what the tool has lost since its reference."""

    tool: str
    run_file: str
    z_um: float
    wear_um: float
    wear_u95_um: float
    home_um: float = math.nan


@dataclass(frozen=True, slots=True)
class RunEnded:
    """The run is over after `time_s`; what it machined stands before this line."""

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
_KNOWN = {"x_um", "y_um", "radius_um"}
"""Where a hole is, and how wide, is known of every one: others may not run into it."""


@dataclass(frozen=True, slots=True)
class Line:
    """One entry: of which machine (by its serial number), and when (UTC, s since 1970).

    `bench_s` is the time of a virtual bench that a file keeps, NaN of any other machine.
    """

    serial: str
    utc_s: float
    entry: Entry
    bench_s: float = math.nan


class LaterVersion(Exception):
    """The version of a line that this program does not know."""


def line_of(row: bytes) -> Line:
    """Read one line. Raises LaterVersion, or ValueError, TypeError or KeyError where it is damaged."""
    values = json_of(row)
    if not isinstance(values, dict):
        raise TypeError("it is no object")
    version = values.pop("v")
    if not isinstance(version, int) or version < 1:
        raise ValueError("its version is no number")
    if version > VERSION:
        raise LaterVersion(version)
    kind = _KINDS.get(values.pop("kind"))
    if kind is None:
        raise ValueError("its kind is unknown")
    serial, utc_s, bench_s = values.pop("serial"), values.pop("utc_s"), values.pop("bench_s", None)
    if not isinstance(serial, str):
        raise TypeError("its serial is no text")
    entry: Entry = record_of(kind, values)
    _refuse_absurd(entry)
    if isinstance(entry, SiteMachined) and entry.lacks_depth:
        raise ValueError("its hole is measured, but has no depth_um")
    own_s = math.nan if bench_s is None else _number("bench_s", bench_s)
    return Line(serial, _number("utc_s", utc_s), entry, own_s)


def from_home_um(z_um: float, home_um: float) -> float:
    """Where a touch was, counted from the tool's home; of lines that do not tell home it is taken to be 0."""
    return z_um if math.isnan(home_um) else z_um - home_um


def _refuse_absurd(entry: Entry) -> None:
    """Raise TypeError for a number that no machine has, or an unknown place."""
    numbers = {one.name: getattr(entry, one.name) for one in dataclasses.fields(entry)}
    for place in numbers.pop("places", ()):
        numbers |= {f"x of {place[0]}": place[1], f"y of {place[0]}": place[2]}
    numbers |= numbers.pop("truth", None) or {}
    for name, value in numbers.items():
        is_known = name in _KNOWN or name.startswith(("x of", "y of"))
        if type(value) is float and (abs(value) > LARGEST or (is_known and math.isnan(value))):
            raise TypeError(f"{name} is no number, or one beyond any machine")
        if type(value) is int and not 0 < value <= LARGEST:
            raise TypeError(f"{name} is no count")


def _number(name: str, raw: object) -> float:
    if isinstance(raw, bool) or not isinstance(raw, int | float) or not abs(raw) <= LARGEST:
        raise TypeError(f"{name} is no number, or one beyond any machine")
    return float(raw)


def text_of(line: Line) -> str:
    """Return the line as it stands in the file, with its end."""
    values = {"v": VERSION, "kind": _NAMES[type(line.entry)], "serial": line.serial, "utc_s": line.utc_s}
    for name, value in {"bench_s": line.bench_s, **dataclasses.asdict(line.entry)}.items():
        values[name] = None if isinstance(value, float) and not math.isfinite(value) else value
    return json.dumps(values, ensure_ascii=False, allow_nan=False) + "\n"


LEDGER_BYTES = 200_000_000
FILE_NAME = "ledger.jsonl"
LONGEST_WAIT_S = 10.0
"""Longest wait to add the result of a job: a slow disk must not cost it."""
OPENING_WAIT_S = 1.0
"""Longest wait to open: a ledger that stays locked is refused before anything moves."""


class Ledger:
    """The ledger of a folder of run files."""

    def __init__(self, path: Path, lines: tuple[Line, ...]) -> None:
        self.path = path
        self.lines = lines

    @classmethod
    def open(cls, folder: Path) -> Ledger:
        """Read the ledger of a folder; an empty one where there is none.

        A last line that was cut off while it was written is left out.

        Raises RunFileError: E9030 it cannot be read, E9031 a line of it is damaged, E9032 a later version wrote it.
        """
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
        """Add entries of a machine; they are on the disk when the call returns. `bench_s` as in `Line`.

        Raises RunFileError E9033 where that is not possible.
        """
        if not entries:
            return
        new = tuple(Line(serial, time.time(), entry, bench_s) for entry in entries)
        text = "".join(text_of(line) for line in new).encode()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with _locked(self.path) as descriptor:
                _mend_end(descriptor)
                _write(descriptor, text)
        except OSError as refused:
            holder = lock_holder(self.path) if isinstance(refused, BlockingIOError) else ""
            why = f"{holder} has locked it" if holder else refused.strerror or refused
            raise failures.ledger_not_written(path=self.path, why=why) from refused
        self.lines += new


def _lines(path: Path, data: bytes) -> Iterator[Line]:
    """Every whole line. The last one counts where it is whole, even if its end of line is missing."""
    rows = data.split(b"\n")
    for number, row in enumerate(rows, start=1):
        is_last = number == len(rows)
        if is_last and not row:
            return
        try:
            yield line_of(row)
        except LaterVersion as later:
            raise failures.ledger_line_of_later_version(
                path=path, number=number, later=later, version=VERSION
            ) from None
        except (ValueError, TypeError, KeyError) as error:
            if is_last:
                return
            raise failures.ledger_line_damaged(path=path, number=number, error=error) from error


@contextmanager
def _locked(path: Path) -> Iterator[int]:
    """Open the ledger for appending while nobody else does."""
    descriptor = open_descriptor(path, os.O_RDWR | os.O_CREAT | os.O_APPEND)
    with ExitStack() as held:
        held.callback(os.close, descriptor)
        retried(lambda: held.enter_context(exclusive(descriptor)), LONGEST_WAIT_S)
        yield descriptor


def _mend_end(descriptor: int) -> None:
    """Give a whole last line its end of line, and take a torn one away: nothing may be glued to it."""
    size = os.fstat(descriptor).st_size
    last = os.pread(descriptor, size, 0).rpartition(b"\n")[2]
    if not last:
        return
    try:
        line_of(last)
    except LaterVersion:
        _write(descriptor, b"\n")
    except (ValueError, TypeError, KeyError):
        os.ftruncate(descriptor, size - len(last))
    else:
        _write(descriptor, b"\n")


def _write(descriptor: int, text: bytes) -> None:
    while text:
        text = text[os.write(descriptor, text) :]
    os.fsync(descriptor)
