"""The command tree and the way from a command line to an exit code."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from functools import cache, partial
from importlib import import_module
from io import TextIOWrapper
from pathlib import Path
from typing import Annotated, Any, NoReturn, cast

import typer

from edmctl import failures
from edmctl.cli.outcome import Outcome, Output, finish, interrupted, mutter, stream_style, unwritable
from edmctl.cli.signals import SignalArrived, leave, raising_signals
from edmctl.errors import EdmError, ExitCode, UsageError, exit_code_table
from edmctl.version import __version__

_COMMANDS = {
    "calibrate": "cli.commands.calibrate:calibrate",
    "approach": "cli.commands.machine:approach",
    "machine": "cli.commands.machine:machine",
    "measure-wear": "cli.commands.machine:measure_wear",
    "measure-drift": "cli.commands.machine:measure_drift",
    "jump-flush": "cli.commands.machine:jump_flush",
    "reset": "cli.commands.doctor:reset",
    "doctor": "cli.commands.doctor:doctor",
    "first-start": "board.commands.first_start:first_start",
    "ports": "cli.commands.doctor:ports",
}
_GROUPS = {
    "simulate": "cli.commands.simulate:app",
    "firmware": "board.commands.firmware:app",
    "profile": "cli.commands.profile:app",
    "run": "cli.commands.run:app",
    "study": "study.commands:app",
}

# Some versions of typer carry click inside; this finds its base of all usage errors in either place.
_ClickError = cast("type[Exception]", typer.BadParameter.__mro__[2])


def edmctl(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    """Controller for a micro-EDM machine with a piezo-driven tool."""
    if version:
        sys.stdout.write(f"edmctl {__version__}\n")
        raise typer.Exit
    if context.invoked_subcommand is None:
        mutter(context.get_help() + "\n")
        raise typer.Exit(ExitCode.USAGE)


def run() -> NoReturn:
    """Run the command line of this process and exit."""
    _prepare_streams(sys.argv[1:])
    try:
        with raising_signals():
            leave(_run(sys.argv[1:]))
    except SignalArrived as arrived:
        leave(128 + arrived.signal_number)


def main(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code; for callers that go on afterwards."""
    with raising_signals():
        return _run(arguments)


def _run(arguments: Sequence[str]) -> int:
    output = Output(
        command=_command_of(arguments), json="--json" in arguments, events="--events" in arguments
    )
    try:
        code = command_tree(arguments[0] if arguments else "").main(
            args=list(arguments), prog_name="edmctl", standalone_mode=False
        )
        sys.stdout.flush()
    except _ClickError as mistake:
        return finish(Outcome(output), _usage_error(mistake, arguments))
    except EdmError as refused:  # while options were read
        return finish(Outcome(output), refused)
    except SignalArrived as arrived:
        return finish(Outcome(output), interrupted(arrived.signal_number))
    except BrokenPipeError:
        return int(ExitCode.DONE)
    except OSError as refused:
        return finish(Outcome(output), unwritable(refused))
    except SystemExit as left:
        return left.code if isinstance(left.code, int) else 0
    return int(code or 0)


@cache
def command_tree(name: str = "") -> Any:
    """Return the command tree as its library runs it, made once for callers that go on afterwards.

    If `name` is that of a command or group, only this one is imported and in the tree, else all are.
    Lists of commands show the first paragraph of each command's help in full; the library would cut it off.
    """
    app = typer.Typer(
        name="edmctl",
        epilog="\b\nExit codes:\n" + exit_code_table(),
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback(invoke_without_command=True)(edmctl)
    is_one = name in _COMMANDS or name in _GROUPS
    for known, place in _COMMANDS.items():
        if not is_one or name == known:
            app.command(known)(_imported(place))
    for known, place in _GROUPS.items():
        if not is_one or name == known:
            app.add_typer(_imported(place), name=known)
    tree = typer.main.get_command(app)
    _describe(tree)
    return tree


def _imported(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(f"edmctl.{module}"), name)


def _describe(command: Any) -> None:
    first = (command.help or "").partition("\n\n")[0]
    command.short_help = " ".join(first.split())
    command.format_help = partial(_write_help, command)
    for inner in getattr(command, "commands", {}).values():
        _describe(inner)


def _write_help(command: Any, context: typer.Context, formatter: Any) -> None:
    from edmctl.cli.render.help import render_help

    formatter.write(render_help(command, context, stream_style(sys.stdout)) + "\n")


def _prepare_streams(arguments: Sequence[str]) -> None:
    """Streams that were closed go nowhere, and no locale gets in the way: JSON is UTF-8 everywhere."""
    if sys.stdout is None:
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    for stream, is_json in ((sys.stdout, "--json" in arguments), (sys.stderr, "--events" in arguments)):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(encoding="utf-8" if is_json else None, errors="replace")


def _usage_error(mistake: Exception, arguments: Sequence[str]) -> UsageError:
    context = getattr(mistake, "ctx", None)
    path = context.command_path if context else f"edmctl {_command_of(arguments)}".rstrip()
    message = mistake.format_message()  # type: ignore[attr-defined]
    end = "" if message.endswith((".", "?")) else "."
    hint = _meant(message, path, arguments) or f"`{path} --help` lists what there is."
    return failures.command_line_wrong(message=message, end=end, remedy=hint)


def _meant(message: str, path: str, arguments: Sequence[str]) -> str:
    """Return the command that was probably meant: a profile without its option, a subcommand without its group."""
    stray = re.search(r"unexpected extra argument(?:\(s\))? \((.+)\)", message)
    if stray is not None and "--profile" in arguments:
        return "--set and --sweep take one KEY=VALUE each, without blanks."
    if stray is not None and any("--profile" in parameter.opts for parameter in _parameters(path)):
        return f"A profile is named with an option: `{path} --profile {stray[1].split()[0]}`."
    unknown = re.search(r"No such command '(.+)'", message)
    groups = [
        f"`edmctl {name} {unknown[1]}`"
        for name, group in command_tree().commands.items()
        if unknown is not None and path == "edmctl" and unknown[1] in getattr(group, "commands", {})
    ]
    return f"Did you mean {' or '.join(groups)}?" if groups else ""


def _parameters(path: str) -> list[Any]:
    """The parameters of a command that is no group's."""
    command = command_tree()
    for word in path.split()[1:]:
        command = getattr(command, "commands", {}).get(word, command)
    return list(command.params)


def _command_of(arguments: Sequence[str]) -> str:
    """The words before the first option: `profile check`, `simulate actuator`."""
    words: list[str] = []
    for argument in arguments[:2]:
        if argument.startswith("-") or (words and words[0] not in _GROUPS):
            break
        words.append(argument)
    return " ".join(words)
