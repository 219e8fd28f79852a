"""What a run can answer: values of a job's result with their intervals, and what a virtual machine knows."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping

from edmctl.jsonout import JsonValue, to_json_value
from edmctl.labels import weakest
from edmctl.study.results import TRUTH

RESPONSES = {
    "depth_um": "depth, mean of the holes, µm",
    "depth_error_um": "depth less the depth that was wanted, µm",
    "wear_um": "wear of the tool, mean of the holes, µm",
    "feed_um": "depth and wear, µm",
    "wear_ratio_lin": "wear per depth",
    "wear_ratio_vol": "volume of the tool per volume of the hole",
    "mrr_mm3_min": "removal rate while sparks flow, mm³/min",
    "machining_time_s": "time with the servo on, s",
    "time_s": "whole time of the job, s",
    "measuring_time_s": "time of touching, s",
    "open_share": "pulses without a discharge",
    "normal_share": "normal discharges",
    "arc_share": "arcs",
    "short_share": "shorts",
    "energy_j": "energy of all discharges, J",
    "energy_per_depth_j_um": "energy per depth, J/µm",
    "working_gap_um": "frontal gap while machining, µm",
    "pulses": "number of pulses",
    "cuts": "number of cuts",
    "measuring_stops": "touches of bottom and pad",
    "zero_drift_um": "move of the rest at 0 V from Z1 to Z3, µm",
}
"""Responses of a job, and what they say."""
TRUTHS = {
    "depth_um": "true depth, µm",
    "wear_um": "true wear, µm",
    "side_gap_um": "gap at the wall, µm",
    "taper_um": "taper, µm",
    "ra_um": "roughness Ra of the floor, µm",
    "rz_um": "roughness Rz of the floor, µm",
    "corner_um": "radius of the floor's edge, µm",
    "wear_ratio_lin": "true wear per true depth",
}
"""What only a virtual machine knows; a response is called `truth.NAME`."""

ABSENT = {
    "through": {
        "depth_um",
        "depth_error_um",
        "energy_per_depth_j_um",
        "truth.depth_um",
        "truth.wear_ratio_lin",
    },
    "feed": {"depth_error_um"},
    "channel": {
        "wear_ratio_lin",
        "wear_ratio_vol",
        "mrr_mm3_min",
        "zero_drift_um",
        *(f"{TRUTH}{name}" for name in ("side_gap_um", "taper_um", "ra_um", "rz_um", "corner_um")),
    },
}
"""Responses that are never known, by the kind of the target, or of a channel."""

COLUMNS = frozenset(
    [
        "run",
        "kind",
        "point",
        "replicate",
        "block",
        "tool",
        "x_um",
        "y_um",
        "seed",
        "attempt",
        "state",
        "judgement",
        "reason",
        "exit_code",
        "error",
        "depth_basis",
        "wear_basis",
        "run_file",
        "run_sha256",
        "started",
        "duration_s",
        "host",
    ]
)
"""Columns of the table that say something else: no response has such a name."""

NEVER_NEGATIVE = frozenset(
    [
        "machining_time_s",
        "time_s",
        "measuring_time_s",
        "open_share",
        "normal_share",
        "arc_share",
        "short_share",
        "energy_j",
        "pulses",
        "cuts",
        "measuring_stops",
    ]
)
"""Sums and shares. Lengths and ratios of them are measured, and may come out below zero by their own error."""

_UNITS = {"_um": "µm", "_s": "s", "_j": "J", "_mm3_min": "mm³/min", "_j_um": "J/µm"}


LARGEST = 1e30
"""Of any response: powers of it stay finite."""


def is_known(name: str) -> bool:
    """Return whether a job answers by that name."""
    return name in RESPONSES or (name.startswith(TRUTH) and name.removeprefix(TRUTH) in TRUTHS)


def near(name: str) -> str:
    """Return what to say of an unknown name."""
    names = [*RESPONSES, *(f"{TRUTH}{one}" for one in TRUTHS)]
    close = difflib.get_close_matches(name, names, 1)
    return f"perhaps {close[0]} is meant" if close else f"a job tells {', '.join(names)}"


def range_of(name: str) -> tuple[float, float]:
    """Return the least and the largest value that a response can have."""
    if name not in NEVER_NEGATIVE:
        return -math.inf, math.inf
    return 0.0, 1.0 if name.endswith("_share") else math.inf


def unit_of(name: str) -> str:
    """Return the unit of a response of the job, by the end of its name."""
    return next(
        (unit for end, unit in sorted(_UNITS.items(), key=lambda one: -len(one[0])) if name.endswith(end)), ""
    )


def responses_of(
    result: Mapping[str, JsonValue], target_um: float | None
) -> tuple[dict[str, float | None], dict[str, float | None], dict[str, float | None], dict[str, str]]:
    """Return values, standard uncertainties, half-widths of 95 % intervals and bases of a job's responses.

    A value that the job does not have is None.

    result : a report as plain values, or the summary in its run file
    """
    made = _made(result)
    values: dict[str, float] = {name: _number(result, name) for name in ("time_s", "measuring_time_s")}
    if not made:
        return _plain(values), {}, {}, {}
    for name in ("depth_um", "wear_um", "feed_um", "working_gap_um", *_RATIOS):
        values[name] = _mean(_number(one, name) for one in made)
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
    u, u95 = (_plain(_uncertainties(values, made, mark)) for mark in ("u", "u95"))
    bases = {
        f"{name}_um": str(weakest(str(one[f"{name}_basis"]) for one in made)) for name in ("depth", "wear")
    }
    return _plain(values), u, u95, bases


def _uncertainties(
    values: Mapping[str, float], made: Iterable[Mapping[str, JsonValue]], mark: str
) -> dict[str, float]:
    """Return uncertainties of the responses by those of depth and wear that are marked so in the result."""
    depth_um, wear_um = values["depth_um"], values["wear_um"]
    depth, wear = (_mean(_number(one, f"{name}_{mark}_um") for one in made) for name in ("depth", "wear"))
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
    values = {name: _mean(_number(one, name) for one in truths) for name in TRUTHS}
    if values["depth_um"] > 0:
        values["wear_ratio_lin"] = values["wear_um"] / values["depth_um"]
    return _plain(values)


_RATIOS = ("wear_ratio_lin", "wear_ratio_vol", "mrr_mm3_min", "zero_drift_um")


def _made(result: Mapping[str, JsonValue]) -> list[dict[str, JsonValue]]:
    """The holes, or the channel, of a result."""
    sites, channel = result.get("sites"), result.get("channel")
    if isinstance(channel, dict):
        return [channel]
    return [one for one in sites if isinstance(one, dict)] if isinstance(sites, list) else []


def _number(table: JsonValue | Mapping[str, JsonValue], name: str) -> float:
    value = table.get(name) if isinstance(table, dict) else None
    return float(value) if isinstance(value, int | float) else math.nan


def _mean(values: Iterable[float]) -> float:
    found = [float(value) for value in values]
    return math.fsum(found) / len(found) if found else math.nan


def _weighted(shares: Iterable[tuple[float, float]]) -> float:
    found = list(shares)
    whole = sum(pulses for _, pulses in found)
    return math.fsum(share * pulses for share, pulses in found) / whole if whole else math.nan


def _plain(values: dict[str, float]) -> dict[str, float | None]:
    """Values as they are written: rounded by their unit, so that they are the same bytes everywhere."""
    plain = {name: to_json_value(float(value), name) for name, value in values.items()}
    return {name: value if isinstance(value, float) else None for name, value in plain.items()}
