"""The calibration file: made of an identification, written whole or not at all, checked when it is read,
and where it is kept.

TOML, so that people can read it, and hashed, because a model that was edited or cut short would still move the
tool.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import ValidationError

from edmctl.errors import ProfileError, RecordError, RunFileError
from edmctl.files import open_regular
from edmctl.profile.calibration_tables import (
    Calibration,
    Figures,
    Made,
    MeasuredFile,
    Parameters,
    Quality,
    Spread,
    content_hash,
)
from edmctl.profile.positions import Sources
from edmctl.profile.read import parse, read_source

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from edmctl.actuator.identification import Identification
    from edmctl.actuator.validation import ErrorFigures
    from edmctl.profile.positions import Source, TomlTable


SCHEMA: Final = "edmctl-calibration/1"
HASH = "sha256"
AGAIN = "Run edmctl calibrate again."


def measured_file(path: Path, samples: int, previous_v: float | None = None) -> MeasuredFile:
    """Name a file of measured data by its content."""
    with open_regular(path) as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return MeasuredFile(name=path.name, sha256=digest, samples=samples, previous_v=previous_v)


def calibration_of(
    identification: Identification, made: Made, baselines: Mapping[str, ErrorFigures] | None = None
) -> Calibration:
    """Turn an identification into the content of a file. `baselines` are held-out errors by model."""
    found, bands = identification.model, identification.bands
    quality = Quality(
        accepted=identification.accepted,
        problems=list(identification.problems),
        notes=list(identification.notes),
        samples=identification.samples,
        stroke_um=found.stroke_um,
        gain_um_per_v=found.gain_um_per_v,
        loop_width=found.loop_width,
        gamma_per_decade=found.gamma_per_decade,
        train=_figures(identification.train),
        held_out=_figures(identification.held_out),
        bands=Spread.model_validate(bands, from_attributes=True),
    )
    arrays = {name: getattr(found, name) for name in Parameters.model_fields}
    plain = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in arrays.items()
    }
    return Calibration(
        schema=SCHEMA,
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
        calibration.model()
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
        _replace(path, text.encode())
    except OSError as error:
        raise RunFileError(
            f"Cannot write the calibration file {path}: {error.strerror or error}.",
            hint="Check that its folder can be written and has space, or name another file with --output.",
            code="E9012",
        ) from error


def _replace(path: Path, content: bytes) -> None:
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
    if found == SCHEMA:
        return
    version = re.fullmatch(r"edmctl-calibration/(\d+)", found) if isinstance(found, str) else None
    if version is None:
        what, hint = (
            "is no calibration file",
            f"A calibration file says schema = {json.dumps(SCHEMA)}. {AGAIN}",
        )
    else:
        what, hint = (
            f"has the schema {found}, and this edmctl reads {SCHEMA}",
            "Update edmctl, or run edmctl calibrate again.",
        )
    where = _sources(source).value(("schema",))
    raise RecordError(f"{path} {what}.", hint=hint, code="E3642", where=where)


def _sources(source: Source) -> Sources:
    return Sources((source,), source)


def _figures(errors: ErrorFigures) -> Figures:
    return Figures.model_validate(errors, from_attributes=True)
