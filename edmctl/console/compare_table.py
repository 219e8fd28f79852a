"""Runs side by side: what was set differently, what came out, and whether the difference says anything."""

from __future__ import annotations

import math
from string import ascii_uppercase
from typing import TYPE_CHECKING

from edmctl.console.layout import NARROW_GAP, render_table, width_of
from edmctl.console.style import PLAIN, Style
from edmctl.labels import marked, meanings
from edmctl.wording import UNKNOWN, count, escaped, named_with_unit, shortened

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from edmctl.results.comparison import Amount, ComparedRun, Comparison, Quantity

    Table = Mapping[str, Sequence[str]]

MOST_BESIDE = 4
"""More runs than these have a row each: beside one another they would not fit on a terminal."""
ROW_COLUMNS = 116
"""A table with a row a run is as wide as this at most; what does not fit makes another."""
MOST_LETTERS = 30
"""A value longer than this is cut off, on a narrow terminal a shorter one."""
LEAST_LETTERS = 11
_HEADING_TIME = 16


def letter(number: int) -> str:
    """Return the name of a run in the table: A, B … Z, A2 …"""
    turn, index = divmod(number, len(ascii_uppercase))
    return f"{ascii_uppercase[index]}{turn + 1 if turn else ''}"


def render_comparison(comparison: Comparison, style: Style = PLAIN) -> str:
    """Render the runs, what differs, and the quantities: a few runs beside each other, many below each other.

    Where runs beside each other are wider than a terminal, they stand below each other.
    """
    columns = style.columns
    blocks = [_runs(comparison.runs, style)]
    both = ((comparison.quantities, "result"), (comparison.sites, "site"))
    beside = [_quantities(quantities, heading) for quantities, heading in both if quantities]
    settings = _settings(comparison, columns)
    fits = columns is None or all(width_of(table, NARROW_GAP) <= columns for table in [settings, *beside])
    if len(comparison.runs) > MOST_BESIDE or not fits:
        blocks += _row_a_run(comparison, style, min(columns or ROW_COLUMNS, ROW_COLUMNS))
    else:
        letters = list(settings)[1:]
        blocks.append(render_table(settings, style) if comparison.differs else _nothing_differs(letters))
        blocks += [render_table(table, style) for table in beside]
    blocks.append(_reading(comparison))
    return "\n\n".join(block for block in blocks if block)


def _row_a_run(comparison: Comparison, style: Style, columns: int) -> list[str]:
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
        if not tables or width_of({**tables[-1], name: cells}) > columns:
            tables.append({"": letters})
        tables[-1][name] = cells
    same = [] if settings else [_nothing_differs(letters)]
    return [*same, *(render_table(table, style) for table in tables)]


def _mark(amount: Amount) -> str:
    return " *" if amount.beyond else "  "


def _nothing_differs(letters: Sequence[str]) -> str:
    return f"Nothing was set differently in {', '.join(letters)}."


def _runs(runs: Sequence[ComparedRun], style: Style) -> str:
    table = {
        "": [letter(number) for number in range(len(runs))],
        "file": [escaped(run.file) for run in runs],
        "started": [run.start[:_HEADING_TIME].replace("T", " ") for run in runs],
        "status": [
            run.status
            + (", simulated" if run.simulated else "")
            + ("" if run.seed is None else f", seed {run.seed}")
            for run in runs
        ],
    }
    return render_table(table, style, left=list(table), cut_first="file")


def _settings(comparison: Comparison, columns: int | None) -> Table:
    names = [named_with_unit(setting.key, setting.units) for setting in comparison.differs]
    most = MOST_LETTERS
    if columns is not None:
        for_each = (columns - max(map(len, names), default=0)) // len(comparison.runs)
        most = min(MOST_LETTERS, max(LEAST_LETTERS, for_each - 3))
    table = {"what differs": names}
    for number in range(len(comparison.runs)):
        table[letter(number)] = [_short(setting.values[number], most) for setting in comparison.differs]
    return table


def _quantities(quantities: Sequence[Quantity], heading: str) -> Table:
    table = {heading: [quantity.name for quantity in quantities]}
    for number in range(len(quantities[0].amounts)):
        amounts = [(quantity, quantity.amounts[number]) for quantity in quantities]
        table[letter(number)] = [_value(quantity, amount) for quantity, amount in amounts]
        if number:
            table[f"{letter(number)} − A"] = [
                f"{_number(quantity, amount.difference, amount.difference_u95, sign=True)}{_mark(amount)}"
                for quantity, amount in amounts
            ]
    return table


def _reading(comparison: Comparison) -> str:
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


def _value(quantity: Quantity, amount: Amount) -> str:
    return marked(_number(quantity, amount.value, amount.u95), amount.basis)


def _number(quantity: Quantity, value: float, u95: float, *, sign: bool = False) -> str:
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


def _short(text: str, most: int = MOST_LETTERS) -> str:
    return shortened(escaped(text) or UNKNOWN, most)
