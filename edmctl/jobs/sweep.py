"""Seeds of the simulator, and profile values in equal steps or lists, with all combinations."""

from __future__ import annotations

import itertools
import math
import operator
import re
import secrets
from collections.abc import Sequence
from typing import SupportsIndex

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, UsageError
from edmctl.wording import plural

# Nine digits at most: short enough to read out and type again.
_NEW_SEEDS = 1_000_000_000
# The run file keeps the seed in 64 bits with a sign.
_LARGEST = 2**63 - 1


def simulated_by(seed: int | None) -> str:
    """Return the remark on a simulated result; a served controller's seed is not known here."""
    return "Simulated. " if seed is None else f"Simulated, seed {seed}. "


def seed_to_use(asked: SupportsIndex | None, runs: int = 1) -> int:
    """Return the requested first seed, else a new one, to be printed and recorded.

    Raises UsageError (E2005) if the run file cannot store it, or the last seed of `runs` runs; TypeError if it is
    not a whole number.
    """
    if asked is None:
        return secrets.randbelow(_NEW_SEEDS)
    asked = operator.index(asked)
    largest = _LARGEST - (runs - 1)
    if not 0 <= asked <= largest:
        of_runs = f" (of the first of {runs} runs)" if runs > 1 else ""
        raise failures.seed_out_of_range(asked=asked, largest=largest, of_runs=of_runs)
    return asked


_KEY = re.compile(r"[A-Za-z0-9_.-]+")
_MOST = 1000


@dataclass(frozen=True, slots=True)
class Sweep:
    """A key and its values, as `--set` takes them."""

    key: str
    values: tuple[str, ...]

    def overrides(self) -> tuple[str, ...]:
        """Return one `KEY=VALUE` per value."""
        return tuple(f"{self.key}={value}" for value in self.values)


def parse_sweep(text: str) -> Sweep:
    """Parse `KEY=START:STOP:COUNT`, both ends included, or a list, `KEY=A,B,C`. Raises UsageError (E2003)."""
    key, _, given = text.partition("=")
    parts = given.split(":")
    is_list = len(parts) == 1 and "," in given
    if not (_KEY.fullmatch(key) and all(parts) and (is_list or len(parts) == 3)):
        raise _refused(text, "is neither of the form KEY=START:STOP:COUNT nor a list KEY=A,B,C")
    values = [value.strip() for value in given.split(",")] if is_list else _steps(text, *parts)
    if not all(values):
        raise _refused(text, "a value of the list is empty")
    if len({_plain_value(value) for value in values}) < len(values):
        raise _refused(text, "its values must differ")
    if len(values) > _MOST:
        raise _refused(text, f"a list has at most {_MOST} values")
    return Sweep(key, tuple(values))


def _steps(text: str, first: str, last: str, number: str) -> list[str]:
    """Return equal steps; whole ends that are whole steps apart give whole numbers, for keys that take no others."""
    try:
        start, stop, count = float(first), float(last), int(number)
    except ValueError:
        raise _refused(text, "START and STOP must be numbers and COUNT a whole number") from None
    if not (math.isfinite(start) and math.isfinite(stop) and math.isfinite(stop - start)):
        raise _refused(text, "START and STOP must be finite")
    if not 2 <= count <= _MOST:
        raise _refused(text, f"COUNT must be 2 to {_MOST}")
    step = (stop - start) / (count - 1)
    is_whole = step.is_integer() and all(re.fullmatch(r"[+-]?\d+", end) for end in (first, last))
    values = [start + index * step for index in range(count)]
    return [str(int(value)) if is_whole else repr(float(f"{value:.12g}")) for value in values]


def _plain_value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


MOST_RUNS = 100_000


def grid_of(sweeps: Sequence[str], runs: int) -> tuple[tuple[str, ...], ...]:
    """Return the `KEY=VALUE` of every combination of the sweeps' values, the first sweep slowest.

    Without a sweep that is one combination of nothing. Raises UsageError E2003.
    """
    found = [parse_sweep(text) for text in sweeps]
    keys = [sweep.key for sweep in found]
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise failures.sweep_key_twice(twice=twice[0])
    size = math.prod(len(sweep.values) for sweep in found)
    if size * runs > MOST_RUNS:
        fewer = f"--runs {MOST_RUNS // size} or fewer, or " if size <= MOST_RUNS else ""
        raise failures.sweep_too_large(
            values=plural(size, "value"),
            runs=plural(runs, "run"),
            size=size * runs,
            most_runs=MOST_RUNS,
            fewer=fewer,
        )
    return tuple(itertools.product(*(sweep.overrides() for sweep in found)))


def of_sweep(diagnostic: Diagnostic, sweeps: Sequence[str]) -> Diagnostic:
    """Return a diagnostic that points at a swept value as one that points at its sweep."""
    where = diagnostic.where
    if where is not None and where.file == "--set":
        for text in sweeps:
            if where.source_line in parse_sweep(text).overrides():
                return replace(diagnostic, where=replace(where, file="--sweep", source_line=text))
    return diagnostic


def _refused(text: str, reason: str) -> UsageError:
    return failures.sweep_unreadable(text=text, reason=reason)
