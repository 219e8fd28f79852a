"""The report of a study: as text on a terminal, as plain values, and as one HTML page without other files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any, TypeAlias

from edmctl.cli.render.terminal import PLAIN, USUAL_COLUMNS, Ink, Style, render_columns, wrapped
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import EdmError
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.report import html
from edmctl.report.html import PageTable, Picture
from edmctl.study.analysis import StudyAnalysis, analysis_of
from edmctl.study.folder import StudyState
from edmctl.study.report import contents
from edmctl.study.results import Confirmation, Recommendation, ResponseInfo, RunState, StudyPlan, StudyRun
from edmctl.study.statistics.response_analysis import ResponseAnalysis
from edmctl.study.suggestions import confirmations_of, recommended
from edmctl.study.table import in_words
from edmctl.wording import plural, significant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Parts: TypeAlias = list[PageTable | str | None]
FEW_ALIASES = 4
"""More of them are folded."""
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


def render_study_page(
    parts: StudyReport, *, title: str = "", source: str = "", with_figures: bool = True
) -> str:
    """Return the page of a study that was analysed; `source` is the folder that its foot names."""
    analysis, plan = parts.analysis, parts.analysis.plan
    numbers = itertools.count(1)

    def numbered(pictures: Iterator[Picture]) -> list[str]:
        made = list(pictures) if with_figures else []
        taken = [next(numbers) for picture in made if picture.figure]
        return html.figures(made, taken[0] if taken else 1)

    sections: list[tuple[str, str, Sequence[PageTable | str | None]]] = [
        ("studied", "What was studied", _studied(parts)),
        ("brief", "Result in brief", _brief(parts)),
    ]
    for n, one in enumerate(analysis.responses, 1):
        pictures = _pictures(parts, one, f"r{n}")
        sections.append((f"response-{n}", one.name, [*_response_parts(parts, one), *numbered(pictures)]))
    sections.append(("choice", "What to choose", [*_choice(parts), *numbered(_front(parts))]))
    sections.append(("runs", "All runs", [contents.all_runs(plan, parts.runs)]))
    title = title or plan.name
    contents_of_page = [(name, heading) for name, heading, _ in sections]
    body = [html.section(name, heading, inside) for name, heading, inside in sections]
    footer = f"{source} ± is half the 95 % interval.".strip()
    return html.document(title, _header(parts, title), contents_of_page, body, footer)


def _header(parts: StudyReport, title: str) -> list[str]:
    plan = parts.analysis.plan
    is_done = all(run.state is RunState.DONE for run in parts.runs)
    is_simulated = any(run.row is not None and run.row.truth for run in parts.runs)
    status = f"{in_words(parts.runs)}{' · simulated' if is_simulated else ''}"
    started = min((run.row.started for run in parts.runs if run.row and run.row.started), default="")
    facts = [plan.kind, plural(len(plan.factors), "factor"), plural(len(plan.responses), "response")]
    facts += [started[:16].replace("T", " ")] if started else []
    found = [
        f"<h1>{escape(title)}</h1>",
        html.paragraph(" · ".join(facts), "sub"),
        f'<p><span class="status {"done" if is_done else "other"}">{escape(status)}</span></p>',
    ]
    if contents.is_refuted(parts.confirmations):
        found.append(html.paragraph("Confirmation did not hold: see the result in brief.", "trouble"))
    return found


def _studied(parts: StudyReport) -> Parts:
    plan, analysis = parts.analysis.plan, parts.analysis
    limitations = contents.limitations(plan, analysis.runs, analysis.responses, parts.notes)
    found: Parts = [
        html.paragraph(plan.description) if plan.description else None,
        "<h3>What this study cannot know</h3>",
        html.sentences(limitations),
        "<h3>Design</h3>",
        html.paragraph(contents.design_text(plan)),
        html.paragraph(f"Model: {contents.MODELS.get(plan.model, plan.model)}."),
        contents.factors(plan),
        contents.responses(plan),
    ]
    if plan.aliases:
        listed = html.sentences(plan.aliases)
        if len(plan.aliases) > FEW_ALIASES:
            listed = html.folded(f"Effects that are mixed ({len(plan.aliases)})", listed)
        found += ["<h3>Effects that are mixed</h3>", listed]
    return found


def _brief(parts: StudyReport) -> Parts:
    plan, responses = parts.analysis.plan, parts.analysis.responses
    acting = [" ".join(contents.what_matters(parts.info(one.name), one)) for one in responses]
    name = "trouble" if contents.is_refuted(parts.confirmations) else ""
    return [
        html.sentences(acting),
        html.paragraph(contents.recommended(plan, parts.recommendation)),
        *(html.paragraph(text, name) for text in contents.confirmed(plan, parts.confirmations)),
    ]


def _response_parts(parts: StudyReport, one: ResponseAnalysis) -> Parts:
    plan, info, target = parts.analysis.plan, parts.info(one.name), contents.target_text(parts.info(one.name))
    log = "modelled as its logarithm, " if one.is_log else ""
    found: Parts = [
        html.paragraph(
            f"In {info.unit or 'units of 1'}, {target}, {log}{len(one.values)} of {len(parts.analysis.runs)} runs "
            "of the design have a value."
        ),
        html.sentences(map(contents.sentence, one.notes)),
        *contents.analysis_of_variance(one),
    ]
    used = [parts.analysis.runs[row].planned.settings for row in one.used]
    shown = {means.factor for means in one.level_means}
    varied = {factor.name for factor in plan.factors if len({repr(of[factor.key]) for of in used}) > 1}
    many = len(varied - shown)
    note = f"{plural(many, 'factor')} with too many different values to have means by level." if many else ""
    unit = f", {info.unit}" if info.unit else ""
    beside = (
        html.table(of) for of in (contents.coefficients(one), contents.fit_quality(one, info.unit)) if of
    )
    inside = "\n".join(f"<div>{table}</div>" for table in beside if table)
    return [
        *found,
        contents.response_table(f"Means of {one.name} by level{unit}", one.level_means, note),
        contents.response_table(f"Signal to noise by level, dB, {target}", one.noise_means),
        f'<div class="beside">\n{inside}\n</div>' if inside else "",
    ]


def _pictures(parts: StudyReport, one: ResponseAnalysis, prefix: str) -> Iterator[Picture]:
    from edmctl.study.report import figures

    plan, info, runs, name = parts.analysis.plan, parts.info(one.name), parts.analysis.runs, one.name
    bars = "Bars are the 95 % interval of a mean by the error of the model"
    if one.anova is None or not one.anova.error.dof:
        bars = "No bars: nothing is left to estimate the error"
    mixed = " The design mixes such effects with those of factors alone." if plan.aliases else ""
    at = figures.other_settings(plan, figures.surface_factors(plan, one))
    pictures: dict[str, tuple[str, str, Callable[[], Figure]]] = {
        "effects": (
            f"Main effects on {name}",
            f"Mean by level of each factor; the dashed line is the mean of all runs. {bars}.",
            partial(figures.draw_main_effects, plan, info, one, runs),
        ),
        "residuals": (
            f"Residuals of {name}",
            "Residuals (a) against fitted values and (b) against a normal distribution: a fan or a bend in (a) "
            "calls for another scale or model, a point far off the line in (b) for a look at its run.",
            partial(figures.draw_residuals, info, one),
        ),
        "interactions": (
            f"Pairs of factors and {name}",
            f"Means over two factors. Lines that are not parallel show an interaction, the strongest first.{mixed}",
            partial(figures.draw_interactions, plan, info, one, runs),
        ),
        "order": (
            f"{name} in the order of the runs",
            "Response above, residuals below; blocks are shaded in turn. A slope below is drift or wear that no "
            "term of the model has.",
            partial(figures.draw_order, info, one, runs),
        ),
        "surface": (
            f"Surface of {name}",
            f"Expected value over the two numbers that explain most; dots are settings that were run. {at}",
            partial(figures.draw_surface, plan, info, one, runs),
        ),
    }
    return (_picture(f"{prefix}-{kind}", *picture) for kind, picture in pictures.items())


_picture = partial(html.picture_of, formulas=False)


def _front(parts: StudyReport) -> Iterator[Picture]:
    from edmctl.study.report import figures

    plan = parts.analysis.plan
    more = len(plan.objectives or plan.responses) - 2
    also = f" The front is over {plural(more, 'further objective')} too, which this figure does not show."
    yield _picture(
        "front",
        "Objectives against each other",
        f"Means of the points, numbered on the front: no other point{contents.that_keeps(plan)} is as good as one "
        f"of these in every objective and better in one.{also if more > 0 else ''}",
        partial(figures.draw_front, plan, parts.analysis.choices),
    )


def _choice(parts: StudyReport) -> Parts:
    plan = parts.analysis.plan
    return [
        *(contents.confirmation(plan, one) for one in parts.confirmations),
        contents.choices(plan, parts.analysis.choices),
    ]
