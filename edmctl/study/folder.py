"""The folder of a study: file, profile, setup and plan as they were when it began, and the rows of its runs.

DIR/study.toml profile.toml setup.toml plan.json    written once; plan.json has the hashes of the others
DIR/rows/*.jsonl                                    appended, one file a writer
DIR/runs/*.h5                                       run files, with ledger and journals on a machine that lasts
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shlex
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from edmctl import failures
from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, EdmError, PreconditionError, ProfileError, RunFileError, UsageError
from edmctl.files import json_of, open_descriptor, read_bytes, user_path
from edmctl.jobs.output_files import make_folder, unwritable, write
from edmctl.jobs.plan import JobRequest
from edmctl.profile.folders import find_profile
from edmctl.profile.read import parse, read_chain, read_source
from edmctl.record.locks import exclusive
from edmctl.study.planning import PlannedStudy, base_request, check_plan
from edmctl.study.results import PlanDocument, StudyPlan, StudyRun
from edmctl.study.rows import Rows, StudyWriter, is_run_of, need, read_rows
from edmctl.study.study_file import StudySource, study_of
from edmctl.version import __version__

SCHEMA = "edmctl-study/2"
PLAN_BYTES = 40_000_000
"""A plan of 20,000 runs with 24 factors."""
MOMENT_S, LOOKS_EVERY_S = 0.5, 0.02
ADDING_S = 30.0
"""Runs are added one after the other: reading all rows takes a moment."""
STUDY, PROFILE, SETUP, CALIBRATION, PLAN, ROWS, RUNS = (
    "study.toml",
    "profile.toml",
    "setup.toml",
    "calibration.toml",
    "plan.json",
    "rows",
    "runs",
)


@dataclass(frozen=True, slots=True)
class StudyFolder:
    """A study that is run, or was: what it is never changes, `state` tells how far it has come."""

    path: Path
    source: StudySource
    plan: StudyPlan
    recipes: Mapping[int, tuple[str, str]]
    version: str
    changes: tuple[str, ...] = ()
    """What holds for every run beside what the file says."""
    has_setup: bool = False

    @property
    def rows(self) -> Path:
        """Folder of the rows."""
        return self.path / ROWS

    @property
    def runs(self) -> Path:
        """Folder of the run files."""
        return self.path.resolve() / RUNS

    @property
    def base(self) -> JobRequest:
        """The job that all runs begin with, from the folder's own files."""
        folder = self.path.resolve()  # for workers that stand in another one
        request = base_request(self.source, self.changes)
        setup = folder / SETUP if self.has_setup else None
        return replace(request, profile=str(folder / PROFILE), setup=setup)

    def command(self, name: str, *words: str) -> str:
        """Return the command `edmctl study NAME` about this study, as a shell takes it."""
        return shlex.join(["edmctl", "study", name, str(self.path), *words])

    def read(self) -> StudyState:
        """Return how far the study has come, by the rows that are there now."""
        rows = read_rows(self.rows)
        planned, factors = len(self.plan.runs), self.plan.factors
        added = [run for run in rows.added if run.number > planned and is_run_of(run, factors)]
        runs = (*self.plan.runs, *added)
        return StudyState(self, rows, tuple(map(rows.of, runs)))

    def writer(self) -> StudyWriter:
        """Return a new writer of rows."""
        return StudyWriter(self.rows)

    @contextmanager
    def claimed(self, part: str = "all", wait_s: float = MOMENT_S) -> Iterator[None]:
        """Hold a lock of the study: `all` to make runs, `suggestions` to add them.

        Raises PreconditionError E8201 if another command holds it for longer than `wait_s`.
        """
        self.rows.mkdir(parents=True, exist_ok=True)
        path, end_s = self.rows / f"{part}.lock", time.monotonic() + wait_s
        with ExitStack() as held:
            while True:
                try:
                    held.enter_context(_locked(path))
                    break
                except BlockingIOError:
                    if time.monotonic() < end_s:
                        time.sleep(LOOKS_EVERY_S)
                        continue
                except OSError as refused:
                    raise failures.study_folder_not_locked(path=path, reason=refused.strerror) from refused
                raise failures.study_is_running(path=self.path, command=self.command("status"))
            yield


@contextmanager
def _locked(path: Path) -> Iterator[None]:

    descriptor = open_descriptor(path, os.O_CREAT | os.O_RDWR)
    try:
        with exclusive(descriptor):
            yield
    finally:
        os.close(descriptor)


@dataclass(frozen=True, slots=True)
class StudyState:
    """A study with its rows: `runs` are the planned ones, then those that were added."""

    folder: StudyFolder
    rows: Rows
    runs: tuple[StudyRun, ...]

    def making_command(self, name: str, *words: str) -> str:
        """Return a command that makes runs, at the port of the machine on which they are made."""
        port = ["--port", self.rows.port] if self.rows.port else []
        return self.folder.command(name, *port, *words)

    def run(self, number: int) -> StudyRun:
        """Return a run by its number. Raises UsageError E2104 where there is none."""
        found = next((run for run in self.runs if run.planned.number == number), None)
        if found is None:
            raise failures.study_run_unknown(
                number=number, runs_count=len(self.runs), command=self.folder.command("status")
            )
        return found


def create_folder(path: Path, planned: PlannedStudy) -> StudyFolder:
    """Make the folder of a study, with all of its files or not at all.

    Raises RunFileError: E9101 the folder contains a study or something else, E9012 it cannot be written.
    """
    if not path.name:
        path = path.resolve()  # "." has no name beside which another can be made
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise _taken(path, planned)
    make_folder(path.parent)
    made = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    make_folder(made)
    try:
        for name, content in _files(planned).items():
            write(made / name, content)
        made.replace(path)  # onto nothing, or onto an empty folder
    except OSError as refused:
        if (path / PLAN).exists():
            raise _taken(path, planned) from None
        raise unwritable(f"into {path}", str(refused.strerror), "Check the path.") from refused
    finally:
        shutil.rmtree(made, ignore_errors=True)
    return open_folder(path)


def _is_same(there: StudyFolder, planned: PlannedStudy) -> bool:
    said = (planned.plan, planned.source.text, planned.changes)
    return (there.plan, there.source.text, there.changes) == said


def _taken(path: Path, planned: PlannedStudy) -> RunFileError:
    """Return the error of a folder that holds something: this study, another one, or no study at all."""
    if not (path / PLAN).exists():
        return failures.study_folder_not_empty(path=path)
    try:
        there = open_folder(path)
    except EdmError as error:
        return failures.folder_has_unreadable_study(path=path, message=error.message)
    if _is_same(there, planned):
        return failures.folder_has_this_study(path=path, command=there.command("status"))
    what = f"another study, {there.plan.name}"
    if there.source.text == planned.source.text:
        what = "a study of the same file with another plan: its profile or setup was changed since"
    if there.changes != planned.changes:
        what = f"a study with {' '.join(there.changes) or 'nothing changed'}"
    return failures.folder_has_another_study(path=path, what=what, command=there.command("status"))


def _files(planned: PlannedStudy) -> dict[str, bytes]:
    """All files of a folder, the plan with the hashes of the others."""
    texts = _texts(planned)
    document = {
        "schema": SCHEMA,
        "edmctl": __version__,
        "sha256": {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()},
        "recipes": {str(point): list(one) for point, one in planned.recipes.items()},
        "plan": planned.plan.as_mapping(),
    }
    if planned.changes:
        document["changes"] = list(planned.changes)
    body = json.dumps(document, ensure_ascii=False, allow_nan=False)
    digest = hashlib.sha256(body.encode()).hexdigest()
    written = json.dumps({"sha256": digest, "study": document}, ensure_ascii=False, indent=1, allow_nan=False)
    return {**{name: text.encode() for name, text in texts.items()}, PLAN: f"{written}\n".encode()}


def _texts(planned: PlannedStudy) -> dict[str, str]:
    """The files that a study stands on, each complete by itself."""
    assert planned.base.profile is not None
    chain = read_chain(find_profile(planned.base.profile))
    texts = {STUDY: planned.source.text, PROFILE: chain.sources[0].text}
    if len(chain.sources) > 1:
        texts[PROFILE] = _toml(chain.table)
    if planned.base.setup is not None:
        source = read_source(planned.base.setup)
        table = parse(source)
        actuator = table.get("actuator")
        texts[SETUP] = source.text
        if isinstance(actuator, dict) and isinstance(actuator.get("calibration"), str):
            texts[CALIBRATION] = read_source(
                user_path(actuator["calibration"], planned.base.setup.parent)
            ).text
            actuator["calibration"] = CALIBRATION
            texts[SETUP] = _toml(table)
    return texts


def _toml(table: dict[str, object]) -> str:
    import tomli_w

    return tomli_w.dumps(table)


def open_folder(path: Path) -> StudyFolder:
    """Open the folder of a study.

    Raises UsageError E2101 if it is none, PreconditionError E8202 if a file of it was changed since the study began,
    or if its plan is not one of this version.
    """
    try:
        content = read_bytes(path / PLAN, PLAN_BYTES)
    except OSError as refused:
        raise failures.folder_without_study(path=path, plan=PLAN, reason=refused.strerror) from refused
    try:
        document = json_of(content)
        study = document["study"]
        body = json.dumps(study, ensure_ascii=False, allow_nan=False).encode()
        is_whole = hashlib.sha256(body).hexdigest() == document["sha256"]
    except (ValueError, KeyError, TypeError):
        is_whole = False
    if not is_whole:
        raise _changed(path, PLAN)
    try:
        return _folder_of(path, body)
    except (ValueError, ProfileError, UsageError) as refused:
        made_by = study.get("edmctl") if isinstance(study, dict) else None
        raise failures.plan_of_another_version(path=path / PLAN, made_by=made_by) from refused


def _folder_of(path: Path, body: bytes) -> StudyFolder:
    """Return the study of a plan document (JSON). Raises ValueError, ProfileError or UsageError."""
    from pydantic import TypeAdapter

    study = TypeAdapter(PlanDocument).validate_json(body, strict=True)
    names = study.sha256.keys()
    need(study.schema == SCHEMA and {STUDY, PROFILE} <= names <= {STUDY, PROFILE, SETUP, CALIBRATION})
    texts = {}
    for name, digest in study.sha256.items():
        try:
            texts[name] = read_bytes(path / name)
        except OSError:
            raise _changed(path, name) from None
        if hashlib.sha256(texts[name]).hexdigest() != digest:
            raise _changed(path, name)
    source = study_of(texts[STUDY].decode(), path / STUDY)
    check_plan(study.plan, source)
    need(study.recipes.keys() == {run.point for run in study.plan.runs})
    return StudyFolder(path, source, study.plan, study.recipes, study.edmctl, study.changes, SETUP in names)


def _changed(path: Path, name: str) -> PreconditionError:
    return failures.study_file_changed(path=path / name)


def version_warning(folder: StudyFolder) -> list[Diagnostic]:
    """Return a warning where another version began the study."""
    if folder.version == __version__:
        return []
    return [failures.study_of_another_version(version=folder.version, version__=__version__)]
