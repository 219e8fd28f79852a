"""Break every key of every shipped profile in many ways: the diagnostic must point at the very place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from edmctl.failures import Code
from tests.planning.rules.documents import (
    NAMES,
    NEWER,
    WrittenKey,
    copy_shipped,
    problems,
    shipped_text,
    with_line,
    written_keys,
)
from tests.tiers import tiers

TYPE_CODES = {Code.WRONG_TYPE, Code.NOT_A_CHOICE, Code.SCHEMA_VERSION, Code.EXTENDS}
RANGE_CODES = {Code.OUT_OF_RANGE, Code.NOT_A_CHOICE, Code.SCHEMA_VERSION}
OPTIONAL_TEXT = {"description"}


@dataclass(frozen=True, slots=True)
class Mutant:
    """A changed text, and where the change must be found: any of `codes` at line and column, on `found`."""

    label: str
    text: str
    line: int
    column: int
    found: str
    codes: frozenset[str]


def rewritten(text: str, at: WrittenKey, key: str, value: str) -> str:
    line = text.split("\n")[at.line - 1]
    rest = line[at.value_column - 1 + len(at.value) :]
    between = line[len(at.key) : at.value_column - 1]
    return with_line(text, at.line, f"{key}{between}{value}{rest}")


def misspellings(key: str) -> Iterator[str]:
    yield f"{key}_"
    yield f"{key[:-2]}{key[-1]}{key[-2]}" if key[-1] != key[-2] else f"{key}s"
    yield key.upper()


def wrong_types(value: str) -> Iterator[str]:
    yield from ("[1]", "{x = 1}", "1979-05-27")
    yield '"abc"' if value[0] not in '"' and value not in ("true", "false") else "17.5"
    if value not in ("true", "false"):
        yield "true"


def wrong_values(at: WrittenKey) -> Iterator[str]:
    if at.value.startswith('"'):
        if at.key not in OPTIONAL_TEXT and at.key != "extends":
            yield '""'
    elif at.value not in ("true", "false"):
        yield from ("-1e9", "1e9", "nan", "-inf") if "." in at.value else ("-1000000", "1000000")


def value_mutants(text: str, at: WrittenKey) -> Iterator[Mutant]:
    for values, codes in ((wrong_types(at.value), TYPE_CODES), (wrong_values(at), RANGE_CODES)):
        for value in values:
            changed = rewritten(text, at, at.key, value)
            label = f"{at.table}.{at.key} = {value}"
            yield Mutant(label, changed, at.line, at.value_column, value, frozenset(codes))


def key_mutants(text: str, at: WrittenKey) -> Iterator[Mutant]:
    for key in misspellings(at.key):
        changed = rewritten(text, at, key, at.value)
        yield Mutant(f"{at.table}.{key}", changed, at.line, 1, key, frozenset({Code.UNKNOWN_KEY}))


def table_mutants(text: str) -> Iterator[Mutant]:
    for number, line in enumerate(text.split("\n"), 1):
        if line.startswith("["):
            name = line.strip("[]")
            changed = with_line(text, number, line.replace(name, f"{name}x"))
            column = line.index(name) + 1
            yield Mutant(line, changed, number, column, f"{name}x", frozenset({Code.UNKNOWN_KEY}))


def mutants(name: str) -> Iterator[Mutant]:
    text = shipped_text(name)
    for at in written_keys(text):
        yield from key_mutants(text, at)
        yield from value_mutants(text, at)
    yield from table_mutants(text)


def complaint(mutant: Mutant, written: Path, loaded: Path) -> str | None:
    """What is wrong with the report of a mutant, or nothing."""
    written.write_text(mutant.text, encoding="utf-8")
    source_line = mutant.text.split("\n")[mutant.line - 1]
    for d in problems(loaded):
        w = d.where
        if w is None or (w.file, w.line, w.column) != (str(written), mutant.line, mutant.column):
            continue
        if d.code in mutant.codes and w.source_line == source_line and d.hint:
            pointed = source_line[w.column - 1 : w.column - 1 + w.length]
            return None if pointed == mutant.found else f"{mutant.label}: caret under {pointed!r}"
    return f"{mutant.label}: {[(d.code, d.message, d.where) for d in problems(loaded)]}"


REST = {*NAMES, *NEWER} - {"w252", "channel-circle", "cu270", "array-3x3"}


@pytest.mark.parametrize(
    "name", tiers("w252", "channel-circle", slow=("cu270", "array-3x3"), full=sorted(REST))
)
def test_every_broken_key_and_value_is_pointed_at(name: str, tmp_path: Path) -> None:
    copy_shipped(tmp_path)
    path = tmp_path / f"{name}.toml"
    wrong = [c for mutant in mutants(name) if (c := complaint(mutant, path, path))]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("name", ["cu150", "w252"])
def test_a_broken_inherited_value_is_pointed_at_in_the_parent(name: str, tmp_path: Path) -> None:
    copy_shipped(tmp_path)
    own = {(at.table, at.key) for at in written_keys(shipped_text(name))}
    text = shipped_text("cu270")
    inherited = [at for at in written_keys(text) if (at.table, at.key) not in own]
    assert len(inherited) > 35
    for at in inherited:
        mutant = next(value_mutants(text, at))
        assert complaint(mutant, tmp_path / "cu270.toml", tmp_path / f"{name}.toml") is None


REQUIRED = {
    ("meta", "name"),
    ("tool", "material"),
    ("tool", "diameter_um"),
    ("work", "material"),
    ("work", "thickness_um"),
    ("pulse", "frequency_hz"),
    ("pulse", "duty"),
    ("pulse", "open_voltage_v"),
    ("pulse", "current_a"),
    ("servo", "reference"),
    ("target", "kind"),
    ("target", "depth_um"),
}


def test_a_removed_key_is_asked_for_at_its_table_or_has_a_default(tmp_path: Path) -> None:
    text, path = shipped_text("cu270"), tmp_path / "p.toml"
    headers = {line[1:-1]: n for n, line in enumerate(text.split("\n"), 1) if line.startswith("[")}
    for at in written_keys(text):
        path.write_text(with_line(text, at.line, ""), encoding="utf-8")
        found = problems(path)
        if (at.table, at.key) not in REQUIRED:
            assert found == (), f"{at.table}.{at.key}"
            continue
        first = found[0]
        assert first.code in (Code.MISSING_KEY, Code.REFERENCE_ONCE)
        assert f"{at.table}.{at.key} is missing" in first.message
        assert at.key in first.hint
        assert first.where is not None
        assert (first.where.line, first.where.column) == (headers[at.table], 2)
        assert first.where.source_line == f"[{at.table}]"


def test_a_removed_table_is_asked_for_at_the_start_or_has_defaults(tmp_path: Path) -> None:
    text, path = shipped_text("cu270"), tmp_path / "p.toml"
    keys = written_keys(text)
    for table in dict.fromkeys(at.table for at in keys):
        gone = {at.line for at in keys if at.table == table}
        lines = [
            "" if number in gone or line == f"[{table}]" else line
            for number, line in enumerate(text.split("\n"), 1)
        ]
        path.write_text("\n".join(lines), encoding="utf-8")
        found = problems(path)
        if any(name == table for name, _ in REQUIRED):
            assert [(d.code, d.hint) for d in found] == [(Code.MISSING_KEY, f"add the table [{table}]")]
            assert found[0].where is not None
            assert (found[0].where.line, found[0].where.column) == (1, 1)
        else:
            assert found == ()
