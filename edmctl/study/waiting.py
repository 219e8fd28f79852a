"""What a study waits for, in sentences with the command that goes on."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from edmctl.study.on_machine import wants_new_tool
from edmctl.study.optimizing import counted
from edmctl.study.results import RunState
from edmctl.study.table import missing_manual
from edmctl.wording import plural

if TYPE_CHECKING:
    from edmctl.study.folder import StudyState

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
    found: list[str] = []
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
    if (
        not found
        and command == "optimize"
        and (left := state.folder.source.file.optimize.runs - counted(state)) > 0
    ):
        found.append(
            f"{plural(left, 'run')} of the optimisation to suggest and make: `{way_on(state, command)}`."
        )
    if not found:
        found.append(f"All is there: `{study('report')} --out PAGE.html`.")
    return [*found, *_not_counted(state)]


def _not_counted(state: StudyState) -> list[str]:
    """Lines of the rows that count for nothing, and why."""
    whys = (
        (state.rows.torn, "cut off or changed"),
        (state.rows.foreign, "of another study"),
        (state.strangers, "of runs with other settings, which another computer added under the same numbers"),
    )
    return [
        f"{plural(lines, 'row')} {why}: {'it counts' if lines == 1 else 'they count'} for nothing."
        for lines, why in whys
        if lines
    ]


def not_yet_known(state: StudyState, numbers: Collection[int]) -> list[str]:
    """Return which constraints some runs cannot be judged by before people tell what they have measured."""
    bounds = {bound.response: str(bound) for bound in state.folder.plan.constraints}
    lacking: dict[str, list[int]] = {}
    for number, names in missing_manual(state):
        for name in names:
            if number in numbers and name in bounds:
                lacking.setdefault(name, []).append(number)
    return [
        f"{bounds[name]} is not known yet: tell {name} of runs {_numbers(runs)} "
        f"(`{state.folder.command('tell')} RUN {name}=VALUE`)."
        for name, runs in lacking.items()
    ]


def _numbers(numbers: list[int]) -> str:
    shown = ", ".join(map(str, numbers[:MOST_NAMED]))
    return shown + (f" and {len(numbers) - MOST_NAMED} more" if len(numbers) > MOST_NAMED else "")
