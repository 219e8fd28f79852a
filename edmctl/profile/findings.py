"""What is found wrong with a profile or setup: a stable code, the value to blame, the remedy.

E30xx are about the file; E31nn and W31nn (a warning) are cross-field rule nn.
"""

from __future__ import annotations

import math
from enum import StrEnum

from edmctl.dataclasses import dataclass
from edmctl.errors import Location
from edmctl.profile.positions import KeyPath

PAD_MARGIN_UM = 50.0  # surface left between a hole and the reference pad, for the burr and the stages
REFERENCE_MARGIN, REFERENCE_MAX = 0.05, 0.95
"""Least servo reference above the level of a gap that sparks at every pulse, and the highest."""
WALL_UM = 20.0  # work left standing between two holes or two sides of a channel


class Code(StrEnum):
    """One code per kind of problem. Codes are never reused."""

    SYNTAX = "E3001"
    MISSING_KEY = "E3002"
    UNKNOWN_KEY = "E3003"
    WRONG_TYPE = "E3004"
    OUT_OF_RANGE = "E3005"
    NOT_A_CHOICE = "E3006"
    EXTENDS = "E3007"
    SCHEMA_VERSION = "E3008"
    OVERRIDE = "E3009"
    UNREADABLE = "E3010"
    NOT_A_MULTIPLE = "E3011"
    PLACES_FILE = "E3012"
    STUDY = "E3013"

    REFERENCE_WINDOW = "E3101"
    STROKE = "E3102"
    SLOPE_BELOW_FEED = "E3103"
    SLOPE_NEAR_FEED = "W3103"
    LIMIT_CYCLE = "E3104"
    LIMIT_CYCLE_LARGE = "W3104"
    RAMP_ORDER = "E3105"
    OFFSET = "E3106"
    JUMP = "E3107"
    JUMP_TOO_LOW = "W3107"
    PULSE_ENERGY = "W3108"
    PULSE_TIMES = "E3109"
    THROUGH_STROKE = "E3110"
    TOLERANCE = "E3111"
    FILTER = "E3113"
    FEED_REMEASURE = "E3114"
    DISCHARGE_TIME = "E3115"
    REFERENCE_ONCE = "E3116"
    TOOL_WEAR = "E3117"
    APPROACH_TRAVEL = "E3118"
    BLIND_DEPTH = "E3119"
    TIME_LIMIT = "W3120"
    ACTUATOR_VOLTAGE = "E3121"
    PAD_DISTANCE = "E3122"
    TARGET_KIND = "E3123"
    NOT_THROUGH = "W3123"
    ADAPTIVE = "E3124"
    PATH_KEYS = "E3125"
    SITES_OR_PATH = "E3126"
    SITES = "E3127"
    OVERLAP = "E3128"
    ARRAY_WEAR = "W3129"
    ARRAY_STROKE = "W3130"
    LAYER = "W3131"
    NOT_SHOWN = "W3132"
    LESS_THAN_TOLERANCE = "W3133"
    UNKNOWN_MATERIAL = "W3134"
    SIM_CONTRADICTS = "W3135"
    BEYOND_LAWS = "W3136"
    STATED_CONTRADICTS = "W3139"
    REGIMES = "E3137"
    NO_REMOVAL = "E3138"
    OUT_OF_REACH = "E3140"


@dataclass(frozen=True, slots=True)
class Finding:
    """One violated rule, blamed on the value at `path`, or on a line of a file that it names (`where`)."""

    code: Code
    path: KeyPath
    message: str
    hint: str
    where: Location | None = None

    @property
    def is_warning(self) -> bool:
        """Codes of warnings begin with W."""
        return self.code.startswith("W")


def rounded_up(value: float) -> str:
    """A least value as a hint gives it: a tenth that is not below it."""
    return f"{math.ceil(10.0 * value - 1e-9) / 10.0:.6g}"


def rounded_down(value: float) -> str:
    """A largest value as a hint gives it: a tenth that is not above it."""
    return f"{math.floor(10.0 * value + 1e-9) / 10.0:.6g}"
