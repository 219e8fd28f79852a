"""The journal of a run: the newest state of its job, on the disk before the machine goes on.

`<run>.journal` lies beside the run file until the run has ended: one JSON object with a hash over its content,
replaced at once, so that a computer that dies leaves the state before or the state after, never a mixture.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import RunFileError
from edmctl.files import json_of, read_bytes, replace_file
from edmctl.jsonout import to_json_value
from edmctl.record.disk import DiskThread, sync_if_possible
from edmctl.record.json_rows import record_of

SCHEMA = "edmctl-journal"
VERSION = 2
PERIOD_S = 5.0
"""Longest age of the state of a cut that is not urgent, in the machine's time."""
SUFFIX = ".journal"
_SEPARATOR = ","
Texts = dict[int, tuple[object, str]]
"""Canonical JSON text of values by their identity; the value is kept so that its identity is not reused."""


class State(Protocol):
    """Progress of a job."""

    @property
    def time_s(self) -> float:
        """The machine's time."""

    def as_mapping(self) -> dict[str, object]:
        """Values that JSON holds."""


@dataclass(frozen=True, slots=True)
class JournalledJob:
    """The job and the machine that a journal belongs to.

    `parents` are the runs that this one continues, the first of them first. Paths are absolute, `setup` is empty for
    the stock machine and `calibration` if none was named. `port` is for people; nothing is ever driven by it.
    `boots` counts the starts of the controller. `places` are name, x and y (µm), θ (degrees) and depth (µm, NaN if
    the target has it).
    """

    run_id: str
    start: str
    profile: str
    overrides: tuple[str, ...]
    profile_sha256: str
    sim_sha256: str
    setup: str
    setup_sha256: str
    calibration: str
    allow_model: bool
    port: str
    serial: str
    boots: int
    tool: str
    seed: int | None
    places: tuple[tuple[str, float, float, float, float], ...]
    parents: tuple[str, ...] = ()

    @property
    def family(self) -> tuple[str, ...]:
        """Names of the runs that it continues, and its own."""
        return (*self.parents, self.run_id)


@dataclass(frozen=True, slots=True)
class Journal:
    """Content of a journal: the job, its state, the time (UTC, s since 1970) and the stage positions (µm).

    `truth` contains the true values of a virtual bench in the same process, and `clock_s` its time: such a bench
    rests between commands, so the calendar does not apply. Elsewhere it is NaN.
    """

    job: JournalledJob
    state: Mapping[str, object]
    written_utc_s: float
    x_um: float
    y_um: float
    truth: Mapping[str, object] | None = None
    clock_s: float = math.nan


class JournalFile:
    """Keeps the state of a running job in the file at `path`, which `disk` replaces.

    stages_um : reads the stage positions from the machine; only with urgent states, when no cut is going on
    truth, clock_s : true values and time of a virtual bench, at every write
    """

    def __init__(
        self,
        path: Path,
        job: JournalledJob,
        stages_um: Callable[[], tuple[float, float]],
        truth: Callable[[], Mapping[str, object] | None] = lambda: None,
        clock_s: Callable[[], float] = lambda: math.nan,
        disk: DiskThread | None = None,
    ) -> None:
        self.path = path
        self._job = job
        self._stages_um, self._truth, self._clock_s = stages_um, truth, clock_s
        self._disk = disk or DiskThread()
        self._at_um = (math.nan, math.nan)
        self._kept_s = -math.inf
        self._texts: Texts = {}

    def keep(self, state: State, *, urgent: bool = False) -> None:
        """Keep a state: urgent ones at once, others every `PERIOD_S`. Raises RunFileError E9040, E9009, or later."""
        if not urgent and state.time_s - self._kept_s < PERIOD_S:
            return
        if urgent:
            self._at_um = self._stages_um()
        mapping, times = state.as_mapping(), (self._truth(), self._clock_s())
        journal = Journal(self._job, mapping, time.time(), *self._at_um, *times)

        def write() -> None:
            write_journal(self.path, journal, self._texts)

        if urgent:
            self._disk.run(self.path, write)
        elif not self._disk.start(write):
            return
        self._kept_s = state.time_s

    def remove(self) -> None:
        """Remove the journal of a run that has ended. Raises RunFileError E9040."""
        remove_journal(self.path)


def journal_path(run_file: Path) -> Path:
    """Return the journal's name of a run file: `runs/a.h5` → `runs/a.journal`."""
    return run_file.with_name(run_file.name.removesuffix(".h5") + SUFFIX)


def write_journal(path: Path, journal: Journal, texts: Texts | None = None) -> None:
    """Replace the journal and sync it; `texts` keeps JSON of job and sites. Raises RunFileError E9040."""
    try:
        replace_file(path, _text(journal, {} if texts is None else texts))
        sync_if_possible(path.parent)
    except OSError as refused:
        raise _unwritable(path, refused) from refused


def remove_journal(path: Path) -> None:
    """Remove a journal that may be gone already. Raises RunFileError E9040."""
    try:
        path.unlink(missing_ok=True)
        sync_if_possible(path.parent)
    except OSError as refused:
        raise _unwritable(path, refused) from refused


def read_journal(path: Path) -> Journal:
    """Return a journal. Raises FileNotFoundError, RunFileError E9041, PreconditionError E8052 if it is damaged."""
    try:
        data = read_bytes(path)
    except FileNotFoundError:
        raise
    except OSError as refused:
        raise failures.journal_unreadable(path=path, reason=refused.strerror or refused) from refused
    try:
        envelope = json_of(data)
        if not isinstance(envelope, dict) or envelope.get("schema") != SCHEMA:
            raise ValueError("it is no journal of a run")
        version, content = envelope["version"], envelope["content"]
        if not isinstance(version, int) or version < 1:
            raise ValueError("its version is no number")
        if version > VERSION:
            raise failures.journal_of_later_version(path=path, later=version, version=VERSION)
        if envelope["sha256"] != _hash_of(_canonical(content)):
            raise ValueError("its content does not fit its check sum")
        return record_of(Journal, content)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise failures.journal_damaged(path=path, error=error) from error


def _text(journal: Journal, texts: Texts) -> bytes:
    """Return the file of a journal. The cached texts of `texts` are replaced by those that this journal uses."""
    used: Texts = {}

    def cached(value: object) -> str:
        used[id(value)] = texts.get(id(value)) or (value, _canonical(value))
        return used[id(value)][1]

    state = {name: _canonical(value) for name, value in journal.state.items() if name != "done"}
    done = journal.state.get("done")
    if isinstance(done, list | tuple):
        state["done"] = f"[{_SEPARATOR.join(map(cached, done))}]"
    parts = {"job": cached(journal.job), "state": _object(state)}
    for name in ("written_utc_s", "x_um", "y_um", "truth", "clock_s"):
        parts[name] = _canonical(getattr(journal, name))
    content = _object(parts)
    texts.clear()
    texts.update(used)
    envelope = {"schema": SCHEMA, "version": VERSION, "sha256": _hash_of(content)}
    whole = _object({name: _canonical(value) for name, value in envelope.items()} | {"content": content})
    return f"{whole}\n".encode()


def _hash_of(canonical: str) -> str:
    return hashlib.sha256(canonical.encode()).hexdigest()


def _canonical(value: object) -> str:
    """Return the JSON text with sorted keys over which a journal is hashed; null replaces NaN and infinity."""
    return json.dumps(to_json_value(value, is_exact=True), sort_keys=True, separators=(_SEPARATOR, ":"))


def _object(members: Mapping[str, str]) -> str:
    """Return the JSON object of texts by name, with sorted names."""
    texts = (f"{json.dumps(name)}:{members[name]}" for name in sorted(members))
    return f"{{{_SEPARATOR.join(texts)}}}"


def _unwritable(path: Path, refused: OSError) -> RunFileError:
    return failures.journal_not_kept(path=path, reason=refused.strerror or refused)
