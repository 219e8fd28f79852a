"""`edmctl run show`: one run on a page, finished, killed, or while it goes on."""

from __future__ import annotations

import json
import math
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edmctl.cli.render.progress import Reporter
from edmctl.cli.signals import SignalArrived
from edmctl.errors import RunFileError
from edmctl.jobs.runs.follow import follow_run
from edmctl.jobs.runs.summary import jumps_of
from edmctl.record.rows import EventLevel, EventRow, RunEvent, ServoBlock, SlowRow, Summary, profile_leaves
from edmctl.record.writer import RunWriter
from edmctl.results.progress import Progress
from edmctl.results.run_file import FileEvent
from tests.cli.commands import ROOT, Here, environment
from tests.cli.run_files import begun, finished, killed
from tests.record.samples import PROFILE, a_meta, slow_row
from tests.record.samples import finished as made_up
from tests.tiers import tiers


class Seen(Reporter):
    """A reporter that keeps what it gets."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.states: list[Progress] = []

    def progress(self, p: Progress) -> None:
        self.states.append(p)

    def note(self, text: str) -> None:
        self.notes.append(text)


def test_a_job_is_shown_with_the_figures_of_its_own_result(here: Here, run: Path) -> None:
    said = here("run", "show", str(run))
    assert (said.exit_code, said.err) == (0, "")
    document = here("run", "show", str(run), "--json").document
    assert (document["seed"], document["simulated"], document["run_file"]) == (3, True, str(run))
    result = document["result"]
    (site,), (shown,) = result["summary"]["sites"], result["sites"]
    depth = re.search(r"^depth +([\d.]+) ± ([\d.]+) µm", said.out, re.MULTILINE)
    assert depth is not None
    assert [float(text) for text in depth.groups()] == pytest.approx(
        [site["depth_um"], site["depth_u95_um"]], abs=0.006
    )
    assert (site["depth_basis"], site["verdict"]) == ("touched", "shown")
    assert f"{site['truth']['depth_um']:.2f} µm" in said.out
    assert "wanted was a depth of 8 ± 2 µm in Cu" in said.out
    assert "No faults, no warnings." in said.out
    assert max(len(line) for line in said.out.splitlines() if "/" not in line) <= 80
    assert (shown["depth_um"], shown["truth_wear_um"]) == (site["depth_um"], site["truth"]["wear_um"])
    assert [touch["kind"] for touch in result["touches"]][:2] == ["Z1", "Z1"]
    assert result["rows"]["servo"] > 1000


def test_a_live_run_is_shown_under_its_coming_name_and_a_killed_one_is_called_so(
    here: Here, tmp_path: Path
) -> None:
    said = here("run", "show", str(killed(tmp_path, "dead")), "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (9, "E9008")
    assert said.document["result"]["status"] == "interrupted"
    assert said.document["result"]["sites"][0]["depth_um"] == 180.0
    writer = begun(tmp_path, "living")
    said = here("run", "show", str(tmp_path / "living.h5"))
    writer.finish("done", 0)
    assert (said.exit_code, said.err) == (0, "")
    assert "status        running" in said.out


def test_following_ends_with_the_run_and_tells_its_news(tmp_path: Path) -> None:
    writer = begun(tmp_path, "living")
    looks = 0

    def wait() -> None:
        nonlocal looks
        looks += 1
        if looks > 3:
            writer.finish("done", 0)
            return
        writer.append(servo(20.0 + looks))
        writer.append(slow(20.0 + looks))
        writer.append(EventRow(20.0 + looks, 130, EventLevel.INFO, f"Look {looks}."))
        writer.flush()

    seen = Seen()
    assert follow_run(tmp_path / "living.h5.partial", seen, wait) == tmp_path / "living.h5"
    assert seen.notes == ['At 1 s: Cut 1: "feed", then touch', "Look 1.", "Look 2.", "Look 3."]
    assert [state.time_s for state in seen.states] == [
        pytest.approx(t) for t in (9.99, 21.0, 22.0, 23.0, 23.0)
    ]
    newest = seen.states[3]
    assert newest.depth_um == pytest.approx(11.5)
    assert newest.gap_v == pytest.approx(9.6)
    assert newest.ratios.normal == pytest.approx(0.7)


def test_the_time_left_of_a_cut_is_that_of_its_mean_feed(tmp_path: Path) -> None:
    writer = RunWriter.create(tmp_path / "fast.h5", a_meta())
    plan = {"cut": 1, "feed_um": 200.0, "wear_ratio": 0.5, "target_um": 100.0}
    writer.append(EventRow(100.0, RunEvent.CUT_PLANNED, EventLevel.INFO, "Cut 1.", plan))
    for now_s in 100.0 + 0.1 * np.arange(1, 401):
        fed_um = 0.3 * (now_s - 100.0)
        writer.append(servo(now_s))
        writer.append(
            replace(slow(now_s), feed_um_s=0.3, depth_um=fed_um / 1.5, wear_um=fed_um / 3.0, wear_u95_um=0.7)
        )
    writer.flush()
    seen = Seen()

    def wait() -> None:
        writer.finish("done", 0)

    follow_run(tmp_path / "fast.h5.partial", seen, wait)
    newest = seen.states[0]
    assert newest.time_s == pytest.approx(140.0)
    assert newest.depth_target_um == 100.0
    assert newest.feed_um == pytest.approx(12.0, rel=1e-4)
    assert newest.wear_u95_um == pytest.approx(0.7)
    assert newest.time_left_s == pytest.approx((100.0 - newest.depth_um) * 1.5 / 0.3, rel=1e-3)


@pytest.mark.parametrize(
    "command", tiers("show", "export", "recover", slow=("explain", "plot", "compare", "list"))
)
def test_every_command_finds_a_run_by_its_id_and_by_its_coming_name(here: Here, command: str) -> None:
    Path("runs").mkdir()
    finished(Path("runs"), "first")
    writer = begun(Path("runs"), "living")
    options = {
        "plot": ("--kind", "touching", "-o", "x.png"),
        "export": ("-t", "touches"),
        "compare": ("first",),
    }
    said = [
        here("run", command, name, *options.get(command, ()))
        for name in ("first", "living", "runs/living.h5")
    ]
    writer.finish("done", 0)
    for one in said:
        assert "E9005" not in one.err


def servo(time_s: float) -> ServoBlock:
    values = (time_s, 20.0, 60.0, 59.0, 9.6, 0.8, 0.02, 1, 4)
    return ServoBlock(*(np.array([value]) for value in values))


def slow(time_s: float) -> SlowRow:
    shares = (1.0, 0.8, 0.8, 0.2, 0.7, 0.1, 0.0)
    return SlowRow(time_s, *shares, depth_um=time_s / 2, wear_um=0.5, power_w=math.nan)


def test_a_finished_run_is_not_waited_for(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edmctl.jobs.runs.follow.time.sleep", pytest.fail)
    said = here("run", "show", "--follow", str(finished(tmp_path, "a")), "--quiet")
    assert (said.exit_code, said.err) == (0, "")
    assert "status        done" in said.out


WRITER = """
import sys
from pathlib import Path
from tests.cli.run_files import begun
writer = begun(Path(sys.argv[1]), "living")
print("ready", flush=True)
sys.stdin.read()
"""


def test_following_ends_when_the_writer_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)],
        cwd=ROOT,
        env=environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"ready\n"
        looks = 0

        def wait() -> None:
            nonlocal looks
            looks += 1
            if looks == 2:
                writer.kill()
                writer.wait()

        with pytest.raises(RunFileError) as caught:
            follow_run(tmp_path / "living.h5.partial", Seen(), wait)
    assert (caught.value.code, looks) == ("E9008", 2)
    with pytest.raises(RunFileError) as caught:
        follow_run(tmp_path / "living.h5.partial", Seen(), pytest.fail)
    assert caught.value.code == "E9008"


def test_ctrl_c_ends_the_following_and_nothing_else(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(_: float) -> None:
        raise SignalArrived(signal.SIGINT)

    monkeypatch.setattr("edmctl.jobs.runs.follow.time.sleep", stop)
    writer = begun(tmp_path, "living")
    said = here("run", "show", "--follow", str(tmp_path / "living.h5"), "--quiet")
    assert said.exit_code == 130
    assert writer.finish("done", 0) == tmp_path / "living.h5"


def test_every_jump_counts_whatever_asked_for_it() -> None:
    told = (
        *((60.0, "JUMPED"), (60.5, "JUMP_DONE"), (70.0, "JUMPED"), (70.6, "JUMP_DONE")),
        *((71.0, "SHORT_RECOVERY"), (71.3, "JUMP_DONE"), (80.0, "CUT_ENDED"), (95.0, "JUMP_DONE")),
    )
    found = jumps_of([FileEvent(time_s, code, 0, "", {}) for time_s, code in told])
    assert found.count == 4
    assert found.shortest_s == pytest.approx(0.7)
    assert found.longest_s == pytest.approx(10.1)


def test_a_hole_that_was_left_and_its_error_are_told_in_words(here: Here, tmp_path: Path) -> None:
    writer = RunWriter.create(tmp_path / "a.h5", a_meta())
    writer.append(
        EventRow(9.0, RunEvent.ENDED_EARLY, EventLevel.ERROR, "The power came back.", {"code": "E4005"})
    )
    reached = {"site": "one", "depth_estimated_um": 1.86, "depth_target_um": 20.0}
    writer.append(Summary(json.dumps({"reached": reached, "home_um": -0.69})))
    writer.finish("no port, or link lost", 4)
    said = here("run", "show", str(tmp_path / "a.h5")).out
    assert "left at about 1.86 of 20 µm (estimated)" in said
    assert "E4005 (exit code 4)" in said
    assert "home" not in said
    assert "E4005 (4)" in here("run", "list", str(tmp_path)).out
    assert "no port" not in said + here("run", "explain", str(tmp_path / "a.h5")).out


DEEP = {"target": {"kind": "depth", "depth_um": 180.0, "tolerance_um": 2.0}}
PROCEDURES: dict[tuple[str, ...], str] = {
    ("measure-wear", "--reference"): "wear reference",
    ("approach", "--contact"): "contact touch",
}
WEAR = {"z2_um": 61.3, "wear_um": 3.468, "wear_u95_um": 0.991, "depth_um": 7.951, "depth_u95_um": 0.42}


def made(folder: Path, run_id: str, *command: str, found: Mapping[str, object] | None = None) -> Path:
    """The file of a run of `command` that found something, or left a hole."""
    leaves = profile_leaves({**PROFILE, **DEEP, "jump": {"height_um": 60.0, "period_s": 10.0}})
    procedure = PROCEDURES.get(command, command[0])
    meta = replace(
        a_meta(), run_id=run_id, command=("edmctl", *command), procedure=procedure, profile_leaves=leaves
    )
    path = folder / f"{run_id}.h5"
    if found is not None:
        return made_up(path, Summary(json.dumps(found)), meta=meta)
    row = replace(slow_row(120), depth_um=153.06, wear_um=40.0, depth_u95_um=6.5)
    return made_up(path, row, meta=meta, end=("machine fault", 6))


@pytest.mark.parametrize(
    ("command", "wanted"),
    [
        (("machine",), "wanted was a depth of 180 ± 2 µm"),
        (("measure-wear",), "wanted was to measure wear"),
        (("measure-wear", "--reference"), "wanted was to touch the pad"),
        (("approach",), "wanted was to find the spark gap"),
        (("approach", "--contact"), "wanted was to find the surface"),
        (("jump-flush", "-n", "4"), "wanted was to jump 60 µm every 10 s"),
    ],
)
def test_what_was_wanted_is_said_by_the_command(
    here: Here, tmp_path: Path, command: tuple[str, ...], wanted: str
) -> None:
    path = made(tmp_path, "a", *command, found={"touches": 3})
    assert wanted in " ".join(here("run", "show", str(path)).out.split())
    explained = here("run", "explain", str(path)).out
    assert wanted in " ".join(explained.split())
    assert ("Found: touches 3." in explained) is (command != ("machine",))


def test_what_was_found_is_told_in_words_and_the_depth_is_listed(here: Here, tmp_path: Path) -> None:
    path = made(tmp_path, "a", "measure-wear", found=WEAR)
    shown = " ".join(here("run", "show", str(path)).out.split())
    assert "Z2 61.30 µm; wear 3.47 ± 0.99 µm; depth 7.95 ± 0.42 µm" in shown
    (line,) = (line for line in here("run", "list", str(tmp_path)).out.splitlines() if line.startswith("a "))
    assert "7.95 ± 0.42   3.47 ± 0.99" in line


def test_a_hole_that_was_left_is_told_as_deep_as_estimated(here: Here, tmp_path: Path) -> None:
    left = made(tmp_path, "left", "machine")
    assert "about 153.1 ± 6.5 µm (estimated)" in here("run", "show", str(left)).out
    assert here("run", "show", str(left), "--json").document["result"]["est_depth_u95_um"] == 6.5
    listed = here("run", "list", str(tmp_path)).out
    assert " ~153.1 " in listed
    assert "\n~ estimated by feed and energy, not touched." in listed
    compared = here("run", "compare", str(left), str(left)).out
    (line,) = (line for line in compared.splitlines() if line.startswith("depth "))
    assert line.split("   ")[0] == "depth when left (estimated), µm"
    assert "153.1 ± 6.5" in line


def test_a_recovered_run_was_killed_and_not_refused(here: Here, tmp_path: Path) -> None:
    here("run", "recover", str(killed(tmp_path, "dead")))
    said = " ".join(here("run", "explain", str(tmp_path / "dead.h5")).out.split())
    assert "was killed" in said
    assert "refused" not in said
    assert "exit code" not in said


def test_a_file_name_stays_on_its_line(here: Here, tmp_path: Path) -> None:
    made(tmp_path, "left", "machine").rename(tmp_path / "two\nlines\x1b[2J.h5")
    (tmp_path / "no\nfile.h5").write_text("no HDF5 at all")
    listed = here("run", "list", str(tmp_path)).out
    assert [line.split()[0] for line in listed.splitlines()[1:3]].count(r"two\nlines\x1b[2J") == 1
    assert r"no\nfile.h5" in listed
    assert "\x1b[2J" not in listed
