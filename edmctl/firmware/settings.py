"""What a machine's owner sets in the image of its board: ends of ranges, steps of the stages, the line's baud."""

from __future__ import annotations

import difflib
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from edmctl.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

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
    """Read `NAME=VALUE` texts; a name may come without EDM_ and in small letters. Raises UsageError E2094."""
    chosen: dict[str, float] = {}
    for text in texts:
        given, found, number = text.partition("=")
        name = "EDM_" + given.strip().upper().removeprefix("EDM_")
        if name not in known:
            close = difflib.get_close_matches(name, known, 1)
            meant = f"Did you mean {close[0]}? " if close else ""
            raise _refused(f"{given.strip() or text} is no setting of the image.", f"{meant}{_HINT}")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not found or not math.isfinite(value):
            raise _refused(
                f"{text} gives {name} no number.", f"Say {name}={known[name].value:g} or another one."
            )
        if known[name].is_whole and value != int(value):
            raise _refused(f"{name} is a whole number, and {number} is none.", f"Say {name}={round(value)}.")
        if value <= 0.0 and not any(part in name for part in _ANY_SIGN):
            raise _refused(f"{name} has to be above 0, and {number} is not.", _HINT)
        chosen[name] = value
    for low, high in (
        ("EDM_MONITOR_LEAST_V", "EDM_MONITOR_MOST_V"),
        ("EDM_SENSOR_LEAST_UM", "EDM_SENSOR_MOST_UM"),
    ):
        ends = [chosen.get(end, known[end].value) for end in (low, high) if end in known]
        if len(ends) == 2 and ends[0] >= ends[1]:
            raise _refused(
                f"{low}, {ends[0]:g}, is not below {high}, {ends[1]:g}.", "Set both ends of the range."
            )
    return chosen


def flags_of(chosen: Mapping[str, float], known: Mapping[str, Setting]) -> list[str]:
    """Return the words of a compiler's command that set them, and let the image tell."""
    if not chosen:
        return []
    values = {name: f"{value:g}" if known[name].is_whole else repr(value) for name, value in chosen.items()}
    flags = [f"-D{name}={value if known[name].is_whole else f'R({value})'}" for name, value in values.items()]
    told = " ".join(f"{name}={value:.9g}" for name, value in chosen.items())
    return [*flags, f'-D{TOLD}="{told}"']


def told_settings(image: bytes) -> dict[str, float]:
    """Return what an image says that was set in it, {} for nothing."""
    at = image.find(MAGIC)
    while at >= 0:
        end = image.find(b"\0", at)
        words = [
            word.partition("=") for word in image[at + len(MAGIC) : max(end, at)].decode("latin-1").split()
        ]
        if words and all(re.fullmatch(r"EDM_\w+", name) for name, _, _ in words):
            return {name: float(value) for name, _, value in words}
        at = image.find(MAGIC, at + 1)
    return {}


def _refused(message: str, hint: str) -> UsageError:
    return UsageError(message, hint=hint, code="E2094")
