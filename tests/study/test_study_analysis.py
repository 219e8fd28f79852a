"""What an analysis says of the runs that are there, and of what stands beside them."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from edmctl.study.analysis import analysis_of
from edmctl.study.report.page import render_study_page
from edmctl.study.reporting import StudyReport
from edmctl.study.running import bare_row, lost_row
from tests.study.studies import SMALL, made

if TYPE_CHECKING:
    from pathlib import Path

TWICE = SMALL.replace('kind = "full"', 'kind = "full"\nreplicates = 2')


def test_what_a_hand_has_measured_is_not_set_beside_a_truth_of_that_name(tmp_path: Path) -> None:
    folder = made(tmp_path, TWICE)
    with folder.writer() as writer:
        for n, run in enumerate(folder.read().runs):
            own = {"machining_time_s": 40.0 + n % 3, "wear_ratio_lin": 0.3 + n % 4 / 100}
            truth = {"wear_ratio_lin": 0.3 + n % 5 / 100, "ra_um": 0.2 + n % 3 / 100}
            row = bare_row(run.planned, 1, run.planned.seed, datetime.now(UTC))
            writer.run(replace(row, responses=own, truth=truth))
            writer.told(run, {"ra_um": 0.4 + n % 3 / 100})
    assert set(analysis_of(folder.read()).truths) == {"wear_ratio_lin"}


def test_a_factor_with_one_level_left_has_no_table_of_levels(tmp_path: Path) -> None:
    folder = made(tmp_path, TWICE)
    with folder.writer() as writer:
        for n, run in enumerate(folder.read().runs):
            row = bare_row(run.planned, 1, run.planned.seed, datetime.now(UTC))
            if run.planned.settings["pulse.duty"] == 0.4:
                row = lost_row(run.planned, 1, "E4001: a short", 4)
            writer.run(replace(row, responses={"machining_time_s": 40.0 + n % 3} if row.ok else {}))
    state = folder.read()
    found = analysis_of(state)
    time = found.responses[0]
    assert [one.factor for one in time.level_means] == ["reference"]
    assert [one.factor for one in time.noise_means] == ["reference"]
    assert not time.interactions
    assert "only one level of duty has a value" in time.notes
    assert "too many different values" not in render_study_page(StudyReport(found, state.runs))
