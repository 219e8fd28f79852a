"""The closing table of a job."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

from edmctl.console.style import PLAIN, Style
from edmctl.console.tables import render_columns
from edmctl.console.text import count, duration, length, percent, plural

if TYPE_CHECKING:
    from collections.abc import Sequence

    from edmctl.console.views import JobView, RatiosView, SiteView, TruthView


def render_job(job: JobView, truths: Sequence[TruthView] = (), style: Style = PLAIN) -> str:
    """Render one block per site and a closing line.

    truths : one per site on the simulator, empty on hardware. They stand in a column of their own, beside
        what the touches measured (with the half-width of its 95 % interval) and what the actuator model makes
        of the voltage alone.
    """
    padded = (*truths, *[None] * (len(job.sites) - len(truths)))
    blocks = [_site_block(site, truth, style) for site, truth in zip(job.sites, padded, strict=True)]
    worn = "the tool's wear was not measured"
    if not isnan(job.tool_wear_total_um):
        worn = f"the tool is {length(job.tool_wear_total_um)} shorter"
    total = f"Whole job {duration(job.time_s)}; {worn}."
    return "\n\n".join([*blocks, total])


def _site_block(site: SiteView, truth: TruthView | None, style: Style) -> str:
    header = [site.name, "measured", "from voltage"]
    depth = ["depth", length(site.depth_um, site.depth_u95_um), length(site.depth_model_um)]
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
        ["Z2 bottom", length(site.z2_um)],
        ["Z3 surface after", length(site.z3_um)],
    ]
    table = render_columns(header, rows, style)
    machining = f"{duration(site.machining_time_s)} in {plural(site.cuts, 'cut')}"
    pulses = f"{count(site.pulses)}: {render_ratios(site.ratios)}"
    return "\n".join([table, f"{'machining':21}{machining}", f"{'pulses':21}{pulses}"])


def render_ratios(ratios: RatiosView, decimals: int = 1) -> str:
    """Return the shares of the four pulse classes in words."""
    shares = (
        ("open", ratios.open),
        ("normal", ratios.normal),
        ("arc", ratios.arc),
        ("short", ratios.short),
    )
    return ", ".join(f"{percent(share, decimals)} {name}" for name, share in shares)
