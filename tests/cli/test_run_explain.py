"""`edmctl run explain`: the story of a run from its file."""

from __future__ import annotations

import json
import math
from pathlib import Path

import h5py
import pytest

from edmctl.jobs.runs.summary import event_sentences, holes_of
from edmctl.results.run_file import FileEvent
from tests.cli.commands import Here


def event(time_s: float, code: str, level: int = 1, message: str = "", **args: object) -> FileEvent:
    """An event as a run file holds it."""
    return FileEvent(time_s, code, level, message, args)


def jump(time_s: float, period_s: float, arcs: float, shorts: float = 0.0) -> FileEvent:
    return event(time_s, "JUMPED", 0, "jump", period_s=period_s, arcs=arcs, shorts=shorts, asked="")


def test_a_run_is_told_from_its_target_to_its_end(here: Here, run: Path) -> None:
    said = here("run", "explain", str(run))
    assert said.exit_code == 0
    lines = said.out.splitlines()
    target = "cu270-cu: wanted was a depth of 8 ± 2 µm in Cu with a Cu tool of 270 µm, with adaptive jumps"
    assert target in lines[0]
    cut, jumps, ended, depth = (
        next(i for i, line in enumerate(lines) if part in line)
        for part in ("Cut 1: feed 8.0 µm", "it jumped", "Cut 1 ended after", "  Depth ")
    )
    assert cut < jumps < ended < depth < len(lines) - 1
    assert "as its period asks for" in lines[jumps]
    assert "The run came to its end after" in lines[-1]
    document = here("run", "explain", str(run), "--json").document
    assert (document["command"], document["ok"], document["run_file"]) == ("run explain", True, str(run))
    story = document["result"]["story"]
    assert all(set(sentence) == {"time_s", "text", "code"} for sentence in story)
    assert [sentence["time_s"] for sentence in story] == sorted(sentence["time_s"] for sentence in story)
    assert [story[0]["code"], story[-1]["code"]] == ["WANTED", "END"]


def test_a_run_that_ended_early_is_told_with_what_to_do(here: Here, faulted_run_file: Path) -> None:
    out = here("run", "explain", str(faulted_run_file)).out
    for words in (
        "a short has lasted",
        "A short did not clear while the tool retracted",
        "Look for a debris bridge",
        "The run ended with exit code 6",
    ):
        assert words in out
    assert out.rstrip().endswith(", see above.")


def test_a_file_without_an_end_is_told_as_far_as_it_goes(here: Here, unfinished: Path) -> None:
    said = here("run", "explain", str(unfinished))
    assert (said.exit_code, "E9008" in said.err) == (9, True)
    assert "Cut 1 ended after" in said.out
    assert "was killed, or is still running" in said.out.splitlines()[-1]


def test_an_array_names_the_hole_of_each_sentence_and_counts_them(here: Here, array_run_file: Path) -> None:
    lines = here("run", "explain", str(array_run_file)).out.splitlines()
    assert "array-3x3: wanted was a depth of 5 ± 2 µm at each of 9 places" in lines[0]
    for number in range(1, 10):
        name = f"hole-{number}"
        assert sum(f"  {name}: Cut 1: feed" in line for line in lines) == 1
        assert any(f"  {name}: Depth " in line for line in lines)
    assert any("Touched the bottom of hole-9 at" in line for line in lines)
    with h5py.File(array_run_file) as run:
        results = {row["site"].decode(): row for row in run["/entry/results"][:]}
    (resolved,) = (line for line in lines if "new depths: " in line)
    row = results["hole-2"]
    assert f"hole-2 {row['depth']:.2f} ± {row['depth_u95']:.2f} µm (was " in resolved
    assert lines[-2].endswith("9 of 9 holes reached their target.")


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


def test_a_run_that_was_refused_at_once_says_that_its_file_holds_no_reason(here: Here, run: Path) -> None:
    with h5py.File(run, "r+") as file:
        file["/entry/exit_code"][()] = 8
        file["/entry/status"][()] = b"precondition"
    last = here("run", "explain", str(run)).out.splitlines()[-1]
    assert "exit code 8 (precondition)" in last
    assert "The file does not hold the reason" in last


def test_jumps_of_one_kind_make_one_sentence_with_their_reason() -> None:
    calm = [jump(10.0 * i, 10.0, 0.012) for i in range(1, 4)]
    asked = [jump(190.0 + 2.0 * i, 2.0, 0.01, 0.02) for i in range(41)]
    asked[0].args.update(asked="shorts", asking_shorts=0.04)
    told = event_sentences([*calm, *asked, event(300.0, "CUT_ENDED", 1, "Cut 1 ended.")], period_s=10.0)
    assert [sentence.text for sentence in told] == [
        "From 10 s to 30 s it jumped 3 times, every 10 s, as its period asks for; 1.2 % arcs between jumps.",
        "From 3 min 10 s to 4 min 30 s it jumped 41 times, every 2 s, because shorts asked for more flushing: "
        "up to 4.0 % shorts within a second; 1.0 % arcs and 2.0 % shorts between jumps on average.",
        "Cut 1 ended.",
    ]
    change = event(15.0, "REFERENCE_CHANGED", 1, "Servo reference 0.8 → 0.82: arcs.")
    told = event_sentences([jump(10.0, 1.5, 0.1), change, jump(20.0, 1.5, 0.1)], period_s=10.0)
    assert [sentence.code for sentence in told] == ["JUMPED", "REFERENCE_CHANGED", "JUMPED"]


def test_single_steps_are_left_out_and_an_earlier_version_knows_no_reasons() -> None:
    steps = [event(1.0, "MOVE_DONE", 0), event(2.0, "READING"), event(3.0, "LINK")]
    assert event_sentences(steps, period_s=10.0) == []
    told = event_sentences([event(10.0, "JUMPED", 0, "jump", height_um=60.0)], period_s=10.0)
    assert [sentence.text for sentence in told] == ["It jumped once, as its period asks for."]


def test_a_hole_through_a_sheet_has_no_depth_in_any_command(here: Here, tmp_path: Path) -> None:
    """The way ends by itself behind the breakthrough; the hole is as long as the sheet is thick."""
    settings = (
        *("approach.speed_um_s=5.0", "measure.settle_s=0.2", "measure.touches=1", "jump.height_um=30.0"),
        *('log.pulses="off"', "work.thickness_um=25.0", "target.completion_um=12.0"),
    )
    options = [word for value in settings for word in ("--set", value)]
    folder = ("--out", str(tmp_path), "--run-id", "sheet", "--events")
    said = here("machine", "--profile", "foil-through", *options, "--seed", "1", *folder)
    assert said.exit_code == 0, said.err
    progress = [json.loads(line) for line in said.err.splitlines() if '"depth_um"' in line]
    assert progress[-1]["depth_um"] is None
    file = str(tmp_path / "sheet.h5")
    story = here("run", "explain", file, "--json").document["result"]["story"]
    assert [sentence["code"] for sentence in story].count("BREAKTHROUGH") == 1
    (ended,) = (sentence["text"] for sentence in story if sentence["code"] == "CUT_ENDED")
    assert "(through)" in ended
    assert "wanted was a hole through the sheet of 25 µm" in story[0]["text"]
    result = here("run", "show", file, "--json").document["result"]
    (site,) = result["sites"]
    assert (site["through"], site["depth_um"], site["truth_depth_um"]) == (True, None, None)
    assert site["beyond_exit_um"] > 5.0
    gap_mm = float(result["profile"]["values"]["work.side_gap_um"]) / 1000.0
    area_mm2 = math.pi / 4.0 * (0.150 + 2.0 * gap_mm) ** 2
    assert site["mrr_mm3_min"] * site["machining_time_s"] / 60.0 == pytest.approx(area_mm2 * 0.025)
    for ratio in (site["wear_ratio_lin"], result["totals"]["wear_ratio_lin"]):
        assert ratio == pytest.approx(site["wear_um"] / 25.0, abs=3e-5)  # the wear is rounded to a nanometre
    text = here("run", "show", file).out
    assert ("feed beyond the exit" in text, "Z2 tip at the end" in text) == (True, True)
    assert " through " in here("run", "list", file).out
    assert "\ndepth, µm" not in here("run", "compare", file, file).out
    exported = here("run", "export", file, "-t", "results", "--format", "csv", "-o", "-").out.splitlines()
    assert {"through", "beyond_exit_um"} <= set(exported[0].split(","))
