"""Seeds of virtual machines; profile values in equal steps or lists, with all combinations."""

from __future__ import annotations

import itertools
import math
import operator
import re
import secrets
from collections.abc import Sequence
from typing import SupportsIndex

from edmctl import failures
from edmctl.dataclasses import replace
from edmctl.errors import Diagnostic
from edmctl.wording import plural

_NEW_SEEDS = 1_000_000_000  # nine digits at most: short enough to read out and type again
_LARGEST = 2**63 - 1  # the run file keeps the seed in 64 bits with a sign
_MOST_VALUES = 1000
MOST_RUNS = 100_000


def simulated_by(seed: int | None) -> str:
    """Return the remark on a simulated result; a served controller's seed is not known here."""
    return "Simulated. " if seed is None else f"Simulated, seed {seed}. "


def seed_to_use(seed: SupportsIndex | None, runs: int = 1) -> int:
    """Return the requested first seed, else a new one, to be printed and recorded.

    Raises UsageError (E2005) if the run file cannot store it, or the last seed of `runs` runs; TypeError if it is
    not a whole number.
    """
    if seed is None:
        return secrets.randbelow(_NEW_SEEDS)
    first, largest = operator.index(seed), _LARGEST - (runs - 1)
    if not 0 <= first <= largest:
        of_runs = f" (of the first of {runs} runs)" if runs > 1 else ""
        raise failures.seed_out_of_range(asked=first, largest=largest, of_runs=of_runs)
    return first


def sweep_overrides(text: str) -> tuple[str, ...]:
    """Return one `KEY=VALUE` per value of `KEY=START:STOP:COUNT`, both ends included, or of a list, `KEY=A,B,C`."""
    key, _, given = text.partition("=")
    parts, problem = given.split(":"), ""
    is_list = len(parts) == 1 and "," in given
    values = [value.strip() for value in given.split(",")]
    if not (re.fullmatch(r"[A-Za-z0-9_.-]+", key) and all(parts) and (is_list or len(parts) == 3)):
        problem = "is neither of the form KEY=START:STOP:COUNT nor a list KEY=A,B,C"
    elif not is_list:
        try:
            values = _steps(*parts)
        except ValueError as error:
            problem = str(error)
    if not problem:
        if not all(values):
            problem = "a value of the list is empty"
        elif len({_number_or_text(value) for value in values}) < len(values):
            problem = "its values must differ"
        elif len(values) > _MOST_VALUES:
            problem = f"a list has at most {_MOST_VALUES} values"
    if problem:
        raise failures.sweep_unreadable(text=text, reason=problem)
    return tuple(f"{key}={value}" for value in values)


def _steps(first: str, last: str, number: str) -> list[str]:
    """Return equal steps; whole ends that are whole steps apart give whole numbers, for keys that take no others."""
    try:
        start, stop, count = float(first), float(last), int(number)
    except ValueError:
        raise ValueError("START and STOP must be numbers and COUNT a whole number") from None
    if not (math.isfinite(start) and math.isfinite(stop) and math.isfinite(stop - start)):
        raise ValueError("START and STOP must be finite")
    if not 2 <= count <= _MOST_VALUES:
        raise ValueError(f"COUNT must be 2 to {_MOST_VALUES}")
    step = (stop - start) / (count - 1)
    is_whole = step.is_integer() and all(re.fullmatch(r"[+-]?\d+", end) for end in (first, last))
    values = [start + index * step for index in range(count)]
    return [str(int(value)) if is_whole else repr(float(f"{value:.12g}")) for value in values]


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def grid_of(sweeps: Sequence[str], runs: int) -> tuple[tuple[str, ...], ...]:
    """Return the `KEY=VALUE` of every combination of the sweeps' values, the first sweep slowest.

    Without a sweep that is one combination of nothing. Raises UsageError E2003.
    """
    steps = [sweep_overrides(text) for text in sweeps]
    keys = [text.partition("=")[0] for text in sweeps]
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise failures.sweep_key_twice(twice=twice[0])
    size = math.prod(map(len, steps))
    if size * runs > MOST_RUNS:
        raise failures.sweep_too_large(
            values=plural(size, "value"),
            runs=plural(runs, "run"),
            size=size * runs,
            most_runs=MOST_RUNS,
            fewer=f"--runs {MOST_RUNS // size} or fewer, or " if size <= MOST_RUNS else "",
        )
    return tuple(itertools.product(*steps))


def at_sweep(diagnostic: Diagnostic, sweeps: Sequence[str]) -> Diagnostic:
    """Return a diagnostic that points at a swept value as one that points at its sweep."""
    where = diagnostic.where
    if where is not None and where.file == "--set":
        for text in sweeps:
            if where.source_line in sweep_overrides(text):
                return replace(diagnostic, where=replace(where, file="--sweep", source_line=text))
    return diagnostic
