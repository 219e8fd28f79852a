"""What the schema file says, read anew: payloads, enumerations, parameters, faults; and the golden frames."""

from __future__ import annotations

import json
import struct
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

ROOT = Path(__file__).parents[2]
LINK = ROOT / "edmctl" / "link"
GOLDEN = ROOT / "tests" / "link" / "golden"
_CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "u64": "Q", "s12": "12s"}

Fields = dict[str, Any]


@dataclass(frozen=True)
class Layout:
    """One payload: a header, then `n` records of fixed size, or text to the end."""

    name: str
    fields: tuple[tuple[str, str, float], ...]
    record: tuple[tuple[str, str, float], ...]

    def pack(self, values: Fields) -> bytes:
        """Values in their units to wire bytes; a field that is not given is 0."""
        unknown = values.keys() - {name for name, _, _ in self.fields}
        assert not unknown, f"{self.name} has no field {sorted(unknown)}"
        return b"".join(_pack(code, scale, values.get(name, 0)) for name, code, scale in self.fields)

    def unpack(self, payload: bytes) -> Fields | None:
        """Wire bytes to values in their units; None where the length is not the table's."""
        fixed = [row for row in self.fields if row[1] != "utf8"]
        head = _format(fixed)
        if len(payload) < head.size:
            return None
        values = _scaled(fixed, head.unpack_from(payload))
        rest = payload[head.size :]
        if len(fixed) < len(self.fields):
            values[self.fields[-1][0]] = rest.decode("utf-8", "replace")
        elif self.record:
            row = _format(self.record)
            if len(rest) != row.size * values["n"]:
                return None
            values["records"] = [rest[start : start + row.size] for start in range(0, len(rest), row.size)]
        elif rest:
            return None
        return values

    def read_record(self, record: bytes) -> Fields:
        """One record as values in their units."""
        return _scaled(self.record, _format(self.record).unpack(record))


@dataclass(frozen=True)
class Parameter:
    """One parameter; every number is a wire integer."""

    id: int
    name: str
    default: int
    least: int
    greatest: int
    scale: float


def _format(rows: Any) -> struct.Struct:
    return struct.Struct("<" + "".join(_CODES[code] for _, code, _ in rows))


def _pack(code: str, scale: float, value: Any) -> bytes:
    if code == "utf8":
        return str(value).encode()
    if code == "s12":
        return struct.pack("12s", str(value).encode("ascii"))
    return struct.pack("<" + _CODES[code], round(value / scale) if scale != 1 else value)


def _scaled(rows: Any, raw: tuple[Any, ...]) -> Fields:
    values: Fields = {}
    for (name, code, scale), value in zip(rows, raw, strict=True):
        if code == "s12":
            values[name] = value.rstrip(b"\0").decode("ascii")
        else:
            # Dividing by the whole number 1/scale gives the decimal that people wrote down.
            values[name] = value if scale == 1 else value / round(1 / scale)
    return values


def _load() -> Any:
    return tomllib.loads((ROOT / "tools" / "generate" / "edmlink1.toml").read_text(encoding="utf-8"))


_SCHEMA = _load()
MAJOR, MINOR = _SCHEMA["protocol"]["major"], _SCHEMA["protocol"]["minor"]
COMMANDS: dict[str, int] = {m["name"]: m["id"] for m in _SCHEMA["message"] if "request" in m}
UNASKED: dict[str, int] = {m["name"]: m["id"] for m in _SCHEMA["message"] if "unsolicited" in m}
REQUESTS: dict[int, Layout] = {}
ANSWERS: dict[int, Layout] = {}
"""What a controller sends, by the type of the frame: replies and what it sends unasked."""


def _rows(rows: Any) -> tuple[tuple[str, str, float], ...]:
    return tuple((name, code, scale) for name, code, _, scale, _ in rows)


for _m in _SCHEMA["message"]:
    _record = _rows(_m.get("record", ()))
    if "request" in _m:
        REQUESTS[_m["id"]] = Layout(_m["name"], _rows(_m["request"]), ())
        ANSWERS[_m["id"] | 0x40] = Layout(_m["name"] + "_REPLY", _rows(_m["reply"]), _record)
    else:
        ANSWERS[_m["id"]] = Layout(_m["name"], _rows(_m["unsolicited"]), _record)

NAMES = {layout.name: type_id for type_id, layout in (REQUESTS | ANSWERS).items()}


def enum(name: str) -> dict[str, int]:
    """Names and numbers of an enumeration or of flags."""
    kinds = _SCHEMA["enum"] | _SCHEMA["flags"]
    values: dict[str, int] = kinds[name]["values"]
    return values


def _count(value: float, scale: float) -> int:
    return round(value / scale)


PARAMETERS = {
    row[1]: Parameter(
        row[0],
        row[1],
        default=_count(row[4], row[3]),
        least=_count(row[5], row[3]),
        greatest=_count(row[6], row[3]),
        scale=row[3],
    )
    for group in _SCHEMA["param"]
    for row in group["rows"]
}


def profile_crc(counts: dict[str, int] | None = None) -> int:
    """The check of COMMIT_PROFILE and ARM; parameters that are not given count with their defaults."""
    given = counts or {}
    crc = 0
    for p in sorted(PARAMETERS.values(), key=lambda p: p.id):
        crc = crc32(struct.pack("<Hi", p.id, given.get(p.name, p.default)), crc)
    return crc


def faults() -> list[Fields]:
    """Rows of the fault table."""
    table = tomllib.loads((LINK / "faults.toml").read_text(encoding="utf-8"))
    return [{"name": name, "who": "controller", **row} for name, row in table.items()]


def golden_names() -> list[str]:
    """Every recorded frame there is."""
    return sorted(path.stem for path in GOLDEN.glob("*.json"))


def golden(name: str) -> Fields:
    """One recorded frame with its fields."""
    loaded: Fields = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
    return loaded


def golden_frame(name: str) -> bytes:
    """The bytes of one recorded frame, both zeros included."""
    return bytes.fromhex(golden(name)["frame"])


def schema_hash() -> int:
    """The hash that HELLO carries, as docs/protocol.md prints it."""
    page = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    return int(page.split("Schema hash of version ")[1].split("`")[1], 16)
