"""Factors and designs: values, coding, which points are run, and which model they can fit."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
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
from edmctl.study.statistics import designs
from edmctl.study.statistics import linear_model as models
from edmctl.study.statistics.linear_model import BLOCK, Settings, Term
from edmctl.study.study_file import StudySource
from edmctl.wording import plural

DIGITS = 4
"""Significant digits of values that a design puts between two bounds: what a person would set."""
RESERVED = (BLOCK, "mean", "error", "total")
"""Rows of an analysis that are no factors."""
MOST_RUNS = 20_000
MOST_ALIASES = 40
DEALT = 500
"""Ways to assign points to blocks that are tried."""
LEVELS, PAIRS, QUADRATIC = "levels", "level pairs", "quadratic"
AS_LEVELS = (LEVELS, PAIRS)
"""Models in which numbers are levels without order."""
OWN_KEYS = {
    "fractional": ("generators", "resolution"),
    "taguchi": ("array",),
    "ccd": ("alpha",),
    "lhs": ("runs",),
    "sobol": ("runs",),
    "csv": ("file",),
}
"""Keys of [design] that belong to one kind of it."""


def factors_of(source: StudySource) -> tuple[FactorInfo, ...]:
    """Return the factors of a study file. Raises ProfileError for the first that is wrong."""
    factors = [_factor(source, number) for number in range(len(source.file.factors))]
    for names, what, hint in (
        ([one.key for one in factors], "{} is varied twice", "give each key once"),
        ([one.name for one in factors], "two factors are called {}", "give them other names"),
    ):
        for number, name in enumerate(names):
            source.require(names.index(name) == number, what.format(name), hint, "factors", number, "key")
    return tuple(factors)


def _factor(source: StudySource, number: int) -> FactorInfo:
    factor, place = source.file.factors[number], ("factors", number)
    key = factor.key
    has_bounds = factor.low is not None or factor.high is not None
    source.require(
        [bool(factor.levels), bool(factor.categories), has_bounds].count(True) == 1,
        f"factor {key} needs either levels, or low and high, or categories",
        'levels = [0.7, 0.8, 0.9], or low = 0.7 and high = 0.9, or categories = ["Cu", "W"]',
        *place,
    )
    message = f"a factor cannot be called {factor.name}: every analysis has a row of that name"
    source.require(factor.name not in RESERVED, message, "give it another name", *place, "name")
    values = [*factor.levels, *factor.categories]
    low, high, step = factor.low, factor.high, factor.step
    if has_bounds:
        if low is None or high is None:
            raise source.wrong(f"factor {key} needs low and high", "give both", *place)
        source.require(
            low < high, f"low = {low} of {key} is not below high = {high}", "swap them", *place, "low"
        )
        message = f"fewer than two multiples of {step} lie between low and high of {key}"
        is_wide = step is None or math.floor(high / step + 1e-9) > math.ceil(low / step - 1e-9)
        source.require(is_wide, message, "take a smaller step", *place, "step")
        values = [low, high]
    else:
        message = f"step has no effect on the listed values of {key}"
        source.require(step is None, message, "remove it, or give low and high", *place, "step")
        different = {float(value) if _is_number(value) else repr(value) for value in values}
        message = f"factor {key} needs two or more different values"
        kind = "levels" if factor.levels else "categories"
        source.require(1 < len(values) == len(different), message, "give each once", *place, kind)
    is_number = not factor.categories and all(map(_is_number, values))
    is_log = is_number and factor.scale == "log"
    message = f"values of {key} on a logarithmic scale have to be above 0"
    is_positive = not is_log or min(map(float, values)) > 0
    source.require(is_positive, message, 'say scale = "linear"', *place, "scale")
    return FactorInfo(key, factor.name or key, tuple(values), is_number, is_log, is_range=has_bounds)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


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
        allowed = ", ".join(map(repr, factor.values))
        if factor.is_number:
            allowed = "{:g} to {:g}".format(*_bounds(factor))
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
    separates_pairs : whether no product of two factors mixes with a factor or with another product
    """

    name: str
    settings: tuple[dict[str, Value], ...]
    blocks: tuple[int, ...] = ()
    aliases: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    separates_pairs: bool = False


def _settings(factors: Sequence[FactorInfo], rows: Iterable[Sequence[Value]]) -> tuple[dict[str, Value], ...]:
    keys = [factor.key for factor in factors]
    return tuple(dict(zip(keys, row, strict=True)) for row in rows)


def points_of(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    """Return the points of a study's design. Raises ProfileError if there can be none."""
    design = source.file.design
    makers = {"full": _full, "fractional": _fractional, "taguchi": _taguchi, "csv": _csv}
    try:
        points = makers.get(design.kind, _coded_points)(source, factors)
    except ValueError as error:
        key = next((key for key in OWN_KEYS.get(design.kind, ()) if getattr(design, key)), "kind")
        hint = "docs/study.md#designs lists what each kind needs"
        raise source.wrong(str(error).rstrip("."), hint, "design", key) from error
    if not points.blocks:
        points = _with_blocks(source, points)
    _refuse_many(source, len(points.settings) * design.replicates)
    return points


def _refuse_many(source: StudySource, runs: int) -> None:
    message = f"the design has {runs} runs, and at most {MOST_RUNS} are planned"
    source.require(runs <= MOST_RUNS, message, "take a fraction, an array or fewer levels", "design", "kind")


def _with_blocks(source: StudySource, points: Points) -> Points:
    """Assign points to blocks of about equal size, of many ways the one that mixes least with the factors."""
    import numpy as np

    count, blocks = len(points.settings), source.file.design.blocks
    message = f"{blocks} blocks of {plural(count, 'point')}"
    source.require(blocks <= count, message, "take fewer", "design", "blocks")
    if blocks == 1:
        return replace(points, blocks=(0,) * count)
    rng = np.random.default_rng(0)
    even = [n % blocks for n in range(count)]
    ways = [even, *(rng.permutation(even).tolist() for _ in range(DEALT if count <= 200 else 0))]
    best = min(ways, key=lambda way: mixing(points, range(count), way))
    notes = points.notes
    if mixing(points, range(count), best) > 1e-9:
        notes = (*notes, "blocks mix a little with the effects of factors: the analysis separates them")
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
    _refuse_many(source, math.prod(len(factor.values) for factor in factors))
    settings = _settings(factors, itertools.product(*(factor.values for factor in factors)))
    name = "full factorial " + " × ".join(str(len(f.values)) for f in factors)
    blocks = source.file.design.blocks
    if blocks == 1 or blocks & (blocks - 1) or any(len(f.values) != 2 for f in factors):
        return Points(name, settings)
    # Blocks of two-level runs hide the longest products (Box, Hunter and Hunter 2005, chapter 5).
    words = designs.hiding_words(len(factors), blocks.bit_length() - 1)
    message = f"{blocks} blocks of {plural(len(settings), 'run')} would hide the effect of a factor"
    source.require(words, message, "take fewer blocks", "design", "blocks")
    numbers = []
    for setting in settings:
        bits = [sum(setting[factors[f].key] == factors[f].values[1] for f in word) % 2 for word in words]
        numbers.append(sum(bit << n for n, bit in enumerate(bits)))
    hidden = ", ".join(map(designs.letters_of, words))
    note = f"blocks cannot be separated from {hidden} and their products"
    return Points(f"{name} in {blocks} blocks", settings, tuple(numbers), notes=(note,))


_ROMAN = {3: "III", 4: "IV", 5: "V", 6: "VI", 7: "VII", 8: "VIII", 9: "IX"}


def _fractional(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    design, count = source.file.design, len(factors)
    for factor in factors:
        message = f"a fractional factorial needs two levels of each factor; {factor.name} has others"
        source.require(len(factor.values) == 2, message, "give low and high", "design", "kind")
    source.require(
        bool(design.generators) != (design.resolution is not None),
        "a fractional factorial needs either a resolution or generators",
        'say resolution = 4, or generators = ["D = ABC"]',
        *("design", "kind"),
    )
    if design.generators:
        fraction = designs.fraction_of(count, design.generators)
    else:
        fraction = designs.fraction_for(count, design.resolution or 3)
    values = [
        [f.values[int(sign > 0)] for f, sign in zip(factors, row, strict=True)]
        for row in fraction.coded().tolist()
    ]
    name, resolution = f"full factorial 2^{count}", fraction.resolution
    if resolution is not None:
        roman = _ROMAN.get(resolution, resolution)
        name = f"fractional factorial 2^({count}-{len(fraction.generators)}), resolution {roman}"
    lines = []
    for group in fraction.aliases():
        effects = [
            ("" if sign > 0 else "−") + " × ".join(factors[n].name for n in sorted(effect))
            for effect, sign in group
        ]
        lines.append(" = ".join(effects))
    if more := max(0, len(lines) - MOST_ALIASES):
        lines[MOST_ALIASES:] = [f"and {more} more groups"]
    separates_pairs = resolution is None or resolution >= 5
    return Points(name, _settings(factors, values), (), tuple(lines), separates_pairs=separates_pairs)


def _taguchi(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    design = source.file.design
    counts = [len(f.values) for f in factors]
    array, columns = designs.array_for(counts, design.array)
    levels = array.levels[:, list(columns)]
    values = [[f.values[level] for f, level in zip(factors, row, strict=True)] for row in levels.tolist()]
    aliases = _array_aliases(levels, [f.name for f in factors])
    note = "interactions mix with the effects of other factors: an orthogonal array shows main effects alone"
    return Points(
        f"Taguchi {array.name}", _settings(factors, values), (), aliases, (note,) if aliases else ()
    )


def _array_aliases(levels: Any, names: Sequence[str]) -> tuple[str, ...]:
    """Return which products of two factors are correlated with which main effects."""
    import numpy as np

    of_runs = dict(zip(names, levels.T.tolist(), strict=True))
    settings = Settings({}, of_runs, {name: sorted(set(column)) for name, column in of_runs.items()})
    pairs = {
        pair: models.model_matrix(settings, [tuple((n, 1) for n in pair)]).columns
        for pair in itertools.combinations(names, 2)
    }
    lines = []
    for name in names:
        columns = models.model_matrix(settings, [(), ((name, 1),)]).columns
        columns[:, 1:] -= columns[:, 1:].mean(axis=0)
        alone = np.linalg.qr(columns)[0][:, 1:]
        mixed = [
            " × ".join(pair)
            for pair, product in pairs.items()
            if name not in pair and np.abs(alone.T @ product).max() > 1e-9
        ]
        if mixed:
            lines.append(f"{name} mixes with {', '.join(mixed)}")
    return tuple(lines[:MOST_ALIASES])


def _coded_points(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    """Points of a design whose settings are places between the bounds, −1 … 1."""
    design, count = source.file.design, len(factors)
    if design.kind in ("bbd", "ccd"):
        for factor in factors:
            message = f"a response-surface design varies numbers, and {factor.name} has none"
            source.require(factor.is_number, message, "give low and high, or take lhs", "design", "kind")
    if design.kind == "bbd":
        name, rows = "Box-Behnken", designs.box_behnken(count)
    elif design.kind == "ccd":
        rows = designs.central_composite(count, design.alpha)
        named = {"face": "face-centred", "rotatable": "rotatable"}
        name = f"central composite, {named.get(str(design.alpha), f'alpha {design.alpha}')}"
    elif design.runs is None:
        raise source.wrong("runs is missing", "add runs = 20 to [design]", "design", "kind")
    elif design.kind == "lhs":
        name, rows = (
            f"Latin hypercube of {design.runs}",
            designs.latin_hypercube(count, design.runs, design.seed),
        )
    else:
        name, rows = f"Sobol sequence of {design.runs}", designs.sobol_points(count, design.runs, design.seed)
    values = [
        [value_at(f, x, source.steps[f.key]) for f, x in zip(factors, row, strict=True)]
        for row in rows.tolist()
    ]
    return Points(name, _settings(factors, values))


def _csv(source: StudySource, factors: Sequence[FactorInfo]) -> Points:
    name, keys, place = source.file.design.file, [factor.key for factor in factors], ("design", "file")
    if name is None:
        raise source.wrong("file is missing", 'add file = "points.csv" to [design]', "design", "kind")
    try:
        table = read_table(user_path(name, source.path.parent), keys)
        if missing := [key for key in keys if key not in table.columns]:
            raise table.without(missing, "Head a column with each factor's key.")
        rows = list(table.rows())
    except RecordError as error:
        raise source.wrong(error.message.rstrip("."), error.hint.rstrip("."), *place) from None
    source.require(rows, f"{name} has no row under its columns", "add a row for each point", *place)
    settings = []
    for line, row in rows:
        values = {factor.key: _value_of(factor, row[factor.key]) for factor in factors}
        for factor in factors:
            message = f"{name}, line {line}: {factor.name} = {row[factor.key]} is not one of its values"
            hint = "correct it, or change the factor"
            source.require(is_within(factor, values[factor.key]), message, hint, *place)
        settings.append(values)
    return Points(f"points of {name}", tuple(settings))


def _value_of(factor: FactorInfo, text: str) -> Any:
    """Return the value of a factor that a cell contains; None for another text."""
    if not factor.is_number:
        return next((value for value in factor.values if str(value) == text), None)
    value = number_of(text)
    is_whole = value is not None and value.is_integer() and all(isinstance(one, int) for one in factor.values)
    return round(value or 0.0) if is_whole else value


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
        return "interactions" if points.separates_pairs else "main"
    return QUADRATIC


def terms_of(model: str, factors: Sequence[FactorInfo], *, blocks: bool) -> list[Term]:
    """Return the terms of a model: each factor, pair and square, and the blocks."""
    names, numbers = [f.name for f in factors], [f.name for f in factors if f.is_number]
    if model in ("levels", "main"):
        mean, *terms = models.main_effects(names)
    elif model in ("interactions", PAIRS):
        mean, *terms = models.with_interactions(names)
    else:
        mean, *terms = models.second_order(numbers, [name for name in names if name not in numbers])
    return [mean, *([((BLOCK, 1),)] if blocks else []), *terms]


def degrees_of_freedom(
    terms: Sequence[Term],
    factors: Sequence[FactorInfo],
    settings: Sequence[Mapping[str, Value]],
    blocks: Sequence[int],
    *,
    as_levels: bool,
) -> tuple[dict[str, int], list[str]]:
    """Return degrees of freedom by term and what is left for the error; and the terms that are undetermined."""
    matrix = models.model_matrix(settings_matrix(factors, settings, blocks, as_levels=as_levels), terms)
    lost = models.undetermined(matrix)
    dof = {models.term_name(term): matrix.dof(term) for term in matrix.spans if term and term not in lost}
    return {**dof, "error": len(settings) - 1 - sum(dof.values())}, [models.term_name(term) for term in lost]
