"""The command tree and the way from a command line to an exit code."""

from __future__ import annotations

import os
import sys
from io import TextIOWrapper
from typing import TYPE_CHECKING, Annotated, cast

import typer

from edmctl.cli import machine, profile, simulate
from edmctl.cli.exitcodes import ExitCode, exit_code_table
from edmctl.cli.outcome import Outcome, Output, finish
from edmctl.cli.signals import SignalArrived, raising_signals
from edmctl.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

app = typer.Typer(
    name="edmctl",
    epilog="\b\nExit codes:\n" + exit_code_table(),
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("machine")(machine.machine)
app.command("simulate")(simulate.simulate)
app.add_typer(profile.app, name="profile")


# Some versions of typer carry click inside; this finds its base of all usage errors in either place.
_ClickError = cast("type[Exception]", typer.BadParameter.__mro__[2])


@app.callback(invoke_without_command=True)
def edmctl(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Say the version and exit.")] = False,
) -> None:
    """Controller for a micro-EDM machine with a piezo-driven tool."""
    if version:
        from edmctl import __version__

        sys.stdout.write(f"edmctl {__version__}\n")
        raise typer.Exit
    if context.invoked_subcommand is None:
        sys.stderr.write(context.get_help() + "\n")
        raise typer.Exit(ExitCode.USAGE)


def run() -> None:
    """Run the command line of this process and exit."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")
    exit_code = main(sys.argv[1:])
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        # What is still buffered for a reader that has gone must not fail at interpreter exit.
        os._exit(exit_code)
    sys.exit(exit_code)


def main(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code."""
    output = Output(
        command=_command_of(arguments), json="--json" in arguments, events="--events" in arguments
    )
    try:
        with raising_signals():
            code = typer.main.get_command(app).main(
                args=list(arguments), prog_name="edmctl", standalone_mode=False
            )
    except _ClickError as mistake:
        return finish(Outcome(output), _usage_error(mistake, output.command))
    except SignalArrived as arrived:
        return 128 + arrived.signal_number
    return int(code or 0)


def _usage_error(mistake: Exception, command: str) -> UsageError:
    context = getattr(mistake, "ctx", None)
    path = context.command_path if context else f"edmctl {command}".rstrip()
    message = mistake.format_message().rstrip(".")  # type: ignore[attr-defined]
    return UsageError(f"{message}.", hint=f"`{path} --help` lists what there is.")


def _command_of(arguments: Sequence[str]) -> str:
    """The words before the first option: `profile check`."""
    words: list[str] = []
    for argument in arguments[:2]:
        if argument.startswith("-") or (words and words[0] != "profile"):
            break
        words.append(argument)
    return " ".join(words)
