"""Tables of many runs: the runs of a folder, a comparison, and the statistics of simulated ones."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from string import ascii_uppercase

from edmctl.cli.render.terminal import (
    PLAIN,
    Ink,
    Style,
    narrowed,
    not_shown,
    render_columns,
    render_table,
    width_of,
    wrapped,
)
from edmctl.labels import Basis, marked, meanings
from edmctl.results.job import Case, Statistics
from edmctl.results.run_file import Comparison, Quantity, RunHead, Unreadable
from edmctl.wording import (
    UNKNOWN,
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
    signed,
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
    rows = [_head_cells(run, heirs) if isinstance(run, RunHead) else _unreadable_cells(run) for run in runs]
    names = list(_head_cells(heads[0], heirs)) if heads else list(rows[0])
    table = {name: [row.get(name, "") for row in rows] for name in names}
    shown = narrowed(table, columns, FIRST_TO_GO)
    if columns is not None and width_of(shown) > columns:
        shown["status"] = [
            f"exit {run.exit_code}" if isinstance(run, RunHead) and run.exit_code else status
            for run, status in zip(runs, table["status"], strict=True)
        ]
    bases = {basis for run in heads for basis in (run.depth_basis, run.wear_basis)}
    if any(_is_left(run) for run in heads):
        bases.add(Basis.ESTIMATED)
    notes = [
        *meanings(bases),
        "Depth and wear of several sites are their means." if any(run.sites > 1 for run in heads) else "",
        not_shown(table, shown),
    ]
    lines = [line for note in notes if note for line in wrapped(note, columns)]
    wrong = [escaped(run.error.message) for run in runs if isinstance(run, Unreadable)]
    text = render_table(shown, style, left=_WORDS, cut_first="run")
    return "\n\n".join(filter(None, [text, style.paint("\n".join(lines), Ink.FAINT), "\n".join(wrong)]))


def _head_cells(run: RunHead, heirs: Mapping[str, str]) -> dict[str, str]:
    status = printable(ended_as(run.status, run.error_code))
    if run.exit_code:
        status += f" ({run.exit_code})"
    seed = "–" if run.seed is None else str(run.seed)
    return {
        "run": _name(run),
        "start (UTC)": start_utc(run.start_time),
        "status": heirs.get(run.run_id, status),
        "profile": printable(run.name),
        "work, tool": printable(f"{run.work}, {run.tool}"),
        "depth µm": _depth(run),
        "wear µm": marked(with_u95(run.wear_um, run.wear_u95_um), run.wear_basis),
        "sites": str(run.sites or "–"),
        "machining": duration(run.machining_time_s),
        "seed": seed if run.simulated else "real",
        "size": file_size(run.size_bytes),
    }


def _unreadable_cells(run: Unreadable) -> dict[str, str]:
    return {
        "run": _name(run),
        "start (UTC)": start_utc(iso_of(run.changed_s)),
        "status": _UNREADABLE.get(run.error.code, run.error.code),
        "size": file_size(run.size_bytes),
    }


def _name(run: RunHead | Unreadable) -> str:
    return escaped(run.path.name.removesuffix(".h5"))


def _is_left(run: RunHead) -> bool:
    """Whether the depth is an estimate of a hole that was not finished."""
    return math.isfinite(run.est_depth_um) and not math.isfinite(run.depth_um)


def _depth(run: RunHead) -> str:
    if _is_left(run):
        return marked(decimal(run.est_depth_um, 1), Basis.ESTIMATED)
    if run.through and run.through == run.sites:
        return "through"
    return marked(with_u95(run.depth_um, run.depth_u95_um), run.depth_basis)


MOST_LETTERS = 30
"""A longer value is cut off."""
_TO_THE_MINUTE = 16


def letter(number: int) -> str:
    """Return the name of a run in the table: A, B … Z, A2 …"""
    turn, index = divmod(number, len(ascii_uppercase))
    return f"{ascii_uppercase[index]}{turn + 1 if turn else ''}"


def render_comparison(comparison: Comparison, style: Style = PLAIN) -> str:
    """Render the runs, what differs, and the quantities: a column for each run and its difference from the first."""
    runs = comparison.runs
    letters = [letter(number) for number in range(len(runs))]
    seeds = ["" if run.seed is None else f", seed {run.seed}" for run in runs]
    about = {
        "": letters,
        "file": [escaped(run.file) for run in runs],
        "started": [run.start[:_TO_THE_MINUTE].replace("T", " ") for run in runs],
        "status": [
            f"{run.status}{', simulated' if run.simulated else ''}{seed}"
            for run, seed in zip(runs, seeds, strict=True)
        ],
    }
    blocks = [render_table(about, style, left=list(about), cut_first="file")]
    if comparison.differs:
        header = ["what differs", *letters]
        rows = [
            [named_with_unit(setting.key, setting.units), *map(_short, setting.values)]
            for setting in comparison.differs
        ]
        blocks.append(render_columns(header, rows, style))
    else:
        blocks.append(f"Nothing was set differently in {', '.join(letters)}.")
    for heading, quantities in (("result", comparison.quantities), ("site", comparison.sites)):
        table = {heading: [quantity.name for quantity in quantities]}
        for number, name in enumerate(letters):
            amounts = [(quantity, quantity.amounts[number]) for quantity in quantities]
            table[name] = [
                marked(_number(quantity, amount.value, amount.u95, decimal), amount.basis)
                for quantity, amount in amounts
            ]
            if number:
                table[f"{name} − A"] = [
                    f"{_number(quantity, amount.difference, amount.difference_u95, signed)}"
                    f"{' *' if amount.beyond else '  '}"
                    for quantity, amount in amounts
                ]
        if quantities:
            blocks.append(render_table(table, style))
    if any(math.isfinite(a.difference_u95) for q in comparison.quantities for a in q.amounts[1:]):
        bases = {a.basis for q in (*comparison.quantities, *comparison.sites) for a in q.amounts}
        reading = [
            "± is half the 95 % interval of a result, of a difference that of both runs together.",
            "* marks a difference from A beyond it. How far repeated runs scatter is not in it.",
            *meanings(bases),
        ]
        blocks.append("\n".join(reading))
    return "\n\n".join(blocks)


def _number(quantity: Quantity, value: float, u95: float, written: Callable[[float, int], str]) -> str:
    def text(value: float, written: Callable[[float, int], str]) -> str:
        number = written(quantity.factor * value, quantity.decimals)
        return number if quantity.decimals else _THOUSANDS.sub(" ", number)

    if not math.isfinite(value):
        return UNKNOWN
    return text(value, written) + (f" ± {text(u95, decimal)}" if math.isfinite(u95) else "")


_THOUSANDS = re.compile(r"(?<=\d)(?=(?:\d{3})+$)")


def _short(text: str) -> str:
    return shortened(escaped(text) or UNKNOWN, MOST_LETTERS)


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
    return "\n".join(filter(None, [render_table(shown, style), not_shown(table, shown)]))


def _mean_sd(found: Statistics | None, scale: float = 1.0) -> str:
    if found is None:
        return "–"
    mean, sd = scale * found.mean, scale * found.sd
    return f"{decimal(mean)} ± {decimal(sd)}" if math.isfinite(sd) else decimal(mean)
