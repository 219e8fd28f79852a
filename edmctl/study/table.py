"""The table of a study, values that people report, and what the study waits for."""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from edmctl import failures
from edmctl.csv_text import number_of, table_text
from edmctl.errors import RecordError, UsageError
from edmctl.record.delimited import read_table
from edmctl.record.rows import unit_of as unit_in_name
from edmctl.study.folder import StudyState
from edmctl.study.on_machine import wants_new_tool
from edmctl.study.responses import KNOWN, LARGEST, RESPONSES, TRUTHS, unit_of
from edmctl.study.results import TRUTH, RunState, StudyRun
from edmctl.study.study_file import Response
from edmctl.study.suggestions import counted
from edmctl.wording import plural, unit_in

Cell = bool | int | float | str | None

OF_EXECUTION = ("run_file", "run_sha256", "started", "duration_s", "host")
"""Columns of time and computer, the last ones: all others are equal however often a study is run."""
WITHDRAWN = "none"
"""The text that withdraws a value."""
U95 = "_u95"
_NOTHING: Mapping[str, tuple[str, str]] = MappingProxyType({})


def table_of(state: StudyState) -> list[dict[str, Cell]]:
    """Return a row a run, in the order of their numbers; None where nothing is known."""
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
        "attempt": getattr(row, "attempt", None),
        "order": (row.order or planned.number) if row is not None else None,
        "state": str(run.state),
        "judgement": str(run.judgement) if run.judgement else None,
        "reason": run.reason or None,
    }
    for factor in plan.factors:
        cells[factor.key] = planned.settings[factor.key]
    cells |= {name: getattr(row, name, None) for name in ("exit_code", "error")}
    asked = [response.name for response in plan.responses if not response.name.startswith(TRUTH)]
    for name in dict.fromkeys((*asked, *RESPONSES)):
        cells[name] = run.recorded(name)
        if name in with_u95:
            cells[f"{name}{U95}"] = run.u95(name)
    for name in ("depth", "wear"):
        cells[f"{name}_basis"] = row.bases.get(f"{name}_um") if row is not None else None
    for name in TRUTHS:
        cells[f"{TRUTH}{name}"] = run.recorded(f"{TRUTH}{name}")
    cells["run_file"] = " ".join(row.run_files) or None if row is not None else None
    cells["run_sha256"] = row.run_sha256 or None if row is not None else None
    return cells | {name: getattr(row, name, None) for name in ("started", "duration_s", "host")}


def columns_of(state: StudyState) -> dict[str, tuple[str, str]]:
    """Return the unit and the meaning of columns that have one, as Parquet keeps them; `1` is a pure number."""
    plan = state.plan
    found = {name: (unit_of(name) or "1", known.text) for name, known in KNOWN.items()}
    found |= {one.name: (one.unit or "1", one.name) for one in plan.responses if one.is_manual}
    found |= {
        f"{name}{U95}": (unit, f"half of the 95 % interval of {name}") for name, (unit, _) in found.items()
    }
    for factor in plan.factors:
        unit = unit_in(factor.key) or unit_in_name(factor.key)
        found[factor.key] = (unit if factor.is_number else "", factor.name)
    return found | {name: (unit_of(name), name) for name in ("x_um", "y_um", "duration_s")}


def table_bytes(
    rows: Sequence[Mapping[str, Cell]], form: str, columns: Mapping[str, tuple[str, str]] = _NOTHING
) -> bytes:
    """Return a table as csv, json, jsonl or parquet, the last one with what is known of its columns.

    Raises PreconditionError E8092 without pyarrow.
    """
    if form == "parquet":
        return _parquet(rows, columns)
    if form == "json":
        return (json.dumps(list(rows), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    if form == "jsonl":
        return "".join(json.dumps(row, ensure_ascii=False, allow_nan=False) + "\n" for row in rows).encode()
    return table_text(rows).encode()


def _parquet(rows: Sequence[Mapping[str, Cell]], known: Mapping[str, tuple[str, str]]) -> bytes:
    from edmctl.report.export import need_pyarrow

    need_pyarrow()
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        kinds = {type(value) for value in values if value is not None}
        if kinds <= {int, float} and float in kinds:
            values = [None if value is None else float(value) for value in values]
        elif len(kinds) > 1:
            values = [None if value is None else str(value) for value in values]
        columns[name] = pa.array(values)
    units = {name: known.get(name, ("", name)) for name in columns}
    schema = pa.schema(
        [
            pa.field(name, column.type, metadata={"units": units[name][0], "long_name": units[name][1]})
            for name, column in columns.items()
        ]
    )
    sink = io.BytesIO()
    pq.write_table(pa.table(list(columns.values()), schema=schema), sink)
    return sink.getvalue()


def told_values(state: StudyState, texts: Sequence[str]) -> dict[str, float | None]:
    """Return what `NAME=VALUE` texts tell of manual responses; None where `none` withdraws it.

    Raises UsageError E2105.
    """
    manual = _manual(state)
    found: dict[str, float | None] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            example = next(iter(manual), "ra_um")
            raise failures.response_unreadable(text=text, example=example)
        name = name.strip()
        if name in found:
            raise failures.response_given_twice(name=name)
        found[name] = _value(name, value.strip(), manual)
    return found


def _manual(state: StudyState) -> dict[str, Response]:
    return {one.name: one for one in state.folder.source.file.responses if one.source == "manual"}


def _value(name: str, text: str, manual: Mapping[str, Response]) -> float | None:
    if name not in manual:
        hint = (
            f"It is told {', '.join(manual)}." if manual else 'None of its responses has source = "manual".'
        )
        raise failures.response_not_manual(name=name, remedy=hint)
    if text == WITHDRAWN:
        return None
    withdraws = f"{name}={WITHDRAWN} withdraws what was told"
    if not text:
        raise failures.response_value_missing(name=name, withdraws=withdraws)
    value = number_of(text)
    if value is None:
        unit = f", in {manual[name].unit}" if manual[name].unit else ""
        hint = f"Give the number alone{unit}; {withdraws}."
        if number_of(text, decimal_commas=True) is not None:
            hint = "Write a decimal point."
        raise failures.response_not_a_number(name=name, text=text, remedy=hint)
    refuse_untellable(manual[name], value)
    return value


def refuse_untellable(response: Response, value: float) -> None:
    """Raise UsageError E2105 where a value is no number, or beyond the bounds of a response."""
    name, unit = response.name, f" {response.unit}" if response.unit else ""
    if not abs(value) <= LARGEST:
        raise failures.response_not_measured(name=name, value=value)
    low, high = response.low, response.high
    if (low is not None and value < low) or (high is not None and value > high):
        bounds = [f"at least {low:g}"] if low is not None else []
        bounds += [f"at most {high:g}"] if high is not None else []
        raise failures.response_out_of_bounds(name=name, value=value, unit=unit, bounds=" and ".join(bounds))


def told_table(state: StudyState, path: Path) -> dict[int, dict[str, float | None]]:
    """Return the manual responses in a table, by run: columns `run` and their names; others are ignored.

    An empty cell tells nothing, `none` withdraws. A column `attempt` says which attempt was measured. Raises
    UsageError: E2104 there is no such run, E2105 a value is none, E2106 the table cannot be read, has no column for
    it or tells nothing, E2107 a run is not made yet, or that attempt at it is not the last one.
    """
    manual, name = _manual(state), str(path)
    try:
        table = read_table(path, ["run", "attempt", *manual])
        there = [one for one in manual if one in table.columns]
        missing = ["run"] if "run" not in table.columns else []
        missing += [] if there else [" or ".join(manual) or "of a manual response"]
        if missing:
            named = f"Manual responses are {', '.join(manual) or 'none'}"
            writes = f"`{state.folder.command('export')}` writes a table with all columns"
            raise table.without(missing, f"{named}; {writes}.")
        rows = list(table.rows())
    except RecordError as error:
        raise failures.import_unreadable(problem=error.message, remedy=error.hint) from None
    found: dict[int, dict[str, float | None]] = {}
    for line, row in rows:
        values = {one: row[one] for one in there if row[one]}
        if not values:
            continue
        try:
            number = number_of(row["run"])
            if number is None or not number.is_integer():  # programs write a column of whole numbers as 1.0
                raise failures.run_number_unreadable(text=row["run"])
            told = {one: _value(one, value, manual) for one, value in values.items()}
            _refuse_other_attempt(made_run(state, int(number)), row.get("attempt", ""))
        except UsageError as error:
            raise UsageError(
                f"{name}, line {line}: {error.message}", hint=error.hint, code=error.code
            ) from None
        if number in found:
            raise failures.import_run_twice(name=name, line=line, number=int(number))
        found[int(number)] = told
    if not found:
        raise failures.import_without_values(name=name, there=" or ".join(there))
    return found


def _refuse_other_attempt(run: StudyRun, text: str) -> None:
    """Refuse a measurement of an attempt that has been repeated since: on a machine that is another hole."""
    if text and number_of(text) is None:
        raise failures.attempt_unreadable(text=text)
    if text and number_of(text) != run.attempts:
        raise failures.attempt_not_the_last(number=run.planned.number, attempts=run.attempts, text=text)


def made_run(state: StudyState, number: int) -> StudyRun:
    """Return a run that was made. Raises UsageError E2104 for none, E2107 for one not made yet."""
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
    return [one for one in lacking if one[1]]


def in_words(runs: Sequence[StudyRun]) -> str:
    """Return the progress of runs: `12 of 18 runs done, 1 failed`."""
    found = counts_of(runs)
    words = [f"{found['done']} of {plural(len(runs), 'run')} done"]
    words += [f"{found[name]} {name}" for name in ("failed", "rejected") if found[name]]
    return ", ".join(words)


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
    if (last := state.rows.paused) is not None and last.number in open_runs:
        found.append(f"It paused before run {last.number}: {last.why}")
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
    if state.rows.torn:
        found.append(f"{plural(state.rows.torn, 'row')} cut off or changed: not counted.")
    return found


def not_yet_known(state: StudyState, numbers: Collection[int]) -> list[str]:
    """Return which constraints some runs cannot be judged by before people tell what they have measured."""
    bounds = {bound.response: str(bound) for bound in state.plan.constraints}
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
