"""`calibrate`: check options and files, measure, fit, compare with simpler models, validate on other data, save."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from edmctl import failures
from edmctl.actuator.acceptance import DIFFERING, excess_of, rate_in_words, restrictions_on
from edmctl.actuator.identification import (
    LONGEST_FIXED_DELAY_S,
    Identification,
    fit_line,
    fit_maxwell,
    identify,
    lever_factor,
)
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import Record, check_record
from edmctl.actuator.validation import ErrorFigures, Refit, Validation, validate, within_rates
from edmctl.array_types import Array
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import Diagnostic, EdmError, RecordError
from edmctl.jobs import output_files
from edmctl.jobs.connect import connected, introduction, known_controller
from edmctl.jobs.connected_machine import CreepNote
from edmctl.jobs.plan import MachineAddress, where_is
from edmctl.jobs.surroundings import NONE, Surroundings, Warn
from edmctl.jsonout import JsonValue, to_json_value
from edmctl.procedures.calibration import CalibrationPlan, measure_actuator, plan_calibration
from edmctl.process.rest_drift import CreepLeft
from edmctl.profile.calibration import Made, calibration_of, contradictions, measured_file
from edmctl.profile.folders import kept_path
from edmctl.profile.setup import Setup, load_setup
from edmctl.quantity import half_width
from edmctl.record.columns import STACK, TOOL, read_columns, read_record, write_columns
from edmctl.results.progress import Observer
from edmctl.results.result import Result
from edmctl.version import __version__
from edmctl.wording import count

LARGEST = 1e30
"""Instruments write 9.9e37 for a missing reading; squares of 1e155 overflow."""
REFITS = ("zero", "gain")
HELD_OUT, VALIDATION = "held-out blocks", "validation files"
BEYOND_SHARE = 0.01
"""Of the span of a calibration; a record that goes this far beyond is reported."""


@dataclass(frozen=True, slots=True)
class CalibrationRequest:
    """The options of the command line."""

    sources: tuple[Path, ...]
    validation: tuple[Path, ...]
    refit: str
    previous_v: tuple[float, ...]
    delay_s: float | None
    output: Path | None
    lever: Path | None = None
    setup: Path | None = None
    port: str | None = None
    wait_s: float = 0.0
    controller: str = ""


class MeasuredRecord(NamedTuple):
    """A file of measured data."""

    path: Path
    record: Record


@dataclass(frozen=True, slots=True)
class LeverFound:
    """Lever factor of the flexure, with the half-width of its 95 % interval."""

    factor: float
    u95: float
    offset_um: float
    samples: int


@dataclass(frozen=True, slots=True)
class CheckedCalibration:
    """A checked request. `plan` is how the machine is driven; None if no machine is driven."""

    request: CalibrationRequest
    surroundings: Surroundings
    setup: Setup
    where: MachineAddress
    refit: tuple[Refit, ...]
    plan: CalibrationPlan | None
    sources: tuple[MeasuredRecord, ...]
    validation: tuple[MeasuredRecord, ...]
    lever: LeverFound | None
    doubts: tuple[Diagnostic, ...]

    @property
    def simulated(self) -> bool | None:
        """Whether the machine is a virtual one; None if that is known only after connecting."""
        return True if self.plan is not None and self.where.in_process else None


def check(request: CalibrationRequest, surroundings: Surroundings = NONE) -> CheckedCalibration:
    """Check options and files, for the program in `surroundings`.

    Raises UsageError, ProfileError, RecordError, RunFileError, LinkLost, PreconditionError.
    """
    words = {word.strip() for word in request.refit.split(",")}
    if words not in ({"zero"}, set(REFITS)):
        raise failures.refit_unknown(text=request.refit)
    if not all(math.isfinite(volts) for volts in request.previous_v):
        raise failures.previous_voltage_not_finite()
    if request.delay_s is not None and not 0.0 <= request.delay_s <= LONGEST_FIXED_DELAY_S:
        raise failures.delay_out_of_range(
            delay_s=request.delay_s, longest_fixed_delay_s=LONGEST_FIXED_DELAY_S
        )
    setup, plan, where = load_setup(request.setup), None, MachineAddress()
    # A lever alone moves no machine, even if one is named.
    if not (request.sources or (request.lever and not (request.validation or request.output))):
        where = where_is(request.port, setup, request.wait_s)
        if request.controller:
            where = replace(where, controller=known_controller(request.controller))
        plan = plan_calibration(setup)
    if request.output is not None:
        output_files.check_new(request.output)
    paths, doubts, measured = (*request.sources, *request.validation), list[Diagnostic](), []
    for path, previous_v in zip(paths, _histories(request.previous_v, len(paths)), strict=True):
        record = read_record(path, previous_v)
        if huge := _huge({"t_s": record.t_s, "u_V": record.u_v, "y_um": record.y_um}):
            raise failures.record_values_too_large(file=path.name, values=huge)
        doubts += _doubtful(record)
        measured.append(MeasuredRecord(path, record))
    sources = len(request.sources)
    return CheckedCalibration(
        request=request,
        surroundings=surroundings,
        setup=setup,
        where=where,
        refit=("zero",) if words == {"zero"} else ("gain", "zero"),
        plan=plan,
        sources=tuple(measured[:sources]),
        validation=tuple(measured[sources:]),
        lever=_lever(request.lever) if request.lever else None,
        doubts=tuple(doubts),
    )


def _doubtful(record: Record) -> list[Diagnostic]:
    return [failures.record_doubtful(doubt=sentence) for sentence in check_record(record)]


def _histories(stated_v: Sequence[float], files: int) -> Sequence[float | None]:
    """Return the voltage that was held before each file, first those of --from."""
    if not stated_v:
        return [None] * files
    if files and len(stated_v) == 1:
        return [stated_v[0]] * files
    if len(stated_v) == files:
        return stated_v
    times = "once" if len(stated_v) == 1 else f"{len(stated_v)} times"
    named = f"{files or 'no'} {'files are' if files > 1 else 'file is'} named"
    raise failures.previous_voltage_count(times=times, named=named)


def _huge(columns: Mapping[str, Array]) -> str:
    """Return words for values too large to be measurements; empty without any."""
    for name, values in columns.items():
        huge = (abs(values) > LARGEST) & (abs(values) < math.inf)
        if huge.any():
            first = int(huge.argmax())
            return (
                f"{huge.sum()} of {len(values)} values of {name} cannot have been measured, the first, "
                f"{values[first]:g}, at sample {first + 1}"
            )
    return ""


def _lever(path: Path) -> LeverFound:
    """Fit the lever factor to a file with the columns x_um and z_um."""
    x_um, z_um = read_columns(path, STACK, TOOL)
    if huge := _huge({"x_um": x_um, "z_um": z_um}):
        raise failures.lever_values_too_large(file=path.name, values=huge)
    try:
        lever = lever_factor(x_um, z_um)
    except RecordError as error:
        message = error.message.rstrip(".")
        raise RecordError(f"{path.name}: {message}.", hint=error.hint, code=error.code) from error
    return LeverFound(lever.factor, half_width(lever.sd), lever.offset_um, len(x_um))


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


@dataclass(frozen=True, slots=True, repr=False)
class CalibrationReport(Result):
    """The result of a calibration. `baselines` and `held_out_baselines` have the keys line and maxwell.

    validated_screened : as `validated`, without ringing starts and outliers; None if there are none
    path : the calibration file; None if nothing was saved
    serial : of the machine that was driven; None if files were fitted
    is_own : whether the machine uses the file without naming it
    replaced : whether an older file was replaced
    """

    identification: Identification
    held_out_baselines: Mapping[str, ErrorFigures]
    validated: ErrorFigures | None
    validated_screened: ErrorFigures | None
    validated_baselines: Mapping[str, ErrorFigures]
    files: tuple[FileFigures, ...]
    refit: tuple[Refit, ...]
    warnings: tuple[Diagnostic, ...]
    path: Path | None = None
    serial: str | None = None
    simulated: bool = False
    is_own: bool = False
    replaced: bool = False
    lever: LeverFound | None = None

    @property
    def error(self) -> None:  # type: ignore[override]
        """None: an error of a calibration is raised."""

    @property
    def model(self) -> ActuatorModel:
        """The model: voltage to displacement, and back."""
        return self.identification.model

    @property
    def accepted(self) -> bool:
        """Whether the calibration is accepted."""
        return self.identification.accepted

    @property
    def problems(self) -> tuple[str, ...]:
        """The reasons against using it, each with its remedy."""
        return tuple(self.identification.problems)

    @property
    def held_out(self) -> ErrorFigures:
        """Errors on blocks of the records that the model did not see."""
        return self.identification.held_out

    @property
    def baselines(self) -> Mapping[str, ErrorFigures]:
        """Errors of the simpler models: on the validation files, else on held-out blocks."""
        return self.validated_baselines or self.held_out_baselines

    def as_mapping(self) -> dict[str, object]:
        """Return the `result` of the JSON object."""
        identified, model = self.identification, self.identification.model
        errors = ("held_out", "held_out_model", "held_out_records", "beyond", "beyond_share")
        parameters = ("gamma_per_decade", "stroke_um", "delay_s", "lag_s", "low_v", "high_v")
        verdict = ("accepted", "problems", "restrictions", "notes")
        return {
            "train": identified.train,
            "validate": self.validated,
            "validate_screened": self.validated_screened,
            "validate_files": self.files,
            "refit": self.refit,
            **{name: getattr(identified, name) for name in errors},
            "noise_sd_um": identified.noise.sd_um,
            "noise_max_um": identified.noise.largest_um,
            "baselines": self.baselines,
            "baselines_on": VALIDATION if self.validated else HELD_OUT,
            **{name: getattr(model, name) for name in parameters},
            "samples": identified.samples,
            "bands": asdict(identified.bands),
            **{name: getattr(identified, name) for name in verdict},
            "calibration_file": str(self.path) if self.path else None,
            "serial": self.serial,
            "lever": self.lever,
        }

    def brief(self) -> list[str]:
        """Return whether it is accepted, and its errors."""
        errors = self.validated or self.held_out
        accepted = "accepted with restrictions" if self.identification.restrictions else "accepted"
        verdict = accepted if self.accepted else "not accepted"
        return [verdict, f"{errors.rms_um:.2f} µm rms and {errors.max_um:.2f} µm at most on data not fitted"]

    def rows(self) -> list[JsonValue]:
        """Return the errors of each model, in µm and in % of the range, on data that none of them saw."""
        errors = {"edmctl": self.validated or self.held_out, **self.baselines}
        return [to_json_value({"model": name, **asdict(figures)}) for name, figures in errors.items()]


def calibrate_machine(
    checked: CheckedCalibration, seed: int, observer: Observer, warn: Warn
) -> CalibrationReport:
    """Drive the machine, fit, and save. If no calibration results, the measured record is kept."""
    where, environ = checked.where, checked.surroundings.environ
    with connected(None, checked.setup, seed, observer.note, where, checked.surroundings) as bench:
        identity = bench.machine.identity
        own_path = kept_path("calibration", identity.serial, environ, lasting=where.lasting)
        path = checked.request.output or own_path
        output_files.check_writable(path)
        note = CreepNote(bench, where, environ)
        note.take_away()
        bench.begin()
        setup = bench.own_setup or checked.setup
        observer.note(f"{introduction(where, bench)}; {setup.in_words()}")
        measured = measure_actuator(bench.machine, setup, plan_calibration(setup), observer)
        note.leave(CreepLeft.none(0.0))
    record = measured.record
    try:
        warn(_doubtful(record))
        if measured.lost_frames:
            warn([failures.telemetry_lost(lost_frames=measured.lost_frames)])
        report = _fit([record], checked, observer)
        is_own, replaced = checked.request.output is None and where.lasting, path.exists()
        if is_own and replaced and not report.accepted:
            path = path.with_name(f"{path.stem}-not-accepted{path.suffix}")
            is_own = replaced = False
            warn([failures.calibration_in_use_stays(path=path), _kept(record, path)])
        report = replace(report, serial=identity.serial, simulated=identity.simulated)
        report = replace(report, path=path, is_own=is_own, replaced=replaced)
        _save(report, path, checked)
    except BaseException:
        warn([_kept(record, path)])  # it took minutes of machine time
        raise
    return report


def calibrate_files(checked: CheckedCalibration, observer: Observer) -> CalibrationReport:
    """Fit measured files, and save if the request names an output file."""
    output = checked.request.output
    report = _fit([given.record for given in checked.sources], checked, observer)
    if output is None:
        observer.note("nothing is saved: --output FILE writes a calibration that `machine` can use")
    else:
        _save(report, output, checked)
    return replace(report, path=output)


def _fit(records: Sequence[Record], checked: CheckedCalibration, observer: Observer) -> CalibrationReport:
    observer.note(f"fitting {count(sum(len(record.t_s) for record in records))} samples")
    validation = [given.record for given in checked.validation]
    report = find(records, validation, checked.refit, checked.request.delay_s)
    return replace(report, lever=checked.lever)


def _save(report: CalibrationReport, path: Path, checked: CheckedCalibration) -> None:
    """Write the calibration file; a signal no longer interrupts."""
    made = Made(
        utc=datetime.now(UTC).isoformat(timespec="seconds"),
        edmctl=__version__,
        serial=report.serial,
        simulated=report.simulated,
        records=[
            measured_file(given.path, len(given.record.t_s), given.record.previous_v)
            for given in checked.sources
        ],
    )
    files = [asdict(file) for file in report.files]
    calibration = calibration_of(report.identification, made, report.held_out_baselines, files)
    checked.surroundings.settled()
    calibration.save(path)


def _kept(record: Record, path: Path) -> Diagnostic:
    """Write the record next to the calibration, or else into the current folder."""
    name = f"{path.stem}-record-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.h5"
    for kept in (path.with_name(name), Path(name)):
        try:
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_columns(kept, {"t_s": record.t_s, "u_V": record.u_v, "y_um": record.y_um})
        except (EdmError, OSError):
            continue
        return failures.measured_data_kept(kept=kept)
    return failures.measured_data_lost()


Validated = Sequence[tuple[Record, Validation]]


def find(
    records: Sequence[Record], validation: Sequence[Record], refit: tuple[Refit, ...], delay_s: float | None
) -> CalibrationReport:
    """Identify the actuator, and compare with a straight line and the paper's Maxwell model."""
    try:
        identified = identify(records, delay_s=delay_s)
        late_s, counting = identified.model.delay_s, identified.screening
        baselines = {
            "line": fit_line(records, late_s, counting),
            "maxwell": fit_maxwell(records, late_s, counting),
        }
    except ValueError as error:
        raise failures.no_model_fits(error=error) from error
    impossible = [
        f"No actuator that feeds a tool is like that: {contradiction}. What the record shows is beyond what is "
        "looked for, such as a lag of more than 20 ms, or t_s is not in s."
        for contradiction in contradictions(identified, identified.model)
    ]

    def validated(model: ActuatorModel) -> Validated:
        return [(record, validate(model, record, refit)) for record in validation]

    outcomes = validated(identified.model)
    identified = _verified(
        replace(identified, problems=(*identified.problems, *impossible)), records, outcomes
    )
    not_accepted = (failures.calibration_not_accepted(problem=problem) for problem in identified.problems)
    has_screened = any(outcome.screened for _, outcome in outcomes)
    return CalibrationReport(
        identification=identified,
        held_out_baselines={name: baseline.held_out for name, baseline in baselines.items()},
        validated=_pooled(outcomes) if validation else None,
        validated_screened=_pooled(outcomes, screened=True) if has_screened else None,
        validated_baselines={
            name: _pooled(validated(baseline.model)) for name, baseline in baselines.items() if validation
        },
        files=tuple(_file_figures(record, outcome) for record, outcome in outcomes),
        refit=refit,
        warnings=(*not_accepted, *_beyond(identified.model, validation)),
    )


def _verified(identified: Identification, records: Sequence[Record], validated: Validated) -> Identification:
    """Return the identification with the verdict of the validation files: a problem for each above the limits."""
    problems, passed = [], list(records)
    for record, outcome in validated:
        excess = excess_of(outcome.errors, identified.noise)
        if not excess:
            passed.append(record)
            continue
        cause = DIFFERING if identified.accepted else "the fitted records show a fault already"
        if not within_rates(record, records):
            cause = (
                f"it swings at another rate{rate_in_words([record])} than the fitted records"
                f"{rate_in_words(records)}: fit records of such rates too"
            )
        problems.append(f"{record.name} (--validate): {excess}; {cause}.")
    restrictions = restrictions_on(passed) if validated else identified.restrictions
    return replace(identified, problems=(*identified.problems, *problems), restrictions=restrictions)


def _file_figures(record: Record, outcome: Validation) -> FileFigures:
    note, left_out, screened = "", [], outcome.screened
    if outcome.rung_s:
        left_out.append(
            f"its first {outcome.rung_s:.2g} s, where far more is missed than in all that follows, as when "
            "something rings down or the voltage before is another than was said (--previous-voltage)"
        )
    if outcome.outliers:
        left_out.append(f"{outcome.outliers} of its samples, which stand out singly")
    if screened:
        note = f"{record.name} has errors up to {screened.max_pct:.2f} % ({screened.rms_pct:.2f} % RMS) "
        note += f"without {', and without '.join(left_out)}."
    return FileFigures(
        name=record.name,
        judged_from_s=float(record.t_s[outcome.first]),
        gain=outcome.gain,
        zero_um=outcome.zero_um,
        screened=screened,
        rung_s=outcome.rung_s,
        outliers=outcome.outliers,
        note=note,
        **asdict(outcome.errors),
    )


def _pooled(validated: Validated, *, screened: bool = False) -> ErrorFigures:
    samples = [len(record.t_s) - outcome.first for record, outcome in validated]
    errors = [
        outcome.screened if screened and outcome.screened else outcome.errors for _, outcome in validated
    ]
    return ErrorFigures.pooled(errors, samples)


def _beyond(model: ActuatorModel, records: Sequence[Record]) -> list[Diagnostic]:
    """Return a warning for each validation file that leaves the range of the calibration."""
    margin_v, warnings = BEYOND_SHARE * (model.high_v - model.low_v), []
    for record in records:
        low_v, high_v = float(record.u_v.min()), float(record.u_v.max())
        if low_v < model.low_v - margin_v or high_v > model.high_v + margin_v:
            fitted = {"fitted_low_v": model.low_v, "fitted_high_v": model.high_v}
            warnings.append(
                failures.validation_beyond_fit(record=record.name, low_v=low_v, high_v=high_v, **fitted)
            )
    return warnings
