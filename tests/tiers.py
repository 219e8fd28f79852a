"""Values of a parametrised test by the tier that runs them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def tiers(*default: object, slow: Iterable[object] = (), full: Iterable[object] = ()) -> list[Any]:
    """The values of all tiers: `parametrize("seed", tiers(1, slow=(2, 3), full=range(4, 40)))`.

    A value that is a tuple holds those of several parameters; one that is a tuple itself is put into another.
    """
    return [
        *(_value(value) for value in default),
        *(_value(value, pytest.mark.slow) for value in slow),
        *(_value(value, pytest.mark.full) for value in full),
    ]


def _value(value: object, *marks: pytest.MarkDecorator) -> object:
    return pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=marks)
