"""A whole quick channel over real frames: a ring 5 µm deep, judged by the height map that only the plant knows."""

from __future__ import annotations

import math
import signal
from dataclasses import dataclass, field
from random import Random

import numpy as np
import pytest

from edmctl.errors import EdmError
from edmctl.jobs.connect import bench_config
from edmctl.jobs.truth import channel_truth
from edmctl.labels import Basis
from edmctl.link.session import Session
from edmctl.machine.controller import LinkMachine
from edmctl.machine.stop import StopRequest
from edmctl.planning.channel import way_of_path
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import JobTally, job_of
from edmctl.procedures.machining import run_job
from edmctl.process.channel import Way
from edmctl.profile.setup import Setup
from edmctl.record.rows import RunEvent
from edmctl.results.job import ChannelResult
from edmctl.results.progress import Phase, Progress
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from edmctl.simulator.injection import parse_injection
from tests.procedures.channel_bench import CIRCLE
from tests.procedures.conftest import Seen, Told
from tests.tiers import tiers

DEPTH_UM = 5.0
QUICK = (
    "path.radius_um=130.0",
    f"target.depth_um={DEPTH_UM}",
    "path.speed_um_s=400.0",
    "pulse.current_a=0.36",
    'jump.mode="off"',
    "measure.touches=2",
    "measure.settle_s=0.2",
    "measure.speed_um_s=2.0",
    "measure.fast_um_s=40.0",
    "approach.speed_um_s=4.0",
)


@dataclass(frozen=True, slots=True)
class Made:
    """A quick channel that was machined; tests only look at it."""

    bench: VirtualBench
    channel: ChannelResult
    seen: Seen
    way: Way

    def floor_um(self, beside_um: float = 0.0) -> list[float]:
        """True depths every 10 µm along the path, or so far outside of it."""
        x_um, y_um, depth_um = self.bench.truth_map()
        centre = self.way.points[:-1].mean(axis=0)
        found = []
        for s_um in np.arange(0.0, self.way.length_um, 10.0):
            place = np.array(self.way.at(float(s_um)))
            out = (place - centre) / np.hypot(*(place - centre))
            at_x, at_y = place + beside_um * out
            column, row = int(np.abs(x_um - at_x).argmin()), int(np.abs(y_um - at_y).argmin())
            within = max(abs(x_um[column] - at_x), abs(y_um[row] - at_y)) <= 2.5
            found.append(float(depth_um[row, column]) if within else 0.0)
        return found


@pytest.fixture(scope="module")
def made() -> Made:
    return machined()


def machined(inject: str = "") -> Made:
    loaded = load_profile(CIRCLE, QUICK)
    profile = loaded.profile
    config = BenchConfig(tool_diameter_um=profile.tool.diameter_um, offset_um=profile.approach.offset_um)
    bench = open_bench(config, seed=2)
    if inject:
        bench.inject(parse_injection(inject))
    session = Session(bench.transport, Random(1))
    session.open()
    seen = Seen()
    result = run_job(LinkMachine(session), job_of(profile, Setup()), recorder=seen, observer=Told())
    assert result.channel is not None
    assert profile.path is not None
    return Made(bench, result.channel, seen, way_of_path(profile.path))


def test_the_floor_is_even_as_wide_as_planned_and_as_stated_and_its_steps_are_recorded(made: Made) -> None:
    channel, floor_um, half_um = made.channel, made.floor_um(), made.channel.width_um / 2.0
    off_um = np.array(floor_um) - DEPTH_UM
    assert np.sqrt((off_um**2).mean()) < 1.0
    assert off_um.std() < 0.3
    assert min(made.floor_um(half_um - 10.0)) > DEPTH_UM - 1.0
    assert max(made.floor_um(half_um + 10.0)) == 0.0
    assert abs(channel.depth_um - np.mean(floor_um)) < channel.depth_u95_um < 1.0
    assert abs(channel.wear_um - made.bench.tool_wear_um) < channel.wear_u95_um
    assert channel.feed_um == pytest.approx(channel.depth_um + channel.wear_um)
    volume_um3, face_um2 = channel.width_um * made.way.length_um * DEPTH_UM, np.pi * 75.0**2
    assert made.bench.tool_wear_um == pytest.approx(0.337 * volume_um3 / face_um2, rel=0.2)
    assert 2.0 < channel.working_gap_um < 7.0
    assert channel.ratios.normal > 0.3
    codes, (row,) = made.seen.codes, made.seen.sites
    assert codes.count(RunEvent.PASS_ENDED) == channel.passes
    assert codes.count(RunEvent.CHANNEL_MEASURED) == channel.measuring_stops
    assert RunEvent.TARGET_REACHED in codes
    assert {touch.kind for touch in made.seen.touches} == {"Z1", "Zr", "Z2", "Z3"}
    assert row.depth_um == channel.depth_um
    assert made.seen.doubts == []


@pytest.mark.parametrize("name", tiers("CHIP", slow=("LOOSE_CHIP",)))
@pytest.mark.parametrize("kind", tiers("Z2", slow=("Z1", "Zr", "Z3")))
def test_a_chip_under_any_touch_is_told_and_covered(made: Made, kind: str, name: str) -> None:
    kinds = [row.kind for row in made.seen.touches]
    number = len(kinds) - kinds[::-1].index(kind)
    spoilt = machined(f"{name}_9@touch{number}+0")
    channel = spoilt.channel
    assert spoilt.seen.doubts
    assert abs(channel.depth_um - np.mean(spoilt.floor_um())) < channel.depth_u95_um
    assert abs(channel.wear_um - spoilt.bench.tool_wear_um) < channel.wear_u95_um


@dataclass(slots=True)
class Shorts(Told):
    """Closes the contact once the channel was touched, and asks to stop soon after."""

    bench: VirtualBench | None = None
    tally: JobTally = field(default_factory=JobTally)
    request: StopRequest = field(default_factory=StopRequest)
    since_s: float = math.inf

    def progress(self, p: Progress) -> None:
        assert self.bench is not None
        if math.isinf(self.since_s) and self.tally.channel is not None and p.phase is Phase.MACHINING:
            self.since_s = p.time_s
            self.bench.inject(parse_injection("WIRE_SHORT@0"))
        if p.time_s > self.since_s + 1.5:
            self.request.request(signal.SIGINT)


@pytest.mark.parametrize("seed", tiers(3, slow=(4, 5)))
def test_a_channel_that_is_left_while_the_gap_is_shorted_is_no_shallower_than_it_was_touched(
    seed: int,
) -> None:
    loaded = load_profile(CIRCLE, QUICK)
    bench = open_bench(bench_config(loaded, Setup()), seed)
    session, told = Session(bench.transport, Random(1)), Shorts(bench=bench)
    session.open()
    machine, job = LinkMachine(session, told.request), job_of(loaded.profile, Setup())
    with pytest.raises(EdmError):
        run_job(machine, job, recorder=Seen(), observer=told, tally=told.tally)
    left, truth = told.tally.channel, channel_truth(loaded.profile, bench, bench.tool_wear_um)
    assert left is not None
    assert truth is not None
    assert left.depth_basis is Basis.ESTIMATED
    assert left.depth_um > 1.0
    assert abs(left.depth_um - truth.depth_um) <= left.depth_u95_um
