"""Design tables of a study: they depend on the runs of the design alone, and are those of statsmodels."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from edmctl.app import main
from edmctl.study.analysis import analysis_of
from edmctl.study.design import value_at
from edmctl.study.folder import StudyFolder
from edmctl.study.report import StudyReport, mapping_of, render_study_page, report_of
from edmctl.study.report.contents import what_matters
from edmctl.study.results import PlannedRun
from edmctl.study.running import lost_row
from edmctl.study.suggestions import confirmation_runs, suggested_runs
from tests.study.studies import FULL, HEAD, RESPONSES, SMALL, come_to, made
from tests.tiers import tiers

THREE_LEVELS = [("servo.reference", [0.7, 0.75, 0.8]), ("pulse.duty", [0.2, 0.3, 0.4])]
TWO_LEVELS = [("servo.reference", [0.7, 0.8]), ("pulse.duty", [0.2, 0.4]), ("pulse.current_a", [0.08, 0.12])]
RANGES = "".join(
    f"[[factors]]\nkey = '{key}'\nlow = {levels[0]}\nhigh = {levels[-1]}\n" for key, levels in TWO_LEVELS
)
MACHINE = "[machine]\nholes_per_tool = 6\n"


def levels(factors: list[tuple[str, list[float]]]) -> str:
    """The tables of factors with levels."""
    return "".join(f"[[factors]]\nkey = '{key}'\nlevels = {values}\n" for key, values in factors)


DESIGNS = {
    "full": (levels(TWO_LEVELS[:2]), "kind = 'full'\nreplicates = 2"),
    "full in blocks": (levels(TWO_LEVELS), "kind = 'full'\nblocks = 2\nreplicates = 2\ncenter_points = 2"),
    "full of levels": (levels(THREE_LEVELS), "kind = 'full'\nreplicates = 2"),
    "a machine each": (levels(TWO_LEVELS[:2]), "kind = 'full'\nseeds = 'run'\nreplicates = 2"),
    "tools": (levels(TWO_LEVELS), f"kind = 'full'\n{MACHINE}"),
    "fractional": (levels(TWO_LEVELS), "kind = 'fractional'\nresolution = 3\nreplicates = 2"),
    "half": (levels(TWO_LEVELS), "kind = 'fractional'\nresolution = 3\ncenter_points = 1"),
    "taguchi": (levels(THREE_LEVELS), "kind = 'taguchi'\nreplicates = 2"),
    "bbd": (RANGES, "kind = 'bbd'\ncenter_points = 3\nseeds = 'run'"),
    "ccd": (RANGES, "kind = 'ccd'\ncenter_points = 1\nreplicates = 2"),
    "lhs": (RANGES, "kind = 'lhs'\nruns = 20\nseeds = 'run'"),
    "sobol": (RANGES, "kind = 'sobol'\nruns = 16\nblocks = 2"),
    "tools and replicates": (levels(TWO_LEVELS), f"kind = 'full'\nreplicates = 2\n{MACHINE}"),
    "csv": (RANGES, "kind = 'csv'\nfile = 'points.csv'\nreplicates = 2"),
}


def study(tmp_path: Path, kind: str) -> StudyFolder:
    """Make the folder of a study of a kind."""
    factors, design = DESIGNS[kind]
    points = [[0.7 + 0.01 * n, 0.2 + 0.02 * (n % 6), 0.08 + 0.005 * (n * n % 7)] for n in range(11)]
    header = ",".join(key for key, _ in TWO_LEVELS)
    lines = [header, *(",".join(f"{value:.3f}" for value in row) for row in points)]
    (tmp_path / "points.csv").write_text("\n".join(lines) + "\n")
    return made(tmp_path, f"{HEAD}{factors}[design]\n{design}\n{RESPONSES}")


def law(run: PlannedRun) -> dict[str, float]:
    """A known response: ten standard errors and more of each factor, machines that differ, and noise."""
    rng = np.random.default_rng([run.number, run.seed, 7])
    settings = [float(value) for value in run.settings.values()]
    machine = float(np.random.default_rng([run.block, 3]).normal())
    slope = sum(10.0 * value / (0.1, 0.2, 0.04)[n] for n, value in enumerate(settings))
    return {
        "machining_time_s": math.exp(3.0 + 0.02 * slope + 0.01 * machine + 0.01 * rng.normal()),
        "wear_ratio_lin": 0.3 + 0.01 * slope + 0.01 * machine + 0.01 * float(rng.normal()),
    }


def make(folder: StudyFolder) -> None:
    """Make rows of all open runs."""
    come_to(folder, law)


def add(folder: StudyFolder, count: int) -> None:
    """Add runs as suggestions are added, crowded where the law is best, and make them."""
    state = folder.read()
    settings = [
        {
            factor.key: value_at(factor, -1 + (0.3 * ((n + 1) * (m + 1)) % 1) ** 2)
            for m, factor in enumerate(folder.plan.factors)
        }
        for n in range(count)
    ]
    with folder.writer() as writer:
        writer.planned(suggested_runs(state, settings))
    make(folder)


def tables(folder: StudyFolder) -> str:
    """All design tables, to the digit."""
    found = mapping_of(StudyReport(analysis_of(folder.read()), ()))
    kept = {name: found[name] for name in ("runs", "responses")}
    return json.dumps(kept, default=lambda one: {name: getattr(one, name) for name in one.__slots__})


CHEAP = ("full", "tools")


@pytest.mark.parametrize("kind", tiers(*CHEAP, slow=[kind for kind in DESIGNS if kind not in CHEAP]))
def test_further_runs_leave_the_design_tables_unchanged(tmp_path: Path, kind: str) -> None:
    folder = study(tmp_path, kind)
    make(folder)
    before, choices = tables(folder), analysis_of(folder.read()).choices
    total = 0
    for count in (1, 24):
        add(folder, count)
        total += count
        state = folder.read()
        found = analysis_of(state)
        assert tables(folder) == before
        assert len(found.runs) == len(folder.plan.runs)
        assert len(found.added) >= total
        after = {one.point: one for one in found.choices}
        alone = {run.planned.point for run in found.added}
        assert all(after[one.point].means == one.means for one in choices if one.point not in alone)
    with folder.writer() as writer:
        writer.planned(confirmation_runs(folder.read(), folder.plan.runs[0].settings, 3))
    make(folder)
    assert tables(folder) == before


@pytest.mark.parametrize("kind", tiers(*CHEAP, slow=[kind for kind in DESIGNS if kind not in CHEAP]))
def test_an_effect_of_six_standard_errors_is_never_not_shown(tmp_path: Path, kind: str) -> None:
    folder = study(tmp_path, kind)
    make(folder)
    add(folder, 16)
    found = analysis_of(folder.read())
    (one,) = (one for one in found.responses if one.name == "wear_ratio_lin")
    assert one.anova is not None
    info = next(info for info in folder.plan.responses if info.name == one.name)
    words = " ".join(what_matters(info, one))
    not_shown = words.partition("Not shown to act:")[2].partition(".")[0]
    for row in one.anova.rows:
        if row.adjusted_ss > 36 * one.anova.error.mean_square:
            assert f"{row.name} (" not in not_shown
    assert one.anova.error.dof


def test_the_analysis_of_variance_is_that_of_statsmodels_with_and_without_suggestions(tmp_path: Path) -> None:
    import pandas as pd
    import statsmodels.formula.api as smf
    from statsmodels.stats.anova import anova_lm

    folder = study(tmp_path, "full")
    make(folder)
    runs = folder.read().runs
    frame = pd.DataFrame(
        {
            "y": [run.value("wear_ratio_lin") for run in runs],
            "a": [run.planned.settings["servo.reference"] for run in runs],
            "b": [run.planned.settings["pulse.duty"] for run in runs],
            "block": [run.planned.block for run in runs],
        }
    )
    expected = anova_lm(smf.ols("y ~ C(block) + C(a, Sum) * C(b, Sum)", frame).fit(), typ=3)
    expected = expected.drop("Intercept")
    for count in (0, 16):
        if count:
            add(folder, count)
        one = analysis_of(folder.read()).responses[1]
        assert one.anova is not None
        rows = [*one.anova.rows, one.anova.error]
        assert [row.adjusted_ss for row in rows] == pytest.approx(expected["sum_sq"].tolist(), rel=1e-9)
        assert [row.f for row in rows[:-1]] == pytest.approx(expected["F"].tolist()[:-1], rel=1e-9)
        assert [row.p for row in rows[:-1]] == pytest.approx(expected["PR(>F)"].tolist()[:-1], rel=1e-9)


def test_an_added_replicate_is_a_block_of_the_design(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two added replicates give the table of a design of three, whatever was suggested between them."""
    folder = study(tmp_path, "full of levels")
    make(folder)
    add(folder, 3)
    assert main(["study", "extend", str(folder.path)]) == 0
    assert "`edmctl study resume" in capsys.readouterr().out
    added = [run.planned for run in folder.read().runs if run.planned.replicate == 3]
    assert len(added) == 9
    assert {run.point for run in added} == {run.point for run in folder.plan.runs}
    used = {run.seed for run in folder.plan.runs} | {run.planned.seed for run in folder.read().runs[18:21]}
    assert len({run.seed for run in added} - used) == len({run.block for run in added}) == 1
    make(folder)
    one = analysis_of(folder.read()).responses[1]
    assert one.anova is not None
    assert {row.name: row.dof for row in one.anova.rows}["block"] == 2
    assert one.anova.total.dof == 26
    assert all(level.means for level in one.level_means)
    page = render_study_page(report_of(folder.read()))
    assert "Runs 22–30 are replicates of the design" in page


def test_table_page_and_json_name_the_runs_that_they_use(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = study(tmp_path, "full")
    make(folder)
    add(folder, 16)
    assert main(["study", "report", str(folder.path), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)["result"]
    assert result["runs"] == result["responses"][0]["runs"] == list(range(1, 9))
    assert result["added_runs"] == list(range(9, 25))
    assert sum(choice["runs"] for choice in result["choices"]) == 24
    assert "24 runs (8 of the design, 16 suggested or added)" in result["recommendation"]["basis"]
    assert main(["study", "report", str(folder.path)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "8 runs of the design: mean" in text
    note = "16 runs suggested or added later (9–24) are in the list of points"
    assert note in text
    state = folder.read()
    found = analysis_of(state)
    page = render_study_page(StudyReport(found, state.runs, notes=found.notes))
    assert note in page
    assert "8 of 8 runs of the design have a value" in page


TWICE = SMALL.replace(FULL, f"{FULL}replicates = 2\n")


def test_a_factor_with_one_level_left_has_no_table_of_levels(tmp_path: Path) -> None:
    folder = made(tmp_path, TWICE)
    with folder.writer() as writer:
        for run in folder.read().runs:
            if run.planned.settings["pulse.duty"] == 0.4:
                writer.run(lost_row(run.planned, 1, "E4001: a short", 4))
    come_to(folder, lambda run: {"machining_time_s": 40.0 + run.number % 3})
    state = folder.read()
    found = analysis_of(state)
    time = found.responses[0]
    assert [one.factor for one in time.level_means] == ["reference"]
    assert [one.factor for one in time.noise_means] == ["reference"]
    assert "only one level of duty has a value" in time.notes
    assert "too many different values" not in render_study_page(StudyReport(found, state.runs))
