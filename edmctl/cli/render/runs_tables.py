"""Tables of many runs: a folder of them, some side by side, and the statistics of simulated ones.

A folder stands with the newest last: where the eye is when a command has ended. Side by side it is told what was
set differently, what came out, and whether the difference says anything. Of simulated runs it is told how far to
trust what is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from string import ascii_uppercase

from edmctl.cli.render.layout import narrowed, not_shown, render_columns, render_table, width_of, wrapped
from edmctl.cli.render.style import PLAIN, Ink, Style
from edmctl.labels import Basis, marked, meanings
from edmctl.results.run_file import Amount, ComparedRun, Comparison, Quantity, RunHead, Unreadable
from edmctl.results.simulation import Case, Statistics
from edmctl.wording import (
    UNKNOWN,
    count,
    decimal,
    duration,
    ended_as,
    escaped,
    file_size,
    iso_of,
    named_with_unit,
    percent,
    plural,
    printable,
    shortened,
    start_utc,
    with_u95,
)

FIRST_TO_GO = ("size", "seed", "sites", "work, tool", "machining", "profile", "wear µm", "start (UTC)")
"""Columns that a narrow terminal does without, one after the other."""
_UNREADABLE = {"E9005": "no run file", "E9006": "of another version", "E9007": "damaged", "E9016": "in use"}
_WORDS = ("start (UTC)", "status", "profile", "work, tool")


def render_runs(runs: Sequence[RunHead | Unreadable], style: Style = PLAIN) -> str:
    """Render a line per run; below it what is wrong with those that cannot be read.

    Columns are left out until the table fits a terminal.
    """
    columns = style.columns
    heads = [run for run in runs if not isinstance(run, Unreadable)]
    heirs = {run.parent_run: f"continued by {_name(run)}" for run in heads if run.parent_run}
    cells = {**_COLUMNS, "status": lambda run: heirs.get(run.run_id, _status(run))}
    table = {name: [_cell(run, name, cell) for run in runs] for name, cell in cells.items()}
    shown = narrowed(table, columns, FIRST_TO_GO)
    if columns is not None and width_of(shown) > columns:
        shown["status"] = [
            _cell(run, "status", lambda one: f"exit {one.exit_code}" if one.exit_code else _status(one))
            for run in runs
        ]
    text = render_table(shown, style, left=_WORDS, cut_first="run")
    notes = [
        *meanings({basis for run in heads for basis in _bases(run)}),
        "Depth and wear of several sites are their means." if any(run.sites > 1 for run in heads) else "",
        not_shown(table, shown),
    ]
    lines = [line for note in notes if note for line in wrapped(note, columns)]
    wrong = [escaped(run.error.message) for run in runs if isinstance(run, Unreadable)]
    parts = [text, style.paint("\n".join(lines), Ink.FAINT), "\n".join(wrong)]
    return "\n\n".join(filter(None, parts))


def _cell(run: RunHead | Unreadable, name: str, cell: Callable[[RunHead], str]) -> str:
    if not isinstance(run, Unreadable):
        return cell(run)
    known = {
        "run": _name(run),
        "start (UTC)": start_utc(iso_of(run.changed_s)),
        "status": _UNREADABLE.get(run.error.code, run.error.code),
        "size": file_size(run.size_bytes),
    }
    return known.get(name, "")


def _name(run: RunHead | Unreadable) -> str:
    return escaped(run.path.name.removesuffix(".h5"))


def _status(run: RunHead) -> str:
    status = printable(ended_as(run.status, run.error_code))
    return f"{status} ({run.exit_code})" if run.exit_code else status


def _depth(run: RunHead) -> str:
    if not math.isfinite(run.depth_um) and math.isfinite(run.est_depth_um):
        return marked(decimal(run.est_depth_um, 1), Basis.ESTIMATED)
    if run.through and run.through == run.sites:
        return "through"
    return marked(with_u95(run.depth_um, run.depth_u95_um), run.depth_basis)


def _bases(run: RunHead) -> tuple[str, ...]:
    left = Basis.ESTIMATED if math.isfinite(run.est_depth_um) and not math.isfinite(run.depth_um) else ""
    return (run.depth_basis, run.wear_basis, left)


_COLUMNS: dict[str, Callable[[RunHead], str]] = {
    "run": _name,
    "start (UTC)": lambda run: start_utc(run.start_time),
    "status": _status,
    "profile": lambda run: printable(run.name),
    "work, tool": lambda run: printable(f"{run.work}, {run.tool}"),
    "depth µm": _depth,
    "wear µm": lambda run: marked(with_u95(run.wear_um, run.wear_u95_um), run.wear_basis),
    "sites": lambda run: str(run.sites or "–"),
    "machining": lambda run: duration(run.machining_time_s),
    "seed": lambda run: ("–" if run.seed is None else str(run.seed)) if run.simulated else "real",
    "size": lambda run: file_size(run.size_bytes),
}


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
    fits = columns is None or all(width_of(table) <= columns for table in [settings, *beside])
    if len(comparison.runs) > MOST_BESIDE or not fits:
        blocks += _row_a_run(comparison, style, min(columns or ROW_COLUMNS, ROW_COLUMNS))
    else:
        letters = list(settings)[1:]
        blocks.append(render_table(settings, style) if comparison.differs else _nothing_differs(letters))
        blocks += [render_table(table, style) for table in beside]
    blocks.append(_reading(comparison))
    return "\n\n".join(block for block in blocks if block)


def _row_a_run(comparison: Comparison, style: Style, columns: int) -> list[str]:
    """Tables with a row for each run, as many as fit their columns."""
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


def _settings(comparison: Comparison, columns: int | None) -> Mapping[str, Sequence[str]]:
    names = [named_with_unit(setting.key, setting.units) for setting in comparison.differs]
    most = MOST_LETTERS
    if columns is not None:
        for_each = (columns - max(map(len, names), default=0)) // len(comparison.runs)
        most = min(MOST_LETTERS, max(LEAST_LETTERS, for_each - 3))
    table = {"what differs": names}
    for number in range(len(comparison.runs)):
        table[letter(number)] = [_short(setting.values[number], most) for setting in comparison.differs]
    return table


def _quantities(quantities: Sequence[Quantity], heading: str) -> Mapping[str, Sequence[str]]:
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


_TRUE_NAMES = {"depth_um": "true depth, µm", "wear_um": "true wear, µm"}
_NAMES = {
    "depth_um": "depth, µm",
    "wear_um": "tool wear, µm",
    "machining_time_s": "machining time, s",
    "time_s": "whole job, s",
    "mrr_mm3_min": "10⁻³ mm³/min",
    "wear_ratio_lin": "wear per depth",
    "arc_share": "arcs, %",
    "depth_error_um": "depth error, µm",
    "wear_error_um": "wear error, µm",
}
_SCALES = {"mrr_mm3_min": 1e3, "arc_share": 100.0}
"""What a quantity is multiplied by in its unit of the table."""
_SHOWN_WHERE_THERE = ("mrr_mm3_min", "wear_ratio_lin", "arc_share")
CASES_FIRST_TO_GO = ("arcs, %", "true wear, µm", "true depth, µm", "wear per depth", "failed")
"""Columns of several cases that a narrow terminal does without, one after the other."""


def render_cases(cases: Sequence[Case], style: Style = PLAIN) -> str:
    """Render one case in full; of several, one line each."""
    return _render_case(cases[0], style) if len(cases) == 1 else _render_overview(cases, style)


def _render_case(case: Case, style: Style) -> str:
    header = [f"{case.label}, {plural(len(case.runs), 'run')}", "mean", "sd", "min", "max"]
    rows = [
        [names[key], *(decimal(_SCALES.get(key, 1.0) * v) for v in (s.mean, s.sd, s.minimum, s.maximum))]
        for names, statistics in (
            (_TRUE_NAMES, case.truth),
            (_NAMES, case.spreads),
            (_of_basis("by model"), case.by_model),
            (_of_basis("estimated"), case.estimated),
        )
        for key, s in statistics.items()
    ]
    lines = [render_columns(header, rows, style)]
    if case.coverage:
        shares = " and ".join(f"{percent(share, 0)} of the {name}s" for name, share in case.coverage.items())
        lines.append(f"The 95 % intervals held {shares}.")
    if case.failed:
        lines.append(f"{case.failed} of {plural(len(case.runs), 'run')} failed.")
    return "\n".join(lines)


def _of_basis(basis: str) -> dict[str, str]:
    return {key: name.replace(",", f" {basis},") for key, name in _NAMES.items()}


def _render_overview(cases: Sequence[Case], style: Style) -> str:
    table = {"mean ± sd": [case.label for case in cases]}
    table |= {name: [_mean_sd(case.truth.get(key)) for case in cases] for key, name in _TRUE_NAMES.items()}
    for key in ("depth_error_um", "machining_time_s", "mrr_mm3_min", "wear_ratio_lin", "arc_share"):
        if key in _SHOWN_WHERE_THERE and not any(key in case.spreads for case in cases):
            continue
        scale = _SCALES.get(key, 1.0)
        table[_NAMES[key]] = [_mean_sd(case.spreads.get(key), scale) for case in cases]
    table["failed"] = [f"{case.failed} of {len(case.runs)}" for case in cases]
    shown = narrowed(table, style.columns, CASES_FIRST_TO_GO)
    left_out = wrapped(not_shown(table, shown), style.columns)
    return "\n".join(filter(None, [render_table(shown, style), *left_out]))


def _mean_sd(found: Statistics | None, scale: float = 1.0) -> str:
    if found is None:
        return "–"
    mean, sd = scale * found.mean, scale * found.sd
    return f"{decimal(mean)} ± {decimal(sd)}" if math.isfinite(sd) else decimal(mean)
