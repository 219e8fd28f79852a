"""The exit codes: one table for `--help`, the documentation and the tests."""

from __future__ import annotations

from enum import IntEnum

from edmctl.errors import EdmError, Interrupted


class ExitCode(IntEnum):
    """What the exit code of `edmctl` says. Codes are only ever added."""

    DONE = 0
    INTERNAL = 1
    USAGE = 2
    PROFILE = 3
    LINK = 4
    PROTOCOL = 5
    FAULT = 6
    OBJECTIVE = 7
    PRECONDITION = 8
    RUN_FILE = 9
    HANGUP = 129
    INTERRUPT = 130
    TERMINATED = 143


MEANING = {
    ExitCode.DONE: "done",
    ExitCode.INTERNAL: "internal error",
    ExitCode.USAGE: "usage",
    ExitCode.PROFILE: "profile, setup or measured data invalid",
    ExitCode.LINK: "no port, or link lost",
    ExitCode.PROTOCOL: "protocol or firmware mismatch",
    ExitCode.FAULT: "machine fault (safe state reached)",
    ExitCode.OBJECTIVE: "objective not reached (depth, time, wear limit)",
    ExitCode.PRECONDITION: "precondition (not calibrated, interlock, no reference)",
    ExitCode.RUN_FILE: "run file or disk",
    ExitCode.HANGUP: "stopped by SIGHUP",
    ExitCode.INTERRUPT: "stopped by Ctrl-C (SIGINT)",
    ExitCode.TERMINATED: "stopped by SIGTERM",
}


def error_exit_code(error: EdmError) -> int:
    """Return 128 + the signal's number for a signal, else the error's own code."""
    if isinstance(error, Interrupted):
        return 128 + error.signal_number
    return error.exit_code


def exit_code_table() -> str:
    """Return one line per code."""
    return "\n".join(f"{code:>5}  {meaning}" for code, meaning in MEANING.items())
