"""The page of a designed experiment: one HTML file without scripts or other files."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from functools import partial
from html import escape
from typing import TypeAlias

from edmctl.report import html
from edmctl.report.html import PageTable, Picture
from edmctl.study.report import StudyReport, tables, words
from edmctl.study.results import RunState
from edmctl.study.statistics.response_analysis import ResponseAnalysis
from edmctl.study.table import in_words
from edmctl.wording import plural

Parts: TypeAlias = Sequence[PageTable | str | None]
FEW_ALIASES = 4
"""More of them are folded."""


def render_study_page(
    parts: StudyReport, *, title: str = "", source: str = "", with_figures: bool = True
) -> str:
    """Return the page of a study that was analysed; `source` is the folder that its foot names."""
    numbers = itertools.count(1)

    def numbered(pictures: Iterator[Picture]) -> list[str]:
        """Figures numbered on from those before."""
        made = list(pictures) if with_figures else []
        taken = [next(numbers) for picture in made if picture.figure]
        return html.figures(made, taken[0] if taken else 1)

    analysis = parts.analysis
    plan = analysis.plan
    sections: list[tuple[str, str, Parts]] = [
        ("studied", "What was studied", _studied(parts)),
        ("brief", "Result in brief", _brief(parts)),
    ]
    for n, one in enumerate(analysis.responses, 1):
        inside = [*_response(parts, one), *numbered(_pictures(parts, one, f"r{n}"))]
        sections.append((f"response-{n}", one.name, inside))
    choice = [*_choice(parts), *numbered(_front(parts))]
    sections.append(("choice", "What to choose", choice))
    if analysis.indices:
        shown = [tables.sobol(plan, parts.info(name), found) for name, found in analysis.indices.items()]
        sections.append(("sobol", "Sensitivity", [*shown, *numbered(_sobol_pictures(parts))]))
    sections.append(("runs", "All runs", [tables.all_runs(plan, parts.runs)]))
    title = title or plan.name
    done = all(run.state is RunState.DONE for run in parts.runs)
    simulated = any(run.row is not None and run.row.truth for run in parts.runs)
    status = f"{in_words(parts.runs)}{' · simulated' if simulated else ''}"
    started = min((run.row.started for run in parts.runs if run.row and run.row.started), default="")
    facts = [plan.kind, plural(len(plan.factors), "factor"), plural(len(plan.responses), "response")]
    header = [
        f"<h1>{escape(title)}</h1>",
        html.paragraph(" · ".join(filter(None, [*facts, started[:16].replace("T", " ")])), "sub"),
        f'<p><span class="status {"done" if done else "other"}">{escape(status)}</span></p>',
    ]
    if words.held(parts.confirmations) is False:
        header.append(html.paragraph("Confirmation did not hold: see the result in brief.", "trouble"))
    contents = [(name, heading) for name, heading, _ in sections]
    body = [html.section(name, heading, inside) for name, heading, inside in sections]
    footer = " ".join(filter(None, [source, "± is half the 95 % interval."]))
    return html.document(title, header, contents, body, footer)


def _studied(parts: StudyReport) -> Parts:
    plan = parts.analysis.plan
    found: list[PageTable | str] = [html.paragraph(plan.description)] if plan.description else []
    found += [
        "<h3>What this study cannot know</h3>",
        html.sentences(words.unknowns(plan, parts.analysis.runs, parts.analysis.responses, parts.notes)),
        "<h3>Design</h3>",
        html.paragraph(words.design_words(plan)),
        html.paragraph(f"Model: {words.MODELS.get(plan.model, plan.model)}."),
        tables.factors(plan),
        tables.responses(plan),
        tables.degrees_of_freedom(plan),
    ]
    if plan.aliases:
        listed = html.sentences(plan.aliases)
        few = len(plan.aliases) <= FEW_ALIASES
        summary = f"Effects that are mixed ({len(plan.aliases)})"
        found += ["<h3>Effects that are mixed</h3>", listed] if few else [html.folded(summary, listed)]
    return found


def _brief(parts: StudyReport) -> Parts:
    plan = parts.analysis.plan
    acting = [" ".join(words.what_matters(parts.info(one.name), one)) for one in parts.analysis.responses]
    found: list[PageTable | str] = [html.sentences(acting)]
    found.append(html.paragraph(words.recommended(plan, parts.recommendation)))
    name = "trouble" if words.held(parts.confirmations) is False else ""
    found += [html.paragraph(text, name) for text in words.confirmed(plan, parts.confirmations)]
    return found


def _response(parts: StudyReport, one: ResponseAnalysis) -> Parts:
    plan, info = parts.analysis.plan, parts.info(one.name)
    found: list[PageTable | str | None] = []
    said = [words.wanted(info)]
    said += ["modelled as its logarithm"] if one.is_log else []
    said += [f"{len(one.values)} of {len(parts.analysis.runs)} runs of the design have a value"]
    found.append(html.paragraph(words.sentence(f"In {info.unit or 'units of 1'}, {', '.join(said)}")))
    if one.notes:
        found.append(html.sentences(words.sentence(note) for note in one.notes))
    found += tables.analysis_of_variance(one)
    if one.anova is not None and one.pooled is None:
        enough = 2 * one.anova.error.dof >= one.anova.total.dof
        why = "the error has enough degrees of freedom" if enough else "there are too few terms for that"
        found.append(html.paragraph(f"Nothing is pooled: {why}.", "note"))
    true = parts.analysis.truths.get(one.name)
    if true is not None:
        found.append(tables.measured_and_true(one, true))
    unit = f", {info.unit}" if info.unit else ""
    used = [parts.analysis.runs[row].planned.settings for row in one.used]
    shown = [means.factor for means in one.level_means]
    varied = [factor for factor in plan.factors if len({repr(of[factor.key]) for of in used}) > 1]
    left = sum(factor.name not in shown for factor in varied)
    note = f"{plural(left, 'factor')} with too many different values to have means by level." if left else ""
    means = f"Means of {one.name} by level{unit}"
    noise = f"Signal to noise by level, dB, {words.wanted(info)}"
    found += [
        tables.response_table(means, plan, one.level_means, note),
        tables.response_table(noise, plan, one.noise_means),
        _beside(tables.coefficients(one), tables.fit_quality(one, info.unit)),
    ]
    return found


def _beside(*tables: PageTable | None) -> str:
    inside = "\n".join(f"<div>{html.table(table)}</div>" for table in tables if table is not None)
    return f'<div class="beside">\n{inside}\n</div>' if inside else ""


def _pictures(parts: StudyReport, one: ResponseAnalysis, prefix: str) -> Iterator[Picture]:
    from edmctl.study.report import figures

    plan, info, runs, name = parts.analysis.plan, parts.info(one.name), parts.analysis.runs, one.name
    mixed = " The design mixes such effects with those of factors alone." if plan.aliases else ""
    bars = "Bars are the 95 % interval of a mean by the error of the model"
    if one.anova is None or not one.anova.error.dof:
        bars = "No bars: nothing is left to estimate the error"
    left = max(0, len(one.interactions) - figures.MOST_INTERACTIONS)
    most = f" The {plural(left, 'pair')} with the most parallel lines are left out." if left else ""
    others = figures.others_in_words(plan, figures.surface_factors(plan, one))
    yield _picture(
        f"{prefix}-effects",
        f"Main effects on {name}",
        f"Mean by level of each factor; the dashed line is the mean of all runs. {bars}.",
        partial(figures.draw_main_effects, plan, info, one, runs),
    )
    yield _picture(
        f"{prefix}-noise",
        f"Signal to noise of {name}",
        "Mean signal-to-noise ratio by level of each factor; higher is better. The dashed line is the mean.",
        partial(figures.draw_noise_effects, plan, one),
    )
    yield _picture(
        f"{prefix}-fitted",
        f"Measured and fitted {name}",
        "Every run and the mean of every point against what the model makes of it; on the line they agree.",
        partial(figures.draw_fitted, info, one, runs),
    )
    yield _picture(
        f"{prefix}-residuals",
        f"Residuals of {name}",
        "What the model leaves, (a) against what was fitted and (b) against a normal distribution: a fan or a bend "
        "in (a) asks for another scale or model, a point far off the line in (b) for a look at its run.",
        partial(figures.draw_residuals, info, one),
    )
    yield _picture(
        f"{prefix}-interactions",
        f"Pairs of factors and {name}",
        f"Means over two factors. Lines that are not parallel say that they act together.{mixed}{most}",
        partial(figures.draw_interactions, plan, info, one),
    )
    yield _picture(
        f"{prefix}-order",
        f"{name} in the order of the runs",
        "The response above, what the model leaves of it below; blocks are shaded in turn. A slope below is drift "
        "or wear that no term of the model has.",
        partial(figures.draw_order, info, one, runs),
    )
    yield _picture(
        f"{prefix}-surface",
        f"Surface of {name}",
        f"What the model expects over the two numbers that explain most; dots are settings that were run. {others}",
        partial(figures.draw_surface, plan, info, one, runs),
    )


_picture = partial(html.picture_of, formulas=False)


def _front(parts: StudyReport) -> Iterator[Picture]:
    from edmctl.study.report import figures

    plan = parts.analysis.plan
    more = len(plan.objectives or plan.responses) - 2
    also = f" The front is over {plural(more, 'further objective')} too, which this figure does not show."
    yield _picture(
        "front",
        "Objectives against each other",
        f"Means of the points, numbered on the front: no other point{tables.that_keeps(plan)} is as good as one of "
        f"those in every objective and better in one.{also if more > 0 else ''}",
        partial(figures.draw_front, plan, parts.analysis.choices),
    )


def _choice(parts: StudyReport) -> Parts:
    plan, choices = parts.analysis.plan, parts.analysis.choices
    return [
        tables.expected(plan, parts.recommendation) if parts.recommendation is not None else None,
        *(tables.confirmation(plan, one) for one in parts.confirmations),
        tables.choices(plan, choices),
        tables.preferences(plan, choices),
    ]


def _sobol_pictures(parts: StudyReport) -> Iterator[Picture]:
    from edmctl.study.report import figures

    for n, (name, found) in enumerate(parts.analysis.indices.items(), 1):
        yield _picture(
            f"sobol-{n}",
            f"Sobol indices of {name}",
            "Share of the variance that a factor brings alone (first order), and with all that it interacts with "
            "(total); bars are 95 % intervals.",
            partial(figures.draw_indices, parts.analysis.plan, found),
        )
