"""What a machine's owner sets in the image of its board: ends of ranges, steps of the stages, the line's baud."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import UsageError
from edmctl.wording import did_you_mean

SOURCES: dict[str, tuple[str, ...]] = {
    "board/scale.h": (),
    "core/limits.h": ("EDM_OFF_NS_MIN", "EDM_OPEN_V_MAX", "EDM_CURRENT_A_MAX"),
    "board/stm32f4/board.h": ("EDM_BAUD",),
}
"""Files of the firmware's sources, and which of their names are the owner's; none stands for all."""
TOLD = "EDM_SETTINGS"
"""Name under which the image is told what was set."""
MAGIC = b"EDMS"
"""The image has it before that text, which ends with a zero."""
_DEFAULT = re.compile(r"^#ifndef (EDM_\w+)\n#define \1 (R\()?(-?\d+(?:\.\d+)?)\b", re.MULTILINE)
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_TOLD = re.compile(r"(EDM_[A-Z0-9_]+)=([^ ]+)", re.ASCII)
_RANGES = {
    "EDM_BAUD": (9600, 2_000_000),
    "EDM_MOST_STEPS_PER_MS": (1, 140),
    "EDM_OFF_NS_MIN": (10_000, 1_000_000),
}
"""Of whole numbers: what the line's ring, the timers of the stages and those who look for pulses do."""
_LEAST, _MOST = 1e-6, 1e6
"""Of the others; a `float` of the board tells all of them apart from 0."""
_ORDERED = (
    ("EDM_OPEN_V_MAX", "EDM_GAP_FULL_V"),
    ("EDM_OPEN_V_MAX", "EDM_OPEN_FULL_V"),
    ("EDM_CURRENT_A_MAX", "EDM_GAP_FULL_A"),
    ("EDM_CURRENT_A_MAX", "EDM_PEAK_FULL_A"),
    ("EDM_NORMAL_PLATEAU_V", "EDM_OPEN_V_MAX"),
    ("EDM_MONITOR_LEAST_V", "EDM_MONITOR_MOST_V"),
    ("EDM_SENSOR_LEAST_UM", "EDM_SENSOR_MOST_UM"),
)
_ENDS = {"EDM_MONITOR_LEAST_V": (-0.5, True), "EDM_MONITOR_MOST_V": (151.0, False)}
"""The actuator's 0 to 150 V, and as much beyond as its guards have to see."""
_ANY_SIGN = ("_LEAST_", "_MOST_V", "_MOST_UM", "_PARKED_")
_HINT = "`docs/build-the-machine.md` lists them under Settings of the owner."


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting: its name in the sources, the value there, and whether it is a whole number."""

    name: str
    value: float
    is_whole: bool
    source: str


def settings_of(folder: Path) -> dict[str, Setting]:
    """Return every setting of the sources in a folder by its name, in their order."""
    found = {}
    for source, names in SOURCES.items():
        file = folder / source
        text = file.read_text(encoding="utf-8") if file.is_file() else ""
        for name, real, value in _DEFAULT.findall(text):
            if not names or name in names:
                found[name] = Setting(name, float(value), not real, source)
    return found


def parse_settings(texts: Sequence[str], known: Mapping[str, Setting]) -> dict[str, float]:
    """Read `NAME=VALUE` texts; a name may come without EDM_ and in small letters.

    Raises UsageError E2094, also for values that contradict each other.
    """
    chosen: dict[str, float] = {}
    for text in texts:
        given, found, number = text.partition("=")
        name = "EDM_" + given.strip().upper().removeprefix("EDM_")
        if name not in known:
            meant = did_you_mean(name, known)
            raise _refused(f"{given.strip() or text} is no setting of the image.", f"{meant}{_HINT}")
        value = float(number) if _NUMBER.fullmatch(number.strip()) else math.nan
        if not found or not math.isfinite(value):
            raise _refused(
                f"{text} gives {name} no number.", f"Say {name}={known[name].value:g} or another one."
            )
        _check_range(known[name], value, number)
        chosen[name] = value
    _check_together({name: chosen.get(name, setting.value) for name, setting in known.items()})
    return chosen


def _check_together(value: Mapping[str, float]) -> None:
    for low, high in _ORDERED:
        if low in value and high in value and not value[low] < value[high]:
            raise _refused(
                f"{low}, {value[low]:g}, is not below {high}, {value[high]:g}.",
                "Set both: the end of a range is no reading of it.",
            )
    for name, (needed, is_least) in _ENDS.items():
        if name in value and (value[name] > needed if is_least else value[name] < needed):
            word = "above" if is_least else "below"
            raise _refused(
                f"{name}, {value[name]:g}, is {word} {needed:g} V.", "The monitor shows 0 to 150 V."
            )


def _check_range(setting: Setting, value: float, text: str) -> None:
    name = setting.name
    if setting.is_whole:
        low, high = _RANGES.get(name, (1, 1_000_000))
        if value != int(value) or not low <= value <= high:
            raise _refused(f"{name} is a whole number from {low} to {high}, and {text} is none.", _HINT)
    elif value <= 0.0 and not any(part in name for part in _ANY_SIGN):
        raise _refused(f"{name} has to be above 0, and {text} is not.", _HINT)
    elif value and not _LEAST <= abs(value) <= _MOST:
        raise _refused(f"{name} lies between {_LEAST:g} and {_MOST:g}, and {text} does not.", _HINT)


def flags_of(chosen: Mapping[str, float], known: Mapping[str, Setting]) -> list[str]:
    """Return the words of a compiler's command that set them, and let the image tell."""
    if not chosen:
        return []
    values = {
        name: str(int(value)) if known[name].is_whole else repr(value) for name, value in chosen.items()
    }
    flags = [f"-D{name}={value if known[name].is_whole else f'R({value})'}" for name, value in values.items()]
    told = " ".join(f"{name}={value}" for name, value in values.items())
    return [*flags, f'-D{TOLD}="{told}"']


def told_settings(image: bytes) -> dict[str, float]:
    """Return what an image says that was set in it, {} for nothing."""
    at = image.find(MAGIC)
    while at >= 0:
        end = image.find(b"\0", at)
        words = image[at + len(MAGIC) : max(end, at)].decode("latin-1").split()
        told = [_TOLD.fullmatch(word) for word in words]
        if words and all(one and _NUMBER.fullmatch(one[2]) for one in told):
            return {one[1]: float(one[2]) for one in told if one}
        at = image.find(MAGIC, at + 1)
    return {}


def _refused(message: str, hint: str) -> UsageError:
    return failures.image_setting_wrong(problem=message, remedy=hint)
