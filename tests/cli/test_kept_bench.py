"""`sim:FILE`: a virtual bench that outlives commands, with its holes and the wear of its tools."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from edmctl.procedures.channel.scan import PassFollower
from edmctl.record import journal
from edmctl.record.bench_file import bench_lock, read_bench, write_bench
from edmctl.record.ledger import UNFINISHED, Ledger, SiteMachined, WearMeasured, history_of
from edmctl.simulator.saving import bench_state, restored_bench
from tests.cli.commands import CU270, SHALLOW, Here
from tests.cli.left_jobs import at_time_of_cut, stop
from tests.cli.test_processes import start
from tests.tiers import tiers

if TYPE_CHECKING:
    from edmctl.machine.interface import TelemetryBlock
    from edmctl.record.ledger import Entry
    from edmctl.simulator import VirtualBench

KEPT = ("--port", "sim:bench.h5")
DEEP_UM = 10.0
CU150 = str(Path(CU270).with_name("cu150.toml"))


def kept(folder: Path | None = None) -> VirtualBench:
    """The bench as it lies in its file."""
    return restored_bench(read_bench((folder or Path()) / "bench.h5"))


def test_a_second_job_needs_no_option(here: Here) -> None:
    sites = []
    for _ in range(2):
        said = here("machine", *SHALLOW, *KEPT, "--seed", "3", "--json")
        assert said.exit_code == 0, said.err
        sites += said.document["result"]["sites"]
    first, second = sites
    assert (first["x_um"], second["x_um"]) == (500.0, 1000.0)
    assert abs(second["z1_um"] - first["z3_um"]) <= 1.0
    for site in sites:
        assert abs(site["wear_um"] - site["truth"]["wear_um"]) <= 2.0 * site["wear_u95_um"]
        assert abs(site["depth_um"] - site["truth"]["depth_um"]) <= 2.0 * site["depth_u95_um"]
        assert abs(site["feed_um"] - site["truth"]["feed_um"]) <= 2.0 * site["feed_u95_um"]
    bench = kept()
    assert bench.tool_wear_um == pytest.approx(sum(site["truth"]["wear_um"] for site in sites), abs=0.01)
    assert len(bench.truth()) == 2


def test_the_seed_makes_a_new_bench_and_does_nothing_to_an_old_one(here: Here) -> None:
    first = here("approach", "--profile", CU270, "--contact", *KEPT, "--seed", "12", "--json").document
    assert (first["simulated"], first["seed"], first["warnings"]) == (True, 12, [])
    assert kept().plant.serial == "SIM-12"
    said = here("approach", "--profile", CU270, "--contact", *KEPT, "--seed", "13", "--json")
    assert said.document["seed"] is None
    (warning,) = said.document["warnings"]
    assert (warning["code"], "bench.h5" in warning["message"]) == ("W4101", True)
    assert kept().plant.serial == "SIM-12"


@pytest.mark.slow
def test_the_file_is_never_older_than_what_is_told_of_the_bench(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[float, float, bool]] = []
    write_journal, append = journal.write_journal, Ledger.append

    def journal_written(path: Path, content: journal.Journal, texts: journal.Texts | None = None) -> None:
        write_journal(path, content, texts)
        told.append((content.clock_s, kept().transport.now_s(), content.state["phase"] == "machining"))

    def line_written(book: Ledger, serial: str, *entries: Entry, bench_s: float = math.nan) -> None:
        append(book, serial, *entries, bench_s=bench_s)
        told.append((bench_s, kept().transport.now_s(), False))

    monkeypatch.setattr(journal, "write_journal", journal_written)
    monkeypatch.setattr(Ledger, "append", line_written)
    assert here("machine", *SHALLOW, *KEPT, "--seed", "3").exit_code == 0
    assert here("measure-wear", *KEPT).exit_code == 0
    assert len(told) > 10
    assert [(told_s, file_s) for told_s, file_s, _ in told if not 0.0 <= file_s - told_s <= 0.2] == []
    assert len({told_s for told_s, _, _ in told}) > 10
    assert any(cuts for _, _, cuts in told)


@pytest.mark.parametrize("lost_s", tiers(slow=(-4500.0,), full=(0.0, 4500.0)))
def test_time_that_no_command_tells_of_counts_for_the_age_of_a_reference(here: Here, lost_s: float) -> None:
    """A sensor that drifts as fast as one in seventeen does, within the 95 %, and a bench that stays under power."""
    assert here("measure-wear", "--reference", *KEPT, "--seed", "131039").exit_code == 0
    bench = kept()
    bench.plant.unit.sensor_drift_um_s = lost_s and math.copysign(1.9 / 600.0, lost_s)
    bench.controller.advance(round(1000.0 * abs(lost_s)))
    write_bench(Path("bench.h5"), bench_state(bench))
    document = here("measure-wear", *KEPT, "--json").document
    assert document["exit_code"] == 0
    result = document["result"]
    assert abs(result["wear_um"] - result["truth"]["wear_um"]) <= result["wear_u95_um"]
    assert (result["wear_u95_um"] > 3.0) == (lost_s != 0.0)


@pytest.mark.slow
def test_one_command_at_a_time_and_another_may_wait(here: Here) -> None:
    arguments = ("measure-wear", "--reference", *KEPT, "--quiet")
    with bench_lock(Path("bench.h5")):
        said = here(*arguments, "--json")
        assert said.exit_code == 9
        assert said.document["error"]["code"] == "E9023"
        assert "--wait" in said.document["error"]["hint"]
        waiting = start(*arguments, "--wait", "60", cwd=Path.cwd())
        with pytest.raises(Exception, match="timed out"):
            waiting.wait(timeout=1.5)
    _, err = waiting.communicate(timeout=60)
    assert waiting.returncode == 0, err


def test_a_file_that_is_no_bench_is_refused_and_stays(here: Here) -> None:
    Path("bench.h5").write_bytes(b"precious")
    said = here("machine", *SHALLOW, *KEPT, "--json")
    assert said.exit_code == 9
    assert said.document["error"]["code"] == "E9020"
    assert Path("bench.h5").read_bytes() == b"precious"


def test_a_bench_in_no_folder_is_refused(here: Here) -> None:
    said = here("measure-wear", "--reference", "--port", "sim:nowhere/bench.h5", "--json")
    assert said.exit_code == 9
    assert said.document["error"]["code"] == "E9024"


def test_a_port_without_a_name_is_refused(here: Here) -> None:
    said = here("machine", *SHALLOW, "--port", "", "--json")
    assert said.exit_code == 2
    assert said.document["error"]["code"] == "E2006"


@pytest.mark.slow
def test_another_tool_is_put_in_and_its_wear_is_its_own(here: Here) -> None:
    assert here("machine", *SHALLOW, *KEPT, "--seed", "3", "--quiet").exit_code == 0
    worn_um = kept().tool_wear_um
    said = here("approach", "--profile", CU150, "--contact", *KEPT)
    assert "tool changed: Cu 150 µm instead of Cu 270 µm\n" in said.err
    assert kept().tool_wear_um == 0.0
    assert here("approach", "--profile", CU270, "--contact", *KEPT).exit_code == 0
    assert kept().tool_wear_um == worn_um > 0.0


def test_the_work_stays_whatever_the_profile_says(here: Here) -> None:
    contact = ("approach", "--profile", CU270, "--contact", *KEPT)
    assert "its own work" not in here(*contact).err
    said = here(*contact, "--set", "sim.flush_time_s=3")
    assert "the bench keeps its own work, whatever [sim] says: flush_time_s = 0.5" in said.err
    assert kept().plant.config.discharge.gap.flush_time_s == 0.5


def test_a_fresh_machine_has_no_ledger(here: Here) -> None:
    for _ in range(2):
        said = here("machine", *SHALLOW, "--seed", "3", "--json", "--quiet")
        assert said.document["result"]["sites"][0]["x_um"] == 500.0
    assert not Path("runs/ledger.jsonl").exists()


def test_ctrl_c_keeps_what_was_done(here: Here) -> None:
    with at_time_of_cut(4.0, stop):
        said = here("machine", "--profile", CU270, *KEPT, "--seed", "1", "--run-id", "r")
    assert said.exit_code == 130, said.err
    assert "Go on with `edmctl machine --resume r --port sim:bench.h5`" in " ".join(said.err.split())
    bench = kept()
    assert bench.is_safe
    (hole,) = bench.truth()
    assert hole.depth_um > 0.0
    lines = [json.loads(line) for line in Path("runs/ledger.jsonl").read_text().splitlines()]
    assert [(line["kind"], line.get("status")) for line in lines][-2:] == [
        ("site", "unfinished"),
        ("end", "stopped by Ctrl-C"),
    ]
    there = f'sites=[{{kind="point",name="here",x_um={hole.x_um:.0f},y_um=0}}]'
    refused = here("machine", *SHALLOW, *KEPT, "--set", there, "--json")
    assert refused.exit_code == 8
    error = refused.document["error"]
    assert error["code"] == "E8042"
    assert "runs/r.h5" in error["message"]
    assert "--resume" in error["hint"]
    assert here("machine", *SHALLOW, *KEPT, "--json").document["result"]["sites"][0]["x_um"] == 1000.0


@pytest.mark.slow
def test_a_killed_command_leaves_the_bench_as_it_was_a_moment_before(here: Here) -> None:
    long = ("--profile", CU270, "--seed", "1", "--run-id", "r", "--events")
    process = start("machine", *long, *KEPT, cwd=Path.cwd())
    assert process.stderr is not None
    for line in process.stderr:
        if json.loads(line).get("depth_um", 0.0) > DEEP_UM:
            break
    process.kill()
    process.communicate(timeout=60)
    bench = kept()
    assert bench.is_safe
    assert bench.truth()[0].depth_um > DEEP_UM - 3.0
    said = here("machine", *SHALLOW, *KEPT, "--json")
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (8, "E8048")
    assert "the run r was killed" in error["message"]
    assert "`edmctl measure-wear --reference --profile " in error["hint"]
    assert here("measure-wear", "--json", *KEPT).document["error"]["code"] == "E8048"
    assert here("measure-wear", "--reference", *KEPT).exit_code == 0
    said = here("machine", *SHALLOW, *KEPT, "--json")
    assert said.exit_code == 0, said.err
    assert said.document["result"]["sites"][0]["x_um"] == 1000.0


@pytest.mark.slow
def test_the_ledger_tells_of_the_holes_in_the_order_they_were_made(here: Here) -> None:
    far = '{kind="point",name="far",x_um=1000,y_um=0}'
    near = '{kind="point",name="near",x_um=500,y_um=0}'
    said = here("machine", *SHALLOW, *KEPT, "--seed", "3", "--set", f"sites=[{far},{near}]", "--json")
    assert said.exit_code == 0, said.err
    made = [site["name"] for site in said.document["result"]["sites"]]
    assert made == ["near", "far"]
    lines = [json.loads(line) for line in Path("runs/ledger.jsonl").read_text().splitlines()]
    assert [line["name"] for line in lines if line["kind"] == "site"] == made
    # The hole that is touched is the last one, and the tool is found as long as that one left it.
    said = here("measure-wear", *KEPT, "--json")
    assert said.exit_code == 0, said.err
    assert said.document["result"]["site"]["name"] == "far"


def test_a_bench_that_cannot_be_kept_in_the_end_does_not_hide_the_result(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    from edmctl.errors import RunFileError
    from edmctl.jobs.persistent_simulator import KeptLine

    def full(line: KeptLine) -> None:
        raise RunFileError("Cannot keep the bench: no space.", hint="Make room.", code="E9024")

    monkeypatch.setattr(KeptLine, "end", full)
    said = here("machine", *SHALLOW, *KEPT, "--seed", "3", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (9, "E9024")
    assert len(said.document["result"]["sites"]) == 1
    assert Path(said.document["run_file"]).exists()


def test_a_bench_that_cannot_be_kept_any_more_is_told(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    from edmctl.errors import RunFileError

    calls: list[float] = []

    def full(path: Path, state: object, *, is_own: bool = False) -> None:
        calls.append(time.monotonic())
        if len(calls) > 1:
            raise RunFileError("Cannot keep the bench: no space.", hint="Make room.", code="E9024")
        write_bench(path, state, is_own=is_own)  # type: ignore[arg-type]

    monkeypatch.setattr("edmctl.jobs.persistent_simulator.write_bench", full)
    said = here("approach", "--profile", CU270, "--contact", *KEPT, "--json")
    assert said.exit_code == 9
    assert said.document["error"]["code"] == "E9024"


def test_a_refused_command_makes_no_bench_and_no_run_file(here: Here) -> None:
    said = here("measure-wear", *KEPT, "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (8, "E8041")
    assert "the tool tool" not in said.err
    assert said.document["run_file"] is None
    assert not Path("bench.h5").exists()
    assert not list(Path().glob("runs/*.h5*"))


def begun(radius_um: float = 143.0, depth_um: float = 20.0, status: str = "done") -> None:
    """Leave a bench and a ledger that tells of one hole at 500,0."""
    here_is = kept()
    hole = SiteMachined("Cu 270 µm", "old.h5", "first", 500.0, 0.0, radius_um, status, depth_um, 8.0)
    Ledger.open(Path("runs")).append(here_is.plant.serial, hole)


def test_a_new_bench_is_told_that_the_ledger_is_of_another(here: Here) -> None:
    assert here("measure-wear", "--reference", *KEPT, "--seed", "3", "--quiet").exit_code == 0
    begun()
    Path("bench.h5").unlink()
    there = ("--set", 'sites=[{kind="point",name="there",x_um=520,y_um=0}]')  # refused: no job is needed here
    said = here("machine", "--profile", CU150, *KEPT, "--seed", "3", *there, "--json")
    assert "W8116" in {warning["code"] for warning in said.document["warnings"]}, said.out


def test_a_refused_job_leaves_tool_and_run_id_as_they_were(here: Here) -> None:
    assert here("approach", "--profile", CU270, "--contact", *KEPT, "--seed", "3").exit_code == 0
    begun()
    before = Path("bench.h5").read_bytes()
    there = ("--set", 'sites=[{kind="point",name="there",x_um=520,y_um=0}]')
    for dry in ((), ("--dry-run",)):
        said = here("machine", "--profile", CU150, *KEPT, *there, "--run-id", "a", "--json", *dry)
        assert (said.exit_code, said.document["error"]["code"]) == (8, "E8042"), said.out
        assert not list(Path("runs").glob("a.*"))
    assert kept().tool_label == "Cu 270 µm"
    assert Path("bench.h5").read_bytes() == before


@pytest.mark.parametrize("how", [(), ("--contact",), ("--dry-run",)])
def test_nothing_approaches_a_hole(here: Here, how: tuple[str, ...]) -> None:
    assert here("measure-wear", "--reference", *KEPT, "--seed", "3", "--quiet").exit_code == 0
    begun()
    before = Path("bench.h5").read_bytes()
    said = here("approach", "--profile", CU270, *KEPT, "--site", "520,0", *how, "--json")
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (8, "E8042")
    assert "runs/old.h5" in error["message"]
    assert Path("bench.h5").read_bytes() == before


@pytest.mark.parametrize(
    ("limit", "code"), [("target.depth_um=75", "E8044"), ("tool.max_wear_um=9", "E8043")]
)
def test_wear_of_another_bench_with_the_seed_has_its_own_remedy(here: Here, limit: str, code: str) -> None:
    assert here("approach", "--profile", CU270, "--contact", *KEPT, "--seed", "3").exit_code == 0
    begun()
    job = ("machine", "--profile", CU270, "--set", "target.depth_um=10", "--set", limit, "--seed", "3", *KEPT)
    if code == "E8044":
        pad = WearMeasured("Cu 270 µm", "old.h5", 300.0, 250.0, 0.5)
        Ledger.open(Path("runs")).append(kept().plant.serial, pad)
    for is_new in (False, True):
        if is_new:
            Path("bench.h5").unlink()
        error = here(*job, "--json").document["error"]
        assert error["code"] == code
        assert ("--seed" in error["hint"], "--new-tool" in error["hint"]) == (is_new, not is_new)
    own = here("machine", "--profile", CU270, "--set", "tool.max_wear_um=9", "--json").document["error"]
    assert "--seed" not in own["hint"]


def test_a_worn_tool_that_is_too_short_for_the_job_may_still_look_for_the_surface(here: Here) -> None:
    assert here("approach", "--profile", CU270, "--contact", *KEPT, "--seed", "3").exit_code == 0
    begun()
    pad = WearMeasured("Cu 270 µm", "old.h5", 300.0, 250.0, 0.5)
    Ledger.open(Path("runs")).append(kept().plant.serial, pad)
    deep = ("--profile", CU270, "--set", "target.depth_um=75", "--dry-run", "--json")
    assert here("machine", *deep, *KEPT).document["error"]["code"] == "E8044"
    said = here("approach", *deep, *KEPT)
    assert said.exit_code == 0, said.out
    assert said.document["result"]["forecast"]["x_um"] == 1000.0


def test_a_reference_without_a_profile_is_that_of_the_first_job_with_such_a_tool(here: Here) -> None:
    assert here("measure-wear", "--reference", *KEPT, "--seed", "3", "--quiet").exit_code == 0
    (run_file,) = Path("runs").glob("*.h5")
    assert "cu270" not in run_file.name
    other = here("machine", "--profile", CU150, *KEPT, "--dry-run", "--json")
    assert [warning["code"] for warning in other.document["warnings"]] == ["W8114"]
    assert here("machine", "--profile", CU270, *KEPT, "--dry-run", "--json").document["warnings"] == []
    said = here("approach", "--profile", CU270, "--contact", *KEPT)
    assert "tool changed" not in said.err
    assert kept().tool_label == "Cu 270 µm"
    history = history_of(Ledger.open(Path("runs")).lines, kept().plant.serial)
    reference = history.account("Cu 270 µm").reference
    assert reference is not None
    assert reference.run_file == run_file.name


def test_a_dry_run_says_what_it_did_not_look_at(here: Here) -> None:
    said = here("machine", *SHALLOW, "--port", "sim:not-there.h5", "--dry-run", "--json")
    assert said.exit_code == 0
    assert said.err.count("\n") == 2
    assert "not looked at" in said.err
    assert here("machine", *SHALLOW, "--dry-run", "--json").err.count("\n") == 1
    assert not Path("not-there.h5").exists()


def test_a_hole_is_named_by_its_run_too(here: Here) -> None:
    assert here("measure-wear", "--reference", "--profile", CU270, *KEPT, "--seed", "3").exit_code == 0
    begun()
    assert here("measure-wear", "--site", "old", "--profile", CU270, *KEPT, "--dry-run").exit_code == 0
    said = here("measure-wear", "--site", "nowhere", *KEPT, "--dry-run", "--json")
    assert said.document["error"]["code"] == "E8045"
    assert "first at 500,0 of old" in said.document["error"]["message"]


def test_nobody_is_told_to_finish_a_run_that_cannot_go_on(here: Here) -> None:
    assert here("measure-wear", "--reference", "--profile", CU270, *KEPT, "--seed", "3").exit_code == 0
    begun(depth_um=math.nan, status=UNFINISHED)
    error = here("measure-wear", "--site", "first", *KEPT, "--dry-run", "--json").document["error"]
    assert "how deep first is" in error["message"]
    assert "--resume" not in error["hint"]


def test_a_command_without_a_profile_is_filed_under_its_own_name_and_the_tool_it_found(here: Here) -> None:
    assert here("measure-wear", "--reference", "--profile", CU150, *KEPT, "--seed", "3").exit_code == 0
    assert here("measure-wear", *KEPT, "--run-id", "w").exit_code == 0
    (run,) = (run for run in here("run", "list", "--json").document["result"]["runs"] if run["run_id"] == "w")
    assert run["name"] == "measure-wear"
    told = here("run", "show", "runs/w.h5").out
    assert "a Cu tool of 150 µm" in told
    assert "Touched the reference pad at" in told
    assert "270" not in told


@pytest.mark.parametrize("stop_s", tiers(slow=(420.0,), full=(900.0,)))
def test_a_channel_that_is_stopped_is_told_by_estimate(
    here: Here, monkeypatch: pytest.MonkeyPatch, stop_s: float
) -> None:
    take, asked = PassFollower.on_telemetry, list[float]()

    def watched(follower: PassFollower, block: TelemetryBlock) -> None:
        take(follower, block)
        if block.time_s[-1] > stop_s and not asked:
            asked.append(stop_s)
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(PassFollower, "on_telemetry", watched)
    said = here("machine", "--profile", "channel-spiral", *KEPT, "--seed", "4", "--json", "--quiet")
    assert said.exit_code == 130
    channel = said.document["result"]["channel"]
    assert (channel["depth_basis"], channel["wear_basis"]) == ("estimated", "estimated")
    for name in ("depth", "wear"):
        off_um = channel[f"{name}_um"] - channel["truth"][f"{name}_um"]
        assert abs(off_um) <= channel[f"{name}_u95_um"]
    # Sums are of all passes, and the floor of an earlier depth is no floor of this one.
    assert 0.0 < 1.0 - channel["machining_time_s"] / said.document["result"]["machining_time_s"] < 0.2
    assert channel["floor"] == []
    assert channel["layers"] >= 2
    shown = here("run", "show", str(next(Path("runs").glob("*.h5"))), "--json").document["result"]
    assert [(site["depth_um"], site["depth_basis"]) for site in shown["sites"]] == [
        (pytest.approx(channel["depth_um"]), "estimated")
    ]
    history = history_of(Ledger.open(Path("runs")).lines, "SIM-4")
    assert {hole.status for hole in history.holes} == {UNFINISHED}
    (tool,) = history.tools.values()
    assert tool.worn_um == pytest.approx(channel["wear_um"], abs=0.01)


def test_a_dry_run_is_refused_as_the_job_would_be_where_no_bench_can_be_kept(here: Here) -> None:
    for more in ((), ("--dry-run",)):
        said = here("machine", *SHALLOW, "--port", "sim:nosuch/b.h5", "--json", *more)
        assert (said.exit_code, said.document["error"]["code"]) == (9, "E9024")


@pytest.mark.parametrize(
    "words",
    [
        ("approach", "--profile", CU270, "--port", "sim:b.h5", "--controller", "stm32"),
        ("machine", "--profile", CU270, "--port", "sim:b.h5", "--set", "sim.controller=stm32"),
        ("simulate", "serve", "--controller", "stm32", "--bench", "b.h5", "--link", "edm"),
        ("first-start", "--yes", "--port", "sim:b.h5", "--controller", "stm32"),
    ],
)
def test_an_emulated_board_is_not_kept_in_a_file(words: tuple[str, ...], here: Here) -> None:
    said = here(*words, "--json")
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (2, "E2049")
    assert "cannot be kept in b.h5" in error["message"]
    assert "--controller firmware" in error["hint"]
    assert not list(Path.cwd().iterdir())
