"""approach, jump-flush and measure-wear by themselves, and in the wrong order: exit code and remedy."""

from __future__ import annotations

import json
import math
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest

from edmctl.app import main
from edmctl.jsonout import to_json_value
from edmctl.record.ledger import Ledger, ReferenceTouched, SiteMachined
from edmctl.simulator import BenchConfig, VirtualBench
from tests.cli.commands import CU270, SHALLOW, Here, Said, read_until, start
from tests.golden import once
from tests.tiers import tiers

KEPT = ("--port", "sim:bench.h5")
SENSORLESS = "[sensor]\nfitted = false\n"
APPROACH = ("approach", "--profile", CU270)
CONTACT = (*APPROACH, "--contact")
JUMPS = ("jump-flush", "--profile", CU270, "--count", "2")
REFERENCE = ("measure-wear", "--reference")
EACH = [APPROACH, CONTACT, JUMPS, REFERENCE]


def failure(said: Said, exit_code: int, code: str) -> dict[str, Any]:
    """The error of a command that failed as it should, with a remedy."""
    assert said.exit_code == exit_code, said.err
    error: dict[str, Any] = said.document["error"]
    assert error["code"] == code
    assert error["hint"]
    return error


@pytest.mark.parametrize("arguments", EACH, ids=" ".join)
def test_each_command_gives_one_result_and_a_run_file_as_forecast(
    here: Here, arguments: tuple[str, ...]
) -> None:
    dry = here(*arguments, *KEPT, "--dry-run", "--json")
    assert here(*arguments, *KEPT, "--dry-run").out
    assert list(Path().iterdir()) == []
    forecast = dry.document["result"]["forecast"]
    said = here(*arguments, "--seed", "2", "--run-id", "r", "--json", "--events")
    assert said.exit_code == 0, said.err
    document = said.document
    assert (document["command"], document["simulated"], document["seed"]) == (arguments[0], True, 2)
    events = [json.loads(line) for line in said.err.splitlines()]
    assert {event["event"] for event in events} <= {"note", "progress", "warning"}
    assert abs(document["result"]["time_s"] - forecast["time_s"]) <= 0.2 * forecast["time_s"]
    # The same seed gives the same bytes, to people as well.
    assert "Run file runs/s.h5" in here(*arguments, "--seed", "2", "--run-id", "s", "--quiet").out
    with h5py.File("runs/s.h5") as file:
        assert file["/entry/status"].asstr()[()] == "done"
        assert file["/entry/servo/v_cmd"][-1] == 0.0
        summary = json.loads(file["/entry/summary"][()].tobytes())
    assert to_json_value(summary) == document["result"]


@pytest.mark.parametrize("arguments", tiers(((JUMPS,)), slow=[(APPROACH,), (CONTACT,), (REFERENCE,)]))
def test_ctrl_c_leaves_a_readable_file_and_a_retracted_tool(here: Here, arguments: tuple[str, ...]) -> None:
    # A thousand samples a second for a thousand jumps: long enough to be stopped.
    long = ("--count", "1000") if arguments is JUMPS else ("--set", "approach.speed_um_s=0.2")
    slow = ("--set", "measure.speed_um_s=0.1", "--set", "measure.touches=20")
    process = start(*arguments, *long, *slow, *KEPT, "--run-id", "r", cwd=Path.cwd())
    assert process.stderr is not None
    read_until(process.stderr, "conditioning")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT, err
    assert "Traceback" not in err
    with h5py.File("runs/r.h5") as file:
        assert file["/entry/exit_code"][()] == 130
        assert file["/entry/servo/v_cmd"][-1] == 0.0


NO_SENSOR = ("--setup", "no-sensor.toml")
MEASURE = ("measure-wear",)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        *(((*command, *NO_SENSOR), "E8030", "") for command in (*EACH, MEASURE)),
        *(((*command, *NO_SENSOR, "--allow-model"), "E8031", "calibrate") for command in (*EACH, MEASURE)),
        ((*APPROACH, "--run-id", "taken"), "E9001", ""),
        *(((*APPROACH, "--site", place), "E2061", "") for place in ("500", "a,b", "1,2,3", "nan,0")),
        *(((*APPROACH, "--site", place), "E8042", "reference pad") for place in ("0,0", "0.7,0", "200,-200")),
        ((*JUMPS, "--period-s", "1.2"), "E2060", "--period-s 1.4"),
        ((*JUMPS, "--height-um", "4000"), "E3005", ""),
        (MEASURE, "E8041", "sim:FILE"),
        ((*MEASURE, *KEPT), "E8041", "`edmctl measure-wear --reference --port sim:"),
        (
            (*MEASURE, *KEPT, "--profile", "cu150"),
            "E8041",
            "`edmctl measure-wear --reference --profile cu150 --port sim:",
        ),
        ((*MEASURE, "--new-tool"), "E2062", ""),
        ((*APPROACH, "--set", "flush.min_flow_lpm=90"), "E8100", ""),
    ],
)
def test_what_cannot_be_done_is_refused_with_its_remedy(
    here: Here, arguments: tuple[str, ...], code: str, words: str
) -> None:
    Path("no-sensor.toml").write_text(SENSORLESS, encoding="utf-8")
    Path("runs").mkdir()
    Path("runs/taken.h5").write_bytes(b"precious")
    error = failure(here(*arguments, "--json"), int(code[1]), code)
    assert words in f"{error['message']} {error['hint']}"
    assert not list(Path("runs").glob("*.partial"))


def test_a_touch_needs_no_dielectric_and_goes_where_it_is_told_also_to_the_pad(here: Here) -> None:
    dry = ("--set", "flush.min_flow_lpm=90", "--json")
    assert here(*REFERENCE, *dry).exit_code == 0
    for x_um, y_um in ((700.0, -300.0), (0.7, 0.0)):
        result = here(*CONTACT, "--site", f"{x_um},{y_um}", *dry).document["result"]
        assert (result["x_um"], result["y_um"]) == (x_um, y_um)


def break_tool(bench: VirtualBench) -> None:
    bench.plant.tool_lost_um = 200.0


def stop_stage(bench: VirtualBench) -> None:
    bench.plant.limit_switch = True


@pytest.mark.parametrize(
    ("arguments", "damage", "fault"),
    [(APPROACH, break_tool, 3005), (CONTACT, break_tool, 2005), (CONTACT, stop_stage, None)],
)
def test_a_lost_tool_and_a_stage_at_its_limit_are_faults(
    here: Here,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    damage: Callable[[VirtualBench], None],
    fault: int | None,
) -> None:
    def broken(config: BenchConfig, seed: int) -> VirtualBench:
        bench = VirtualBench(config, seed)
        damage(bench)
        return bench

    monkeypatch.setattr("edmctl.simulator.open_bench", broken)
    said = here(*arguments, "--run-id", "r", "--json")
    assert said.exit_code in ((6,) if fault else (6, 8))
    assert said.document["error"]["hint"]
    if fault:
        assert said.document["error"]["fault"] == fault
        with h5py.File("runs/r.h5") as file:
            assert file["/entry/exit_code"][()] == 6
            assert file["/entry/servo/v_cmd"][-1] == 0.0


def test_the_reference_of_another_machine_is_none(here: Here) -> None:
    assert here(*REFERENCE, *KEPT, "--seed", "1", "--quiet").exit_code == 0
    error = failure(here(*MEASURE, "--port", "sim:other.h5", "--seed", "2", "--json"), 8, "E8041")
    assert "other.h5 does not exist" in error["message"]
    assert "tells of SIM-1." in error["message"]
    assert "SIM-2" not in error["message"]
    assert "--port sim:FILE" in error["hint"]
    Path("runs/ledger.jsonl").unlink()
    assert "SIM-1, the bench of " in failure(here(*MEASURE, *KEPT, "--json"), 8, "E8041")["message"]
    (warning,) = here(*REFERENCE, "--json").document["warnings"]
    assert warning["code"] == "W8113"  # a reference that is not kept


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a bench, a reference on it and a hole."""

    def make(folder: Path) -> None:
        kept = ("--port", f"sim:{folder / 'bench.h5'}", "--out", str(folder / "runs"), "--quiet")
        assert main((*REFERENCE, "--profile", CU270, *kept, "--seed", "4")) == 0
        assert main(("machine", *SHALLOW, *kept, "--run-id", "first")) == 0

    return once(tmp_path_factory, "workshop", make)


def holes(*made: SiteMachined) -> None:
    Ledger.open(Path("runs")).append("SIM-4", *made)


def narrow_hole() -> None:
    holes(SiteMachined("Cu 270 µm", "first.h5", "narrow", 900.0, 0.0, 83.0, "done", 8.0, 2.0, 0.5))


def wear_the_tool() -> None:
    holes(SiteMachined("Cu 270 µm", "x.h5", "x", 9000.0, 0.0, 143.0, "done", 180.0, 250.0, 1.0, z3_um=300.0))


def scribble() -> None:
    with Path("runs/ledger.jsonl").open("a") as file:
        file.write("scribble\n")


WIDE = ("--profile", CU270, "--set", "tool.diameter_um=300", "--set", 'tool.id="Cu 270 µm"')
THERE = ("--set", 'sites=[{kind="point",name="again",x_um=600,y_um=0}]')


@pytest.mark.parametrize(
    ("before", "arguments", "code", "words"),
    [
        (None, (*MEASURE, "--site", "nothing"), "E8045", "cu270-cu"),
        (None, (*MEASURE, "--site", "5000,0"), "E8045", "cu270-cu"),
        (None, (*MEASURE, "--site", "cu270-cu", *WIDE), "E8046", ""),
        (narrow_hole, (*MEASURE, "--site", "900,0", "--dry-run"), "E8046", "270.00 µm"),
        (wear_the_tool, ("machine", "--profile", CU270), "E8044", "300.00 µm"),
        (None, ("machine", *SHALLOW, *THERE), "E8042", "runs/first.h5"),
        (None, ("machine", *SHALLOW, "--set", "tool.max_wear_um=4"), "E8043", "--new-tool"),
        *(
            (scribble, command, "E9031", "ledger.jsonl:")
            for command in (("machine", *SHALLOW), MEASURE, REFERENCE)
        ),
    ],
)
def test_what_the_ledger_knows_refuses_before_anything_moves(
    machined: Here, before: Callable[[], None] | None, arguments: tuple[str, ...], code: str, words: str
) -> None:
    if before is not None:
        before()
    error = failure(machined(*arguments, *KEPT, "--json"), int(code[1]), code)
    assert words in f"{error['message']} {error['hint']}"


def test_a_hole_is_named_or_pointed_at_and_other_work_has_no_holes(machined: Here) -> None:
    for site in ("cu270-cu", "520,-10"):
        result = machined(*MEASURE, "--site", site, *KEPT, "--json").document["result"]
        assert result["site"]["x_um"] == 500.0
    other = ("--out", "new-work", *KEPT, "--dry-run")
    assert machined("machine", *SHALLOW, *THERE, *other).exit_code == 0


def test_another_speed_is_told_and_a_recipe_that_another_program_has_open_is_in_use(machined: Here) -> None:
    said = machined(*MEASURE, "--profile", CU270, "--set", "measure.speed_um_s=2", *KEPT, "--json")
    assert [warning["code"] for warning in said.document["warnings"]] == ["W8111"]
    with h5py.File("runs/first.h5", "r+"):
        error = failure(machined(*MEASURE, *KEPT, "--dry-run", "--json"), 9, "E9016")
    assert "Close it in that program" in error["hint"]


@pytest.fixture
def machined(here: Here, workshop: Path, capsys: pytest.CaptureFixture[str]) -> Here:
    """Command lines in a copy of that folder."""
    shutil.copytree(workshop, Path.cwd(), dirs_exist_ok=True)
    capsys.readouterr()
    return here


def test_wear_depth_and_feed_add_up_and_hold_the_truth(machined: Here) -> None:
    result = machined("measure-wear", *KEPT, "--json").document["result"]
    assert result["tool"] == "Cu 270 µm"
    assert abs(result["feed_um"] - result["depth_um"] - result["wear_um"]) <= 0.0021
    for key in ("depth", "wear", "feed"):
        error_um = abs(result[f"{key}_um"] - result["truth"][f"{key}_um"])
        assert error_um <= 2.0 * result[f"{key}_u95_um"]
    assert result["touches"] >= 3
    assert abs(result["wear_um"] - result["ledger"]["wear_um"]) <= result["wear_u95_um"]
    assert result["budget"][0]["source"] == "scatter of the touches"
    said = machined("measure-wear", *KEPT)
    assert "standard uncertainty" in said.out
    assert "truth" in said.out
    assert "Drift since the reference is not corrected" in said.out


def test_a_reference_that_jobs_count_from_is_replaced_with_a_warning(machined: Here) -> None:
    said = machined("measure-wear", "--reference", *KEPT, "--json")
    (warning,) = said.document["warnings"]
    assert warning["code"] == "W8117"
    assert f"{said.document['result']['reference']['z1_um']:.2f} µm" in warning["message"]
    assert machined("measure-wear", "--reference", *KEPT, "--json").document["warnings"] == []


def test_wear_that_no_job_accounts_for_is_told(machined: Here) -> None:
    book = Ledger.open(Path("runs"))
    gone = [line for line in book.path.read_text().splitlines() if json.loads(line)["kind"] != "site"]
    book.path.write_text("\n".join(gone) + "\n")
    book = Ledger.open(Path("runs"))
    tool = next(line.entry for line in book.lines if isinstance(line.entry, ReferenceTouched))
    hole = SiteMachined(
        "Cu 270 µm", tool.run_file, "x", 500.0, 0.0, 143.0, "done", 8.0, 40.0, 0.5, z3_um=tool.z_um + 3.0
    )
    book.append("SIM-4", hole)
    said = machined("measure-wear", *KEPT, "--json")
    assert "W8112" in [warning["code"] for warning in said.document["warnings"]]


def test_a_new_tool_takes_the_place_of_a_worn_one(machined: Here) -> None:
    little = ("--set", "tool.max_wear_um=4")
    said = machined("machine", *SHALLOW, *little, "--new-tool", *KEPT, "--json")
    assert said.exit_code == 0, said.err
    (site,) = said.document["result"]["sites"]
    assert abs(site["z1_um"] - 50.0) <= 4.0
    assert abs(site["wear_um"] - site["truth"]["wear_um"]) <= 2.0 * site["wear_u95_um"]


def test_an_interrupted_job_leaves_its_hole_in_the_ledger(machined: Here) -> None:
    said = machined("machine", *SHALLOW, *KEPT, "--set", "limits.max_time_s=100", "--json")
    assert said.exit_code == 7
    lines = [json.loads(line) for line in Path("runs/ledger.jsonl").read_text().splitlines()]
    assert lines[-1]["kind"] == "end"
    assert lines[-1]["status"] != "done"
    assert math.isfinite(lines[-1]["time_s"])
