"""The page of a designed experiment: the numbers of its analyses, names as text, and figures that draw quietly."""

from __future__ import annotations

import itertools
import math
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache, partial
from html.parser import HTMLParser
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.report.html import picture_of
from edmctl.report.panels import NothingToDraw
from edmctl.study.analysis import StudyAnalysis, doe_runs, pareto_front
from edmctl.study.design import terms_of
from edmctl.study.report import StudyReport, render_study_page
from edmctl.study.report import figures as drawn
from edmctl.study.report.contents import all_runs, p_text, p_words
from edmctl.study.results import (
    Choice,
    Confirmation,
    ConfirmedResponse,
    ConstraintInfo,
    FactorInfo,
    Judgement,
    PlannedRun,
    Recommendation,
    ResponseInfo,
    RunKind,
    RunRow,
    StudyPlan,
    StudyRun,
)
from edmctl.study.running import bare_row
from edmctl.study.statistics.response_analysis import ResponseAnalysis, analyse
from edmctl.wording import significant, to_its_u95

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HOSTILE = "<b>tool</b> & $x$"
GAP, DUTY = FactorInfo("servo.reference", "reference", (0.7, 0.8, 0.9), is_number=True), "duty"
LEVELS = (GAP, FactorInfo("pulse.duty", DUTY, (0.2, 0.3, 0.4), is_number=True))
SURFACE = (
    FactorInfo(
        "pulse.frequency_hz", "frequency", (500.0, 5000.0), is_number=True, is_log=True, is_range=True
    ),
    FactorInfo("servo.reference", "reference", (0.7, 0.9), is_number=True, is_range=True),
    FactorInfo("tool.material", HOSTILE, ("Cu", "<b>W</b>"), is_number=False),
)
RESPONSES = (
    ResponseInfo("time_s", "s", "smaller", is_log=True),
    ResponseInfo("wear_um", "µm", "smaller"),
    ResponseInfo("bare", "", "larger", is_manual=True),
    ResponseInfo("flat", "", "nominal", target=2.0),
)
SPARSE = (1, 2, 3, 4, 7)
"""Points that determine the main effects of the 3 × 3, and leave nothing."""


@dataclass(frozen=True)
class Made:
    """A study with its analyses."""

    plan: StudyPlan
    runs: tuple[StudyRun, ...]
    responses: tuple[ResponseAnalysis, ...]
    choices: tuple[Choice, ...]

    def page(self, *, with_figures: bool = False, **others: object) -> str:
        """The page; `others` take the place of parts."""
        parts = {
            "plan": self.plan,
            "runs": self.runs,
            "added": (),
            "responses": self.responses,
            "choices": self.choices,
            "notes": (),
        }
        parts |= {name: others.pop(name) for name in parts if name in others and name != "notes"}
        texts = {name: str(others.pop(name, "")) for name in ("title", "source")}
        runs = others.pop("state", self.runs)
        page = StudyReport(StudyAnalysis(**parts), runs, **others)  # type: ignore[arg-type]
        return render_study_page(page, **texts, with_figures=with_figures)

    def one(self, name: str) -> ResponseAnalysis:
        """The analysis of a response."""
        return next(one for one in self.responses if one.name == name)


def values_of(run: PlannedRun, rng: np.random.Generator) -> dict[str, float | None]:
    """What a made-up machine would answer; only the first replicate of SPARSE has all."""
    keys = list(run.settings)
    x = [float(run.settings[key]) if not isinstance(run.settings[key], str) else 0.0 for key in keys]
    noise = rng.normal(size=3)
    first = run.replicate == 1
    return {
        "time_s": math.exp(3 + 2 * math.log(x[0]) - 3 * x[1] + 0.1 * run.block + 0.02 * noise[0]),
        "wear_um": None if run.number % 5 == 3 else 5 + 8 * x[1] * x[0] ** 0.2 + 0.1 * noise[1],
        "bare": float(1 + run.point + 0.1 * noise[2]) if first and run.point in SPARSE else None,
        "flat": 2.0,
    }


def made(factors: tuple[FactorInfo, ...], model: str, points: Sequence[tuple[object, ...]]) -> Made:
    """A study of two replicates, each on a machine of its own."""
    keys = [factor.key for factor in factors]
    planned = [
        PlannedRun(
            number=replicate * len(points) + n + 1,
            kind=RunKind.CENTER if n == 4 else RunKind.DESIGN,
            point=n + 1,
            replicate=replicate + 1,
            block=replicate + 1,
            seed=replicate + 1,
            settings=dict(zip(keys, point, strict=True)),  # type: ignore[arg-type]
        )
        for replicate in range(2)
        for n, point in enumerate(points)
    ]
    rng = np.random.default_rng(7)
    runs = tuple(StudyRun(run, row_of(run, values_of(run, rng)), attempts=1) for run in planned)
    plan = StudyPlan(
        name=HOSTILE,
        description="Why <i>not</i>?",
        kind="full factorial",
        factors=factors,
        responses=RESPONSES,
        constraints=(ConstraintInfo("wear_um", 7.5, 1), ConstraintInfo("bare", 1.0, -1)),
        objectives=(("time_s", 2.0), ("wear_um", 1.0), ("flat", 1.0)),
        runs=tuple(planned),
        points=len(points),
        replicates=2,
        model=model,
        dof={"block": 1, "error": len(planned) - 2},
        aliases=("a mixes with b × c",),
        notes=("one note of the plan",),
    )
    table = doe_runs(plan, runs)
    terms = terms_of(model, factors, blocks=True)
    responses = tuple(
        analyse(
            info.name,
            table,
            [math.nan if (value := run.value(info.name)) is None else value for run in runs],
            terms,
            info.better,  # type: ignore[arg-type]
            is_log=info.is_log,
        )
        for info in RESPONSES
    )
    return Made(plan, runs, responses, choices_of(runs))


def row_of(run: PlannedRun, values: dict[str, float | None]) -> RunRow:
    """The row of a run that came to its end."""
    return replace(
        bare_row(run, 1, run.seed, datetime(2026, 11, 24, tzinfo=UTC)),
        responses=values,
        u={"wear_um": 0.125},
        u95={"wear_um": 0.25},
        truth={"wear_um": values["wear_um"]},
    )


def choices_of(runs: Sequence[StudyRun]) -> tuple[Choice, ...]:
    """Every point, by its first run."""
    first = [run for run in runs if run.planned.replicate == 1]
    table = [[run.value("time_s"), run.value("wear_um") or math.nan] for run in first]
    front = pareto_front(np.array(table, float))
    return tuple(
        Choice(
            point=run.planned.point,
            settings=run.planned.settings,
            runs=2,
            means={info.name: run.value(info.name) for info in RESPONSES},
            upper={"wear_um ≤ 7.5": 7.25 if n else None, "bare ≥ 1": None},
            is_feasible=n % 4 != 0,
            is_pareto=bool(front[n]),
            grey_grade=0.4 + n / 100,
        )
        for n, run in enumerate(first)
    )


@cache
def levels() -> Made:
    return made(LEVELS, "levels", list(itertools.product(*(factor.values for factor in LEVELS))))


@cache
def surface() -> Made:
    middle = math.sqrt(500.0 * 5000.0)
    grid = itertools.product((500.0, middle, 5000.0), (0.7, 0.8, 0.9), ("Cu", "<b>W</b>"))
    return made(SURFACE, "quadratic", list(grid))


class Page(HTMLParser):
    """Tables of a page by caption, rows by their first cell, and every element's text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: dict[str, list[list[str]]] = {}
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self._rows: list[list[str]] = []
        self._caption, self._into = "", ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._into = tag
        if tag == "table":
            self._rows, self._caption = [], ""
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self._into = ""
        if tag == "table":
            self.tables[self._caption] = self._rows

    def handle_data(self, data: str) -> None:
        if self._into != "style":
            self.text.append(data)
        if self._into == "caption":
            self._caption += data
        elif self._into in ("td", "th"):
            self._rows[-1][-1] += data

    def cells(self, caption: str, row: str) -> dict[str, str]:
        """A row of the table whose caption begins so, by the names of its columns."""
        table = next(rows for name, rows in self.tables.items() if name.startswith(caption))
        found = next(cells for cells in table[1:] if cells[0] == row)
        return dict(zip(table[0][1:], found[1:], strict=True))


@pytest.fixture(scope="module")
def page() -> Page:
    return Page(levels().page())


@pytest.mark.parametrize("name", ["time_s", "wear_um"])
def test_the_analysis_of_variance_is_that_of_the_response(page: Page, name: str) -> None:
    one = levels().one(name)
    assert one.anova is not None
    assert {row.name for row in one.anova.rows} == {"block", "reference", DUTY}
    for row in one.anova.rows:
        cells = page.cells(f"Analysis of variance of {'ln ' if one.is_log else ''}{name}, nothing", row.name)
        assert cells["F"] == significant(row.f, 4)
        assert cells["p"] == p_text(row.p)
        assert cells["dof"] == str(row.dof)
        assert float(cells["share of seq. SS, %"]) == pytest.approx(row.contribution_pct, abs=0.005)
        assert cells["adj. SS"] == significant(row.adjusted_ss, 4)


def test_means_noise_coefficients_and_fit(page: Page) -> None:
    one = levels().one("time_s")
    for caption, tables in (("Means of time_s", one.level_means), ("Signal to noise by", one.noise_means)):
        for means in tables:
            cells = page.cells(caption, means.factor)
            if caption.startswith("Means"):
                pairs = zip(means.levels, means.means, strict=True)
                shown = [f"{level:g}: {significant(mean, 4)}" for level, mean in pairs]
                assert [cells[f"level {n + 1}"] for n in range(3)] == shown
                assert (cells["delta"], cells["rank"]) == (significant(means.delta, 4), str(means.rank))
    text = " ".join(page.text)
    for coefficient in one.coefficients:
        assert to_its_u95(coefficient.estimate, coefficient.u95) in text
    assert f"held {one.held} of {one.left_out}" in text
    assert one.left_out == 9


def test_what_the_runs_do_not_determine_has_its_reason(page: Page) -> None:
    text = " ".join(page.text)
    one = levels().one("bare")
    assert one.anova is not None
    assert one.pooled is not None
    assert one.anova.error.dof == 0
    cells = page.cells("Analysis of variance of bare, nothing pooled", DUTY)
    assert (cells["F"], cells["p"]) == ("–", "–")
    (row,) = one.pooled.rows
    caption = f"Analysis of variance of bare, pooled: {one.pooled.pooled[0]} counted as error"
    assert page.cells(caption, row.name)["F"] == significant(row.f, 4)
    for words in (
        "No F: no degrees of freedom are left to estimate the error.",
        "none of this is shown to be more than chance",
        "13 of 18 runs have no value",
        "flat: not analysed; all runs have the same value.",
    ):
        assert words in text


def test_the_result_in_brief_says_what_acts(page: Page) -> None:
    one = levels().one("time_s")
    assert one.anova is not None
    row = one.anova.rows[1]
    share = f"{row.contribution_pct:.1f}\u00a0%"
    assert f"reference ({share}, {p_words(row.p)}, best mean at 0.7)" in " ".join(page.text)


def test_names_are_text_and_the_page_needs_nothing_but_itself() -> None:
    text = surface().page(title="<script>alert(1)</script>", notes=["a <u>note</u>"], source="<em>")
    tags = {tag for tag, _ in Page(text).tags}
    assert not tags & {"b", "i", "u", "em", "script", "link2", "iframe"}
    assert "&lt;b&gt;tool&lt;/b&gt; &amp; $x$" in text
    assert "&lt;b&gt;W&lt;/b&gt;" in text
    assert not re.search(r"url\(|@import|https?:", text)
    ids = [attrs["id"] for _, attrs in Page(text).tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    links = {str(attrs["href"]) for tag, attrs in Page(text).tags if tag == "a"}
    assert links == {f"#{name}" for name in ids}


def test_what_the_study_cannot_know_comes_first(page: Page) -> None:
    text = " ".join(page.text)
    places = [
        text.index(words)
        for words in ("cannot know", "One note of the plan.", "effects are tested", "Degrees of freedom:")
    ]
    assert places == sorted(places)


def test_recommendation_and_confirmation() -> None:
    settings = {"servo.reference": 0.7, "pulse.duty": 0.4}
    interval = {"time_s": 4.5}, {"time_s": 4.0}, {"time_s": 5.0}
    recommendation = Recommendation(settings, *interval, is_feasible=False, basis="the models")
    held = ConfirmedResponse("time_s", 4.5, 4.0, 5.0, (4.4, 4.6))
    missed = ConfirmedResponse("wear_um", 6.0, 5.5, 6.5, (6.6, 6.4))
    for responses, words in (
        ((held,), "confirmation held."),
        ((held, missed), "did NOT hold for wear_um (1 of 2 within)"),
    ):
        confirmation = Confirmation(settings, (19, 20), responses)
        text = levels().page(recommendation=recommendation, confirmations=[confirmation])
        page = Page(text)
        assert words in " ".join(page.text)
        assert "Expected of a new run there: time_s 4.500 s (4.000 to 5.000)." in " ".join(page.text)
        assert page.cells("Confirmation at", "time_s")["measured"] == "4.400, 4.600"
        assert "The constraints are NOT kept." in " ".join(page.text)
        assert ("Confirmation did not hold" in text) == (len(responses) == 2)


def test_choices_have_bounds_and_grades_are_preferences(page: Page) -> None:
    cells = page.cells("Points", "2")
    assert cells["wear_um, upper 95 % bound (≤ 7.5)"] == "7.250"
    assert cells["keeps constraints"] == "yes"
    assert cells["grey relational grade"] == "0.410"
    assert "preference, no finding: it follows from the weights (time_s 2, wear_um 1, flat 1)" in " ".join(
        page.text
    )


def test_all_runs_stand_in_the_table_with_state_and_judgement(page: Page) -> None:
    assert page.cells("All runs", "1")["wear_um (µm)"].endswith(" ± 0.25")
    assert page.cells("All runs", "3")["wear_um (µm)"] == "–"
    rejected = replace(
        levels().runs[0], judgement=Judgement.REJECT, reason="short of oil", told={"bare": 9.0}
    )
    opened = StudyRun(levels().runs[1].planned)
    rows = all_runs(levels().plan, [rejected, opened]).rows
    assert (rows[0][1], rows[0][-1]) == ("rejected", "reject; short of oil")
    assert rows[0][-3] == "9.000"
    assert rows[1][1] == "open"
    assert list(rows[1][-5:]) == ["–", "–", "–", "–", ""]
    assert page.cells("All runs", "1")["state"] == "done"


def figures() -> dict[str, Callable[[], Figure]]:
    small, large = levels(), surface()
    time = small.one("time_s")
    wide = large.one("time_s")
    plan, runs, info = small.plan, small.runs, RESPONSES[0]
    return {
        "effects": partial(drawn.draw_main_effects, plan, info, time, runs),
        "effects without error": partial(
            drawn.draw_main_effects, plan, RESPONSES[2], small.one("bare"), runs
        ),
        "interactions": partial(drawn.draw_interactions, large.plan, info, wide, large.runs),
        "residuals": partial(drawn.draw_residuals, info, time),
        "order": partial(drawn.draw_order, RESPONSES[1], small.one("wear_um"), runs),
        "order of a constant": partial(drawn.draw_order, RESPONSES[3], small.one("flat"), runs),
        "front": partial(drawn.draw_front, plan, small.choices),
        "surface": partial(drawn.draw_surface, large.plan, info, wide, large.runs),
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", list(figures()))
def test_every_figure_draws_quietly(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        picture = picture_of(name, name, name, figures()[name], formulas=False)
    assert picture.figure is not None, picture.why_not
    assert picture.address().startswith("data:image/svg+xml;base64,")
    assert 25.4 * picture.figure.get_figwidth() == pytest.approx(85.0)


def test_figures_without_data_say_why() -> None:
    small = levels()
    info = RESPONSES[3]
    for draw in (
        partial(drawn.draw_residuals, info, small.one("flat")),
        partial(drawn.draw_residuals, RESPONSES[2], small.one("bare")),
        partial(drawn.draw_surface, small.plan, RESPONSES[0], small.one("time_s"), small.runs),
    ):
        with pytest.raises(NothingToDraw):
            draw()


def test_a_surface_is_what_the_model_expects() -> None:
    large = surface()
    one = large.one("time_s")
    assert one.model is not None
    assert {factor.name for factor in drawn.surface_factors(large.plan, one)} == {
        "frequency",
        "reference",
    }
    axes = drawn.draw_surface(large.plan, RESPONSES[0], one, large.runs).axes[0]
    assert axes.get_xlim() == pytest.approx((500.0, 5000.0))
    low, high = axes.collections[0].get_clim()
    assert low < min(np.exp(one.fitted)) * 1.2
    assert high > 0.8 * max(np.exp(one.fitted))


def test_figures_of_the_page_are_numbered_through() -> None:
    small = levels()
    short = replace(small.plan, responses=RESPONSES[3:], objectives=())
    text = Made(short, small.runs, small.responses[3:], small.choices).page(with_figures=True)
    found = re.findall(r"<b>Fig\. (\d+): ", text)
    assert found == [str(n + 1) for n in range(len(found))]
    assert "Not drawn" in text
