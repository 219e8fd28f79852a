"""The drift file: what `edmctl measure-drift` has measured, hashed and checked like a calibration file."""

import math
from datetime import UTC, datetime
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field

from edmctl.process.rest_drift import LEAST_TOUCHES, TIME_CONSTANTS_S, DriftModel, refuse_creep
from edmctl.process.touches import share_u
from edmctl.profile.hashed_file import HashedTable
from edmctl.profile.tables import ONE_LINE, Line, Table, entry
from edmctl.results.measurements import DriftResult

SCHEMA: Final = "edmctl-drift/1"
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
    share_u: float = entry(..., "standard uncertainty of that", ge=0.0, le=1.0)
    apart_u_um_per_s: float = entry(..., "of a drift that only touches see, µm/s", ge=0.0, le=1.0)
    walk_um_per_sqrt_s: float = entry(..., "random walk of the sensor's zero, µm/√s", ge=0.0, le=10.0)
    time_constants_s: list[float] = entry(..., "n time constants of creep, s")
    creep: list[float] = entry(..., "n weights of their lags in a rest")
    creep_covariance: list[list[float]] = entry(..., "n × n covariance of the weights")


class DriftFile(HashedTable):
    """A drift file, without its hash."""

    kind = "drift file"
    schemas = (SCHEMA,)
    again = "Run edmctl measure-drift again, or say use = false under [drift] in the setup."
    missing = f"Check the path. {again}"
    codes = ("E3670", "E3671", "E3672", "E3673", "E3674", "E9013")

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
            raise ValueError(
                f"its time constants are not {', '.join(f'{tau:g}' for tau in TIME_CONSTANTS_S)} s"
            )
        if {len(used.creep), len(used.creep_covariance), *map(len, used.creep_covariance)} != {n}:
            raise ValueError("its arrays do not fit each other")
        creep, covariance = np.array(used.creep), np.array(used.creep_covariance)
        refuse_creep(creep, covariance)
        uncertain = used.share_u, used.apart_u_um_per_s, used.walk_um_per_sqrt_s
        return DriftModel(creep, covariance, used.share, *uncertain)

    def check(self) -> None:
        """Raise ValueError if the values in use do not follow from the measured ones (`model_of`)."""
        self.model()
        measured, used = self.measured, self.used
        touch, rest = measured.touch_um_per_s, measured.rest_um_per_s
        if not measured.rests > measured.touches >= LEAST_TOUCHES:
            raise ValueError(f"{measured.touches} touches and {measured.rests} rests are too few")
        if used.apart_u_um_per_s < (1.0 - ROUNDING) * abs(touch - rest):
            raise ValueError(
                f"touches have drifted by {abs(touch - rest):.3g} µm/s more or less than rests, and jobs would use "
                f"{used.apart_u_um_per_s:.3g} µm/s"
            )
        ratio = touch / rest if rest else math.nan
        is_unknown = used.share == 1.0 and used.share_u >= (1.0 - ROUNDING) * share_u(1.0)
        is_measured = (
            math.isclose(used.share * rest, touch, rel_tol=ROUNDING)
            or (used.share == 0.0 and ratio <= 0.0)  # touches drift the opposite way
            or (used.share == 1.0 and ratio >= 1.0)
        )
        if not (is_unknown or (is_measured and used.share_u > 0.0)):
            raise ValueError(
                f"a share of {used.share:.3g} ± {used.share_u:.3g} does not come of drifts of {touch:.3g} and "
                f"{rest:.3g} µm/s"
            )


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
