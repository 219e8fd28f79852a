"""Studies for people: the plan before it runs, how far it is, and what its runs say in one screen."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from edmctl.cli.render.layout import USUAL_COLUMNS, labelled, narrowed, render_columns, render_table, wrapped
from edmctl.cli.render.style import PLAIN, Ink, Style
from edmctl.study.report.words import differing_words, points_needed, why_not_predicted
from edmctl.study.results import (
    Choice,
    Confirmation,
    PlannedRun,
    Recommendation,
    RunKind,
    RunState,
    StudyPlan,
    StudyRun,
)
from edmctl.wording import duration, length, plural, setting_text, settings_words, shortened, significant

if TYPE_CHECKING:
    from edmctl.study.statistics.linear_model import Anova, AnovaRow
    from edmctl.study.statistics.response_analysis import ResponseAnalysis


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


def render_analysis(
    responses: Sequence[ResponseAnalysis],
    choices: Sequence[Choice],
    names: Sequence[str],
    recommendation: Recommendation | None,
    confirmations: Sequence[Confirmation],
    notes: Sequence[str],
    style: Style = PLAIN,
    truths: Mapping[str, ResponseAnalysis] = MappingProxyType({}),
) -> str:
    """Render what matters for each response, the best points, and what is recommended.

    Where `truths` has the analysis of what a virtual machine knows of a response, it stands beside the measured one.
    """
    columns = style.columns or USUAL_COLUMNS
    parts = [render_response(one, style, truths.get(one.name)) for one in responses]
    front = [one for one in choices if one.is_pareto]
    if len(names) > 1 and front:
        parts.append(_front(choices, front, names, style))
    if recommendation is not None:
        parts.append(render_recommendation(recommendation, style))
    parts += [render_confirmation(one, style) for one in confirmations]
    lines = [line for note in notes for line in wrapped(f"note: {note}", columns, "  ")]
    return "\n\n".join([*parts, *(["\n".join(lines)] if lines else [])])


def render_response(one: ResponseAnalysis, style: Style = PLAIN, true: ResponseAnalysis | None = None) -> str:
    """Render the analysis of variance of a response, pooled where nothing was left for the error.

    true : the analysis of the true values of a virtual machine, beside it
    """
    columns = style.columns or USUAL_COLUMNS
    mean = (
        f"{plural(len(one.used), 'run')} of the design: mean {significant(one.mean, 4)}, standard deviation "
        f"{significant(one.sd, 3)}"
    )
    head = style.paint(f"{one.name}{', logarithm' if one.is_log else ''}", Ink.STRONG) + f"  {mean}"
    lines = [head]
    table, true_table = _table_of(one), _table_of(true) if true is not None else None
    if table is not None:
        beside = {row.name: row for row in (*true_table.rows, true_table.error)} if true_table else {}
        rows = [
            [
                row.name,
                str(row.dof),
                _number(row.f),
                _p_words(row.p),
                _share_words(row),
                *(
                    [_p_words(it.p) if (it := beside.get(row.name)) else "–", _share_words(it)]
                    if beside
                    else []
                ),
            ]
            for row in (*table.rows, table.error)
        ]
        rows += [
            [row.name, str(row.dof), "–", "–", "–", _p_words(row.p), _share_words(row)]
            for name, row in beside.items()
            if name not in {one.name for one in (*table.rows, table.error)}
        ]
        titles = [
            "",
            "DoF",
            "F",
            "p",
            "seq. contribution",
            *(["p, true values", "seq. contribution"] if beside else []),
        ]
        lines.append(render_columns(titles, rows, style, "<>"))
        if words := differing_words(table):
            lines += wrapped(words, columns, "  ")
        if table.pooled:
            lines += wrapped(f"counted as error: {', '.join(table.pooled)}", columns, "  ")
        if math.isfinite(one.r2):
            fit = f"R² {one.r2:.3f}, predicted R² {_number(one.predicted_r2)}"
            if not math.isfinite(one.predicted_r2):
                fit += f" ({why_not_predicted(one)})"
            if one.left_out:
                fit += f"; intervals without a point held {one.held} of {one.left_out} points"
                needed = points_needed(one)
                fit += f" (the model cannot do without the other {plural(needed, 'point')})" if needed else ""
            lines += wrapped(fit, columns, "  ")
        if one.lack is not None and one.lack.p < SIGNIFICANT:
            lines += wrapped(
                "The model misses more than runs of one point differ by (lack of fit, p "
                f"{_p_words(one.lack.p).rstrip(' *')}): there is more to it.",
                columns,
                "  ",
            )
    lines += [line for note in one.notes for line in wrapped(note, columns, "  ")]
    return "\n".join(lines)


def _table_of(one: ResponseAnalysis) -> Anova | None:
    return one.pooled if one.anova is not None and not one.anova.error.dof and one.pooled else one.anova


def _share_words(row: AnovaRow | None) -> str:
    return f"{row.contribution_pct:.1f} %" if row is not None and math.isfinite(row.contribution_pct) else "–"


def _p_words(p: float) -> str:
    if not math.isfinite(p):
        return "–"
    words = "< 0.001" if p < 0.001 else f"{p:.3f}"
    return f"{words} *" if p < SIGNIFICANT else words


def _number(value: float) -> str:
    return significant(value, 3) if math.isfinite(value) else "–"


def _front(choices: Sequence[Choice], front: Sequence[Choice], names: Sequence[str], style: Style) -> str:
    best = sorted(front, key=lambda one: -(one.grey_grade or 0.0))[:MOST_POINTS_SHOWN]
    table = {
        "point": [str(one.point) for one in best],
        **{name: [_optional(one.means.get(name)) for one in best] for name in names},
        "grey grade": [_optional(one.grey_grade) for one in best],
        "TOPSIS": [_optional(one.topsis_closeness) for one in best],
    }
    runs = plural(sum(one.runs for one in choices), "run")
    head = f"{len(front)} of {plural(len(choices), 'point')} ({runs}) Pareto-optimal; grades are preferences"
    return f"{head}\n{render_table(table, style)}"


def _optional(value: float | None) -> str:
    return "–" if value is None else significant(value, 3)


def render_recommendation(one: Recommendation, style: Style = PLAIN) -> str:
    """Render the settings that are recommended, and what is expected of a run there."""
    columns = style.columns or USUAL_COLUMNS
    kept = "kept by the 95 % bound of the mean" if one.is_feasible else "NO settings are known to keep this"
    of = f" ({', '.join(one.constraints)}: {kept})" if one.constraints else ""
    lines = [style.paint("Recommended", Ink.STRONG) + f"{of}:"]
    lines += wrapped(settings_words(one.settings), columns, "  ")
    rows = [
        [name, significant(value, 4), f"{significant(one.low[name], 4)} to {significant(one.high[name], 4)}"]
        for name, value in one.expected.items()
    ]
    if rows:
        lines.append(render_columns(["response", "expected", "95 % of runs"], rows, style, "<>"))
    return "\n".join([*lines, *wrapped(one.basis, columns, "  ")])


def render_confirmation(one: Confirmation, style: Style = PLAIN) -> str:
    """Render what runs came to at settings that no model had seen, against what was expected of them."""
    columns = style.columns or USUAL_COLUMNS
    lines = [style.paint("Confirmation", Ink.STRONG) + f", {plural(len(one.runs), 'run')}:"]
    lines += wrapped(settings_words(one.settings), columns, "  ")
    rows = [
        [
            response.name,
            f"{significant(response.low, 4)} to {significant(response.high, 4)}"
            if response.is_tested
            else "not known",
            ", ".join(significant(value, 4) for value in response.measured),
            f"{response.held} of {len(response.measured)}" if response.is_tested else "–",
        ]
        for response in one.responses
    ]
    if rows:
        lines.append(render_columns(["response", "expected", "measured", "held"], rows, style, "<"))
    else:
        lines.append("No response has a value yet.")
    for limit in one.limits:
        upper = f", 95 % bound {significant(limit.upper, 3)}" if limit.upper is not None else ""
        lines.append(
            f"{limit.constraint}: mean of the runs {significant(limit.mean, 3)}{upper}: {limit.verdict}"
        )
    return "\n".join(lines)


def approval_words(run: StudyRun, time_s: float) -> str:
    """Return the question before sparks of a run."""
    settings = shortened(settings_words(run.planned.settings))
    return f"run {run.planned.number} ({run.planned.kind}): {settings}; takes {duration(time_s)}"
