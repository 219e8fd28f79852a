"""What a machine's owner sets in the image of its board: ends of ranges, steps of the stages, the line's baud."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.wording import did_you_mean

SOURCES: dict[str, tuple[str, ...]] = {
    "board/scale.h": (),
    "core/limits.h": ("EDM_OFF_NS_MIN", "EDM_OPEN_V_MAX", "EDM_CURRENT_A_MAX"),
    "board/stm32f4/board.h": ("EDM_BAUD",),
}
"""Files of the firmware's sources, and which of their names are settings; an empty tuple: all."""
DEFINE = "EDM_SETTINGS"
"""Name of the chosen settings as one text for the compiler; in the image it follows MAGIC and ends with 0."""
MAGIC = b"EDMS"
_DEFAULT = re.compile(r"^#ifndef (EDM_\w+)\n#define \1 (R\()?(-?\d+(?:\.\d+)?)\b", re.MULTILINE)
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_PAIR = re.compile(rf"(EDM_[A-Z0-9_]+)=({_NUMBER.pattern})", re.ASCII)
_RANGES = {
    "EDM_BAUD": (9600, 2_000_000),
    "EDM_MOST_STEPS_PER_MS": (1, 140),
    "EDM_OFF_NS_MIN": (10_000, 1_000_000),
}
"""Of whole numbers: limits of the line's ring, of the timers of the stages and of the pulse counting."""
_LEAST, _MOST = 1e-6, 1e6
"""Of the others; a `float` of the board distinguishes all of them from 0."""
_ORDERED = (
    ("EDM_OPEN_V_MAX", "EDM_GAP_FULL_V"),
    ("EDM_OPEN_V_MAX", "EDM_OPEN_FULL_V"),
    ("EDM_CURRENT_A_MAX", "EDM_GAP_FULL_A"),
    ("EDM_CURRENT_A_MAX", "EDM_PEAK_FULL_A"),
    ("EDM_NORMAL_PLATEAU_V", "EDM_OPEN_V_MAX"),
    ("EDM_MONITOR_LEAST_V", "EDM_MONITOR_MOST_V"),
    ("EDM_SENSOR_LEAST_UM", "EDM_SENSOR_MOST_UM"),
)
_MONITOR_V = (-0.5, 151.0)
"""The actuator's 0 to 150 V, and as much beyond as its guards have to see."""
_ANY_SIGN = ("_LEAST_", "_MOST_V", "_MOST_UM", "_PARKED_")
_HINT = "`docs/build-the-machine.md` lists them under Settings of the owner."


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting by its name in the sources, with its value there."""

    name: str
    value: float
    is_whole: bool
    source: str


def settings_of(folder: Path) -> dict[str, Setting]:
    """Return every setting of the sources in a folder by its name, in their order."""
    settings = {}
    for source, names in SOURCES.items():
        file = folder / source
        text = file.read_text(encoding="utf-8") if file.is_file() else ""
        for name, real, value in _DEFAULT.findall(text):
            if not names or name in names:
                settings[name] = Setting(name, float(value), not real, source)
    return settings


def parse_settings(texts: Sequence[str], known: Mapping[str, Setting]) -> dict[str, float]:
    """Read `NAME=VALUE` texts; a name may come without EDM_ and in small letters.

    Raises UsageError E2094, also for values that contradict each other.
    """
    chosen: dict[str, float] = {}
    for text in texts:
        given, _, number = text.partition("=")
        name = "EDM_" + given.strip().upper().removeprefix("EDM_")
        if name not in known:
            raise failures.image_setting_wrong(
                problem=f"{given.strip() or text} is not a setting of the image.",
                remedy=f"{did_you_mean(name, known)}{_HINT}",
            )
        value = float(number) if _NUMBER.fullmatch(number.strip()) else math.nan
        if not math.isfinite(value):
            raise failures.image_setting_wrong(
                problem=f"{text} is not a number for {name}.",
                remedy=f"Use {name}={known[name].value:g} or another number.",
            )
        if problem := _range_problem(known[name], value):
            raise failures.image_setting_wrong(problem=f"{text}: {name} {problem}.", remedy=_HINT)
        chosen[name] = value
    value_of = {name: chosen.get(name, setting.value) for name, setting in known.items()}
    for low, high in _ORDERED:
        if low in value_of and high in value_of and not value_of[low] < value_of[high]:
            raise failures.image_setting_wrong(
                problem=f"{low}, {value_of[low]:g}, is not below {high}, {value_of[high]:g}.",
                remedy="Set both: a reading at the end of its range is not valid.",
            )
    least_v = value_of.get("EDM_MONITOR_LEAST_V", _MONITOR_V[0])
    most_v = value_of.get("EDM_MONITOR_MOST_V", _MONITOR_V[1])
    if least_v > _MONITOR_V[0] or most_v < _MONITOR_V[1]:
        raise failures.image_setting_wrong(
            problem=f"The monitor's range, {least_v:g} to {most_v:g} V, has to include {_MONITOR_V[0]:g} to "
            f"{_MONITOR_V[1]:g} V.",
            remedy="The monitor shows 0 to 150 V.",
        )
    return chosen


def _range_problem(setting: Setting, value: float) -> str:
    if setting.is_whole:
        low, high = _RANGES.get(setting.name, (1, 1_000_000))
        is_right = value == int(value) and low <= value <= high
        return "" if is_right else f"has to be a whole number from {low} to {high}"
    if value <= 0.0 and not any(part in setting.name for part in _ANY_SIGN):
        return "has to be above 0"
    if value and not _LEAST <= abs(value) <= _MOST:
        return f"has to be between {_LEAST:g} and {_MOST:g}"
    return ""


def flags_of(chosen: Mapping[str, float], known: Mapping[str, Setting]) -> list[str]:
    """Return the arguments of a compiler that set them, and make the image state them."""
    if not chosen:
        return []
    texts = {name: str(int(v)) if known[name].is_whole else repr(v) for name, v in chosen.items()}
    flags = [f"-D{name}={text if known[name].is_whole else f'R({text})'}" for name, text in texts.items()]
    stated = " ".join(f"{name}={text}" for name, text in texts.items())
    return [*flags, f'-D{DEFINE}="{stated}"']


def settings_in(image: bytes) -> dict[str, float]:
    """Return the settings that an image states; empty for those of the sources."""
    at = image.find(MAGIC)
    while at >= 0:
        end = image.find(b"\0", at)
        parts = image[at + len(MAGIC) : max(end, at)].decode("latin-1").split()
        pairs = [pair for part in parts if (pair := _PAIR.fullmatch(part))]
        if parts and len(pairs) == len(parts):
            return {pair[1]: float(pair[2]) for pair in pairs}
        at = image.find(MAGIC, at + 1)
    return {}


def settings_text(settings: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.9g}" for name, value in settings.items()) or "as in the sources"
