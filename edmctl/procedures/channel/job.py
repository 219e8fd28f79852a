"""A job that makes a channel: its place in the tally and in the run file."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from edmctl.procedures.channel.procedure import machine_channel
from edmctl.procedures.hole.target import goal_of
from edmctl.procedures.hole.verdict import judged_channel
from edmctl.procedures.job import Site
from edmctl.procedures.servo.time_limits import TimeLimits
from edmctl.process.erosion import mrr_mm3_min
from edmctl.record.rows import SiteRow

if TYPE_CHECKING:
    from edmctl.procedures.hole.cut_decision import Decision
    from edmctl.procedures.run import Run
    from edmctl.results.channel import ChannelResult


def machine_path(run: Run) -> Decision | None:
    """Machine the channel of the recipe; the decision where it missed its objective, None where it did not.

    Raises PreconditionError E8060, E8061 where it is not the channel, or the tool, that an earlier run has left.
    """
    path = run.profile.path
    assert path is not None

    def keep(result: ChannelResult) -> None:
        run.tally.channel = result

    result, decision = machine_channel(run, TimeLimits(run), keep)
    run.tally.open_site = run.tally.unmeasured_site = ""
    if result is not None:
        result = judged_channel(goal_of(run.profile, Site(result.name, path.x_um, path.y_um)), result)
        keep(replace(result, finished=True))
        run.recorder.site_result(_row(run, result))
    return decision if decision.missed else None


def record_left_channel(run: Run) -> None:
    """Write what is known of a channel that was looked at, where its job ends early."""
    channel = run.tally.channel
    if channel is not None and not channel.finished:
        run.recorder.site_result(_row(run, channel))


def _row(run: Run, result: ChannelResult) -> SiteRow:
    """The channel as a row of the results: Z2 is the mean of its floor."""
    path = run.profile.path
    assert path is not None
    volume_um3 = result.depth_um * result.width_um * result.length_um
    return SiteRow(
        site=result.name,
        x_um=path.x_um,
        y_um=path.y_um,
        z1_um=result.z1_um,
        z2_um=result.z3_um + result.depth_um,
        z3_um=result.z3_um,
        depth_um=result.depth_um,
        depth_u95_um=result.depth_u95_um,
        wear_um=result.wear_um,
        wear_u95_um=result.wear_u95_um,
        feed_um=result.feed_um,
        depth_model_um=math.nan,
        wear_model_um=math.nan,
        machining_time_s=result.machining_time_s,
        cuts=result.passes,
        pulses=result.pulses,
        ratio_open=result.ratios.open,
        ratio_normal=result.ratios.normal,
        ratio_arc=result.ratios.arc,
        ratio_short=result.ratios.short,
        energy_j=result.energy_j,
        mrr_mm3_min=mrr_mm3_min(volume_um3 / time_s) if (time_s := result.machining_time_s) else math.nan,
        measuring_stops=result.measuring_stops,
        depth_basis=result.depth_basis,
        wear_basis=result.wear_basis,
        verdict=result.verdict or "",
    )
