"""Energies of single discharges as a histogram, or the means of blocks of pulses where single ones were not kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from edmctl.record import layout
from edmctl.report.pulse_counts import (
    ARC,
    NORMAL,
    SHORT,
    current_a,
    has_every_pulse,
    pulse_blocks,
    rows_at,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from edmctl.record.reader import RunFile

    Array = NDArray[np.float64]

FINE = 4096
"""Bins that are counted; `SHOWN` or more of them are left when the range that is used is known."""
SHOWN = 48


@dataclass(frozen=True, slots=True)
class SparkEnergies:
    """How many discharges had which energy, and what they came to.

    edges_uj : ndarray, shape (n + 1,)
    normal, arc : ndarrays, shape (n,); discharges of a block all stand under `normal`, at their mean
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

    The energy of a single one is plateau voltage × discharge time × the current at that plateau. None where there
    were no discharges.
    """
    is_single = has_every_pulse(run)
    width_uj = _largest_uj(run) / FINE
    counts, sums_uj = (_of_pulses if is_single else _of_blocks)(run, edges_s, width_uj)
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


def _of_pulses(run: RunFile, edges_s: Array, width_uj: float) -> tuple[Array, Array]:
    open_v, siemens = _generator(run)
    counts, sums_uj = np.zeros(4 * FINE), np.zeros(len(edges_s) - 1)
    edges = rows_at(run, edges_s)
    for first, columns in pulse_blocks(run, int(edges[0]), int(edges[-1]), ("pulse_class", "te", "u")):
        kind = columns["pulse_class"] & 3
        plateau_v = columns["u"]
        amps = np.float32(siemens) * np.maximum(np.float32(open_v) - plateau_v, 0.0)
        energy_uj = columns["te"] * plateau_v * amps
        bins = np.minimum(energy_uj * np.float32(1.0 / width_uj), FINE - 1).astype(np.int32)
        counts += np.bincount(FINE * kind.astype(np.int32) + bins, minlength=4 * FINE)
        # An open pulse has no discharge time, so its product is 0 already.
        energy_uj *= kind != SHORT
        starts = np.clip(edges - first, 0, len(kind))
        filled = np.diff(starts) > 0
        sums_uj[filled] += np.add.reduceat(energy_uj, starts[:-1][filled], dtype=np.float64)
    return counts.reshape(4, FINE)[[NORMAL, ARC]], sums_uj


def _of_blocks(run: RunFile, edges_s: Array, width_uj: float) -> tuple[Array, Array]:
    counts, sums_uj = np.zeros((2, FINE)), np.zeros(len(edges_s) - 1)
    for block in run.blocks(layout.PULSE_BLOCKS.path, ("time", "n_normal", "n_arc", "sum_energy")):
        sparks = block["n_normal"].astype(np.float64) + block["n_arc"].astype(np.float64)
        interval = np.searchsorted(edges_s, block["time"], side="right") - 1
        used = (interval >= 0) & (interval < len(sums_uj)) & (sparks > 0)
        energy_uj = block["sum_energy"][used].astype(np.float64)
        bins = np.minimum(energy_uj / sparks[used] / width_uj, FINE - 1).astype(np.int64)
        counts[0] += np.bincount(bins, sparks[used], minlength=FINE)
        sums_uj += np.bincount(interval[used], energy_uj, minlength=len(sums_uj))
    return counts, sums_uj


def _largest_uj(run: RunFile) -> float:
    """The most that a discharge of these settings can have: all through the on-time at half the open voltage."""
    values = run.profile_values()
    open_v, siemens = _generator(run)
    duty, hz = (float(values[f"pulse.{name}"]) for name in ("duty", "frequency_hz"))
    return 1.001 * 0.25 * open_v**2 * siemens * duty / hz * 1e6


def _generator(run: RunFile) -> tuple[float, float]:
    """Open voltage, and the conductance of the resistor that makes the current: an arc's plateau lets more through.

    The current of the profile is that at the plateau of a normal discharge.
    """
    values = run.profile_values()
    open_v, plateau_v = (float(values[f"pulse.{name}"]) for name in ("open_voltage_v", "discharge_voltage_v"))
    return open_v, current_a(run) / max(open_v - plateau_v, 0.1)
