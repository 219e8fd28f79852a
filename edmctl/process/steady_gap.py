"""The mean state of the gap under the servo: width, debris, arcs, removal and wear.

The mean gap voltage fixes the ignition delay, whatever the gap (`process.erosion`). Removal fills the gap with
debris until as much is flushed out; debris reduces removal and turns discharges into arcs. The gap follows from the
delay and the debris. The laws are those of the virtual machine, averaged over its pulses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import mul

from edmctl.dataclasses import astuple, dataclass
from edmctl.process.erosion import (
    ARC_V,
    BRIDGE_CLEAR,
    CLEARING,
    GAP_LAW,
    LAW,
    MOST_DEBRIS,
    SHORT_V,
    USUAL_OPEN_V,
    crater_scale,
    deionisation_us,
    delay_over_on_time,
    flush_time_s,
    molten_uj,
    pulse_energy_uj,
    removal_um3_per_uj,
    tool_area_um2,
    working_gap_um,
)

_STEPS = 24
_DELAYS = [(i + 0.5) / _STEPS for i in range(_STEPS)]
_ROUNDS, _TRIES, _ARC_ROUNDS = 12, 60, 4
_DAMPING, _STEEPEST = 0.7, 3.0
_CLOSE_LEVEL, _CLOSE_DEBRIS, _NEAR_DEBRIS = 1e-6, 1e-6, 0.02
MOST_LEVEL = 0.99
"""A gap so dirty that nothing in between keeps the servo's level has pulses that ignite as rarely as this."""


@dataclass(frozen=True, slots=True)
class GapRecipe:
    """What the gap depends on: the pulses, the servo's level, the pair of materials and the tool.

    work_removal, tool_wear : erosion over that of copper
    longest_us : the longest that a discharge burns
    flush_time_s : clearance of a shallow working gap under a tool of 270 µm
    jump_clearing_hz : how often jumps change the oil
    """

    on_time_us: float
    off_time_us: float
    open_voltage_v: float
    current_a: float
    level_s: float
    diameter_um: float
    discharge_voltage_v: float = 22.0
    longest_us: float = math.inf
    tool_negative: bool = True
    work_removal: float = 1.0
    tool_wear: float = 1.0
    flush_time_s: float = GAP_LAW.flush_time_s
    jump_clearing_hz: float = 0.0

    @property
    def rho(self) -> float:
        """Servo level while every pulse ignites at once."""
        return self.discharge_voltage_v / self.open_voltage_v

    @property
    def longest_share(self) -> float:
        """Longest share of the on-time that a discharge burns."""
        return min(1.0, self.longest_us / self.on_time_us)

    @property
    def full_pulse_uj(self) -> float:
        """Energy of a pulse that ignites at once."""
        longest_us = self.on_time_us * self.longest_share
        return pulse_energy_uj(self.discharge_voltage_v, self.current_a, longest_us)


@dataclass(frozen=True, slots=True)
class SteadyGap:
    """The state that a recipe comes to: rates while sparking, and shares of all pulses.

    `side_share` of the discharges burn at the wall; the volumes include them.
    """

    gap_um: float
    debris: float
    spark_share: float
    arc_share: float
    short_share: float
    side_share: float
    removal_um3_s: float
    wear_um3_s: float
    power_uj_s: float  # mean current by the plateau of a normal discharge
    crater_um3: float

    @property
    def removal_um3_per_uj(self) -> float:
        """Work removed per energy."""
        return self.removal_um3_s / self.power_uj_s

    @property
    def wear_ratio(self) -> float:
        """Volume of the tool lost per volume of work."""
        return self.wear_um3_s / self.removal_um3_s


@dataclass(frozen=True, slots=True)
class _Kind:
    """Discharges of one kind on average: level of their pulse, energy, work and tool removed in clean oil."""

    level_s: float
    energy_uj: float
    work_um3: float
    tool_um3: float


@dataclass(frozen=True, slots=True)
class _Pulses:
    """What the ignition delays come to, which the servo's level sets.

    All discharges on average; those that ignite soon, which are the ones that turn into arcs; and arcs.
    """

    tau_us: float
    sparks: float  # share of the pulses that ignite
    soon_share: float  # of the discharges: as their delay has them turn into arcs
    every: _Kind
    soon: _Kind
    arc: _Kind
    crater_um3: float  # volume-weighted mean


@lru_cache(maxsize=256)
def steady_gap(recipe: GapRecipe, depth_um: float) -> SteadyGap:
    """Solve for the debris at which as much is flushed out as comes in, at the bottom of a hole of this depth.

    Arcs have no delay and a lower plateau, bridges hardly any voltage: what they take off the servo's level, later
    pulses make up.
    """
    least = recipe.rho * recipe.longest_share
    level, step, left = recipe.level_s, 0.0, 0.0
    near: _Dirt | None = None
    for _ in range(_ROUNDS):
        pulses = _pulses(recipe, min(max(level, least + 1e-3), MOST_LEVEL))
        near = dirt = _balance(recipe, pulses, depth_um, near)
        missing = (1.0 - dirt.shorts) * pulses.sparks * dirt.arcs * (pulses.soon.level_s - pulses.arc.level_s)
        missing += dirt.shorts * (level - SHORT_V / recipe.open_voltage_v)
        before, left = left, recipe.level_s + missing - level
        # A secant where the last step has brought it nearer, else damped.
        slope = (before - left) / step if step else 0.0
        step = left / slope if 1.0 / _STEEPEST < slope < _STEEPEST else _DAMPING * left
        if abs(step) < _CLOSE_LEVEL:
            break
        level += step
    per_s = (1.0 - dirt.shorts) * 1e6 / (recipe.on_time_us + recipe.off_time_us)
    work_um3, tool_um3 = _volumes_um3(pulses, dirt.debris, dirt.arcs)
    surplus_uj = dirt.arcs * (pulses.arc.energy_uj - pulses.soon.energy_uj)
    sparks = (1.0 - dirt.shorts) * pulses.sparks
    return SteadyGap(
        gap_um=_gap_um(recipe, pulses, dirt.debris),
        debris=dirt.debris,
        spark_share=sparks,
        arc_share=sparks * dirt.arcs,
        short_share=dirt.shorts,
        side_share=GAP_LAW.side_base + GAP_LAW.side_debris * dirt.debris * min(1.0, depth_um / 100.0),
        removal_um3_s=work_um3 * per_s,
        wear_um3_s=tool_um3 * per_s,
        power_uj_s=pulses.sparks * (pulses.every.energy_uj + surplus_uj) * per_s,
        crater_um3=pulses.crater_um3 * _left(dirt.debris),
    )


def _pulses(recipe: GapRecipe, level_s: float) -> _Pulses:
    tau = delay_over_on_time(level_s, recipe.rho, recipe.longest_share)
    at_once, kinds = _discharges(recipe)
    weights = [math.exp(-delay / tau) for delay in _DELAYS]
    fades = [math.exp(-recipe.on_time_us * delay / GAP_LAW.arc_delay_us) for delay in _DELAYS]
    soon = list(map(mul, weights, fades))
    every = _mean(kinds, weights)
    volumes = list(map(mul, weights, kinds[2]))
    # An arc's plateau is lower, its current higher; the energy is calculated as if all burned at the usual plateau.
    current = (recipe.open_voltage_v - ARC_V) / (recipe.open_voltage_v - recipe.discharge_voltage_v)
    volume = current * (ARC_V / recipe.discharge_voltage_v) ** 2
    return _Pulses(
        tau_us=tau * recipe.on_time_us,
        sparks=-math.expm1(-1.0 / tau),
        soon_share=sum(soon) / sum(weights),
        every=every,
        soon=_mean(kinds, soon),
        arc=_Kind(
            ARC_V / recipe.open_voltage_v * recipe.longest_share,
            current * at_once.energy_uj,
            volume * GAP_LAW.arc_work * at_once.work_um3,
            volume * GAP_LAW.arc_tool * at_once.tool_um3,
        ),
        crater_um3=_mean(kinds, volumes).work_um3 if sum(volumes) > 0.0 else 0.0,
    )


@lru_cache(maxsize=16)
def _discharges(recipe: GapRecipe) -> tuple[_Kind, tuple[tuple[float, ...], ...]]:
    """A discharge without delay, and those of equal steps of the delay, each quantity of `_Kind` in a row."""
    kinds = (astuple(_normal(recipe, delay)) for delay in _DELAYS)
    return _normal(recipe, 0.0), tuple(zip(*kinds, strict=True))


def _normal(recipe: GapRecipe, delay: float) -> _Kind:
    """Return a discharge that ignites after this share of the on-time."""
    share = min(1.0 - delay, recipe.longest_share)
    burning_us, current_a, negative = recipe.on_time_us * share, recipe.current_a, recipe.tool_negative
    energy_uj = pulse_energy_uj(recipe.discharge_voltage_v, current_a, burning_us)
    molten = molten_uj(LAW, energy_uj)
    work, tool = removal_um3_per_uj(LAW, burning_us, current_a, tool_negative=negative)
    work, tool = recipe.work_removal * work, recipe.tool_wear * tool
    return _Kind(delay + recipe.rho * share, energy_uj, molten * work, molten * tool)


def _mean(rows: Sequence[Sequence[float]], weights: list[float]) -> _Kind:
    total = sum(weights)
    return _Kind(*(sum(map(mul, weights, values)) / total for values in rows))


@dataclass(frozen=True, slots=True)
class _Dirt:
    """Debris, arcs among the discharges, and bridges among the pulses."""

    debris: float
    arcs: float
    shorts: float


def _balance(recipe: GapRecipe, pulses: _Pulses, depth_um: float, near: _Dirt | None) -> _Dirt:
    """Return the state in which debris is cleared as fast as it is produced, searched near the last one first."""
    per_s = 1e6 / (recipe.on_time_us + recipe.off_time_us)
    area_um2, working_um = tool_area_um2(recipe.diameter_um), working_gap_um(GAP_LAW, recipe.open_voltage_v)
    flush_s = flush_time_s(GAP_LAW, recipe.diameter_um, depth_um) * recipe.flush_time_s / GAP_LAW.flush_time_s
    channel_us = deionisation_us(GAP_LAW, pulses.every.energy_uj)
    particle_um = GAP_LAW.particle_um * crater_scale(recipe.full_pulse_uj)

    def surplus(debris: float) -> tuple[float, _Dirt]:
        gap_um = _gap_um(recipe, pulses, debris)
        dirt = _Dirt(debris, _arcs(recipe, pulses, debris, channel_us), _shorts(debris, gap_um / particle_um))
        clearing = min(CLEARING[1], max(CLEARING[0], (gap_um / working_um) ** 2))
        outflow = debris * area_um2 * gap_um * (clearing / flush_s + recipe.jump_clearing_hz)
        return (1.0 - dirt.shorts) * sum(_volumes_um3(pulses, debris, dirt.arcs)) * per_s - outflow, dirt

    middle, reach = (0.0, MOST_DEBRIS) if near is None else (near.debris, _NEAR_DEBRIS)
    low, high = max(0.0, middle - reach), min(MOST_DEBRIS, middle + reach)
    (more, _), (less, dirt) = surplus(low), surplus(high)
    if more > 0.0 > less:
        return _between(surplus, (low, more), (high, less))
    return dirt if near is None else _balance(recipe, pulses, depth_um, None)


def _between(
    surplus: Callable[[float], tuple[float, _Dirt]], low: tuple[float, float], high: tuple[float, float]
) -> _Dirt:
    """Return the root of the surplus by false position (Illinois method)."""
    (a, more), (b, less) = low, high
    was_more = None
    for _ in range(_TRIES):
        debris = (b * more - a * less) / (more - less)
        rest, dirt = surplus(debris)
        is_more = rest > 0.0
        again = 0.5 if is_more is was_more else 1.0
        moved = debris - a if is_more else b - debris
        if is_more:
            a, more, less = debris, rest, less * again
        else:
            b, less, more = debris, rest, more * again
        was_more = is_more
        if min(moved, b - a) < _CLOSE_DEBRIS:
            break
    return dirt


def _shorts(debris: float, particles: float) -> float:
    """Return the share of pulses that bridges short until they burn off, for a gap of that many particles."""
    lasting = min(0.5, GAP_LAW.bridge_base * math.pow(debris, max(particles - 0.5, 0.0))) / BRIDGE_CLEAR
    return lasting / (1.0 + lasting)


def _arcs(recipe: GapRecipe, pulses: _Pulses, debris: float, channel_us: float) -> float:
    """Share of the discharges that are arcs; `channel_us` is the decay of a channel."""
    again = math.exp(-recipe.off_time_us / (channel_us * (1.0 + GAP_LAW.deionisation_debris * debris)))
    pause = 1.0 / (1.0 + recipe.off_time_us / GAP_LAW.arc_pause_us)
    dense = (debris / GAP_LAW.arc_debris) ** 2
    base, once, nine = GAP_LAW.arc_base, min(1.0, dense), min(1.0, 9.0 * dense)
    sparks, soon_share, arcs = pulses.sparks, pulses.soon_share, GAP_LAW.arc_base
    for _ in range(_ARC_ROUNDS):
        near = (1.0 - arcs) * once + arcs * nine
        arcs = min(1.0, base + sparks * (again + (1.0 - again) * near * soon_share * pause))
    return arcs


def _volumes_um3(pulses: _Pulses, debris: float, arcs: float) -> tuple[float, float]:
    every, soon, arc = pulses.every, pulses.soon, pulses.arc
    work = every.work_um3 + arcs * (arc.work_um3 - soon.work_um3)
    tool = every.tool_um3 + arcs * (arc.tool_um3 - soon.tool_um3)
    return _left(debris) * pulses.sparks * max(work, 0.0), pulses.sparks * max(tool, 0.0)


def _left(debris: float) -> float:
    return 1.0 / (1.0 + (debris / GAP_LAW.redeposition) ** 2)


def _gap_um(recipe: GapRecipe, pulses: _Pulses, debris: float) -> float:
    reference_um = GAP_LAW.gap_reference_um * recipe.open_voltage_v / USUAL_OPEN_V
    clean_um = reference_um * math.pow(pulses.tau_us / GAP_LAW.tau_reference_us, 1.0 / GAP_LAW.gap_exponent)
    return clean_um / max(1.0 - GAP_LAW.debris_gap_factor * debris, 0.05)
