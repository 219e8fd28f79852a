"""Choose the drift file of a run, with warnings; keep the creep that a use of the actuator leaves."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic
from edmctl.files import json_of, read_bytes
from edmctl.jobs.connected_machine import ConnectedMachine
from edmctl.jobs.plan import MachineAddress
from edmctl.process.rest_drift import CreepLeft, DriftModel
from edmctl.profile.folders import creep_path, find_drift
from edmctl.profile.read import read_source
from edmctl.profile.setup import Setup
from edmctl.quantity import Value
from edmctl.wording import duration, plural

_DAY_S = 86_400.0
FADED_S = 1800.0
"""Creep of a full stroke is negligible after this time."""
CLOCK_STEP_S = 3600.0
"""Tolerated correction of a clock: a file may be this much newer than now."""


@dataclass(frozen=True, slots=True)
class DriftChoice:
    """The drift that a job corrects, None without a usable file; the file in words, its text, and warnings.

    `touch_um_per_s` is the drift of touches when it was measured.
    """

    model: DriftModel | None = None
    text: str = ""
    toml: str = ""
    warnings: tuple[Diagnostic, ...] = ()
    touch_um_per_s: Value | None = None


def choose_drift(
    environ: Mapping[str, str], setup: Setup, serial: str, *, lasting: bool = True
) -> DriftChoice:
    """Find the result of `measure-drift` for the machine with that serial number.

    A machine that is not `lasting` (a virtual one of this command) has none of its own, so that a seed always
    gives the same result. A file that is too old or of another machine is ignored with a warning. Raises
    RecordError if the file cannot be used.
    """
    if not (setup.drift.use and setup.sensor.fitted):
        return DriftChoice()
    path = find_drift(environ, setup.drift.file, serial if lasting else None)
    if path is None:
        return DriftChoice()
    from edmctl.profile.drift_file import load_drift

    found = load_drift(path)
    if found.made.serial != serial:
        return _ignored("W8106", f"{path} is of {found.made.serial}; this machine is {serial}.")
    age_s = found.age_s()
    if not age_s >= -CLOCK_STEP_S:
        return _ignored("W8107", f"{path} does not say when it was made, or says a time to come.")
    if age_s > setup.drift.max_age_days * _DAY_S:
        age = plural(int(age_s / _DAY_S), "day")
        return _ignored("W8107", f"{path} is {age} old; drift.max_age_days is {setup.drift.max_age_days:g}.")
    words = f"drift file {path} (sha256 {found.sha256[:12]})"
    model, measured = believed(found.model(), setup), found.measured
    touch = Value(measured.touch_um_per_s, measured.touch_u_um_per_s).widened(model.apart_u_um_per_s)
    return DriftChoice(model, words, read_source(path).text, touch_um_per_s=touch)


def believed(model: DriftModel, setup: Setup) -> DriftModel:
    """Return the model of a job: the drift between tool and workpiece may have changed since it was measured."""
    apart_u_um_per_s = math.hypot(model.apart_u_um_per_s, setup.drift.apart_u_um_per_s)
    return replace(model, apart_u_um_per_s=apart_u_um_per_s)


def doubts_of_use(choice: DriftChoice, unknown_use_s: float) -> list[Diagnostic]:
    """Return a warning if creep of an unknown use of the actuator may affect the zero-voltage holds."""
    if choice.model is None or unknown_use_s >= FADED_S:
        return []
    return [failures.actuator_use_unknown(unknown_use_s=duration(unknown_use_s))]


def _ignored(code: str, message: str) -> DriftChoice:
    hint = "Drift is not corrected in this run. Run `edmctl measure-drift` here."
    return DriftChoice(warnings=(Diagnostic(code, message, hint, is_warning=True),))


SCHEMA = "edmctl-creep/1"


class CreepNote:
    """The creep that a use of the actuator leaves, kept in a file of the machine next to its drift file.

    A command removes the file before the actuator moves, and writes it again when it has followed the creep to its
    end. A command that is killed or follows no creep leaves no file, so that the next command knows that.
    """

    def __init__(self, bench: ConnectedMachine, where: MachineAddress, environ: Mapping[str, str]) -> None:
        self._bench, self._is_new = bench, bench.seed is not None
        file = where.bench_file
        self._machine = str(file.resolve()) if file is not None else ""
        serial = bench.machine.identity.serial
        self._path: Path | None = creep_path(serial, environ) if where.lasting else None

    def read(self) -> CreepLeft | None:
        """Return the remaining creep; None if nothing has used the actuator.

        Without a file it is that of a use that may have ended just now.
        """
        if self._is_new:
            return None
        if self._path is None:
            return CreepLeft.none(0.0)
        try:
            values = json_of(read_bytes(self._path))
            if values["schema"] != SCHEMA or values["machine"] != self._machine:
                return CreepLeft.none(0.0)
            left = CreepLeft.of(values["lags_um"], _number(values["unknown_s"], math.inf))
            utc_s, bench_s = _number(values["utc_s"], math.nan), _number(values["bench_s"], math.nan)
        except (OSError, ValueError, KeyError, TypeError, OverflowError):
            return CreepLeft.none(0.0)
        passed_s = self._bench.now.since_s(utc_s, bench_s)
        return left.after(passed_s) if passed_s < math.inf else CreepLeft.none(0.0)

    def take_away(self) -> None:
        """Remove the file before the actuator moves. Raises RunFileError E9012 if that fails: it would mislead."""
        if self._path is None:
            return
        try:
            self._path.unlink(missing_ok=True)
        except OSError as refused:
            raise failures.use_record_not_removed(
                path=self._path, reason=refused.strerror or refused
            ) from refused

    def leave(self, left: CreepLeft) -> None:
        """Write the remaining creep. A disk error is ignored: the next command knows less."""
        if self._path is None:
            return
        values = {
            "schema": SCHEMA,
            "machine": self._machine,
            "utc_s": time.time(),
            "bench_s": _or_none(self._bench.now.bench_s),
            "lags_um": left.um.tolist(),
            "unknown_s": _or_none(left.unknown_s),
        }
        with suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            beside = self._path.with_suffix(".new")
            beside.write_text(json.dumps(values, allow_nan=False), encoding="utf-8")
            beside.replace(self._path)


def _number(value: float | None, instead: float) -> float:
    return instead if value is None else float(value)


def _or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None
