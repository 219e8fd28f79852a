"""What `calibrate` is asked for: options that fit together, files that can be read, a place for the result."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, RecordError, RunFileError, UsageError
from edmctl.jobs import output_files
from edmctl.jobs.connect import known_controller
from edmctl.jobs.plan import MachineAddress, where_is
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.quantity import half_width

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from edmctl.actuator.record import Record
    from edmctl.actuator.validation import Refit
    from edmctl.procedures.actuator.calibration import CalibrationPlan
    from edmctl.profile.setup import Setup

LONGEST_NAME = 200
"""Bytes; a file system takes 255, and a file that is being written has a longer name."""
LARGEST = 1e30
"""Instruments write 9.9e37 where they read nothing, and squares of 1e155 are beyond all numbers."""
REFITS = ("zero", "gain")


@dataclass(frozen=True, slots=True)
class CalibrationRequest:
    """What the command line asks for."""

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
    """A checked request. `plan` is what to drive a machine through; None where nothing is driven."""

    setup: Setup
    where: MachineAddress
    simulated: bool | None
    sources: tuple[MeasuredRecord, ...]
    validation: tuple[MeasuredRecord, ...]
    refit: tuple[Refit, ...]
    delay_s: float | None
    output: Path | None
    plan: CalibrationPlan | None
    lever: LeverFound | None
    doubts: tuple[Diagnostic, ...]
    surroundings: Surroundings


def check(request: CalibrationRequest, surroundings: Surroundings = NONE) -> CheckedCalibration:
    """Check options and files, for the program in `surroundings`.

    Raises UsageError, ProfileError, RecordError, RunFileError, LinkLost, PreconditionError.
    """
    refit = _refit(request.refit)
    _check_numbers(request)
    from edmctl.profile.setup import load_setup

    setup = load_setup(request.setup)
    plan, simulated, where = None, None, MachineAddress()
    if not request.sources and not request.lever_only:
        from edmctl.procedures.actuator.calibration import plan_calibration

        where = where_is(request.port, setup, request.wait_s)
        if request.controller:
            where = replace(where, controller=known_controller(request.controller))
        simulated = True if where.in_process else None
        plan = plan_calibration(setup)
    if request.output is not None:
        check_new(request.output)
    histories = _histories(request)
    count = len(request.sources)
    sources, doubts = _read(request.sources, histories[:count])
    validation, more_doubts = _read(request.validation, histories[count:])
    return CheckedCalibration(
        setup=setup,
        where=where,
        simulated=simulated,
        sources=sources,
        validation=validation,
        refit=refit,
        delay_s=request.delay_s,
        output=request.output,
        plan=plan,
        lever=_lever(request.lever) if request.lever else None,
        doubts=(*doubts, *more_doubts),
        surroundings=surroundings,
    )


def check_new(path: Path) -> None:
    """Refuse a file that is there (RunFileError E9011) or could not be written (E9012)."""
    _check_name(path)
    output_files.check_free(path)
    check_writable(path)


def check_writable(path: Path) -> None:
    """Refuse (RunFileError E9012) a file that could not be written, going by the nearest folder that is there."""
    _check_name(path)
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if folder.is_dir() and os.access(folder, os.W_OK | os.X_OK) and not path.is_dir():
        return
    why = "is a folder" if path.is_dir() else f"{folder} is no folder that can be written"
    raise output_files.unwritable(f"the calibration file {path}", why, "Name another file with --output.")


def _check_name(path: Path) -> None:
    if len(os.fsencode(path.name)) > LONGEST_NAME:
        raise RunFileError(
            f"The name of the calibration file has {len(os.fsencode(path.name))} bytes; at most {LONGEST_NAME} fit.",
            hint="Give --output a shorter name.",
            code="E9012",
        )


def doubtful(sentences: Sequence[str], code: str) -> list[Diagnostic]:
    """Turn sentences that carry their remedy into warnings."""
    return [Diagnostic(code, sentence, "", is_warning=True) for sentence in sentences]


def _refit(text: str) -> tuple[Refit, ...]:
    words = {word.strip() for word in text.split(",")}
    if words == {"zero"}:
        return ("zero",)
    if words == set(REFITS):
        return ("gain", "zero")
    raise UsageError(
        f"--refit {text!r} is neither 'zero' nor 'gain,zero'.",
        hint="The zero is always set again; the gain too where the record is of another day.",
        code="E2020",
    )


def _check_numbers(request: CalibrationRequest) -> None:
    if not all(math.isfinite(volts) for volts in request.previous_v):
        raise UsageError(
            "--previous-voltage is no finite number.",
            hint="Give volts; leave it out where the actuator had been cycled over the range of the record.",
            code="E2021",
        )
    if request.delay_s is None:
        return
    from edmctl.actuator.identification import LONGEST_FIXED_DELAY_S

    if not 0.0 <= request.delay_s <= LONGEST_FIXED_DELAY_S:
        raise UsageError(
            f"--delay {request.delay_s:g} s does not lie between 0 and {LONGEST_FIXED_DELAY_S:g} s.",
            hint="Give seconds; leave it out to have it found.",
            code="E2022",
        )


def _histories(request: CalibrationRequest) -> list[float | None]:
    """What the actuator was held at before each file, those of --from first."""
    files, said = len(request.sources) + len(request.validation), request.previous_v
    if not said:
        return [None] * files
    if files and len(said) == 1:
        return [said[0]] * files
    if len(said) == files:
        return list(said)
    times = "once" if len(said) == 1 else f"{len(said)} times"
    named = (
        "no file is named" if not files else f"{files} files are named" if files > 1 else "1 file is named"
    )
    raise UsageError(
        f"--previous-voltage is given {times}, and {named} with --from and --validate.",
        hint="Give it once for all files, or once for each: those of --from first, then those of --validate.",
        code="E2021",
    )


def _read(
    paths: Sequence[Path], histories: Sequence[float | None]
) -> tuple[tuple[MeasuredRecord, ...], list[Diagnostic]]:
    if not paths:
        return (), []
    from edmctl.actuator.checks import check_record
    from edmctl.record.columns import read_record

    found: list[MeasuredRecord] = []
    doubts: list[Diagnostic] = []
    for path, previous_v in zip(paths, histories, strict=True):
        record = read_record(path, previous_v)
        columns = {"t_s": record.t_s, "u_V": record.u_v, "y_um": record.y_um}
        _refuse_huge(path, columns, "E3612")
        doubts += doubtful(check_record(record), "W3610")
        found.append(MeasuredRecord(path, record))
    return tuple(found), doubts


def _refuse_huge(path: Path, columns: dict[str, NDArray[np.float64]], code: str) -> None:
    """Raise RecordError for numbers that nothing can have measured; what is not finite is refused elsewhere."""
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
    from edmctl.actuator.lever import lever_factor
    from edmctl.record.columns import read_lever

    x_um, z_um = read_lever(path)
    _refuse_huge(path, {"x_um": x_um, "z_um": z_um}, "E3622")
    try:
        lever = lever_factor(x_um, z_um)
    except RecordError as error:
        message = error.message.rstrip(".")
        raise RecordError(f"{path.name}: {message}.", hint=error.hint, code=error.code) from error
    return LeverFound(lever.factor, half_width(lever.sd), lever.offset_um, len(x_um))
