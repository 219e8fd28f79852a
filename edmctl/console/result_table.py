"""The closing table of a job."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.console.text import count, duration, length, percent, plural

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.console.views import (
        ChannelTruthView,
        ChannelView,
        JobView,
        RatiosView,
        SiteView,
        TruthView,
    )

MOST_BLOCKS = 2
"""Sites that are told at length; more make a table."""


def render_job(
    job: JobView,
    truths: Sequence[TruthView] = (),
    style: Style = PLAIN,
    channel_truth: ChannelTruthView | None = None,
) -> str:
    """Render one block per site, one line each where there are many, and a closing line.

    truths : one per site on the simulator, empty on hardware. They stand in a column of their own, beside
        what the touches measured (with the half-width of its 95 % interval) and what the actuator model makes
        of the voltage alone.
    """
    padded = (*truths, *[None] * (len(job.sites) - len(truths)))
    pairs = list(zip(job.sites, padded, strict=True))
    blocks = [_site_block(site, truth, style) for site, truth in pairs]
    if len(pairs) > MOST_BLOCKS:
        blocks = [_site_lines(pairs, style)]
    if job.channel is not None:
        blocks.append(_channel_block(job.channel, channel_truth, style))
    worn = "the tool's wear was not measured"
    if not isnan(job.tool_wear_total_um):
        worn = f"the tool is {length(job.tool_wear_total_um)} shorter"
    total = f"Whole job {duration(job.time_s)}; {worn}."
    return "\n\n".join([*blocks, total])


def _site_lines(pairs: Sequence[tuple[SiteView, TruthView | None]], style: Style) -> str:
    header = ["site", "depth", "tool wear", "feed", "stops", "machining"]
    if any(truth for _, truth in pairs):
        header.append("true depth")
    rows = [
        [
            site.name,
            length(site.depth_um, site.depth_u95_um),
            length(site.wear_um, site.wear_u95_um),
            length(site.feed_um),
            str(site.measuring_stops),
            duration(site.machining_time_s),
            *([length(truth.depth_um)] if truth else []),
        ]
        for site, truth in pairs
    ]
    return render_columns(header, rows, style)


def _site_block(site: SiteView, truth: TruthView | None, style: Style) -> str:
    header = [site.name, "measured", "from voltage"]
    name = "tip below the face" if site.through else "depth"
    depth = [name, length(site.depth_um, site.depth_u95_um), length(site.depth_model_um)]
    wear = ["tool wear", length(site.wear_um, site.wear_u95_um), length(site.wear_model_um)]
    if truth:
        header.append("truth")
        depth.append(length(truth.depth_um))
        wear.append(length(truth.wear_um))
    rows = [
        depth,
        wear,
        ["feed", length(site.feed_um)],
        ["Z1 surface before", length(site.z1_um)],
        ["Z2 tip at the end" if site.through else "Z2 bottom", length(site.z2_um)],
        ["Z3 surface after", length(site.z3_um)],
    ]
    table = render_columns(header, rows, style)
    machining = f"{duration(site.machining_time_s)} in {plural(site.cuts, 'cut')}"
    if site.through:
        machining += ", through the sheet"
    if site.estimated_um:
        machining += (
            f"; the last {length(site.estimated_um)} were not touched, Z2 and Z3 are where contact would be"
        )
    pulses = f"{count(site.pulses)}: {render_ratios(site.ratios)}"
    return "\n".join([table, f"{'machining':21}{machining}", f"{'pulses':21}{pulses}"])


def _channel_block(channel: ChannelView, truth: ChannelTruthView | None, style: Style) -> str:
    header = [channel.name, "measured"]
    depth = ["depth, mean", length(channel.depth_um, channel.depth_u95_um)]
    floor = ["floor, rms along the path", length(channel.floor_sd_um)]
    wear = ["tool wear", length(channel.wear_um, channel.wear_u95_um)]
    if truth:
        header.append("truth")
        depth.append(length(truth.depth_um))
        floor.append(f"{length(truth.floor_error_rms_um)} from the target")
        wear.append(length(truth.wear_um))
    table = render_columns(header, [depth, floor, wear, ["length", length(channel.length_um)]], style)
    passes = "1 pass" if channel.passes == 1 else f"{channel.passes} passes"
    made = f"{plural(channel.layers, 'layer')} in {passes}"
    pulses = f"{count(channel.pulses)}: {render_ratios(channel.ratios)}"
    machining = f"{duration(channel.machining_time_s)}, {made}"
    return "\n".join([table, f"{'machining':27}{machining}", f"{'pulses':27}{pulses}"])


def render_ratios(ratios: RatiosView, decimals: int = 1) -> str:
    """Return the shares of the four pulse classes in words."""
    shares = (
        ("open", ratios.open),
        ("normal", ratios.normal),
        ("arc", ratios.arc),
        ("short", ratios.short),
    )
    return ", ".join(f"{percent(share, decimals)} {name}" for name, share in shares)
