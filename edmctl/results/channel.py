"""Result of a channel: its floor by touches along the path, tool wear, and the sums of its passes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from edmctl.labels import Basis, Verdict
    from edmctl.results.telemetry import PulseShares


@dataclass(frozen=True, slots=True)
class FloorPlace:
    """One touch of the floor: where, at which length along the path, and how deep below the face, µm."""

    s_um: float
    x_um: float
    y_um: float
    depth_um: float


@dataclass(frozen=True, slots=True)
class ChannelResult:
    """One channel, measured by touches: `feed = depth + wear`, u95 are half-widths of 95 % intervals.

    `depth_um` is the mean over the places of `floor`, `floor_sd_um` their standard deviation; the touches cannot
    tell roughness below the tool's face. One that is not `finished` was under way when its job ended early; if it
    was cut on since its last stop, it is estimated and `floor` is empty. `verdict` is None until the channel is
    done. `width_um` is planned. `layers` are those cut, `passes` the times that the path was gone along. `energy_j`
    is mean gap current × plateau voltage of a normal discharge × time, over all passes; `working_gap_um` the gap
    between the held tool and the floor that it left.
    """

    name: str
    length_um: float
    width_um: float
    layers: int
    passes: int
    depth_um: float
    depth_u95_um: float
    floor_sd_um: float
    wear_um: float
    wear_u95_um: float
    feed_um: float
    z1_um: float
    z3_um: float
    machining_time_s: float
    pulses: int
    ratios: PulseShares
    energy_j: float
    working_gap_um: float
    measuring_stops: int
    floor: tuple[FloorPlace, ...]
    depth_basis: Basis
    wear_basis: Basis
    verdict: Verdict | None = None
    finished: bool = False

    def floor_rms_um(self, depth_um: float) -> float:
        """Root mean square of what the places of the floor differ from a depth."""
        squares = math.fsum((place.depth_um - depth_um) ** 2 for place in self.floor)
        return math.sqrt(squares / len(self.floor))


@dataclass(frozen=True, slots=True)
class ChannelTruth:
    """Mean depth of the floor under the path, its scatter, its rms error against the target, the tool's wear, µm."""

    depth_um: float
    floor_sd_um: float
    floor_error_rms_um: float
    wear_um: float
