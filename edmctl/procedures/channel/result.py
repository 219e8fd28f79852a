"""What a channel has become: its floor by touches along the path, tool wear, and the sums of its passes."""

from __future__ import annotations

import math
from dataclasses import replace

from edmctl.labels import Basis
from edmctl.procedures.channel.touching import ChannelSurface, FloorReading
from edmctl.procedures.job_state import CutTotals
from edmctl.procedures.run import JobRun
from edmctl.procedures.touch.drift import drift_between
from edmctl.procedures.touch.spots import pad_u_um
from edmctl.process.channel import channel_width_um
from edmctl.process.discharge import mrr_mm3_min
from edmctl.process.touches import TOUCH_PRIOR_DOF, Drift
from edmctl.quantity import Value
from edmctl.results.declared import shared
from edmctl.results.job import ChannelResult, SiteResult
from edmctl.results.telemetry import pulse_shares

TOUCH_LEAST_SD_UM = 0.1
"""Touches that agree better than this do so by chance."""


def channel_result(
    run: JobRun,
    length_um: float,
    surface: ChannelSurface,
    found: FloorReading,
    sums: CutTotals,
    *,
    layers: int,
    gap_um: float,
    stops: int,
    uneven_um: float = 0.0,
) -> ChannelResult:
    """Reduce a measuring stop and all passes before it.

    After a pass that ended early the floor may be deeper by `uneven_um` where the tool was, which is at none of the
    places that were touched: so much the mean of the floor may be off.
    """
    job, z1 = run.job, surface.z1
    seconds, by_rests = found.pad.time_s - z1.time_s, drift_between(run, z1, found.pad)
    drift = by_rests or Drift(0.0, run.uncertainty.drifted_u_um(seconds))
    depth, wear, feed = _lengths(run, surface, found, uneven_um, drift)
    return ChannelResult(
        name=job.profile.meta.name,
        length_um=length_um,
        width_um=channel_width_um(job.profile.tool.diameter_um, job.profile.work.side_gap_um),
        layers=layers,
        passes=sums.number,
        **depth.columns("depth_{}um"),
        **wear.columns("wear_{}um"),
        **feed.columns("feed_{}um"),
        floor_sd_um=found.sd_um,
        z1_um=z1.z_um,
        z3_um=found.pad.z_um - drift.um,
        machining_time_s=sums.time_s,
        pulses=sum(sums.counts),
        ratios=pulse_shares(*sums.counts),
        energy_j=sums.energy_j,
        working_gap_um=gap_um,
        measuring_stops=stops,
        floor=found.places,
        depth_basis=job.touch_basis,
        wear_basis=job.touch_basis,
        drift_correction_um=drift.um,
        drift_left_u_um=drift.left_u_um,
        drift_by_rests=by_rests is not None,
    )


def channel_left(
    measured: ChannelResult,
    sums: CutTotals,
    *,
    layers: int,
    depth_um: float,
    most_um: float,
    wear_um: float,
) -> ChannelResult:
    """Return a channel that was cut on to about `depth_um` since it was measured, and then left, by estimate.

    It may be as deep as `most_um` in places. `wear_um` is the wear by the energy of whole passes; since the stop the
    tool has lost as much per depth as before at least. Whatever was not touched may be wrong by all of it, and by as
    much per depth as the stop was wrong; a tool does not lose more than it cuts. A pass that was broken off is in no
    sum.
    """
    cut_um = max(most_um, depth_um) - measured.depth_um
    per_um = 1.0 / measured.depth_um if measured.depth_um > 0.0 else 0.0
    worn_um = max(wear_um - measured.wear_um, measured.wear_um * per_um * cut_um, 0.0)
    missed_um = cut_um * min(measured.wear_u_um * per_um, 1.0) if per_um else cut_um
    wear_u_um = math.hypot(measured.wear_u_um + missed_um, worn_um)
    feed_um = depth_um + measured.wear_um + worn_um
    return replace(
        measured,
        layers=layers,
        passes=sums.number,
        **Value(depth_um, math.hypot(measured.depth_u_um, cut_um)).columns("depth_{}um"),
        **Value(measured.wear_um + worn_um, wear_u_um).columns("wear_{}um"),
        **Value(feed_um, math.hypot(measured.depth_u_um, cut_um, wear_u_um)).columns("feed_{}um"),
        floor_sd_um=math.nan,
        z3_um=math.nan,
        machining_time_s=sums.time_s,
        pulses=sum(sums.counts),
        ratios=pulse_shares(*sums.counts),
        energy_j=sums.energy_j,
        floor=(),
        depth_basis=Basis.ESTIMATED,
        wear_basis=Basis.ESTIMATED,
    )


def _lengths(
    run: JobRun, surface: ChannelSurface, found: FloorReading, uneven_um: float, drift: Drift
) -> tuple[Value, Value, Value]:
    """Return mean depth, wear and feed, with what is unknown of touches, doubts, sensor, drift, face, stages.

    How much the floor varies from place to place counts too, as only some were touched. The pad is touched before
    and after the floor, so a steady drift is no part of the depth.
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


def channel_row(run: JobRun, result: ChannelResult) -> SiteResult:
    """Return the channel as a row of the results: Z2 is the mean of its floor."""
    path = run.profile.path
    assert path is not None
    volume_um3 = result.depth_um * result.width_um * result.length_um
    time_s = result.machining_time_s
    return SiteResult(
        **shared(SiteResult, result),
        x_um=path.x_um,
        y_um=path.y_um,
        z2_um=result.z3_um + result.depth_um,
        face_um=0.0,
        estimated_um=0.0,
        depth_model_um=math.nan,
        wear_model_um=math.nan,
        zero_drift_um=math.nan,
        feed_model_error_max_um=math.nan,
        feed_model_error_rms_um=math.nan,
        feed_model_error_max_pct=math.nan,
        feed_model_error_rms_pct=math.nan,
        cuts=result.passes,
        wear_ratio_lin=math.nan,
        wear_ratio_vol=math.nan,
        mrr_mm3_min=mrr_mm3_min(volume_um3 / time_s) if time_s else math.nan,
    )
