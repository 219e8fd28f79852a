"""What a run can answer: values of a job's result with their intervals, and what a virtual machine knows."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from statistics import fmean
from typing import Any

from edmctl.dataclasses import dataclass
from edmctl.jsonout import JsonValue, to_json_value
from edmctl.labels import weakest
from edmctl.study.results import TRUTH


@dataclass(frozen=True, slots=True)
class Known:
    """A response of a job: what it is, its lowest and highest possible value, and the jobs that never have it.

    absent : kinds of the target, or `channel`
    """

    text: str
    low: float = -math.inf
    high: float = math.inf
    absent: tuple[str, ...] = ()


RESPONSES = {
    "depth_um": Known("depth, mean of the holes, µm", absent=("through",)),
    "depth_error_um": Known("depth less the depth that was wanted, µm", absent=("through", "feed")),
    "wear_um": Known("wear of the tool, mean of the holes, µm"),
    "feed_um": Known("depth and wear, µm"),
    "wear_ratio_lin": Known("wear per depth", absent=("channel",)),
    "wear_ratio_vol": Known("volume of the tool per volume of the hole", absent=("channel",)),
    "mrr_mm3_min": Known("removal rate while sparks flow, mm³/min", absent=("channel",)),
    "machining_time_s": Known("time with the servo on, s", 0.0),
    "time_s": Known("whole time of the job, s", 0.0),
    "measuring_time_s": Known("time of touching, s", 0.0),
    "open_share": Known("pulses without a discharge", 0.0, 1.0),
    "normal_share": Known("normal discharges", 0.0, 1.0),
    "arc_share": Known("arcs", 0.0, 1.0),
    "short_share": Known("shorts", 0.0, 1.0),
    "energy_j": Known("energy of all discharges, J", 0.0),
    "energy_per_depth_j_um": Known("energy per depth, J/µm", absent=("through",)),
    "working_gap_um": Known("frontal gap while machining, µm"),
    "pulses": Known("number of pulses", 0.0),
    "cuts": Known("number of cuts", 0.0),
    "measuring_stops": Known("touches of bottom and pad", 0.0),
    "zero_drift_um": Known("move of the rest at 0 V from Z1 to Z3, µm", absent=("channel",)),
}
"""Responses of a job. Lengths and ratios of them have no lowest value: the error of one may bring it below zero."""
TRUTHS = {
    "depth_um": Known("true depth, µm", absent=("through",)),
    "wear_um": Known("true wear, µm"),
    "side_gap_um": Known("gap at the wall, µm", absent=("channel",)),
    "taper_um": Known("taper, µm", absent=("channel",)),
    "ra_um": Known("roughness Ra of the floor, µm", absent=("channel",)),
    "rz_um": Known("roughness Rz of the floor, µm", absent=("channel",)),
    "corner_um": Known("radius of the floor's edge, µm", absent=("channel",)),
    "wear_ratio_lin": Known("true wear per true depth", absent=("through",)),
}
"""What only a virtual machine knows; a response is called `truth.NAME`."""
KNOWN = RESPONSES | {f"{TRUTH}{name}": one for name, one in TRUTHS.items()}

COLUMNS = frozenset((
    "run", "kind", "point", "replicate", "block", "tool", "x_um", "y_um", "seed", "attempt", "state", "judgement",
    "reason", "exit_code", "error", "depth_basis", "wear_basis", "run_file", "run_sha256", "started", "duration_s",
    "host",
))  # fmt: skip
"""Columns of the table that contain something else: no response has such a name."""

_UNITS = {"_j_um": "J/µm", "_um": "µm", "_s": "s", "_j": "J", "_mm3_min": "mm³/min"}
LARGEST = 1e30
"""Of any response: powers of it stay finite."""


def near(name: str) -> str:
    """Return a hint on an unknown name."""
    close = difflib.get_close_matches(name, KNOWN, 1)
    return f"perhaps {close[0]} is meant" if close else f"a job tells {', '.join(KNOWN)}"


def range_of(name: str) -> tuple[float, float]:
    """Return the lowest and the highest value that a response can have."""
    known = KNOWN.get(name, Known(""))
    return known.low, known.high


def unit_of(name: str) -> str:
    """Return the unit of a response of the job, by the end of its name."""
    return next((unit for end, unit in _UNITS.items() if name.endswith(end)), "")


def responses_of(result: Mapping[str, JsonValue], target_um: float | None) -> dict[str, Any]:
    """Return the `responses` of a job with `u`, `u95` and `bases`, as a row of a run has them.

    result : a report as plain values, or the summary in its run file
    """
    made = _made(result)
    values: dict[str, float] = {name: _number(result, name) for name in ("time_s", "measuring_time_s")}
    if not made:
        return {"responses": _plain(values)}
    for name in ("depth_um", "wear_um", "feed_um", "working_gap_um", *_RATIOS):
        values[name] = fmean(_number(one, name) for one in made)
    for kind in ("open", "normal", "arc", "short"):
        shares = ((_number(one.get("ratios"), kind), _number(one, "pulses")) for one in made)
        values[f"{kind}_share"] = _weighted(shares)
    for name in ("machining_time_s", "energy_j", "pulses", "measuring_stops"):
        values[name] = math.fsum(_number(one, name) for one in made)
    values["cuts"] = math.fsum(_number(one, "cuts" if "cuts" in one else "passes") for one in made)
    depth_um = values["depth_um"]
    if target_um is not None:
        values["depth_error_um"] = depth_um - target_um
    if depth_um > 0:
        values["energy_per_depth_j_um"] = values["energy_j"] / (depth_um * len(made))
    uncertainties = {mark: _plain(_uncertainties(values, made, mark)) for mark in ("u", "u95")}
    bases = {
        f"{name}_um": str(weakest(str(one[f"{name}_basis"]) for one in made)) for name in ("depth", "wear")
    }
    return {"responses": _plain(values), **uncertainties, "bases": bases}


def _uncertainties(
    values: Mapping[str, float], made: Iterable[Mapping[str, JsonValue]], mark: str
) -> dict[str, float]:
    """Return uncertainties that follow from the uncertainty (`u` or `u95`) of depth and wear in the result."""
    depth_um, wear_um = values["depth_um"], values["wear_um"]
    depth, wear = (fmean(_number(one, f"{name}_{mark}_um") for one in made) for name in ("depth", "wear"))
    found = {"depth_um": depth, "wear_um": wear}
    if "depth_error_um" in values:
        found["depth_error_um"] = depth
    if depth_um > 0:
        found["wear_ratio_lin"] = math.hypot(wear, wear_um / depth_um * depth) / depth_um
        found["mrr_mm3_min"] = values["mrr_mm3_min"] * depth / depth_um
        if wear_um > 0:
            found["wear_ratio_vol"] = (
                values["wear_ratio_vol"] * found["wear_ratio_lin"] / (wear_um / depth_um)
            )
    return found


def truth_of(result: Mapping[str, JsonValue]) -> dict[str, float | None]:
    """Return what the virtual machine knows, mean of the holes; nothing of any other machine."""
    truths = [truth for one in _made(result) if isinstance(truth := one.get("truth"), dict)]
    if not truths:
        return {}
    values = {name: fmean(_number(one, name) for one in truths) for name in TRUTHS}
    if values["depth_um"] > 0:
        values["wear_ratio_lin"] = values["wear_um"] / values["depth_um"]
    return _plain(values)


_RATIOS = ("wear_ratio_lin", "wear_ratio_vol", "mrr_mm3_min", "zero_drift_um")


def _made(result: Mapping[str, JsonValue]) -> list[dict[str, JsonValue]]:
    sites, channel = result.get("sites"), result.get("channel")
    if isinstance(channel, dict):
        return [channel]
    return [one for one in sites if isinstance(one, dict)] if isinstance(sites, list) else []


def _number(table: JsonValue | Mapping[str, JsonValue], name: str) -> float:
    value = table.get(name) if isinstance(table, dict) else None
    return float(value) if isinstance(value, int | float) else math.nan


def _weighted(shares: Iterable[tuple[float, float]]) -> float:
    found = list(shares)
    whole = sum(pulses for _, pulses in found)
    return math.fsum(share * pulses for share, pulses in found) / whole if whole else math.nan


def _plain(values: dict[str, float]) -> dict[str, float | None]:
    """Values as they are written: rounded by their unit, so that they are the same bytes everywhere."""
    plain = {name: to_json_value(float(value), name) for name, value in values.items()}
    return {name: value if isinstance(value, float) else None for name, value in plain.items()}
