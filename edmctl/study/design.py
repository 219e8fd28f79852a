"""Factors and designs: values, coding, which points are run, and which model they can fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from edmctl import failures
from edmctl.csv_text import number_of
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, RecordError
from edmctl.files import user_path
from edmctl.profile.model import ProfileFile
from edmctl.profile.positions import KeyPath
from edmctl.profile.tables import field_at
from edmctl.record.delimited import read_table
from edmctl.study.results import FactorInfo, Value
from edmctl.study.statistics.designs import (
    array_for,
    box_behnken,
    central_composite,
    fraction_for,
    fraction_of,
    hiding_words,
    latin_hypercube,
    letters_of,
    sobol_points,
)
from edmctl.study.statistics.linear_model import (
    Settings,
    Term,
    main_effects,
    model_matrix,
    second_order,
    term_name,
    undetermined,
    with_interactions,
)
from edmctl.study.study_file import Factor, StudySource
from edmctl.wording import plural

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
        raise failures.setting_out_of_range(key=factor.key, value=value, allowed=allowed)
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


MOST_RUNS = 20_000
MOST_ALIASES = 40
LEVELS, PAIRS, QUADRATIC, SENSITIVITY = "levels", "level pairs", "quadratic", "sensitivity"
AS_LEVELS = (LEVELS, PAIRS)
"""Models in which numbers are levels without order."""


class Refused(Exception):
    """A design that cannot be, blamed on a key of `[design]`."""

    def __init__(self, message: str, hint: str, key: str = "kind") -> None:
        super().__init__(message)
        self.message, self.hint, self.key = message, hint, key


@dataclass(frozen=True, slots=True)
class Points:
    """The settings of a design in its standard order, and how the design is called.

    `blocks` has, a point, the number of its block within a replicate, from 0.
    """

    name: str
    settings: tuple[dict[str, Value], ...]
    blocks: tuple[int, ...]
    aliases: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    tells_pairs: bool = False
    """Of a fraction: whether no product of two factors mixes with a factor or with another product."""


def points_of(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    """Return the points of a study's design. Raises Refused if there can be none."""
    design = source.file.design
    try:
        made = _MAKERS[design.kind](source, factors)
    except ValueError as error:
        hint, *keys = _REMEDIES[design.kind]
        key = next((key for key in keys if getattr(design, key)), keys[0])
        raise Refused(str(error).rstrip("."), hint, key) from error
    size = len(made.settings) * design.replicates
    if size > MOST_RUNS:
        runs = f"{plural(len(made.settings), 'point')} with {plural(design.replicates, 'replicate')} are {size} runs"
        raise Refused(f"{runs}, and at most {MOST_RUNS} are planned", "take a fraction, or fewer levels")
    return made


def _full(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    size = math.prod(len(factor.values) for factor in factors)
    if size > MOST_RUNS:
        raise Refused(f"all combinations are {size} runs", "take a fraction, an array or a sample")
    settings = [
        dict(zip([f.key for f in factors], values, strict=True))
        for values in itertools.product(*(f.values for f in factors))
    ]
    blocks = source.file.design.blocks
    name = "full factorial " + " × ".join(str(len(f.values)) for f in factors)
    if blocks > 1 and blocks & (blocks - 1) == 0 and all(len(f.values) == 2 for f in factors):
        return _confounded(name, settings, factors, blocks)
    return _with_parts(Points(name, tuple(settings), ()), blocks)


def _confounded(
    name: str, settings: list[dict[str, Value]], factors: Sequence[FactorInfo], blocks: int
) -> Points:
    """Two-level runs in blocks that hide the longest products (Box, Hunter and Hunter 2005, chapter 5)."""
    extra = blocks.bit_length() - 1
    words = hiding_words(len(factors), extra)
    if not words:
        message = f"{blocks} blocks of {plural(len(settings), 'run')} would hide the effect of a factor"
        raise Refused(message, "take fewer blocks", "blocks")
    number = []
    for one in settings:
        bits = [sum(one[factors[f].key] == factors[f].values[1] for f in word) % 2 for word in words]
        number.append(sum(bit << n for n, bit in enumerate(bits)))
    told = ", ".join(letters_of(word) for word in words)
    note = f"blocks cannot be told apart from {told} and their products"
    return Points(f"{name} in {blocks} blocks", tuple(settings), tuple(number), notes=(note,))


def mixing(points: Points, order: Sequence[int], part_of: Sequence[int]) -> float:
    """Return how much parts of an order of points mix with the factors: squared correlations of main effects.

    Points beyond those of the design are centre runs, which no factor moves.
    """
    import numpy as np

    parts = np.eye(max(part_of) + 1)[list(part_of)][:, 1:]
    parts = parts - parts.mean(axis=0)
    columns = []
    for key in points.settings[0]:
        values = list(dict.fromkeys(map(repr, (one[key] for one in points.settings))))
        columns += [
            [n < len(points.settings) and repr(points.settings[n][key]) == value for n in order]
            for value in values[1:]
        ]
    factors = np.array(columns, float).T
    factors = factors - factors.mean(axis=0)
    size = np.sqrt((parts**2).sum(axis=0))[:, None] * np.sqrt((factors**2).sum(axis=0))[None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(size > 0, (parts.T @ factors) / size, 0.0)
    return float((found**2).sum())


DEALT = 500


def _with_parts(points: Points, blocks: int) -> Points:
    """Points dealt to so many blocks of about equal size: of many ways the one that mixes least with the factors."""
    import numpy as np

    count = len(points.settings)
    if blocks > count:
        raise Refused(f"{blocks} blocks of {plural(count, 'point')}", "take fewer", "blocks")
    if blocks == 1:
        return replace(points, blocks=(0,) * count)
    rng = np.random.default_rng(0)
    even = [n % blocks for n in range(count)]
    ways = [even, *(rng.permutation(even).tolist() for _ in range(DEALT if count <= 200 else 0))]
    best = min(ways, key=lambda way: mixing(points, range(count), way))
    mixed = mixing(points, range(count), best)
    notes = points.notes
    if mixed > 1e-9:
        notes = (*notes, "blocks mix a little with the effects of factors: the analysis takes both apart")
    return replace(points, blocks=tuple(best), notes=notes)


def _fractional(source: StudySource, factors: Sequence[FactorInfo]) -> Points:

    design = source.file.design
    _all_of_two(factors, "a fractional factorial")
    if bool(design.generators) == (design.resolution is not None):
        raise Refused(
            "a fractional factorial has either a resolution or generators",
            'say resolution = 4, or generators = ["D = ABC"]',
        )
    fraction = (
        fraction_of(len(factors), design.generators)
        if design.generators
        else fraction_for(len(factors), design.resolution or 3)
    )
    settings = [
        {f.key: f.values[int(sign > 0)] for f, sign in zip(factors, row, strict=True)}
        for row in fraction.coded().tolist()
    ]
    whole = fraction.resolution is None
    name = (
        f"full factorial 2^{len(factors)}"
        if whole
        else f"fractional factorial 2^({len(factors)}-{len(fraction.generators)}), "
        f"resolution {_ROMAN.get(fraction.resolution or 0, fraction.resolution)}"
    )
    aliases = _alias_words(fraction.aliases(), factors)
    tells_pairs = whole or (fraction.resolution or 0) >= 5
    return _with_parts(Points(name, tuple(settings), (), aliases, tells_pairs=tells_pairs), design.blocks)


_ROMAN = {3: "III", 4: "IV", 5: "V", 6: "VI", 7: "VII", 8: "VIII", 9: "IX"}


def _alias_words(
    groups: Sequence[Sequence[tuple[frozenset[int], int]]], factors: Sequence[FactorInfo]
) -> tuple[str, ...]:
    lines = []
    for group in groups:
        words = [
            ("" if sign > 0 else "−") + " × ".join(factors[one].name for one in sorted(effect))
            for effect, sign in group
        ]
        lines.append(" = ".join(words))
    more = len(lines) - MOST_ALIASES
    return (*lines[:MOST_ALIASES], *([f"and {more} more groups"] if more > 0 else []))


def _all_of_two(factors: Sequence[FactorInfo], what: str) -> None:
    many = [f.name for f in factors if len(f.values) != 2]
    if many:
        raise Refused(f"{what} has factors of two levels, and {many[0]} has others", "give low and high")


def _taguchi(source: StudySource, factors: Sequence[FactorInfo]) -> Points:

    design = source.file.design
    counts = [len(f.values) for f in factors]
    array, columns = array_for(counts, design.array)
    if design.columns:
        columns = tuple(column - 1 for column in design.columns)
        if (
            len(columns) != len(factors)
            or len(set(columns)) < len(columns)
            or not all(0 <= column < len(array.counts) for column in columns)
            or [array.counts[column] for column in columns] != counts
        ):
            raise Refused(
                f"columns {', '.join(map(str, design.columns))} do not hold these factors",
                f"{array.name} has columns of {', '.join(map(str, array.counts))} levels; give one a factor",
                "columns",
            )
    settings = [
        {f.key: f.values[level] for f, level in zip(factors, row, strict=True)}
        for row in array.levels[:, list(columns)].tolist()
    ]
    note = (
        "interactions of factors mix with the effects of others: an orthogonal array tells main effects alone"
    )
    aliases = _array_aliases(array.levels, columns, factors)
    return _with_parts(
        Points(f"Taguchi {array.name}", tuple(settings), (), aliases, (note,) if aliases else ()),
        design.blocks,
    )


def _array_aliases(levels: Any, columns: Sequence[int], factors: Sequence[FactorInfo]) -> tuple[str, ...]:
    """Which products of two factors mix with which main effects, by what their columns have in common."""
    import numpy as np

    names = [f.name for f in factors]
    settings = Settings(
        {},
        {name: levels[:, column].tolist() for name, column in zip(names, columns, strict=True)},
        {name: sorted(set(levels[:, column].tolist())) for name, column in zip(names, columns, strict=True)},
    )
    found: dict[str, list[str]] = {name: [] for name in names}
    blocks = {}
    for name in names:
        columns_of = model_matrix(settings, [(), ((name, 1),)]).columns
        blocks[name] = np.linalg.qr(
            columns_of - columns_of.mean(axis=0) * [0, *[1] * (columns_of.shape[1] - 1)]
        )[0][:, 1:]
    for a, b in itertools.combinations(names, 2):
        pair = model_matrix(settings, [((a, 1), (b, 1))]).columns
        for name in names:
            if name not in (a, b) and np.abs(blocks[name].T @ pair).max() > 1e-9:
                found[name].append(f"{a} × {b}")
    lines = [f"{name} mixes with {', '.join(pairs)}" for name, pairs in found.items() if pairs]
    return tuple(lines[:MOST_ALIASES])


def _coded_design(kind: str, rows: Any, source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    steps = {factor.key: factor.step for factor in source.file.factors}
    settings = [
        {f.key: value_at(f, x, steps[f.key]) for f, x in zip(factors, row, strict=True)} for row in rows
    ]
    return _with_parts(Points(kind, tuple(settings), ()), source.file.design.blocks)


def _numbers_only(factors: Sequence[FactorInfo], what: str) -> None:
    for factor in factors:
        if not factor.is_number:
            raise Refused(
                f"{what} varies numbers, and {factor.name} has none", "give low and high, or take lhs"
            )


def _bbd(source: StudySource, factors: Sequence[FactorInfo]) -> Points:

    _numbers_only(factors, "a Box-Behnken design")
    return _coded_design("Box-Behnken", box_behnken(len(factors)).tolist(), source, factors)


def _ccd(source: StudySource, factors: Sequence[FactorInfo]) -> Points:

    _numbers_only(factors, "a central composite design")
    alpha = source.file.design.alpha
    rows = central_composite(len(factors), alpha)
    name = {"face": "face-centred", "rotatable": "rotatable"}.get(str(alpha), f"alpha {alpha}")
    return _coded_design(f"central composite, {name}", rows.tolist(), source, factors)


def _sampled(source: StudySource, factors: Sequence[FactorInfo]) -> Points:

    design = source.file.design
    if design.runs is None:
        raise Refused("how many points there are is not said", "add runs = 20 to [design]")
    is_lhs = design.kind == "lhs"
    rows = (latin_hypercube if is_lhs else sobol_points)(len(factors), design.runs, design.seed)
    name = f"{'Latin hypercube' if is_lhs else 'Sobol sequence'} of {design.runs}"
    return _coded_design(name, rows.tolist(), source, factors)


def _sensitivity(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    from edmctl.study.statistics.choice import sensitivity_points

    base = source.file.design.base
    if base is None:
        raise Refused("how many base samples there are is not said", "add base = 64 to [design]")
    if base * (len(factors) + 2) > MOST_RUNS:
        raise Refused(f"{base * (len(factors) + 2)} runs are more than {MOST_RUNS}", "take fewer", "base")
    rows = sensitivity_points(len(factors), base, source.file.design.seed)
    return _coded_design(f"Sobol indices, {base} base samples", (2 * rows - 1).tolist(), source, factors)


def _csv(source: StudySource, factors: Sequence[FactorInfo]) -> Points:

    name, keys = source.file.design.file, [factor.key for factor in factors]
    if name is None:
        raise Refused("which table has the points is not said", 'add file = "points.csv" to [design]')
    try:
        table = read_table(user_path(name, source.path.parent), keys)
        if missing := [key for key in keys if key not in table.columns]:
            raise table.without(missing, "Head a column with each factor's key.")
        rows = list(table.rows())
    except RecordError as error:
        raise Refused(error.message.rstrip("."), error.hint.rstrip("."), "file") from None
    if not rows:
        raise Refused(f"{name} has no row under its columns", "add a row for each point", "file")
    settings = [{f.key: _value_in_table(f, row[f.key], name, line) for f in factors} for line, row in rows]
    return _with_parts(Points(f"points of {name}", tuple(settings), ()), source.file.design.blocks)


def _value_in_table(factor: FactorInfo, text: str, name: str, line: int) -> Value:
    if not factor.is_number:
        found = [value for value in factor.values if str(value) == text]
        if found:
            return found[0]
        raise Refused(
            f"{name}, line {line}: {text!r} is none of {factor.name}'s values", "correct it", "file"
        )
    value = number_of(text)
    if value is None:
        raise Refused(f"{name}, line {line}: {text!r} is no number", "correct it", "file")
    low, high = (float(pick(factor.values)) for pick in (min, max))
    if not low <= value <= high:
        message = f"{name}, line {line}: {factor.name} = {value:g} lies beyond {low:g} to {high:g}"
        raise Refused(message, "correct it, or widen the factor", "file")
    return int(value) if value.is_integer() and all(isinstance(v, int) for v in factor.values) else value


_MAKERS = {
    "full": _full,
    "fractional": _fractional,
    "taguchi": _taguchi,
    "bbd": _bbd,
    "ccd": _ccd,
    "lhs": _sampled,
    "sobol": _sampled,
    "sensitivity": _sensitivity,
    "csv": _csv,
}


_REMEDIES = {
    "fractional": ("docs/study.md tells how fractions are named", "generators", "resolution"),
    "taguchi": ("give other levels, or another array", "array"),
    "bbd": ("vary other factors, or take ccd", "kind"),
    "ccd": ("vary two factors or more, or take lhs", "alpha"),
    "sensitivity": ("take a power of two", "base"),
}
"""The hint on a design that cannot be, and the key of [design] that it names: the first of them that is given."""


def center_of(source: StudySource, factors: Sequence[FactorInfo]) -> dict[str, Value]:
    """Return the settings of a centre run."""
    steps = {factor.key: factor.step for factor in source.file.factors}
    return {f.key: middle(f, steps[f.key]) for f in factors}


def model_of(source: StudySource, factors: Sequence[FactorInfo], points: Points) -> str:
    """Return which model is fitted: the one that is asked for, or the one that the design is for."""
    asked = source.file.analysis.model
    if asked != "auto":
        return asked
    kind = source.file.design.kind
    if kind == "full" and not all(f.is_number and len(f.values) == 2 for f in factors):
        return PAIRS
    if not any(f.is_number for f in factors):
        return LEVELS
    if kind in ("full", "taguchi"):
        if all(f.is_number and len(f.values) == 2 for f in factors):
            return "interactions" if kind == "full" else "main"  # a centre run shows curvature
        return LEVELS
    if kind == "fractional":
        return "interactions" if points.tells_pairs else "main"
    return QUADRATIC


def terms_of(model: str, factors: Sequence[FactorInfo], *, blocks: bool) -> list[Term]:
    """Return the terms of a model: what each factor, pair and square adds; the block's among them."""
    numbers = [f.name for f in factors if f.is_number]
    others = [f.name for f in factors if not f.is_number]
    names = [f.name for f in factors]
    if model in ("levels", "main"):
        terms = main_effects(names)
    elif model in ("interactions", PAIRS):
        terms = with_interactions(names)
    else:
        terms = second_order(numbers, others)
    return [*terms[:1], *([((BLOCK, 1),)] if blocks else []), *terms[1:]]


def degrees_of_freedom(
    terms: Sequence[Term],
    factors: Sequence[FactorInfo],
    settings: Sequence[Mapping[str, Value]],
    blocks: Sequence[int],
    *,
    as_levels: bool,
) -> tuple[dict[str, int], list[str]]:
    """Return degrees of freedom by term and what is left for the error; and the terms that the runs do not tell."""
    matrix = model_matrix(settings_matrix(factors, settings, blocks, as_levels=as_levels), terms)
    lost = undetermined(matrix)
    dof = {
        term_name(term): span.stop - span.start
        for term, span in matrix.spans.items()
        if term and term not in lost
    }
    left = len(settings) - 1 - sum(dof.values())
    return {**dof, "error": left}, [term_name(term) for term in lost]
