"""Source of edmctl/failures.py and the tables of docs/exit-codes.md, both made from edmctl/errors.toml."""

from __future__ import annotations

import string
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from edmctl.errors import MEANING, ExitCode
from tools.generate.text import quoted, table

_ERRORS = Path(__file__).parents[2] / "edmctl" / "errors.toml"
_CLASSES = {
    "E2": "UsageError",
    "E3": "RecordError",
    "E4": "LinkLost",
    "E5": "ProtocolMismatch",
    "E6": "MachineFault",
    "E7": "ObjectiveNotReached",
    "E8": "PreconditionError",
    "E9": "RunFileError",
}
_GIVEN = {"message": "{problem}", "hint": "{remedy}"}
"""What a message or remedy is that errors.toml leaves to the caller."""
_KINDS = dict.fromkeys("efg%", "float") | dict.fromkeys("dX", "int")
_HEAD = '''\
"""Errors and warnings, one function each, which returns it with its code, message and remedy.

Made from errors.toml by `python -m tools.generate`; edit that file.
"""

from __future__ import annotations

from enum import StrEnum

from edmctl.errors import Diagnostic, {classes}
'''


@dataclass(frozen=True)
class Definition:
    """A message of a code. A code whose messages are composed elsewhere has `about` instead."""

    code: str
    name: str
    message: str = ""
    hint: str = ""
    about: str = ""


def definitions() -> list[Definition]:
    """Return all of errors.toml, by their codes."""
    content = tomllib.loads(_ERRORS.read_text(encoding="utf-8"))
    rules, abouts = content.pop("rules"), content.pop("about")
    found = [Definition(code, rule["name"], about=rule["about"]) for code, rule in rules.items()]
    found += [Definition(code, "", about=about) for code, about in abouts.items()]
    found += [
        Definition(code, name, **(_GIVEN | each))
        for code, named in content.items()
        for name, each in named.items()
    ]
    return sorted(found, key=lambda each: each.code)


def failures_source() -> str:
    """Return the source of edmctl/failures.py. ValueError where two messages have one name."""
    all_of_them = definitions()
    messages = [each for each in all_of_them if not each.about]
    names = [each.name for each in messages]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ValueError(f"errors.toml has two messages called {', '.join(sorted(twice))}")
    classes = sorted({_class(each) for each in messages} - {"Diagnostic"})
    rules = "".join(f'    {each.name} = "{each.code}"\n' for each in all_of_them if each.about and each.name)
    return (
        _HEAD.format(classes=", ".join(classes))
        + f'\nclass Code(StrEnum):\n    """A rule that a profile, setup or study violates."""\n\n{rules}\n'
        + "\n".join(map(_function, messages))
    )


def _class(each: Definition) -> str:
    return "Diagnostic" if each.code.startswith("W") else _CLASSES[each.code[:2]]


def slots(each: Definition) -> dict[str, str]:
    """Return the type of every value that message and remedy take, by name."""
    found: dict[str, str] = {}
    for text in (each.message, each.hint):
        for _, name, spec, _ in string.Formatter().parse(text):
            if name is not None:
                kind = _KINDS.get(spec[-1:] if spec else "", "object")
                found[name] = kind if kind != "object" else found.get(name, kind)
    return found


def _function(each: Definition) -> str:
    parameters = [f"{name}: {kind}" for name, kind in slots(each).items()]
    kind = _class(each)
    returned = f"{_text(each.message)}, hint={_text(each.hint)}, code={quoted(each.code)}"
    if kind == "Diagnostic":
        returned = f"{quoted(each.code)}, {_text(each.message)}, {_text(each.hint)}, is_warning=True"
    signature = f"*, {', '.join(parameters)}" if parameters else ""
    return f"def {each.name}({signature}) -> {kind}:\n    return {kind}({returned})\n"


def _text(template: str) -> str:
    """Return a template as Python source: an f-string where it takes values."""
    if any(name is not None for _, name, _, _ in string.Formatter().parse(template)):
        return "f" + quoted(template)
    return quoted(template.replace("{{", "{").replace("}}", "}"))


def page_tables() -> dict[str, str]:
    """Return the parts of docs/exit-codes.md."""
    codes = table(("code", "meaning"), [(int(code), meaning) for code, meaning in MEANING.items()])
    return {"exit_codes": codes, "error_codes": "\n".join(_sections())}


def _sections() -> Iterator[str]:
    found = definitions()
    for digit in map(str, range(1, 10)):
        rows = [
            (each.code, _cell(each.about or each.message), _cell(each.hint))
            for each in found
            if each.code[1] == digit
        ]
        if rows:
            yield f"### {digit}: {MEANING[ExitCode(int(digit))]}\n\n" + table(
                ("code", "message", "remedy"), rows
            )


def _cell(template: str) -> str:
    """Return a template as a table cell: values as {name}, without their format."""
    parts = []
    for text, name, _, _ in string.Formatter().parse(template):
        parts.append(text + (f"{{{name}}}" if name is not None else ""))
    return "".join(parts).replace("|", "\\|").replace("\n", " ")
