"""The page of a designed experiment: one HTML file without scripts or other files."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from html import escape
from typing import TYPE_CHECKING, TypeAlias

from edmctl.report import html
from edmctl.report.html import PageTable, Picture
from edmctl.study.report import StudyReport, contents
from edmctl.study.results import RunState
from edmctl.study.statistics.response_analysis import ResponseAnalysis
from edmctl.study.table import in_words
from edmctl.wording import plural

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Parts: TypeAlias = list[PageTable | str | None]
FEW_ALIASES = 4
"""More of them are folded."""


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
        sections.append((f"response-{n}", one.name, [*_response(parts, one), *numbered(pictures)]))
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


def _response(parts: StudyReport, one: ResponseAnalysis) -> Parts:
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
