"""Print how even and how deep the channels of the virtual machine come out: `python -m benchmarks.channel`.

    python -m benchmarks.channel [--runs 2] [--seed 1] [--profile channel-spiral …]

The whole job over real frames, judged by the plant's height map under the path of the tool's axis: the bar is a
floor within 2 µm RMS of the target depth along the path. Exit code 1 if it is missed.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.jobs.connect import connected
from edmctl.planning.channel import way_of_path
from edmctl.planning.forecast import forecast
from edmctl.planning.rules.load import load_profile
from edmctl.procedures.job import job_of
from edmctl.procedures.machining import run_job
from edmctl.profile.setup import Setup
from edmctl.record.rows import NullRecorder
from edmctl.results.forecast import Forecast

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.planning.rules.load import LoadedProfile
    from edmctl.results.forecast import Forecast
    from edmctl.results.job import ChannelResult, JobResult
    from edmctl.results.progress import Progress

    Array = NDArray[np.float64]

PROFILES = ("channel-rectangle", "channel-circle", "channel-spiral")
RMS_BAR_UM = 2.0
STEP_UM = 5.0
"""The floor is looked at every so often along the path."""


class Quiet(NullRecorder):
    """Nobody is told."""

    def progress(self, p: Progress) -> None:
        """Do nothing."""

    def note(self, text: str) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class Done:
    """One channel: what the program found, what the plant knows, what was forecast."""

    job: JobResult
    channel: ChannelResult
    floor_um: Array
    """True depths under the path, shape (n,)."""
    expected: Forecast
    wall_s: float

    def rms_um(self, target_um: float) -> float:
        """Error of the floor along the path."""
        return math.sqrt(float(np.mean((self.floor_um - target_um) ** 2)))


def machined(loaded: LoadedProfile, seed: int) -> Done:
    """Run the job of a profile on the machine of a seed."""
    begin_s = time.perf_counter()
    profile, setup = loaded.profile, Setup()
    quiet = Quiet()
    with connected(loaded, setup, seed, quiet.note) as bench:
        job = run_job(bench.machine, job_of(profile, setup), recorder=quiet, observer=quiet)
        assert bench.virtual is not None
        x_um, y_um, depth_um = bench.virtual.truth_map()
    assert job.channel is not None
    assert profile.path is not None
    way = way_of_path(profile.path)
    places = np.array([way.at(s_um) for s_um in np.arange(0.0, way.length_um, STEP_UM)])
    floor_um = depth_um[nearest(y_um, places[:, 1]), nearest(x_um, places[:, 0])]
    return Done(job, job.channel, floor_um, forecast(profile, setup), time.perf_counter() - begin_s)


def nearest(centres: Array, values: Array) -> NDArray[np.int64]:
    """Index of the nearest of evenly spaced centres."""
    steps = np.rint((values - centres[0]) / (centres[1] - centres[0])).astype(np.int64)
    clipped: NDArray[np.int64] = np.clip(steps, 0, len(centres) - 1)
    return clipped


def line(name: str, seed: int, target_um: float, done: Done) -> str:
    """One row of the table."""
    channel, off_um = done.channel, done.floor_um - target_um
    return (
        f"{name:<18} {seed:>4} {done.rms_um(target_um):8.2f} {off_um.mean():+8.2f} {off_um.std():7.2f} "
        f"{off_um.min():+7.2f} {off_um.max():+7.2f} {channel.depth_um - target_um:+8.2f} ± "
        f"{channel.depth_u95_um:4.2f} {channel.wear_um:7.1f} {channel.layers:>4} "
        f"{channel.passes:>4} {channel.measuring_stops:>4} "
        f"{done.job.machining_time_s:7.0f} ({done.expected.machining_time_s:.0f}) "
        f"{done.job.time_s:7.0f} ({done.expected.time_s:.0f}) {done.wall_s:6.0f}"
    )


HEADER = (
    "profile            seed  rms µm  mean µm   sd µm  min µm  max µm   found µm  ±    wear µm lay. pass stop "
    " machining s (fc.)  whole s (fc.)   wall"
)


def main() -> int:
    """Run everything, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--profile", nargs="+", default=PROFILES)
    parser.add_argument("--set", action="append", default=[], dest="overrides")
    args = parser.parse_args()
    print(HEADER)
    met = True
    for name in args.profile:
        loaded = load_profile(name, tuple(args.overrides))
        target = loaded.profile.target
        assert target.kind == "depth"
        for seed in range(args.seed, args.seed + args.runs):
            done = machined(loaded, seed)
            met = met and done.rms_um(target.depth_um) <= RMS_BAR_UM
            print(line(name, seed, target.depth_um, done), flush=True)
    print(f"bar: {RMS_BAR_UM:g} µm rms along the path: {'met' if met else 'MISSED'}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
