"""Studies from Python: asked and told, by jobs, people and other optimisers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import edmctl
from edmctl.errors import PreconditionError, UsageError
from edmctl.study.results import RunKind
from edmctl.study.suggestions import data_of
from edmctl.study.table import OF_EXECUTION
from tests.study.studies import HEAD, SMALL, written

SPACE = (
    HEAD
    + """
[[factors]]
key = "servo.reference"
name = "reference"
low = 0.65
high = 0.88

[[factors]]
key = "pulse.duty"
name = "duty"
low = 0.1
high = 0.5

[design]
kind = "lhs"
runs = 8
blocks = 4

[[responses]]
name = "machining_time_s"
log = true

[[responses]]
name = "arc_share"

[[constraints]]
response = "arc_share"
at_most = 0.1

[[objectives]]
response = "machining_time_s"

[optimize]
runs = 16
"""
)


def law(settings: object) -> dict[str, float]:
    """A made-up process: faster with a low reference and a high duty, which arc."""
    assert isinstance(settings, dict)
    reference, duty = settings["servo.reference"], settings["pulse.duty"]
    return {
        "machining_time_s": 20.0 * (reference / 0.7) ** 3 / duty**0.8,
        "arc_share": 0.02 + 2.0 * duty**2 * (0.95 - reference) ** 2 * 5.0,
    }


def test_a_job_of_ones_own_is_told(tmp_path: Path) -> None:
    study = edmctl.Study.load(written(tmp_path)).start(tmp_path / "out")
    run = study.ask()[0]
    report = edmctl.connect("sim:", seed=run.seed).machine(**study.job(run))
    study.tell(run, report)
    study.tell(run, {"ra_um": 0.3})
    row = study.table()[run.number - 1]
    assert row["machining_time_s"] == pytest.approx(report.sites[0].machining_time_s, abs=1e-3)
    assert row["ra_um"] == 0.3
    assert study.ask()[0].number == run.number + 1
    assert "1 of 4 runs done" in repr(edmctl.Study.load(tmp_path / "out"))


def test_a_study_is_run_and_fitted(tmp_path: Path) -> None:
    study = edmctl.Study.load(written(tmp_path)).start(tmp_path / "out").run()
    found = study.fit("machining_time_s")
    assert found.anova is not None
    assert {row.name for row in found.anova.rows} == {"reference", "duty", "reference × duty"}
    assert len(study.to_frame()) == 4
    assert study.recommend().settings["pulse.duty"] == 0.4
    with pytest.raises(UsageError):
        study.fit("depth_um")


@pytest.mark.slow
def test_any_executor_makes_the_same_table(tmp_path: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    file = written(tmp_path)
    alone = edmctl.Study.load(file).start(tmp_path / "alone").run()
    threads = edmctl.Study.load(file).start(tmp_path / "threads")
    threads.run(workers=2, executor=lambda: ThreadPoolExecutor(2))
    assert _without_time(threads) == _without_time(alone)


def _without_time(study: edmctl.Study) -> list[dict[str, object]]:
    return [{name: value for name, value in row.items() if name not in OF_EXECUTION} for row in study.table()]


@pytest.mark.slow
def test_suggestions_follow_from_the_rows_alone(tmp_path: Path) -> None:
    """Two studies that were told the same ask for the same, whatever was opened and closed between."""
    suggested = []
    for name in ("once", "reopened"):
        study = edmctl.Study.load(written(tmp_path, SPACE)).start(tmp_path / name)
        for _ in range(16):
            if name == "reopened":
                study = edmctl.Study.load(tmp_path / name)
            (run,) = study.ask()
            study.tell(run, law(run.settings))
        suggested.append([dict(row) for row in study.table()])
    for one, other in zip(*suggested, strict=True):
        assert {k: v for k, v in one.items() if k != "started"} == {
            k: v for k, v in other.items() if k != "started"
        }
    best = study.recommend()
    assert best.is_feasible
    true = law(best.settings)
    assert true["arc_share"] <= 0.1
    fastest = min(
        law({"servo.reference": r / 1000, "pulse.duty": d / 100})["machining_time_s"]
        for r in range(650, 881, 10)
        for d in range(10, 51)
        if law({"servo.reference": r / 1000, "pulse.duty": d / 100})["arc_share"] <= 0.1
    )
    assert true["machining_time_s"] <= 1.1 * fastest


def test_runs_of_other_optimisers_count_alike(tmp_path: Path) -> None:
    study = edmctl.Study.load(written(tmp_path, SPACE)).start(tmp_path / "out")
    run = study.add({"servo.reference": 0.765, "pulse.duty": 0.3})
    assert run.kind is RunKind.SUGGESTED
    study.tell(run, law(run.settings))
    assert study.table()[-1]["machining_time_s"] == law(run.settings)["machining_time_s"]
    with pytest.raises(UsageError):
        study.add({"servo.reference": 0.7})
    with pytest.raises(UsageError):
        study.add({"servo.reference": 0.7, "pulse.duty": 3.0})
    with pytest.raises(UsageError):
        study.tell(run, {"colour": 1.0})


def test_what_is_not_there_and_what_is_no_number_is_refused(tmp_path: Path) -> None:
    study = edmctl.Study.load(written(tmp_path))

    def refused(call: Callable[[], object]) -> str:
        with pytest.raises((UsageError, PreconditionError)) as caught:
            call()
        return caught.value.code

    assert refused(study.ask) == "E2109"
    study.start(tmp_path / "out")
    assert refused(lambda: study.fit("machining_time_s")) == "E8206"
    for value in ("3 s", None, float("nan")):
        assert refused(lambda value=value: study.tell(1, {"machining_time_s": value})) == "E2105"  # type: ignore[misc]
    for run in study.ask(4):
        study.tell(run, {"machining_time_s": 10.0 + run.number})
    assert refused(study.ask) == "E8210"


def test_what_nobody_has_told_is_no_failure(tmp_path: Path) -> None:
    text = SPACE.replace('response = "machining_time_s"\n', 'response = "ra_um"\n') + (
        '\n[[responses]]\nname = "ra_um"\nsource = "manual"\nlog = true\n'
    )
    study = edmctl.Study.load(written(tmp_path, text)).start(tmp_path / "out")
    for run in study.ask(8):
        values = law(run.settings)
        if run.number % 3:
            values["ra_um"] = 0.0 if run.number == 1 else 0.2 + 0.1 * float(run.settings["pulse.duty"])
        study.tell(run, values)
    runs, objective, constraints = data_of(study._state())
    assert len(runs) == len(objective) == 6
    assert min(objective) == 0.0  # one logarithm is missing, so none is taken
    assert all(len(values) == 6 for values, _ in constraints)


def test_centre_runs_are_no_level(tmp_path: Path) -> None:
    text = SMALL.replace('kind = "full"', 'kind = "full"\ncenter_points = 1')
    study = edmctl.Study.load(written(tmp_path, text)).start(tmp_path / "out")
    for run in study.ask(5):
        is_center = run.kind is RunKind.CENTER
        study.tell(
            run, {"machining_time_s": 60.0 if is_center else 20.0, "wear_ratio_lin": 0.3 + 0.01 * run.number}
        )
    means = study.fit("machining_time_s").level_means
    assert [row.means for row in means] == [(20.0, 20.0), (20.0, 20.0)]


def test_a_frame_without_pandas_names_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = edmctl.Study.load(written(tmp_path)).start(tmp_path / "out")
    monkeypatch.setitem(sys.modules, "pandas", None)
    for frame in (study.to_frame, edmctl.forecast("cu270").to_frame):
        with pytest.raises(ImportError, match="pip install pandas"):
            frame()
