"""What the rest of the program hands to a run file, in physical units.

Array fields have shape (n,) and one length per block. A block is kept by reference until it is written,
so its arrays must not be changed afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import TYPE_CHECKING, Protocol, TypeAlias

from edmctl.dataclasses import dataclass, field
from edmctl.results.declared import PURE, TEXT, quantity, um
from edmctl.results.job import SiteResult
from edmctl.results.telemetry import LinkReport, PulseBlockBatch, PulseTrain, TelemetryBlock, WaveformBatch

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    FloatArray = NDArray[np.floating]
    IntArray = NDArray[np.integer]


class RunEvent(IntEnum):
    """A decision or a result of a procedure; codes below 100 are the controller's own events."""

    ARMED = 100
    CONDITIONED = 101
    STAGE_MOVED = 102
    APPROACHED = 103
    SELF_TESTED = 105
    READING = 110
    READING_REJECTED = 111
    FACE_FITTED = 112
    TOUCH_DOUBTED = 113
    DOUBT_WITHDRAWN = 114
    CUT_PLANNED = 120
    CUT_ENDED = 121
    JUMPED = 122
    CUT_DECIDED = 123
    CUT_GIVEN_UP = 124
    SITE_MEASURED = 130
    TARGET_REACHED = 131
    TARGET_MISSED = 132
    LEFT_UNMEASURED = 133
    SITE_ESTIMATED = 134
    RESUMED = 135
    SITES_LEFT = 136
    VERDICT = 137
    ARCING = 140
    SHORTING = 141
    Z_MISMATCH = 142
    LINE_NOISE = 143
    LINK = 144
    SETUP_WRONG = 145
    BELIEF_CONTRADICTED = 146
    CONTROLLER_LOG = 150
    ENDED_EARLY = 160
    JUMP_PERIOD = 161
    REFERENCE_CHANGED = 162
    DUTY_CHANGED = 163
    SHORT_RECOVERY = 164
    ARC_BURN_RECOVERY = 165
    STALL_JUMP = 166
    BREAKTHROUGH = 167
    PASS_ENDED = 170
    CHANNEL_MEASURED = 171
    WEAR_MEASURED = 180
    SURFACE_FOUND = 181
    JUMP_MEASURED = 182
    DRIFT_MEASURED = 183
    CREEP_RESTED_OUT = 184


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
    """Consecutive servo samples. Displacements are positive towards the workpiece."""

    time_s: FloatArray = quantity("s", "time since start")
    actuator_v: FloatArray = quantity("V", "actuator voltage", dtype="f4", column="v_cmd")
    displacement_um: FloatArray = um(
        "tool displacement, sensor; NaN without one", dtype="f4", column="z_sensor"
    )
    model_um: FloatArray = um("tool displacement, estimated from the voltage", dtype="f4", column="z_model")
    gap_v: FloatArray = quantity("V", "mean gap voltage", dtype="f4", column="v_gap_avg")
    gap_ratio: FloatArray = quantity(
        PURE, "mean gap voltage over duty factor × open voltage", dtype="f4", column="s"
    )
    current_a: FloatArray = quantity("A", "mean gap current", dtype="f4")
    direction: IntArray = quantity(
        PURE, "direction of the servo: −1 back, 0 hold, 1 forward", dtype="i1", column="dir"
    )
    state: IntArray = quantity(PURE, "state of the controller", dtype="u1")


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

    time_s: float = quantity("s", "time since start")
    kind: str = quantity(TEXT, "Z1, Z2 or Z3; Zr at a place that is not machined yet", dtype="S4")
    site: str = quantity(TEXT, "site", dtype="S128")
    actuator_v: float = quantity("V", "actuator voltage", column="v_cmd")
    displacement_um: float = um("displacement, sensor; NaN without one", column="z_sensor")
    model_um: float = um("displacement, estimated", column="z_model")
    touches: int = quantity(PURE, "touches", dtype="u2", column="n")
    sd_um: float = um("standard deviation of one touch")
    drift_um: float = um("drift between repeated readings")
    speed_um_s: float = quantity("um/s", "approach speed", column="speed")
    accepted: bool = quantity(
        PURE,
        "1 when the reading was used, 0 when another one counts instead",
        dtype="u1",
        default=True,
    )


@dataclass(frozen=True, slots=True)
class RejectedTouch:
    """Marks the reading of that time as one that is not used, because of what was touched after it."""

    time_s: float


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
    | SiteResult
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
