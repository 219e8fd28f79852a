"""The report of a study on a terminal: the tables and sentences of its page."""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.cli.render.layout import USUAL_COLUMNS, render_columns, wrapped
from edmctl.cli.render.style import PLAIN, Ink, Style
from edmctl.report.html import PageTable
from edmctl.study.report import StudyReport, tables, words
from edmctl.study.results import Confirmation, Recommendation, ResponseInfo, StudyPlan
from edmctl.study.statistics.response_analysis import ResponseAnalysis
from edmctl.wording import plural, significant

MOST_POINTS = 12
OF_VARIANCE = ("term", "dof", "F", "p", "share of seq. SS, %")
OF_BOTH = ("term", *(f"{what}, {of}" for of in ("measured", "true") for what in ("p", "seq. share %")))


def render_report(report: StudyReport, style: Style = PLAIN) -> str:
    """Render what matters for each response, the Pareto front, the recommendation and the confirmations."""
    found, plan, columns = report.analysis, report.analysis.plan, style.columns or USUAL_COLUMNS
    parts = [
        render_response(report.info(one.name), one, style, found.truths.get(one.name))
        for one in found.responses
    ]
    front = [one for one in found.choices if one.is_pareto]
    if len(plan.objectives or plan.responses) > 1 and front:
        runs = plural(sum(one.runs for one in found.choices), "run")
        head = f"{len(front)} of {plural(len(found.choices), 'point')} ({runs}) Pareto-optimal"
        ranked = tables.preferences(plan, front)
        parts.append(f"{head}\n{_text(ranked, style, most=MOST_POINTS)}")
    if report.recommendation is not None:
        parts.append(render_recommendation(plan, report.recommendation, style))
    parts += [render_confirmation(plan, one, style) for one in report.confirmations]
    if report.notes:
        parts.append(
            "\n".join(line for note in report.notes for line in wrapped(f"note: {note}", columns, "  "))
        )
    return "\n\n".join(parts)


def render_response(
    info: ResponseInfo, one: ResponseAnalysis, style: Style = PLAIN, true: ResponseAnalysis | None = None
) -> str:
    """Render the analysis of variance of a response, pooled if nothing else is left for the error.

    true : the analysis of the true values of a virtual machine, beside it
    """
    columns = style.columns or USUAL_COLUMNS
    mean = f"mean {significant(one.mean, 4)}, standard deviation {significant(one.sd, 3)}"
    head = style.paint(f"{one.name}{', logarithm' if one.is_log else ''}", Ink.STRONG)
    lines = [f"{head}  {plural(len(one.used), 'run')} of the design: {mean}"]
    if true is not None and (both := tables.measured_and_true(one, true)) is not None:
        lines.append(_text(both, style, OF_BOTH))
    elif shown := tables.analysis_of_variance(one):
        is_pooled = one.anova is not None and not one.anova.error.dof
        lines.append(_text(shown[-1 if is_pooled else 0], style, OF_VARIANCE))
    said = [*words.what_matters(info, one), *map(words.sentence, one.notes)]
    quality = tables.fit_quality(one, info.unit)
    if quality is not None and math.isfinite(one.r2):
        said.append(words.sentence("; ".join(f"{name}: {value}" for name, value, *_ in quality.rows[1:])))
    return "\n".join([*lines, *(line for one in said for line in wrapped(one, columns, "  "))])


def render_recommendation(plan: StudyPlan, one: Recommendation, style: Style = PLAIN) -> str:
    """Render the settings that are recommended, and what is expected of a run there."""
    return "\n".join(wrapped(words.recommended(plan, one), style.columns or USUAL_COLUMNS, "  "))


def render_confirmation(plan: StudyPlan, one: Confirmation, style: Style = PLAIN) -> str:
    """Render the results of runs at settings that no model had seen, against what was expected of them."""
    said = [
        line
        for text in words.confirmed(plan, [one])
        for line in wrapped(text, style.columns or USUAL_COLUMNS, "  ")
    ]
    table = tables.confirmation(plan, one)
    return "\n".join([*said, *([_text(table, style)] if table is not None else [])])


def _text(table: PageTable | None, style: Style, columns: Sequence[str] = (), most: int | None = None) -> str:
    """Return a table of the page, or some of its columns and rows, as text."""
    if table is None:
        return ""
    kept = [n for n, name in enumerate(table.header) if not columns or name in columns]
    header, *rows = ([str(row[n]) for n in kept] for row in (table.header, *table.rows[:most]))
    return render_columns(header, rows, style, "<" if table.words else "<>")
