"""What is chosen among points and confirmed: without what machines differ by, and not against what was measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.app import main
from edmctl.errors import PreconditionError
from edmctl.study.analysis import analysis_of, expected_at, is_one_machine
from edmctl.study.planning import plan_study
from edmctl.study.results import RunKind
from edmctl.study.running import bare_row
from edmctl.study.study_file import read_study
from edmctl.study.suggestions import confirmation_runs, counted, recommended, suggested_runs, suggestions
from tests.study.studies import HEAD, SMALL, TWO_FACTORS, made, written

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from edmctl.study.folder import StudyFolder
    from edmctl.study.results import PlannedRun

THREE = """
[[factors]]
key = "pulse.frequency_hz"
name = "frequency"
levels = [1500, 3100]
"""
CHOICE = """
[[responses]]
name = "machining_time_s"
log = true

[[responses]]
name = "arc_share"

[[constraints]]
response = "arc_share"
at_most = 0.05

[[objectives]]
response = "machining_time_s"
"""
IN_BLOCKS = HEAD + TWO_FACTORS + THREE + '[design]\nkind = "full"\nblocks = 2\nreplicates = 2\n' + CHOICE


def tell(folder: StudyFolder, law: Callable[[PlannedRun], dict[str, float]]) -> None:
    """Make rows of the open runs by a law."""
    from dataclasses import replace
    from datetime import UTC, datetime

    with folder.writer() as writer:
        for run in folder.read().runs:
            if run.row is None:
                row = bare_row(run.planned, 1, run.planned.seed, datetime.now(UTC))
                writer.run(replace(row, responses=law(run.planned)))


def time_s(run: PlannedRun) -> float:
    """A law without blocks."""
    settings = run.settings
    return 40.0 * float(settings["servo.reference"]) ** 2 / float(settings["pulse.duty"])


def test_points_are_compared_without_what_their_machines_differ_by(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_BLOCKS)

    def law(run: PlannedRun) -> dict[str, float]:
        slow = 1.8 if run.block % 2 else 1.0
        return {"machining_time_s": slow * time_s(run), "arc_share": 0.01}

    tell(folder, law)
    choices = analysis_of(folder.read()).choices
    means = {choice.point: choice.means["machining_time_s"] for choice in choices}
    expected = {run.planned.point: time_s(run.planned) for run in folder.read().runs}
    ratios = [float(means[point] or 0.0) / expected[point] for point in expected]
    assert max(ratios) / min(ratios) == pytest.approx(1.0, rel=1e-9)
    best = recommended(folder.read())
    assert (best.settings["servo.reference"], best.settings["pulse.duty"]) == (0.7, 0.4)


def test_settings_that_a_confirmation_has_disproved_are_not_recommended(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_BLOCKS)
    tell(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": 0.01})
    state = folder.read()
    first = recommended(state)
    assert first.is_feasible
    with folder.writer() as writer:
        writer.planned(confirmation_runs(state, first.settings, 3))
    tell(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": 0.09})
    second = recommended(folder.read())
    assert second.settings != first.settings
    assert second.is_feasible


def test_broken_settings_are_neither_suggested_nor_recommended_after_suggestions(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_BLOCKS)

    def law(run: PlannedRun) -> dict[str, float]:
        share = 0.09 if run.kind is RunKind.CONFIRMATION else 0.01
        return {"machining_time_s": time_s(run), "arc_share": share}

    tell(folder, law)
    with folder.writer() as writer:
        writer.planned(suggestions(folder.read(), 1))
    tell(folder, law)
    first = recommended(folder.read())
    assert first.is_feasible
    with folder.writer() as writer:
        writer.planned(confirmation_runs(folder.read(), first.settings, 3))
    tell(folder, law)
    state = folder.read()
    second = recommended(state)
    assert second.settings != first.settings
    assert "left out" in second.basis
    assert all(run.settings != first.settings for run in suggestions(state, 2))


def test_the_best_may_lie_in_a_corner_that_nobody_has_run(tmp_path: Path) -> None:
    ranges = """
[[factors]]
key = "servo.reference"
low = 0.7
high = 0.8

[[factors]]
key = "pulse.duty"
low = 0.2
high = 0.4
"""
    text = HEAD + ranges + "[design]\nkind = 'lhs'\nruns = 8\nseeds = 'run'\n" + CHOICE
    folder = made(tmp_path, text)
    law: Callable[[PlannedRun], dict[str, float]] = lambda run: {  # noqa: E731
        "machining_time_s": time_s(run),
        "arc_share": 0.01,
    }
    tell(folder, law)
    with folder.writer() as writer:
        writer.planned(suggestions(folder.read(), 1))
    tell(folder, law)
    assert recommended(folder.read()).settings == {"servo.reference": 0.7, "pulse.duty": 0.4}


def test_levels_that_a_model_has_not_seen_are_not_guessed(tmp_path: Path) -> None:
    text = IN_BLOCKS.replace("blocks = 2\nreplicates = 2", 'seeds = "run"\ncenter_points = 1').replace(
        "[0.2, 0.4]", "[0.2, 0.3, 0.4]"
    )
    folder = made(tmp_path, text)
    tell(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": 0.01})
    state = folder.read()
    found = analysis_of(state)
    for run in state.runs:
        expected = expected_at(state, found.responses, run.planned.settings)
        value, low, high = expected["machining_time_s"]
        assert value == pytest.approx(time_s(run.planned), rel=0.05)
        assert low <= time_s(run.planned) <= high
    assert recommended(state).settings["servo.reference"] == 0.7
    with folder.writer() as writer:
        for run in state.runs:
            if run.planned.settings["pulse.duty"] == 0.2:
                words = {"number": run.planned.number, "attempt": 1, "judgement": "reject", "reason": "chip"}
                writer.append("judged", words)
    fewer = folder.read()
    lost = next(run for run in fewer.runs if run.planned.settings["pulse.duty"] == 0.2)
    assert expected_at(fewer, analysis_of(fewer).responses, lost.planned.settings) == {}


def test_machines_with_a_run_each_are_not_taken_for_one(tmp_path: Path) -> None:
    text = IN_BLOCKS.replace("blocks = 2\nreplicates = 2", 'seeds = "run"\nreplicates = 2')
    folder = made(tmp_path, text)
    tell(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": 0.01})
    assert not is_one_machine(folder.read().runs)
    (tmp_path / "alone").mkdir()
    alone = made(tmp_path / "alone", IN_BLOCKS.replace("blocks = 2\nreplicates = 2\n", ""))
    tell(alone, lambda run: {"machining_time_s": time_s(run), "arc_share": 0.01})
    assert is_one_machine(alone.read().runs)


def test_nothing_is_recommended_where_no_constraint_is_known(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_BLOCKS)
    tell(folder, lambda run: {"machining_time_s": time_s(run)})
    with pytest.raises(PreconditionError, match=r"known to keep arc_share ≤ 0\.05") as nothing:
        recommended(folder.read())
    assert nothing.value.code == "E8208"


@pytest.mark.parametrize(("more", "is_named"), [(0.06, True), (0.08, False)])
def test_a_faster_point_is_named_if_its_mean_keeps_the_constraint(
    tmp_path: Path, more: float, is_named: bool
) -> None:
    folder = made(tmp_path, IN_BLOCKS)
    fastest = min(folder.plan.runs, key=time_s)
    tell(
        folder,
        lambda run: {
            "machining_time_s": time_s(run),
            "arc_share": 0.02 + more * (run.point == fastest.point and run.replicate == 2),
        },
    )
    best = recommended(folder.read())
    assert "and are known to keep arc_share ≤ 0.05" in best.basis
    named = f"Points with a better mean that keep it by their mean alone: {fastest.point}."
    assert (named in best.basis) == is_named
    assert ("better mean" in best.basis) == is_named


def test_an_expected_share_is_none_that_cannot_be(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_BLOCKS.replace("blocks = 2\n", ""))
    shares = iter([0.0, 0.05, 0.01, 0.0, 0.04, 0.0, 0.02, 0.001] * 2)
    tell(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": next(shares)})
    state = folder.read()
    analysis = analysis_of(state)
    for run in state.runs:
        value, low, high = expected_at(state, analysis.responses, run.planned.settings)["arc_share"]
        assert 0.0 <= low <= value <= high <= 1.0
    assert "arc_share is wider than all that was measured" in recommended(state).basis


def test_suggestions_on_a_machine_come_with_centre_runs_of_each_tool(tmp_path: Path) -> None:
    folder = made(tmp_path, SMALL + "\n[machine]\nholes_per_tool = 4\n")
    tell(folder, lambda run: {"machining_time_s": time_s(run)})
    state = folder.read()
    settings = [{"servo.reference": 0.7 + n / 100, "pulse.duty": 0.3} for n in range(5)]
    runs = suggested_runs(state, settings)
    kinds = "".join("c" if run.kind is RunKind.CENTER else "s" for run in runs)
    assert kinds == "csscc" + "ssc" + "cs"
    assert [run.tool for run in runs] == [3] * 4 + [4] * 4 + [5] * 2
    assert len({run.point for run in runs if run.kind is RunKind.SUGGESTED}) == 5
    assert [run.number for run in runs] == list(range(9, 19))
    with folder.writer() as writer:
        writer.planned(runs)
    assert counted(folder.read()) == 8 + 5


def test_a_plan_says_what_the_supervisor_moves(tmp_path: Path) -> None:
    adaptive = SMALL.replace("jump.mode='off'", "jump.mode='adaptive'")
    notes = plan_study(read_study(written(tmp_path, adaptive))).plan.notes
    assert any("servo.reference, pulse.duty: a run begins there" in note for note in notes)
    assert not any(
        "a run begins there" in note for note in plan_study(read_study(written(tmp_path))).plan.notes
    )


@pytest.mark.parametrize("is_followed", [False, True])
def test_a_confirmation_that_breaks_a_constraint_ends_with_7(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], is_followed: bool
) -> None:
    """Also where a suggestion was added after it."""
    folder = made(tmp_path, IN_BLOCKS)
    tell(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": 1e-6})
    first = recommended(folder.read())
    with folder.writer() as writer:
        writer.planned(confirmation_runs(folder.read(), first.settings, 2))
    tell(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": 0.09})
    with folder.writer() as writer:
        writer.planned(confirmation_runs(folder.read(), first.settings, 1))
        if is_followed:
            writer.planned(suggested_runs(folder.read(), [{**first.settings, "pulse.duty": 0.2}]))
    assert main(["study", "confirm", str(folder.path), "--quiet"]) == 7
    assert "E7911" in capsys.readouterr().err


def test_a_study_for_a_machine_says_that_it_runs_on_virtual_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made(tmp_path, SMALL + "\n[machine]\nholes_per_tool = 4\n")
    tell(folder, lambda run: {"machining_time_s": time_s(run)})
    assert main(["study", "resume", str(folder.path)]) == 0
    assert "W8215" in capsys.readouterr().err
