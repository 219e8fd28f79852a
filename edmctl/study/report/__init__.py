"""The report of a study: what it contains, on a terminal, as plain values and as profiles; `page` has its page."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.cli.render.terminal import PLAIN, USUAL_COLUMNS, Ink, Style, render_columns, wrapped
from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import EdmError
from edmctl.jobs import output_files
from edmctl.jobs.run_header import plain_name
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.profile.folders import find_profile
from edmctl.profile.read import apply_overrides, read_chain
from edmctl.study.analysis import StudyAnalysis, analysis_of
from edmctl.study.folder import StudyState
from edmctl.study.planning import request_of
from edmctl.study.report import tables, words
from edmctl.study.results import Confirmation, Recommendation, ResponseInfo, StudyPlan, StudyRun
from edmctl.study.statistics.response_analysis import ResponseAnalysis
from edmctl.study.suggestions import confirmations_of, recommended
from edmctl.wording import plural, significant

if TYPE_CHECKING:
    from edmctl.report.html import PageTable


MOST_POINTS = 12
OF_VARIANCE = ("term", "dof", "F", "p", "share of seq. SS, %")
OF_BOTH = ("term", *(f"{what}, {of}" for of in ("measured", "true") for what in ("p", "seq. share %")))


def recommendation_or_why(
    state: StudyState, surroundings: Surroundings = NONE
) -> tuple[Recommendation | None, tuple[str, ...]]:
    """Return what is recommended; without, a note why the rows do not tell, as far as that can be said."""
    try:
        return recommended(state, surroundings), ()
    except EdmError as error:
        return None, (error.message.rstrip("."),)
    except ValueError:
        return None, ()


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
    best, why = recommendation_or_why(state, surroundings)
    return StudyReport(found, state.runs, best, confirmations_of(state), (*found.notes, *why))


def mapping_of(report: StudyReport) -> dict[str, Any]:
    """Return the `result` of the JSON object of a report."""
    analysis = report.analysis
    return {
        "study": analysis.plan.name,
        "runs": [run.planned.number for run in analysis.runs],
        "added_runs": [run.planned.number for run in analysis.added],
        "responses": [_response(one, analysis) for one in analysis.responses],
        "truths": [_response(one, analysis) for one in analysis.truths.values()],
        "sobol_indices": {
            name: {key: list(map(float, values)) for key, values in asdict(one).items()}
            for name, one in analysis.indices.items()
        },
        "choices": analysis.choices,
        "recommendation": report.recommendation,
        "confirmations": report.confirmations,
        "notes": report.notes,
    }


def _response(one: ResponseAnalysis, analysis: StudyAnalysis) -> dict[str, Any]:
    lack = one.lack
    return {
        **{name: getattr(one, name) for name in AS_ANALYSED},
        "runs": [analysis.runs[row].planned.number for row in one.used],
        "pooled_anova": one.pooled,
        "lack_of_fit": {name: getattr(lack, name) for name in ("dof", "f", "p", "pure_dof")}
        if lack
        else None,
        "level_means": [{**asdict(row), "delta": row.delta} for row in one.level_means],
        "signal_to_noise_db": [{**asdict(row), "delta": row.delta} for row in one.noise_means],
        "left_out": {"held": one.held, "of": one.left_out},
    }


AS_ANALYSED = (
    *("name", "is_log", "mean", "sd", "anova", "coefficients"),
    *("r2", "adjusted_r2", "predicted_r2", "error_sd", "notes"),
)
"""Fields of an analysis that the JSON object has under the same name."""


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


def write_profiles(state: StudyState, folder: Path, *, overwrite: bool = False) -> list[Path]:
    """Write a technology table: a profile for each point of the Pareto front, complete by itself; return the files.

    Settings that are recommended and were not run get one too.

    Raises PreconditionError E8208 where no point has all objectives, RunFileError E9011 where a file is there.
    """
    import tomli_w

    analysis = analysis_of(state)
    front = [one for one in analysis.choices if one.is_pareto]
    if not front:
        raise failures.no_point_keeps_constraints()
    chosen = sorted(front, key=lambda one: -(one.grey_grade if one.grey_grade is not None else -math.inf))
    stem, name = file_stem(state.plan.name), state.plan.name
    files = [
        (
            folder / f"{stem}-point{one.point:03d}.toml",
            one.settings,
            f"point {one.point} of the study {name}",
            f"means of {one.runs} runs: {_values(one.means)}",
        )
        for one in chosen
    ]
    best, _ = recommendation_or_why(state)
    if best is not None and best.settings not in [one.settings for one in chosen]:
        path, says = folder / f"{stem}-recommended.toml", f"expected: {_values(best.expected)}"
        files.append((path, best.settings, f"recommended by the study {name}", says))
    output_files.make_folder(folder)
    if not overwrite:
        for path, *_ in files:
            output_files.check_free(path, "Name another folder, or replace its profiles with --overwrite.")
    for path, settings, description, says in files:
        request = request_of(state.folder.base, settings)
        assert request.profile is not None
        merged = apply_overrides(read_chain(find_profile(request.profile)), request.overrides)
        table: dict[str, Any] = dict(merged.table)
        table["meta"] = {**table.get("meta", {}), "name": path.stem, "description": description[:200]}
        head = f"# {description[:200]}: {says}.\n\n"
        output_files.write(path, (head + tomli_w.dumps(table)).encode(), overwrite=True)
    return [path for path, *_ in files]


def _values(of: Mapping[str, float | None]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in of.items() if value is not None)


def file_stem(name: str) -> str:
    """Return what the names of files of a study begin with."""
    return re.sub("-{2,}", "-", plain_name(name.lower()))[:40].strip("-") or "study"
