"""Who gets colour, and who gets a picture that redraws."""

from __future__ import annotations

import io

import pytest

from edmctl.console.style import PLAIN, Ink, Style, style_of


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
    assert style_of(stream, environ) == expected


def test_paint_leaves_plain_text_alone() -> None:
    assert PLAIN.paint("gap", Ink.ERROR) == "gap"
    assert Style(colour=True, live=False).paint("gap", Ink.ERROR) == "\x1b[1;31mgap\x1b[0m"
