"""The calibration file: TOML with a hash, written atomically, checked when it is read.

The arrays are those of `ActuatorModel`; numbers are read back exactly.
"""

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from edmctl.actuator.identification import Identification
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.validation import ErrorFigures
from edmctl.array_types import Array
from edmctl.errors import ProfileError, RecordError, RunFileError
from edmctl.files import open_regular
from edmctl.profile.calibration_bounds import contradictions
from edmctl.profile.positions import Source, Sources, TomlTable
from edmctl.profile.read import parse, read_source
from edmctl.profile.tables import ONE_LINE, Table

SCHEMA: Final = "edmctl-calibration/1"
BEYOND_PLAYS: Final = "edmctl-calibration/2"
"""Of a model with rounded plays or a lag, which readers of the first number do not know."""
HASH = "sha256"
AGAIN = "Run edmctl calibrate again."


MOST = 1e9
"""Larger figures than any that is measured; their squares are still numbers."""
Words = Annotated[str, Field(pattern=ONE_LINE, max_length=1000)]


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
    rounded_limits_v: list[list[float]] | None = Field(
        None, description="k × 2 limits of the rounded plays' stops, rising and falling, V; absent: none"
    )
    rounded_sharpness: list[float] | None = Field(
        None, description="k numbers from 0 to 1: how sharply a stop bends into its limit"
    )
    rounded_unloading: list[float] | None = Field(
        None, description="k numbers, not negative: how much steeper a stop unloads than it begins to load"
    )
    rounded_um_per_v: list[float] | None = Field(
        None, description="k weights of the rounded plays, not negative, µm/V"
    )
    lag_s: float | None = Field(None, description="time constant of amplifier and actuator, s; absent: none")


class Figures(Table):
    """Errors of a model on measured displacements."""

    max_um: float = Field(ge=0.0, le=MOST, description="largest error, µm")
    rms_um: float = Field(ge=0.0, le=MOST, description="RMS error, µm")
    max_pct: float = Field(ge=0.0, le=MOST, description="largest error, % of the range")
    rms_pct: float = Field(ge=0.0, le=MOST, description="RMS error, % of the range")
    range_um: float = Field(gt=0.0, le=MOST, description="range of the measured displacement, µm")


class ValidationFigures(Figures):
    """Errors of the model on one validation file."""

    name: str = Field(pattern=ONE_LINE, description="its name, without the folder")
    judged_from_s: float = Field(description="its time from which on errors count, s")
    gain: float = Field(description="gain that was set for it before; 1: none")
    zero_um: float = Field(description="zero that was set for it before, µm")


class Spread(Table):
    """Standard uncertainties (one sd) from refits to resampled blocks."""

    displacement_sd_um: float = Field(
        ge=0.0, le=MOST, description="of the displacement, mean over the records, µm"
    )
    displacement_sd_max_um: float = Field(ge=0.0, le=MOST, description="the same, largest, µm")
    gain_sd_um_per_v: float = Field(ge=0.0, le=MOST, description="of the gain, µm/V")
    loop_width_sd: float = Field(ge=0.0, le=MOST, description="of the loop's width, relative to the stroke")
    gamma_sd_per_decade: float = Field(
        ge=0.0, le=MOST, description="of the creep, relative, per decade of time"
    )


class Quality(Table):
    """How good the model is."""

    accepted: bool = Field(description="whether nothing stands against using it")
    problems: list[Words] = Field(description="what stands against it, each with its remedy", max_length=100)
    restrictions: list[Words] | None = Field(
        None, description="what an acceptance is limited to; absent: nothing", max_length=100
    )
    notes: list[Words] = Field(description="what else to know", max_length=100)
    samples: int = Field(ge=1, description="samples that it was fitted to")
    stroke_um: float = Field(gt=0.0, description="displacement between the ends of the range, µm")
    gain_um_per_v: float = Field(gt=0.0, description="stroke over range of voltage, µm/V")
    loop_width: float = Field(description="opening of the full loop, relative to the stroke")
    gamma_per_decade: float = Field(description="creep after a step, relative, per decade of time")
    train: Figures = Field(description="errors on the records that it was fitted to")
    held_out: Figures = Field(description="errors on blocks of them that it did not see")
    held_out_records: Figures | None = Field(
        None, description="errors on whole records that it did not see; absent: no record is like the others"
    )
    validation: list[ValidationFigures] | None = Field(
        None, description="errors on each validation file; absent: none was given", max_length=1000
    )
    bands: Spread = Field(description="standard uncertainties of the above")


class Calibration(Table):
    """A calibration file, without its hash."""

    schema_name: Literal["edmctl-calibration/1", "edmctl-calibration/2"] = Field(alias="schema")
    made: Made
    actuator: Parameters = Field(alias="model")
    quality: Quality
    baselines: dict[Words, Figures] = Field(
        {}, max_length=100, description="errors of simpler models, on blocks that these did not see"
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
    rounded_um_per_v = written.rounded_um_per_v or []
    k = len(rounded_um_per_v)
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
        rounded_limits_v=floats(written.rounded_limits_v or [], (k, 2)),
        rounded_sharpness=floats(written.rounded_sharpness or [], (k,)),
        rounded_unloading=floats(written.rounded_unloading or [], (k,)),
        rounded_um_per_v=floats(rounded_um_per_v, (k,)),
        lag_s=written.lag_s or 0.0,
    )


def measured_file(path: Path, samples: int, previous_v: float | None = None) -> MeasuredFile:
    """Name a file of measured data by its content."""
    with open_regular(path) as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return MeasuredFile(name=path.name, sha256=digest, samples=samples, previous_v=previous_v)


def calibration_of(
    identification: Identification,
    made: Made,
    baselines: Mapping[str, ErrorFigures] | None = None,
    validation: Sequence[Mapping[str, object]] = (),
) -> Calibration:
    """Return the content of a file. `baselines` are held-out errors by model, `validation` figures by file."""
    found, bands, whole = identification.model, identification.bands, identification.held_out_records
    saved = ValidationFigures.model_fields
    quality = Quality(
        accepted=identification.accepted,
        problems=list(identification.problems),
        restrictions=list(identification.restrictions) or None,
        notes=list(identification.notes),
        samples=identification.samples,
        stroke_um=found.stroke_um,
        gain_um_per_v=found.gain_um_per_v,
        loop_width=found.loop_width,
        gamma_per_decade=found.gamma_per_decade,
        train=_figures(identification.train),
        held_out=_figures(identification.held_out),
        held_out_records=None if whole is None else _figures(whole),
        validation=[ValidationFigures.model_validate({key: one[key] for key in saved}) for one in validation]
        or None,
        bands=Spread.model_validate(bands, from_attributes=True),
    )
    arrays = {name: getattr(found, name) for name in Parameters.model_fields}
    plain = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in arrays.items()
    }
    absent = [name for name in plain if Parameters.model_fields[name].default is None and not plain[name]]
    for name in absent:
        plain[name] = None
    beyond = len(found.rounded_um_per_v) > 0 or found.lag_s > 0.0
    return Calibration(
        schema=BEYOND_PLAYS if beyond else SCHEMA,
        made=made,
        model=Parameters(**plain),
        quality=quality,
        baselines={name: _figures(errors) for name, errors in (baselines or {}).items()},
    )


def load_calibration(path: Path) -> Calibration:
    """Read and check a calibration file.

    Raises RecordError: E3640 it cannot be read, E3641 it is not TOML, E3642 it is of another schema, E3643 it is not
    as it was written, E3644 its model cannot be used.
    """
    source, table = _read(path)
    _check_schema(path, source, table)
    written = table.pop(HASH, None)
    if written != content_hash(table):
        what = "was edited or damaged: its content does not have the hash that it says"
        raise RecordError(f"{path} {what}.", hint=AGAIN, code="E3643", where=_sources(source).value((HASH,)))
    try:
        calibration = Calibration.model_validate(table)
        quality = calibration.quality
        others: list[tuple[str, Figures]] = [("validation", one) for one in quality.validation or ()]
        if quality.held_out_records is not None:
            others.append(("held_out_records", quality.held_out_records))
        for wrong in contradictions(quality, calibration.model(), others):
            raise ValueError(f"it cannot be of an actuator that feeds a tool: {wrong}")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(part) for part in first["loc"])
        message, where = f"{path}: {key}: {first['msg']}", _sources(source).value(first["loc"])
    except ValueError as error:
        message, where = f"{path}: {error}", _sources(source).value(("model",))
    else:
        return calibration
    raise RecordError(f"{message}.", hint=AGAIN, code="E3644", where=where)


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration file, whole or not at all, in the place of what was there.

    Its folder is made where there is none. Raises RunFileError E9012 when it cannot be written.
    """
    import tomli_w

    table = calibration.table()
    text = tomli_w.dumps({"schema": table.pop("schema"), HASH: calibration.sha256, **table})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    except OSError as error:
        raise RunFileError(
            f"Cannot write the calibration file {path}: {error.strerror or error}.",
            hint="Check that its folder can be written and has space, or name another file with --output.",
            code="E9012",
        ) from error


def write_whole(path: Path, content: bytes) -> None:
    """Put a file of that content under the name, by way of a file beside it."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise


def _read(path: Path) -> tuple[Source, TomlTable]:
    try:
        source = read_source(path)
    except (ProfileError, ValueError) as error:
        hint = f"Check the path, or make the file: edmctl calibrate --output {path}."
        message = error.message if isinstance(error, ProfileError) else f"cannot read {path}: {error}"
        raise RecordError(f"{message}.", hint=hint, code="E3640") from error
    try:
        return source, parse(source)
    except ProfileError as error:
        what = f"{path} is no calibration file: {error.message}"
        raise RecordError(f"{what}.", hint=AGAIN, code="E3641", where=error.where) from error


def _check_schema(path: Path, source: Source, table: TomlTable) -> None:
    found = table.get("schema")
    if found in (SCHEMA, BEYOND_PLAYS):
        return
    version = re.fullmatch(r"edmctl-calibration/(\d+)", found) if isinstance(found, str) else None
    if version is None:
        what, hint = (
            "is no calibration file",
            f"A calibration file says schema = {json.dumps(SCHEMA)}. {AGAIN}",
        )
    else:
        what, hint = (
            f"has the schema {found}, and this edmctl reads {SCHEMA} and {BEYOND_PLAYS}",
            "Update edmctl, or run edmctl calibrate again.",
        )
    where = _sources(source).value(("schema",))
    raise RecordError(f"{path} {what}.", hint=hint, code="E3642", where=where)


def _sources(source: Source) -> Sources:
    return Sources((source,), source)


def _figures(errors: ErrorFigures) -> Figures:
    return Figures.model_validate(errors, from_attributes=True)
