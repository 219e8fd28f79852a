"""Numbers as people read them, on the terminal, on a page and in a figure.

What is unknown is a dash, a minus is a proper one, and an uncertainty stands behind what it belongs to.
"""

from __future__ import annotations

import math
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime

UNKNOWN = "–"
BEYOND_EXIT = "feed beyond the exit"
"""A hole through the sheet has this instead of a depth."""

_UNITS = {
    "um_s": "µm/s",
    "um3_per_uj": "µm³/µJ",
    "uj": "µJ",
    "um": "µm",
    "mm3_min": "mm³/min",
    "lpm": "L/min",
    "hz": "Hz",
    "s": "s",
    "v": "V",
    "c": "°C",
    "ms": "ms",
    "us": "µs",
    "ppm": "ppm",
    "pct": "%",
    "deg": "°",
    "j": "J",
}
"""Units as they end keys; a longer ending stands before those that it ends with."""
_WORDS = {
    "sd": "standard deviation",
    "model_um": "displacement from voltage",
    "wanted": "height requested",
    "mrr": "removal rate",
    "ra": "Ra",
    "depth u": "depth, standard uncertainty",
}
_LINK_ERRORS = "E4"
"""They share a status, although a machine that lost its power has lost no port."""
_SHOWN_ELSEWHERE = (
    "link",
    "calibration",
    "time_s",
    "machining_time_s",
    "measuring_time_s",
    "earlier_time_s",
    "pause_s",
    "home_um",
)


def plain_number(value: object) -> float:
    """Return a number out of a result or a profile, NaN where there is none."""
    return float(value) if isinstance(value, int | float) else math.nan


def duration(seconds: float) -> str:
    """Return a time rounded to a second: `47 s`, `15 min 02 s`, `1 h 04 min`."""
    if not math.isfinite(seconds):
        return UNKNOWN
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min"


def earlier(time_s: float, pause_s: float) -> str:
    """Return the time of a job in the runs before it was taken up again, and the pause that is not in it."""
    if time_s < 0.5 and pause_s < 0.5:
        return "taken up before it had begun"
    paused = f"after a pause of {duration(pause_s)}" if math.isfinite(pause_s) else "after an unknown pause"
    return f"{duration(time_s)} before it was taken up {paused}"


def decimal(value: float, decimals: int = 2) -> str:
    """Return a number with its decimals."""
    if not math.isfinite(value):
        return UNKNOWN
    # Adding zero takes the sign off a rounded zero.
    return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", "−")


def signed(value: float, decimals: int = 2) -> str:
    """Return a difference with its sign: `+0.24`, `−0.13`; what rounds to nothing has none."""
    text = decimal(value, decimals)
    return f"+{text}" if round(value, decimals) > 0.0 else text


def coordinates(x_um: float, y_um: float, decimals: int = 0) -> str:
    """Return where the stages stand: `(−5000, 0) µm`."""
    return f"({decimal(x_um, decimals)}, {decimal(y_um, decimals)}) µm"


def with_u95(value: float, u95: float, decimals: int = 2) -> str:
    """Return a number with half its 95 % interval, where it has one."""
    if not math.isfinite(value) or not math.isfinite(u95):
        return decimal(value, decimals)
    return f"{decimal(value, decimals)} ± {decimal(u95, decimals)}"


def to_its_u95(value: float, u95: float) -> str:
    """Return a number and half its 95 % interval, both with as many decimals as leave two digits of the interval."""
    if not u95 > 0.0 or not math.isfinite(u95):
        return significant(value)
    return with_u95(value, u95, max(0, 1 - math.floor(math.log10(u95))))


def length(value_um: float, u95_um: float = math.nan) -> str:
    """Return a length in µm with two decimals, with its 95 % half-width where it has one."""
    return f"{with_u95(value_um, u95_um)} µm" if math.isfinite(value_um) else UNKNOWN


def significant(value: float, digits: int = 3) -> str:
    """Return a number with so many digits, in powers of ten where it is very small or very large."""
    if not math.isfinite(value):
        return UNKNOWN
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    if -3 <= power <= 5:
        return decimal(value, max(0, digits - 1 - power))
    raised = str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{decimal(value / 10.0**power, digits - 1)}·10{raised}"


def removal_rate(mm3_min: float) -> str:
    """Return a removal rate in the power of ten that this machine works in: `0.801 × 10⁻³ mm³/min`."""
    return f"{decimal(1e3 * mm3_min, 3)} × 10⁻³ mm³/min" if math.isfinite(mm3_min) else UNKNOWN


def about(value_um: float, u95_um: float = math.nan) -> str:
    """Return a length that was estimated: `about 153.1 ± 6.5 µm (estimated)`."""
    return f"about {with_u95(value_um, u95_um, 1)} µm (estimated)"


def ended_as(status: str, error_code: str) -> str:
    """Return how a run ended: by its status, but where the machine was lost by its error, which says how."""
    return error_code if error_code.startswith(_LINK_ERRORS) else status


def left_at(reached: Mapping[str, object]) -> str:
    """Return how deep a hole was left, from `reached` of a result: `about 1.86 ± 0.70 of 20 µm (estimated)`."""
    names = ("depth_estimated_um", "depth_estimated_u95_um", "depth_target_um")
    depth_um, u95_um, target_um = (plain_number(reached.get(name)) for name in names)
    wanted = f" of {target_um:g}" if math.isfinite(target_um) else ""
    return f"about {with_u95(depth_um, u95_um)}{wanted} µm (estimated)"


def percent(share: float, decimals: int = 1) -> str:
    """Return a share of one in percent."""
    return f"{decimal(100.0 * share, decimals)} %" if math.isfinite(share) else UNKNOWN


def count(number: int, gap: str = " ") -> str:
    """Return an integer in groups of three digits, with `gap` between them."""
    return f"{number:,}".replace(",", gap)


def plural(number: int, noun: str) -> str:
    """Return `1 cut`, `3 cuts`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def facts(result: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield the single values of a result by their names in words, with units and 95 % half widths; no lists.

    Times of the whole job, the actuator model and the link are shown elsewhere with every result.
    """
    bare = Counter(_without_unit(key) for key in result)  # `max_um` and `max_pct` are two values
    for key, value in result.items():
        if key in _SHOWN_ELSEWHERE or (
            key.endswith("_u95_um") and f"{key.removesuffix('_u95_um')}_um" in result
        ):
            continue
        u95_um = result.get(f"{key.removesuffix('_um')}_u95_um")
        if isinstance(value, Mapping) and key == "reached":
            yield "left at", left_at(value)
        elif isinstance(value, Mapping):
            before = "" if key == "summary" else f"{_words(key)}, "
            yield from ((f"{before}{name}", text) for name, text in facts(value))
        elif isinstance(value, int | float) and isinstance(u95_um, int | float) and key.endswith("_um"):
            yield _words(key.removesuffix("_um")), length(float(value), float(u95_um))
        elif isinstance(value, bool):
            yield _words(key), "yes" if value else "no"
        elif isinstance(value, int | float):
            without = _without_unit(key)
            ending = key.removeprefix(without)[1:]
            unit = _UNITS.get(ending, "")
            text = f"{value:.4g}".replace("-", "−")
            if isinstance(value, int):
                text = count(value)
            elif ending in ("um", "v"):
                text = decimal(value)
            name = _words(key if key in _WORDS else without)
            yield f"{name}, {unit}" if bare[without] > 1 else name, f"{text} {unit}".rstrip()
        elif isinstance(value, str):
            yield _words(key), printable(value)


def _without_unit(key: str) -> str:
    ending = next((ending for ending in _UNITS if key.endswith(f"_{ending}")), None)
    return key if ending is None else key.removesuffix(f"_{ending}")


def _words(key: str) -> str:
    words = key.replace("_", " ")
    if known := _WORDS.get(key) or _WORDS.get(words):
        return known
    if words[:2] in ("z1", "z2", "z3"):
        words = f"Z{words[1:]}"
    return f"{words.removesuffix(' model')} from voltage" if words.endswith(" model") else words


def utc_of(iso: str) -> datetime | None:
    """Return an ISO time in UTC; None if it is no time."""
    try:
        time = datetime.fromisoformat(iso)
        return time.astimezone(UTC) if time.tzinfo else time
    except (ValueError, OverflowError):
        return None


def iso_of(time_s: float) -> str:
    """Return the time of a file as ISO text in UTC; empty if the calendar has no such year."""
    try:
        return datetime.fromtimestamp(time_s, UTC).isoformat(timespec="milliseconds")
    except (ValueError, OverflowError, OSError):
        return ""


def start_utc(iso: str) -> str:
    """Return an ISO time to the second, in UTC; as it is where it is none."""
    time = utc_of(iso)
    return f"{time:%Y-%m-%d %H:%M:%S}" if time else printable(iso) or UNKNOWN


def file_size(size_bytes: int) -> str:
    """Return the size of a file: `640 B`, `2.1 MB`."""
    value, unit = float(size_bytes), "B"
    for larger in ("kB", "MB", "GB", "TB"):
        if value < 999.5:
            break
        value, unit = value / 1000.0, larger
    return f"{value:.0f} {unit}" if unit == "B" or value >= 99.5 else f"{value:.1f} {unit}"


def named_with_unit(key: str, unit: str) -> str:
    """Return the name of a value with its unit, where the name does not end with that already."""
    ending = unit.replace("deg", "").replace("/", "_").lower()
    if not unit or key.endswith((f"_{ending}", *(f"_{known}" for known in _UNITS))):
        return key
    return f"{key}, {unit}"


def unit_in(key: str) -> str:
    """Return the unit that the name of a value ends with; empty where it has none."""
    return next((unit for ending, unit in _UNITS.items() if key.endswith(f"_{ending}")), "")


def escaped(text: str) -> str:
    """Return the name of a file on one line: what cannot be printed becomes its escape sequence."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in text
    )


def printable(text: str) -> str:
    """Return a text out of a file without what a terminal would take for a command."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def code_point(character: str) -> str:
    """Return number and name of a character, such as `U+2212 (MINUS SIGN)`."""
    return f"U+{ord(character):04X} ({unicodedata.name(character, 'a control character')})"


def shortened(text: str, most: int = 200) -> str:
    """Return a text that nobody would read to its end without that end."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def setting_text(value: bool | int | float | str) -> str:
    """Return a setting as tables show it: all numbers of a factor alike."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def settings_words(settings: Mapping[str, bool | int | float | str]) -> str:
    """Return settings as `key = value, …`."""
    return ", ".join(f"{key} = {setting_text(value)}" for key, value in settings.items())


def dotted(version: tuple[int, ...]) -> str:
    """Return a version as people write it."""
    return ".".join(map(str, version))


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return a question with the known name spelled most like `name`, and a space; empty without a close one."""
    from difflib import get_close_matches  # mistakes only

    close = get_close_matches(name, list(known), 1)
    return f"Did you mean {close[0]}? " if close else ""
