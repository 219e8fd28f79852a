"""One command from start to exit code: whatever happens ends as a result, a message or both."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from edmctl import failures
from edmctl.cli.render.diagnostics import render_diagnostics
from edmctl.cli.render.progress import EventReporter, LineReporter, Reporter
from edmctl.cli.render.terminal import Style, fitted, style_of
from edmctl.cli.signals import SignalArrived, ignore_signals, signal_name
from edmctl.dataclasses import dataclass, field
from edmctl.errors import (
    Diagnostic,
    EdmError,
    ExitCode,
    Interrupted,
    MachineFault,
    ProfileError,
    RunFileError,
    error_exit_code,
)
from edmctl.jsonout import SCHEMA, render_json, render_json_line
from edmctl.start_up import refuse_wrong_clock

if TYPE_CHECKING:
    from edmctl.jobs.output_files import Sink

_watching: list[Reporter] = []
"""Who is writing to stderr at present."""


@dataclass(frozen=True, slots=True)
class Output:
    """How one invocation speaks."""

    command: str
    json: bool = False
    events: bool = False
    quiet: bool = False
    debug: bool = False


@dataclass(slots=True)
class Outcome:
    """What a command has reached so far; a failure reports as much of it as there is.

    `result` is the `result` of the JSON object; `views` and then `text` are the same for people. `files` has the
    paths of the files in use: profile, study.
    """

    output: Output
    simulated: bool | None = None
    seed: int | None = None
    run_file: Path | None = None
    files: dict[str, str] = field(default_factory=dict)
    warnings: list[Diagnostic] = field(default_factory=list)
    result: object = None
    views: list[str | Callable[[Style], str]] = field(default_factory=list)
    text: str = ""

    def show(self, view: str | Callable[[Style], str]) -> None:
        """Add a paragraph or table for people; a function is called only if they see the result."""
        self.views.append(view)

    def rendered(self) -> str:
        """Return the result for people, as stdout shows it."""
        style = stream_style(sys.stdout)
        shown = [view if isinstance(view, str) else view(style) for view in self.views]
        return "\n".join(filter(None, [*shown, self.text]))

    def uses(self, **files: Path | None) -> None:
        """Report on stderr which files the command uses, and keep their absolute paths for the JSON object."""
        from edmctl.profile.folders import file_in_words

        for what, path in files.items():
            if path is None:
                continue
            self.files[what] = str(path.absolute())
            note(self.output, f"{what}: {file_in_words(path)}")

    def warn(self, warnings: Iterable[Diagnostic]) -> None:
        """Say warnings at once, and keep them for the JSON object."""
        new = list(warnings)
        if new:
            self.warnings += new
            say(self.output, new)


def run_command(output: Output, body: Callable[[Outcome], None]) -> int:
    """Run `body`, write its result to stdout and stderr, and return the exit code."""
    outcome = Outcome(output)
    error: EdmError | None = None
    try:
        refuse_wrong_clock()
        body(outcome)
    except EdmError as expected:
        error = expected
    except SignalArrived as arrived:
        error = interrupted(arrived.signal_number)
    except Exception as bug:
        error = internal_error(bug)
    return finish(outcome, error)


def finish(outcome: Outcome, error: EdmError | None) -> int:
    """Write the result to stdout, the error (last, where people look) to stderr; return the exit code."""
    # The result is complete: a signal from now on could only cut it off.
    ignore_signals()
    exit_code = error_exit_code(error) if error else int(ExitCode.DONE)
    try:
        if outcome.output.json:
            document = _document(exit_code, outcome, error)
            # A file of results has one a line; a person reads indented ones.
            text = render_json(document) if sys.stdout.isatty() else render_json_line(document)
        else:
            text = fitted(outcome.rendered(), stream_style(sys.stdout).columns)
            text += "\n" if text else ""
        write(sys.stdout, text)
    except OSError as refused:
        lost = unwritable(refused)
        if error is None:
            error, exit_code = lost, error_exit_code(lost)
        elif not isinstance(error, Interrupted):
            # The reason why the job ended is more important than the lost result, and a signal than both.
            complain(outcome.output, lost)
    if error:
        complain(outcome.output, error)
    return exit_code


def interrupted(signal_number: int) -> Interrupted:
    """Return the error of a signal that came while no machine was connected."""
    return Interrupted(f"Stopped by {signal_name(signal_number)}.", signal_number=signal_number)


def unwritable(refused: OSError) -> RunFileError:
    """Return the error of a stdout that takes no result."""
    return failures.result_not_written(reason=refused.strerror)


def internal_error(bug: Exception) -> EdmError:
    """Return the error that stands for a bug; its cause keeps the traceback."""
    error = EdmError(
        f"Internal error: {type(bug).__name__}: {bug}",
        hint="This is a bug of edmctl. --debug shows the traceback.",
    )
    error.__cause__ = bug
    return error


def complain(output: Output, error: EdmError) -> None:
    """Write an error to stderr: every diagnostic of a profile, one message for all else."""
    if output.debug:
        mutter("".join(traceback.format_exception(error)))
    say(output, diagnostics_of(error))


def say(output: Output, diagnostics: Sequence[Diagnostic]) -> None:
    """Write errors and warnings to stderr, with their number when there are several."""
    if output.events:
        for d in diagnostics:
            event = "warning" if d.is_warning else "error"
            mutter(render_json_line({"event": event, **_problem(d)}))
        return
    mutter(render_diagnostics(diagnostics, stream_style(sys.stderr)) + "\n")


@contextmanager
def watching(output: Output) -> Iterator[Reporter]:
    """Give a reporter for stderr, and leave the terminal clean behind it."""
    reporter = _reporter(output)
    _watching.append(reporter)
    try:
        yield reporter
    finally:
        _watching.remove(reporter)
        reporter.close()


def _reporter(output: Output) -> Reporter:
    if output.events:
        return EventReporter(sys.stderr)
    if output.quiet:
        return Reporter()
    if (style := stream_style(sys.stderr)).live:
        from edmctl.cli.render.live import LiveReporter

        return LiveReporter(sys.stderr, style)
    return LineReporter(sys.stderr)


def stream_style(stream: TextIO) -> Style:
    """Return how to write to `stream` in this environment."""
    return style_of(stream, os.environ)


def write(stream: TextIO, text: str) -> None:
    """Write and flush. Nobody reading any more is no failure of the job: the rest goes nowhere.

    Raises OSError, once: what a stream that takes nothing still holds goes nowhere as well.
    """
    try:
        stream.write(text)
        stream.flush()
    except OSError as refused:
        _drain(stream)
        if not isinstance(refused, BrokenPipeError):
            raise


@contextmanager
def stdout_sink() -> Iterator[Sink]:
    """Give a sink into stdout; a reader that goes away ends the block in order. Raises RunFileError E9010."""
    from edmctl.jobs.output_files import Sink

    sys.stdout.flush()
    sink = Sink(sys.stdout.buffer, unwritable)
    try:
        yield sink
        sink.flush()
    except RunFileError as lost:
        if not isinstance(lost.__cause__, BrokenPipeError):
            raise
        _drain(sys.stdout)


def _drain(stream: TextIO) -> None:
    """Let what the stream still holds go nowhere, so that Python does not fail at exit."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def note(output: Output, text: str) -> None:
    """Write one line of progress to stderr, in the form that was asked for."""
    with watching(output) as reporter:
        reporter.note(text)


def tell(output: Output, text: str) -> None:
    """Write a line to stderr, unless silence was asked for."""
    if not output.quiet:
        mutter(f"{text}\n")


def mutter(text: str) -> None:
    """Write to stderr, past a picture that is shown there. That it takes nothing changes nothing about the job."""
    for reporter in _watching:
        reporter.aside()
    with suppress(OSError, ValueError):
        write(sys.stderr, text)


def _document(exit_code: int, outcome: Outcome, error: EdmError | None) -> dict[str, object]:
    found = diagnostics_of(error) if error else ()
    return {
        "schema": SCHEMA,
        "command": outcome.output.command,
        "ok": error is None,
        "exit_code": exit_code,
        "simulated": outcome.simulated,
        "seed": outcome.seed,
        "run_file": str(outcome.run_file) if outcome.run_file else None,
        "files": outcome.files,
        "warnings": [_problem(warning) for warning in (*outcome.warnings, *found) if warning.is_warning],
        "result": outcome.result,
        "error": _error_mapping(error) if error else None,
    }


def diagnostics_of(error: EdmError) -> Sequence[Diagnostic]:
    """Return every diagnostic of a profile, or the one that any other error is."""
    if isinstance(error, ProfileError):
        return error.diagnostics
    return [Diagnostic(error.code, error.message, error.hint, error.where)]


def _error_mapping(error: EdmError) -> dict[str, object]:
    mapping = _problem(error)
    if isinstance(error, ProfileError):
        mapping["all"] = [_problem(d) for d in error.diagnostics if not d.is_warning]
    if isinstance(error, MachineFault):
        mapping["fault"] = error.fault
    return mapping


def _problem(found: Diagnostic | EdmError) -> dict[str, object]:
    where = found.where
    return {
        **{key: getattr(found, key) for key in ("code", "message", "hint")},
        **{key: getattr(where, key, None) for key in ("file", "line", "column")},
    }
