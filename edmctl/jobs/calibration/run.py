"""From a checked request to a calibration file: measure where a machine is to be driven, fit, save."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl.dataclasses import asdict, dataclass
from edmctl.errors import Diagnostic, EdmError
from edmctl.jobs.calibration.request import CheckedCalibration, LeverFound, check_writable, doubtful
from edmctl.jobs.connect import connected, introduction
from edmctl.jobs.surroundings import Warn
from edmctl.jsonout import JsonValue, to_json_value
from edmctl.profile.folders import default_path, fresh_path
from edmctl.results.progress import Observer
from edmctl.results.result import Result
from edmctl.version import __version__
from edmctl.wording import count

if TYPE_CHECKING:
    from edmctl.actuator.model import ActuatorModel
    from edmctl.actuator.record import Record
    from edmctl.actuator.validation import ErrorFigures
    from edmctl.jobs.calibration.fit import Findings
    from edmctl.procedures.actuator.calibration import CalibrationPlan, MeasuredActuator


@dataclass(frozen=True, slots=True, repr=False)
class CalibrationReport(Result):
    """What was found, and where it is now.

    path : the calibration file; None where nothing was saved
    serial : of the machine that was driven, None when files were fitted
    is_own : whether the file is the one that this machine uses by itself; a virtual machine that is gone with its
        command uses none unless it is named
    replaced : whether it stands in the place of an older one
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
        """None: what ends a calibration is raised."""

    @property
    def model(self) -> ActuatorModel:
        """The model: voltage to displacement, and back."""
        return self.findings.identification.model

    @property
    def accepted(self) -> bool:
        """Whether nothing stands against using it."""
        return self.findings.identification.accepted

    @property
    def problems(self) -> tuple[str, ...]:
        """What stands against using it, each with its remedy."""
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
    plan: CalibrationPlan, checked: CheckedCalibration, seed: int, observer: Observer, warn: Warn
) -> CalibrationReport:
    """Drive the machine, fit, and save. What was measured is kept where it comes to no calibration."""
    from edmctl.jobs.creep_left import CreepNote
    from edmctl.procedures.actuator.calibration import measure_actuator, plan_calibration
    from edmctl.process.rest_drift import CreepLeft

    with connected(None, checked.setup, seed, observer.note, checked.where, checked.surroundings) as bench:
        identity = bench.machine.identity
        place = default_path if checked.where.lasting else fresh_path
        path = checked.output or place(identity.serial, checked.surroundings.environ)
        check_writable(path)
        note = CreepNote(bench, checked.where, checked.surroundings.environ)
        note.take_away()
        bench.begin()
        setup = checked.setup if bench.own_setup is None else bench.own_setup
        plan = plan if bench.own_setup is None else plan_calibration(setup)
        observer.note(f"{introduction(checked.where, bench)}; {setup.in_words()}")
        measured = measure_actuator(bench.machine, setup, plan, observer)
        note.leave(CreepLeft.none(0.0))
    with _kept_on_failure(measured.record, path, warn):
        warn(_doubts(measured))
        findings = _fit([measured.record], checked, observer)
        is_own, replaced = checked.output is None and checked.where.lasting, path.exists()
        if is_own and replaced and not findings.identification.accepted:
            path = path.with_name(f"{path.stem}-not-accepted{path.suffix}")
            is_own = replaced = False
            message = f"The calibration in use stays: the new one was not accepted, and is in {path}."
            hint = "Put right what it says, and calibrate again; --calibration FILE uses it all the same."
            not_replaced = Diagnostic("W3652", message, hint, is_warning=True)
            warn([not_replaced, _kept(measured.record, path)])
        _save(findings, path, checked, identity.serial, simulated=identity.simulated)
    return CalibrationReport(
        findings, path, identity.serial, identity.simulated, is_own, replaced, checked.lever
    )


def calibrate_files(checked: CheckedCalibration, observer: Observer) -> CalibrationReport:
    """Fit measured files, and save where a name was given."""
    findings = _fit([given.record for given in checked.sources], checked, observer)
    if checked.output is None:
        observer.note("nothing is saved: --output FILE writes a calibration that `machine` can use")
    else:
        _save(findings, checked.output, checked, None, simulated=False)
    return CalibrationReport(findings, checked.output, None, simulated=False, lever=checked.lever)


def _doubts(measured: MeasuredActuator) -> list[Diagnostic]:
    from edmctl.actuator.checks import check_record

    doubts = doubtful(check_record(measured.record), "W3610")
    if measured.lost_frames:
        message = f"{measured.lost_frames} frames of telemetry were lost on the line."
        hint = "Turning points may be missing: look at the line, and calibrate again."
        doubts.append(Diagnostic("W3611", message, hint, is_warning=True))
    return doubts


def _fit(records: Sequence[Record], checked: CheckedCalibration, observer: Observer) -> Findings:
    from edmctl.jobs.calibration.fit import find

    observer.note(f"fitting {count(sum(len(record.t_s) for record in records))} samples")
    validation = [given.record for given in checked.validation]
    return find(records, validation, checked.refit, checked.delay_s)


def _save(
    findings: Findings, path: Path, checked: CheckedCalibration, serial: str | None, *, simulated: bool
) -> None:
    """Write the calibration file; from here on a signal could only cut off what is settled."""
    from edmctl.profile.calibration import Made, calibration_of, measured_file, save_calibration

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
    save_calibration(path, calibration)


@contextmanager
def _kept_on_failure(record: Record, path: Path, warn: Warn) -> Iterator[None]:
    """Keep what was measured in a file when it comes to no calibration: it took minutes of machine time."""
    try:
        yield
    except BaseException:
        warn([_kept(record, path)])
        raise


def _kept(record: Record, path: Path) -> Diagnostic:
    """Write the record beside the calibration, or where that cannot be, into the present folder."""
    from edmctl.record.columns import write_columns

    name = f"{path.stem}-record-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.h5"
    for kept in (path.with_name(name), Path(name)):
        try:
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_columns(kept, {"t_s": record.t_s, "u_V": record.u_v, "y_um": record.y_um})
        except (EdmError, OSError):
            continue
        hint = f"Fit it again with `edmctl calibrate --from {kept}`."
        return Diagnostic("W3660", f"What was measured is kept in {kept}.", hint, is_warning=True)
    message = "What was measured is lost: it could not be written beside the calibration, nor here."
    return Diagnostic("W3660", message, "Make room, and calibrate again.", is_warning=True)
