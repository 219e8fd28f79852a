"""`edmctl machine`: the result, the run file, and what stands on which stream."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import h5py
import pytest

from edmctl.jobs import run_context
from edmctl.jobs.run_header import _title
from edmctl.jobs.truth import TrueWear, truths_of
from edmctl.jsonout import to_json_value
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import JobState, NoStateStore
from edmctl.simulator.bench import HoleTruth, VirtualBench
from edmctl.simulator.config import BenchConfig
from tests.cli.commands import CU270, SHALLOW, Here, Said, in_process_of_its_own

KEYS = "schema command ok exit_code simulated seed run_file files warnings result error"
SITE_KEYS = """depth_um depth_u95_um wear_um wear_u95_um feed_um z1_um z2_um z3_um depth_model_um wear_model_um
zero_drift_um machining_time_s cuts pulses"""
TRUTH_KEYS = "depth_um wear_um side_gap_um taper_um ra_um rz_um corner_um feed_um"


def test_json_has_the_documented_keys_and_the_same_seed_gives_the_same_bytes(
    here: Here, piped: tuple[Said, Path]
) -> None:
    document = here("machine", *SHALLOW, "--seed", "7", "--run-id", "one", "--json", "--quiet").document
    assert list(document) == KEYS.split()
    assert document["schema"] == "edmctl-result/1"
    assert not Path("runs/ledger.jsonl").exists()  # a fresh machine has none
    assert (document["ok"], document["exit_code"], document["simulated"]) == (True, 0, True)
    assert (document["seed"], document["run_file"], document["error"]) == (7, "runs/one.h5", None)
    (site,) = document["result"]["sites"]
    assert set(SITE_KEYS.split()) <= set(site)
    assert set(site["ratios"]) == {"open", "normal", "arc", "short"}
    assert set(site["truth"]) == set(TRUTH_KEYS.split())
    assert abs(site["depth_um"] - 8.0) <= 2.0
    assert abs(site["truth"]["depth_um"] - 8.0) <= 3.0
    assert {"time_s", "tool_wear_total_um"} <= set(document["result"])
    with h5py.File(piped[1]) as file:
        summary = json.loads(file["/entry/summary"][()].tobytes())
        assert to_json_value(summary) == document["result"]
        assert summary["sites"][0]["depth_um"] == file["/entry/results"]["depth"][0]


@pytest.fixture(scope="module")
def piped(tmp_path_factory: pytest.TempPathFactory) -> tuple[Said, Path]:
    """One run with seed 7 in a process of its own, as a person with pipes sees it, and its run file."""
    folder = tmp_path_factory.mktemp("piped")
    arguments = ("machine", *SHALLOW, "--seed", "7", "--run-id", "r")
    said = in_process_of_its_own(*arguments, cwd=folder, TERM="xterm-256color")
    assert said.exit_code == 0
    return said, folder / "runs" / "r.h5"


def test_a_pipe_gets_the_table_on_stdout_and_the_rest_on_stderr(piped: tuple[Said, Path]) -> None:
    said, path = piped
    assert "measured     from voltage" in said.out
    assert "Simulated, seed 7. Run file runs/r.h5" in said.out
    assert said.err.startswith(
        "profile: cu270 (shipped with edmctl)\n"
        "simulated run on the virtual machine, seed 7, into runs/r.h5; default setup\n"
    )
    assert "machining; gap" in said.err
    assert not {"\r", "\x1b"} & {*said.out, *said.err}
    with h5py.File(path) as file:
        entry = file["/entry"]
        assert entry["status"].asstr()[()] == "done"
        assert [entry[name][()] for name in ("exit_code", "simulated", "seed")] == [0, 1, 7]
        assert entry["profile/toml"].asstr()[()] == Path(CU270).read_text(encoding="utf-8")
        assert "target.depth_um = 8" in entry["profile/overrides"].asstr()[()]
        assert entry["profile/values"].attrs["pulse.frequency_hz_units"] == "Hz"


def test_events_are_json_lines_and_a_seed_nobody_chose_is_reported(here: Here) -> None:
    said = here("machine", *SHALLOW, "--events", "--json")
    events = [json.loads(line) for line in said.err.splitlines()]
    assert {event["event"] for event in events} == {"note", "progress"}
    assert any(event.get("phase") == "machining" for event in events)
    seed = said.document["seed"]
    assert isinstance(seed, int)
    assert 0 <= seed < 10**9
    with h5py.File(said.document["run_file"]) as file:
        assert file["/entry/seed"][()] == seed


def test_dry_run_forecasts_and_touches_nothing(here: Here) -> None:
    said = here("machine", "--profile", "cu270", "--dry-run")
    assert said.exit_code == 0
    for line in ("depth", "stroke", "feed", "whole job", "servo swing"):
        assert f"\n{line} " in said.out
    forecast = here("machine", "--profile", "cu270", "--dry-run", "--json").document["result"]["forecast"]
    assert forecast["depth_um"] == 180.0
    assert forecast["stroke_um"] < forecast["stroke_available_um"]
    assert list(Path().iterdir()) == []


def test_the_place_of_the_run_file_is_looked_at_before_the_machine_and_never_overwritten(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_context, "connected", None)
    Path("file").touch()
    Path("r.h5.partial").write_bytes(b"precious")
    for out, run_id, code in (("file", "r", "E9002"), ("file/in/it", "r", "E9002"), (".", "r", "E9001")):
        said = here("machine", *SHALLOW, "--out", out, "--run-id", run_id, "--json")
        assert (said.exit_code, said.document["error"]["code"]) == (9, code)
        assert said.document["run_file"] is None
    assert "--run-id" in said.document["error"]["hint"]
    assert {path.name for path in Path().iterdir()} == {"file", "r.h5.partial"}
    assert Path("r.h5.partial").read_bytes() == b"precious"


def test_a_port_is_named_by_option_environment_or_setup_in_this_order(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("setup.toml").write_text('port = "/dev/ttyNONE"\n', encoding="utf-8")
    job: tuple[str, ...] = ("machine", *SHALLOW, "--setup", "setup.toml")
    for port in ("NONE", "VARIABLE", "OPTION"):
        if port == "VARIABLE":
            monkeypatch.setenv("EDMCTL_PORT", "/dev/ttyVARIABLE")
        elif port == "OPTION":
            job = (*job, "--port", "/dev/ttyOPTION")
        said = here(*job, "--json")
        assert (said.exit_code, said.document["error"]["code"]) == (4, "E4001")
        assert said.document["error"]["message"] == f"There is no port /dev/tty{port}."
    assert here(*job, "--port", "sim:", "--dry-run").exit_code == 0
    assert not Path("runs").exists()


def test_a_missed_objective_reports_what_was_reached(here: Here) -> None:
    said = here("machine", *SHALLOW, "--set", "limits.max_time_s=100", "--run-id", "r", "--json")
    assert (said.exit_code, said.document["ok"], said.document["run_file"]) == (7, False, "runs/r.h5")
    assert said.document["result"]["time_s"] > 0.0
    with h5py.File("runs/r.h5") as file:
        assert file["/entry/exit_code"][()] == 7


def test_an_open_interlock_is_a_precondition_of_a_machine_that_says_whether_it_is_simulated(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert here("machine", *SHALLOW, "--dry-run", "--json").document["simulated"] is True

    def pretending(config: BenchConfig, seed: int) -> VirtualBench:
        bench = VirtualBench(config, seed)
        bench.controller.board = 1
        return bench

    monkeypatch.setattr("edmctl.simulator.open_bench", pretending)
    said = here("machine", *SHALLOW, "--set", "flush.min_flow_lpm=2.0", "--run-id", "r", "--json")
    assert (said.exit_code, said.document["simulated"]) == (8, False)
    assert said.document["error"]["code"].startswith("E8")
    assert said.document["result"]["sites"] == []
    with h5py.File("runs/r.h5") as file:
        assert file["/entry/exit_code"][()] == 8


@dataclass
class Worn:
    """A bench that is asked for nothing but the wear of its tool."""

    tool_wear_um: float = 0.0


@dataclass
class Place:
    """As much of a site's result as its truth asks for."""

    name: str
    x_um: float
    y_um: float = 0.0
    through: bool = False


def test_the_true_hole_of_a_site_is_the_nearest_and_the_wear_its_own() -> None:
    bench = Worn(100.0)
    wear = TrueWear(bench, NoStateStore())  # type: ignore[arg-type]
    for names, worn_um in (((), 107.0), (("a",), 107.5), (("a", "b"), 112.5)):
        bench.tool_wear_um = worn_um
        done = tuple({"name": name} for name in names)
        wear.keep(JobState("machining", 0.0, "Cu", done=done))
    bench.tool_wear_um = 113.5
    holes = (HoleTruth(999.0, 1.0, 20.0), HoleTruth(0.5, -1.0, 10.0))
    sites = [Place("a", 0.0), Place("b", 1000.0), Place("c", 2000.0)]
    truths = truths_of(sites, holes, wear)  # type: ignore[arg-type]
    assert [truth.depth_um for truth in truths[:2]] == [10.0, 20.0]
    assert [truth.wear_um for truth in truths] == [7.5, 5.0, 1.0]
    assert math.isnan(truths[2].depth_um)
    (unknown,) = truths_of(sites[:1], (), wear)  # type: ignore[arg-type]
    assert math.isnan(unknown.depth_um)
    (tip,) = truths_of([Place("a", 0.0, through=True)], holes, wear)  # type: ignore[list-item]
    assert (math.isnan(tip.depth_um), tip.wear_um) == (True, 7.5)


def test_a_bug_is_one_line_and_debug_shows_where(
    here: Here, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from edmctl.app import main
    from edmctl.jobs import plan as checking

    def broken(*_: object) -> None:
        raise ZeroDivisionError("made for this test")

    monkeypatch.setattr(checking, "check", broken)
    said = here("machine", *SHALLOW, "--json")
    assert said.exit_code == 1
    assert said.document["error"]["message"] == "Internal error: ZeroDivisionError: made for this test"
    assert len(said.err.splitlines()) == 2
    assert main(["machine", *SHALLOW, "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_a_depth_that_cannot_be_shown_is_told_before_any_spark_and_afterwards(here: Here) -> None:
    """A sensor whose scale is known to 20 % leaves 8 µm unknown by more than the tolerance of 2 µm."""
    Path("coarse.toml").write_text("[sensor]\ngain_u_rel = 0.2\n", encoding="utf-8")
    job = ("machine", *SHALLOW, "--set", "wear.max_cuts=1", "--setup", "coarse.toml")
    forecast = here(*job, "--dry-run", "--json")
    assert forecast.exit_code == 0
    assert [warning["code"] for warning in forecast.document["warnings"]] == ["W3132"]
    foretold_um = forecast.document["result"]["forecast"]["depth_u95_um"]
    said = here(*job, "--seed", "1", "--run-id", "unknown", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (7, "E7013")
    assert [warning["code"] for warning in said.document["warnings"]] == ["W3132"]
    (site,) = said.document["result"]["sites"]
    assert (site["verdict"], site["depth_basis"], site["wear_basis"]) == ("not shown", "touched", "touched")
    assert abs(site["depth_um"] - 8.0) <= 2.0 < site["depth_u95_um"]
    assert site["depth_u95_um"] == pytest.approx(foretold_um, rel=0.25)
    assert "not shown (7)" in here("run", "list").out
    assert "not shown to be right" in here("run", "explain", "runs/unknown.h5").out
    assert "verdict              not shown" in here("run", "show", "runs/unknown.h5").out


@pytest.mark.parametrize(
    ("options", "title"),
    [
        (("cu270",), "Cu 270 µm on Cu, 180 µm deep"),
        (("w252",), "W 252 µm on Cu, 240 µm deep"),
        (("cu270", "target.depth_um=5"), "cu270-cu"),
        (("cu270", "target.depth_um=5", 'meta.description="mine"'), "mine"),
    ],
)
def test_the_title_of_a_run_is_that_of_its_own_job(options: tuple[str, ...], title: str) -> None:
    assert _title(load_profile(options[0], options[1:])) == title
