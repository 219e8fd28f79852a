"""What the rest of the program hands to a run file, in physical units.

Array fields have shape (n,) and one length per block. A block is kept by reference until it is written,
so its arrays must not be changed afterwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Protocol, TypeAlias

from edmctl.results.telemetry import PulseBlockBatch, PulseTrain, TelemetryBlock, WaveformBatch

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from edmctl.results.telemetry import LinkReport

    FloatArray = NDArray[np.floating]
    IntArray = NDArray[np.integer]


class EventLevel(IntEnum):
    """Weight of an event. From WARNING on, an event is flushed at once."""

    DEBUG = 0
    INFO = 1
    WARNING = 2
    ERROR = 3


@dataclass(frozen=True, slots=True)
class EventRow:
    """A state, jump, fault or decision. A copy of `args` is kept.

    `message` is cut to 160 bytes; of `args` the last values are left out when their JSON exceeds 200 bytes.
    """

    time_s: float
    code: int
    level: EventLevel
    message: str
    args: Mapping[str, float | int | str | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "args", dict(self.args))


@dataclass(slots=True)
class ServoBlock:
    """Consecutive servo samples."""

    time_s: FloatArray
    actuator_v: FloatArray
    displacement_um: FloatArray
    """Inductive sensor, + towards the work."""
    model_um: FloatArray
    """Displacement estimated from the actuator voltage alone; NaN without an estimator."""
    gap_v: FloatArray
    """Mean gap voltage."""
    gap_ratio: FloatArray
    """Mean gap voltage over duty factor × open voltage."""
    current_a: FloatArray
    direction: IntArray
    """−1 retracting, 0 holding, 1 advancing."""
    state: IntArray
    """State of the controller."""


@dataclass(slots=True)
class SlowRow:
    """One row of the supervisor's view. Unknown values are NaN."""

    time_s: float
    feed_um_s: float
    gap_ratio: float
    gap_ratio_ref: float
    ratio_open: float
    ratio_normal: float
    ratio_arc: float
    ratio_short: float
    depth_um: float
    """Estimated depth."""
    wear_um: float
    """Estimated tool wear."""
    power_w: float
    """Mean discharge power."""
    jump_period_s: float = math.nan
    dielectric_c: float = math.nan
    flow_lpm: float = math.nan
    link_errors: int = 0
    """Telemetry frames missing so far."""
    depth_u95_um: float = math.nan
    """Half the 95 % interval of the estimated depth."""
    wear_u95_um: float = math.nan
    """Likewise of the estimated tool wear."""


@dataclass(frozen=True, slots=True)
class TruthMap:
    """The floor of a channel as the virtual machine knows it: depths, shape (m, n), over y (m,) and x (n,), µm.

    It replaces an earlier one.
    """

    x_um: FloatArray
    y_um: FloatArray
    depth_um: FloatArray


@dataclass(frozen=True, slots=True)
class LinkRow:
    """How the line did from its opening until now."""

    time_s: float
    report: LinkReport


@dataclass(frozen=True, slots=True)
class TouchRow:
    """One accepted or rejected set of touches, reduced to one reading. Later touches may reject an accepted one."""

    time_s: float
    kind: str
    """Z1, Z2 or Z3."""
    site: str
    actuator_v: float
    displacement_um: float
    model_um: float
    touches: int
    sd_um: float
    """Standard deviation of the single touches."""
    drift_um: float
    speed_um_s: float
    accepted: bool = True


@dataclass(frozen=True, slots=True)
class RejectedTouch:
    """Marks the reading of that time as one that is not used, because of what was touched after it."""

    time_s: float


@dataclass(frozen=True, slots=True)
class SiteRow:
    """Result at one site. Unknown values are NaN."""

    site: str
    x_um: float
    y_um: float
    z1_um: float
    z2_um: float
    z3_um: float
    depth_um: float
    depth_u95_um: float
    wear_um: float
    wear_u95_um: float
    feed_um: float
    depth_model_um: float
    wear_model_um: float
    machining_time_s: float
    cuts: int
    pulses: int
    ratio_open: float
    ratio_normal: float
    ratio_arc: float
    ratio_short: float
    energy_j: float = math.nan
    """Mean gap current × plateau voltage of a normal discharge × time, over all cuts."""
    wear_ratio_lin: float = math.nan
    """Wear per depth."""
    wear_ratio_vol: float = math.nan
    """Tool volume lost per hole volume."""
    mrr_mm3_min: float = math.nan
    """Material removal rate: hole volume per machining time."""
    depth_model_error_um: float = math.nan
    """Depth by the model minus depth by the sensor."""
    wear_model_error_um: float = math.nan
    zero_drift_um: float = math.nan
    """How far the rest at 0 V moved from Z1 to Z3, by the sensor beside the model."""
    feed_model_error_max_um: float = math.nan
    """Displacement by the model minus that by the sensor while machining, averaged over 0.1 s: the largest."""
    feed_model_error_rms_um: float = math.nan
    feed_model_error_max_pct: float = math.nan
    """Of the feed."""
    feed_model_error_rms_pct: float = math.nan
    face_um: float = 0.0
    """How much further than the pad the face lies at the site."""
    measuring_stops: int = 0
    """Times that the bottom, and the pad after it, were touched."""
    estimated_um: float = 0.0
    """Part of the depth that was cut after the last touch, and is estimated."""
    through: bool = False
    """The hole goes through the sheet: `depth` is how far the tip went below the face, `z2` where the tip ended."""
    depth_basis: str = ""
    """What the depth rests on, a `Basis`."""
    wear_basis: str = ""
    verdict: str = ""
    """A `Verdict`; empty where no depth was wanted."""


@dataclass(frozen=True, slots=True)
class Summary:
    """The result of the run as a JSON object; it replaces an earlier one."""

    json_text: str


Row: TypeAlias = (
    ServoBlock
    | SlowRow
    | PulseBlockBatch
    | PulseTrain
    | EventRow
    | TouchRow
    | RejectedTouch
    | SiteRow
    | TelemetryBlock
    | WaveformBatch
    | LinkRow
    | TruthMap
    | Summary
)
"""What a run file takes. A TelemetryBlock is the black box: what the controller kept from before a fault."""


class Recorder(Protocol):
    """Takes what procedures see, in order of time: into a run file, or nowhere."""

    def append(self, row: Row) -> None:
        """Append a row, or a block whose arrays are kept by reference.

        May raise RunFileError once, when the disk fails; later rows are then ignored, so that the caller can still
        bring the machine to its safe point.
        """


class NullRecorder:
    """Keeps nothing: for runs without a file."""

    def append(self, row: Row) -> None:
        """Do nothing."""
