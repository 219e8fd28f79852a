"""`calibrate`: check options and files, measure, fit, save."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from edmctl import failures
from edmctl.actuator.identification import LONGEST_FIXED_DELAY_S
from edmctl.actuator.lever import lever_factor
from edmctl.actuator.model import ActuatorModel
from edmctl.actuator.record import Record, check_record
from edmctl.actuator.validation import ErrorFigures, Refit
from edmctl.array_types import Array
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import Diagnostic, EdmError, RecordError
from edmctl.jobs import output_files
from edmctl.jobs.calibration_fit import Findings, find
from edmctl.jobs.connect import connected, introduction, known_controller
from edmctl.jobs.connected_machine import CreepNote
from edmctl.jobs.plan import MachineAddress, where_is
from edmctl.jobs.surroundings import NONE, Surroundings, Warn
from edmctl.jsonout import JsonValue, to_json_value
from edmctl.procedures.calibration import CalibrationPlan, measure_actuator, plan_calibration
from edmctl.process.rest_drift import CreepLeft
from edmctl.profile.calibration import Made, calibration_of, measured_file
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

    @property
    def lever_only(self) -> bool:
        """Whether a lever factor is all that is wanted; then no machine moves, even if one is named."""
        return self.lever is not None and not (self.sources or self.validation or self.output)


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
    if not request.sources and not request.lever_only:
        where = where_is(request.port, setup, request.wait_s)
        if request.controller:
            where = replace(where, controller=known_controller(request.controller))
        plan = plan_calibration(setup)
    if request.output is not None:
        output_files.check_new(request.output)
    paths, doubts, measured = (*request.sources, *request.validation), list[Diagnostic](), []
    for path, previous_v in zip(paths, _histories(request.previous_v, len(paths)), strict=True):
        record = read_record(path, previous_v)
        _refuse_huge(path, {"t_s": record.t_s, "u_V": record.u_v, "y_um": record.y_um}, "E3612")
        doubts += doubtful(check_record(record), "W3610")
        measured.append(MeasuredRecord(path, record))
    count = len(request.sources)
    return CheckedCalibration(
        request=request,
        surroundings=surroundings,
        setup=setup,
        where=where,
        refit=("zero",) if words == {"zero"} else ("gain", "zero"),
        plan=plan,
        sources=tuple(measured[:count]),
        validation=tuple(measured[count:]),
        lever=_lever(request.lever) if request.lever else None,
        doubts=tuple(doubts),
    )


def doubtful(sentences: Sequence[str], code: str) -> list[Diagnostic]:
    """Turn sentences that carry their remedy into warnings."""
    return [Diagnostic(code, sentence, "", is_warning=True) for sentence in sentences]


def _histories(said: Sequence[float], files: int) -> Sequence[float | None]:
    """Return the voltage that was held before each file, first those of --from."""
    if not said:
        return [None] * files
    if files and len(said) == 1:
        return [said[0]] * files
    if len(said) == files:
        return said
    times = "once" if len(said) == 1 else f"{len(said)} times"
    many = f"{files} files are named" if files > 1 else "1 file is named"
    raise failures.previous_voltage_count(times=times, named=many if files else "no file is named")


def _refuse_huge(path: Path, columns: Mapping[str, Array], code: str) -> None:
    """Raise RecordError for values too large to be measurements."""
    for name, values in columns.items():
        huge = (abs(values) > LARGEST) & (abs(values) < math.inf)
        if huge.any():
            first = int(huge.argmax())
            raise RecordError(
                f"{path.name}: {huge.sum()} of {len(values)} values of {name} cannot have been measured, the first, "
                f"{values[first]:g}, at sample {first + 1}.",
                hint="Leave out the samples where the instrument gave no number, or repair the recording.",
                code=code,
            )


def _lever(path: Path) -> LeverFound:
    """Fit the lever factor to a file with the columns x_um and z_um."""
    x_um, z_um = read_columns(path, STACK, TOOL)
    _refuse_huge(path, {"x_um": x_um, "z_um": z_um}, "E3622")
    try:
        lever = lever_factor(x_um, z_um)
    except RecordError as error:
        message = error.message.rstrip(".")
        raise RecordError(f"{path.name}: {message}.", hint=error.hint, code=error.code) from error
    return LeverFound(lever.factor, half_width(lever.sd), lever.offset_um, len(x_um))


@dataclass(frozen=True, slots=True, repr=False)
class CalibrationReport(Result):
    """The result of a calibration.

    path : the calibration file; None if nothing was saved
    serial : of the machine that was driven; None if files were fitted
    is_own : whether the machine uses the file without naming it
    replaced : whether an older file was replaced
    """

    findings: Findings
    path: Path | None
    serial: str | None
    simulated: bool
    is_own: bool = False
    replaced: bool = False
    lever: LeverFound | None = None

    @property
    def error(self) -> None:  # type: ignore[override]
        """None: an error of a calibration is raised."""

    @property
    def model(self) -> ActuatorModel:
        """The model: voltage to displacement, and back."""
        return self.findings.identification.model

    @property
    def accepted(self) -> bool:
        """Whether the calibration is accepted."""
        return self.findings.identification.accepted

    @property
    def problems(self) -> tuple[str, ...]:
        """The reasons against using it, each with its remedy."""
        return tuple(self.findings.identification.problems)

    @property
    def held_out(self) -> ErrorFigures:
        """Errors on blocks of the records that the model did not see."""
        return self.findings.held_out

    @property
    def validated(self) -> ErrorFigures | None:
        """Errors on the files to validate, None without any."""
        return self.findings.validated

    def as_mapping(self) -> dict[str, object]:
        """Return the `result` of the JSON object."""
        return {
            **self.findings.as_mapping(),
            "calibration_file": str(self.path) if self.path else None,
            "serial": self.serial,
            "lever": self.lever,
        }

    def brief(self) -> list[str]:
        """Return whether it is accepted, and its errors."""
        errors = self.validated or self.held_out
        accepted = "accepted with restrictions" if self.findings.identification.restrictions else "accepted"
        verdict = accepted if self.accepted else "not accepted"
        return [verdict, f"{errors.rms_um:.2f} µm rms and {errors.max_um:.2f} µm at most on data not fitted"]

    def rows(self) -> list[JsonValue]:
        """Return the errors of each model, in µm and in % of the range, on data that none of them saw."""
        errors = {"edmctl": self.validated or self.held_out, **self.findings.baselines}
        return [to_json_value({"model": name, **asdict(figures)}) for name, figures in errors.items()]


def calibrate_machine(
    checked: CheckedCalibration, seed: int, observer: Observer, warn: Warn
) -> CalibrationReport:
    """Drive the machine, fit, and save. If no calibration results, the measured record is kept."""
    where, environ = checked.where, checked.surroundings.environ
    with connected(None, checked.setup, seed, observer.note, where, checked.surroundings) as bench:
        identity = bench.machine.identity
        own = kept_path("calibration", identity.serial, environ, lasting=where.lasting)
        path = checked.request.output or own
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
        warn(doubtful(check_record(record), "W3610"))
        if measured.lost_frames:
            warn([failures.telemetry_lost(lost_frames=measured.lost_frames)])
        findings = _fit([record], checked, observer)
        is_own, replaced = checked.request.output is None and where.lasting, path.exists()
        if is_own and replaced and not findings.identification.accepted:
            path = path.with_name(f"{path.stem}-not-accepted{path.suffix}")
            is_own = replaced = False
            warn([failures.calibration_in_use_stays(path=path), _kept(record, path)])
        _save(findings, path, checked, identity.serial, simulated=identity.simulated)
    except BaseException:
        warn([_kept(record, path)])  # it took minutes of machine time
        raise
    return CalibrationReport(
        findings, path, identity.serial, identity.simulated, is_own, replaced, checked.lever
    )


def calibrate_files(checked: CheckedCalibration, observer: Observer) -> CalibrationReport:
    """Fit measured files, and save if the request names an output file."""
    output = checked.request.output
    findings = _fit([given.record for given in checked.sources], checked, observer)
    if output is None:
        observer.note("nothing is saved: --output FILE writes a calibration that `machine` can use")
    else:
        _save(findings, output, checked, None, simulated=False)
    return CalibrationReport(findings, output, None, simulated=False, lever=checked.lever)


def _fit(records: Sequence[Record], checked: CheckedCalibration, observer: Observer) -> Findings:
    observer.note(f"fitting {count(sum(len(record.t_s) for record in records))} samples")
    validation = [given.record for given in checked.validation]
    return find(records, validation, checked.refit, checked.request.delay_s)


def _save(
    findings: Findings, path: Path, checked: CheckedCalibration, serial: str | None, *, simulated: bool
) -> None:
    """Write the calibration file; a signal no longer interrupts."""
    made = Made(
        utc=datetime.now(UTC).isoformat(timespec="seconds"),
        edmctl=__version__,
        serial=serial,
        simulated=simulated,
        records=[
            measured_file(given.path, len(given.record.t_s), given.record.previous_v)
            for given in checked.sources
        ],
    )
    calibration = calibration_of(
        findings.identification, made, findings.held_out_baselines, [asdict(file) for file in findings.files]
    )
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
