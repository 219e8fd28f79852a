"""`edmctl run explain`: the story of a run from its file."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import pytest

from edmctl.app import main
from edmctl.jobs.runs.explanation import event_sentences, holes_of
from edmctl.results.run_file import FileEvent
from tests.cli.commands import CU270, Here
from tests.faults.workshop import Workshop
from tests.golden import once

QUICK = (
    'target={kind="feed",feed_um=25.0}',
    "approach.speed_um_s=5.0",
    "measure.settle_s=0.2",
    "measure.touches=1",
    "jump.height_um=30.0",
    'log.pulses="off"',
)


def event(
    time_s: float, code: str, level: int = 1, message: str = "", args: dict[str, object] | None = None
) -> FileEvent:
    """An event as a run file holds it."""
    return FileEvent(time_s, code, level, message, args or {})


def jump(
    time_s: float,
    period_s: float,
    arcs: float,
    shorts: float = 0.0,
    asking: Mapping[str, float] | None = None,
) -> FileEvent:
    asking = asking or {}
    args = {"period_s": period_s, "arcs": arcs, "shorts": shorts, "asked": " and ".join(asking)}
    return event(
        time_s, "JUMPED", 0, "jump", {**args, **{f"asking_{name}": share for name, share in asking.items()}}
    )


def words(*overrides: str) -> list[str]:
    return [word for value in (*QUICK, *overrides) for word in ("--set", value)]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a quick job."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("EDMCTL_HOME", str(folder / "home"))
            options = ["--seed", "1", "--out", str(folder), "--run-id", "one", "--quiet"]
            assert main(["machine", "--profile", CU270, *words('jump.mode="fixed"'), *options]) == 0

    return once(tmp_path_factory, "explained-run", make) / "one.h5"


@pytest.fixture
def file(recorded: Path, tmp_path: Path) -> Path:
    """A copy of it in a folder of its own."""
    return Path(shutil.copy(recorded, tmp_path / "one.h5"))


def test_a_run_is_told_from_what_was_wanted_to_its_end(here: Here, file: Path) -> None:
    said = here("run", "explain", str(file))
    assert said.exit_code == 0
    lines = said.out.splitlines()
    wanted = "cu270-cu: wanted was a feed of 25 µm in Cu with a Cu tool of 270 µm, with a jump every 10 s"
    assert wanted in lines[0]
    (cut,) = (i for i, line in enumerate(lines) if "Cut 1: feed 25.0 µm" in line)
    (jumps,) = (i for i, line in enumerate(lines) if "it jumped" in line)
    (ended,) = (i for i, line in enumerate(lines) if "Cut 1 ended after" in line)
    (depth,) = (i for i, line in enumerate(lines) if "  Depth " in line)
    assert cut < jumps < ended < depth < len(lines) - 1
    assert "as its period asks for" in lines[jumps]
    assert "The run came to its end after" in lines[-1]
    document = here("run", "explain", str(file), "--json").document
    assert (document["command"], document["ok"], document["run_file"]) == ("run explain", True, str(file))
    told = document["result"]["story"]
    assert all(set(sentence) == {"time_s", "text", "code"} for sentence in told)
    times_s = [sentence["time_s"] for sentence in told]
    assert times_s == sorted(times_s)
    assert [told[0]["code"], told[-1]["code"]] == ["WANTED", "END"]
    assert "CUT_ENDED" in {sentence["code"] for sentence in told}


def test_a_run_that_ended_early_is_told_with_what_to_do(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edmctl.simulator.open_bench", Workshop("WIRE_SHORT@sparks+5"))
    options = ("--seed", "1", "--out", str(tmp_path), "--run-id", "one", "--quiet")
    assert here("machine", "--profile", CU270, *words(), *options).exit_code == 6
    out = here("run", "explain", str(tmp_path / "one.h5")).out
    assert "a short has lasted" in out
    assert "A short did not clear while the tool retracted" in out
    assert "Look for a debris bridge" in out
    assert "The run ended with exit code 6" in out
    assert out.rstrip().endswith(", see above.")


def test_a_file_without_an_end_is_told_as_far_as_it_goes(here: Here, file: Path) -> None:
    partial = file.with_name("one.h5.partial")
    file.rename(partial)
    with h5py.File(partial, "r+") as run:
        run["/entry/end_time"][()] = b""
    said = here("run", "explain", str(partial))
    assert said.exit_code == 9
    assert "E9008" in said.err
    assert "Cut 1 ended after" in said.out
    assert "was killed, or is still running" in said.out.splitlines()[-1]


def test_an_array_names_the_hole_of_each_sentence_and_counts_them(here: Here, tmp_path: Path) -> None:
    sites = (
        "sites=[{name='a',x_um=500},{name='b',x_um=800},{name='c',x_um=1100}]",
        "target.depth_um=6.0",
        'log.pulses="off"',
        "approach.speed_um_s=5.0",
        "measure.settle_s=0.2",
    )
    options = [word for value in sites for word in ("--set", value)]
    folder = ("--out", str(tmp_path), "--run-id", "array", "--quiet")
    said = here("machine", "--profile", "array-3x3", *options, "--seed", "1", *folder)
    assert said.exit_code == 0, said.err
    lines = here("run", "explain", str(tmp_path / "array.h5")).out.splitlines()
    assert "array-3x3: wanted was a depth of 6 ± 2 µm at each of 3 places" in lines[0]
    for name in "abc":
        assert sum(f"  {name}: Cut 1: feed" in line for line in lines) == 1
        assert any(f"  {name}: Depth " in line for line in lines)
    assert any("Touched the bottom of a at" in line for line in lines)
    with h5py.File(tmp_path / "array.h5") as run:
        results = {row["site"].decode(): row for row in run["/entry/results"][:]}
    (settled,) = (line for line in lines if "new depths: " in line)
    assert f"b {results['b']['depth']:.2f} ± {results['b']['depth_u95']:.2f} µm (was " in settled
    assert lines[-2].endswith("3 of 3 holes reached their target.")


def test_a_hole_ends_with_its_target_and_the_pad_is_none() -> None:
    events = [
        event(1.0, "STAGE_MOVED", message="At a (1) (500, 0) µm."),
        event(2.0, "CUT_ENDED"),
        event(3.0, "STAGE_MOVED", message="At the reference pad (0, 0) µm."),
        event(4.0, "SITE_MEASURED"),
        event(5.0, "TARGET_REACHED"),
        event(6.0, "SITES_LEFT"),
        event(7.0, "STAGE_MOVED", message="At b (900, 0) µm."),
        event(8.0, "TARGET_MISSED"),
    ]
    assert holes_of(events) == ["a (1)"] * 5 + ["", "b", "b"]


def test_a_run_that_was_refused_at_once_says_that_its_file_holds_no_reason(here: Here, file: Path) -> None:
    with h5py.File(file, "r+") as run:
        run["/entry/exit_code"][()] = 8
        run["/entry/status"][()] = b"precondition"
    last = here("run", "explain", str(file)).out.splitlines()[-1]
    assert "exit code 8 (precondition)" in last
    assert "The file does not hold the reason" in last


def test_jumps_of_one_kind_make_one_sentence_with_their_reason() -> None:
    calm = [jump(10.0 * i, 10.0, 0.012) for i in range(1, 4)]
    asked = [jump(190.0 + 2.0 * i, 2.0, 0.01, 0.02, {"shorts": 0.04} if i == 0 else {}) for i in range(41)]
    told = event_sentences([*calm, *asked, event(300.0, "CUT_ENDED", 1, "Cut 1 ended.")], period_s=10.0)
    assert [sentence.text for sentence in told] == [
        "From 10 s to 30 s it jumped 3 times, every 10 s, as its period asks for; 1.2 % arcs between jumps.",
        "From 3 min 10 s to 4 min 30 s it jumped 41 times, every 2 s, because shorts asked for more flushing: "
        "up to 4.0 % shorts within a second; 1.0 % arcs and 2.0 % shorts between jumps on average.",
        "Cut 1 ended.",
    ]


def test_jumps_are_not_grouped_over_a_change_of_the_gap() -> None:
    change = event(15.0, "REFERENCE_CHANGED", 1, "Servo reference 0.8 → 0.82: arcs.")
    told = event_sentences([jump(10.0, 1.5, 0.1), change, jump(20.0, 1.5, 0.1)], period_s=10.0)
    assert [sentence.code for sentence in told] == ["JUMPED", "REFERENCE_CHANGED", "JUMPED"]


def test_single_steps_are_left_out_and_an_earlier_version_knows_no_reasons() -> None:
    steps = [event(1.0, "MOVE_DONE", 0), event(2.0, "READING"), event(3.0, "LINK")]
    assert event_sentences(steps, period_s=10.0) == []
    told = event_sentences([event(10.0, "JUMPED", 0, "jump", {"height_um": 60.0})], period_s=10.0)
    assert [sentence.text for sentence in told] == ["It jumped once, as its period asks for."]


def test_a_way_through_a_sheet_ends_by_itself_behind_the_breakthrough(here: Here, tmp_path: Path) -> None:
    sheet = ("work.thickness_um=25.0", "target.completion_um=12.0", 'log.pulses="off"')
    options = [word for value in (*QUICK[1:], *sheet) for word in ("--set", value)]
    folder = ("--out", str(tmp_path), "--run-id", "sheet", "--events")
    said = here("machine", "--profile", "foil-through", *options, "--seed", "1", *folder)
    assert said.exit_code == 0, said.err
    progress = [json.loads(line) for line in said.err.splitlines() if '"depth_um"' in line]
    assert progress[-1]["depth_um"] is None, "an open hole has no depth"
    told = here("run", "explain", str(tmp_path / "sheet.h5"), "--json").document["result"]["story"]
    codes = [sentence["code"] for sentence in told]
    assert codes.count("BREAKTHROUGH") == 1
    (ended,) = (sentence["text"] for sentence in told if sentence["code"] == "CUT_ENDED")
    assert "(through)" in ended
    assert "wanted was a hole through the sheet of 25 µm" in told[0]["text"]
    sheet_is_known_by_its_tip(here, tmp_path / "sheet.h5")


def sheet_is_known_by_its_tip(here: Here, file: Path) -> None:
    """It has no depth, and the hole is as long as the sheet is thick."""
    shown = here("run", "show", str(file), "--json")
    (site,) = shown.document["result"]["sites"]
    assert site["through"] is True
    assert site["depth_um"] is None
    assert site["beyond_exit_um"] > 5.0
    assert site["truth_depth_um"] is None
    area_mm2 = math.pi / 4.0 * (0.150 + 2.0 * site_gap_mm(shown.document)) ** 2
    assert site["mrr_mm3_min"] * site["machining_time_s"] / 60.0 == pytest.approx(area_mm2 * 0.025)
    # Both are rounded: the wear to a nanometre.
    assert site["wear_ratio_lin"] == pytest.approx(site["wear_um"] / 25.0, abs=3e-5)
    assert shown.document["result"]["totals"]["wear_ratio_lin"] == pytest.approx(
        site["wear_um"] / 25.0, abs=3e-5
    )
    text = here("run", "show", str(file)).out
    assert "feed beyond the exit" in text
    assert "Z2 tip at the end" in text
    assert " through " in here("run", "list", str(file)).out
    assert "\ndepth, µm" not in here("run", "compare", str(file), str(file)).out
    exported = here(
        "run", "export", str(file), "-t", "results", "--format", "csv", "-o", "-"
    ).out.splitlines()
    assert {"through", "beyond_exit_um"} <= set(exported[0].split(","))


def site_gap_mm(document: dict[str, Any]) -> float:
    return float(document["result"]["profile"]["values"]["work.side_gap_um"]) / 1000.0


@pytest.mark.parametrize("name", ["a.h5.partial", "a.h5"])
def test_a_run_id_leads_to_its_file(here: Here, name: str) -> None:
    file = Path("runs") / name
    file.parent.mkdir()
    file.write_bytes(b"")
    said = here("run", "explain", "a", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (9, "E9005")
    assert str(file) in said.document["error"]["message"]
