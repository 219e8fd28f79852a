"""Holes that are roughed and finished, judged by the plant's truth."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

import edmctl
from edmctl.errors import Interrupted
from edmctl.jobs.job import Report
from edmctl.record.journal import read_journal
from edmctl.results.progress import Progress
from tests.tiers import tiers

REGIMES = [
    {"name": "rough", "share": 0.75, "current_a": 0.3, "reference": 0.78},
    {"name": "fine", "share": 0.25, "current_a": 0.06, "frequency_hz": 7000, "duty": 0.35},
]
JOB = {
    **{"target.depth_um": 24, "regimes": REGIMES, "log.pulses": "off", "approach.speed_um_s": 3},
    **{"measure.settle_s": 0.2, "measure.fast_um_s": 50},
}


class StoppedIn:
    def __init__(self, regime: str, seconds: float) -> None:
        self.stop = edmctl.StopRequest()
        self._regime, self._seconds = regime, seconds
        self._since_s = -1.0
        self._now_s = 0.0

    def progress(self, p: Progress) -> None:
        self._now_s = p.time_s
        if 0.0 <= self._since_s < p.time_s - self._seconds:
            self.stop.request(signal.SIGINT)

    def note(self, text: str) -> None:
        if text.startswith(f"Regime {self._regime}"):
            self._since_s = self._now_s


def is_right(report: Report) -> bool:
    report.raise_for_error()
    (site,), (truth,) = report.sites, report.truths
    return (
        abs(truth.depth_um - 24.0) <= 2.0
        and abs(truth.depth_um - site.depth_um) <= 3.0 * site.depth_u_um
        and abs(truth.wear_um - site.wear_um) <= 3.0 * site.wear_u_um
    )


@pytest.mark.parametrize("tool_wear", tiers(1.0, slow=(0.4, 2.2)))
def test_a_hole_is_roughed_and_finished_to_its_depth(tool_wear: float, tmp_path: Path) -> None:
    report = edmctl.connect("sim:", seed=6).machine(
        "cu270", overrides={**JOB, "sim.tool_wear": tool_wear}, out=tmp_path, warn=lambda _: None
    )
    assert is_right(report)
    rough = edmctl.connect("sim:", seed=6).machine(
        "cu270", overrides={**JOB, "regimes": [], "pulse.current_a": 0.3, "servo.reference": 0.78}
    )
    assert report.truths[0].ra_um < 0.7 * rough.truths[0].ra_um
    assert report.run_file is not None
    with edmctl.open_run(report.run_file) as run:
        messages = [row["message"].decode() for row in run.table("/entry/events")]
    assert sum(message.startswith("Regime fine: to 24.0 µm with 0.06 A") for message in messages) == 1


@pytest.mark.parametrize(("regime", "seconds"), tiers(("fine", 40.0), slow=(("fine", 15.0),)))
def test_a_hole_is_taken_up_in_the_regime_that_it_was_left_in(
    regime: str, seconds: float, tmp_path: Path
) -> None:
    machine, stopping = edmctl.connect(f"sim:{tmp_path / 'bench'}", seed=7), StoppedIn(regime, seconds)
    left = machine.machine(
        "cu270", overrides=JOB, out=tmp_path, run_id="left", observer=stopping, stop=stopping.stop
    )
    assert isinstance(left.error, Interrupted)
    state = read_journal(tmp_path / "left.journal").state
    assert state["regime"] == 1
    assert 14.0 < float(str(state["regime_depth_um"])) < 20.0
    assert is_right(machine.resume("left", out=tmp_path))


def test_regimes_and_an_adaptive_reference_go_together() -> None:
    regimes = [{key: value for key, value in one.items() if key != "reference"} for one in REGIMES]
    overrides = {**JOB, "regimes": regimes, "adaptive.seek_reference": True}
    assert is_right(edmctl.connect("sim:", seed=8).machine("cu270", overrides=overrides))


@pytest.mark.parametrize("remeasure", tiers("sparing", slow=(2,)))
def test_the_next_regime_follows_however_little_is_measured(remeasure: object) -> None:
    overrides = {**JOB, "target.depth_um": 14, "wear.remeasure": remeasure}
    report = edmctl.connect("sim:", seed=3).machine("cu270", overrides=overrides, warn=lambda _: None)
    report.raise_for_error()
    assert abs(report.truths[0].depth_um - 14.0) <= 2.0
    assert abs(report.truths[0].depth_um - report.sites[0].depth_um) <= report.sites[0].depth_u95_um
