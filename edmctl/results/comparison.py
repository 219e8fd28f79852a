"""Runs side by side: what was different about them, and their results."""

from __future__ import annotations

from edmctl.dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ComparedRun:
    """A run of the comparison."""

    file: str
    run_id: str
    title: str
    start: str
    status: str
    simulated: bool
    seed: int | None
    sites: int


@dataclass(frozen=True, slots=True)
class Setting:
    """Something that is not the same in all runs; `values` has one text a run, empty where a run has none."""

    key: str
    units: str
    values: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Amount:
    """A quantity in one run, and against the first run. What is not known is NaN.

    `difference_u95` combines the uncertainties of both; `beyond` says that the difference is larger. `basis` is what
    a depth or wear rests on, empty for all else.
    """

    value: float
    u95: float
    difference: float
    difference_u95: float
    beyond: bool
    basis: str = ""


@dataclass(frozen=True, slots=True)
class Quantity:
    """One quantity in every run, in the unit of `key`; what is shown under `name` is `factor` times that."""

    key: str
    name: str
    decimals: int
    factor: float
    amounts: tuple[Amount, ...]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Several runs; `sites` has the depths and wears of places that all of them have, where there are several."""

    runs: tuple[ComparedRun, ...]
    differs: tuple[Setting, ...]
    quantities: tuple[Quantity, ...]
    sites: tuple[Quantity, ...]
