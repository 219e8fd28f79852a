"""Reading TOML: the text verbatim, syntax errors with their place, `extends` and `--set key=value` laid over it."""

from __future__ import annotations

import re
import sys
import tomllib
import unicodedata
from collections.abc import Iterator, Sequence
from pathlib import Path

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, Location, ProfileError, UsageError
from edmctl.failures import Code
from edmctl.files import read_bytes
from edmctl.profile.folders import find_profile
from edmctl.profile.positions import SET_OPTION, KeyPath, Source, TomlTable, location
from edmctl.profile.units import NO_UNIT, in_unit_of_key, quantity
from edmctl.toml_text import toml_value
from edmctl.wording import code_point, shortened, with_hyphens

MOST_PARENTS = 20
MOST_KEYS = 20_000  # a thousand places with five keys each, and some more
MOST_PARTS = 32
_SYNTAX_PLACE = re.compile(
    r"(?P<what>.*) \(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)", re.DOTALL
)
_LONG_KEY = re.compile(r"""(?<![\w"'-])(?:[\w"'-]+[ \t]*\.[ \t]*){""" + str(MOST_PARTS) + "}")
_DECIMAL_COMMA = re.compile(r"\s*([+-]?\d+),(\d+)\s*(?:#.*)?")
_STRING_OR_COMMENT = re.compile(r""""[^"]*"|'[^']*'|#.*""")
_BARE_WORD = re.compile(r"[A-Za-z][\w.+/ -]*")
_LONG = re.compile(r"[\dA-Fa-f_]{256}")
_SITES = re.compile(r"\s*sites\s*[.\[]")
_HINT_SITES = (
    "write all places, --set 'sites=[{x_um=600},{x_um=1000,y_um=400}]', or put them into the profile"
)
_HINT = "write --set servo.reference=0.82, with the value as in a file: 0.8 and not .8, text in quotes"


@dataclass(frozen=True, slots=True)
class Merged:
    """Texts laid over one another: those that prevail first, the merged table, and what each changed, in words."""

    sources: tuple[Source, ...]
    table: TomlTable
    changes: tuple[str, ...]


def read_source(path: Path) -> Source:
    """Read a text file. Raises ProfileError when it cannot be read as UTF-8."""
    try:
        # Some editors put a mark of the byte order before the text.
        return Source(str(path), read_bytes(path).decode("utf-8").removeprefix("\ufeff"))
    except OSError as error:
        message, hint = f"cannot read {path}: {error.strerror}", "check the path and its permissions"
    except UnicodeDecodeError as error:
        message = f"{path} is not UTF-8 text (byte {error.start})"
        hint = "name a TOML file, saved as UTF-8 (`edmctl run show FILE` reads run files)"
    raise _refusal(Code.UNREADABLE, message, hint)


def parse(source: Source) -> TomlTable:
    """Parse a TOML text. Raises ProfileError with the place of the syntax error, or for more than anybody writes."""
    if long_key := _LONG_KEY.search(source.text):
        where, message = location(source.name, source.text, long_key.span()), f"more than {MOST_PARTS} parts"
        hint = "tables are at most three deep"
        raise _refusal(Code.SYNTAX, f"a key has {message}", hint, replace(where, column=1))
    try:
        table, keys = _loads(source.text)
        if keys > MOST_KEYS:
            raise _refusal(Code.SYNTAX, f"{source.name} holds more than {MOST_KEYS} keys", "split it")
        return table
    except tomllib.TOMLDecodeError as error:
        where, what = _syntax_place(source, str(error))
    except (ValueError, RecursionError):
        where, what = source.start(), "a number is too long or values are nested too deeply"
    hint = _value_hint(where.source_line, where.column) or (
        "texts are in quotes, a table begins with [name], a key is given once"
    )
    raise _refusal(Code.SYNTAX, f"not TOML: {what}", hint, where)


def _loads(text: str) -> tuple[TomlTable, int]:
    """Parse a TOML text, count its keys. Raises ValueError, also for an integer beyond any float; RecursionError."""
    table, keys = tomllib.loads(text), 0
    values: list[object] = [table]
    for value in values:  # which grows meanwhile
        if isinstance(value, dict):
            values += value.values()
            keys += len(value)
        elif isinstance(value, list):
            values += value
        elif isinstance(value, int) and abs(value) > sys.float_info.max:
            raise ValueError("a number is too long")
    return table, keys


def _value_hint(line: str, column: int = 1) -> str:
    """Return what to write instead of a line `key = value` that is not TOML; empty if no usual mistake is found.

    Those are a decimal comma, a unit behind a number, and a character that looks like another one. `column` is that
    of the syntax error.
    """
    key, _, value = line.partition("=")
    if number := _DECIMAL_COMMA.fullmatch(value):
        return f"a number has a decimal point, not a comma: {number[1]}.{number[2]}"
    if found := quantity(value.partition("#")[0]):
        number_of, unit = found
        fitting = in_unit_of_key(key.strip().rpartition(".")[2], number_of, unit or NO_UNIT)
        written = "{} = {:.12g}".format(*fitting) if fitting else "a number"
        return f"write {written}, without a unit: the unit is in the key"
    outside = _STRING_OR_COMMENT.sub("", line)
    for character in (line[column - 1 : column], *outside):
        if not character.isascii():
            return f"{code_point(character)} is not TOML here: {_instead(character)}"
    return ""


def _instead(character: str) -> str:
    if re.search("QUOTATION|PRIME|APOSTROPHE", unicodedata.name(character, "")):
        return 'write "'
    if with_hyphens(character) == "-":
        return "write -"
    if unicodedata.category(character) in ("Zs", "Zl", "Zp", "Cf"):
        return "write a plain space, or remove it"
    return "put texts in quotes"


def read_chain(path: Path, children: tuple[Path, ...] = ()) -> Merged:
    """Read a profile and, through `extends`, its parents. Raises ProfileError, also for a circle."""
    source = read_source(path)
    own = parse(source)
    if "extends" not in own:
        return Merged((source,), own, ())
    seen = (*children, path.resolve())
    if len(seen) > MOST_PARENTS:
        message = f"more than {MOST_PARENTS} profiles extend one another"
        raise _refusal(Code.EXTENDS, message, "put them together", source.value(("extends",)))
    below = read_chain(_parent(source, own.pop("extends"), path, seen), seen)
    merged = extend(below.table, own)
    changed = (*below.changes, *changes(below.table, merged, path.name))
    return Merged((source, *below.sources), merged, changed)


def _parent(source: Source, name: object, path: Path, seen: tuple[Path, ...]) -> Path:
    try:
        parent = find_profile(name, path.parent) if isinstance(name, str) else None
        if parent is None:
            message, hint = "extends does not name a file", 'write extends = "other.toml"'
        elif parent.resolve() not in seen:
            return parent
        else:
            circle = " -> ".join(one.name for one in (*seen, parent.resolve()))
            message, hint = f"profiles extend each other in a circle: {circle}", "break it here"
    except UsageError as error:
        message, hint = f"extends = {toml_value(name)}: {error.message}", error.hint
    raise _refusal(Code.EXTENDS, message, hint, source.value(("extends",)))


def _refusal(code: Code, message: str, hint: str, where: Location | None = None) -> ProfileError:
    return ProfileError((Diagnostic(code, message, hint, where),))


def _syntax_place(source: Source, message: str) -> tuple[Location, str]:
    """Return the location that a syntax error names; the last line's end for the end of the document."""
    match, lines = _SYNTAX_PLACE.match(message), source.text.split("\n")
    line, column = len(lines), len(lines[-1]) + 1
    if match and match["line"]:
        line, column = int(match["line"]), int(match["column"])
    what = match["what"] if match else message
    source_line = lines[line - 1].rstrip("\r") if line <= len(lines) else ""
    return Location(source.name, line, column, 1, source_line), what


def apply_overrides(below: Merged, overrides: Sequence[str]) -> Merged:
    """Lay `key=value` texts over what files hold; a whole table as value replaces the table.

    Values are TOML; a bare word becomes a text. Raises ProfileError with every malformed text.
    """
    table, sources, lines = below.table, list(below.sources), list(below.changes)
    wrong: list[Diagnostic] = []
    for text in overrides:
        hint = _HINT
        try:
            if _SITES.match(text.partition("=")[0]):
                message, hint = "sites is a list, and only the whole of it can be set", _HINT_SITES
                raise KeyError(message)
            path, value = _parse(text)
            after = put(table, path, value)
        except ValueError:
            message = f"cannot read --set {shortened(text)}: it is not key=value with a TOML value"
            hint = "the number is too long" if _LONG.search(text) else _value_hint(text) or hint
        except KeyError as error:
            message = f"cannot use --set {text}: {error.args[0]}"
        else:
            lines += changes(table, after, SET_OPTION)
            table = after
            sources.insert(0, Source(SET_OPTION, text))
            continue
        where = Location(SET_OPTION, 1, 1, max(1, len(text)), text)
        wrong.append(Diagnostic(Code.OVERRIDE, message, hint, where))
    if wrong:
        raise ProfileError(tuple(wrong))
    return Merged(tuple(sources), table, tuple(lines))


def _parse(text: str) -> tuple[tuple[str, ...], object]:
    """Return key path and value. Raises ValueError when the text is not `key=value`."""
    key, _, value = text.partition("=")
    path, value = _key_path(key), value.strip(" \t")
    if not path or not value or "\n" in text:
        raise ValueError("no key or no value")
    try:
        return path, _loads(f"value = {value}")[0]["value"]
    except (ValueError, RecursionError):
        if _BARE_WORD.fullmatch(value):
            return path, value
        raise ValueError("no TOML value") from None


def _key_path(key: str) -> tuple[str, ...]:
    """The parts of a dotted key; none when it is not one."""
    try:
        below: object = tomllib.loads(f"{key} = 0")
    except (ValueError, RecursionError):
        return ()
    path: tuple[str, ...] = ()
    while isinstance(below, dict) and len(below) == 1:
        ((part, below),) = below.items()
        path = (*path, part)
    return path if len(path) <= MOST_PARTS else ()


def dotted(path: KeyPath) -> str:
    """A key path as people write it: `servo.reference`, `sites[1].x_um`."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def extend(base: TomlTable, child: TomlTable) -> TomlTable:
    """The base with the child's keys laid over it, table by table.

    A table that states its `kind` is another kind of thing, not a change of the base's: it replaces it whole.
    """
    merged = dict(base)
    for key, value in child.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            is_change = value.get("kind") in (None, below.get("kind"))
            value = extend(below, value) if is_change else value
        merged[key] = value
    return merged


def put(table: TomlTable, path: tuple[str, ...], value: object) -> TomlTable:
    """A copy of the table with one value set; raises KeyError where the path runs through a plain value."""
    if len(path) == 1:
        return {**table, path[0]: value}
    below = table.get(path[0], {})
    if not isinstance(below, dict):
        raise KeyError(f"{path[0]} is a value, not a table")
    return {**table, path[0]: put(below, path[1:], value)}


def changes(before: TomlTable, after: TomlTable, origin: str) -> Iterator[str]:
    """One line per value that differs: `servo.reference = 0.82 (was 0.8, --set)`."""
    old, new = dict(_leaves(before)), dict(_leaves(after))
    for path, value in new.items():
        if path not in old or old[path] != value:
            was = f"was {toml_value(old[path])}" if path in old else "was not given"
            yield f"{dotted(path)} = {toml_value(value)} ({was}, {origin})"
    for path in [path for path in old if path not in new]:
        yield f"{dotted(path)} removed (was {toml_value(old[path])}, {origin})"


def _leaves(table: TomlTable, prefix: KeyPath = ()) -> Iterator[tuple[KeyPath, object]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*prefix, key))
        else:
            yield (*prefix, key), value
