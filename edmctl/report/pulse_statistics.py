"""Statistics of the pulses of a run: counts by class and time, ignition delays, discharge energies.

A working day has 66 million pulses. They are read part by part, in constant memory; the interval of each pulse
follows from the segments of constant period, without the time of a single one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edmctl.array_types import Array, Integers
from edmctl.dataclasses import dataclass
from edmctl.quantity import half_width
from edmctl.record import layout
from edmctl.record.reader import RunFile
from edmctl.report.panels import NothingToDraw
from edmctl.report.signals import cuts_s
from edmctl.results.telemetry import PULSE_CLASSES

OPEN, NORMAL, ARC, SHORT = range(4)
"""Numbers of the classes, in the order of `PULSE_CLASSES`."""
READ_ROWS = 1 << 20
_BLOCK_COUNTS = tuple(f"n_{name}" for name in PULSE_CLASSES)
STEP_US = 0.1
"""Resolution of a stored ignition delay."""
_STEPS = 1 << 16
_LAG_SHARE = 0.001
"""Share of the delays before which ignition counts as not begun: the time that a breakdown takes to form."""
FINE = 4096
"""Bins of energy that are counted; they are merged to `SHOWN` or more over the range that is used."""
SHOWN = 48


def has_every_pulse(run: RunFile) -> bool:
    return run.rows(layout.PULSES.path) > 0


def cuts_with_pulses(run: RunFile) -> Array:
    """Return begin and end of each interval of cutting, shape (n, 2), s. Raises NothingToDraw without pulses."""
    cuts = cuts_s(run)
    if not len(cuts) or not (has_every_pulse(run) or run.rows(layout.PULSE_BLOCKS.path)):
        raise NothingToDraw(
            "No pulses were recorded while cutting: the run ended before its first cut, "
            'or its profile has log.pulses = "off".'
        )
    return cuts


def pulse_counts(run: RunFile, edges_s: Array) -> Integers:
    """Count the pulses of each class between `edges_s`, shape (n + 1,), which rise; shape (n, 4)."""
    intervals = len(edges_s) - 1
    counts = np.zeros((intervals, 4), np.int64)
    if has_every_pulse(run):
        for interval, columns in _by_interval(run, edges_s, ("pulse_class",)):
            cells = 4 * interval + (columns["pulse_class"] & 3)
            counts += np.bincount(cells, minlength=counts.size).reshape(-1, 4)
        return counts
    for interval, columns in _by_interval(run, edges_s, _BLOCK_COUNTS):
        for k, name in enumerate(_BLOCK_COUNTS):
            counts[:, k] += np.bincount(interval, columns[name], minlength=intervals).astype(np.int64)
    return counts


def rows_at(run: RunFile, times_s: Array) -> NDArray[np.int64]:
    """Return the first row of `/entry/pulses/full` that is not before each of the times, which rise."""
    segments = run.columns(layout.SEGMENTS.path)
    first_row = segments["first_row"].astype(np.int64)
    start_s, period_s = segments["t0"].astype(np.float64), segments["period"].astype(np.float64)
    stop_row = np.append(first_row[1:], run.rows(layout.PULSES.path))
    of = np.maximum(np.searchsorted(start_s, times_s, side="right") - 1, 0)
    pulses = np.ceil((times_s - start_s[of]) / period_s[of] - 1e-6)
    rows = first_row[of] + np.maximum(pulses, 0.0).astype(np.int64)
    kept: NDArray[np.int64] = np.minimum(rows, stop_row[of])
    return kept


def _pulses(
    run: RunFile, first: int, stop: int, names: Sequence[str]
) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
    """Yield the number of the first row, and columns of `/entry/pulses/full`, part by part."""
    for start in range(first, stop, READ_ROWS):
        end = min(start + READ_ROWS, stop)
        yield start, {name: run.column(layout.PULSES.path, name, start, end) for name in names}


def _by_interval(
    run: RunFile, edges_s: Array, names: Sequence[str]
) -> Iterator[tuple[Integers, dict[str, NDArray[Any]]]]:
    """Yield columns of single pulses, or of blocks of them, between edges, and the interval of each row."""
    intervals = len(edges_s) - 1
    if has_every_pulse(run):
        edges = rows_at(run, edges_s)
        for first, columns in _pulses(run, int(edges[0]), int(edges[-1]), names):
            ends = np.clip(edges, first, first + len(columns[names[0]]))
            yield np.repeat(np.arange(intervals, dtype=np.int32), np.diff(ends)), columns
        return
    for block in run.blocks(layout.PULSE_BLOCKS.path, ("time", *names)):
        interval = np.searchsorted(edges_s, block["time"], side="right") - 1
        inside = (interval >= 0) & (interval < intervals)
        yield interval[inside], {name: block[name][inside].astype(np.float64) for name in names}


@dataclass(frozen=True, slots=True)
class Delays:
    """Pulses by their delay, in steps of 0.1 µs.

    ignited : ndarray, shape (n,), normal discharges after that delay
    censored : ndarray, shape (n,), pulses that had not ignited after an on-time of that length
    """

    ignited: Integers
    censored: Integers

    @property
    def at_risk(self) -> Integers:
        """Pulses without a spark before each delay, shape (n,)."""
        counts: Integers = np.cumsum((self.ignited + self.censored)[::-1])[::-1]
        return counts

    @property
    def surviving(self) -> Array:
        """Share of pulses without a spark after each delay, shape (n,), by Kaplan and Meier."""
        at_risk = self.at_risk
        with np.errstate(invalid="ignore", divide="ignore"):
            steps: Array = np.where(at_risk > 0, 1.0 - self.ignited / at_risk, np.nan)
        return steps.cumprod()


@dataclass(frozen=True, slots=True)
class RandomIgnition:
    """The exponential law by maximum likelihood, open pulses counted as not yet ignited.

    Survivors follow exp(-(t - lag) / mean) after the lag; `mean_u95_us` is half the 95 % interval of the mean, and
    `ignited` and `censored` are the numbers of pulses in it.
    """

    lag_us: float
    mean_us: float
    mean_u95_us: float
    ignited: int
    censored: int


def delays(run: RunFile, cuts_s: Array) -> Delays:
    """Count normal discharges and open pulses by their delay, in cuts, shape (n, 2): approaches have long delays."""
    counts = np.zeros((2, _STEPS), np.int64)
    for first, stop in rows_at(run, cuts_s.ravel()).reshape(-1, 2).tolist():
        for _, columns in _pulses(run, first, stop, ("pulse_class", "td")):
            kind = columns["pulse_class"]
            rounded = np.rint(columns["td"] / np.float32(STEP_US)).astype(np.int32)
            for k, wanted in enumerate((NORMAL, OPEN)):
                counts[k] += np.bincount(rounded[kind == wanted], minlength=_STEPS)
    used = np.flatnonzero(counts.any(axis=0))
    end = int(used[-1]) + 1 if len(used) else 0
    return Delays(counts[0, :end], counts[1, :end])


def random_ignition(counted: Delays) -> RandomIgnition | None:
    """Fit random ignition; None if fewer than two pulses ignited after the lag."""
    total = int(counted.ignited.sum())
    lag = int(np.searchsorted(np.cumsum(counted.ignited), max(1.0, _LAG_SHARE * total)))
    after = np.arange(len(counted.ignited)) - lag
    later = after > 0
    ignited, censored = int(counted.ignited[later].sum()), int(counted.censored[later].sum())
    if ignited < 2:
        return None
    waited_us = STEP_US * float(((counted.ignited + counted.censored) * after)[later].sum())
    mean_us = waited_us / ignited
    return RandomIgnition(STEP_US * lag, mean_us, half_width(mean_us / math.sqrt(ignited)), ignited, censored)


@dataclass(frozen=True, slots=True)
class SparkEnergies:
    """Numbers of discharges by their energy, and their sums.

    edges_uj : ndarray, shape (n + 1,)
    normal, arc : ndarrays, shape (n,); all discharges of a block count as `normal`, with their mean energy
    sums_uj : ndarray, shape (m,), energy of all discharges in each interval of time
    is_single : whether single discharges were counted
    """

    edges_uj: Array
    normal: Array
    arc: Array
    sums_uj: Array
    is_single: bool


def spark_energies(run: RunFile, edges_s: Array) -> SparkEnergies | None:
    """Count normal discharges and arcs by their energy, and sum it up between `edges_s`, shape (m + 1,), which rise.

    The energy of a single one is plateau voltage × discharge time × the current at that plateau. None without
    discharges.
    """
    values = run.profile_values()
    regimes: list[dict[str, float]] = json.loads(str(values.get("regimes", "[]")))
    # The current of a single discharge follows from the profile's, which changes from regime to regime.
    is_single = has_every_pulse(run) and not regimes
    open_v, plateau_v, current_a, duty, frequency_hz = (
        float(values[f"pulse.{name}"])
        for name in ("open_voltage_v", "discharge_voltage_v", "current_a", "duty", "frequency_hz")
    )
    # Of the resistor that makes the current: an arc's plateau lets more through.
    siemens = current_a / max(open_v - plateau_v, 0.1)
    charges = [one["current_a"] * one["duty"] / one["frequency_hz"] for one in regimes]
    charges = charges or [current_a * duty / frequency_hz]
    # The largest energy is all through the on-time at half the open voltage.
    largest_uj = 1.001 * 0.25 * open_v**2 * siemens / current_a * max(charges) * 1e6
    width_uj = largest_uj / FINE
    if is_single:
        counts, sums_uj = _sum_pulses(run, edges_s, width_uj, open_v, siemens)
    else:
        counts, sums_uj = _sum_blocks(run, edges_s, width_uj)
    used = np.flatnonzero(counts.any(axis=0))
    if not len(used):
        return None
    merged = -(-int(used[-1] + 1) // SHOWN)
    bins = -(-int(used[-1] + 1) // merged)
    padded = np.zeros((2, bins * merged))
    kept = counts[:, : bins * merged]
    padded[:, : kept.shape[1]] = kept
    normal, arc = padded.reshape(2, bins, merged).sum(axis=2)
    edges_uj = width_uj * merged * np.arange(bins + 1.0)
    return SparkEnergies(edges_uj, normal, arc, sums_uj, is_single)


def _sum_pulses(
    run: RunFile, edges_s: Array, width_uj: float, open_v: float, siemens: float
) -> tuple[Array, Array]:
    counts, sums_uj = np.zeros(4 * FINE), np.zeros(len(edges_s) - 1)
    for interval, columns in _by_interval(run, edges_s, ("pulse_class", "te", "u")):
        kind, plateau_v = columns["pulse_class"] & 3, columns["u"]
        amps = np.float32(siemens) * np.maximum(np.float32(open_v) - plateau_v, 0.0)
        energy_uj = columns["te"] * plateau_v * amps
        bins = np.minimum(energy_uj * np.float32(1.0 / width_uj), FINE - 1).astype(np.int32)
        counts += np.bincount(FINE * kind.astype(np.int32) + bins, minlength=4 * FINE)
        # An open pulse has no discharge time, so its product is 0 already.
        sums_uj += np.bincount(interval, energy_uj * (kind != SHORT), minlength=len(sums_uj))
    return counts.reshape(4, FINE)[[NORMAL, ARC]], sums_uj


def _sum_blocks(run: RunFile, edges_s: Array, width_uj: float) -> tuple[Array, Array]:
    counts, sums_uj = np.zeros((2, FINE)), np.zeros(len(edges_s) - 1)
    for interval, columns in _by_interval(run, edges_s, ("n_normal", "n_arc", "sum_energy")):
        sparks, energy_uj = columns["n_normal"] + columns["n_arc"], columns["sum_energy"]
        used = sparks > 0
        bins = np.minimum(energy_uj[used] / sparks[used] / width_uj, FINE - 1).astype(np.int64)
        counts[0] += np.bincount(bins, sparks[used], minlength=FINE)
        sums_uj += np.bincount(interval[used], energy_uj[used], minlength=len(sums_uj))
    return counts, sums_uj
