"""Every error and warning of errors.toml can be made, and every code in the sources is defined there."""

import inspect
import re
import string
from pathlib import Path

import pytest

from edmctl import failures
from edmctl.errors import Diagnostic, EdmError, error_exit_code
from tools.generate.failures import Definition, definitions

PACKAGE = Path(failures.__file__).parent
DEFINITIONS = definitions()
MESSAGES = [each for each in DEFINITIONS if each.message]


@pytest.mark.parametrize("each", MESSAGES, ids=lambda each: each.name)
def test_every_message_can_be_made(each: Definition) -> None:
    function = getattr(failures, each.name)
    values = {
        name: {"float": 1.0, "int": 1}.get(parameter.annotation, f"<{name}>")
        for name, parameter in inspect.signature(function).parameters.items()
    }
    made = function(**values)
    parsed = string.Formatter().parse(each.message + each.hint)
    assert set(values) == {name for _, name, _, _ in parsed if name}
    assert made.code == each.code
    text = made.message + made.hint
    assert "{" not in text
    assert all(value in text for value in values.values() if isinstance(value, str))
    if each.code.startswith("W"):
        assert isinstance(made, Diagnostic)
        assert made.is_warning
    else:
        assert isinstance(made, EdmError)
        assert error_exit_code(made) == int(each.code[1])


def test_every_code_is_defined() -> None:
    defined = {each.code for each in DEFINITIONS}
    for path in [*PACKAGE.rglob("*.py"), PACKAGE / "link" / "faults.toml"]:
        used = set(re.findall(r"[\"']([EW]\d{4})[\"']", path.read_text(encoding="utf-8")))
        assert used <= defined, f"{path.relative_to(PACKAGE)}: {sorted(used - defined)}"


def test_every_definition_is_used() -> None:
    sources = [
        path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py") if path.name != "failures.py"
    ]
    names = set(re.findall(r"\b(?:failures|Code)\.(\w+)", "".join(sources)))
    assert {each.name for each in DEFINITIONS if each.name} <= names
