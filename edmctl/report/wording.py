"""Numbers as the page of a run gives them: with a proper minus, a dash where there is none, their uncertainty."""

from __future__ import annotations

import math

UNKNOWN = "–"


def decimal(value: float, decimals: int = 2) -> str:
    """Return a number with its decimals."""
    if not math.isfinite(value):
        return UNKNOWN
    # Adding zero takes the sign off a rounded zero.
    return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", "−")


def with_u95(value: float, u95: float, decimals: int = 2) -> str:
    """Return a number with half its 95 % interval, where it has one."""
    if not math.isfinite(value) or not math.isfinite(u95):
        return decimal(value, decimals)
    return f"{decimal(value, decimals)} ± {decimal(u95, decimals)}"


def significant(value: float, digits: int = 3) -> str:
    """Return a number with so many digits, in powers of ten where it is very small or very large."""
    if not math.isfinite(value):
        return UNKNOWN
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    if -3 <= power <= 5:
        return decimal(value, max(0, digits - 1 - power))
    return f"{decimal(value / 10.0**power, digits - 1)}·10{_raised(power)}"


def percent(share: float, decimals: int = 1) -> str:
    """Return a share of one in percent."""
    return f"{decimal(100.0 * share, decimals)} %" if math.isfinite(share) else UNKNOWN


def count(number: int) -> str:
    """Return an integer in groups of three digits, which a line does not break."""
    return f"{number:,}".replace(",", "\u202f")


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


def _raised(power: int) -> str:
    return "".join("⁻" if letter == "-" else "⁰¹²³⁴⁵⁶⁷⁸⁹"[int(letter)] for letter in str(power))
