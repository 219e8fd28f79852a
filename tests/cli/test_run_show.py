"""`edmctl run show`: one run on a page, finished, killed, or while it goes on."""

from __future__ import annotations

import json
import math
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from edmctl.cli.render.progress import Reporter
from edmctl.cli.signals import SignalArrived
from edmctl.errors import RunFileError
from edmctl.jobs.runs.follow import follow_run
from edmctl.jobs.runs.summary import jumps_of
from edmctl.record.rows import EventLevel, EventRow, RunEvent, ServoBlock, SlowRow, Summary
from edmctl.record.writer import RunWriter
from edmctl.results.run_file import FileEvent
from tests.cli.commands import CU270, ROOT, Here, environment
from tests.cli.run_files import begun, finished, killed
from tests.record.samples import a_meta
from tests.tiers import tiers

if TYPE_CHECKING:
    from edmctl.results.progress import Progress

QUICK = ("target.depth_um=8", "measure.settle_s=0.2", "measure.touches=2", "approach.speed_um_s=5.0")


class Seen(Reporter):
    """A reporter that keeps what it gets."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.states: list[Progress] = []

    def progress(self, p: Progress) -> None:
        self.states.append(p)

    def note(self, text: str) -> None:
        self.notes.append(text)


def test_a_job_is_shown_with_the_figures_of_its_own_result(here: Here) -> None:
    options = [word for value in QUICK for word in ("--set", value)]
    naming = ("--seed", "3", "--run-id", "one", "--quiet", "--json")
    made = here("machine", "--profile", CU270, *options, *naming)
    site = made.document["result"]["sites"][0]
    said = here("run", "show", "runs/one.h5")
    assert (said.exit_code, said.err) == (0, "")
    depth = re.search(r"^depth +([\d.]+) ± ([\d.]+) µm", said.out, re.MULTILINE)
    assert depth is not None
    assert [float(text) for text in depth.groups()] == pytest.approx(
        [site["depth_um"], site["depth_u95_um"]], abs=0.006
    )
    assert (site["depth_basis"], site["verdict"]) == ("touched", "shown")
    assert f"{site['truth']['depth_um']:.2f} µm" in said.out
    assert "wanted was a depth of 8 ± 2 µm in Cu" in said.out
    assert "No faults, no warnings." in said.out
    assert max(map(len, said.out.splitlines())) <= 80
    shown = here("run", "show", "runs/one.h5", "--json").document
    assert shown["result"]["summary"] == made.document["result"]
    assert (shown["seed"], shown["simulated"], shown["run_file"]) == (3, True, "runs/one.h5")
    (told,) = shown["result"]["sites"]
    assert told["depth_um"] == site["depth_um"]
    assert told["truth_wear_um"] == site["truth"]["wear_um"]
    assert [touch["kind"] for touch in shown["result"]["touches"]][:2] == ["Z1", "Z1"]
    assert shown["result"]["rows"]["servo"] > 1000


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
