"""What a job will take, and what a profile makes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from edmctl.dataclasses import asdict, dataclass
from edmctl.results.result import Result, html_table
from edmctl.wording import duration, facts, length


@dataclass(frozen=True, slots=True)
class RegimeForecast:
    """One regime of a hole: the depth that it ends at, its time, the tool wear in it, and the floor it leaves."""

    name: str
    depth_um: float
    machining_time_s: float
    wear_um: float
    ra_um: float


@dataclass(frozen=True, slots=True, repr=False)
class Forecast(Result):
    """Expected course of a job.

    Times, cuts, measuring stops and pulses are those of the whole job, as is `tool_wear_um`; depth, wear and feed
    are of its deepest hole or of its channel, whose cuts are its passes, `depth_min_um` is that of its shallowest
    hole. `holes_in_reach` are those, in working order, for which the stroke lasts. `limit_cycle_um` is the
    half-amplitude of the servo's swing; `channel_um` and `layers` are 0 where there is no channel. `depth_u95_um` is
    half the 95 % interval of the depth that will be known least, NaN where no depth is wanted. `side_gap_um`,
    `ra_um` and `rz_um` are the gap at the wall and the roughness Ra and Rz of the floor by the laws of the process.
    """

    machining_time_s: float
    measuring_time_s: float
    time_s: float
    cuts: int
    feed_rate_um_s: float
    feed_um: float
    depth_um: float
    depth_min_um: float
    wear_um: float
    stroke_um: float
    stroke_available_um: float
    loop_delay_s: float
    limit_cycle_um: float
    limit_cycle_period_s: float
    spark_energy_uj: float
    mrr_mm3_min: float
    jump_share: float
    pulses: int
    holes: int
    holes_in_reach: int
    stops: int
    tool_wear_um: float
    channel_um: float
    layers: int
    depth_u95_um: float
    side_gap_um: float
    ra_um: float
    rz_um: float
    regimes: tuple[RegimeForecast, ...] = ()
    error: ClassVar[None] = None  # type: ignore[misc]

    def as_mapping(self) -> Mapping[str, object]:
        """Return what `--dry-run --json` tells."""
        return asdict(self)

    def _repr_html_(self) -> str:
        times = {"time": self.time_s, "machining": self.machining_time_s, "measuring": self.measuring_time_s}
        lines = [(name, duration(time_s)) for name, time_s in times.items()]
        return html_table((), [*lines, *facts(self.as_mapping())], None)

    def brief(self) -> list[str]:
        """Return time, depth and tool wear."""
        return [
            duration(self.time_s),
            f"depth {length(self.depth_um)}",
            f"tool wear {length(self.tool_wear_um)}",
        ]


@dataclass(frozen=True, slots=True)
class ProfileSummary:
    """A profile and its forecast, `materials` as tool → work.

    `refused` says why the machine cannot run it, and the forecast is None then.
    """

    profile: str
    name: str
    description: str
    materials: str
    time_s: float | None
    depth_um: float | None
    holes: int | None
    channel_um: float | None
    tool_wear_um: float | None
    refused: str = ""
