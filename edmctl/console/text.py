"""Numbers as people read them."""

from __future__ import annotations

import math


def duration(seconds: float) -> str:
    """Return `seconds` rounded to a second: `47 s`, `15 min 02 s`, `1 h 04 min`."""
    if not math.isfinite(seconds):
        return "–"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min"


def decimal(value: float) -> str:
    """Return a number with two decimals, `–` where it is unknown."""
    if not math.isfinite(value):
        return "–"
    # Adding zero takes the sign off a rounded zero.
    return f"{round(value, 2) + 0.0:.2f}".replace("-", "−")


def length(value_um: float, u95_um: float | None = None) -> str:
    """Return a length in µm with two decimals, with its 95 % half-width where it has one."""
    if not math.isfinite(value_um):
        return "–"
    if u95_um is None or not math.isfinite(u95_um):
        return f"{decimal(value_um)} µm"
    return f"{decimal(value_um)} ± {decimal(u95_um)} µm"


def count(value: int) -> str:
    """Return an integer in groups of three digits."""
    return f"{value:,}".replace(",", " ")


def percent(fraction: float, decimals: int = 1) -> str:
    """Return a fraction of one as a percentage."""
    return f"{100 * fraction:.{decimals}f} %" if math.isfinite(fraction) else "–"


def plural(number: int, noun: str) -> str:
    """Return `1 cut`, `3 cuts`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
