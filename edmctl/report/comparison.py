"""Runs side by side: what was different about them, and whether their results differ beyond uncertainty."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Sequence
from itertools import zip_longest

from edmctl.labels import basis_of
from edmctl.record.reader import RunFile
from edmctl.record.run_index import estimated_depth
from edmctl.report.numbers import CLASSES, RunNumbers, numbers_of
from edmctl.results.run_file import Amount, ComparedRun, Comparison, Quantity, Setting
from edmctl.wording import plain_number


def compare(runs: Sequence[RunFile]) -> Comparison:
    """Compare open run files with the first of them."""
    numbers = [numbers_of(run) for run in runs]
    return Comparison(
        tuple(_compared(run, len(n.sites)) for run, n in zip(runs, numbers, strict=True)),
        tuple(_differing(runs)),
        tuple(q for q in _quantities(runs, numbers) if any(math.isfinite(a.value) for a in q.amounts)),
        tuple(_places(numbers)),
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


def _quantities(runs: Sequence[RunFile], numbers: Sequence[RunNumbers]) -> Iterator[Quantity]:
    several = any(len(n.sites) > 1 for n in numbers)
    mean, total = ("mean ", "total ") if several else ("", "")
    summaries = [run.summary() or {} for run in runs]
    sums = [n.totals for n in numbers]

    def means(key: str) -> list[float]:
        # A run without sites may have measured a hole all the same, as `measure-wear` does.
        return [
            n.mean(key) if n.sites else plain_number(found.get(key))
            for n, found in zip(numbers, summaries, strict=True)
        ]

    def of_sums(key: str) -> list[float]:
        return [float(getattr(one, key)) for one in sums]

    def bases(key: str) -> list[str]:
        return [
            n.basis(key)
            or basis_of(key, *(str(found.get(f"{name}_basis") or "") for name in ("depth", "wear")))
            for n, found in zip(numbers, summaries, strict=True)
        ]

    def measured(key: str, name: str) -> Quantity:
        return _quantity(f"{key}_um", name, means(f"{key}_um"), means(f"{key}_u95_um"), bases(f"{key}_um"))

    def true(key: str, name: str) -> Quantity:
        return _quantity(f"truth_{key}", f"{mean}true {name} (simulated), µm", means(f"truth.{key}"))

    estimated = [estimated_depth(run) for run in runs]
    rates = of_sums("mrr_mm3_min")
    rate_u95s = [rate * _relative_length_u95(n) for rate, n in zip(rates, numbers, strict=True)]
    wear_u95s = [_wear_ratio_u95(n) for n in numbers]
    lengths, volumes = "wear_ratio_lin", "wear_ratio_vol"
    yield measured("depth", f"{mean}depth, µm")
    yield _quantity(
        "est_depth_um",
        "depth when left (estimated), µm",
        [one.depth_um for one in estimated],
        [one.depth_u95_um for one in estimated],
        decimals=1,
    )
    yield true("depth_um", "depth")
    yield measured("wear", f"{mean}tool wear, µm")
    for key, name in (
        ("wear_um", "wear"),
        ("side_gap_um", "side gap"),
        ("taper_um", "taper"),
        ("ra_um", "Ra"),
    ):
        yield true(key, name)
    yield _quantity(lengths, "wear ratio, lengths", of_sums(lengths), wear_u95s, bases(lengths), decimals=3)
    yield _quantity(volumes, "wear ratio, volumes", of_sums(volumes), bases=bases(volumes), decimals=3)
    yield measured("feed", f"{mean}feed, µm")
    times_s = [n.total("machining_time_s") for n in numbers]
    yield _quantity("machining_time_s", f"{total}machining time, s", times_s, decimals=1)
    times_s = [plain_number(found.get("time_s")) for found in summaries]
    yield _quantity("time_s", "whole run, s", times_s, decimals=1)
    name = "removal rate, 10⁻³ mm³/min"
    yield _quantity("mrr_mm3_min", name, rates, rate_u95s, bases("mrr_mm3_min"), decimals=3, factor=1e3)
    yield _quantity("energy_j", f"{total}discharge energy, J", [n.total("energy_j") for n in numbers])
    yield _quantity("pulses", f"{total}pulses", [n.total("pulses") for n in numbers], decimals=0)
    for name in CLASSES:
        shares = [getattr(of_run.ratios, name) for of_run in sums]
        yield _quantity(f"ratio_{name}", f"{name}, %", shares, factor=100.0)


def _places(numbers: Sequence[RunNumbers]) -> Iterator[Quantity]:
    """Depth and wear of the places that all runs have, if a run has several."""
    if all(len(n.sites) < 2 for n in numbers):
        return
    by_name = [{site.name: site for site in n.sites} for n in numbers]
    for name in (site.name for site in numbers[0].sites if all(site.name in sites for sites in by_name)):
        there = [sites[name] for sites in by_name]
        for key, called in (("depth", "depth"), ("wear", "tool wear")):
            if key == "wear" or not all(site.through for site in there):
                values, u95s, bases = (
                    [getattr(site, f"{key}_{part}") for site in there] for part in ("um", "u95_um", "basis")
                )
                yield _quantity(f"{key}_um", f"{name} {called}, µm", values, u95s, bases)


def _quantity(
    key: str,
    name: str,
    values: Sequence[float],
    u95s: Sequence[float] = (),
    bases: Sequence[str] = (),
    *,
    decimals: int = 2,
    factor: float = 1.0,
) -> Quantity:
    """Return a quantity of each run; without `u95s` its uncertainties are unknown."""
    amounts = []
    first_u95 = u95s[0] if u95s else math.nan
    for value, u95, basis in zip_longest(values, u95s, bases):
        u95 = math.nan if u95 is None else u95
        difference, u95_of_it = value - values[0], math.hypot(u95, first_u95)
        amounts.append(Amount(value, u95, difference, u95_of_it, abs(difference) > u95_of_it, basis or ""))
    return Quantity(key, name, decimals, factor, tuple(amounts))


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

    NaN for a hole through a sheet: the uncertainty of its thickness is unknown.
    """
    length_um = numbers.mean("length_um")
    if not length_um > 0.0 or any(site.through for site in numbers.sites):
        return math.nan
    return numbers.mean("depth_u95_um") / length_um
