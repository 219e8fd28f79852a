"""An option that takes one value and stands there twice: one of the two would be lost without a word."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from edmctl.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence


def refuse_repeated(root: Any, arguments: Sequence[str]) -> None:
    """Raise UsageError E2007 where an option of one value is given more than once to a command of `root`."""
    command, options, given = root, _single(root), dict[str, str]()
    words = iter(arguments)
    for word in words:
        if word == "--":
            return
        name, equals, value = word.partition("=")
        if name in options:
            name, value = options[name], value if equals else next(words, "")
            if name in given:
                raise UsageError(
                    f"{name} is given twice: {given[name]} and {value}.",
                    hint="It takes one value: leave one of them out.",
                    code="E2007",
                )
            given[name] = value
        elif not word.startswith("-") and word in getattr(command, "commands", {}):
            command, given = command.commands[word], {}
            options = _single(command)


def _single(command: Any) -> dict[str, str]:
    """The spellings of every option that takes one value and no more, and its first name."""
    return {
        spelling: parameter.opts[0]
        for parameter in command.params
        if parameter.param_type_name == "option" and not (parameter.is_flag or parameter.multiple)
        for spelling in (*parameter.opts, *parameter.secondary_opts)
    }
