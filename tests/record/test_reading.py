"""What is read from a run file: events, results, the estimate of a hole without one; and what cannot be opened."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.labels import Basis, Verdict
from edmctl.machine.interface import EventCode, MachineState
from edmctl.record.layout import RESULTS
from edmctl.record.opening import open_file
from edmctl.record.reader import (
    JUMP_DONE,
    TOUCH,
    RecordedState,
    RunFile,
    estimated_depth,
    open_run,
    read_head,
    reading,
    recorded_events,
    sites_of,
)
from edmctl.record.rows import EventLevel, EventRow, Row, RunEvent
from edmctl.results.declared import quantities, stored_columns
from edmctl.results.job import SiteResult
from tests.record.samples import a_site_row, finished, slow_row


def test_every_code_and_state_is_that_of_its_writer() -> None:
    assert (JUMP_DONE, TOUCH) == (EventCode.JUMP_DONE, EventCode.TOUCH)
    assert len({int(code) for code in (*EventCode, *RunEvent)}) == len(EventCode) + len(RunEvent)
    assert [(state.name, int(state)) for state in RecordedState] == [
        (state.name, int(state)) for state in MachineState
    ]


@pytest.mark.parametrize(
    ("content", "why", "hint"),
    [
        (None, r"no run file .*x\.h5", "run list"),
        (b"partial", r"no run file .*x\.h5", "x.h5.partial"),
        (b"", "is empty", ".h5.partial"),
        (b"not HDF5 at all" * 100, "not an HDF5 file", ".h5.partial"),
        ("other/9", "not a run file of edmctl", ".h5.partial"),
    ],
)
def test_what_is_no_run_file_is_refused(
    tmp_path: Path, content: bytes | str | None, why: str, hint: str
) -> None:
    path = tmp_path / "x.h5"
    if isinstance(content, str):
        with h5py.File(path, "w") as file:
            file.attrs["schema"] = content
    elif content is not None:
        path.with_name("x.h5.partial" if content == b"partial" else "x.h5").write_bytes(content)
    with pytest.raises(RunFileError, match=why) as refusal:
        open_run(path)
    assert (refusal.value.code, hint in refusal.value.hint) == ("E9005", True)


def test_an_earlier_layout_is_refused(run_path: Path) -> None:
    with h5py.File(run_path, "r+") as file:
        file.attrs["schema"] = "edmctl-run/1"
    with pytest.raises(RunFileError, match="earlier version") as refused, reading(run_path, verify=False):
        pass
    assert (refused.value.code, "export" in refused.value.hint) == ("E9006", True)


def test_a_run_file_without_its_group_is_damaged(run_path: Path) -> None:
    with h5py.File(run_path, "r+") as file:
        del file["entry"]
    with pytest.raises(RunFileError, match="no group /entry") as refused:
        open_file(run_path, verify=False)
    assert refused.value.code == "E9007"


def test_columns_are_cut_to_the_shortest(run_path: Path) -> None:
    with h5py.File(run_path, "r+") as file:
        values = file["/entry/servo/s"][:9_000]
        del file["/entry/servo/s"]
        file["/entry/servo/s"] = values
    with reading(run_path, verify=False) as run:
        servo = run.columns("/entry/servo")
    assert {len(column) for column in servo.values()} == {9_000}
    np.testing.assert_array_equal(servo["time"], 0.01 * np.arange(9_000))


class Held:
    """As much of a run file as events are read from."""

    def table(self, path: str, start: int = 0) -> np.ndarray:
        assert path == "/entry/events"
        events = [
            (1.0, int(JUMP_DONE), 0, b"Jumped.", b'{"height_um": 60.5, "asked": true}'),
            (2.0, 32000, 2, "Half a \u00b5".encode()[:-1], b'{"code": "E6'),
            (3.0, int(RunEvent.SITE_MEASURED), 1, b"Measured.", b""),
        ]
        kinds = [("time", "f8"), ("code", "i4"), ("level", "i4"), ("message", "S40"), ("args", "S60")]
        return np.array(events, kinds)[start:]


def test_an_event_whose_texts_were_damaged_still_happened() -> None:
    run: RunFile = Held()  # type: ignore[assignment]
    jumped, damaged, measured = recorded_events(run)
    assert (jumped.code, jumped.message) == (JUMP_DONE, "Jumped.")
    assert (jumped.number("height_um"), jumped.number("asked")) == (60.5, 1.0)
    assert (damaged.code, damaged.level, damaged.message, damaged.values) == (32000, 2, "Half a ", {})
    assert math.isnan(measured.number("depth_um"))
    wanted = recorded_events(run, RunEvent.SITE_MEASURED, JUMP_DONE)
    assert [event.time_s for event in wanted] == [1.0, 3.0]
    assert [event.time_s for event in recorded_events(run, start=1)] == [2.0, 3.0]


def machined(from_s: float, to_depth_um: float) -> list[Row]:
    """Ten rows of a hole, the last without an estimate."""
    depths_um = [*(to_depth_um * k / 9 for k in range(1, 10)), math.nan]
    return [
        replace(slow_row(k), time_s=from_s + 0.1 * k, depth_um=depth_um, depth_u95_um=0.04 * depth_um)
        for k, depth_um in enumerate(depths_um, 1)
    ]


MEASURED = [EventRow(30.0, RunEvent.SITE_MEASURED, EventLevel.INFO, "", {"depth_um": 20.0}), a_site_row()]


@pytest.mark.parametrize(
    ("rows", "exit_code", "depth_um"),
    [
        (machined(10.0, 153.0), 6, 153.0),
        ([*machined(10.0, 20.0), *MEASURED], 6, math.nan),
        ([*machined(10.0, 20.0), *MEASURED, *machined(40.0, 7.0)], 6, 7.0),
        (machined(10.0, 153.0), 0, math.nan),
        ([], 6, math.nan),
    ],
    ids=["left", "measured", "left after a measured one", "done", "nothing machined"],
)
def test_a_hole_that_was_left_has_its_last_estimate(
    tmp_path: Path, rows: list[Row], exit_code: int, depth_um: float
) -> None:
    path = finished(tmp_path / "a.h5", *rows, end=("ended", exit_code))
    with open_run(path) as run:
        found = estimated_depth(run)
    assert (found.depth_um, found.depth_u95_um) == pytest.approx((depth_um, 0.04 * depth_um), nan_ok=True)
    head = read_head(path)
    assert (head.est_depth_um, head.est_depth_u95_um) == pytest.approx(
        (found.depth_um, found.depth_u95_um), nan_ok=True
    )
    assert math.isnan(head.depth_um) == (MEASURED[1] not in rows)


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    labels = {"depth_basis": Basis.ESTIMATED, "verdict": Verdict.NOT_SHOWN, "drift_by_rests": True}
    row = replace(a_site_row(), **labels, depth_u_um=0.4)  # type: ignore[arg-type]
    with open_run(finished(tmp_path / "run.h5", row)) as run:
        (site,) = sites_of(run)
    stored = {one.source.partition(".")[0] for one in stored_columns(SiteResult)}
    read = {name: getattr(site, name) for name in quantities(SiteResult) if name in stored}
    assert str(read) == str({name: getattr(row, name) for name in read})  # NaN is NaN
    assert (site.length_um, site.truth.is_known) == (row.depth_um, False)


def test_columns_that_a_file_does_not_have_are_unknown(run_path: Path) -> None:
    with h5py.File(run_path, "r+") as file:
        rows = file[RESULTS.path][:]
        names = [name for name in rows.dtype.names if name not in ("wear_basis", "face", "stops")]
        del file[RESULTS.path]
        file.create_dataset(RESULTS.path, data=rows[names].astype([(n, rows.dtype[n]) for n in names]))
    with reading(run_path, verify=False) as run:
        (site,) = sites_of(run)
    assert (site.wear_basis, site.measuring_stops, site.depth_um) == (Basis.ESTIMATED, 0, 180.0)
    assert math.isnan(site.face_um)


def test_the_head_of_a_run_has_the_weakest_basis_and_the_worst_verdict(tmp_path: Path) -> None:
    good = replace(a_site_row(), depth_basis=Basis.TOUCHED, wear_basis=Basis.TOUCHED, verdict=Verdict.SHOWN)
    missed = replace(good, name="A2", depth_basis=Basis.ESTIMATED, verdict=Verdict.MISSED)
    not_shown = replace(good, name="A3", verdict=Verdict.NOT_SHOWN)
    head = read_head(finished(tmp_path / "run.h5", good, missed, not_shown))
    assert (head.depth_basis, head.wear_basis, head.verdict) == ("estimated", "touched", "missed")
