"""The option --site: a name, or stage coordinates."""

from __future__ import annotations

import math

from edmctl.errors import UsageError


def coordinates(text: str) -> tuple[float, float] | None:
    """Return x and y in µm where the text is two numbers with a comma between them."""
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        return None
    if len(numbers) != 2 or not all(map(math.isfinite, numbers)):
        return None
    return numbers[0], numbers[1]


def no_place(text: str) -> UsageError:
    """Return the error of a text that names no place."""
    return UsageError(
        f"--site {text} is no X,Y in µm.", hint="Say two numbers, e.g. --site 500,0.", code="E2061"
    )
