"""The tables of a calibration file: a model, how good it is, and what it was made of.

The arrays are those of `ActuatorModel`; numbers are written so that they are read back exactly.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from edmctl.actuator.model import ActuatorModel
from edmctl.profile.tables import ONE_LINE, Table

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class MeasuredFile(Table):
    """A file that the model was identified from."""

    name: str = Field(pattern=ONE_LINE, description="its name, without the folder")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="of its bytes")
    samples: int = Field(ge=1, description="samples in it")
    previous_v: float | None = Field(None, description="held before its first sample, V; absent: conditioned")


class Made(Table):
    """When, with what and of what the calibration was made."""

    utc: str = Field(pattern=ONE_LINE, description="time, ISO 8601")
    edmctl: str = Field(pattern=ONE_LINE, description="version of edmctl")
    serial: str | None = Field(
        None, pattern=ONE_LINE, description="serial number of the machine; absent when it is not known"
    )
    simulated: bool = Field(False, description="true: of a virtual machine")
    records: list[MeasuredFile] = Field([], description="measured files; none when a machine was driven")


class Parameters(Table):
    """Parameters of `ActuatorModel`: n plays of m pieces, g creeping plays with j time constants."""

    thresholds_v: list[float] = Field(description="thresholds of the n plays, ascending from 0, V")
    knots_v: list[list[float]] = Field(description="n × (m + 1) ends of each play's pieces, ascending, V")
    slopes_um_per_v: list[list[float]] = Field(
        description="n × m slopes, not negative, those of the first play positive, µm/V"
    )
    creep_plays: list[Annotated[int, Field(ge=0, lt=10_000)]] = Field(
        description="g plays that creep, counted from 0"
    )
    time_constants_s: list[float] = Field(description="j time constants of creep, s")
    creep_um_per_v: list[list[float]] = Field(description="g × j weights of creep, not negative, µm/V")
    zero_um: float = Field(
        description="added to every displacement: the zero of the last record's sensor, µm"
    )
    delay_s: float = Field(description="delay of the displacement, s")
    low_v: float = Field(description="lowest voltage of the records, V")
    high_v: float = Field(description="highest voltage of the records, V")


class Figures(Table):
    """Errors of a model on measured displacements."""

    max_um: float = Field(ge=0.0, description="largest error, µm")
    rms_um: float = Field(ge=0.0, description="RMS error, µm")
    max_pct: float = Field(ge=0.0, description="largest error, % of the range")
    rms_pct: float = Field(ge=0.0, description="RMS error, % of the range")
    range_um: float = Field(gt=0.0, description="range of the measured displacement, µm")


class Spread(Table):
    """Standard uncertainties (one sd) from refits to resampled blocks."""

    displacement_sd_um: float = Field(ge=0.0, description="of the displacement, mean over the records, µm")
    displacement_sd_max_um: float = Field(ge=0.0, description="the same, largest, µm")
    gain_sd_um_per_v: float = Field(ge=0.0, description="of the gain, µm/V")
    loop_width_sd: float = Field(ge=0.0, description="of the loop's width, relative to the stroke")
    gamma_sd_per_decade: float = Field(ge=0.0, description="of the creep, relative, per decade of time")


class Quality(Table):
    """How good the model is."""

    accepted: bool = Field(description="whether nothing stands against using it")
    problems: list[str] = Field(description="what stands against it, each with its remedy")
    notes: list[str] = Field(description="what else to know")
    samples: int = Field(ge=1, description="samples that it was fitted to")
    stroke_um: float = Field(gt=0.0, description="displacement between the ends of the range, µm")
    gain_um_per_v: float = Field(gt=0.0, description="stroke over range of voltage, µm/V")
    loop_width: float = Field(description="opening of the full loop, relative to the stroke")
    gamma_per_decade: float = Field(description="creep after a step, relative, per decade of time")
    train: Figures = Field(description="errors on the records that it was fitted to")
    held_out: Figures = Field(description="errors on blocks of them that it did not see")
    bands: Spread = Field(description="standard uncertainties of the above")


class Calibration(Table):
    """A calibration file, without its hash."""

    schema_name: Literal["edmctl-calibration/1"] = Field(alias="schema")
    made: Made
    actuator: Parameters = Field(alias="model")
    quality: Quality
    baselines: dict[str, Figures] = Field(
        {}, description="errors of simpler models, on blocks that these did not see"
    )

    @property
    def serial(self) -> str | None:
        """Serial number of the machine that it was made on; None when it was made of files."""
        return self.made.serial

    @property
    def sha256(self) -> str:
        """Hash of its content, as it stands in the file."""
        return content_hash(self.table())

    def table(self) -> dict[str, object]:
        """Return the content as TOML holds it, without the hash."""
        return self.model_dump(by_alias=True, exclude_none=True)

    def model(self) -> ActuatorModel:
        """Return the model. Raises ValueError when its arrays do not fit or it could not be inverted."""
        return _model(self.actuator)


def content_hash(table: Mapping[str, object]) -> str:
    """SHA-256 of a table as JSON: keys sorted, no spaces, ASCII, numbers as short as they are read back exactly."""
    canonical = json.dumps(table, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


def _model(written: Parameters) -> ActuatorModel:
    def floats(values: list[float] | list[list[float]], shape: tuple[int, ...]) -> Array:
        try:
            return np.array(values, dtype=np.float64).reshape(shape)
        except ValueError:
            raise ValueError("the arrays of the model do not fit each other") from None

    n, g, j = len(written.thresholds_v), len(written.creep_plays), len(written.time_constants_s)
    return ActuatorModel(
        thresholds_v=floats(written.thresholds_v, (n,)),
        knots_v=floats(written.knots_v, (n, -1)),
        slopes_um_per_v=floats(written.slopes_um_per_v, (n, -1)),
        creep_plays=np.array(written.creep_plays, dtype=np.int64),
        time_constants_s=floats(written.time_constants_s, (j,)),
        creep_um_per_v=floats(written.creep_um_per_v, (g, j)),
        zero_um=written.zero_um,
        delay_s=written.delay_s,
        low_v=written.low_v,
        high_v=written.high_v,
    )
