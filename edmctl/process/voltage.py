"""What the mean gap voltage says about the gap.

The servo regulates the normalised level `s = mean gap voltage / (duty x open voltage)`: 1 means every pulse
stays open, `rho = discharge voltage / open voltage` means every pulse ignites at once. The ignition delay has
an exponential tail (Laue 1925), so its mean time constant against the on-time fixes the level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_QUADRATURE_INTERVALS = 64
_QUADRATURE_SIGMAS = 6.0


@dataclass(frozen=True, slots=True)
class IgnitionLaw:
    """Ignition delay in clean oil: `tau = tau_ref * (gap / gap_ref)**exponent` at the reference voltage.

    Parameters
    ----------
    tau_ref_us : statistical delay at the reference gap, µs
    gap_ref_um : gap that ignites with `tau_ref_us` at `voltage_ref_v`; scales with the open voltage
    exponent : steepness of the delay against the gap; breakdown of micro gaps in oil is steep
    formative_us : delay that no pulse falls short of
    roughness_um : standard deviation of the half-normal surface peaks that narrow the gap
    """

    tau_ref_us: float = 60.0
    gap_ref_um: float = 2.5
    exponent: float = 4.0
    formative_us: float = 1.0
    roughness_um: float = 0.20
    voltage_ref_v: float = 40.0

    def tau_us(self, gap_um: float, open_voltage_v: float) -> float:
        """Statistical delay in µs of a smooth gap in µm; 0 for a closed gap."""
        if gap_um <= 0.0:
            return 0.0
        reference_um = self.gap_ref_um * open_voltage_v / self.voltage_ref_v
        return self.tau_ref_us * math.pow(gap_um / reference_um, self.exponent)


def open_share(tau_over_on_time: float) -> float:
    """Mean share of the on-time before ignition, `phi = E[min(t_d, t_on)] / t_on`, for exponential delay."""
    x = tau_over_on_time
    if x <= 0.0:
        return 0.0
    return -x * math.expm1(-1.0 / x)


def spark_probability(tau_over_on_time: float) -> float:
    """Probability that a pulse ignites within its on-time, `P = 1 - exp(-t_on / tau)`."""
    if tau_over_on_time <= 0.0:
        return 1.0
    return -math.expm1(-1.0 / tau_over_on_time)


def level(tau_over_on_time: float, rho: float) -> float:
    """Normalised mean gap voltage `s = rho + (1 - rho) * phi`; dimensionless, rho..1."""
    return rho + (1.0 - rho) * open_share(tau_over_on_time)


def discharge_share(level_s: float, rho: float) -> float:
    """Share of the on-time that burns, `1 - phi = (1 - s) / (1 - rho)`: voltage read as a removal meter."""
    return (1.0 - level_s) / (1.0 - rho)


def burning_share(tau_over_on_time: float, longest_share: float) -> float:
    """Mean share of the on-time that burns when a discharge is cut off after `longest_share` of it.

    `E[min(t_set, t_on - t_d)] / t_on` for exponential delay; with `longest_share` 1 it is `1 - phi`.
    """
    x = tau_over_on_time
    if x <= 0.0:
        return longest_share
    return longest_share - x * (math.exp(-(1.0 - longest_share) / x) - math.exp(-1.0 / x))


def isopulse_discharge_share(level_s: float, rho: float, longest_share: float) -> float:
    """Share of the on-time that burns at a servo level when every discharge is cut off after a set time.

    Solves `s = phi + rho * burning` for the ignition delay by bisection; it rises from `rho * longest_share`
    to 1.
    """
    low, high = -6.0, 6.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        x = 10.0**middle
        if open_share(x) + rho * burning_share(x, longest_share) < level_s:
            low = middle
        else:
            high = middle
    return burning_share(10.0**low, longest_share)


def _half_normal_nodes() -> tuple[tuple[float, float], ...]:
    """Simpson nodes (|n|, weight) of the standard half-normal distribution; the weights sum to 1."""
    step = _QUADRATURE_SIGMAS / _QUADRATURE_INTERVALS
    nodes = []
    for i in range(_QUADRATURE_INTERVALS + 1):
        x = i * step
        simpson = 1.0 if i in (0, _QUADRATURE_INTERVALS) else (4.0 if i % 2 else 2.0)
        nodes.append((x, simpson * math.exp(-0.5 * x * x)))
    total = math.fsum(weight for _, weight in nodes)
    return tuple((x, weight / total) for x, weight in nodes)


_HALF_NORMAL = _half_normal_nodes()


def clean_oil_level(
    gap_um: float, *, on_time_us: float, open_voltage_v: float, discharge_voltage_v: float, law: IgnitionLaw
) -> float:
    """Normalised mean gap voltage at a fixed gap without debris.

    Averages the delay law over the surface peaks (half-normal, `law.roughness_um`) and counts the formative
    time. A gap that a peak bridges is taken as igniting at once. Dimensionless, rho..1.
    """
    rho = discharge_voltage_v / open_voltage_v
    formative = min(1.0, law.formative_us / on_time_us)
    remaining_us = on_time_us * (1.0 - formative)
    share = 0.0
    for peak, weight in _HALF_NORMAL:
        local_um = gap_um - law.roughness_um * peak
        if local_um > 0.0 and remaining_us > 0.0:
            phi = open_share(law.tau_us(local_um, open_voltage_v) / remaining_us)
            share += weight * (formative + (1.0 - formative) * phi)
    return rho + (1.0 - rho) * share


def clean_oil_spark_probability(
    gap_um: float, *, on_time_us: float, open_voltage_v: float, law: IgnitionLaw
) -> float:
    """Probability that a pulse ignites at a fixed gap without debris; dimensionless, 0..1."""
    remaining_us = max(on_time_us - law.formative_us, 1e-9)
    return math.fsum(
        weight
        * spark_probability(law.tau_us(gap_um - law.roughness_um * peak, open_voltage_v) / remaining_us)
        for peak, weight in _HALF_NORMAL
    )
