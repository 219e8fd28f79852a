"""Factors of a study: their values, and how settings become columns of numbers and back."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic, UsageError
from edmctl.profile.profile_file import ProfileFile
from edmctl.profile.tables import field_at
from edmctl.study.results import FactorInfo, Value

if TYPE_CHECKING:
    from edmctl.profile.positions import KeyPath
    from edmctl.study.statistics.linear_model import Settings
    from edmctl.study.study_file import Factor, StudySource

DIGITS = 4
"""Significant digits of values that a design puts between two bounds: what a person would set."""


def factors_of(source: StudySource) -> tuple[tuple[FactorInfo, ...], list[Diagnostic]]:
    """Return the factors of a study file, and what is wrong with them."""
    wrong: list[Diagnostic] = []
    found = []
    keys = [factor.key for factor in source.file.factors]
    for number, factor in enumerate(source.file.factors):
        if keys.index(factor.key) != number:
            wrong.append(
                source.refusal(
                    ("factors", number, "key"), f"{factor.key} is varied twice", "give each key once"
                )
            )
            continue
        if ("factors", number) in source.damaged:
            continue
        if factor.name in RESERVED:
            message = (
                f"a factor cannot be called {factor.name}: tables of every analysis have a row of that name"
            )
            wrong.append(source.refusal(("factors", number, "name"), message, "give it another name"))
        try:
            found.append(_factor(factor))
        except _Refused as refused:
            path: KeyPath = ("factors", number, *refused.path)
            wrong.append(source.refusal(path, f"factor {factor.key}: {refused.message}", refused.hint))
    names = [factor.name for factor in found]
    if again := sorted({name for name in names if names.count(name) > 1}):
        wrong.append(
            source.refusal(("factors",), f"two factors are called {again[0]}", "give them other names")
        )
    return tuple(found), wrong


class _Refused(Exception):
    def __init__(self, message: str, hint: str, *path: str) -> None:
        super().__init__(message)
        self.message, self.hint, self.path = message, hint, path


def _factor(factor: Factor) -> FactorInfo:
    given = [
        bool(factor.levels),
        bool(factor.categories),
        factor.low is not None or factor.high is not None,
    ]
    if sum(given) != 1:
        raise _Refused(
            "give either levels, or low and high, or categories",
            'levels = [0.7, 0.8, 0.9], or low = 0.7 and high = 0.9, or categories = ["Cu", "W"]',
        )
    name = factor.name or factor.key
    if factor.categories:
        _all_differ(factor.categories, "categories")
        return FactorInfo(factor.key, name, tuple(factor.categories), is_number=False)
    if factor.levels:
        _all_differ(factor.levels, "levels")
        numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in factor.levels)
        return FactorInfo(
            factor.key, name, tuple(factor.levels), is_number=numbers, is_log=numbers and _is_log(factor)
        )
    if factor.low is None or factor.high is None:
        raise _Refused("a range has low and high", "give both")
    if factor.step is not None and math.floor(factor.high / factor.step + 1e-9) <= math.ceil(
        factor.low / factor.step - 1e-9
    ):
        raise _Refused(
            f"fewer than two multiples of {factor.step:g} lie between the bounds",
            "take a smaller step",
            "step",
        )
    if not factor.low < factor.high:
        raise _Refused(f"low = {factor.low} is not below high = {factor.high}", "swap them", "low")
    return FactorInfo(
        factor.key, name, (factor.low, factor.high), is_number=True, is_log=_is_log(factor), is_range=True
    )


def _is_log(factor: Factor) -> bool:
    values = [v for v in (*factor.levels, factor.low) if isinstance(v, int | float)]
    if factor.scale == "log" and min(values) <= 0:
        raise _Refused("values on a logarithmic scale are above 0", 'say scale = "linear"', "scale")
    return factor.scale == "log"


def _all_differ(values: Sequence[Value], what: str) -> None:
    same = {float(v) if isinstance(v, int | float) and not isinstance(v, bool) else repr(v) for v in values}
    if len(values) < 2 or len(same) < len(values):
        raise _Refused(f"{what} have to be two or more different values", "give two or more, each once", what)


def value_at(factor: FactorInfo, coded: float, step: float | None = None) -> Value:
    """Return the value of a coded setting, −1 … 1, rounded as a person would set it; of a category by its slice."""
    if not factor.is_number:
        slices = len(factor.values)
        return factor.values[min(slices - 1, int((coded + 1) / 2 * slices))]
    low, high = _bounds(factor)
    share = (coded + 1) / 2
    value = low * (high / low) ** share if factor.is_log else low + (high - low) * share
    if step is not None:
        least, most = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        value = float(f"{step * min(max(round(value / step), least), most):.12g}")
        return round(value) if _takes_whole_numbers(factor.key) else value
    is_whole = _takes_whole_numbers(factor.key)
    rounded = float(f"{value:.{DIGITS}g}")
    value = min(max(rounded, low), high) if abs(share - 0.5) < 0.5 else (low if share < 0.5 else high)
    return round(value) if is_whole else value


def is_within(factor: FactorInfo, value: object) -> bool:
    """Return whether a factor can have a value: one of its categories, or a number within its bounds."""
    if not factor.is_number:
        return any(value == one and type(value) is type(one) for one in factor.values)
    low, high = _bounds(factor)
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def value_within(factor: FactorInfo, value: object) -> Value:
    """Return a value that somebody gives a factor, as a plain one. Raises UsageError E2110 for one beyond it."""
    plain = value.item() if hasattr(value, "item") else value
    if not is_within(factor, plain):
        low, high = _bounds(factor) if factor.is_number else (0.0, 0.0)
        allowed = f"a number from {low:g} to {high:g}"
        if not factor.is_number:
            allowed = f"one of {', '.join(map(repr, factor.values))}"
        raise UsageError(
            f"{factor.key} = {value!r} is not {allowed}.",
            hint="The study varies it within that; another study has other bounds.",
            code="E2110",
        )
    assert isinstance(plain, bool | int | float | str)
    return plain


def coded(factor: FactorInfo, value: Value) -> float:
    """Return a number's place between the bounds as −1 … 1."""
    low, high = _bounds(factor)
    number = float(value)
    if factor.is_log:
        return 2 * math.log(number / low) / math.log(high / low) - 1
    return 2 * (number - low) / (high - low) - 1


def _bounds(factor: FactorInfo) -> tuple[float, float]:
    numbers = [float(value) for value in factor.values]
    return min(numbers), max(numbers)


def middle(factor: FactorInfo, step: float | None = None) -> Value:
    """Return the value of a centre run: the middle of a range or of two levels, the middle level, a category."""
    if not factor.is_number:
        return factor.values[0]
    if factor.is_range or len(factor.values) == 2:
        return value_at(factor, 0.0, step)
    return sorted(factor.values, key=float)[(len(factor.values) - 1) // 2]


def _takes_whole_numbers(key: str) -> bool:
    found = field_at(ProfileFile, tuple(key.split(".")))
    return found is not None and found.annotation in (int, int | None)


def settings_matrix(
    factors: Sequence[FactorInfo],
    settings: Sequence[Mapping[str, Value]],
    blocks: Sequence[int] | None = None,
    *,
    as_levels: bool = False,
) -> Settings:
    """Return what was set as `doe` wants it: numbers coded, categories by name, the block as a category `block`.

    `as_levels` takes numbers as levels without order too.
    """
    import numpy as np

    from edmctl.study.statistics.linear_model import Settings

    numbers, categories, names = {}, {}, {}
    for factor in factors:
        values = [one[factor.key] for one in settings]
        if factor.is_number and not as_levels:
            numbers[factor.name] = np.array([coded(factor, value) for value in values])
        else:
            categories[factor.name] = values
            seen = list(dict.fromkeys(values))
            order = list(factor.values) if set(map(repr, seen)) <= set(map(repr, factor.values)) else seen
            names[factor.name] = [value for value in order if value in seen]
    if blocks is not None and len(set(blocks)) > 1:
        categories[BLOCK] = list(blocks)
        names[BLOCK] = sorted(set(blocks))
    return Settings(numbers, categories, names)


BLOCK = "block"
"""The term of what runs share beside their settings."""
RESERVED = (BLOCK, "mean", "error", "total")
"""Rows of an analysis beside those of factors."""


def settings_key(settings: Mapping[str, Value]) -> str:
    """Return what is equal of equal settings."""
    return repr(sorted(settings.items()))


def unit_points(factors: Sequence[FactorInfo], settings: Sequence[Mapping[str, Value]]) -> list[list[float]]:
    """Return settings as points between 0 and 1, a category as a column a name but the first."""
    return [
        [
            column
            for factor in factors
            for column in (
                [(coded(factor, one[factor.key]) + 1) / 2]
                if factor.is_number
                else [float(one[factor.key] == value) for value in factor.values[1:]]
            )
        ]
        for one in settings
    ]
