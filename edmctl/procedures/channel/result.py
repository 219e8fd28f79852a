"""The result of a channel: its floor by touches along the path, tool wear, and the sums of its passes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from edmctl.labels import Basis
from edmctl.procedures.channel.layers import Layers
from edmctl.procedures.channel.touching import ChannelSurface, FloorReading
from edmctl.procedures.job_state import CutTotals
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.spots import drift_between, pad_u_um
from edmctl.process.channel import channel_width_um
from edmctl.process.discharge import mrr_mm3_min
from edmctl.process.touches import TOUCH_PRIOR_DOF, DepthAndWear, Drift
from edmctl.quantity import Value
from edmctl.results.declared import shared
from edmctl.results.job import ChannelResult, SiteResult
from edmctl.results.telemetry import pulse_shares

TOUCH_LEAST_SD_UM = 0.1
"""Least standard deviation of touches: better agreement is by chance."""


def channel_result(
    run: JobRun,
    length_um: float,
    surface: ChannelSurface,
    found: FloorReading,
    layers: Layers,
    stops: int,
    uneven_um: float = 0.0,
) -> ChannelResult:
    """Return the result of a measurement cycle and all passes before it.

    After a pass that ended early the floor may be deeper by `uneven_um` where the tool was, which is at none of the
    touched places: the mean of the floor may be off by that.
    """
    job, z1, sums = run.job, surface.z1, layers.sums
    seconds, by_rests = found.pad.time_s - z1.time_s, drift_between(run, z1, found.pad)
    drift = by_rests or Drift(0.0, run.uncertainty.drifted_u_um(seconds))
    depth, wear, feed = _lengths(run, surface, found, uneven_um, drift)
    return ChannelResult(
        name=job.profile.meta.name,
        length_um=length_um,
        width_um=channel_width_um(job.profile.tool.diameter_um, job.profile.work.side_gap_um),
        layers=layers.layers,
        **_columns(depth, wear, feed),
        **_sums(sums),
        floor_sd_um=found.sd_um,
        z1_um=z1.z_um,
        z3_um=found.pad.z_um - drift.um,
        working_gap_um=layers.gap_um,
        measuring_stops=stops,
        floor=found.places,
        depth_basis=job.touch_basis,
        wear_basis=job.touch_basis,
        drift_correction_um=drift.um,
        drift_left_u_um=drift.left_u_um,
        drift_by_rests=by_rests is not None,
    )


def channel_left(measured: ChannelResult, layers: Layers, depth_um: float) -> ChannelResult:
    """Return the estimate of a channel that was cut to about `depth_um` since it was measured, and then left.

    It may be as deep as the layer under way in places. The wear is by the energy of whole passes, and per depth at
    least as much as before. What was not touched may be wrong by all of it, and by as much per depth as the
    measurement; a tool does not lose more than it cuts. A pass that was broken off is in no sum.
    """
    wear_um = layers.wear.um(layers.since_uj)
    cut_um = max(depth_um, layers.aim_um) - measured.depth_um
    per_um = 1.0 / measured.depth_um if measured.depth_um > 0.0 else 0.0
    worn_um = max(wear_um - measured.wear_um, measured.wear_um * per_um * cut_um, 0.0)
    missed_um = cut_um * min(measured.wear_u_um * per_um, 1.0) if per_um else cut_um
    wear_u_um = math.hypot(measured.wear_u_um + missed_um, worn_um)
    feed_um = depth_um + measured.wear_um + worn_um
    return replace(
        measured,
        layers=layers.layers,
        **_columns(
            Value(depth_um, math.hypot(measured.depth_u_um, cut_um)),
            Value(measured.wear_um + worn_um, wear_u_um),
            Value(feed_um, math.hypot(measured.depth_u_um, cut_um, wear_u_um)),
        ),
        **_sums(layers.sums),
        floor_sd_um=math.nan,
        z3_um=math.nan,
        floor=(),
        depth_basis=Basis.ESTIMATED,
        wear_basis=Basis.ESTIMATED,
    )


def _columns(depth: Value, wear: Value, feed: Value) -> dict[str, Any]:
    return DepthAndWear(depth, wear, feed, depth_noise_um=math.nan).columns()


def _sums(sums: CutTotals) -> dict[str, Any]:
    return {
        "passes": sums.number,
        "machining_time_s": sums.time_s,
        "pulses": sum(sums.counts),
        "ratios": pulse_shares(*sums.counts),
        "energy_j": sums.energy_j,
    }


def _lengths(
    run: JobRun, surface: ChannelSurface, found: FloorReading, uneven_um: float, drift: Drift
) -> tuple[Value, Value, Value]:
    """Return mean depth, wear and feed.

    The scatter of the floor from place to place counts too, as only some were touched. The pad is touched before and
    after the floor, so a steady drift is no part of the depth.
    """
    sensor_u, z1, setup = run.uncertainty, surface.z1, run.setup
    face_u_um = max(surface.plane.height_u_um(place.x_um, place.y_um) for place in found.places)
    pads = (z1, found.pad_before, found.pad)
    dof = TOUCH_PRIOR_DOF + sum(r.reading.touches - 1 for r in (*pads, *found.floor))
    meeting_u_um = pad_u_um(setup)
    z1_u_um, before_u_um, after_u_um = (
        max(r.reading.sd_um, TOUCH_LEAST_SD_UM) / math.sqrt(r.reading.touches) for r in pads
    )
    depth_u_um = math.hypot(
        found.sd_um / math.sqrt(len(found.floor)),
        0.5 * uneven_um,
        before_u_um / 2.0,
        after_u_um / 2.0,
        sensor_u.length_u_um(found.depth_um),
        face_u_um,
        surface.doubt_u_um,
        meeting_u_um,
        math.fsum(z2.doubt_u_um for z2 in found.floor) / len(found.floor),
        0.5 * (found.pad_before.doubt_u_um + found.pad.doubt_u_um),
    )
    wear_um = found.pad.z_um - drift.um - z1.z_um
    wear_u_um = math.hypot(
        z1_u_um,
        after_u_um,
        sensor_u.length_u_um(wear_um),
        drift.left_u_um,
        meeting_u_um,
        z1.doubt_u_um,
        found.pad.doubt_u_um,
    )
    feed_um, feed_u_um = found.depth_um + wear_um, math.hypot(depth_u_um, wear_u_um)
    return (
        Value(found.depth_um, depth_u_um, dof),
        Value(wear_um, wear_u_um, dof),
        Value(feed_um, feed_u_um, dof),
    )


_UNKNOWN = (
    *("depth_model_um", "wear_model_um", "zero_drift_um"),
    *("feed_model_error_max_um", "feed_model_error_rms_um"),
    *("feed_model_error_max_pct", "feed_model_error_rms_pct"),
    *("wear_ratio_lin", "wear_ratio_vol"),
)
"""Fields of a hole that are NaN for a channel."""


def channel_row(run: JobRun, result: ChannelResult) -> SiteResult:
    """Return the channel as a row of the results: Z2 is the mean of its floor."""
    path = run.profile.path
    assert path is not None
    volume_um3, time_s = result.depth_um * result.width_um * result.length_um, result.machining_time_s
    unknown: dict[str, Any] = dict.fromkeys(_UNKNOWN, math.nan)
    return SiteResult(
        **shared(SiteResult, result),
        **unknown,
        x_um=path.x_um,
        y_um=path.y_um,
        z2_um=result.z3_um + result.depth_um,
        face_um=0.0,
        estimated_um=0.0,
        cuts=result.passes,
        mrr_mm3_min=mrr_mm3_min(volume_um3 / time_s) if time_s else math.nan,
    )
