"""The name and the header of a run file."""

from __future__ import annotations

import getpass
import re
import socket
import threading
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.jobs.corrections import Choice
from edmctl.jobs.plan import Plan
from edmctl.planning.rules.load import LoadedProfile
from edmctl.profile.read import SET_OPTION, read_chain
from edmctl.profile.setup import Setup
from edmctl.record.journal import journal_path
from edmctl.record.rows import RunMeta, SourceText, profile_leaves
from edmctl.toml_text import toml_scalar, toml_tables
from edmctl.version import __version__

if TYPE_CHECKING:
    from edmctl.machine.interface import MachineIdentity


@dataclass(frozen=True, slots=True)
class RunName:
    """Name, start (UTC) and run file of a run, and the run that it resumes, if any."""

    run_id: str
    path: Path
    start: datetime
    parent: str = ""

    @property
    def partial(self) -> Path:
        """The file's name until it is finished."""
        return self.path.with_name(self.path.name + ".partial")

    @property
    def journal(self) -> Path:
        """Path of the journal until the job is done."""
        return journal_path(self.path)


_GIVEN: set[Path] = set()
"""Names that this process has given to runs: jobs of several threads begin in the same millisecond."""
_LOCK = threading.Lock()


def name_run(
    folder: Path, run_id: str | None, loaded: LoadedProfile | None, start: datetime, command: str = ""
) -> RunName:
    """Name a run by `run_id`, or else by the profile's file name and the time: `cu270-20260131T101500.250Z`.

    A `command` other than `machine` is the first word. Raises UsageError (E2004) if the id is not a plain file name.
    """
    if run_id is not None:
        return RunName(run_id, run_path(folder, run_id), start)
    words = [command, plain_name(loaded.path.stem) if loaded else ""]
    while True:
        stamp = f"{start:%Y%m%dT%H%M%S}.{start.microsecond // 1000:03d}Z"
        run_id = "-".join([*filter(None, words), stamp])
        name = RunName(run_id, run_path(folder, run_id), start)
        with _LOCK:
            is_new = name.path not in _GIVEN
            _GIVEN.add(name.path)
        if is_new and not name.path.exists() and not name.partial.exists():
            return name
        start += timedelta(milliseconds=1)


def plain_name(text: str) -> str:
    """Return `text` with the characters that a file name can contain."""
    return re.sub(r"[^A-Za-z0-9._+-]", "-", text).lstrip("._+-")[:80] or "run"


def run_path(folder: Path, run_id: str) -> Path:
    """Return a run file's path. Raises UsageError (E2004) when the id is no plain file name, TypeError no text."""
    if not isinstance(run_id, str):
        raise TypeError(f"a run id has to be text, not {type(run_id).__name__}")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,119}", run_id):
        raise failures.run_id_not_a_file_name(run_id=run_id)
    return folder / f"{run_id}.h5"


def run_meta(
    name: RunName,
    plan: Plan,
    seed: int | None,
    identity: MachineIdentity,
    choice: Choice,
    procedure: str,
    drift_text: str = "",
) -> RunMeta:
    """Return the header of a run; `drift_text` is the drift file in use."""
    loaded, profile = plan.loaded, plan.loaded.profile
    values = profile.model_dump(mode="json", by_alias=True, exclude_none=True)
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # containers may have no login name
        user = ""
    return RunMeta(
        run_id=name.run_id,
        parent_run=name.parent,
        parent_time_s=plan.resumed.state.time_s if plan.resumed else 0.0,
        title=_title(loaded),
        start_time=name.start.isoformat(timespec="milliseconds"),
        command=list(plan.surroundings.command),
        host=socket.gethostname(),
        simulated=identity.simulated,
        seed=seed,
        profile_text=loaded.text,
        profile_sha256=loaded.sha256,
        sim_sha256=loaded.sim_sha256,
        edmctl_version=__version__,
        procedure=procedure,
        profile_path=str(loaded.path),
        profile_parents=tuple(
            SourceText(source.name, source.text) for source in read_chain(loaded.path).sources[1:]
        ),
        profile_leaves=profile_leaves({**values, "sim": loaded.sim.model_dump(mode="json")}),
        profile_overrides=loaded.overrides,
        setup_text=plan.setup_text,
        setup_toml=_setup_toml(plan.setup),
        setup_path=str(plan.setup.file or ""),
        setup_sha256=plan.setup.sha256,
        protocol_version=identity.protocol,
        firmware_version=identity.firmware,
        controller_serial=identity.serial,
        calibration=choice.used.text,
        calibration_text=choice.text,
        drift_text=drift_text,
        user=user,
        work_material=profile.work.material,
        work_thickness_um=profile.work.thickness_um,
        tool_material=profile.tool.material,
        tool_diameter_um=profile.tool.diameter_um,
    )


def _title(loaded: LoadedProfile) -> str:
    """Return the job's own description; an inherited or overridden one may describe another job."""
    import tomllib

    meta = loaded.profile.meta
    changed = {line.partition(" ")[0] for line in loaded.overrides if line.endswith(f", {SET_OPTION})")}
    own = tomllib.loads(loaded.text).get("meta", {}).get("description")
    if "meta.description" in changed:
        return meta.description or meta.name
    is_another = {key.partition(".")[0] for key in changed} & {"target", "tool", "work", "path", "sites"}
    return meta.description if meta.description == own and own and not is_another else meta.name


def _setup_toml(setup: Setup) -> str:
    """Every value of a setup as TOML: those outside any table first, as TOML wants it."""
    values = setup.model_dump(mode="json", exclude_none=True)
    tables = {name: value for name, value in values.items() if isinstance(value, dict)}
    plain = {name: value for name, value in values.items() if name not in tables}
    head = "".join(f"{name} = {toml_scalar(value)}\n" for name, value in plain.items())
    return f"{head}{toml_tables(tables)}\n"
