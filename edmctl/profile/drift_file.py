"""The drift file: what `edmctl measure-drift` has measured, hashed and checked like a calibration file."""

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field

from edmctl.process.rest_drift import LEAST_TOUCHES, TIME_CONSTANTS_S, DriftModel, refuse_creep
from edmctl.process.touches import share_u
from edmctl.profile.hashed_file import FileKind, HashedTable
from edmctl.profile.tables import ONE_LINE, Line, Table, entry
from edmctl.results.measurements import DriftResult

SCHEMA: Final = "edmctl-drift/1"
AGAIN: Final = "Run edmctl measure-drift again, or say use = false under [drift] in the setup."
FILE: Final = FileKind(
    "drift file",
    (SCHEMA,),
    again=AGAIN,
    missing=f"Check the path. {AGAIN}",
    codes=("E3670", "E3671", "E3672", "E3673", "E3674"),
    write_code="E9013",
)
MOST_SHARE_U = 1.0
ROUNDING = 1e-6  # relative, of numbers that follow from one another


class MadeBy(Table):
    """When, with what and of what it was made."""

    utc: Line = entry(..., "time, ISO 8601")
    edmctl: Line = entry(..., "version of edmctl")
    serial: str = entry(..., "serial number of the machine", pattern=ONE_LINE, min_length=1)
    simulated: bool = entry(False, "true: of a virtual machine")
    run_file: Line = entry(..., "name of the run file with rests and touches")


class Measured(Table):
    """What was measured; uncertainties are standard uncertainties."""

    rest_um_per_s: float = entry(..., "drift of the rests without creep, µm/s", ge=-1.0, le=1.0)
    rest_u_um_per_s: float = entry(..., "of that", ge=0.0, le=1.0)
    touch_um_per_s: float = entry(..., "drift of the touches, µm/s", ge=-1.0, le=1.0)
    touch_u_um_per_s: float = entry(..., "of that", ge=0.0, le=1.0)
    touches: int = entry(..., "touches of the pad", ge=1, le=100_000)
    rests: int = entry(..., "rests at 0 V", ge=2, le=100_000)
    misfit: float = entry(..., "residuals over what was expected, at least 1", ge=1.0, le=10.0)


class Used(Table):
    """The values that correct jobs."""

    share: float = entry(..., "of the drift of the rests that a touch sees", ge=0.0, le=1.0)
    share_u: float = entry(..., "standard uncertainty of that", ge=0.0, le=MOST_SHARE_U)
    apart_u_um_per_s: float = entry(
        ..., "standard uncertainty of a drift that touches see and rests do not, µm/s", ge=0.0, le=1.0
    )
    walk_um_per_sqrt_s: float = entry(
        ..., "random walk of the sensor's zero, µm per square root of a second", ge=0.0, le=10.0
    )
    time_constants_s: list[float] = entry(..., "n time constants of creep, s")
    creep: list[float] = entry(..., "n weights of their lags in a rest")
    creep_covariance: list[list[float]] = entry(..., "n × n covariance of the weights")


class DriftFile(HashedTable):
    """A drift file, without its hash."""

    schema_name: Literal["edmctl-drift/1"] = Field(alias="schema")
    made: MadeBy
    measured: Measured
    used: Used

    def age_s(self) -> float:
        """How long ago it was measured by the clock, s; NaN where it does not say."""
        try:
            return (datetime.now(UTC) - datetime.fromisoformat(self.made.utc)).total_seconds()
        except (ValueError, TypeError):  # no time, or one without a zone
            return math.nan

    def model(self) -> DriftModel:
        """Return the model that corrects jobs. Raises ValueError where its arrays cannot be."""
        used, n = self.used, len(TIME_CONSTANTS_S)
        if tuple(used.time_constants_s) != TIME_CONSTANTS_S:
            wanted = ", ".join(f"{tau:g}" for tau in TIME_CONSTANTS_S)
            raise ValueError(f"its time constants are not {wanted} s")
        lengths = (len(used.creep), len(used.creep_covariance), *map(len, used.creep_covariance))
        if set(lengths) != {n}:
            raise ValueError("its arrays do not fit each other")
        creep, covariance = np.array(used.creep), np.array(used.creep_covariance)
        refuse_creep(creep, covariance)
        self._refuse_contradictions()
        uncertain = used.share_u, used.apart_u_um_per_s, used.walk_um_per_sqrt_s
        return DriftModel(creep, covariance, used.share, *uncertain)

    def _refuse_contradictions(self) -> None:
        """Raise ValueError if the values in use do not follow from the measured ones (`model_of`)."""
        found, used = self.measured, self.used
        if not found.rests > found.touches >= LEAST_TOUCHES:
            raise ValueError(f"{found.touches} touches and {found.rests} rests tell no drift")
        apart_um_per_s = abs(found.touch_um_per_s - found.rest_um_per_s)
        if used.apart_u_um_per_s < (1.0 - ROUNDING) * apart_um_per_s:
            drifted = f"touches have drifted by {apart_um_per_s:.3g} µm/s more or less than rests"
            raise ValueError(f"{drifted}, and jobs would go by {used.apart_u_um_per_s:.3g} µm/s")
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
    """Whether touches drift the opposite way (share 0), or more than the rests (share 1)."""
    ratio = touch_um_per_s / rest_um_per_s if rest_um_per_s else math.nan
    return ratio <= 0.0 if share == 0.0 else ratio >= 1.0


def drift_file(made: MadeBy, result: DriftResult, model: DriftModel) -> DriftFile:
    """Turn a measurement into the content of a file."""
    used: dict[str, Any] = {"time_constants_s": list(TIME_CONSTANTS_S)}
    for name in Used.model_fields.keys() - used:
        value = getattr(model, name)
        used[name] = value.tolist() if isinstance(value, np.ndarray) else value
    return DriftFile(
        schema=SCHEMA,
        made=made,
        measured=Measured(**{name: getattr(result, name) for name in Measured.model_fields}),
        used=Used(**used),
    )


def load_drift(path: Path) -> DriftFile:
    """Read and check a drift file.

    Raises RecordError: E3670 it cannot be read, E3671 it is not TOML, E3672 it has another schema, E3673 it was
    edited, E3674 it holds impossible values.
    """
    return FILE.load(path, DriftFile, DriftFile.model)


def save_drift(path: Path, found: DriftFile) -> None:
    """Write a drift file and its folder, whole or not at all. Raises RunFileError E9013."""
    FILE.save(path, found)
