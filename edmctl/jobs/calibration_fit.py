"""Fit a calibration to records, compare it with simpler models, and validate it on other data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from edmctl import failures
from edmctl.actuator.acceptance import DIFFERING, excess_of, rate_in_words, restrictions_on
from edmctl.actuator.identification import Identification, fit_line, fit_maxwell, identify
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import Record
from edmctl.actuator.validation import ErrorFigures, Refit, Validation, validate, within_rates
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import Diagnostic
from edmctl.profile.calibration import contradictions

HELD_OUT, VALIDATION = "held-out blocks", "validation files"
REMEDY = "`edmctl machine` uses such a calibration, and warns each time."
BEYOND_SHARE = 0.01
"""Of the span of a calibration; a record that goes this far beyond is worth a word."""


@dataclass(frozen=True, slots=True)
class FileFigures:
    """Errors on one validation file, with the gain and zero that were fitted to it.

    judged_from_s : start of the evaluation; before it the actuator's history is unknown
    screened : errors without the ringing start of `rung_s` and without `outliers` single samples; None if nothing is
        left out
    note : the same as a sentence
    """

    name: str
    judged_from_s: float
    max_um: float
    rms_um: float
    max_pct: float
    rms_pct: float
    range_um: float
    gain: float
    zero_um: float
    screened: ErrorFigures | None = None
    rung_s: float = 0.0
    outliers: int = 0
    note: str = ""


@dataclass(frozen=True, slots=True)
class Findings:
    """An identified actuator. `baselines` and `held_out_baselines` have the keys line and maxwell.

    validated_screened : as `validated`, without ringing starts and outliers; None if there are none
    """

    identification: Identification
    held_out_baselines: Mapping[str, ErrorFigures]
    validated: ErrorFigures | None
    validated_screened: ErrorFigures | None
    validated_baselines: Mapping[str, ErrorFigures]
    files: tuple[FileFigures, ...]
    refit: tuple[Refit, ...]
    warnings: tuple[Diagnostic, ...]

    @property
    def train(self) -> ErrorFigures:
        """Errors on the records themselves."""
        return self.identification.train

    @property
    def held_out(self) -> ErrorFigures:
        """Errors on blocks of the records that the model did not see."""
        return self.identification.held_out

    @property
    def baselines(self) -> Mapping[str, ErrorFigures]:
        """Errors of the simpler models: on the validation files, else on held-out blocks."""
        return self.validated_baselines or self.held_out_baselines

    def as_mapping(self) -> dict[str, object]:
        """Return the `result` of the JSON object, but for the files."""
        found = self.identification
        return {
            "train": self.train,
            "validate": self.validated,
            "validate_screened": self.validated_screened,
            "validate_files": self.files,
            "refit": self.refit,
            "held_out": self.held_out,
            "held_out_model": found.held_out_model,
            "held_out_records": found.held_out_records,
            "beyond": found.beyond,
            "beyond_share": found.beyond_share,
            "noise_sd_um": found.noise.sd_um,
            "noise_max_um": found.noise.largest_um,
            "baselines": self.baselines,
            "baselines_on": VALIDATION if self.validated else HELD_OUT,
            "gamma_per_decade": found.model.gamma_per_decade,
            "stroke_um": found.model.stroke_um,
            "delay_s": found.model.delay_s,
            "lag_s": found.model.lag_s,
            "low_v": found.model.low_v,
            "high_v": found.model.high_v,
            "samples": found.samples,
            "bands": asdict(found.bands),
            "accepted": found.accepted,
            "problems": found.problems,
            "restrictions": found.restrictions,
            "notes": found.notes,
        }


def find(
    records: Sequence[Record], validation: Sequence[Record], refit: tuple[Refit, ...], delay_s: float | None
) -> Findings:
    """Identify the actuator, and compare with a straight line and the paper's Maxwell model.

    Raises RecordError E3619 if the records allow no fit.
    """
    try:
        found = identify(records, delay_s=delay_s)
        late_s, counting = found.model.delay_s, found.screening
        baselines = {
            "line": fit_line(records, late_s, counting),
            "maxwell": fit_maxwell(records, late_s, counting),
        }
    except ValueError as error:
        raise failures.no_model_fits(error=error) from error
    wrong = [
        f"No actuator that feeds a tool is like that: {one}. What the record shows is beyond what is looked for, "
        "such as a lag of more than 20 ms, or t_s is not in s."
        for one in contradictions(found, found.model)
    ]
    judged = _judged(found.model, validation, refit)
    found = _verified(replace(found, problems=(*found.problems, *wrong)), records, judged)
    return Findings(
        identification=found,
        held_out_baselines={name: baseline.held_out for name, baseline in baselines.items()},
        validated=_pooled(judged) if validation else None,
        validated_screened=_pooled(judged, screened=True) if any(one.screened for _, one in judged) else None,
        validated_baselines={
            name: _pooled(_judged(baseline.model, validation, refit))
            for name, baseline in baselines.items()
            if validation
        },
        files=tuple(
            FileFigures(
                name=record.name,
                judged_from_s=float(record.t_s[one.first]),
                gain=one.gain,
                zero_um=one.zero_um,
                screened=one.screened,
                rung_s=one.rung_s,
                outliers=one.outliers,
                note=_without(record, one, one.screened) if one.screened else "",
                **asdict(one.errors),
            )
            for record, one in judged
        ),
        refit=refit,
        warnings=(
            *(failures.calibration_not_accepted(one=one, remedy=REMEDY) for one in found.problems),
            *_beyond(found.model, validation),
        ),
    )


def _verified(
    found: Identification, records: Sequence[Record], judged: Sequence[tuple[Record, Validation]]
) -> Identification:
    """Return the identification with the verdict of the validation files: a problem for each above the limits."""
    problems, passed = [], list(records)
    for record, one in judged:
        excess = excess_of(one.errors, found.noise)
        if not excess:
            passed.append(record)
            continue
        cause = DIFFERING if found.accepted else "the fitted records show a fault already"
        if not within_rates(record, records):
            cause = (
                f"it swings at another rate{rate_in_words([record])} than the fitted records"
                f"{rate_in_words(records)}: fit records of such rates too"
            )
        problems.append(f"{record.name} (--validate): {excess}; {cause}.")
    return replace(
        found,
        problems=(*found.problems, *problems),
        restrictions=restrictions_on(passed) if judged else found.restrictions,
    )


def _judged(
    model: ActuatorModel, records: Sequence[Record], refit: tuple[Refit, ...]
) -> list[tuple[Record, Validation]]:
    return [(record, validate(model, record, refit)) for record in records]


def _without(record: Record, judged: Validation, screened: ErrorFigures) -> str:
    """Return a sentence with the errors without ringing start and outliers."""
    left_out = []
    if judged.rung_s:
        left_out.append(
            f"its first {judged.rung_s:.2g} s, where far more is missed than in all that follows, as when something "
            "rings down or the voltage before is another than was said (--previous-voltage)"
        )
    if judged.outliers:
        left_out.append(f"{judged.outliers} of its samples, which stand out singly")
    return (
        f"{record.name} has errors up to {screened.max_pct:.2f} % ({screened.rms_pct:.2f} % RMS) without "
        f"{', and without '.join(left_out)}."
    )


def _pooled(judged: Sequence[tuple[Record, Validation]], *, screened: bool = False) -> ErrorFigures:
    samples = [len(record.t_s) - one.first for record, one in judged]
    errors = [one.screened if screened and one.screened else one.errors for _, one in judged]
    return ErrorFigures.pooled(errors, samples)


def _beyond(model: ActuatorModel, records: Sequence[Record]) -> list[Diagnostic]:
    """Validation files that leave the range of the calibration."""
    margin_v = BEYOND_SHARE * (model.high_v - model.low_v)
    doubts = []
    for record in records:
        low_v, high_v = float(record.u_v.min()), float(record.u_v.max())
        if low_v >= model.low_v - margin_v and high_v <= model.high_v + margin_v:
            continue
        doubts.append(
            failures.validation_beyond_fit(
                record=record.name,
                low_v=low_v,
                high_v=high_v,
                fitted_low_v=model.low_v,
                fitted_high_v=model.high_v,
            )
        )
    return doubts
