"""Runs side by side: what was different about them, and whether their results differ beyond uncertainty."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence

from edmctl.dataclasses import dataclass
from edmctl.labels import basis_of
from edmctl.record.reader import RunFile
from edmctl.record.rows import profile_leaves
from edmctl.record.run_index import estimated_depth, sites_of
from edmctl.results.run_file import Amount, ComparedRun, Comparison, Quantity, Setting, Sites
from edmctl.results.telemetry import PULSE_CLASSES
from edmctl.wording import plain_number


def compare(runs: Sequence[RunFile]) -> Comparison:
    """Compare open run files with the first of them."""
    sites = [sites_of(run) for run in runs]
    values = [_values_of(run, one) for run, one in zip(runs, sites, strict=True)]
    mean, total = ("mean ", "total ") if any(len(one) > 1 for one in sites) else ("", "")
    quantities = [
        _quantity(
            key, name.format(mean=mean, total=total), [of_run[key] for of_run in values], decimals, factor
        )
        for key, (name, decimals, factor) in ROWS.items()
    ]
    return Comparison(
        tuple(_compared(run, len(one)) for run, one in zip(runs, sites, strict=True)),
        tuple(_differing(runs)),
        tuple(q for q in quantities if any(math.isfinite(a.value) for a in q.amounts)),
        tuple(_places(sites)),
    )


def _compared(run: RunFile, sites: int) -> ComparedRun:
    run_id, title, start, status = (
        run.text(f"/entry/{name}") for name in ("run_id", "title", "start_time", "status")
    )
    return ComparedRun(str(run.path), run_id, title, start, status, run.is_simulated, run.seed, sites)


_TEXTS = (
    ("machine", "/entry/machine/serial"),
    ("firmware", "/entry/machine/firmware"),
    ("protocol", "/entry/machine/protocol"),
    ("actuator model", "/entry/machine/calibration"),
    ("edmctl", "/entry/software/version"),
    ("status", "/entry/status"),
)


def _differing(runs: Sequence[RunFile]) -> list[Setting]:
    profiles = [run.profile_values() for run in runs]
    setups = [
        {
            f"setup {key}": value
            for key, value in profile_leaves(tomllib.loads(run.text("/entry/machine/toml"))).items()
        }
        for run in runs
    ]
    others: list[dict[str, object]] = [
        {name: run.text(path) for name, path in _TEXTS} | {"seed": "" if run.seed is None else run.seed}
        for run in runs
    ]
    found = []
    several: tuple[Sequence[Mapping[str, object]], ...] = (profiles, others, setups)
    for groups in several:
        for key in dict.fromkeys(key for values in groups for key in values if not key.endswith("_units")):
            units = next((str(values[f"{key}_units"]) for values in groups if f"{key}_units" in values), "")
            found.append(Setting(key, units, tuple(_text(values.get(key, "")) for values in groups)))
    return [setting for setting in found if len(set(setting.values)) > 1]


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


ROWS: Mapping[str, tuple[str, int, float]] = {
    "depth_um": ("{mean}depth, µm", 2, 1.0),
    "est_depth_um": ("depth when left (estimated), µm", 1, 1.0),
    "truth_depth_um": ("{mean}true depth (simulated), µm", 2, 1.0),
    "wear_um": ("{mean}tool wear, µm", 2, 1.0),
    "truth_wear_um": ("{mean}true wear (simulated), µm", 2, 1.0),
    "truth_side_gap_um": ("{mean}true side gap (simulated), µm", 2, 1.0),
    "truth_taper_um": ("{mean}true taper (simulated), µm", 2, 1.0),
    "truth_ra_um": ("{mean}true Ra (simulated), µm", 2, 1.0),
    "wear_ratio_lin": ("wear ratio, lengths", 3, 1.0),
    "wear_ratio_vol": ("wear ratio, volumes", 3, 1.0),
    "feed_um": ("{mean}feed, µm", 2, 1.0),
    "machining_time_s": ("{total}machining time, s", 1, 1.0),
    "time_s": ("whole run, s", 1, 1.0),
    "mrr_mm3_min": ("removal rate, 10⁻³ mm³/min", 3, 1e3),
    "energy_j": ("{total}discharge energy, J", 2, 1.0),
    "pulses": ("{total}pulses", 0, 1.0),
    **{f"ratio_{name}": (f"{name}, %", 2, 100.0) for name in PULSE_CLASSES},
}
"""Quantities by their keys: name, decimals, and how many of the shown unit are one of the key's."""


@dataclass(frozen=True, slots=True)
class _Value:
    """A quantity of one run; half its 95 % interval is NaN if unknown, its basis empty if it has none."""

    value: float
    u95: float = math.nan
    basis: str = ""


def _values_of(run: RunFile, sites: Sites) -> dict[str, _Value]:
    """Return the quantities of a run by the keys of `ROWS`."""
    summary, totals, left = run.summary() or {}, sites.totals, estimated_depth(run)

    def mean(key: str) -> float:
        # A run without sites may have measured a hole all the same, as `measure-wear` does.
        return sites.mean(key) if sites else plain_number(summary.get(key))

    def basis(key: str) -> str:
        found = (str(summary.get(f"{name}_basis") or "") for name in ("depth", "wear"))
        return sites.basis(key) or basis_of(key, *found)

    measured = {
        f"{name}_um": _Value(mean(f"{name}_um"), mean(f"{name}_u95_um"), basis(name))
        for name in ("depth", "wear", "feed")
    }
    truths = ("depth_um", "wear_um", "side_gap_um", "taper_um", "ra_um")
    true = {f"truth_{name}": _Value(mean(f"truth.{name}")) for name in truths}
    sums = {name: _Value(sites.total(name)) for name in ("machining_time_s", "energy_j", "pulses")}
    shares = {f"ratio_{name}": _Value(getattr(totals.ratios, name)) for name in PULSE_CLASSES}
    ratio, rate = totals.wear_ratio_lin, totals.mrr_mm3_min
    return {
        **measured,
        **true,
        **sums,
        **shares,
        "est_depth_um": _Value(left.depth_um, left.depth_u95_um),
        "wear_ratio_lin": _Value(ratio, _wear_ratio_u95(sites, ratio), basis("wear_ratio")),
        "wear_ratio_vol": _Value(totals.wear_ratio_vol, basis=basis("wear_ratio")),
        "time_s": _Value(plain_number(summary.get("time_s"))),
        "mrr_mm3_min": _Value(rate, rate * _relative_length_u95(sites), basis("mrr")),
    }


def _places(sites: Sequence[Sites]) -> Iterator[Quantity]:
    """Depth and wear of the places that all runs have, if a run has several."""
    if all(len(one) < 2 for one in sites):
        return
    by_name = [{site.name: site for site in one} for one in sites]
    for name in (site.name for site in sites[0] if all(site.name in of_run for of_run in by_name)):
        there = [of_run[name] for of_run in by_name]
        depths = [_Value(site.depth_um, site.depth_u95_um, site.depth_basis or "") for site in there]
        if not all(site.through for site in there):
            yield _quantity("depth_um", f"{name} depth, µm", depths)
        wears = [_Value(site.wear_um, site.wear_u95_um, site.wear_basis) for site in there]
        yield _quantity("wear_um", f"{name} tool wear, µm", wears)


def _quantity(
    key: str, name: str, values: Sequence[_Value], decimals: int = 2, factor: float = 1.0
) -> Quantity:
    first, amounts = values[0], []
    for one in values:
        difference, u95 = one.value - first.value, math.hypot(one.u95, first.u95)
        amounts.append(Amount(one.value, one.u95, difference, u95, abs(difference) > u95, one.basis))
    return Quantity(key, name, decimals, factor, tuple(amounts))


def _wear_ratio_u95(sites: Sites, ratio: float) -> float:
    """Uncertainty of wear over length. A depth has Z3 as the wear has, with opposite sign, so their errors add up.

    The thickness of a sheet is taken as the profile has it.
    """
    length_um = sites.mean("length_um")
    if not length_um > 0.0 or not math.isfinite(ratio):
        return math.nan
    length_u95_um = math.fsum(0.0 if site.through else site.depth_u95_um for site in sites) / len(sites)
    return (sites.mean("wear_u95_um") + abs(ratio) * length_u95_um) / length_um


def _relative_length_u95(sites: Sites) -> float:
    """Uncertainty of a removed volume as a share of it: the area of a hole is known better than its length.

    NaN for a hole through a sheet: the uncertainty of its thickness is unknown.
    """
    length_um = sites.mean("length_um")
    if not length_um > 0.0 or any(site.through for site in sites):
        return math.nan
    return sites.mean("depth_u95_um") / length_um
