"""Runs side by side: what was different about them, and whether their results differ beyond uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence

from edmctl.dataclasses import dataclass
from edmctl.labels import basis_of
from edmctl.record.reader import RunFile
from edmctl.record.results import estimated_depth
from edmctl.report.numbers import CLASSES, RunNumbers, numbers_of
from edmctl.results.comparison import Amount, ComparedRun, Comparison, Quantity, Setting
from edmctl.wording import plain_number


@dataclass(frozen=True, slots=True)
class _Shown:
    """How a quantity is called and shown."""

    key: str
    name: str
    decimals: int = 2
    factor: float = 1.0


def compare(runs: Sequence[RunFile]) -> Comparison:
    """Compare open run files with the first of them."""
    numbers = [numbers_of(run) for run in runs]
    return Comparison(
        tuple(_compared(run, len(n.sites)) for run, n in zip(runs, numbers, strict=True)),
        tuple(_differing(runs)),
        tuple(_quantities(runs, numbers)),
        tuple(_places(numbers)),
    )


def _compared(run: RunFile, sites: int) -> ComparedRun:
    return ComparedRun(
        str(run.path),
        run.text("/entry/run_id"),
        run.text("/entry/title"),
        run.text("/entry/start_time"),
        run.text("/entry/status"),
        run.is_simulated,
        run.seed,
        sites,
    )


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
    keys = dict.fromkeys(key for values in profiles for key in values)
    found = [
        Setting(
            key,
            str(next((v[f"{key}_units"] for v in profiles if f"{key}_units" in v), "")),
            tuple(_text(values.get(key, "")) for values in profiles),
        )
        for key in keys
        if key != "NX_class" and not key.endswith("_units")
    ]
    found += [Setting(name, "", tuple(run.text(path) for run in runs)) for name, path in _TEXTS]
    found.append(Setting("seed", "", tuple("" if run.seed is None else str(run.seed) for run in runs)))
    setups = [run.text("/entry/machine/toml") for run in runs]
    found += [Setting(f"setup {key}", "", values) for key, values in _setup_lines(setups)]
    return [setting for setting in found if len(set(setting.values)) > 1]


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _setup_lines(texts: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Every value of the setups by its dotted key."""
    import tomllib

    setups = [dict(_leaves(tomllib.loads(text), "")) for text in texts]
    keys = dict.fromkeys(key for setup in setups for key in setup)
    return [(key, tuple(setup.get(key, "") for setup in setups)) for key in keys]


def _leaves(table: dict[str, object], prefix: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for key, value in table.items():
        if isinstance(value, dict):
            found += _leaves(value, f"{prefix}{key}.")
        else:
            found.append((f"{prefix}{key}", _text(value)))
    return found


_WITH_BASIS = ("depth_um", "wear_um", "wear_ratio_lin", "wear_ratio_vol", "feed_um", "mrr_mm3_min")


def _quantities(runs: Sequence[RunFile], numbers: Sequence[RunNumbers]) -> list[Quantity]:
    several = any(len(n.sites) > 1 for n in numbers)
    mean, total = ("mean ", "total ") if several else ("", "")
    nothing, nobody = [math.nan] * len(runs), [""] * len(runs)

    def means(key: str) -> list[float]:
        # A run without sites may have measured a hole all the same, as `measure-wear` does.
        touched = [{} if n.sites else run.summary() or {} for run, n in zip(runs, numbers, strict=True)]
        return [
            n.mean(key) if n.sites else plain_number(found.get(key))
            for n, found in zip(numbers, touched, strict=True)
        ]

    def totals(key: str) -> list[float]:
        return [n.total(key) for n in numbers]

    sums = [n.totals for n in numbers]
    mrr = [of_run.mrr_mm3_min for of_run in sums]
    times_s = [plain_number((run.summary() or {}).get("time_s")) for run in runs]
    lengths, volumes = [of_run.wear_ratio_lin for of_run in sums], [of_run.wear_ratio_vol for of_run in sums]
    rows = [
        (_Shown("depth_um", f"{mean}depth, µm"), means("depth_um"), means("depth_u95_um")),
        (_Shown("est_depth_um", "depth when left (estimated), µm", 1), *_estimates(runs)),
        (_Shown("truth_depth_um", f"{mean}true depth (simulated), µm"), means("truth.depth_um"), nothing),
        (_Shown("wear_um", f"{mean}tool wear, µm"), means("wear_um"), means("wear_u95_um")),
        (_Shown("truth_wear_um", f"{mean}true wear (simulated), µm"), means("truth.wear_um"), nothing),
        *(
            (_Shown(f"truth_{key}", f"{mean}true {name} (simulated), µm"), means(f"truth.{key}"), nothing)
            for key, name in (("side_gap_um", "side gap"), ("taper_um", "taper"), ("ra_um", "Ra"))
        ),
        (_Shown("wear_ratio_lin", "wear ratio, lengths", 3), lengths, [_wear_ratio_u95(n) for n in numbers]),
        (_Shown("wear_ratio_vol", "wear ratio, volumes", 3), volumes, nothing),
        (_Shown("feed_um", f"{mean}feed, µm"), means("feed_um"), means("feed_u95_um")),
        (_Shown("machining_time_s", f"{total}machining time, s", 1), totals("machining_time_s"), nothing),
        (_Shown("time_s", "whole run, s", 1), times_s, nothing),
        (
            _Shown("mrr_mm3_min", "removal rate, 10⁻³ mm³/min", 3, 1e3),
            mrr,
            [rate * _relative_length_u95(n) for rate, n in zip(mrr, numbers, strict=True)],
        ),
        (_Shown("energy_j", f"{total}discharge energy, J"), totals("energy_j"), nothing),
        (_Shown("pulses", f"{total}pulses", 0), totals("pulses"), nothing),
        *(
            (
                _Shown(f"ratio_{name}", f"{name}, %", 2, 100.0),
                [getattr(of_run.ratios, name) for of_run in sums],
                nothing,
            )
            for name in CLASSES
        ),
    ]
    summaries = [run.summary() or {} for run in runs]
    touched = [[str(found.get(f"{name}_basis") or "") for name in ("depth", "wear")] for found in summaries]
    bases = {
        shown: [
            n.basis(shown.key) or basis_of(shown.key, *own) for n, own in zip(numbers, touched, strict=True)
        ]
        for shown, _, _ in rows
        if shown.key in _WITH_BASIS
    }
    found = [_quantity(shown, values, u95s, bases.get(shown, nobody)) for shown, values, u95s in rows]
    return [quantity for quantity in found if any(math.isfinite(a.value) for a in quantity.amounts)]


def _places(numbers: Sequence[RunNumbers]) -> list[Quantity]:
    """Depth and wear of the places that all runs have, where there are several in one."""
    if all(len(n.sites) < 2 for n in numbers):
        return []
    by_name = [{site.name: site for site in n.sites} for n in numbers]
    found = []
    for name in (site.name for site in numbers[0].sites if all(site.name in sites for sites in by_name)):
        there = [sites[name] for sites in by_name]
        found += [
            _quantity(
                _Shown(f"{key}_um", f"{name} {called}, µm"),
                [getattr(site, f"{key}_um") for site in there],
                [getattr(site, f"{key}_u95_um") for site in there],
                [getattr(site, f"{key}_basis") for site in there],
            )
            for key, called in (("depth", "depth"), ("wear", "tool wear"))
            if key == "wear" or not all(site.through for site in there)
        ]
    return found


def _quantity(
    shown: _Shown, values: Sequence[float], u95s: Sequence[float], bases: Sequence[str]
) -> Quantity:
    amounts = []
    for value, u95, basis in zip(values, u95s, bases, strict=True):
        difference, u95_of_it = value - values[0], math.hypot(u95, u95s[0])
        amounts.append(Amount(value, u95, difference, u95_of_it, abs(difference) > u95_of_it, basis))
    return Quantity(shown.key, shown.name, shown.decimals, shown.factor, tuple(amounts))


def _estimates(runs: Sequence[RunFile]) -> tuple[list[float], list[float]]:
    """How deep each run was where it left a hole without a result, and the uncertainties of that."""
    found = [estimated_depth(run) for run in runs]
    return [one.depth_um for one in found], [one.depth_u95_um for one in found]


def _wear_ratio_u95(numbers: RunNumbers) -> float:
    """Uncertainty of wear over length. A depth has Z3 as the wear has, with opposite sign, so their errors add up.

    The thickness of a sheet is taken as the profile has it.
    """
    length_um, ratio = numbers.mean("length_um"), numbers.totals.wear_ratio_lin
    if not length_um > 0.0 or not math.isfinite(ratio):
        return math.nan
    length_u95_um = math.fsum(0.0 if s.through else s.depth_u95_um for s in numbers.sites) / len(
        numbers.sites
    )
    return (numbers.mean("wear_u95_um") + abs(ratio) * length_u95_um) / length_um


def _relative_length_u95(numbers: RunNumbers) -> float:
    """Uncertainty of a removed volume as a share of it: the area of a hole is known better than its length.

    NaN of a hole through a sheet, of which nobody says how well its thickness is known.
    """
    length_um = numbers.mean("length_um")
    if not length_um > 0.0 or any(site.through for site in numbers.sites):
        return math.nan
    return numbers.mean("depth_u95_um") / length_um
