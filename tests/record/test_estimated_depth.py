"""How deep a run got that left a hole without a result."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from edmctl.record.reader import RecordedCode, open_run
from edmctl.record.rows import EventLevel, EventRow, SlowRow
from edmctl.record.run_index import estimated_depth, read_head
from edmctl.record.writer import RunWriter
from tests.record.samples import a_meta, a_site_row

if TYPE_CHECKING:
    from pathlib import Path


def machined(writer: RunWriter, from_s: float, to_depth_um: float) -> None:
    """Ten rows of a hole, the last without an estimate."""
    for k in range(1, 11):
        depth_um = math.nan if k == 10 else to_depth_um * k / 9
        row = SlowRow(
            from_s + 0.1 * k,
            1.0,
            0.8,
            0.8,
            0.2,
            0.7,
            0.1,
            0.0,
            depth_um=depth_um,
            wear_um=0.5,
            power_w=math.nan,
        )
        writer.append(replace(row, depth_u95_um=0.04 * depth_um))


def result(writer: RunWriter, time_s: float) -> None:
    writer.append(
        EventRow(time_s, RecordedCode.SITE_MEASURED, EventLevel.INFO, "Measured.", {"depth_um": 20.0})
    )
    writer.append(a_site_row())


@pytest.fixture
def writer(tmp_path: Path) -> RunWriter:
    return RunWriter.create(tmp_path / "a.h5", a_meta())


def test_a_hole_that_was_left_has_its_last_estimate(writer: RunWriter) -> None:
    machined(writer, 10.0, 153.0)
    path = writer.finish("machine fault", 6)
    with open_run(path) as run:
        found = estimated_depth(run)
    assert found.depth_um == pytest.approx(153.0)
    assert found.depth_u95_um == pytest.approx(6.12)
    head = read_head(path)
    assert math.isnan(head.depth_um)
    assert (head.est_depth_um, head.est_depth_u95_um) == pytest.approx((153.0, 6.12))


def test_a_hole_with_a_result_needs_no_estimate(writer: RunWriter) -> None:
    machined(writer, 10.0, 20.0)
    result(writer, 30.0)
    with open_run(writer.finish("machine fault", 6)) as run:
        assert math.isnan(estimated_depth(run).depth_um)


def test_the_hole_after_those_with_results_is_meant(writer: RunWriter) -> None:
    machined(writer, 10.0, 20.0)
    result(writer, 30.0)
    machined(writer, 40.0, 7.0)
    with open_run(writer.finish("machine fault", 6)) as run:
        assert estimated_depth(run).depth_um == pytest.approx(7.0)


def test_a_run_that_came_to_its_end_left_nothing(writer: RunWriter) -> None:
    machined(writer, 10.0, 153.0)
    with open_run(writer.finish("done", 0)) as run:
        assert math.isnan(estimated_depth(run).depth_um)


def test_a_run_that_machined_nothing_has_no_estimate(writer: RunWriter) -> None:
    with open_run(writer.finish("machine fault", 6)) as run:
        assert math.isnan(estimated_depth(run).depth_um)
