"""What a use of the actuator leaves for the next one: creep that goes back for an hour, kept beside the drift file.

Whatever drives the actuator takes the note away first, and leaves a new one where it has followed the creep to its
end. So a command that was killed, and one that follows nothing, leave none, and the next one knows that.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from edmctl.errors import RunFileError
from edmctl.files import json_of, read_bytes
from edmctl.jobs.connected_machine import ConnectedMachine
from edmctl.jobs.plan import MachineAddress
from edmctl.process.rest_drift import CreepLeft
from edmctl.profile.folders import creep_path

SCHEMA = "edmctl-creep/1"


class CreepNote:
    """The note of one machine. A fresh virtual bench was not used before, and leaves none where no file keeps it."""

    def __init__(self, bench: ConnectedMachine, where: MachineAddress, environ: Mapping[str, str]) -> None:
        self._bench, self._is_new = bench, bench.seed is not None
        file = where.bench_file
        self._machine = str(file.resolve()) if file is not None else ""
        serial = bench.machine.identity.serial
        self._path: Path | None = creep_path(serial, environ) if where.lasting else None

    def read(self) -> CreepLeft | None:
        """Return what is left by now, None where nothing has used the actuator.

        Where nobody has noted it, it is of a use that may have ended just now.
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
        """Before the actuator moves. Raises RunFileError E9012 where it stays: it would mislead."""
        if self._path is None:
            return
        try:
            self._path.unlink(missing_ok=True)
        except OSError as refused:
            raise RunFileError(
                f"Cannot remove {self._path}, which says how the actuator was used: {refused.strerror or refused}.",
                hint="Check its permissions, or remove it by hand.",
                code="E9012",
            ) from refused

    def leave(self, left: CreepLeft) -> None:
        """Note what is left now. That the disk refuses is no error of the job: the next one knows less."""
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
