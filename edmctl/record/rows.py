"""Input of a run file: its header, and rows in physical units.

Array fields have shape (n,) and one length per block. A block is kept by reference until it is written,
so its arrays must not be changed afterwards.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from edmctl.dataclasses import dataclass, field
from edmctl.results.declared import PURE, TEXT, flag, quantity, um
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
    """A state, jump, fault or decision; its message is cut to 160 bytes, its arguments to 200 bytes of JSON."""

    time_s: float
    code: int
    level: EventLevel
    message: str
    args: Mapping[str, float | int | str | bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "args", dict(self.args))


def _f4(units: str, title: str, column: str = "", **options: Any) -> Any:
    return quantity(units, title, dtype="f4", column=column, **options)


def _unknown(units: str, title: str, column: str) -> Any:
    return _f4(units, title, column, default=math.nan)


@dataclass(slots=True)
class ServoBlock:
    """Consecutive servo samples. Displacements are positive towards the workpiece."""

    time_s: FloatArray = quantity("s", "time since start")
    actuator_v: FloatArray = _f4("V", "actuator voltage", "v_cmd")
    displacement_um: FloatArray = _f4("um", "tool displacement, sensor; NaN without one", "z_sensor")
    model_um: FloatArray = _f4("um", "tool displacement, estimated from the voltage", "z_model")
    gap_v: FloatArray = _f4("V", "mean gap voltage", "v_gap_avg")
    gap_ratio: FloatArray = _f4(PURE, "mean gap voltage over duty factor × open voltage", "s")
    current_a: FloatArray = _f4("A", "mean gap current")
    direction: IntArray = quantity(
        PURE, "direction of the servo: −1 back, 0 hold, 1 forward", dtype="i1", column="dir"
    )
    state: IntArray = quantity(PURE, "state of the controller", dtype="u1")


@dataclass(slots=True)
class SlowRow:
    """One row of the supervisor. Unknown values are NaN."""

    time_s: float = quantity("s", "time since start")
    feed_um_s: float = _f4("um/s", "feed rate", "feed_um_s")
    gap_ratio: float = _f4(PURE, "mean gap voltage over duty factor × open voltage", "s")
    gap_ratio_ref: float = _f4(PURE, "servo reference", "s_ref")
    ratio_open: float = _f4(PURE, "share of open pulses", "r_open")
    ratio_normal: float = _f4(PURE, "share of normal discharges", "r_normal")
    ratio_arc: float = _f4(PURE, "share of arcs", "r_arc")
    ratio_short: float = _f4(PURE, "share of shorts", "r_short")
    _: KW_ONLY
    depth_um: float = _f4("um", "estimated depth", "est_depth")
    depth_u95_um: float = _unknown("um", "half the 95 % interval of the estimated depth", "est_depth_u95")
    wear_um: float = _f4("um", "estimated tool wear", "est_wear")
    wear_u95_um: float = _unknown("um", "half the 95 % interval of the estimated tool wear", "est_wear_u95")
    jump_period_s: float = _unknown("s", "jump period; NaN without jumps", "jump_period")
    power_w: float = _f4("W", "mean discharge power", "p_avg")
    dielectric_c: float = _unknown("degC", "temperature of the dielectric", "temp_dielectric")
    flow_lpm: float = _unknown("L/min", "flow of the dielectric", "flow")
    link_errors: int = quantity(PURE, "telemetry frames missing so far", dtype="u4", default=0)


@dataclass(frozen=True, slots=True)
class TruthMap:
    """The true floor of a channel: depths, shape (m, n), over y (m,) and x (n,), µm. It replaces an earlier one."""

    x_um: FloatArray
    y_um: FloatArray
    depth_um: FloatArray


TIME_TOLERANCE_S = 2e-6
"""How far the start of a train may be from a segment's count: twice the LSB of a controller's time."""


@dataclass(frozen=True, slots=True)
class Segment:
    """Pulses from row `first_row` on: pulse first_row + i begins at start_s + i × period_s."""

    first_row: int = quantity(PURE, "first row in `/entry/pulses/full`", dtype="u8")
    first_pulse: int = quantity(PURE, "number of that pulse since the controller started", dtype="u8")
    start_s: float = quantity("s", "time of that pulse since start", column="t0")
    period_s: float = quantity("s", "pulse period")

    def continues_in(self, train: PulseTrain, row: int) -> bool:
        """Whether `train`, stored from `row` on, follows the segment's pulses without a gap."""
        passed = row - self.first_row
        return (
            train.period_s == self.period_s
            and train.first_pulse == self.first_pulse + passed
            and abs(self.start_s + passed * self.period_s - train.start_s) <= TIME_TOLERANCE_S
        )


@dataclass(frozen=True, slots=True)
class LinkRow:
    """Statistics of the line since it was opened."""

    time_s: float = quantity("s", "time since start")
    report: LinkReport = quantity(PURE, "statistics since the line was opened", nested=LinkReport)


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
    accepted: bool = flag("1 when the reading was used, 0 when another one counts instead", default=True)


@dataclass(frozen=True, slots=True)
class RejectedTouch:
    """Marks the reading of that time as one that is not used, because of later touches."""

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
"""Rows of a run file. A TelemetryBlock is the black box: samples of the controller from before a fault."""


class Recorder(Protocol):
    """Takes rows in order of time: into a run file, or nowhere."""

    def append(self, row: Row) -> None:
        """Append a row, or a block whose arrays are kept by reference.

        May raise RunFileError once, when the disk fails; later rows are then ignored, so that the caller can still
        bring the machine to its safe point.
        """


class NullRecorder:
    """Keeps nothing: for runs without a file."""

    def append(self, row: Row) -> None: ...


UNIT_SUFFIXES = {
    **{"um3_per_uj": "um3/uJ", "um_per_v": "um/V", "um_s2": "um/s2", "um_s": "um/s", "v_s": "V/s"},
    **{unit: unit for unit in ("um", "mm", "us", "ns", "ms", "s", "deg", "mrad", "ohm")},
    **{"v_max": "V", "v": "V", "a": "A", "w": "W", "uj": "uJ", "hz": "Hz", "khz": "kHz", "pf": "pF"},
    **{"lpm": "L/min", "c": "degC", "degc": "degC"},
}
"""Endings of a key, longest first, and the unit they stand for."""
Leaf: TypeAlias = float | int | str | bool
"""One value of a profile."""


@dataclass(frozen=True, slots=True)
class SourceText:
    """A file that went into a run: where it was found, and its text."""

    path: str
    text: str


def scalar(path: str, title: str, dtype: str = "text", units: str = TEXT, **options: Any) -> Any:
    """Declare a value with a dataset of its own; `options` go to `dataclasses.field`."""
    return field(metadata={"scalar": (f"/entry/{path}", dtype, units, title)}, **options)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunMeta:
    """Everything about a run that is known before it starts.

    Times are ISO 8601 with offset, texts of files verbatim. `parent_run` is the run that this one continues;
    `profile_parents` are the files that the profile extends, nearest first.
    """

    title: str = scalar("title", "title")
    run_id: str = scalar("run_id", "identifier of the run")
    parent_run: str = scalar("parent_run", "run that was taken up again; empty without", default="")
    parent_time_s: float = scalar(
        "parent_time", "time of the job in the runs before; 0 without", "f8", "s", default=0.0
    )
    command: Sequence[str] = scalar("command", "command line, as a JSON list")
    procedure: str = scalar(
        "procedure",
        "what was done: `machine`, `approach`, `contact touch`, `measure-wear`, `wear reference`, "
        "`jump-flush`, `measure-drift`",
        default="machine",
    )
    start_time: str = scalar("start_time", "start, ISO 8601")
    simulated: bool = scalar("simulated", "1 when the machine was virtual", "u1", PURE)
    seed: int | None = scalar("seed", "seed of the virtual machine; −1 without", "i8", PURE)
    user: str = scalar("user/name", "user", default="")
    work_material: str = scalar("sample/material", "work material", default="")
    work_thickness_um: float = scalar("sample/thickness", "work thickness", "f8", "um", default=math.nan)
    tool_material: str = scalar("tool/material", "tool material", default="")
    tool_diameter_um: float = scalar("tool/diameter", "tool diameter", "f8", "um", default=math.nan)
    profile_text: str = scalar("profile/toml", "profile, verbatim")
    profile_path: str = scalar("profile/path", "where the profile was found", default="")
    profile_parents: Sequence[SourceText] = ()
    profile_leaves: Mapping[str, Leaf] = field(default_factory=dict)
    profile_sha256: str = scalar("profile/recipe_sha256", "SHA-256 of the recipe in effect")
    sim_sha256: str = scalar("profile/sim_sha256", "SHA-256 of `[sim]` in effect", default="")
    profile_overrides: Sequence[str] = scalar("profile/overrides", "overrides, one a line", default=())
    setup_toml: str = scalar("machine/toml", "setup in effect, every value", default="")
    setup_text: str = scalar("machine/setup_file", "the setup file; empty without", default="")
    setup_path: str = scalar("machine/setup_path", "where the setup was found; empty without", default="")
    setup_sha256: str = scalar("machine/setup_sha256", "hash of the setup's values", default="")
    host: str = scalar("machine/host", "host name")
    controller_serial: str = scalar("machine/serial", "serial number of the controller", default="")
    firmware_version: str = scalar("machine/firmware", "firmware version", default="")
    protocol_version: str = scalar("machine/protocol", "protocol version", default="")
    calibration: str = scalar("machine/calibration", "actuator model of the run, in words", default="")
    calibration_text: str = scalar("machine/calibration_toml", "calibration file; empty without", default="")
    drift_text: str = scalar("machine/drift_toml", "drift file; empty without", default="")
    edmctl_version: str = scalar("software/version", "version of edmctl")


def profile_leaves(profile: Mapping[str, object], prefix: str = "") -> dict[str, Leaf]:
    """Return every value of the nested `profile` by dotted key; lists become JSON, None is left out."""
    found: dict[str, Leaf] = {}
    for name, value in profile.items():
        key = f"{prefix}{name}"
        if isinstance(value, Mapping):
            found |= profile_leaves(value, f"{key}.")
        elif isinstance(value, float | int | str | bool):
            found[key] = value
        elif value is not None:
            found[key] = json.dumps(value, default=str)
    return found


def unit_of(name: str) -> str:
    """Return the unit that the ending of `name` names; `1` if it names none."""
    return next((unit for suffix, unit in UNIT_SUFFIXES.items() if name.endswith(f"_{suffix}")), PURE)
