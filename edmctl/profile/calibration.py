"""The calibration file: TOML with a hash. Its arrays are those of `ActuatorModel`, read back exactly."""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from edmctl.actuator.acceptance import ACCEPTED_RMS_PCT, NOISY_MAX_PCT
from edmctl.actuator.identification import Identification
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.validation import ErrorFigures
from edmctl.files import open_regular
from edmctl.profile.hashed_file import HashedTable
from edmctl.profile.tables import ONE_LINE, Line, Table, entry

SCHEMA: Final = "edmctl-calibration/1"
BEYOND_PLAYS: Final = "edmctl-calibration/2"
"""Of a model with rounded plays or a lag, which readers of the first number do not know."""
MOST = 1e9  # larger figures than any that is measured; their squares are still numbers
Words = Annotated[str, Field(pattern=ONE_LINE, max_length=1000)]


class MeasuredFile(Table):
    """A file that the model was identified from."""

    name: Line = entry(..., "its name, without the folder")
    sha256: str = entry(..., "of its bytes", pattern=r"^[0-9a-f]{64}$")
    samples: int = entry(..., "samples in it", ge=1)
    previous_v: float | None = entry(None, "held before its first sample, V; absent: conditioned")


class Made(Table):
    """When, with what and of what the calibration was made."""

    utc: Line = entry(..., "time, ISO 8601")
    edmctl: Line = entry(..., "version of edmctl")
    serial: Line | None = entry(None, "serial number of the machine; absent when it is not known")
    simulated: bool = entry(False, "true: of a virtual machine")
    records: list[MeasuredFile] = entry([], "measured files; none when a machine was driven")


class Parameters(Table):
    """Parameters of `ActuatorModel`: n plays of m pieces, g creeping plays with j time constants."""

    thresholds_v: list[float] = entry(..., "thresholds of the n plays, ascending from 0, V")
    knots_v: list[list[float]] = entry(..., "n × (m + 1) ends of each play's pieces, ascending, V")
    slopes_um_per_v: list[list[float]] = entry(..., "n × m slopes ≥ 0, those of the first play > 0, µm/V")
    creep_plays: list[Annotated[int, Field(ge=0, lt=10_000)]] = entry(..., "g creeping plays, from 0")
    time_constants_s: list[float] = entry(..., "j time constants of creep, s")
    creep_um_per_v: list[list[float]] = entry(..., "g × j weights of creep, not negative, µm/V")
    zero_um: float = entry(..., "added to every displacement: the zero of the last record's sensor, µm")
    delay_s: float = entry(..., "delay of the displacement, s")
    low_v: float = entry(..., "lowest voltage of the records, V")
    high_v: float = entry(..., "highest voltage of the records, V")
    rounded_limits_v: list[list[float]] | None = entry(None, "k × 2 limits of rounded plays, V; absent: none")
    rounded_sharpness: list[float] | None = entry(None, "k bends of their stops into the limits, 0 to 1")
    rounded_unloading: list[float] | None = entry(None, "k factors ≥ 0: unloading over loading, less 1")
    rounded_um_per_v: list[float] | None = entry(None, "k weights of the rounded plays ≥ 0, µm/V")
    lag_s: float | None = entry(None, "time constant of amplifier and actuator, s; absent: none")


class Figures(Table):
    """Errors of a model on measured displacements."""

    max_um: float = entry(..., "largest error, µm", ge=0.0, le=MOST)
    rms_um: float = entry(..., "RMS error, µm", ge=0.0, le=MOST)
    max_pct: float = entry(..., "largest error, % of the range", ge=0.0, le=MOST)
    rms_pct: float = entry(..., "RMS error, % of the range", ge=0.0, le=MOST)
    range_um: float = entry(..., "range of the measured displacement, µm", gt=0.0, le=MOST)


class ValidationFigures(Figures):
    """Errors of the model on one validation file."""

    name: Line = entry(..., "its name, without the folder")
    judged_from_s: float = entry(..., "its time from which on errors count, s")
    gain: float = entry(..., "gain that was set for it before; 1: none")
    zero_um: float = entry(..., "zero that was set for it before, µm")


class Spread(Table):
    """Standard uncertainties (one sd) from refits to resampled blocks."""

    displacement_sd_um: float = entry(..., "of the displacement, mean over the records, µm", ge=0.0, le=MOST)
    displacement_sd_max_um: float = entry(..., "the same, largest, µm", ge=0.0, le=MOST)
    gain_sd_um_per_v: float = entry(..., "of the gain, µm/V", ge=0.0, le=MOST)
    loop_width_sd: float = entry(..., "of the loop's width, relative to the stroke", ge=0.0, le=MOST)
    gamma_sd_per_decade: float = entry(..., "of the creep, relative, per decade of time", ge=0.0, le=MOST)


class Quality(Table):
    """How good the model is."""

    accepted: bool = entry(..., "whether nothing stands against using it")
    problems: list[Words] = entry(..., "what stands against it, each with its remedy", max_length=100)
    restrictions: list[Words] | None = entry(None, "limits of an acceptance; absent: none", max_length=100)
    notes: list[Words] = entry(..., "what else to know", max_length=100)
    samples: int = entry(..., "samples that it was fitted to", ge=1)
    stroke_um: float = entry(..., "displacement between the ends of the range, µm", gt=0.0)
    gain_um_per_v: float = entry(..., "stroke over range of voltage, µm/V", gt=0.0)
    loop_width: float = entry(..., "opening of the full loop, relative to the stroke")
    gamma_per_decade: float = entry(..., "creep after a step, relative, per decade of time")
    train: Figures = entry(..., "errors on the records that it was fitted to")
    held_out: Figures = entry(..., "errors on blocks of them that it did not see")
    held_out_records: Figures | None = entry(None, "errors on whole records that it did not see, if any")
    validation: list[ValidationFigures] | None = entry(
        None, "errors on each validation file", max_length=1000
    )
    bands: Spread = entry(..., "standard uncertainties of the above")


class Calibration(HashedTable):
    """A calibration file, without its hash."""

    kind = "calibration file"
    schemas = (SCHEMA, BEYOND_PLAYS)
    again = "Run edmctl calibrate again."
    missing = "Check the path, or make the file: edmctl calibrate --output {path}."
    codes = ("E3640", "E3641", "E3642", "E3643", "E3644", "E9012")

    schema_name: Literal["edmctl-calibration/1", "edmctl-calibration/2"] = Field(alias="schema")
    made: Made
    actuator: Parameters = Field(alias="model")
    quality: Quality
    baselines: dict[Words, Figures] = entry({}, "held-out errors of simpler models", max_length=100)

    @property
    def serial(self) -> str | None:
        """Serial number of the machine that it was made on; None when it was made of files."""
        return self.made.serial

    def model(self) -> ActuatorModel:
        """Return the model. Raises ValueError when its arrays do not fit or it could not be inverted."""
        written = self.actuator
        n, g, j = len(written.thresholds_v), len(written.creep_plays), len(written.time_constants_s)
        k = len(written.rounded_um_per_v or ())
        shapes = {
            "thresholds_v": (n,),
            "knots_v": (n, -1),
            "slopes_um_per_v": (n, -1),
            "time_constants_s": (j,),
            "creep_um_per_v": (g, j),
            "rounded_limits_v": (k, 2),
            "rounded_sharpness": (k,),
            "rounded_unloading": (k,),
            "rounded_um_per_v": (k,),
        }
        values = written.model_dump() | {"lag_s": written.lag_s or 0.0}
        values["creep_plays"] = np.array(written.creep_plays, dtype=np.int64)
        try:
            for name, shape in shapes.items():
                values[name] = np.array(values[name] or [], dtype=np.float64).reshape(shape)
        except ValueError:
            raise ValueError("the arrays of the model do not fit each other") from None
        return ActuatorModel(**values)

    def check(self) -> None:
        """Raise ValueError if the model cannot be used, or values contradict each other."""
        quality = self.quality
        others: list[tuple[str, Figures]] = [("validation", one) for one in quality.validation or ()]
        if quality.held_out_records is not None:
            others.append(("held_out_records", quality.held_out_records))
        for wrong in contradictions(quality, self.model(), others):
            raise ValueError(f"it cannot be of an actuator that feeds a tool: {wrong}")


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
    model, whole = identification.model, identification.held_out_records
    quality = Quality(
        accepted=identification.accepted,
        problems=list(identification.problems),
        restrictions=list(identification.restrictions) or None,
        notes=list(identification.notes),
        samples=identification.samples,
        stroke_um=model.stroke_um,
        gain_um_per_v=model.gain_um_per_v,
        loop_width=model.loop_width,
        gamma_per_decade=model.gamma_per_decade,
        train=_figures(identification.train),
        held_out=_figures(identification.held_out),
        held_out_records=None if whole is None else _figures(whole),
        validation=[
            ValidationFigures.model_validate({key: one[key] for key in ValidationFigures.model_fields})
            for one in validation
        ]
        or None,
        bands=Spread.model_validate(identification.bands, from_attributes=True),
    )
    plain: dict[str, Any] = {}
    for name, info in Parameters.model_fields.items():
        value = getattr(model, name)
        plain[name] = value.tolist() if isinstance(value, np.ndarray) else value
        if info.default is None and not plain[name]:
            plain[name] = None
    beyond = len(model.rounded_um_per_v) > 0 or model.lag_s > 0.0
    return Calibration(
        schema=BEYOND_PLAYS if beyond else SCHEMA,
        made=made,
        model=Parameters(**plain),
        quality=quality,
        baselines={name: _figures(errors) for name, errors in (baselines or {}).items()},
    )


def _figures(errors: ErrorFigures) -> Figures:
    return Figures.model_validate(errors, from_attributes=True)


# Wide bounds: beyond them no actuator feeds a tool, or arithmetic overflows.
MOST_V = 10_000.0
LEAST_SPAN_SHARE = 0.01
"""Of the knots of the first play: a range of voltage that is narrower was not recorded."""
LEAST_STROKE_UM, MOST_STROKE_UM = 1.0, 10_000.0
MOST_ZERO_UM = 1e6
LEAST_TAU_S, MOST_TAU_S = 1e-6, 1e9
MOST_DELAY_S = 1.0
MOST_PLAYS, MOST_PIECES, MOST_TAUS, MOST_ROUNDED = 200, 50, 50, 10
"""A tick of the estimator takes time in proportion; identified are 10, 4 and 15."""
MOST_CREEP_SHARE = 1.0  # of the displacement without creep
STROKE_FACTOR = 1.5  # between the stroke that the quality states and that of the model's weights
ROUNDING = 1e-3


def contradictions(
    quality: Identification | Quality, model: ActuatorModel, others: Sequence[tuple[str, Figures]] = ()
) -> Iterator[str]:
    """Yield what is impossible in a calibration, also of `others`, errors that an acceptance depends on, by name."""
    taus_s, ends_v = model.time_constants_s, np.array([model.low_v, model.high_v])
    volts = (model.thresholds_v, model.knots_v, ends_v, model.rounded_limits_v, model.rounded[:, -1])
    for value, most, what in (
        (len(model.thresholds_v), MOST_PLAYS, "{:g} plays"),
        (model.slopes_um_per_v.shape[1], MOST_PIECES, "{:g} pieces a play"),
        (len(taus_s), MOST_TAUS, "{:g} time constants"),
        (len(model.rounded_um_per_v), MOST_ROUNDED, "{:g} rounded plays"),
        (max(float(np.abs(one).max(initial=0.0)) for one in volts), MOST_V, "voltages up to {:.3g} V"),
        (taus_s.max(initial=0.0), MOST_TAU_S, "time constants of {:.3g} s"),
        (model.delay_s, MOST_DELAY_S, "a delay of {:.3g} s"),
        (model.lag_s, MOST_DELAY_S, "a lag of {:.3g} s"),
        (abs(model.zero_um), MOST_ZERO_UM, "a zero of {:.3g} µm"),
    ):
        if not value <= most:
            yield f"{what.format(value)}, at most {most:g} are used"
    if taus_s.min(initial=1.0) < LEAST_TAU_S:
        yield f"time constants of {taus_s.min():.3g} s, at least {LEAST_TAU_S:g} are used"
    low_v, high_v = float(model.knots_v[0, 0]), float(model.knots_v[0, -1])
    span_v = high_v - low_v
    narrow = model.high_v - model.low_v < LEAST_SPAN_SHARE * span_v
    if narrow or model.low_v < low_v - span_v or model.high_v > high_v + span_v or model.high_v <= low_v:
        stated = f"a range of {model.low_v:.4g} V to {model.high_v:.4g} V"
        yield f"{stated} with knots from {low_v:.4g} V to {high_v:.4g} V"
    yield from _of_stroke(quality, model)
    if quality.accepted == bool(quality.problems):
        verdict = "accepted" if quality.accepted else "not accepted"
        yield f"it is {verdict} with {len(quality.problems)} problems against it"
    yield from _of_figures(quality.train, "train")
    for name, errors in (("held_out", quality.held_out), *others):
        if quality.accepted and (errors.rms_pct > ACCEPTED_RMS_PCT or errors.max_pct > NOISY_MAX_PCT):
            yield f"it is accepted with errors of {errors.rms_pct:.3g} % RMS, {errors.max_pct:.3g} % ({name})"
        yield from _of_figures(errors, name)


def _of_stroke(quality: Identification | Quality, model: ActuatorModel) -> Iterator[str]:
    """The weights give a plausible stroke, and that which is stated."""
    span_v = model.high_v - model.low_v
    steepest = max(model.slopes_um_per_v.max(), model.creep_um_per_v.max(initial=0.0))
    if not steepest <= MOST_STROKE_UM:
        yield f"slopes up to {steepest:.3g} µm/V"
        return
    knots = np.clip(model.knots_v, model.low_v, model.high_v)
    knots[:, 0], knots[:, -1] = model.low_v, model.high_v
    thresholds_v = model.thresholds_v[:, np.newaxis]
    tops_v = np.minimum(knots[:, 1:], model.high_v - thresholds_v)
    reached_v = np.maximum(tops_v - np.maximum(knots[:, :-1], model.low_v + thresholds_v), 0.0)
    plays_v = np.maximum(0.0, span_v - 2.0 * model.thresholds_v)
    rounded_v = np.maximum(0.0, model.rounded[:, -1] * span_v - model.rounded_limits_v.sum(axis=1))
    swings_v = np.concatenate([plays_v, rounded_v])
    plain_um = float((model.slopes_um_per_v * reached_v).sum() + model.rounded_um_per_v @ rounded_v)
    creep_um = float((model.creep_um_per_v.sum(axis=1) * swings_v[model.creep_plays]).sum())
    stroke_um, stated_um = plain_um + creep_um, quality.stroke_um
    if not LEAST_STROKE_UM <= stroke_um <= MOST_STROKE_UM:
        yield f"a stroke of {stroke_um:.3g} µm; {LEAST_STROKE_UM:g} µm to {MOST_STROKE_UM:g} µm feed a tool"
    elif creep_um > MOST_CREEP_SHARE * plain_um:
        yield f"{creep_um:.4g} µm of creep on {plain_um:.4g} µm without it"
    if not plain_um / STROKE_FACTOR <= stated_um <= STROKE_FACTOR * stroke_um:
        yield f"a stated stroke of {stated_um:.4g} µm and weights that give {stroke_um:.4g} µm"


def _of_figures(figures: ErrorFigures | Figures, name: str) -> Iterator[str]:
    """Percentages match the lengths, and no RMS exceeds the largest error."""
    pairs = ((figures.max_pct, figures.max_um), (figures.rms_pct, figures.rms_um))
    apart = any(
        not math.isclose(pct / 100.0 * figures.range_um, um, rel_tol=ROUNDING, abs_tol=1e-9)
        for pct, um in pairs
    )
    if apart or figures.rms_um > figures.max_um * (1.0 + ROUNDING):
        yield f"errors of {name} that contradict each other"
