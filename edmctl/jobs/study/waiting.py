"""What a study waits for, in sentences with the command that goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.jobs.study.on_machine import wants_new_tool
from edmctl.jobs.study.table import missing_manual
from edmctl.results.study import RunState
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.jobs.study.folder import StudyState

MOST_NAMED = 8


def way_on(state: StudyState, command: str = "resume") -> str:
    """Return the command that makes what is left: at the study's machine, with --new-tool where it waits for one."""
    return state.making_command(command, *(["--new-tool"] if wants_new_tool(state) else []))


def what_next(state: StudyState, command: str = "resume") -> list[str]:
    """Return what is to be done by people or by the next command, the most urgent first.

    command : the one that makes what is left
    """
    study = state.folder.command
    open_runs = [run.planned.number for run in state.runs if run.state is RunState.OPEN]
    failed = [run.planned.number for run in state.runs if run.state is RunState.FAILED]
    missing = missing_manual(state)
    found = []
    if failed:
        found.append(
            f"Runs that failed: {_numbers(failed)}. Judge each: `{study('judge')} RUN accept|reject|repeat "
            "REASON`."
        )
    if state.rows.paused and open_runs:
        last = state.rows.paused[-1]
        if last.get("number") in open_runs:
            found.append(f"It paused before run {last['number']}: {last['why']}")
    if open_runs:
        when = ", with another tool or that one dressed" if wants_new_tool(state) else ""
        found.append(f"{plural(len(open_runs), 'run')} to make{when}: `{way_on(state, command)}`.")
    if missing:
        names = ", ".join(dict.fromkeys(name for _, lacking in missing for name in lacking))
        found.append(
            f"{names} of runs {_numbers([number for number, _ in missing])}: `{study('tell')} RUN "
            f"{missing[0][1][0]}=VALUE`, or `{study('import')} TABLE.csv`."
        )
    if state.rows.torn:
        found.append(f"{plural(state.rows.torn, 'line')} of the rows were cut off and count for nothing.")
    if state.rows.foreign:
        found.append(
            f"{plural(state.rows.foreign, 'line')} of the rows are of another study and count for nothing."
        )
    if not found:
        found.append(f"All is there: `{study('report')} --out PAGE.html`.")
    return found


def _numbers(numbers: list[int]) -> str:
    shown = ", ".join(map(str, numbers[:MOST_NAMED]))
    return shown + (f" and {len(numbers) - MOST_NAMED} more" if len(numbers) > MOST_NAMED else "")
