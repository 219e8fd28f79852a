"""The table of a study, values measured by hand, what the study waits for, and its plan and status as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from edmctl import failures
from edmctl.cli.render.terminal import (
    PLAIN,
    USUAL_COLUMNS,
    Ink,
    Style,
    labelled,
    narrowed,
    not_shown,
    render_columns,
    render_table,
    wrapped,
)
from edmctl.csv_text import number_of
from edmctl.errors import RecordError, UsageError
from edmctl.record.delimited import read_table
from edmctl.study.folder import StudyState
from edmctl.study.responses import LARGEST, RESPONSES, TRUTHS
from edmctl.study.results import TRUTH, PlannedRun, RunKind, RunState, StudyPlan, StudyRun
from edmctl.study.study_file import Response
from edmctl.study.suggestions import counted
from edmctl.wording import duration, length, plural, setting_text, significant

Cell = bool | int | float | str | None

OF_EXECUTION = ("run_file", "run_sha256", "started", "duration_s", "host")
"""Columns of time and computer, the last ones: all others are equal however often a study is run."""
WITHDRAWN = "none"
"""The text that withdraws a value."""
U95 = "_u95"


def table_of(state: StudyState) -> list[dict[str, Cell]]:
    """Return a row a run, in the order of their numbers; None for unknown values."""
    with_u95 = {"depth_um", "wear_um"}
    with_u95 |= {name for run in state.runs if run.row is not None for name in run.row.u95}
    return [_row(state, run, with_u95) for run in sorted(state.runs, key=lambda run: run.planned.number)]


def _row(state: StudyState, run: StudyRun, with_u95: set[str]) -> dict[str, Cell]:
    planned, row, plan = run.planned, run.row, state.plan
    x_um, y_um = (row and row.site_um) or (None, None)
    cells: dict[str, Cell] = {
        "run": planned.number,
        "kind": str(planned.kind),
        "point": planned.point,
        "replicate": planned.replicate,
        "block": run.block,
        "tool": run.tool or None,
        "x_um": x_um,
        "y_um": y_um,
        "seed": row.seed if row is not None else planned.seed,
        "attempt": row.attempt if row is not None else None,
        "order": (row.order or planned.number) if row is not None else None,
        "state": str(run.state),
        "judgement": str(run.judgement) if run.judgement else None,
        "reason": run.reason or None,
    }
    cells |= {factor.key: planned.settings[factor.key] for factor in plan.factors}
    cells |= {name: getattr(row, name, None) for name in ("exit_code", "error")}
    stated = [response.name for response in plan.responses if not response.name.startswith(TRUTH)]
    for name in dict.fromkeys((*stated, *RESPONSES)):
        cells[name] = run.recorded(name)
        if name in with_u95:
            cells[f"{name}{U95}"] = run.u95(name)
    for name in ("depth", "wear"):
        cells[f"{name}_basis"] = row.bases.get(f"{name}_um") if row is not None else None
    cells |= {f"{TRUTH}{name}": run.recorded(f"{TRUTH}{name}") for name in TRUTHS}
    cells["run_file"] = " ".join(row.run_files) or None if row is not None else None
    cells["run_sha256"] = row.run_sha256 or None if row is not None else None
    return cells | {name: getattr(row, name, None) for name in ("started", "duration_s", "host")}


def reported_values(state: StudyState, texts: Sequence[str]) -> dict[str, float | None]:
    """Return the manual responses in `NAME=VALUE` texts; None if `none` withdraws one. Raises UsageError E2105."""
    manual = _manual(state)
    values: dict[str, float | None] = {}
    for text in texts:
        name, equals, value = map(str.strip, text.partition("="))
        if not equals:
            raise failures.response_unreadable(text=text, example=next(iter(manual), "ra_um"))
        if name in values:
            raise failures.response_given_twice(name=name)
        values[name] = _value(name, value, manual)
    return values


def _manual(state: StudyState) -> dict[str, Response]:
    return {one.name: one for one in state.folder.source.file.responses if one.source == "manual"}


def _value(name: str, text: str, manual: Mapping[str, Response]) -> float | None:
    if name not in manual:
        raise failures.response_not_manual(name=name, manual=", ".join(manual) or "none")
    if text == WITHDRAWN:
        return None
    withdraws = f"{name}={WITHDRAWN} withdraws a reported value"
    if not text:
        raise failures.response_value_missing(name=name, withdraws=withdraws)
    value = number_of(text)
    if value is None:
        unit = f", in {manual[name].unit}" if manual[name].unit else ""
        remedy = f"Give the number alone{unit}; {withdraws}."
        if number_of(text, decimal_commas=True) is not None:
            remedy = "Write a decimal point."
        raise failures.response_not_a_number(name=name, text=text, remedy=remedy)
    check_bounds(manual[name], value)
    return value


def check_bounds(response: Response, value: float) -> None:
    """Raise UsageError E2105 if a value is not finite or beyond the bounds of a response."""
    name, unit = response.name, f" {response.unit}" if response.unit else ""
    if not abs(value) <= LARGEST:
        raise failures.response_not_measured(name=name, value=value)
    low, high = response.low, response.high
    if (low is not None and value < low) or (high is not None and value > high):
        bounds = [f"at least {low:g}"] if low is not None else []
        bounds += [f"at most {high:g}"] if high is not None else []
        raise failures.response_out_of_bounds(name=name, value=value, unit=unit, bounds=" and ".join(bounds))


def reported_table(state: StudyState, path: Path) -> dict[int, dict[str, float | None]]:
    """Return the manual responses in a table, by run: columns `run` and their names; others are ignored.

    Empty cells are skipped, `none` withdraws. A column `attempt` states which attempt was measured. Raises
    UsageError: E2104 there is no such run, E2105 a value is wrong, E2106 the table cannot be read or has no values,
    E2107 a run is not made yet, or that attempt at it is not the last one.
    """
    manual = _manual(state)
    try:
        table = read_table(path, ["run", "attempt", *manual])
        names = [name for name in manual if name in table.columns]
        missing = ["run"] if "run" not in table.columns else []
        missing += [] if names else [" or ".join(manual) or "of a manual response"]
        if missing:
            remedy = f"`{state.folder.command('export')}` writes a table with all columns."
            raise table.without(missing, f"Manual responses are {', '.join(manual) or 'none'}; {remedy}")
        rows = list(table.rows())
    except RecordError as error:
        raise failures.import_unreadable(problem=error.message, remedy=error.hint) from None
    reported: dict[int, dict[str, float | None]] = {}
    for line, row in rows:
        cells = {name: row[name] for name in names if row[name]}
        if not cells:
            continue
        try:
            number = number_of(row["run"])
            if number is None or not number.is_integer():  # programs write a column of whole numbers as 1.0
                raise failures.run_number_unreadable(text=row["run"])
            values = {name: _value(name, text, manual) for name, text in cells.items()}
            attempts = made_run(state, int(number)).attempts
            attempt = row.get("attempt") or str(attempts)
            if number_of(attempt) != attempts:  # on a machine the repeated run is another hole
                raise failures.attempt_not_the_last(number=int(number), attempts=attempts, text=attempt)
        except UsageError as error:
            message = f"{path}, line {line}: {error.message}"
            raise UsageError(message, hint=error.hint, code=error.code) from None
        if number in reported:
            raise failures.import_run_twice(name=path, line=line, number=int(number))
        reported[int(number)] = values
    if not reported:
        raise failures.import_without_values(name=path, there=" or ".join(names))
    return reported


def made_run(state: StudyState, number: int) -> StudyRun:
    """Return a run that was made. Raises UsageError E2104 for an unknown one, E2107 for one not made yet."""
    run = state.run(number)
    if run.row is None:
        raise failures.measured_run_not_made(number=number, command=state.folder.command("status"))
    return run


def counts_of(runs: Sequence[StudyRun]) -> dict[str, int]:
    """Return the number of runs in each state."""
    return {str(kind): sum(run.state is kind for run in runs) for kind in RunState}


def missing_manual(state: StudyState) -> list[tuple[int, tuple[str, ...]]]:
    """Return the runs that are done, and which manual responses they lack."""
    manual = [response.name for response in state.plan.responses if response.is_manual]
    lacking = [
        (run.planned.number, tuple(name for name in manual if name not in run.told))
        for run in state.runs
        if run.state is RunState.DONE
    ]
    return [(number, names) for number, names in lacking if names]


def in_words(runs: Sequence[StudyRun]) -> str:
    """Return the progress of runs: `12 of 18 runs done, 1 failed`."""
    counts = counts_of(runs)
    others = [f"{counts[name]} {name}" for name in ("failed", "rejected") if counts[name]]
    return ", ".join([f"{counts['done']} of {plural(len(runs), 'run')} done", *others])


MOST_NAMED = 8
MOST_RUNS_SHOWN = 60
LABEL_CELLS = 14


def what_next(state: StudyState, command: str = "resume") -> list[str]:
    """Return what people or the next command have to do, the most urgent first.

    command : the one that makes the open runs
    """
    study, make = state.folder.command, state.making_command(command)
    open_runs, failed = (
        [run.planned.number for run in state.runs if run.state is kind]
        for kind in (RunState.OPEN, RunState.FAILED)
    )
    steps: list[str] = []
    if failed:
        judge = study("judge")
        steps.append(
            f"Failed runs: {_numbers(failed)}. Judge each: `{judge} RUN accept|reject|repeat REASON`."
        )
    if (last := state.rows.paused) is not None and last.number in open_runs:
        steps.append(f"Paused before run {last.number}: {last.why}")
    if open_runs:
        steps.append(f"{plural(len(open_runs), 'run')} to make: `{make}`.")
    if missing := missing_manual(state):
        names = ", ".join(dict.fromkeys(name for _, names in missing for name in names))
        runs, first = _numbers([number for number, _ in missing]), missing[0][1][0]
        tell = f"`{study('tell')} RUN {first}=VALUE`, or `{study('import')} TABLE.csv`"
        steps.append(f"{names} of runs {runs}: {tell}.")
    remaining = state.folder.source.file.optimize.runs - counted(state)
    if not steps and command == "optimize" and remaining > 0:
        steps.append(f"{plural(remaining, 'run')} of the optimisation to suggest and make: `{make}`.")
    if not steps:
        steps.append(f"The study is complete: `{study('report')} --out PAGE.html`.")
    if state.rows.torn:
        steps.append(f"{plural(state.rows.torn, 'row')} cut off or changed: not counted.")
    return steps


def _numbers(numbers: list[int]) -> str:
    shown = ", ".join(map(str, numbers[:MOST_NAMED]))
    return shown + (f" and {len(numbers) - MOST_NAMED} more" if len(numbers) > MOST_NAMED else "")


def render_plan(plan: StudyPlan, style: Style = PLAIN) -> str:
    """Render what will be run: design, factors, model, costs, and every run in its order."""
    columns = style.columns or USUAL_COLUMNS
    lines = [style.paint(f"{plan.name}: {plan.kind}", Ink.STRONG)]
    if plan.description:
        lines += wrapped(plan.description, columns)
    dof = ", ".join(f"{name} {count}" for name, count in plan.dof.items())
    facts = {
        "runs": _counts(plan),
        "responses": ", ".join(one.label + (" (by hand)" if one.is_manual else "") for one in plan.responses),
        "constraints": ", ".join(map(str, plan.constraints)),
        "objectives": ", ".join(
            f"{name} (weight {weight:g})" if weight != 1 else name for name, weight in plan.objectives
        ),
        "model": f"{plan.model}; degrees of freedom: {dof}",
        "takes": _costs(plan),
        "aliases": "; ".join(plan.aliases),
    }
    lines += [labelled(name, text, LABEL_CELLS, columns) for name, text in facts.items() if text]
    factors = [
        [one.name, one.key, (" to " if one.is_range else ", ").join(map(setting_text, one.values))]
        for one in plan.factors
    ]
    parts = ["\n".join(lines), render_columns(["factor", "key", "values"], factors, style, "<", "values")]
    shared = "tool" if any(run.tool for run in plan.runs) else "seed"
    is_shown = shared == "tool" or len({run.seed for run in plan.runs}) > 1
    head = ["run", "point", *([shared] if is_shown else []), *(factor.name for factor in plan.factors)]
    rows = []
    for run in plan.runs[:MOST_RUNS_SHOWN]:
        row = [str(run.number), _point(run), *([str(getattr(run, shared))] if is_shown else [])]
        rows.append([*row, *(setting_text(run.settings[factor.key]) for factor in plan.factors)])
    if len(plan.runs) > MOST_RUNS_SHOWN:
        rows.append(["…", f"and {len(plan.runs) - MOST_RUNS_SHOWN} more"])
    parts.append(render_columns(head, rows, style, "<<>"))
    if plan.notes:
        parts.append(
            "\n".join(line for note in plan.notes for line in wrapped(f"note: {note}", columns, "  "))
        )
    return "\n\n".join(parts)


def _counts(plan: StudyPlan) -> str:
    parts = [f"{plural(len(plan.runs), 'run')} of {plural(plan.points, 'point')}"]
    blocks = len({run.block for run in plan.runs})
    tools = len({run.tool for run in plan.runs} - {0})
    if plan.replicates > 1:
        parts.append(f"{plan.replicates} replicates")
    if blocks > 1 and tools != blocks:
        parts.append(f"{blocks} blocks")
    first, last = min(run.seed for run in plan.runs), max(run.seed for run in plan.runs)
    seeds = f"seed {first}" if first == last else f"seeds {first} to {last}"
    return ", ".join([*parts, plural(tools, "tool") if tools else seeds])


def _costs(plan: StudyPlan) -> str:
    if plan.costs is None:
        return ""
    text = f"{duration(plan.costs.time_s)} of the machine, {duration(plan.costs.machining_time_s)} of it machining"
    if plan.costs.tool_wear_um:
        worn = ", ".join(map(length, plan.costs.tool_wear_um))
        text += f"; tools lose {worn} of {length(plan.costs.most_wear_um)}"
    if plan.costs.places:
        text += f"; {len(plan.runs)} of {plural(plan.costs.places, 'place')} of the grid"
    return text


def render_status(state: StudyState, style: Style = PLAIN) -> str:
    """Render every run with its state and responses, and the next steps."""
    plan, runs = state.plan, state.runs
    columns = style.columns or USUAL_COLUMNS
    some = runs[:MOST_RUNS_SHOWN]
    table: dict[str, list[str]] = {
        "run": [str(run.planned.number) for run in some],
        "state": [
            f"{run.state}, attempt {run.row.attempt}" if run.row and run.row.attempt > 1 else str(run.state)
            for run in some
        ],
        "point": [_point(run.planned) for run in some],
    }
    for factor in plan.factors:
        table[factor.name] = [setting_text(run.planned.settings[factor.key]) for run in some]
    if any(run.row is not None or run.told for run in runs):
        for response in plan.responses:
            table[response.label] = [_value_text(run, response.name) for run in some]
    fitted = narrowed(table, style.columns, [*(f.name for f in reversed(plan.factors)), "point"])
    lines = [
        *wrapped(f"{plan.name}: {in_words(runs)}.", columns),
        "",
        render_table(fitted, style, left=("state",)),
    ]
    if len(runs) > len(some):
        lines.append(f"… and {len(runs) - len(some)} more runs: `edmctl study export` has all of them")
    failed = [run for run in runs if run.state is RunState.FAILED and run.row is not None]
    errors = [f"run {run.planned.number}: {run.row.error}" for run in failed[:10] if run.row is not None]
    notes = [note for note in (not_shown(table, fitted), *what_next(state), *errors) if note]
    return "\n".join([*lines, "", *(line for note in notes for line in wrapped(note, columns, "  "))])


def _point(run: PlannedRun) -> str:
    return str(run.point) if run.kind is RunKind.DESIGN else f"{run.point} {run.kind}"


def _value_text(run: StudyRun, name: str) -> str:
    value, u95 = run.value(name), run.u95(name)
    if value is None:
        return "–"
    return significant(value, 4) + (f" ± {significant(u95, 2)}" if u95 else "")
