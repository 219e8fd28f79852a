"""The report of a study: its contents, as text on a terminal and as plain values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from edmctl.cli.render.terminal import PLAIN, USUAL_COLUMNS, Ink, Style, render_columns, wrapped
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import EdmError
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.study.analysis import StudyAnalysis, analysis_of
from edmctl.study.folder import StudyState
from edmctl.study.report import contents
from edmctl.study.results import Confirmation, Recommendation, ResponseInfo, StudyPlan, StudyRun
from edmctl.study.statistics.response_analysis import ResponseAnalysis
from edmctl.study.suggestions import confirmations_of, recommended
from edmctl.wording import plural, significant

if TYPE_CHECKING:
    from edmctl.report.html import PageTable


MOST_POINTS = 12
ANOVA_COLUMNS = ("term", "dof", "F", "p", "share of seq. SS, %")
FIELDS = (
    *("name", "is_log", "mean", "sd", "anova", "coefficients"),
    *("r2", "adjusted_r2", "predicted_r2", "error_sd", "notes"),
)
"""Fields of an analysis that the JSON object has under the same name."""


@dataclass(frozen=True, slots=True)
class StudyReport:
    """All that a report contains.

    runs : every run of the study with its state
    notes : what a reader has to know before the tables; those of the plan are added
    """

    analysis: StudyAnalysis
    runs: Sequence[StudyRun]
    recommendation: Recommendation | None = None
    confirmations: Sequence[Confirmation] = ()
    notes: Sequence[str] = ()

    def info(self, name: str) -> ResponseInfo:
        """Return how a response was requested."""
        return next(info for info in self.analysis.plan.responses if info.name == name)


def report_of(state: StudyState, surroundings: Surroundings = NONE) -> StudyReport:
    """Return the report of a study. Raises PreconditionError E8206 if no run is done."""
    found = analysis_of(state)
    best, notes = None, found.notes
    try:
        best = recommended(state, surroundings)
    except EdmError as error:
        notes = (*notes, error.message.rstrip("."))
    except ValueError:  # too few values for processes
        pass
    return StudyReport(found, state.runs, best, confirmations_of(state), notes)


def mapping_of(report: StudyReport) -> dict[str, Any]:
    """Return the `result` of the JSON object of a report."""
    analysis = report.analysis
    return {
        "study": analysis.plan.name,
        "runs": [run.planned.number for run in analysis.runs],
        "added_runs": [run.planned.number for run in analysis.added],
        "responses": [_response(one, analysis) for one in analysis.responses],
        "choices": analysis.choices,
        "recommendation": report.recommendation,
        "confirmations": report.confirmations,
        "notes": report.notes,
    }


def _response(one: ResponseAnalysis, analysis: StudyAnalysis) -> dict[str, Any]:
    lack = one.lack
    return {
        **{name: getattr(one, name) for name in FIELDS},
        "runs": [analysis.runs[row].planned.number for row in one.used],
        "pooled_anova": one.pooled,
        "lack_of_fit": {name: getattr(lack, name) for name in ("dof", "f", "p", "pure_dof")}
        if lack
        else None,
        "level_means": [{**asdict(row), "delta": row.delta} for row in one.level_means],
        "signal_to_noise_db": [{**asdict(row), "delta": row.delta} for row in one.noise_means],
        "left_out": {"held": one.held, "of": one.left_out},
    }


def render_report(report: StudyReport, style: Style = PLAIN) -> str:
    """Render the tables of each response, the Pareto front, the recommendation and the confirmations."""
    found, plan = report.analysis, report.analysis.plan
    parts = [render_response(report.info(one.name), one, style) for one in found.responses]
    front = [one for one in found.choices if one.is_pareto]
    if len(plan.objectives or plan.responses) > 1 and front:
        runs = plural(sum(one.runs for one in found.choices), "run")
        columns = ("point", *(of.name for of in plan.factors), "grey relational grade", "keeps constraints")
        table = _text(contents.choices(plan, front), style, columns, MOST_POINTS)
        points = plural(len(found.choices), "point")
        parts.append(f"{len(front)} of {points} ({runs}) Pareto-optimal\n{table}")
    if report.recommendation is not None:
        parts.append(render_recommendation(plan, report.recommendation, style))
    parts += [render_confirmation(plan, one, style) for one in report.confirmations]
    if report.notes:
        parts.append(_lines((f"note: {note}" for note in report.notes), style))
    return "\n\n".join(parts)


def render_response(info: ResponseInfo, one: ResponseAnalysis, style: Style = PLAIN) -> str:
    """Render the analysis of variance of a response, pooled if nothing else is left for the error."""
    head = style.paint(f"{one.name}{', logarithm' if one.is_log else ''}", Ink.STRONG)
    mean = f"mean {significant(one.mean, 4)}, standard deviation {significant(one.sd, 3)}"
    lines = [f"{head}  {plural(len(one.used), 'run')} of the design: {mean}"]
    if one.anova is not None:
        shown = contents.analysis_of_variance(one)[0 if one.anova.error.dof else -1]
        lines.append(_text(shown, style, ANOVA_COLUMNS))
    sentences = [*contents.what_matters(info, one), *map(contents.sentence, one.notes)]
    quality = contents.fit_quality(one, info.unit)
    if quality is not None and math.isfinite(one.r2):
        sentences.append(contents.sentence("; ".join(f"{name}: {value}" for name, value in quality.rows[1:])))
    return "\n".join([*lines, _lines(sentences, style)])


def render_recommendation(plan: StudyPlan, one: Recommendation, style: Style = PLAIN) -> str:
    """Render the settings that are recommended, and the response values that are expected there."""
    return _lines([contents.recommended(plan, one)], style)


def render_confirmation(plan: StudyPlan, one: Confirmation, style: Style = PLAIN) -> str:
    """Render the results of confirmation runs beside what was expected of them."""
    text = _lines(contents.confirmed(plan, [one]), style)
    return f"{text}\n{_text(contents.confirmation(plan, one), style)}" if one.responses else text


def _lines(paragraphs: Iterable[str], style: Style) -> str:
    columns = style.columns or USUAL_COLUMNS
    return "\n".join(line for text in paragraphs for line in wrapped(text, columns, "  "))


def _text(table: PageTable, style: Style, columns: Sequence[str] = (), most: int | None = None) -> str:
    """Return a table of the page, or some of its columns and rows, as text."""
    kept = [n for n, name in enumerate(table.header) if not columns or name in columns]
    header, *rows = ([str(row[n]) for n in kept] for row in (table.header, *table.rows[:most]))
    return render_columns(header, rows, style, "<" if table.words else "<>")
