"""Runs side by side: what was set differently, what came out, and whether the difference says anything."""

from __future__ import annotations

import math
from string import ascii_uppercase
from typing import TYPE_CHECKING, Protocol

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns, width_of
from edmctl.labels import marked, meanings
from edmctl.wording import UNKNOWN, count, escaped, named_with_unit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

MOST_BESIDE = 4
"""More runs than these have a row each: beside one another they would not fit on a terminal."""
ROW_COLUMNS = 116
"""A table with a row a run is as wide as this at most; what does not fit makes another."""
MOST_LETTERS = 30
"""A value longer than this is cut off."""
_HEADING_TIME = 16


class ComparedRunView(Protocol):
    """A run of the comparison."""

    @property
    def file(self) -> str: ...
    @property
    def title(self) -> str: ...
    @property
    def start(self) -> str: ...
    @property
    def status(self) -> str: ...
    @property
    def simulated(self) -> bool: ...
    @property
    def seed(self) -> int | None: ...


class SettingView(Protocol):
    """Something that is not the same in all runs."""

    @property
    def key(self) -> str: ...
    @property
    def units(self) -> str: ...
    @property
    def values(self) -> Sequence[str]: ...


class AmountView(Protocol):
    """A quantity in one run, and against the first."""

    @property
    def value(self) -> float: ...
    @property
    def u95(self) -> float: ...
    @property
    def difference(self) -> float: ...
    @property
    def difference_u95(self) -> float: ...
    @property
    def beyond(self) -> bool: ...
    @property
    def basis(self) -> str: ...


class QuantityView(Protocol):
    """One quantity in every run; shown is `factor` times its value."""

    @property
    def name(self) -> str: ...
    @property
    def decimals(self) -> int: ...
    @property
    def factor(self) -> float: ...
    @property
    def amounts(self) -> Sequence[AmountView]: ...


class ComparisonView(Protocol):
    """Several runs against the first."""

    @property
    def runs(self) -> Sequence[ComparedRunView]: ...
    @property
    def differs(self) -> Sequence[SettingView]: ...
    @property
    def quantities(self) -> Sequence[QuantityView]: ...
    @property
    def sites(self) -> Sequence[QuantityView]: ...


def letter(number: int) -> str:
    """Return the name of a run in the table: A, B … Z, A2 …"""
    turn, index = divmod(number, len(ascii_uppercase))
    return f"{ascii_uppercase[index]}{turn + 1 if turn else ''}"


def render_comparison(comparison: ComparisonView, style: Style = PLAIN) -> str:
    """Render the runs, what differs, and the quantities: a few runs beside each other, many below each other."""
    blocks = [_runs(comparison.runs, style)]
    if len(comparison.runs) > MOST_BESIDE:
        blocks += _row_a_run(comparison, style)
    else:
        blocks.append(_settings(comparison, style))
        for quantities, heading in ((comparison.quantities, "result"), (comparison.sites, "site")):
            if quantities:
                blocks.append(_quantities(quantities, heading, style))
    blocks.append(_reading(comparison))
    return "\n\n".join(block for block in blocks if block)


def _row_a_run(comparison: ComparisonView, style: Style) -> list[str]:
    """Tables with a row for each run and a column for each setting and quantity, as many tables as they need."""
    settings = {
        named_with_unit(setting.key, setting.units): [_short(value) for value in setting.values]
        for setting in comparison.differs
    }
    quantities = {
        quantity.name: [f"{_value(quantity, amount)}{_mark(amount)}" for amount in quantity.amounts]
        for quantity in (*comparison.quantities, *comparison.sites)
    }
    letters = [letter(number) for number in range(len(comparison.runs))]
    tables: list[dict[str, list[str]]] = []
    for name, cells in (settings | quantities).items():
        if not tables or _width_of({**tables[-1], name: cells}) > ROW_COLUMNS:
            tables.append({"": letters})
        tables[-1][name] = cells
    same = [] if settings else [_nothing_differs(letters)]
    return [*same, *(render_columns(list(table), _transposed(table), style) for table in tables)]


def _width_of(table: Mapping[str, Sequence[str]]) -> int:
    return width_of(list(table), _transposed(table))


def _transposed(table: Mapping[str, Sequence[str]]) -> list[tuple[str, ...]]:
    return list(zip(*table.values(), strict=True))


def _mark(amount: AmountView) -> str:
    return " *" if amount.beyond else "  "


def _nothing_differs(letters: Sequence[str]) -> str:
    return f"Nothing was set differently in {', '.join(letters)}."


def _runs(runs: Sequence[ComparedRunView], style: Style) -> str:
    rows = [
        [
            letter(number),
            escaped(run.file),
            run.start[:_HEADING_TIME].replace("T", " "),
            run.status
            + (", simulated" if run.simulated else "")
            + ("" if run.seed is None else f", seed {run.seed}"),
        ]
        for number, run in enumerate(runs)
    ]
    return render_columns(["", "file", "started", "status"], rows, style, align="<")


def _settings(comparison: ComparisonView, style: Style) -> str:
    letters = [letter(number) for number in range(len(comparison.runs))]
    rows = [
        [named_with_unit(setting.key, setting.units), *map(_short, setting.values)]
        for setting in comparison.differs
    ]
    return render_columns(["what differs", *letters], rows, style) if rows else _nothing_differs(letters)


def _quantities(quantities: Sequence[QuantityView], heading: str, style: Style) -> str:
    header = [heading, letter(0)]
    for number in range(1, len(quantities[0].amounts)):
        header += [letter(number), f"{letter(number)} − A"]
    rows = []
    for quantity in quantities:
        first, *others = quantity.amounts
        row = [quantity.name, _value(quantity, first)]
        for amount in others:
            difference = _number(quantity, amount.difference, amount.difference_u95, sign=True)
            row += [_value(quantity, amount), f"{difference}{_mark(amount)}"]
        rows.append(row)
    return render_columns(header, rows, style)


def _reading(comparison: ComparisonView) -> str:
    """How the tables are to be read."""
    amounts = [amount for quantity in comparison.quantities for amount in quantity.amounts[1:]]
    if not any(math.isfinite(amount.difference_u95) for amount in amounts):
        return ""
    bases = {a.basis for q in (*comparison.quantities, *comparison.sites) for a in q.amounts}
    return "\n".join(
        [
            "± is half the 95 % interval of a result, of a difference that of both runs together.",
            "* marks a difference from A beyond it. How far repeated runs scatter is not in it.",
            *meanings(bases),
        ]
    )


def _value(quantity: QuantityView, amount: AmountView) -> str:
    return marked(_number(quantity, amount.value, amount.u95), amount.basis)


def _number(quantity: QuantityView, value: float, u95: float, *, sign: bool = False) -> str:
    if not math.isfinite(value):
        return UNKNOWN
    text = _decimal(quantity.factor * value, quantity.decimals, sign=sign)
    if math.isfinite(u95):
        text += f" ± {_decimal(quantity.factor * u95, quantity.decimals)}"
    return text


def _decimal(value: float, decimals: int, *, sign: bool = False) -> str:
    # Adding zero takes the sign off a rounded zero.
    rounded = round(value, decimals) + 0.0
    if not decimals:
        return f"{'+' if sign and rounded > 0 else ''}{count(int(rounded))}".replace("-", "−")
    return f"{rounded:{'+' if sign and rounded else ''}.{decimals}f}".replace("-", "−")


def _short(text: str) -> str:
    text = escaped(text) or UNKNOWN
    return text if len(text) <= MOST_LETTERS else f"{text[: MOST_LETTERS - 1]}…"
