"""What a study waits for, in sentences with the command that goes on."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from edmctl.jobs.study.table import missing_manual
from edmctl.results.study import RunState
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.jobs.study.folder import StudyState

MOST_NAMED = 8


def what_next(state: StudyState) -> list[str]:
    """Return what is to be done by people or by the next command, the most urgent first."""
    folder = shlex.quote(str(state.folder.path))
    open_runs = [run.planned.number for run in state.runs if run.state is RunState.OPEN]
    failed = [run.planned.number for run in state.runs if run.state is RunState.FAILED]
    missing = missing_manual(state)
    found = []
    if failed:
        found.append(
            f"Runs that failed: {_numbers(failed)}. Judge each: `edmctl study judge {folder} RUN "
            "accept|reject|repeat REASON`."
        )
    if state.rows.paused and open_runs:
        last = state.rows.paused[-1]
        if last.get("number") in open_runs:
            found.append(f"It paused before run {last['number']}: {last['why']}")
    if open_runs:
        port = f" --port {shlex.quote(state.rows.port)}" if state.rows.port else ""
        found.append(f"{plural(len(open_runs), 'run')} to make: `edmctl study resume {folder}{port}`.")
    if missing:
        names = ", ".join(dict.fromkeys(name for _, lacking in missing for name in lacking))
        found.append(
            f"{names} of runs {_numbers([number for number, _ in missing])}: `edmctl study tell {folder} RUN "
            f"{missing[0][1][0]}=VALUE`, or `edmctl study import {folder} TABLE.csv`."
        )
    if state.rows.torn:
        found.append(f"{plural(state.rows.torn, 'line')} of the rows were cut off and count for nothing.")
    if state.rows.foreign:
        found.append(
            f"{plural(state.rows.foreign, 'line')} of the rows are of another study and count for nothing."
        )
    if not found:
        found.append(f"All is there: `edmctl study report {folder} --out PAGE.html`.")
    return found


def _numbers(numbers: list[int]) -> str:
    shown = ", ".join(map(str, numbers[:MOST_NAMED]))
    return shown + (f" and {len(numbers) - MOST_NAMED} more" if len(numbers) > MOST_NAMED else "")
