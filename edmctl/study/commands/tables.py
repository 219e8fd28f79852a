"""Studies for people: the plan before it runs, how far it is, and what its runs say in one screen."""

from __future__ import annotations

from collections.abc import Sequence

from edmctl.cli.render.layout import USUAL_COLUMNS, labelled, narrowed, render_columns, render_table, wrapped
from edmctl.cli.render.style import PLAIN, Ink, Style
from edmctl.study.results import (
    PlannedRun,
    RunKind,
    RunState,
    StudyPlan,
    StudyRun,
)
from edmctl.wording import duration, length, plural, setting_text, settings_words, shortened, significant

MOST_RUNS_SHOWN = 60
MOST_POINTS_SHOWN = 12
LABEL_CELLS = 14
SIGNIFICANT = 0.05


def render_plan(plan: StudyPlan, style: Style = PLAIN) -> str:
    """Render what will be run: design, factors, model, costs, and every run in its order."""
    columns = style.columns or USUAL_COLUMNS
    lines = [style.paint(f"{plan.name}: {plan.kind}", Ink.STRONG)]
    if plan.description:
        lines += wrapped(plan.description, columns)
    facts = {
        "runs": _runs_words(plan),
        "responses": ", ".join(one.label + (" (by hand)" if one.is_manual else "") for one in plan.responses),
        "constraints": ", ".join(map(str, plan.constraints)),
        "objectives": ", ".join(
            f"{name} (weight {weight:g})" if weight != 1 else name for name, weight in plan.objectives
        ),
        "model": f"{plan.model}; degrees of freedom: "
        + ", ".join(f"{name} {dof}" for name, dof in plan.dof.items())
        if plan.dof and plan.model != "sensitivity"
        else "",
        "takes": _costs_words(plan),
        "aliases": "; ".join(plan.aliases),
    }
    lines += [labelled(name, text, LABEL_CELLS, columns) for name, text in facts.items() if text]
    factors = {
        "factor": [factor.name for factor in plan.factors],
        "key": [factor.key for factor in plan.factors],
        "values": [
            (" to " if factor.is_range else ", ").join(map(setting_text, factor.values))
            for factor in plan.factors
        ],
    }
    parts = ["\n".join(lines), render_table(factors, style, left=("key", "values"), cut_first="values")]
    parts.append(render_columns(*_runs_table(plan), style, "<<>"))
    notes = [line for note in plan.notes for line in wrapped(f"note: {note}", columns, "  ")]
    return "\n\n".join([*parts, *(["\n".join(notes)] if notes else [])])


def _runs_words(plan: StudyPlan) -> str:
    words = f"{plural(len(plan.runs), 'run')} of {plural(plan.points, 'point')}"
    blocks = sorted({run.block for run in plan.runs})
    tools = sorted({run.tool for run in plan.runs} - {0})
    if plan.replicates > 1:
        words += f", {plan.replicates} replicates"
    if len(blocks) > 1 and not (tools and len(tools) == len(blocks)):
        words += f", {len(blocks)} blocks"
    if tools:
        words += f", {plural(len(tools), 'tool')}"
    else:
        seeds = sorted({run.seed for run in plan.runs})
        words += f", seed {seeds[0]}" if len(seeds) == 1 else f", seeds {seeds[0]} to {seeds[-1]}"
    return words


def _costs_words(plan: StudyPlan) -> str:
    if plan.costs is None:
        return ""
    words = f"{duration(plan.costs.time_s)} of the machine, {duration(plan.costs.machining_time_s)} of it machining"
    if plan.costs.tool_wear_um:
        worn = ", ".join(length(wear_um) for wear_um in plan.costs.tool_wear_um)
        words += f"; tools lose {worn} of {length(plan.costs.most_wear_um)}"
    if plan.costs.places:
        words += f"; {len(plan.runs)} of {plural(plan.costs.places, 'place')} of the grid"
    return words


def _runs_table(plan: StudyPlan) -> tuple[list[str], list[list[str]]]:
    several_seeds = len({run.seed for run in plan.runs}) > 1
    has_tools = any(run.tool for run in plan.runs)
    head = [
        "run",
        "point",
        *(["tool"] if has_tools else []),
        *(["seed"] if several_seeds and not has_tools else []),
    ]
    head += [factor.name for factor in plan.factors]
    rows = []
    for run in plan.runs[:MOST_RUNS_SHOWN]:
        row = [str(run.number), _kind_words(run)]
        row += [str(run.tool)] if has_tools else []
        row += [str(run.seed)] if several_seeds and not has_tools else []
        rows.append([*row, *(setting_text(run.settings[factor.key]) for factor in plan.factors)])
    if len(plan.runs) > MOST_RUNS_SHOWN:
        rows.append(["…", f"and {len(plan.runs) - MOST_RUNS_SHOWN} more"])
    return head, rows


def render_status(
    plan: StudyPlan,
    runs: Sequence[StudyRun],
    words: str,
    waiting: Sequence[str],
    style: Style = PLAIN,
) -> str:
    """Render every run with its state and responses, and what the study waits for."""
    columns = style.columns or USUAL_COLUMNS
    shown = [one for one in plan.responses if any(run.row is not None or run.told for run in runs)]
    table: dict[str, list[str]] = {
        "run": [str(run.planned.number) for run in runs],
        "state": [_state_words(run) for run in runs],
        "point": [_kind_words(run.planned) for run in runs],
    }
    for factor in plan.factors:
        table[factor.name] = [setting_text(run.planned.settings[factor.key]) for run in runs]
    for response in shown:
        table[response.label] = [_cell(run, response.name) for run in runs]
    most = MOST_RUNS_SHOWN
    cut = {name: cells[:most] for name, cells in table.items()}
    fitted = narrowed(cut, style.columns, [*(f.name for f in reversed(plan.factors)), "point"])
    text = render_table(fitted, style, left=("state",))
    if len(runs) > most:
        text += f"\n… and {len(runs) - most} more runs: `edmctl study export` has all of them"
    missing = [name for name in table if name not in fitted]
    lines = wrapped(f"{plan.name}: {words}.", columns)
    after = [line for one in waiting for line in wrapped(one, columns, "  ")]
    if missing:
        after.insert(0, f"Not shown, for want of width: {', '.join(missing)}.")
    failed = [run for run in runs if run.state is RunState.FAILED and run.row is not None]
    for run in failed[:10]:
        assert run.row is not None
        after += wrapped(f"run {run.planned.number}: {run.row.error}", columns, "  ")
    return "\n".join([*lines, "", text, *([""] if after else []), *after])


def _state_words(run: StudyRun) -> str:
    words = str(run.state)
    if run.row is not None and run.row.attempt > 1:
        words += f", attempt {run.row.attempt}"
    return words


def _kind_words(run: PlannedRun) -> str:
    return str(run.point) if run.kind is RunKind.DESIGN else f"{run.point} {run.kind}"


def _cell(run: StudyRun, name: str) -> str:
    value = run.value(name)
    if value is None:
        return "–"
    u95 = run.row.u95.get(name) if run.row is not None and name not in run.told else None
    return significant(value, 4) + (f" ± {significant(u95, 2)}" if u95 else "")


def approval_words(run: StudyRun, time_s: float) -> str:
    """Return the question before sparks of a run."""
    settings = shortened(settings_words(run.planned.settings))
    return f"run {run.planned.number} ({run.planned.kind}): {settings}; takes {duration(time_s)}"
