"""The drift file: what `edmctl measure-drift` has told of a machine, hashed and checked like a calibration file."""

import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from edmctl.errors import ProfileError, RecordError, RunFileError
from edmctl.process.rest_drift import LEAST_TOUCHES, TIME_CONSTANTS_S, DriftModel, refuse_creep
from edmctl.process.touches import share_u
from edmctl.profile.calibration import HASH, content_hash, write_whole
from edmctl.profile.read import parse, read_source
from edmctl.profile.tables import ONE_LINE, Table
from edmctl.results.measurements import DriftResult

SCHEMA: Final = "edmctl-drift/1"
AGAIN = "Run edmctl measure-drift again, or say use = false under [drift] in the setup."
MOST_SHARE_U = 1.0
ROUNDING = 1e-6
"""Relative, of numbers that follow from one another."""


class MadeBy(Table):
    """When, with what and of what it was made."""

    utc: str = Field(pattern=ONE_LINE, description="time, ISO 8601")
    edmctl: str = Field(pattern=ONE_LINE, description="version of edmctl")
    serial: str = Field(pattern=ONE_LINE, min_length=1, description="serial number of the machine")
    simulated: bool = Field(False, description="true: of a virtual machine")
    run_file: str = Field(pattern=ONE_LINE, description="name of the run file with rests and touches")


class Measured(Table):
    """What was measured; uncertainties are standard uncertainties."""

    rest_um_per_s: float = Field(ge=-1.0, le=1.0, description="drift of the rests without creep, µm/s")
    rest_u_um_per_s: float = Field(ge=0.0, le=1.0, description="of that")
    touch_um_per_s: float = Field(ge=-1.0, le=1.0, description="drift of the touches, µm/s")
    touch_u_um_per_s: float = Field(ge=0.0, le=1.0, description="of that")
    touches: int = Field(ge=1, le=100_000, description="touches of the pad")
    rests: int = Field(ge=2, le=100_000, description="rests at 0 V")
    misfit: float = Field(ge=1.0, le=10.0, description="residuals over what was expected, at least 1")


class Used(Table):
    """What jobs go by."""

    share: float = Field(ge=0.0, le=1.0, description="of the drift of the rests that a touch sees")
    share_u: float = Field(ge=0.0, le=MOST_SHARE_U, description="standard uncertainty of that")
    apart_u_um_per_s: float = Field(
        ge=0.0, le=1.0, description="standard uncertainty of a drift that touches see and rests do not, µm/s"
    )
    walk_um_per_sqrt_s: float = Field(
        ge=0.0, le=10.0, description="random walk of the sensor's zero, µm per square root of a second"
    )
    time_constants_s: list[float] = Field(description="n time constants of creep, s")
    creep: list[float] = Field(description="n weights of their lags in a rest")
    creep_covariance: list[list[float]] = Field(description="n × n covariance of the weights")


class DriftFile(Table):
    """A drift file, without its hash."""

    schema_name: Literal["edmctl-drift/1"] = Field(alias="schema")
    made: MadeBy
    measured: Measured
    used: Used

    @property
    def sha256(self) -> str:
        """Hash of its content, as it stands in the file."""
        return content_hash(self.table())

    def table(self) -> dict[str, object]:
        """Return the content as TOML holds it, without the hash."""
        return self.model_dump(by_alias=True, exclude_none=True)

    def age_s(self) -> float:
        """How long ago it was measured by the clock, s; NaN where it does not say."""
        try:
            made = datetime.fromisoformat(self.made.utc)
        except ValueError:
            return math.nan
        if made.tzinfo is None:
            return math.nan
        return (datetime.now(UTC) - made).total_seconds()

    def model(self) -> DriftModel:
        """Return what jobs go by. Raises ValueError where its arrays cannot be."""
        used, n = self.used, len(TIME_CONSTANTS_S)
        if tuple(used.time_constants_s) != TIME_CONSTANTS_S:
            raise ValueError(
                f"its time constants are not {', '.join(f'{tau:g}' for tau in TIME_CONSTANTS_S)} s"
            )
        try:
            creep, covariance = np.array(used.creep), np.array(used.creep_covariance)
        except ValueError:
            raise ValueError("its arrays do not fit each other") from None
        if creep.shape != (n,) or covariance.shape != (n, n):
            raise ValueError("its arrays do not fit each other")
        refuse_creep(creep, covariance)
        self._refuse_contradictions()
        return DriftModel(
            creep,
            covariance,
            used.share,
            used.share_u,
            used.apart_u_um_per_s,
            used.walk_um_per_sqrt_s,
        )

    def _refuse_contradictions(self) -> None:
        """Raise ValueError where jobs would go by what was not measured (`model_of` makes the one of the other)."""
        found, used = self.measured, self.used
        if not found.rests > found.touches >= LEAST_TOUCHES:
            raise ValueError(f"{found.touches} touches and {found.rests} rests tell no drift")
        apart_um_per_s = abs(found.touch_um_per_s - found.rest_um_per_s)
        if used.apart_u_um_per_s < (1.0 - ROUNDING) * apart_um_per_s:
            raise ValueError(
                f"touches have drifted by {apart_um_per_s:.3g} µm/s more or less than rests, and jobs would go by "
                f"{used.apart_u_um_per_s:.3g} µm/s"
            )
        untold = used.share == 1.0 and used.share_u >= (1.0 - ROUNDING) * share_u(1.0)
        seen_um_per_s = used.share * found.rest_um_per_s
        beyond = used.share in (0.0, 1.0) and _beyond(found.touch_um_per_s, found.rest_um_per_s, used.share)
        told = beyond or math.isclose(seen_um_per_s, found.touch_um_per_s, rel_tol=ROUNDING)
        if not (untold or (told and used.share_u > 0.0)):
            raise ValueError(
                f"a share of {used.share:.3g} ± {used.share_u:.3g} does not come of drifts of "
                f"{found.touch_um_per_s:.3g} and {found.rest_um_per_s:.3g} µm/s"
            )


def _beyond(touch_um_per_s: float, rest_um_per_s: float, share: float) -> bool:
    """Whether touches have drifted the opposite way, share 0, or by more than rests, share 1."""
    ratio = touch_um_per_s / rest_um_per_s if rest_um_per_s else math.nan
    return ratio <= 0.0 if share == 0.0 else ratio >= 1.0


def drift_file(made: MadeBy, result: DriftResult, model: DriftModel) -> DriftFile:
    """Turn a measurement into the content of a file."""
    return DriftFile(
        schema=SCHEMA,
        made=made,
        measured=Measured(**{name: getattr(result, name) for name in Measured.model_fields}),
        used=Used(
            share=model.share,
            share_u=model.share_u,
            apart_u_um_per_s=model.apart_u_um_per_s,
            walk_um_per_sqrt_s=model.walk_um_per_sqrt_s,
            time_constants_s=list(TIME_CONSTANTS_S),
            creep=model.creep.tolist(),
            creep_covariance=model.creep_covariance.tolist(),
        ),
    )


def load_drift(path: Path) -> DriftFile:
    """Read and check a drift file.

    Raises RecordError: E3670 it cannot be read, E3671 it is not TOML, E3672 it is of another schema, E3673 it is not
    as it was written, E3674 it holds what cannot be.
    """
    try:
        source = read_source(path)
    except (ProfileError, ValueError) as error:
        message = error.message if isinstance(error, ProfileError) else f"cannot read {path}: {error}"
        raise RecordError(f"{message}.", hint=f"Check the path. {AGAIN}", code="E3670") from error
    try:
        table = parse(source)
    except ProfileError as error:
        what = f"{path} is no drift file: {error.message}"
        raise RecordError(f"{what}.", hint=AGAIN, code="E3671", where=error.where) from error
    if table.get("schema") != SCHEMA:
        raise RecordError(
            f"{path} is no drift file that this edmctl reads, which says schema = {json.dumps(SCHEMA)}.",
            hint=AGAIN,
            code="E3672",
        )
    if table.pop(HASH, None) != content_hash(table):
        what = "was edited or damaged: its content does not have the hash that it says"
        raise RecordError(f"{path} {what}.", hint=AGAIN, code="E3673")
    try:
        found = DriftFile.model_validate(table)
        found.model()
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        message = f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}"
    except ValueError as error:
        message = str(error)
    else:
        return found
    raise RecordError(f"{path}: {message}.", hint=AGAIN, code="E3674")


def save_drift(path: Path, found: DriftFile) -> None:
    """Write a drift file, whole or not at all. Raises RunFileError E9013 when it cannot be written."""
    import tomli_w

    table = found.table()
    text = tomli_w.dumps({"schema": table.pop("schema"), HASH: found.sha256, **table})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text.encode())
    except OSError as error:
        raise RunFileError(
            f"Cannot write the drift file {path}: {error.strerror or error}.",
            hint="Check that its folder can be written and has space, or name another file with --output.",
            code="E9013",
        ) from error
