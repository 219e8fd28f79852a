"""What the plant knows of a channel: its floor under the path, for judging the measurement."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING

from edmctl.errors import RunFileError
from edmctl.results.channel import ChannelTruth

if TYPE_CHECKING:
    from edmctl.profile.model import Profile
    from edmctl.record.rows import Recorder
    from edmctl.simulator import VirtualBench

STEP_UM = 5.0
"""The floor is looked at every so often along the path."""


def channel_truth(profile: Profile, bench: VirtualBench, wear_um: float) -> ChannelTruth | None:
    """Look along the path in the height map; None where the recipe has no path or nothing was cut."""
    import numpy as np

    from edmctl.procedures.channel.way import way_of_path

    path, target = profile.path, profile.target
    x_um, y_um, depth_um = bench.truth_map()
    if path is None or target.kind != "depth" or len(x_um) < 2 or len(y_um) < 2:
        return None
    way = way_of_path(path)
    places = np.array([way.at(s_um) for s_um in np.arange(0.0, way.length_um, STEP_UM)])
    columns = np.rint((places[:, 0] - x_um[0]) / (x_um[1] - x_um[0])).astype(np.int64)
    rows = np.rint((places[:, 1] - y_um[0]) / (y_um[1] - y_um[0])).astype(np.int64)
    floor_um = depth_um[np.clip(rows, 0, len(y_um) - 1), np.clip(columns, 0, len(x_um) - 1)]
    error_um = math.sqrt(float(np.mean((floor_um - target.depth_um) ** 2)))
    return ChannelTruth(float(floor_um.mean()), float(floor_um.std()), error_um, wear_um)


def keep_truth_map(recorder: Recorder, bench: VirtualBench) -> None:
    """Write the height map of the work into the run file. A disk that failed is told at the end of the file."""
    from edmctl.record.rows import TruthMap

    with suppress(RunFileError):
        recorder.append(TruthMap(*bench.truth_map()))
