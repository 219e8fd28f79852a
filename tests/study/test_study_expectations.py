"""What is expected of runs at settings, and what confirmation says of it then and later."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.app import main
from edmctl.study.analysis import analysis_of, expected_at
from edmctl.study.report.text import render_confirmation, render_recommendation
from edmctl.study.report.words import confirmed
from edmctl.study.running import bare_row
from edmctl.study.suggestions import confirmation_runs, confirmations_of, recommended, suggested_runs
from tests.study.studies import FULL, HEAD, TWO_FACTORS, made

if TYPE_CHECKING:
    from pathlib import Path

    from edmctl.study.folder import StudyFolder
    from edmctl.study.results import Recommendation

FACTORS = "".join(
    f"[[factors]]\nkey = '{key}'\nname = '{name}'\nlevels = {levels}\n"
    for key, name, levels in (
        ("servo.reference", "reference", [0.70, 0.75, 0.80]),
        ("pulse.duty", "duty", [0.2, 0.3, 0.4]),
        ("pulse.frequency_hz", "frequency", [1500, 2300, 3100]),
        ("pulse.current_a", "current", [0.08, 0.10, 0.12]),
    )
)
TIME = "[[responses]]\nname = 'machining_time_s'\n"
SATURATED = f"{HEAD}{FACTORS}[design]\nkind = 'taguchi'\nreplicates = 3\n{TIME}"


def tell(folder: StudyFolder, seed: int = 1, arc_share: float = 0.01) -> None:
    """Make rows of the open runs: shorter with the duty, with scatter of 1 s within and between machines."""
    rng = np.random.default_rng(seed)
    with folder.writer() as writer:
        for run in folder.read().runs:
            if run.row is None:
                machine = float(np.random.default_rng(run.planned.block).normal())
                time_s = 80.0 - 100.0 * float(run.planned.settings["pulse.duty"]) + machine + rng.normal()
                row = bare_row(run.planned, 1, run.planned.seed, datetime.now(UTC))
                writer.run(
                    replace(row, responses={"machining_time_s": float(time_s), "arc_share": arc_share})
                )


def confirm(
    folder: StudyFolder,
    best: Recommendation,
    runs: int = 3,
    *,
    arc_share: float = 0.01,
) -> None:
    """Confirm a recommendation as the command does."""
    with folder.writer() as writer:
        writer.planned(confirmation_runs(folder.read(), best.settings, runs), best.intervals)
    tell(folder, 2, arc_share)


def test_points_that_were_repeated_tell_what_to_expect_without_a_model(tmp_path: Path) -> None:
    """An array with a factor in every column needs every point, and its replicates still tell."""
    folder = made(tmp_path, SATURATED)
    tell(folder)
    (analysis,) = analysis_of(folder.read()).responses
    assert analysis.model is None
    best = recommended(folder.read())
    low, high = best.low["machining_time_s"], best.high["machining_time_s"]
    assert low < 80.0 - 100.0 * float(best.settings["pulse.duty"]) < high
    assert 4.0 < high - low < 40.0
    confirm(folder, best)
    state = folder.read()
    (found,) = confirmations_of(state)
    assert found.responses[0].held == 3


def test_what_is_not_expected_has_no_table_and_is_not_refuted(tmp_path: Path) -> None:
    folder = made(tmp_path, SATURATED.replace("replicates = 3", ""))
    tell(folder)
    best = recommended(folder.read())
    assert not best.expected
    plan = folder.plan
    assert "Expected of a new run" not in render_recommendation(plan, best)
    confirm(folder, best)
    state = folder.read()
    (found,) = confirmations_of(state)
    assert "expected nothing" in confirmed(state.folder.plan, [found])[0]
    assert "held" not in render_confirmation(plan, replace(found, responses=()))


def test_what_a_confirmation_was_to_confirm_does_not_change_afterwards(tmp_path: Path) -> None:
    """Suggestions let Gaussian processes tell from then on; what was expected before them stays."""
    folder = made(tmp_path, f"{SATURATED}[[objectives]]\nresponse = 'machining_time_s'\n")
    tell(folder)
    best = recommended(folder.read())
    confirm(folder, best)
    (before,) = confirmations_of(folder.read())
    one = before.responses[0]
    assert (one.expected, one.low, one.high) == pytest.approx(best.intervals["machining_time_s"])
    with folder.writer() as writer:
        writer.planned(suggested_runs(folder.read(), [best.settings] * 2))
    tell(folder, seed=3)
    state = folder.read()
    assert recommended(state).intervals != best.intervals
    assert confirmations_of(state) == [before]


def test_each_confirmation_is_judged_by_what_was_expected_of_it(tmp_path: Path) -> None:
    folder = made(tmp_path, f"{SATURATED}[[objectives]]\nresponse = 'machining_time_s'\n")
    tell(folder)
    first = recommended(folder.read())
    confirm(folder, first)
    other = replace(first, low={"machining_time_s": 1.0}, high={"machining_time_s": 2.0})
    confirm(folder, other, runs=2)
    found = confirmations_of(folder.read())
    assert [one.settings for one in found] == [first.settings] * 2
    assert [(one.responses[0].held, len(one.runs)) for one in found] == [(3, 3), (0, 2)]


def test_the_command_keeps_what_it_expects(tmp_path: Path) -> None:
    folder = made(tmp_path, SATURATED)
    tell(folder)
    best = recommended(folder.read())
    assert main(["study", "confirm", str(folder.path), "--runs", "1", "--quiet"]) == 0
    state = folder.read()
    assert state.rows.expected == {state.runs[-1].planned.number: best.intervals}


CLEAN = f"""{HEAD}{TWO_FACTORS}
[design]
kind = "full"
replicates = 2
{TIME}
[[responses]]
name = "arc_share"

[[constraints]]
response = "arc_share"
at_most = 0.05

[[objectives]]
response = "machining_time_s"
"""


def test_what_confirmation_has_refuted_is_not_recommended_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made(tmp_path, CLEAN)
    tell(folder)
    refuted: list[object] = []
    for _ in range(4):
        best = recommended(folder.read())
        assert best.settings not in refuted
        assert (
            "Settings whose confirmation did not keep arc_share ≤ 0.05 are left out" in best.basis
        ) == bool(refuted)
        assert "not known to keep" not in best.basis
        refuted.append(best.settings)
        confirm(folder, best, arc_share=0.09)
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
    tell(folder)
    with folder.writer() as writer:
        for run, ra_um in zip(folder.read().runs, (0.0, 0.4, 0.1, 0.0, 0.3, 0.4, 0.0, 0.2), strict=True):
            writer.told(run, {"ra_um": ra_um})
    state = folder.read()
    responses = analysis_of(state).responses
    found = [expected_at(state, responses, run.planned.settings)["ra_um"] for run in state.runs]
    assert all(0.0 <= low <= value <= high <= 0.4 for value, low, high in found)
    assert min(low for _, low, _ in found) == 0.0
    assert max(high for *_, high in found) == 0.4
