"""approach, jump-flush and measure-wear by themselves, and in the wrong order: exit code and remedy."""

from __future__ import annotations

import json
import math
import shutil
import signal
from pathlib import Path
from typing import Any

import h5py
import pytest

from edmctl.app import main
from edmctl.jsonout import to_json_value
from edmctl.record.ledger import Ledger, ReferenceTouched, SiteMachined
from edmctl.simulator import BenchConfig, VirtualBench
from tests.cli.commands import CU270, SHALLOW, Here, Said
from tests.cli.test_processes import read_until, start

KEPT = ("--port", "sim:bench.h5")
SENSORLESS = "[sensor]\nfitted = false\n"
EACH = [
    ("approach", "--profile", CU270),
    ("approach", "--profile", CU270, "--contact"),
    ("jump-flush", "--profile", CU270, "--count", "2"),
    ("measure-wear", "--reference"),
]


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
    said = here(*arguments, "--seed", "2", "--run-id", "r", "--json", "--events")
    assert said.exit_code == 0, said.err
    document = said.document
    assert (document["command"], document["simulated"], document["seed"]) == (arguments[0], True, 2)
    events = [json.loads(line) for line in said.err.splitlines()]
    assert {event["event"] for event in events} <= {"note", "progress", "warning"}
    with h5py.File("runs/r.h5") as file:
        assert file["/entry/status"].asstr()[()] == "done"
        assert file["/entry/servo/v_cmd"][-1] == 0.0
    forecast = here(*arguments, "--dry-run", "--json").document["result"]["forecast"]
    assert abs(document["result"]["time_s"] - forecast["time_s"]) <= 0.2 * forecast["time_s"]
    # The same seed gives the same bytes, to people as well.
    assert "Run file runs/s.h5" in here(*arguments, "--seed", "2", "--run-id", "s", "--quiet").out
    with h5py.File("runs/s.h5") as file:
        summary = json.loads(file["/entry/summary"][()].tobytes())
    assert to_json_value(summary) == document["result"]


@pytest.mark.parametrize("arguments", [*EACH, ("measure-wear",)], ids=" ".join)
def test_a_dry_run_touches_nothing(here: Here, arguments: tuple[str, ...]) -> None:
    said = here(*arguments, *KEPT, "--dry-run", "--json")
    assert said.exit_code == 0
    assert said.document["result"]["forecast"]["time_s"] > 10.0
    assert here(*arguments, *KEPT, "--dry-run").out
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize("arguments", EACH, ids=" ".join)
def test_ctrl_c_leaves_a_readable_file_and_a_retracted_tool(here: Here, arguments: tuple[str, ...]) -> None:
    # A thousand samples a second for a thousand jumps: long enough to be stopped.
    long = ("--count", "1000") if arguments[0] == "jump-flush" else ("--set", "approach.speed_um_s=0.2")
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


@pytest.mark.parametrize("arguments", [*EACH, ("measure-wear",)], ids=" ".join)
def test_without_a_sensor_a_calibration_is_asked_for(here: Here, arguments: tuple[str, ...]) -> None:
    Path("setup.toml").write_text(SENSORLESS, encoding="utf-8")
    asked = (*arguments, "--setup", "setup.toml", "--json")
    failure(here(*asked), 8, "E8030")
    assert "calibrate" in failure(here(*asked, "--allow-model"), 8, "E8031")["hint"]


@pytest.mark.parametrize("arguments", EACH, ids=" ".join)
def test_a_full_folder_is_no_place_for_a_second_run(here: Here, arguments: tuple[str, ...]) -> None:
    Path("runs").mkdir()
    Path("runs/r.h5").write_bytes(b"precious")
    failure(here(*arguments, "--run-id", "r", "--json"), 9, "E9001")


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [(EACH[0], 3005), (EACH[1], 2005), (EACH[3], 2005)],
    ids=["approach", "contact", "measure-wear"],
)
def test_a_lost_tool_is_a_fault(
    here: Here, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], fault: int
) -> None:
    def broken(config: BenchConfig, seed: int) -> VirtualBench:
        bench = VirtualBench(config, seed)
        bench.plant.tool_lost_um = 200.0
        return bench

    monkeypatch.setattr("edmctl.simulator.open_bench", broken)
    said = here(*arguments, "--run-id", "r", "--json")
    assert said.exit_code == 6
    assert said.document["error"]["fault"] == fault
    assert said.document["error"]["hint"]
    with h5py.File("runs/r.h5") as file:
        assert file["/entry/exit_code"][()] == 6
        assert file["/entry/servo/v_cmd"][-1] == 0.0


def test_a_stage_at_its_limit_is_a_fault(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    def stuck(config: BenchConfig, seed: int) -> VirtualBench:
        bench = VirtualBench(config, seed)
        bench.plant.limit_switch = True
        return bench

    monkeypatch.setattr("edmctl.simulator.open_bench", stuck)
    said = here("approach", "--profile", CU270, "--json")
    assert said.exit_code in (6, 8)
    assert said.document["error"]["hint"]


def test_sparks_need_the_dielectric_and_touches_do_not(here: Here) -> None:
    dry = ("--set", "flush.min_flow_lpm=90")
    assert here("approach", "--profile", CU270, *dry, "--json").exit_code == 8
    assert here("approach", "--profile", CU270, *dry, "--contact", "--json").exit_code == 0
    assert here("measure-wear", "--reference", *dry, "--json").exit_code == 0


@pytest.mark.parametrize("place", ["500", "a,b", "1,2,3", "nan,0"])
def test_a_place_is_two_numbers(here: Here, place: str) -> None:
    failure(here("approach", "--profile", CU270, "--site", place, "--json"), 2, "E2061")


def test_an_approach_goes_where_it_is_told(here: Here) -> None:
    said = here("approach", "--profile", CU270, "--contact", "--site", "700,-300", "--json")
    assert (said.document["result"]["x_um"], said.document["result"]["y_um"]) == (700.0, -300.0)


@pytest.mark.parametrize("place", ["0,0", "0.7,0", "200,-200"])
def test_no_sparks_are_made_on_the_pad(here: Here, place: str) -> None:
    where = ("approach", "--profile", CU270, "--site", place, "--json")
    assert "reference pad" in failure(here(*where), 8, "E8042")["message"]
    assert here(*where, "--contact").exit_code == 0


def test_jumps_in_a_hurry_are_refused(here: Here) -> None:
    fast = ("jump-flush", "--profile", CU270, "--period-s", "1.2", "--json")
    assert "--period-s 1.4" in failure(here(*fast), 2, "E2060")["hint"]


def test_options_of_a_jump_are_checked_like_the_profile(here: Here) -> None:
    failure(here("jump-flush", "--profile", CU270, "--height-um", "4000", "--json"), 3, "E3005")


def test_a_wear_needs_a_reference(here: Here) -> None:
    assert "sim:FILE" in failure(here("measure-wear", "--json"), 8, "E8041")["hint"]
    error = failure(here("measure-wear", *KEPT, "--json"), 8, "E8041")
    assert "`edmctl measure-wear --reference --port sim:" in error["hint"]
    error = failure(here("measure-wear", "--profile", "cu150", *KEPT, "--json"), 8, "E8041")
    assert "`edmctl measure-wear --reference --profile cu150 --port sim:" in error["hint"]
    assert not list(Path("runs").glob("*.partial"))


def test_the_reference_of_another_machine_is_none(here: Here) -> None:
    assert here("measure-wear", "--reference", *KEPT, "--seed", "1", "--quiet").exit_code == 0
    other = ("measure-wear", "--port", "sim:other.h5", "--seed", "2", "--json")
    error = failure(here(*other), 8, "E8041")
    assert "other.h5 does not exist" in error["message"]
    assert "tells of SIM-1." in error["message"]
    assert "SIM-2" not in error["message"]
    assert "--port sim:FILE" in error["hint"]


def test_a_bench_without_a_reference_is_named_by_its_file(here: Here) -> None:
    assert here("approach", "--profile", CU270, "--contact", *KEPT, "--seed", "1", "--quiet").exit_code == 0
    error = failure(here("measure-wear", *KEPT, "--json"), 8, "E8041")
    assert "SIM-1, the bench of " in error["message"]


def test_a_new_tool_has_lost_nothing_yet(here: Here) -> None:
    failure(here("measure-wear", "--new-tool", "--json"), 2, "E2062")


def test_a_reference_that_is_not_kept_is_told(here: Here) -> None:
    (warning,) = here("measure-wear", "--reference", "--json").document["warnings"]
    assert warning["code"] == "W8113"


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a bench, a reference on it and a hole."""
    folder = tmp_path_factory.mktemp("workshop")
    kept = (
        "--profile",
        CU270,
        "--port",
        f"sim:{folder / 'bench.h5'}",
        "--out",
        str(folder / "runs"),
        "--quiet",
    )
    assert main(("measure-wear", "--reference", *kept, "--seed", "4")) == 0
    assert main(("machine", *SHALLOW, *kept, "--run-id", "first")) == 0
    return folder


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


def test_a_hole_is_named_or_pointed_at(machined: Here) -> None:
    for site in ("cu270-cu", "520,-10"):
        result = machined("measure-wear", "--site", site, *KEPT, "--json").document["result"]
        assert result["site"]["x_um"] == 500.0
    for site in ("nothing", "5000,0"):
        error = failure(machined("measure-wear", "--site", site, *KEPT, "--json"), 8, "E8045")
        assert "cu270-cu" in error["message"]


def test_a_tool_that_is_too_wide_goes_into_no_hole(machined: Here) -> None:
    wide = ("--profile", CU270, "--set", "tool.diameter_um=300", "--set", 'tool.id="Cu 270 µm"')
    failure(machined("measure-wear", "--site", "cu270-cu", *wide, *KEPT, "--json"), 8, "E8046")
    narrow = SiteMachined("Cu 270 µm", "first.h5", "narrow", 900.0, 0.0, 83.0, "done", 8.0, 2.0, 0.5)
    Ledger.open(Path("runs")).append("SIM-4", narrow)
    error = failure(machined("measure-wear", "--site", "900,0", "--dry-run", *KEPT, "--json"), 8, "E8046")
    assert "270.00 µm" in error["message"]


def test_a_reference_that_jobs_count_from_is_replaced_with_a_warning(machined: Here) -> None:
    said = machined("measure-wear", "--reference", *KEPT, "--json")
    (warning,) = said.document["warnings"]
    assert warning["code"] == "W8117"
    assert f"{said.document['result']['reference']['z1_um']:.2f} µm" in warning["message"]
    assert machined("measure-wear", "--reference", *KEPT, "--json").document["warnings"] == []


def test_a_recipe_that_another_program_has_open_is_in_use(machined: Here) -> None:
    with h5py.File("runs/first.h5", "r+"):
        error = failure(machined("measure-wear", *KEPT, "--dry-run", "--json"), 9, "E9016")
    assert "Close it in that program" in error["hint"]


def test_another_speed_of_touching_is_told(machined: Here) -> None:
    said = machined("measure-wear", "--profile", CU270, "--set", "measure.speed_um_s=2", *KEPT, "--json")
    assert [warning["code"] for warning in said.document["warnings"]] == ["W8111"]


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


def test_a_worn_out_tool_is_refused_and_a_new_one_is_not(machined: Here) -> None:
    little = ("--set", "tool.max_wear_um=4")
    error = failure(machined("machine", *SHALLOW, *little, *KEPT, "--json"), 8, "E8043")
    assert "--new-tool" in error["hint"]
    said = machined("machine", *SHALLOW, *little, "--new-tool", *KEPT, "--json")
    assert said.exit_code == 0, said.err
    (site,) = said.document["result"]["sites"]
    assert abs(site["z1_um"] - 50.0) <= 4.0
    assert abs(site["wear_um"] - site["truth"]["wear_um"]) <= 2.0 * site["wear_u95_um"]


def test_a_tool_that_became_too_short_is_refused(machined: Here) -> None:
    worn = SiteMachined("Cu 270 µm", "x.h5", "x", 9000.0, 0.0, 143.0, "done", 180.0, 250.0, 1.0, z3_um=300.0)
    Ledger.open(Path("runs")).append("SIM-4", worn)
    error = failure(machined("machine", "--profile", CU270, *KEPT, "--json"), 8, "E8044")
    assert "300.00 µm" in error["message"]


def test_a_taken_place_is_refused_with_the_run_that_made_it(machined: Here) -> None:
    there = 'sites=[{kind="point",name="again",x_um=600,y_um=0}]'
    error = failure(machined("machine", *SHALLOW, "--set", there, *KEPT, "--json"), 8, "E8042")
    assert "runs/first.h5" in error["message"]
    assert (
        machined("machine", *SHALLOW, "--set", there, "--out", "new-work", *KEPT, "--dry-run").exit_code == 0
    )


def test_a_damaged_ledger_stops_a_job_before_anything_moves(machined: Here) -> None:
    with Path("runs/ledger.jsonl").open("a") as file:
        file.write("scribble\n")
    for arguments in (("machine", *SHALLOW), ("measure-wear",), ("measure-wear", "--reference")):
        error = failure(machined(*arguments, *KEPT, "--json"), 9, "E9031")
        assert "ledger.jsonl:" in error["message"]


def test_an_interrupted_job_leaves_its_hole_in_the_ledger(machined: Here) -> None:
    said = machined("machine", *SHALLOW, *KEPT, "--set", "limits.max_time_s=100", "--json")
    assert said.exit_code == 7
    lines = [json.loads(line) for line in Path("runs/ledger.jsonl").read_text().splitlines()]
    assert lines[-1]["kind"] == "end"
    assert lines[-1]["status"] != "done"
    assert math.isfinite(lines[-1]["time_s"])
