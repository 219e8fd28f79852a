"""Stop operators in parallel: springs that slip, all stretched by the same position.

A stop of limit d follows every change of the position and stays within ±d: s ← clip(s + change, −d, +d). With
stiffnesses k_i and a spring k_0 that never slips, the load is k_0 · position + Σ k_i s_i. This is the
elasto-slip hysteresis of Goldfarb & Celanovic, IEEE Control Systems 17(3), 1997, in whatever quantities: here
displacement to voltage (`maxwell`) and charge to voltage (`electromechanical`).

Everything is compiled by numba, without fastmath: the source is the definition. Arrays: stiffness, limits and
the state stops, shape (n,).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from edmctl.actuator.compiling import cached, compiled

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array: TypeAlias = NDArray[np.float64]


@compiled
def stop(limit: float, stretched: float) -> float:
    """One stop that would be at `stretched` if it did not slip."""
    return min(max(stretched, -limit), limit)


@compiled
def move(limits: Array, stops: Array, change: float) -> None:
    """Advance the state by a change of the position, monotone and of any size."""
    for i in range(limits.shape[0]):
        stops[i] = stop(limits[i], stops[i] + change)


@compiled
def change_for(base: float, stiffness: Array, limits: Array, stops: Array, added: float) -> float:
    """Change of the position that adds `added` to the load; the state stays.

    On the way more and more stops slip and none sticks again, so the load is concave in the change upwards
    and convex downwards: Newton's method from the present state approaches from one side and ends exactly,
    after as many steps as there are sets of slipping stops in between.
    """
    up = added > 0.0
    change = 0.0
    for _ in range(limits.shape[0] + 2):
        load, slope = base * change, base
        for i in range(limits.shape[0]):
            stretched = stops[i] + change
            load += stiffness[i] * (stop(limits[i], stretched) - stops[i])
            if (stretched < limits[i]) if up else (stretched > -limits[i]):
                slope += stiffness[i]
        further = (added - load) / slope
        if change + further == change:
            break
        change += further
    return change


@cached
def advance_loads(
    positions: Array,
    since: float,
    base: float,
    stiffness: Array,
    limits: Array,
    stops: Array,
    loads: Array,
) -> None:
    """Advance the state over positions (k,), from position `since`; `loads` (k,) receives the load at each."""
    position = since
    for k in range(positions.shape[0]):
        move(limits, stops, positions[k] - position)
        position = positions[k]
        total = base * position
        for i in range(limits.shape[0]):
            total += stiffness[i] * stops[i]
        loads[k] = total


@cached
def advance_positions(
    loads: Array,
    since: float,
    base: float,
    stiffness: Array,
    limits: Array,
    stops: Array,
    positions: Array,
) -> None:
    """Advance the state over loads (k,), from position `since`; `positions` (k,) receives each position."""
    position = since
    for k in range(loads.shape[0]):
        total = base * position
        for i in range(limits.shape[0]):
            total += stiffness[i] * stops[i]
        change = change_for(base, stiffness, limits, stops, loads[k] - total)
        move(limits, stops, change)
        position += change
        positions[k] = position
