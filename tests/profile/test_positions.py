"""Positions of keys and values, against tomllib."""

from __future__ import annotations

import json
import tomllib
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from edmctl.profile.read import location, scan
from edmctl.profile.tables import KeyPath

bare = st.text("abcXYZ019_-", min_size=1, max_size=6)
odd = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=6)
plain_text = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cs", "Cc"), exclude_characters="'"), max_size=8
)
space = st.sampled_from(["", " ", "  ", "\t"])
gap = st.sampled_from(["", " ", "\n", ' # [x] = "{\n', "\r\n  ", "\n\n"])


@st.composite
def key_texts(draw: st.DrawFn) -> str:
    name = draw(bare | odd)
    quoted = json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")
    return name if name and all(c in "abcXYZ019_-" for c in name) and draw(st.booleans()) else quoted


scalar_texts = st.one_of(
    st.integers(-(10**6), 10**6).map(str),
    st.floats(-1e6, 1e6).map(lambda x: repr(x) if "." in repr(x) or "e" in repr(x) else f"{x!r}.0"),
    st.sampled_from(["true", "false", "inf", "-nan", "0x1F", "1_000", "1979-05-27 07:32:00Z", "07:32:00"]),
    plain_text.map(lambda s: json.dumps(s, ensure_ascii=False).replace("\x7f", "\\u007f")),
    plain_text.map(lambda s: "'" + s.replace("\x7f", "") + "'"),
    st.sampled_from(
        ['"""a\n"b" \\" c"""', "'''x\n'y'\n'''", '"""ends in quotes"""""', '"a # \\" = ["', '""']
    ),
)


@st.composite
def arrays(draw: st.DrawFn, inner: st.SearchStrategy[str]) -> str:
    items = draw(st.lists(inner, max_size=3))
    body = "".join(f"{draw(gap)}{item}{draw(gap)}," for item in items)
    return f"[{body if draw(st.booleans()) else body[:-1]}{draw(gap)}]"


@st.composite
def inline_tables(draw: st.DrawFn, inner: st.SearchStrategy[str]) -> str:
    keys = draw(st.lists(key_texts(), max_size=3))
    pairs = (f"{draw(space)}{key}{draw(space)}={draw(space)}{draw(inner)}{draw(space)}" for key in keys)
    return f"{{{','.join(pairs)}}}"


value_texts = st.recursive(scalar_texts, lambda inner: arrays(inner) | inline_tables(inner), max_leaves=6)


@st.composite
def documents(draw: st.DrawFn) -> str:
    lines = []
    end = draw(st.sampled_from(["\n", "\r\n"]))
    for _ in range(draw(st.integers(0, 8))):
        key = f"{draw(space)}.{draw(space)}".join(draw(st.lists(key_texts(), min_size=1, max_size=3)))
        form = draw(st.sampled_from(["pair", "pair", "pair", "table", "array"]))
        if form == "pair":
            line = f"{draw(space)}{key}{draw(space)}={draw(space)}{draw(value_texts)}"
        else:
            opening, closing = ("[", "]") if form == "table" else ("[[", "]]")
            line = f"{draw(space)}{opening}{draw(space)}{key}{draw(space)}{closing}"
        lines.append(line + draw(st.sampled_from(["", " ", " # comment = 1 [", "\t"])))
    return end.join(lines)


def leaves(value: Any, path: KeyPath = ()) -> list[tuple[KeyPath, Any]]:
    if isinstance(value, dict) and value:
        return [leaf for key, item in value.items() for leaf in leaves(item, (*path, key))]
    if isinstance(value, list) and value:
        return [leaf for i, item in enumerate(value) for leaf in leaves(item, (*path, i))]
    return [(path, value)]


def check(text: str) -> int:
    """Every leaf's spans hold that leaf, read by tomllib; returns how many there were."""
    data = tomllib.loads(text)
    entries = scan(text)
    found = leaves(data) if data else []
    for path, value in found:
        entry = entries[path]
        if value == {} and entry.key == entry.value:
            continue
        held = text[slice(*entry.value)]
        assert repr(tomllib.loads(f"v = {held}")["v"]) == repr(value)
        if isinstance(path[-1], str):
            key = text[slice(*entry.key)]
            assert list(tomllib.loads(f"{key} = 0")) == [path[-1]]
    return len(found)


@settings(max_examples=60, deadline=None)
@given(documents())
def test_every_key_and_value_is_where_tomllib_read_it(text: str) -> None:
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    check(text)


def test_all_forms_of_keys_and_values_in_one_document() -> None:
    text = (
        'top = 1 # a = 2\r\n"quoted key".b . \'c\' = [1, {x = "]"}, [\r\n 2, # ]\r\n]]\r\n'
        '[a.b]\nc.d = """\nx = 1\n"""\n[[rows]]\nx=1\n[[rows]]\nx=2\n[rows.sub]\ny = {z = {w = 1979-05-27}}\n'
    )
    assert check(text) == 8
    entries = scan(text)
    x = entries["rows", 1, "x"].value
    assert location("f", text, x).line == 12
    assert location("f", text, x).column == 3
    y = entries["rows", 1, "sub", "y", "z", "w"].value
    assert text[slice(*y)] == "1979-05-27"


def test_a_location_carries_its_line_without_the_line_end() -> None:
    text = 'a = 1\r\n  b = """x\r\ny"""\r\n'
    where = location("f.toml", text, scan(text)["b",].value)
    assert (where.line, where.column, where.length, where.source_line) == (2, 7, 4, '  b = """x')


def test_a_header_is_the_place_of_its_table() -> None:
    text = "\n[ servo . inner ]\nx = 1\n"
    where = location("f", text, scan(text)["servo", "inner"].value)
    assert (where.line, where.column, where.length) == (2, 3, 13)
