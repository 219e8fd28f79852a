"""The report of a study: its contents, as text on a terminal, as plain values and as profiles."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
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
    best, notes = _recommendation_or_note(state, surroundings)
    return StudyReport(found, state.runs, best, confirmations_of(state), (*found.notes, *notes))


def _recommendation_or_note(
    state: StudyState, surroundings: Surroundings = NONE
) -> tuple[Recommendation | None, tuple[str, ...]]:
    try:
        return recommended(state, surroundings), ()
    except EdmError as error:
        return None, (error.message.rstrip("."),)
    except ValueError:
        return None, ()


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


def write_profiles(state: StudyState, folder: Path, *, overwrite: bool = False) -> list[Path]:
    """Write a technology table: a profile for each point of the Pareto front, complete by itself; return the files.

    Settings that are recommended and were not run get one too.

    Raises PreconditionError E8208 where no point has all objectives, RunFileError E9011 where a file is there.
    """
    import tomli_w

    front = [one for one in analysis_of(state).choices if one.is_pareto]
    if not front:
        raise failures.no_point_keeps_constraints()
    stem, name = file_stem(state.plan.name), state.plan.name
    files = {
        folder / f"{stem}-point{one.point:03d}.toml": (
            one.settings,
            f"point {one.point} of the study {name}",
            f"means of {one.runs} runs: {_values(one.means)}",
        )
        for one in sorted(front, key=lambda one: -(one.grey_grade or 0.0))
    }
    best, _ = _recommendation_or_note(state)
    if best is not None and best.settings not in [one.settings for one in front]:
        expected = f"expected: {_values(best.expected)}"
        files[folder / f"{stem}-recommended.toml"] = (
            best.settings,
            f"recommended by the study {name}",
            expected,
        )
    output_files.make_folder(folder)
    if not overwrite:
        for path in files:
            output_files.check_free(path, "Name another folder, or replace its profiles with --overwrite.")
    for path, (settings, description, values) in files.items():
        request = request_of(state.folder.base, settings)
        assert request.profile is not None
        merged = apply_overrides(read_chain(find_profile(request.profile)), request.overrides)
        table: dict[str, Any] = dict(merged.table)
        table["meta"] = {**table.get("meta", {}), "name": path.stem, "description": description[:200]}
        head = f"# {description[:200]}: {values}.\n\n"
        output_files.write(path, (head + tomli_w.dumps(table)).encode(), overwrite=True)
    return list(files)


def _values(of: Mapping[str, float | None]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in of.items() if value is not None)


def file_stem(name: str) -> str:
    """Return the beginning of the names of a study's files."""
    return re.sub("-{2,}", "-", plain_name(name.lower()))[:40].strip("-") or "study"
