"""Who gets colour, and who gets a picture that redraws."""

from __future__ import annotations

import io
import os
from dataclasses import replace

import pytest

from edmctl.cli.render.terminal import PLAIN, Ink, Style, fitted, style_of


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("stream", "environ", "expected"),
    [
        (Terminal(), {"TERM": "xterm"}, Style(colour=True, live=True)),
        (Terminal(), {"TERM": "xterm", "NO_COLOR": "1"}, Style(colour=False, live=True)),
        (Terminal(), {"TERM": "xterm", "NO_COLOR": ""}, Style(colour=True, live=True)),
        (Terminal(), {"TERM": "dumb"}, Style(colour=False, live=False)),
        (io.StringIO(), {"TERM": "xterm"}, Style(colour=False, live=False)),
        (io.StringIO(), {"FORCE_COLOR": "1"}, Style(colour=True, live=False)),
        (io.StringIO(), {"FORCE_COLOR": "1", "NO_COLOR": "1"}, Style(colour=False, live=False)),
    ],
)
def test_stream_and_environment_decide(stream: io.StringIO, environ: dict[str, str], expected: Style) -> None:
    assert replace(style_of(stream, {**environ, "LANG": "de_DE.UTF-8"}), columns=None) == expected


def test_a_terminal_has_a_width_and_a_file_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "61")
    assert style_of(Terminal(), {}).columns == 61
    assert style_of(io.StringIO(), {}).columns is None


@pytest.mark.skipif(os.name == "nt", reason="the locale decides on POSIX")
@pytest.mark.parametrize(
    ("encoding", "environ", "expected"),
    [
        ("utf-8", {"LANG": "en_US.UTF-8"}, True),
        ("utf-8", {"LANG": "C.UTF-8"}, True),
        ("utf-8", {"LC_ALL": "en_US.UTF-8", "LANG": "C"}, True),
        ("utf-8", {"LC_CTYPE": "en_US.UTF-8", "LANG": "C"}, True),
        ("utf-8", {"LANG": "C"}, False),
        ("utf-8", {"LC_ALL": "POSIX", "LANG": "en_US.UTF-8"}, False),
        ("utf-8", {}, False),
        # Python adds LC_CTYPE itself in the C locale.
        ("utf-8", {"LANG": "C", "LC_CTYPE": "C.UTF-8"}, False),
        ("utf-8", {"LANG": "C", "PYTHONUTF8": "1"}, True),
        ("iso8859-1", {"LANG": "de_DE"}, False),
        ("ascii", {"LANG": "en_US.UTF-8"}, False),
    ],
)
def test_who_gets_more_than_ascii(encoding: str, environ: dict[str, str], expected: bool) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    assert style_of(stream, environ).unicode is expected


def test_paint_leaves_plain_text_alone() -> None:
    assert PLAIN.paint("gap", Ink.ERROR) == "gap"
    assert Style(colour=True, live=False).paint("gap", Ink.ERROR) == "\x1b[1;31mgap\x1b[0m"


def test_long_lines_are_wrapped_behind_their_label_and_tables_are_not() -> None:
    table = "\x1b[1mcoloured table that is wider than this\x1b[0m"
    text = f"displacement  ± 0.02 µm on average and at most ± 0.1 µm\nshort\n{table}"
    assert fitted(text, None) == text
    assert fitted(text, 34).split("\n") == [
        "displacement  ± 0.02 µm on average",
        "              and at most ± 0.1 µm",
        "short",
        table,
    ]
