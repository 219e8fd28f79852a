"""`sim:FILE`: a virtual bench that outlives commands, with its holes and the wear of its tools."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
from pathlib import Path
from typing import NoReturn

import pytest

from edmctl.errors import RunFileError
from edmctl.jobs.persistent_simulator import KeptLine
from edmctl.machine.interface import TelemetryBlock
from edmctl.procedures.channel.layers import PassFollower
from edmctl.record import journal
from edmctl.record.bench_file import bench_lock, read_bench, write_bench
from edmctl.record.ledger import UNFINISHED, Entry, Ledger, SiteMachined, WearMeasured, history_of
from edmctl.simulator import VirtualBench
from edmctl.simulator.saving import bench_state, restored_bench
from tests.cli.commands import CU270, SHALLOW, Here, start
from tests.cli.left_jobs import at_time_of_cut, stop
from tests.golden import once
from tests.tiers import tiers

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


def test_the_seed_makes_a_new_bench_and_an_old_one_keeps_machine_and_work(here: Here) -> None:
    contact = ("approach", "--profile", CU270, "--contact", *KEPT, "--json")
    first = here(*contact, "--seed", "12")
    document = first.document
    assert (document["simulated"], document["seed"], document["warnings"]) == (True, 12, [])
    assert "its own values" not in first.err
    said = here(*contact, "--seed", "13", "--set", "sim.flush_time_s=3")
    assert said.document["seed"] is None
    (warning,) = said.document["warnings"]
    assert (warning["code"], "bench.h5" in warning["message"]) == ("W4101", True)
    assert "the bench keeps its own values, whatever the profile says: flush_time_s = 0.5" in said.err
    bench = kept()
    assert bench.plant.serial == "SIM-12"
    assert bench.plant.config.discharge.gap.flush_time_s == 0.5


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


STM32 = ("--controller", "stm32")


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("machine", *SHALLOW, "--port", "sim:precious"), "E9020"),
        (("machine", *SHALLOW, "--port", "sim:nowhere/b.h5"), "E9024"),
        (("machine", *SHALLOW, "--port", "sim:nowhere/b.h5", "--dry-run"), "E9024"),
        (("measure-wear", "--reference", "--port", "sim:nowhere/b.h5"), "E9024"),
        (("machine", *SHALLOW, "--port", ""), "E2006"),
        (("measure-wear", "--port", "sim:b.h5"), "E8041"),
        (("approach", "--profile", CU270, "--port", "sim:b.h5", *STM32), "E2049"),
        (("machine", "--profile", CU270, "--port", "sim:b.h5", "--set", "sim.controller=stm32"), "E2049"),
        (("simulate", "serve", *STM32, "--bench", "b.h5", "--link", "edm"), "E2049"),
        (("first-start", "--yes", "--port", "sim:b.h5", *STM32), "E2049"),
    ],
)
def test_what_cannot_be_kept_is_refused_and_nothing_is_made(
    here: Here, words: tuple[str, ...], code: str
) -> None:
    Path("precious").write_bytes(b"mine")
    said = here(*words, "--json")
    error = said.document["error"]
    assert (said.exit_code, error["code"], said.document["run_file"]) == (int(code[1]), code, None)
    if code == "E2049":
        assert "cannot be kept in b.h5" in error["message"]
        assert "--controller firmware" in error["hint"]
    assert Path("precious").read_bytes() == b"mine"
    assert not [path for path in Path().rglob("*") if path.is_file() and path.name != "precious"]


@pytest.mark.slow
def test_another_tool_is_put_in_and_its_wear_is_its_own(here: Here) -> None:
    assert here("machine", *SHALLOW, *KEPT, "--seed", "3", "--quiet").exit_code == 0
    worn_um = kept().tool_wear_um
    said = here("approach", "--profile", CU150, "--contact", *KEPT)
    assert "tool changed: Cu 150 µm instead of Cu 270 µm\n" in said.err
    assert kept().tool_wear_um == 0.0
    assert here("approach", "--profile", CU270, "--contact", *KEPT).exit_code == 0
    assert kept().tool_wear_um == worn_um > 0.0


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


def test_a_bench_that_cannot_be_kept_does_not_hide_the_result(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> NoReturn:
        raise RunFileError("Cannot keep the bench: no space.", hint="Make room.", code="E9024")

    contact = ("approach", "--profile", CU270, "--contact", *KEPT, "--json")
    with monkeypatch.context() as patch:
        patch.setattr(KeptLine, "end", full)
        said = here(*contact, "--seed", "3")
        assert (said.exit_code, said.document["error"]["code"]) == (9, "E9024")
        assert said.document["result"]["displacement_um"] > 0.0
        assert Path(said.document["run_file"]).exists()
    monkeypatch.setattr("edmctl.jobs.persistent_simulator.write_bench", full)
    said = here(*contact)
    assert (said.exit_code, said.document["error"]["code"]) == (9, "E9024")


@pytest.fixture
def begun(here: Here, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Leave a bench with a reference, and a ledger that tells of one hole at 500,0 made since."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            reference = ("measure-wear", "--reference", "--profile", CU270)
            assert here(*reference, *KEPT, "--seed", "3", "--quiet").exit_code == 0

    shutil.copytree(once(tmp_path_factory, "kept-bench", make), Path.cwd(), dirs_exist_ok=True)
    ledger_goes_on(SiteMachined("Cu 270 µm", "old.h5", "first", 500.0, 0.0, 143.0, "done", 20.0, 8.0))


def ledger_goes_on(entry: Entry) -> None:
    Ledger.open(Path("runs")).append("SIM-3", entry)


SHORT = WearMeasured("Cu 270 µm", "old.h5", 300.0, 250.0, 0.5)
LEFT = SiteMachined("Cu 270 µm", "old.h5", "left", 500.0, 0.0, 143.0, UNFINISHED, math.nan, 8.0)
THERE = ("--set", 'sites=[{kind="point",name="there",x_um=520,y_um=0}]')
ANEW = ("machine", "--profile", CU150, *THERE, "--run-id", "a")
CLOSE = ("approach", "--profile", CU270, "--site", "520,0")
DEEP = ("--profile", CU270, "--set", "target.depth_um=75", "--dry-run")


@pytest.mark.usefixtures("begun")
@pytest.mark.parametrize(
    ("entry", "arguments", "code", "words"),
    [
        (None, ANEW, "E8042", "runs/old.h5"),
        (None, (*ANEW, "--dry-run"), "E8042", "runs/old.h5"),
        *((None, (*CLOSE, *how), "E8042", "runs/old.h5") for how in ((), ("--contact",), ("--dry-run",))),
        (SHORT, ("machine", *DEEP), "E8044", ""),
        (None, ("measure-wear", "--site", "nowhere", "--dry-run"), "E8045", "first at 500,0 of old"),
        (LEFT, ("measure-wear", "--site", "left", "--dry-run"), "E8045", "how deep left is"),
    ],
)
def test_a_refused_command_leaves_the_bench_as_it_was(
    here: Here, entry: Entry | None, arguments: tuple[str, ...], code: str, words: str
) -> None:
    if entry is not None:
        ledger_goes_on(entry)
    before = Path("bench.h5").read_bytes()
    error = here(*arguments, *KEPT, "--json").document["error"]
    assert error["code"] == code
    assert words in error["message"]
    assert entry is not LEFT or "--resume" not in error["hint"]
    assert (kept().tool_label, Path("bench.h5").read_bytes()) == ("Cu 270 µm", before)
    assert not list(Path("runs").glob("a.*"))


@pytest.mark.usefixtures("begun")
def test_a_hole_is_named_by_its_run_and_a_short_tool_may_look_for_the_surface(here: Here) -> None:
    named = ("measure-wear", "--site", "old", "--profile", CU270, "--dry-run")
    assert here(*named, *KEPT).exit_code == 0
    ledger_goes_on(SHORT)
    said = here("approach", *DEEP, *KEPT, "--json")
    assert said.exit_code == 0, said.out
    assert said.document["result"]["forecast"]["x_um"] == 1000.0


@pytest.mark.usefixtures("begun")
@pytest.mark.parametrize(
    ("limit", "code"), [("target.depth_um=75", "E8044"), ("tool.max_wear_um=9", "E8043")]
)
def test_wear_of_another_bench_with_the_seed_has_its_own_remedy(here: Here, limit: str, code: str) -> None:
    job = ("machine", "--profile", CU270, "--set", "target.depth_um=10", "--set", limit, "--seed", "3", *KEPT)
    if code == "E8044":
        ledger_goes_on(SHORT)
    for is_new in (False, True):
        if is_new:
            Path("bench.h5").unlink()
        error = here(*job, "--json").document["error"]
        assert error["code"] == code
        assert ("--seed" in error["hint"], "--new-tool" in error["hint"]) == (is_new, not is_new)
    own = here("machine", "--profile", CU270, "--set", "tool.max_wear_um=9", "--json").document["error"]
    assert "--seed" not in own["hint"]
    said = here(
        "machine", "--profile", CU150, *KEPT, "--seed", "3", *THERE, "--json"
    )  # refused: no job is needed
    assert "W8116" in {warning["code"] for warning in said.document["warnings"]}, said.out


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
