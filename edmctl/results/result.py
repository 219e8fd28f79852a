"""What all results show of themselves to programs and notebooks, and the forecast of a job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar

from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import EdmError, installing
from edmctl.jsonout import JsonValue, to_json_value
from edmctl.wording import duration, facts, length

if TYPE_CHECKING:
    import pandas


MOST_FACTS = 4
"""As many values stand in a short representation."""


class Result:
    """Base of all results: a short representation, a table in a notebook, plain values, a frame of pandas."""

    __slots__ = ()

    error: EdmError | None
    """What ended it early, None where it came to its end."""

    def as_mapping(self) -> Mapping[str, object]:
        """Return the `result` of the JSON object."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, JsonValue]:
        """Return the same values as `--json` tells under `result`, rounded alike."""
        return {name: to_json_value(value, name) for name, value in self.as_mapping().items()}

    def rows(self) -> list[JsonValue]:
        """Return the rows of the result's table: one, unless it is a series of alike things."""
        return [self.to_dict()]

    def to_frame(self) -> pandas.DataFrame:
        """Return the rows as a frame, with units in the names of the columns. Raises ImportError without pandas."""
        return need_pandas().json_normalize(self.rows(), sep="_")

    def raise_for_error(self) -> None:
        """Raise the error that ended it, if one did."""
        if self.error is not None:
            raise self.error

    def brief(self) -> list[str]:
        """Return the words of the short representation."""
        return [f"{name} {value}" for name, value in facts(self.as_mapping())][:MOST_FACTS]

    def __repr__(self) -> str:
        words = [*self.brief(), *([f"{self.error.code}: {self.error.message}"] if self.error else [])]
        return f"<{type(self).__name__}: {', '.join(words) or 'nothing reached'}>"

    def _repr_html_(self) -> str:
        """The rows as a table for a notebook; a single one with a line a value."""
        rows = [dict(facts(row)) for row in self.rows() if isinstance(row, Mapping)]
        if len(rows) == 1:
            return html_table((), [*rows[0].items()], self.error)
        head = tuple(dict.fromkeys(name for row in rows for name in row))
        return html_table(head, [[row.get(name, "") for name in head] for row in rows], self.error)


def need_pandas() -> Any:
    """Return the package of frames. Raises ImportError with the command that installs it."""
    try:
        import pandas as pd
    except ImportError as error:
        message = f"A frame needs pandas, which is not installed: {installing('pandas')}."
        raise ImportError(message, name="pandas") from error
    return pd


def html_table(head: Sequence[str], lines: Sequence[Sequence[str]], error: EdmError | None) -> str:
    """Return a table for a notebook, with the error below it."""
    cells = [*([("th", head)] if head else []), *(("td", line) for line in lines)]
    rows = (f"<tr>{''.join(f'<{tag}>{escape(text)}</{tag}>' for text in line)}</tr>" for tag, line in cells)
    below = f"<p>{escape(error.code)}: {escape(error.message)}</p>" if error else ""
    return f"<table>{''.join(rows)}</table>{below}"


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

    Times, cuts, stops, pulses and `tool_wear_um` are those of the whole job; depth, wear and feed of its deepest
    hole or channel, whose cuts are its passes; `depth_min_um` of its shallowest hole. `holes_in_reach` are those, in
    working order, within the stroke. `limit_cycle_um` is the half-amplitude of the servo's swing. `depth_u95_um` is
    half the 95 % interval of the depth known least, NaN without a depth target. Gap and roughness are by the laws of
    the process.
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
