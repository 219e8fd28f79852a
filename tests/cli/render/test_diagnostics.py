"""Carets stand under what is wrong."""

from __future__ import annotations

import re

import pytest

from edmctl.cli.render.diagnostics import render_diagnostics
from edmctl.cli.render.terminal import Style
from edmctl.errors import Diagnostic, Location

ERROR = Diagnostic(
    "E3004",
    "servo.reference: 0.42 is below 0.60",
    "take 0.60 to 0.95",
    Location("profiles/cu270.toml", 14, 13, 4, "reference = 0.42"),
)
SHOWN = (
    "error[E3004]: servo.reference: 0.42 is below 0.60\n"
    "  --> profiles/cu270.toml:14:13\n"
    "14 | reference = 0.42\n"
    "   |             ^^^^\n"
    "   = help: take 0.60 to 0.95"
)


def test_an_error_shows_place_line_caret_and_help_and_colour_is_only_paint() -> None:
    assert render_diagnostics([ERROR]) == SHOWN
    painted = render_diagnostics([ERROR], Style(colour=True, live=False))
    assert "\x1b[1;31merror[E3004]\x1b[0m" in painted
    assert re.sub(r"\x1b\[[0-9;]*m", "", painted) == SHOWN


def test_every_problem_is_shown_in_order_and_counted() -> None:
    warning = Diagnostic("W3001", "the jump is low", "raise it", is_warning=True)
    text = render_diagnostics([ERROR, ERROR, warning])
    end = "\n\nwarning[W3001]: the jump is low\n  = help: raise it\n\n2 errors, 1 warning"
    assert text == f"{SHOWN}\n\n{SHOWN}{end}"


@pytest.mark.parametrize(
    ("where", "end"),
    [
        pytest.param(
            Location("a.toml", 3, 3, 4, "\t\t0.42 # x"), "|             ^^^^", id="the caret follows tabs"
        ),
        pytest.param(Location("a.toml", 1, 5, 40, "a = 1"), "|     ^", id="it ends with the line"),
        pytest.param(Location("a.toml", 1, 9, 1, "a = ["), "|         ^", id="past the end there is one"),
    ],
)
def test_the_caret_is_under_the_place(where: Location, end: str) -> None:
    assert render_diagnostics([Diagnostic("E1", "m", "", where)]).endswith(end)


@pytest.mark.parametrize("columns", [40, 80, 120])
@pytest.mark.parametrize("column", [1, 60, 109])
def test_on_a_narrow_terminal_words_are_wrapped_and_the_caret_is_in_sight(columns: int, column: int) -> None:
    line = "".join(f"{number:3}" for number in range(37))
    fix = "`edmctl profile check folder/of/a/profile.toml`"
    error = Diagnostic("E3004", "a message " * 12, f"try {fix}", Location("a.toml", 7, column, 3, line))
    lines = render_diagnostics([error], Style(colour=False, live=True, columns=columns)).splitlines()
    assert all(len(text) <= columns for text in lines if fix not in text)
    (caret,) = (number for number, text in enumerate(lines) if "^" in text)
    at = lines[caret].index("^")
    assert lines[caret - 1][at : at + 3] == line[column - 1 : column + 2]
    assert fix in "\n".join(lines)


def test_control_characters_do_not_reach_the_terminal() -> None:
    where = Location("a\x1b[2J.toml", 1, 1, 1, "a\x1b = 1")
    text = render_diagnostics([Diagnostic("E1", "no a\x1b[2Jb\rc\nerror[E2]: d", "say \x07", where)])
    assert text.splitlines() == [
        r"error[E1]: no a\x1b[2Jb\rc",
        "  error[E2]: d",
        r" --> a\x1b[2J.toml:1:1",
        "1 | a? = 1",
        "  | ^",
        r"  = help: say \x07",
    ]
