"""Factors and designs: values, coding, which points are run, and which model they can fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

from edmctl import failures
from edmctl.csv_text import number_of
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import RecordError
from edmctl.files import user_path
from edmctl.profile.model import ProfileFile
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
    BLOCK,
    Settings,
    Term,
    main_effects,
    model_matrix,
    second_order,
    term_name,
    undetermined,
    with_interactions,
)
from edmctl.study.study_file import Factor, Refusals, StudySource
from edmctl.wording import plural

DIGITS = 4
"""Significant digits of values that a design puts between two bounds: what a person would set."""
RESERVED = (BLOCK, "mean", "error", "total")
"""Rows of an analysis that are no factors."""
MOST_RUNS = 20_000
MOST_ALIASES = 40
DEALT = 500
"""Ways to assign points to blocks that are tried."""
LEVELS, PAIRS, QUADRATIC, SENSITIVITY = "levels", "level pairs", "quadratic", "sensitivity"
AS_LEVELS = (LEVELS, PAIRS)
"""Models in which numbers are levels without order."""


class Refused(Exception):
    """A factor or a design that cannot be; `key` is that of its table, empty for the whole of it."""

    def __init__(self, message: str, hint: str, key: str = "") -> None:
        super().__init__(message)
        self.message, self.hint, self.key = message, hint, key


def factors_of(source: StudySource) -> tuple[tuple[FactorInfo, ...], Refusals]:
    """Return the factors of a study file, and what is wrong with them."""
    wrong, found = Refusals(source), []
    keys = [factor.key for factor in source.file.factors]
    for number, factor in enumerate(source.file.factors):
        if keys.index(factor.key) != number:
            wrong.add("give each key once", f"{factor.key} is varied twice", "factors", number, "key")
            continue
        if ("factors", number) in source.damaged:
            continue
        if factor.name in RESERVED:
            message = (
                f"a factor cannot be called {factor.name}: tables of every analysis have a row of that name"
            )
            wrong.add("give it another name", message, "factors", number, "name")
        try:
            found.append(_factor(factor))
        except Refused as refused:
            key = [refused.key] if refused.key else []
            message = f"factor {factor.key}: {refused.message}"
            wrong.add(refused.hint, message, "factors", number, *key)
    names = [factor.name for factor in found]
    if again := sorted({name for name in names if names.count(name) > 1}):
        wrong.add("give them other names", f"two factors are called {again[0]}", "factors")
    return tuple(found), wrong


def _factor(factor: Factor) -> FactorInfo:
    given = [factor.levels, factor.categories, factor.low is not None or factor.high is not None]
    if sum(map(bool, given)) != 1:
        raise Refused(
            "give either levels, or low and high, or categories",
            'levels = [0.7, 0.8, 0.9], or low = 0.7 and high = 0.9, or categories = ["Cu", "W"]',
        )
    name = factor.name or factor.key
    for key, values in (("categories", factor.categories), ("levels", factor.levels)):
        if values:
            same = {float(value) if _is_number(value) else repr(value) for value in values}
            if len(values) < 2 or len(same) < len(values):
                message = f"{key} have to be two or more different values"
                raise Refused(message, "give two or more, each once", key)
            is_number = key == "levels" and all(map(_is_number, values))
            is_log = is_number and _is_log(factor)
            return FactorInfo(factor.key, name, tuple(values), is_number=is_number, is_log=is_log)
    low, high, step = factor.low, factor.high, factor.step
    if low is None or high is None:
        raise Refused("a range has low and high", "give both")
    if step is not None and math.floor(high / step + 1e-9) <= math.ceil(low / step - 1e-9):
        message = f"fewer than two multiples of {step:g} lie between the bounds"
        raise Refused(message, "take a smaller step", "step")
    if not low < high:
        raise Refused(f"low = {low} is not below high = {high}", "swap them", "low")
    is_log = _is_log(factor)
    return FactorInfo(factor.key, name, (low, high), is_number=True, is_log=is_log, is_range=True)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_log(factor: Factor) -> bool:
    values = [v for v in (*factor.levels, factor.low) if isinstance(v, int | float)]
    if factor.scale == "log" and min(values) <= 0:
        raise Refused("values on a logarithmic scale are above 0", 'say scale = "linear"', "scale")
    return factor.scale == "log"


def value_at(factor: FactorInfo, coded: float, step: float | None = None) -> Value:
    """Return the value of a coded setting, −1 … 1, rounded as a person would set it; of a category by its slice."""
    if not factor.is_number:
        slices = len(factor.values)
        return factor.values[min(slices - 1, int((coded + 1) / 2 * slices))]
    low, high = _bounds(factor)
    share = (coded + 1) / 2
    value = uncoded(factor, coded)
    if step is not None:
        least, most = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        value = float(f"{step * min(max(round(value / step), least), most):.12g}")
    elif abs(share - 0.5) < 0.5:
        value = min(max(float(f"{value:.{DIGITS}g}"), low), high)
    else:
        value = low if share < 0.5 else high
    of_profile = field_at(ProfileFile, tuple(factor.key.split(".")))
    is_whole = of_profile is not None and of_profile.annotation in (int, int | None)
    return round(value) if is_whole else value


def uncoded(factor: FactorInfo, coded: Any) -> Any:
    """Return the number, or the array of numbers, at a place between the bounds, −1 … 1."""
    low, high = _bounds(factor)
    share = (coded + 1) / 2
    return low * (high / low) ** share if factor.is_log else low + (high - low) * share


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


def is_within(factor: FactorInfo, value: object) -> bool:
    """Return whether a factor can have a value: one of its categories, or a number within its bounds."""
    if not factor.is_number:
        return any(value == one and type(value) is type(one) for one in factor.values)
    low, high = _bounds(factor)
    return _is_number(value) and low <= value <= high  # type: ignore[operator]


def value_within(factor: FactorInfo, value: object) -> Value:
    """Return a given value of a factor as a plain one. Raises UsageError E2110 for one beyond its bounds."""
    plain = value.item() if hasattr(value, "item") else value
    if not is_within(factor, plain):
        low, high = _bounds(factor) if factor.is_number else (0.0, 0.0)
        allowed = f"a number from {low:g} to {high:g}"
        if not factor.is_number:
            allowed = f"one of {', '.join(map(repr, factor.values))}"
        raise failures.setting_out_of_range(key=factor.key, value=value, allowed=allowed)
    assert isinstance(plain, bool | int | float | str)
    return plain


def settings_matrix(
    factors: Sequence[FactorInfo],
    settings: Sequence[Mapping[str, Value]],
    blocks: Sequence[int] | None = None,
    *,
    as_levels: bool = False,
) -> Settings:
    """Return settings for a model: numbers coded, categories by name, the block as a category `block`.

    as_levels : numbers are levels without order too
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


def settings_key(settings: Mapping[str, Value]) -> str:
    """Return a text that is equal for equal settings."""
    return repr(sorted(settings.items()))


def unit_points(factors: Sequence[FactorInfo], settings: Sequence[Mapping[str, Value]]) -> list[list[float]]:
    """Return settings as points between 0 and 1, a category as a column a name but the first."""
    points = []
    for one in settings:
        point: list[float] = []
        for factor in factors:
            value = one[factor.key]
            if factor.is_number:
                point.append((coded(factor, value) + 1) / 2)
            else:
                point += [float(value == name) for name in factor.values[1:]]
        points.append(point)
    return points


@dataclass(frozen=True, slots=True)
class Points:
    """The settings of a design in its standard order.

    name : of the design, in words
    blocks : of each point the number of its block within a replicate, from 0
    tells_pairs : of a fraction, whether no product of two factors mixes with a factor or with another product
    """

    name: str
    settings: tuple[dict[str, Value], ...]
    blocks: tuple[int, ...] = ()
    aliases: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    tells_pairs: bool = False


def points_of(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    """Return the points of a study's design. Raises Refused if there can be none."""
    design = source.file.design
    makers = {"full": _full, "fractional": _fractional, "taguchi": _taguchi, "csv": _csv}
    try:
        made = makers.get(design.kind, _coded_points)(source, factors)
    except ValueError as error:
        hint, *keys = _REMEDIES[design.kind]
        key = next((key for key in keys if getattr(design, key)), keys[0])
        raise Refused(str(error).rstrip("."), hint, key) from error
    if not made.blocks:
        made = _with_blocks(made, design.blocks)
    size = len(made.settings) * design.replicates
    if size > MOST_RUNS:
        runs = f"{plural(len(made.settings), 'point')} with {plural(design.replicates, 'replicate')} are {size} runs"
        raise Refused(f"{runs}, and at most {MOST_RUNS} are planned", "take a fraction, or fewer levels")
    return made


_REMEDIES = {
    "fractional": ("docs/study.md tells how fractions are named", "generators", "resolution"),
    "taguchi": ("give other levels, or another array", "array"),
    "bbd": ("vary other factors, or take ccd", "kind"),
    "ccd": ("vary two factors or more, or take lhs", "alpha"),
    "sensitivity": ("take a power of two", "base"),
}
"""The hint on a design that cannot be, and the key of [design] that it names: the first of them that is given."""


def _with_blocks(points: Points, blocks: int) -> Points:
    """Points dealt to blocks of about equal size: of many ways the one that mixes least with the factors."""
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
    notes = points.notes
    if mixing(points, range(count), best) > 1e-9:
        notes = (*notes, "blocks mix a little with the effects of factors: the analysis takes both apart")
    return replace(points, blocks=tuple(best), notes=notes)


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


def _full(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    size = math.prod(len(factor.values) for factor in factors)
    if size > MOST_RUNS:
        raise Refused(f"all combinations are {size} runs", "take a fraction, an array or a sample")
    rows = itertools.product(*(factor.values for factor in factors))
    settings = tuple({f.key: value for f, value in zip(factors, row, strict=True)} for row in rows)
    name = "full factorial " + " × ".join(str(len(f.values)) for f in factors)
    blocks = source.file.design.blocks
    if blocks == 1 or blocks & (blocks - 1) or any(len(f.values) != 2 for f in factors):
        return Points(name, settings)
    # Blocks of two-level runs hide the longest products (Box, Hunter and Hunter 2005, chapter 5).
    words = hiding_words(len(factors), blocks.bit_length() - 1)
    if not words:
        message = f"{blocks} blocks of {plural(len(settings), 'run')} would hide the effect of a factor"
        raise Refused(message, "take fewer blocks", "blocks")
    numbers = []
    for one in settings:
        bits = [sum(one[factors[f].key] == factors[f].values[1] for f in word) % 2 for word in words]
        numbers.append(sum(bit << n for n, bit in enumerate(bits)))
    hidden = ", ".join(letters_of(word) for word in words)
    note = f"blocks cannot be told apart from {hidden} and their products"
    return Points(f"{name} in {blocks} blocks", settings, tuple(numbers), notes=(note,))


_ROMAN = {3: "III", 4: "IV", 5: "V", 6: "VI", 7: "VII", 8: "VIII", 9: "IX"}


def _fractional(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    design, count = source.file.design, len(factors)
    if many := [f.name for f in factors if len(f.values) != 2]:
        message = f"a fractional factorial has factors of two levels, and {many[0]} has others"
        raise Refused(message, "give low and high")
    if bool(design.generators) == (design.resolution is not None):
        raise Refused(
            "a fractional factorial has either a resolution or generators",
            'say resolution = 4, or generators = ["D = ABC"]',
        )
    if design.generators:
        fraction = fraction_of(count, design.generators)
    else:
        fraction = fraction_for(count, design.resolution or 3)
    settings = [
        {f.key: f.values[int(sign > 0)] for f, sign in zip(factors, row, strict=True)}
        for row in fraction.coded().tolist()
    ]
    name, resolution = f"full factorial 2^{count}", fraction.resolution
    if resolution is not None:
        name = f"fractional factorial 2^({count}-{len(fraction.generators)}), "
        name += f"resolution {_ROMAN.get(resolution, resolution)}"
    lines = []
    for group in fraction.aliases():
        effects = [
            ("" if sign > 0 else "−") + " × ".join(factors[one].name for one in sorted(effect))
            for effect, sign in group
        ]
        lines.append(" = ".join(effects))
    if more := max(0, len(lines) - MOST_ALIASES):
        lines[MOST_ALIASES:] = [f"and {more} more groups"]
    tells_pairs = resolution is None or resolution >= 5
    return Points(name, tuple(settings), aliases=tuple(lines), tells_pairs=tells_pairs)


def _taguchi(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    design = source.file.design
    counts = [len(f.values) for f in factors]
    array, columns = array_for(counts, design.array)
    if design.columns:
        columns = tuple(column - 1 for column in design.columns)
        are_columns = len(set(columns)) == len(columns) == len(factors) and all(
            0 <= column < len(array.counts) for column in columns
        )
        if not are_columns or [array.counts[column] for column in columns] != counts:
            raise Refused(
                f"columns {', '.join(map(str, design.columns))} do not hold these factors",
                f"{array.name} has columns of {', '.join(map(str, array.counts))} levels; give one a factor",
                "columns",
            )
    levels = array.levels[:, list(columns)]
    settings = [
        {f.key: f.values[level] for f, level in zip(factors, row, strict=True)} for row in levels.tolist()
    ]
    note = (
        "interactions of factors mix with the effects of others: an orthogonal array tells main effects alone"
    )
    aliases = _array_aliases(levels, [f.name for f in factors])
    return Points(f"Taguchi {array.name}", tuple(settings), (), aliases, (note,) if aliases else ())


def _array_aliases(levels: Any, names: Sequence[str]) -> tuple[str, ...]:
    """Which products of two factors mix with which main effects, by what their columns have in common."""
    import numpy as np

    of_runs = dict(zip(names, levels.T.tolist(), strict=True))
    settings = Settings({}, of_runs, {name: sorted(set(column)) for name, column in of_runs.items()})
    alone = {}
    for name in names:
        columns = model_matrix(settings, [(), ((name, 1),)]).columns
        columns[:, 1:] -= columns[:, 1:].mean(axis=0)
        alone[name] = np.linalg.qr(columns)[0][:, 1:]
    found: dict[str, list[str]] = {name: [] for name in names}
    for a, b in itertools.combinations(names, 2):
        pair = model_matrix(settings, [((a, 1), (b, 1))]).columns
        for name in names:
            if name not in (a, b) and np.abs(alone[name].T @ pair).max() > 1e-9:
                found[name].append(f"{a} × {b}")
    lines = [f"{name} mixes with {', '.join(pairs)}" for name, pairs in found.items() if pairs]
    return tuple(lines[:MOST_ALIASES])


def _coded_points(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    """Points of a design whose settings are places between the bounds, −1 … 1."""
    design, count = source.file.design, len(factors)
    if design.kind in ("bbd", "ccd"):
        what = "a Box-Behnken design" if design.kind == "bbd" else "a central composite design"
        if names := [factor.name for factor in factors if not factor.is_number]:
            message = f"{what} varies numbers, and {names[0]} has none"
            raise Refused(message, "give low and high, or take lhs")
    if design.kind == "bbd":
        name, rows = "Box-Behnken", box_behnken(count)
    elif design.kind == "ccd":
        rows = central_composite(count, design.alpha)
        named = {"face": "face-centred", "rotatable": "rotatable"}
        name = f"central composite, {named.get(str(design.alpha), f'alpha {design.alpha}')}"
    elif design.kind == "sensitivity":
        from edmctl.study.statistics.choice import sensitivity_points

        if design.base is None:
            raise Refused("how many base samples there are is not said", "add base = 64 to [design]")
        if (size := design.base * (count + 2)) > MOST_RUNS:
            raise Refused(f"{size} runs are more than {MOST_RUNS}", "take fewer", "base")
        name = f"Sobol indices, {design.base} base samples"
        rows = 2 * sensitivity_points(count, design.base, design.seed) - 1
    elif design.runs is None:
        raise Refused("how many points there are is not said", "add runs = 20 to [design]")
    elif design.kind == "lhs":
        name, rows = f"Latin hypercube of {design.runs}", latin_hypercube(count, design.runs, design.seed)
    else:
        name, rows = f"Sobol sequence of {design.runs}", sobol_points(count, design.runs, design.seed)
    settings = [
        {f.key: value_at(f, x, source.steps[f.key]) for f, x in zip(factors, row, strict=True)}
        for row in rows.tolist()
    ]
    return Points(name, tuple(settings))


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
    settings = [
        {f.key: _value_in_table(f, row[f.key], f"{name}, line {line}") for f in factors} for line, row in rows
    ]
    return Points(f"points of {name}", tuple(settings))


def _value_in_table(factor: FactorInfo, text: str, place: str) -> Value:
    if not factor.is_number:
        if found := [value for value in factor.values if str(value) == text]:
            return found[0]
        raise Refused(f"{place}: {text!r} is none of {factor.name}'s values", "correct it", "file")
    value, (low, high) = number_of(text), _bounds(factor)
    if value is None:
        raise Refused(f"{place}: {text!r} is no number", "correct it", "file")
    if not low <= value <= high:
        message = f"{place}: {factor.name} = {value:g} lies beyond {low:g} to {high:g}"
        raise Refused(message, "correct it, or widen the factor", "file")
    return int(value) if value.is_integer() and all(isinstance(v, int) for v in factor.values) else value


def center_of(source: StudySource, factors: Sequence[FactorInfo]) -> dict[str, Value]:
    """Return the settings of a centre run: the middle of a range or of two levels, the middle level, a category."""
    center: dict[str, Value] = {}
    for factor in factors:
        values = factor.values
        if not factor.is_number:
            center[factor.key] = values[0]
        elif factor.is_range or len(values) == 2:
            center[factor.key] = value_at(factor, 0.0, source.steps[factor.key])
        else:
            center[factor.key] = sorted(values, key=float)[(len(values) - 1) // 2]
    return center


def model_of(source: StudySource, factors: Sequence[FactorInfo], points: Points) -> str:
    """Return which model is fitted: the one that is asked for, or the one that the design is for."""
    asked, kind = source.file.analysis.model, source.file.design.kind
    if asked != "auto":
        return asked
    of_two_levels = all(f.is_number and len(f.values) == 2 for f in factors)
    if kind == "full" and not of_two_levels:
        return PAIRS
    if not any(f.is_number for f in factors):
        return LEVELS
    if kind == "full":
        return "interactions"
    if kind == "taguchi":
        return "main" if of_two_levels else LEVELS  # a centre run shows curvature
    if kind == "fractional":
        return "interactions" if points.tells_pairs else "main"
    return QUADRATIC


def terms_of(model: str, factors: Sequence[FactorInfo], *, blocks: bool) -> list[Term]:
    """Return the terms of a model: each factor, pair and square, and the blocks."""
    names = [f.name for f in factors]
    if model in ("levels", "main"):
        terms = main_effects(names)
    elif model in ("interactions", PAIRS):
        terms = with_interactions(names)
    else:
        numbers = [f.name for f in factors if f.is_number]
        terms = second_order(numbers, [f.name for f in factors if not f.is_number])
    return [*terms[:1], *([((BLOCK, 1),)] if blocks else []), *terms[1:]]


def degrees_of_freedom(
    terms: Sequence[Term],
    factors: Sequence[FactorInfo],
    settings: Sequence[Mapping[str, Value]],
    blocks: Sequence[int],
    *,
    as_levels: bool,
) -> tuple[dict[str, int], list[str]]:
    """Return degrees of freedom by term and what is left for the error; and the terms that are undetermined."""
    matrix = model_matrix(settings_matrix(factors, settings, blocks, as_levels=as_levels), terms)
    lost = undetermined(matrix)
    dof = {term_name(term): matrix.dof(term) for term in matrix.spans if term and term not in lost}
    return {**dof, "error": len(settings) - 1 - sum(dof.values())}, [term_name(term) for term in lost]
