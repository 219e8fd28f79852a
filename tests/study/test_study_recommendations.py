"""What is chosen, recommended, expected and confirmed: without what machines differ by, and kept as it was."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.app import main
from edmctl.dataclasses import replace
from edmctl.errors import PreconditionError
from edmctl.study.analysis import analysis_of, expected_at, is_one_machine
from edmctl.study.planning import plan_study
from edmctl.study.report import render_confirmation, render_recommendation
from edmctl.study.report.contents import confirmed
from edmctl.study.results import Judgement, RunKind
from edmctl.study.study_file import read_study
from edmctl.study.suggestions import (
    confirmation_runs,
    confirmations_of,
    counted,
    recommended,
    suggested_runs,
    suggestions,
)
from tests.study.studies import (
    FULL,
    HEAD,
    MACHINE,
    RANGES,
    SMALL,
    THREE_FACTORS,
    TIME,
    TWO_FACTORS,
    come_to,
    made,
    written,
)
from tests.tiers import tiers

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from edmctl.study.folder import StudyFolder
    from edmctl.study.results import PlannedRun, Recommendation

    Law = Callable[[PlannedRun], dict[str, float | None]]


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
IN_BLOCKS = HEAD + THREE_FACTORS + '[design]\nkind = "full"\nblocks = 2\nreplicates = 2\n' + CHOICE


def time_s(run: PlannedRun) -> float:
    """A law without blocks."""
    settings = run.settings
    return 40.0 * float(settings["servo.reference"]) ** 2 / float(settings["pulse.duty"])


def arcs(share: float, confirmed: float | None = None) -> Law:
    """That law with a share of arcs, another one for confirmation runs."""

    def law(run: PlannedRun) -> dict[str, float | None]:
        is_other = confirmed is not None and run.kind is RunKind.CONFIRMATION
        return {"machining_time_s": time_s(run), "arc_share": confirmed if is_other else share}

    return law


def confirm(folder: StudyFolder, best: Recommendation, runs: int = 3) -> None:
    """Add confirmation runs of a recommendation as the command does."""
    with folder.writer() as writer:
        writer.planned(confirmation_runs(folder.read(), best.settings, runs), best.intervals)


def test_points_are_compared_without_what_their_machines_differ_by(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_BLOCKS)

    def law(run: PlannedRun) -> dict[str, float]:
        slow = 1.8 if run.block % 2 else 1.0
        return {"machining_time_s": slow * time_s(run), "arc_share": 0.01}

    come_to(folder, law)
    choices = analysis_of(folder.read()).choices
    means = {choice.point: choice.means["machining_time_s"] for choice in choices}
    expected = {run.planned.point: time_s(run.planned) for run in folder.read().runs}
    ratios = [float(means[point] or 0.0) / expected[point] for point in expected]
    assert max(ratios) / min(ratios) == pytest.approx(1.0, rel=1e-9)
    best = recommended(folder.read())
    assert (best.settings["servo.reference"], best.settings["pulse.duty"]) == (0.7, 0.4)


@pytest.mark.parametrize("has_suggestions", [False, True])
def test_settings_that_a_confirmation_has_disproved_are_neither_suggested_nor_recommended(
    tmp_path: Path, has_suggestions: bool
) -> None:
    folder, law = made(tmp_path, IN_BLOCKS), arcs(0.01, confirmed=0.09)
    come_to(folder, law)
    if has_suggestions:
        with folder.writer() as writer:
            writer.planned(suggestions(folder.read(), 1))
        come_to(folder, law)
    first = recommended(folder.read())
    assert first.is_feasible
    confirm(folder, first)
    come_to(folder, law)
    second = recommended(folder.read())
    assert second.settings != first.settings
    assert "left out" in second.basis
    if has_suggestions:
        assert all(run.settings != first.settings for run in suggestions(folder.read(), 2))
    else:
        assert second.is_feasible


def test_the_best_may_lie_in_a_corner_that_was_not_run(tmp_path: Path) -> None:
    folder = made(tmp_path, HEAD + RANGES + "[design]\nkind = 'lhs'\nruns = 8\nseeds = 'run'\n" + CHOICE)
    come_to(folder, arcs(0.01))
    with folder.writer() as writer:
        writer.planned(suggestions(folder.read(), 1))
    come_to(folder, arcs(0.01))
    assert recommended(folder.read()).settings == {"servo.reference": 0.7, "pulse.duty": 0.4}


def test_levels_that_a_model_has_not_seen_are_not_guessed(tmp_path: Path) -> None:
    text = IN_BLOCKS.replace("blocks = 2\nreplicates = 2", 'seeds = "run"\ncenter_points = 1').replace(
        "[0.2, 0.4]", "[0.2, 0.3, 0.4]"
    )
    folder = made(tmp_path, text)
    come_to(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": 0.01 + run.number % 3 / 2000})
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
                writer.judged(run, Judgement.REJECT, "chip")
    fewer = folder.read()
    lost = next(run for run in fewer.runs if run.planned.settings["pulse.duty"] == 0.2)
    assert expected_at(fewer, analysis_of(fewer).responses, lost.planned.settings) == {}


def test_machines_with_a_run_each_are_not_taken_for_one(tmp_path: Path) -> None:
    text = IN_BLOCKS.replace("blocks = 2\nreplicates = 2", 'seeds = "run"\nreplicates = 2')
    folder = made(tmp_path, text)
    come_to(folder, arcs(0.01))
    assert not is_one_machine(folder.read().runs)
    (tmp_path / "alone").mkdir()
    alone = made(tmp_path / "alone", IN_BLOCKS.replace("blocks = 2\nreplicates = 2\n", ""))
    come_to(alone, arcs(0.01))
    assert is_one_machine(alone.read().runs)


def test_nothing_is_recommended_where_no_constraint_is_known(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_BLOCKS)
    come_to(folder, lambda run: {"machining_time_s": time_s(run)})
    with pytest.raises(PreconditionError, match=r"known to keep arc_share ≤ 0\.05") as nothing:
        recommended(folder.read())
    assert nothing.value.code == "E8208"


def test_an_expected_share_is_none_that_cannot_be(tmp_path: Path) -> None:
    folder = made(tmp_path, IN_BLOCKS.replace("blocks = 2\n", ""))
    shares = iter([0.0, 0.05, 0.01, 0.0, 0.04, 0.0, 0.02, 0.001] * 2)
    come_to(folder, lambda run: {"machining_time_s": time_s(run), "arc_share": next(shares)})
    state = folder.read()
    analysis = analysis_of(state)
    for run in state.runs:
        value, low, high = expected_at(state, analysis.responses, run.planned.settings)["arc_share"]
        assert 0.0 <= low <= value <= high <= 1.0
    assert "arc_share is wider than all that was measured" in recommended(state).basis


def test_suggestions_on_a_machine_come_with_centre_runs_of_each_tool(tmp_path: Path) -> None:
    folder = made(tmp_path, MACHINE)
    come_to(folder, lambda run: {"machining_time_s": time_s(run)})
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


@pytest.mark.parametrize("is_followed", tiers(True, slow=[False]))
def test_a_confirmation_that_breaks_a_constraint_ends_with_7(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], is_followed: bool
) -> None:
    """Also where a suggestion was added after it."""
    folder = made(tmp_path, IN_BLOCKS)
    come_to(folder, arcs(1e-6))
    first = recommended(folder.read())
    confirm(folder, first, 2)
    come_to(folder, arcs(0.09))
    confirm(folder, first, 1)
    with folder.writer() as writer:
        if is_followed:
            writer.planned(suggested_runs(folder.read(), [{**first.settings, "pulse.duty": 0.2}]))
    assert main(["study", "confirm", str(folder.path), "--workers", "1", "--quiet"]) == 7
    assert "E7911" in capsys.readouterr().err


def test_a_study_for_a_machine_says_that_it_runs_on_virtual_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made(tmp_path, MACHINE)
    come_to(folder, lambda run: {"machining_time_s": time_s(run)})
    assert main(["study", "resume", str(folder.path)]) == 0
    assert "W8215" in capsys.readouterr().err


FACTORS = "".join(
    f"[[factors]]\nkey = '{key}'\nname = '{name}'\nlevels = {levels}\n"
    for key, name, levels in (
        ("servo.reference", "reference", [0.70, 0.75, 0.80]),
        ("pulse.duty", "duty", [0.2, 0.3, 0.4]),
        ("pulse.frequency_hz", "frequency", [1500, 2300, 3100]),
        ("pulse.current_a", "current", [0.08, 0.10, 0.12]),
    )
)
SATURATED = f"{HEAD}{FACTORS}[design]\nkind = 'taguchi'\nreplicates = 3\n{TIME}"


def scattered(seed: int = 1, arc_share: float = 0.01) -> Law:
    """A law: shorter with the duty, with scatter of 1 s within and between machines."""
    rng = np.random.default_rng(seed)

    def law(run: PlannedRun) -> dict[str, float | None]:
        machine = float(np.random.default_rng(run.block).normal())
        time_s = 80.0 - 100.0 * float(run.settings["pulse.duty"]) + machine + rng.normal()
        return {"machining_time_s": float(time_s), "arc_share": arc_share}

    return law


def test_points_that_were_repeated_tell_what_to_expect_without_a_model(tmp_path: Path) -> None:
    """An array with a factor in every column needs every point, and its replicates still tell."""
    folder = made(tmp_path, SATURATED)
    come_to(folder, scattered())
    (analysis,) = analysis_of(folder.read()).responses
    assert analysis.model is None
    best = recommended(folder.read())
    low, high = best.low["machining_time_s"], best.high["machining_time_s"]
    assert low < 80.0 - 100.0 * float(best.settings["pulse.duty"]) < high
    assert 4.0 < high - low < 40.0
    confirm(folder, best)
    come_to(folder, scattered(2))
    state = folder.read()
    (found,) = confirmations_of(state)
    assert found.responses[0].held == 3


def test_what_is_not_expected_has_no_table_and_is_not_refuted(tmp_path: Path) -> None:
    folder = made(tmp_path, SATURATED.replace("replicates = 3", ""))
    come_to(folder, scattered())
    best = recommended(folder.read())
    assert not best.expected
    plan = folder.plan
    assert "Expected of a new run" not in render_recommendation(plan, best)
    confirm(folder, best)
    come_to(folder, scattered(2))
    state = folder.read()
    (found,) = confirmations_of(state)
    assert "expected nothing" in confirmed(state.folder.plan, [found])[0]
    assert "held" not in render_confirmation(plan, replace(found, responses=()))


def test_what_a_confirmation_was_to_confirm_does_not_change_afterwards(tmp_path: Path) -> None:
    """Suggestions let Gaussian processes tell from then on; what was expected before them stays."""
    folder = made(tmp_path, f"{SATURATED}[[objectives]]\nresponse = 'machining_time_s'\n")
    come_to(folder, scattered())
    best = recommended(folder.read())
    confirm(folder, best)
    come_to(folder, scattered(2))
    (before,) = confirmations_of(folder.read())
    one = before.responses[0]
    assert (one.expected, one.low, one.high) == pytest.approx(best.intervals["machining_time_s"])
    with folder.writer() as writer:
        writer.planned(suggested_runs(folder.read(), [best.settings] * 2))
    come_to(folder, scattered(3))
    state = folder.read()
    assert recommended(state).intervals != best.intervals
    assert confirmations_of(state) == [before]


def test_each_confirmation_is_judged_by_what_was_expected_of_it(tmp_path: Path) -> None:
    folder = made(tmp_path, f"{SATURATED}[[objectives]]\nresponse = 'machining_time_s'\n")
    come_to(folder, scattered())
    first = recommended(folder.read())
    confirm(folder, first)
    come_to(folder, scattered(2))
    other = replace(first, low={"machining_time_s": 1.0}, high={"machining_time_s": 2.0})
    confirm(folder, other, runs=2)
    come_to(folder, scattered(2))
    found = confirmations_of(folder.read())
    assert [one.settings for one in found] == [first.settings] * 2
    assert [(one.responses[0].held, len(one.runs)) for one in found] == [(3, 3), (0, 2)]


def test_the_command_keeps_what_it_expects(tmp_path: Path) -> None:
    folder = made(tmp_path, SATURATED)
    come_to(folder, scattered())
    best = recommended(folder.read())
    assert main(["study", "confirm", str(folder.path), "--runs", "1", "--workers", "1", "-q"]) == 0
    state = folder.read()
    assert state.rows.expected == {state.runs[-1].planned.number: best.intervals}


CLEAN = f"{HEAD}{TWO_FACTORS}{FULL}replicates = 2\n{CHOICE}"


def test_what_confirmation_has_refuted_is_not_recommended_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made(tmp_path, CLEAN)
    come_to(folder, scattered())
    refuted: list[object] = []
    for _ in range(4):
        best = recommended(folder.read())
        assert best.settings not in refuted
        assert (
            "Settings whose confirmation did not keep arc_share ≤ 0.05 are left out" in best.basis
        ) == bool(refuted)
        assert "not known to keep" not in best.basis
        refuted.append(best.settings)
        confirm(folder, best)
        come_to(folder, scattered(2, arc_share=0.09))
    made_before = len(folder.read().runs)
    for command, hint in (("confirm", "study suggest"), ("suggest", "wider factors")):
        assert main(["study", command, str(folder.path)]) == 8
        said = " ".join(capsys.readouterr().err.split())
        assert "E8217" in said
        assert "did not keep arc_share ≤ 0.05" in said
        assert hint in said
    assert len(folder.read().runs) == made_before
    assert main(["study", "report", str(folder.path)]) == 0
    assert "Nothing is left to recommend" in capsys.readouterr().out


def test_what_cannot_be_told_is_not_expected(tmp_path: Path) -> None:
    ra = "[[responses]]\nname = 'ra_um'\nsource = 'manual'\nunit = 'µm'\nlow = 0.0\nhigh = 0.4\n"
    folder = made(tmp_path, f"{HEAD}{TWO_FACTORS}{FULL}replicates = 2\n{TIME}{ra}")
    come_to(folder, scattered())
    with folder.writer() as writer:
        for run, ra_um in zip(folder.read().runs, (0.0, 0.4, 0.1, 0.0, 0.3, 0.4, 0.0, 0.2), strict=True):
            writer.told(run, {"ra_um": ra_um})
    state = folder.read()
    responses = analysis_of(state).responses
    found = [expected_at(state, responses, run.planned.settings)["ra_um"] for run in state.runs]
    assert all(0.0 <= low <= value <= high <= 0.4 for value, low, high in found)
    assert min(low for _, low, _ in found) == 0.0
    assert max(high for *_, high in found) == 0.4
