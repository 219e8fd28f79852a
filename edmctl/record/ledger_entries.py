"""What a line of the job ledger can say, and its form as JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import TypeAlias

from edmctl.dataclasses import dataclass
from edmctl.files import json_of

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
    known = {field.name: field for field in dataclasses.fields(kind)}
    strange = set(values) - set(known)
    if strange:
        raise ValueError(f"it has no place for {', '.join(sorted(strange))}")
    fields = {name: _value(name, str(known[name].type), raw) for name, raw in values.items()}
    entry = kind(**fields)  # type: ignore[arg-type]
    if isinstance(entry, SiteMachined) and entry.lacks_depth:
        raise ValueError("its hole is measured, but has no depth_um")
    own_s = math.nan if bench_s is None else _number("bench_s", bench_s)
    return Line(serial, _number("utc_s", utc_s), entry, own_s)


def from_home_um(z_um: float, home_um: float) -> float:
    """Where a touch was, counted from the tool's home; of lines that do not tell home it is taken to be 0."""
    return z_um if math.isnan(home_um) else z_um - home_um


def _value(name: str, kind: str, raw: object) -> object:
    if kind == "str" and isinstance(raw, str):
        return raw
    if kind == "bool" and isinstance(raw, bool):
        return raw
    if kind == "int" and isinstance(raw, int) and not isinstance(raw, bool) and 0 < raw <= LARGEST:
        return raw
    if kind == "float":
        return math.nan if raw is None and name not in _KNOWN else _number(name, raw)
    if kind.startswith("tuple") and isinstance(raw, list):
        return tuple((_value(name, "str", place), _number(name, x), _number(name, y)) for place, x, y in raw)
    if kind.startswith("Mapping") and (raw is None or isinstance(raw, dict)):
        return raw and {str(key): _number(name, value) for key, value in raw.items()}
    raise TypeError(f"{name} is no {kind.partition('[')[0]}")


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
