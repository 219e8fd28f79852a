"""`edmctl machine --resume`: channels and holes through a sheet, which have more to tell than one bottom."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.errors import RunFileError
from edmctl.planning.channel import way_of_path
from edmctl.planning.rules.load import load_profile
from edmctl.record.bench_file import read_bench
from edmctl.record.journal import read_journal, write_journal
from edmctl.record.ledger import Ledger, SiteMachined, history_of
from edmctl.record.reader import open_run
from edmctl.record.rows import RunEvent
from edmctl.simulator.plant_records import TICK_S
from edmctl.simulator.saving import restored_bench
from edmctl.simulator.work_under_tool import Chip
from tests.cli.commands import ROOT
from tests.cli.left_jobs import (
    BENCH,
    RESUME,
    at_event,
    at_time_of_cut,
    at_time_of_run,
    bench_changed,
    done,
    error_of,
    killed_at,
    lengthen_tool,
    refused,
    snapshot_and_stop,
    stop,
    swap_work,
    taken_over,
)
from tests.tiers import tiers

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from edmctl.process.channel import Way
    from edmctl.record.journal import Journal
    from edmctl.simulator import VirtualBench
    from tests.cli.commands import Here

    LeaveAt = Callable[[float], Journal]

CHANNEL = (
    "machine",
    *("--profile", str(ROOT / "profiles" / "channel-circle.toml")),
    *("--set", "path.radius_um=150", "--set", "target.depth_um=6", "--set", 'log.pulses="off"'),
)
DEPTH_UM, TOLERANCE_UM = 6.0, 2.0
FOIL = (
    "machine",
    *("--profile", str(ROOT / "profiles" / "foil-through.toml")),
    *("--set", 'log.pulses="off"'),
)


@pytest.fixture
def left_at(here: Here, tmp_path_factory: pytest.TempPathFactory) -> LeaveAt:
    """Return what leaves a channel that was killed so long after its first cut began in the folder of the test."""
    times_s = (0.0, 2.0, 20.0, 30.0, 45.0, 60.0, 130.0, 160.0)
    killed = killed_at(tmp_path_factory, "channel", (*CHANNEL, "--seed", "4"), times_s)
    return lambda seconds: taken_over(killed[seconds])


@pytest.fixture
def foil_left_at(here: Here, tmp_path_factory: pytest.TempPathFactory) -> LeaveAt:
    """Return the same for a hole through a sheet."""
    times_s = (5.0, 10.0, 40.0, 66.0, 75.0, 95.0)
    killed = killed_at(tmp_path_factory, "through-hole", (*FOIL, "--seed", "4"), times_s)
    return lambda seconds: taken_over(killed[seconds])


def way_of_channel() -> Way:
    """The way of the channel's tool."""
    path = load_profile("channel-circle", ("path.radius_um=150",)).profile.path
    assert path is not None
    return way_of_path(path)


def channel_of(result: dict[str, Any]) -> dict[str, Any]:
    """The finished channel of a result, which is as deep as it says and as it was to be."""
    channel: dict[str, Any] = result["channel"]
    truth = channel["truth"]
    assert channel["finished"]
    assert abs(truth["depth_um"] - DEPTH_UM) <= TOLERANCE_UM
    assert abs(channel["depth_um"] - truth["depth_um"]) <= channel["depth_u95_um"]
    assert abs(channel["wear_um"] - truth["wear_um"]) <= channel["wear_u95_um"]
    return channel


@pytest.mark.parametrize("seconds", tiers(45.0, full=(2.0, 130.0, 160.0)))
def test_a_channel_is_finished_wherever_it_was_left(here: Here, left_at: LeaveAt, seconds: float) -> None:
    journal = left_at(seconds)
    assert journal.state["begun"]
    dry = here(*RESUME, *BENCH, "--dry-run").document["result"]["resumed"]
    assert dry["left"] == ["channel-circle"]
    channel = channel_of(done(here(*RESUME, *BENCH)))
    assert channel["passes"] > journal.state["cuts"]
    assert channel["pulses"] > sum(journal.state["counts"])  # type: ignore[call-overload]
    assert channel["machining_time_s"] > journal.state["machining_time_s"]
    assert not list(Path("runs").glob("*.journal"))
    lines = [line.entry for line in Ledger.open(Path("runs")).lines]
    rows = [entry for entry in lines if isinstance(entry, SiteMachined) and entry.run_file == "a-r1.h5"]
    assert rows[0].wear_um == pytest.approx(channel["wear_um"], abs=1e-3)
    assert rows[0].depth_um == pytest.approx(channel["depth_um"], abs=1e-3)
    with open_run(Path("runs/a-r1.h5")) as run:
        worn_um, u95_um = (run.column("/entry/slow", name) for name in ("est_wear", "est_wear_u95"))
    assert np.isfinite(worn_um).any()
    assert (np.isfinite(u95_um) == np.isfinite(worn_um)).all()


@pytest.mark.slow
def test_a_channel_that_was_left_before_its_first_pass_is_made_from_its_face(here: Here) -> None:
    with at_time_of_run(40.0, stop):
        assert here(*CHANNEL, *BENCH, "--seed", "4", "--run-id", "a", "--quiet").exit_code == 130
    assert not read_journal(Path("runs/a.journal")).state["begun"]
    channel_of(done(here(*RESUME, *BENCH)))


@pytest.mark.slow
def test_a_channel_may_be_interrupted_again_and_again(here: Here, left_at: LeaveAt) -> None:
    left_at(30.0)
    home = Path.cwd()
    for number in (1, 2):
        snapshot = home.with_name(f"{home.name}-killed-{number}")
        with at_time_of_cut(20.0, snapshot_and_stop(home, snapshot)):
            assert here(*RESUME, *BENCH).exit_code == 130
        for entry in home.iterdir():
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        shutil.copytree(snapshot, home, dirs_exist_ok=True)
        shutil.rmtree(snapshot)
    channel_of(done(here(*RESUME, *BENCH)))


@pytest.mark.parametrize("hours", tiers(full=(1.6, 10.0)))
def test_a_channel_that_stood_for_hours_is_taken_up(here: Here, left_at: LeaveAt, hours: float) -> None:
    """By then the sensor may have drifted by more than the tool is clear: what is under the tool is touched."""
    left_at(20.0)

    def wait(bench: VirtualBench) -> None:
        bench.plant.unit.sensor_drift_um_s = 0.0
        bench.plant.readings.tick += int(hours * 3600.0 / TICK_S)

    bench_changed(wait)
    channel_of(done(here(*RESUME, *BENCH)))


@pytest.mark.slow
def test_a_stop_right_after_the_take_up_is_a_stop(here: Here, left_at: LeaveAt) -> None:
    """No pulse of the channel was counted by then."""
    left_at(0.0)
    with at_event(RunEvent.RESUMED, stop):
        said = here(*RESUME, *BENCH)
    assert said.exit_code == 130, said.out
    assert here(*RESUME, *BENCH).exit_code == 0


@pytest.mark.parametrize("height_um", tiers(full=(6.0, 10.0, 18.0)))
def test_a_chip_on_the_floor_spoils_no_channel(here: Here, left_at: LeaveAt, height_um: float) -> None:
    left_at(130.0)

    def drop(bench: VirtualBench) -> None:
        bench.plant.leave()
        x_um, y_um = way_of_channel().at(78.5)
        bench.plant.chips.lying.append(Chip(x_um, y_um, height_um, 0.5))
        bench.plant.arrive()

    bench_changed(drop)
    assert channel_of(done(here(*RESUME, *BENCH)))["depth_u95_um"] < 1.0


@pytest.mark.slow
def test_the_books_have_the_wear_of_every_channel(here: Here) -> None:
    """Also of a ring whose last point is its first but for rounding."""
    for radius_um, run_id in ((150, "a"), (155, "b")):
        order = (*CHANNEL, "--set", f"path.radius_um={radius_um}", "--seed", "4", "--run-id", run_id)
        said = here(*order, "--port", f"sim:{run_id}.h5", "--out", run_id, "--json", "--quiet")
        lines = Ledger.open(Path(run_id)).lines
        (account,) = history_of(lines, lines[0].serial).tools.values()
        assert account.lost_um == pytest.approx(said.document["result"]["channel"]["wear_um"], abs=1e-3)


@pytest.mark.slow
def test_a_resume_that_fails_before_anything_moves_can_be_said_again(
    here: Here, left_at: LeaveAt, monkeypatch: pytest.MonkeyPatch
) -> None:
    left_at(60.0)

    def full(*_: object, **__: object) -> None:
        raise RunFileError("The disk is full.", hint="Make room.", code="E9030")

    for place in ("edmctl.record.journal.write_journal", "edmctl.record.ledger.Ledger.append"):
        with monkeypatch.context() as patch:
            patch.setattr(place, full)
            assert here(*RESUME, *BENCH).exit_code == 9
    channel_of(done(here(*RESUME, *BENCH)))


@pytest.mark.slow
def test_a_journal_that_was_not_removed_yet_stands_for_the_newer_one(here: Here, left_at: LeaveAt) -> None:
    journal = left_at(60.0)
    with at_time_of_cut(10.0, stop):
        assert here(*RESUME, *BENCH).exit_code == 130
    write_journal(Path("runs/a.journal"), journal)
    said = here(*RESUME, *BENCH)
    assert said.exit_code == 0, said.out
    assert said.document["run_file"] == "runs/a-r2.h5"


def test_a_job_that_was_done_but_not_closed_is_recovered(here: Here, left_at: LeaveAt) -> None:
    left_at(60.0)
    Path("runs/a.journal").unlink()
    error = error_of(here(*RESUME, *BENCH))
    assert error["code"] == "E8050"
    assert "`edmctl run recover runs/a.h5.partial`" in str(error["hint"])


@pytest.mark.slow
def test_other_work_under_a_channel_is_refused(here: Here, left_at: LeaveAt) -> None:
    left_at(130.0)
    bench_changed(swap_work)
    assert "Put the workpiece back" in refused(here, "E8060")


@pytest.mark.slow
def test_a_channel_that_is_hardly_begun_may_be_on_other_work_and_is_told_wider(
    here: Here, left_at: LeaveAt
) -> None:
    left_at(2.0)
    own = channel_of(done(here(*CHANNEL, "--seed", "4", "--json", "--quiet")))
    bench_changed(swap_work)
    taken_up = channel_of(done(here(*RESUME, *BENCH)))
    assert taken_up["depth_u95_um"] > 1.1 * own["depth_u95_um"]


@pytest.mark.parametrize("way_um", tiers(20.0, full=(-25.0,)))
def test_another_tool_in_a_channel_is_refused(here: Here, left_at: LeaveAt, way_um: float) -> None:
    left_at(130.0)
    bench_changed(lengthen_tool(way_um))
    refused(here, "E8061")


def test_no_channel_is_restarted(here: Here, left_at: LeaveAt) -> None:
    left_at(30.0)
    error = error_of(here(*RESUME, *BENCH, "--restart-hole"))
    assert error["code"] == "E8062"
    assert "makes holes anew" in str(error["message"])


@pytest.mark.slow
def test_a_sheet_that_is_thicker_than_believed_is_no_other_tool(here: Here) -> None:
    """Its bottom lies deeper than the believed back, and the tool is worn by all that was cut."""
    thick = ("approach", *FOIL[1:], "--set", "work.thickness_um=70", "--contact", "--seed", "4")
    assert here(*thick, *BENCH, "--quiet").exit_code == 0
    with at_time_of_cut(104.0, stop):
        assert here(*FOIL, *BENCH, "--run-id", "a", "--quiet").exit_code == 130
    state = read_journal(Path("runs/a.journal")).state
    assert float(state["depth_um"]) > 53.0  # type: ignore[arg-type]
    said = here(*RESUME, *BENCH)
    # Cut through at 70 µm: the sparks end where the recipe knows of no back. Then it is found open.
    assert said.exit_code == 6, said.out
    assert error_of(said)["code"] == "E63005"
    said = here(*RESUME, *BENCH)
    assert said.exit_code == 0, said.out
    assert said.document["result"]["sites"][0]["through"]


@pytest.mark.parametrize("seconds", tiers(66.0, slow=(95.0,), full=(5.0, 40.0, 75.0)))
def test_a_hole_through_a_sheet_is_finished_wherever_it_was_left(
    here: Here, foil_left_at: LeaveAt, seconds: float
) -> None:
    """In the sheet, as it opens, and behind it."""
    assert foil_left_at(seconds).state["begun"]
    (site,) = done(here(*RESUME, *BENCH))["sites"]
    assert site["through"]
    (hole,) = restored_bench(read_bench(Path("bench.h5"))).truth()
    assert hole.depth_um == pytest.approx(50.0, abs=0.1)
    assert abs(site["wear_um"] - site["truth"]["wear_um"]) <= site["wear_u95_um"]


@pytest.mark.slow
def test_a_sheet_that_was_left_just_after_the_breakthrough_is_open(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first touch meets the rim of the hole, and the approach no sparks."""
    home = Path.cwd()
    snapshot = home.with_name(f"{home.name}-killed")
    with at_event(RunEvent.BREAKTHROUGH, snapshot_and_stop(home, snapshot)):
        assert here(*FOIL, "--seed", "31", *BENCH, "--run-id", "a", "--quiet").exit_code == 130
    monkeypatch.chdir(snapshot)
    (site,) = done(here(*RESUME, *BENCH))["sites"]
    assert (site["through"], site["depth_um"]) == (True, None)
    # Of machines like this one in twenty lies outside of its 95 % interval, this one by 2.1 standard uncertainties.
    assert abs(site["wear_um"] - site["truth"]["wear_um"]) <= 3.0 * site["wear_u_um"]


def test_another_sheet_is_refused(here: Here, foil_left_at: LeaveAt) -> None:
    foil_left_at(75.0)
    bench_changed(swap_work)
    assert "Put the workpiece back" in refused(here, "E8060")


def test_a_sheet_that_is_open_where_it_cannot_be_is_refused(here: Here, foil_left_at: LeaveAt) -> None:
    """The stages stand over another hole, or the sheet is gone: the journal knows of 10 µm."""
    foil_left_at(10.0)

    def open_it(bench: Any) -> None:
        bench.plant.leave()
        for cells in bench.plant.work_under_tool.work.tiles.values():
            cells[cells > 0.0] = 50.0
        for hole in bench.plant.work_under_tool.holes:
            hole.depth_um = 50.0
        bench.plant.arrive()

    bench_changed(open_it)
    refused(here, "E8060")
