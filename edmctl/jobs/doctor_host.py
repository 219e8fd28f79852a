"""What `doctor` finds: one check after the other; those of this computer, its files, and how its line is set."""

from __future__ import annotations

import dataclasses
import os
import platform
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from edmctl.dataclasses import dataclass, field
from edmctl.errors import EdmError, PreconditionError, installing
from edmctl.jobs.plan import where_is
from edmctl.jobs.runs.opening import on_machine
from edmctl.link.ports import is_adapter
from edmctl.profile.folders import find_calibration
from edmctl.profile.setup import Setup, load_setup
from edmctl.results.equipment import Check, CheckStatus
from edmctl.version import __version__


def ok(name: str, message: str) -> Check:
    """A check without a finding."""
    return Check(name, CheckStatus.OK, message)


def warn(name: str, message: str, fix: str) -> Check:
    """A check with a finding that stops nothing."""
    return Check(name, CheckStatus.WARN, message, fix)


def fail(name: str, message: str, fix: str) -> Check:
    """A check with a finding that stops a job."""
    return Check(name, CheckStatus.FAIL, message, fix)


@dataclass(slots=True)
class Checks:
    """Every check done so far, in order."""

    done: list[Check] = field(default_factory=list)

    def add(self, *checks: Check) -> None:
        """Add checks."""
        self.done += checks

    def fail(self, name: str, error: EdmError) -> None:
        """Add a check that ended with an error."""
        self.done.append(fail(name, error.message, error.hint))

    def as_list(self) -> list[dict[str, str]]:
        """Every check as a mapping of plain values."""
        return [{**dataclasses.asdict(check), "status": check.status.value} for check in self.done]

    def error(self) -> PreconditionError | None:
        """The error of the failed checks; None where none failed."""
        failed = [check.name for check in self.done if check.status is CheckStatus.FAIL]
        if not failed:
            return None
        return PreconditionError(
            f"{len(failed)} of {len(self.done)} checks failed: {', '.join(failed)}.",
            hint="The fix stands beside each of them.",
            code="E8040",
        )


LIBRARIES = ("numpy", "scipy", "h5py", "pyserial", "pydantic")
LEAST_FREE_BYTES = 100e6
"""A job with every pulse recorded takes 26 MB in a quarter of an hour."""
COMFORTABLE_FREE_BYTES = 1e9
LOW_LATENCY_MS = 1
_SYS, _PROC = Path("/sys"), Path("/proc")


def versions() -> Check:
    """Python, edmctl and the libraries that a job needs."""
    found, missing = [f"edmctl {__version__}", f"Python {platform.python_version()}"], []
    for name in LIBRARIES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return fail("versions", f"Missing: {', '.join(missing)}.", f"Install them: {installing(*missing)}.")
    return ok("versions", ", ".join(found))


def run_folder(folder: Path) -> Check:
    """Whether run files can be written, and how much room there is."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not (place.is_dir() and os.access(place, os.W_OK | os.X_OK)):
        return fail(
            "run folder",
            f"{folder} cannot be written.",
            "Name another folder with --out, or allow writing there.",
        )
    free_bytes = shutil.disk_usage(place).free
    told = f"{folder}: {free_bytes / 1e9:.1f} GB free"
    if free_bytes < LEAST_FREE_BYTES:
        return fail("run folder", f"{told}.", "Free some space, or name another disk with --out.")
    if free_bytes < COMFORTABLE_FREE_BYTES:
        return warn("run folder", f"{told}.", "Free some space before a long job.")
    return ok("run folder", told)


def load(checks: Checks, path: Path | None) -> Setup:
    """Read the setup; the default one where it cannot be read."""
    try:
        setup = load_setup(path)
    except EdmError as error:
        checks.fail("setup", error)
        return Setup()
    return setup


def setup_used(setup: Setup) -> Check:
    """Return which setup is in effect."""
    return ok("setup", setup.in_words())


def calibration(environ: Mapping[str, str], setup: Setup, serial: str, port: str) -> Check:
    """Whether the calibration that a job would use is there, can be read, and is of this machine."""
    from edmctl.profile.calibration import load_calibration

    fresh = not where_is(port or None, setup).lasting
    path = find_calibration(None, environ, setup.actuator.calibration, None if fresh else serial)
    if fresh:
        # It is the same machine again only with its seed, which its number tells.
        seed = serial.removeprefix("SIM-")
        remedy = f"Run `edmctl calibrate --seed {seed}`, and name its file with --calibration."
    else:
        remedy = f"Run `{on_machine('edmctl calibrate', port)}`."
    if path is None:
        none = "None is named" if fresh else f"None of {serial}"
        if setup.sensor.fitted:
            return warn("calibration", f"{none}; a job makes a quick one of its own.", remedy)
        return fail("calibration", f"{none}, and no displacement sensor is fitted.", remedy)
    try:
        found = load_calibration(path)
    except EdmError as error:
        return fail("calibration", error.message, error.hint or remedy)
    if found.serial != serial:
        return warn("calibration", f"{path} is of {found.serial}; this machine is {serial}.", remedy)
    if not found.quality.accepted:
        return warn("calibration", f"{path} was not accepted.", remedy)
    return ok("calibration", str(path))


def line_settings(selector: str | None, sys: Path = _SYS, proc: Path = _PROC) -> Sequence[Check]:
    """What Linux tells about a serial port: the wait of an FTDI adapter, and ModemManager, which types into it."""
    device = os.path.realpath(selector or "")
    if selector is None or not device.startswith("/dev/") or not is_adapter(device):
        return ()
    checks: list[Check] = []
    latency = sys / "bus" / "usb-serial" / "devices" / Path(device).name / "latency_timer"
    with suppress(OSError, ValueError):
        wait_ms = int(latency.read_text())
        if wait_ms > LOW_LATENCY_MS:
            checks.append(
                warn(
                    "latency timer",
                    f"The adapter keeps bytes back for {wait_ms} ms.",
                    f"Install the udev rule of docs/, or `echo {LOW_LATENCY_MS} | sudo tee {latency}`.",
                )
            )
        else:
            checks.append(ok("latency timer", f"{wait_ms} ms"))
    if _runs("ModemManager", proc):
        checks.append(
            warn(
                "ModemManager",
                "ModemManager runs; it sends AT commands into a port that has just been plugged in.",
                "Install the udev rule of docs/, or `sudo systemctl disable --now ModemManager`.",
            )
        )
    return checks


def _runs(program: str, proc: Path) -> bool:
    for comm in proc.glob("[0-9]*/comm"):
        with suppress(OSError):
            if comm.read_text().strip() == program:
                return True
    return False
