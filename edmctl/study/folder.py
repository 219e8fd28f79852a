"""The folder of a study: file, profile, setup and plan as they were when it began, and the rows of its runs.

DIR/study.toml profile.toml setup.toml plan.json    written once; plan.json has the hashes of the others
DIR/rows/*.jsonl                                    appended, one file a writer
DIR/runs/*.h5                                       run files, with ledger and journals on a machine that lasts
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
import shlex
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import Diagnostic, EdmError, PreconditionError, ProfileError, RunFileError, UsageError
from edmctl.files import json_of, open_descriptor, read_bytes, user_path
from edmctl.jobs.output_files import make_folder, unwritable, write
from edmctl.jobs.plan import SIMULATOR, JobRequest, MachineAddress
from edmctl.profile.folders import find_profile
from edmctl.profile.read import parse, read_chain, read_source
from edmctl.record.json_rows import RowWriter, read_lines
from edmctl.record.locks import exclusive
from edmctl.study.design import SENSITIVITY, factors_of, is_within
from edmctl.study.planning import LADDERS, PlannedStudy, base_request, stated_in
from edmctl.study.responses import LARGEST
from edmctl.study.results import (
    FactorInfo,
    Interval,
    Judgement,
    PlanDocument,
    PlannedRun,
    RunKind,
    RunRow,
    StudyPlan,
    StudyRun,
)
from edmctl.study.study_file import StudySource, study_of
from edmctl.version import __version__

if TYPE_CHECKING:
    from pydantic import TypeAdapter

SCHEMA = "edmctl-study/2"
PLAN_BYTES = 40_000_000
"""A plan of 20,000 runs with 24 factors."""
MOMENT_S, LOOKS_EVERY_S = 0.5, 0.02
ADDING_S = 30.0
"""Runs are added one after the other: reading all rows takes a moment."""
STUDY, PROFILE, SETUP, CALIBRATION = "study.toml", "profile.toml", "setup.toml", "calibration.toml"
PLAN, ROWS, RUNS = "plan.json", "rows", "runs"
RUN, TOLD, JUDGED, PLANNED, PAUSED, MACHINE = "run", "told", "judged", "planned", "paused", "machine"


@dataclass(frozen=True, slots=True)
class Told:
    """Values that were reported of an attempt; None withdraws one."""

    number: int
    values: Mapping[str, float | None]
    attempt: int = 1


@dataclass(frozen=True, slots=True)
class Judged:
    """A judgement of an attempt."""

    number: int
    attempt: int
    judgement: Judgement
    reason: str


@dataclass(frozen=True, slots=True)
class Added:
    """Runs that are not in the plan; `expected` is what confirmation runs are to confirm."""

    runs: tuple[PlannedRun, ...]
    expected: Mapping[str, Interval] | None = None


@dataclass(frozen=True, slots=True)
class Paused:
    """Why the study stopped before a run on a machine that lasts."""

    number: int
    why: str
    worn_tool: int | None = None


@dataclass(frozen=True, slots=True)
class OnMachine:
    """The machine that lasts on which the runs are made, with the whole path of a virtual bench."""

    port: str
    bench: str = ""

    @property
    def port_from_here(self) -> str:
        """The port; the bench by its whole path where its name leads to another one from here."""
        is_same = not self.bench or bench_of(self.port) == self.bench
        return self.port if is_same else f"{SIMULATOR}{self.bench}"


class StudyWriter(RowWriter):
    """Appends the rows of a study."""

    def run(self, row: RunRow) -> None:
        """Append the outcome of a run."""
        self.append(RUN, asdict(row))

    def told(self, run: StudyRun, values: Mapping[str, float | None]) -> None:
        """Append reported values of a run, of its first attempt where it is not made yet; None withdraws."""
        attempt = run.row.attempt if run.row is not None else 1
        self.append(TOLD, asdict(Told(run.planned.number, values, attempt)))

    def judged(self, run: StudyRun, judgement: Judgement, reason: str) -> None:
        """Append a judgement of a run's last attempt."""
        self.append(JUDGED, asdict(Judged(run.planned.number, run.attempts, judgement, reason)))

    def paused(self, run: StudyRun, why: str, worn_tool: int | None = None) -> None:
        """Append why the study stops before a run."""
        self.append(PAUSED, asdict(Paused(run.planned.number, why, worn_tool)))

    def on_machine(self, port: str) -> None:
        """Append the port of the machine on which the runs are made."""
        self.append(MACHINE, asdict(OnMachine(port, bench_of(port))))

    def planned(self, runs: Sequence[PlannedRun], expected: Mapping[str, Interval] | None = None) -> None:
        """Append runs that are not in the plan, suggestions or confirmations: all of them in one line, or none.

        `expected` is stored with confirmations: later runs do not change it.
        """
        row: dict[str, object] = {"runs": [asdict(run) for run in runs]}
        if expected is not None:
            row["expected"] = {name: one for name, one in expected.items() if all(map(math.isfinite, one))}
        self.append(PLANNED, row)


@dataclass(frozen=True, slots=True)
class Rows:
    """All rows of a study: attempts by run, later knowledge, added runs and damaged lines (`torn`).

    reports : what was told and judged, by run, in the order of time
    expected : of confirmations, by run
    port : of the machine that lasts on which the runs are made, if they are made on one
    """

    attempts: Mapping[int, tuple[RunRow, ...]]
    reports: Mapping[int, Sequence[Told | Judged]]
    added: tuple[PlannedRun, ...]
    expected: Mapping[int, Mapping[str, Interval]]
    paused: Paused | None = None
    port: str = ""
    torn: int = 0

    def of(self, planned: PlannedRun) -> StudyRun:
        """Return a run with all that is known of it."""
        last = next(iter(self.attempts.get(planned.number, ())[::-1]), None)
        attempt = last.attempt if last else 0
        told: dict[str, float | None] = {}
        judgement, reason = None, ""
        for one in self.reports.get(planned.number, ()):
            if isinstance(one, Judged):
                if one.attempt == attempt:
                    judgement, reason = one.judgement, one.reason
            elif one.attempt == max(1, attempt):
                told.update(one.values)
        known = {name: value for name, value in told.items() if value is not None}
        return StudyRun(planned, last, known, judgement, reason, attempt)


@cache
def _schemas() -> dict[str, TypeAdapter[Any]]:
    from pydantic import TypeAdapter

    kinds = {RUN: RunRow, TOLD: Told, JUDGED: Judged, PLANNED: Added, PAUSED: Paused, MACHINE: OnMachine}
    return {kind: TypeAdapter(schema) for kind, schema in kinds.items()}


def read_rows(folder: Path) -> Rows:
    """Read the rows of a study. Raises RunFileError E9111 if a file cannot be read."""
    lines, torn = read_lines(folder)
    attempts: dict[int, dict[int, RunRow]] = {}
    reports: dict[int, list[Told | Judged]] = {}
    added: dict[int, PlannedRun] = {}
    expected: dict[int, Mapping[str, Interval]] = {}
    paused, port = None, ""
    for values in lines:
        schema = _schemas().get(values.pop("row"))
        if schema is None:
            continue  # of another version
        try:
            row = schema.validate_json(json.dumps(values), strict=True)
            need(all(abs(number) <= LARGEST for number in _numbers(row)))
        except (ValueError, OverflowError):
            torn += 1
            continue
        if isinstance(row, RunRow):
            attempts.setdefault(row.number, {}).setdefault(row.attempt, row)
        elif isinstance(row, Told | Judged):
            reports.setdefault(row.number, []).append(row)
        elif isinstance(row, Added):
            for run in row.runs:
                if added.setdefault(run.number, run) is run and row.expected is not None:
                    expected[run.number] = row.expected
        elif isinstance(row, Paused):
            paused = row
        else:
            port = row.port_from_here
    by_number = {number: tuple(found[n] for n in sorted(found)) for number, found in attempts.items()}
    in_order = tuple(added[number] for number in sorted(added))
    return Rows(by_number, reports, in_order, expected, paused, port, torn)


def _numbers(row: object) -> Iterator[float]:
    """The measured numbers of a row, which have a largest value. Raises ValueError for a count that cannot be."""
    if isinstance(row, RunRow):
        counts = (row.number, row.point, row.replicate, row.block, row.tool, row.attempt, row.order)
        need(_are_counts(*counts, row.seed or 0))
        yield from (row.duration_s, *(row.site_um or ()))
    named = (row.responses, row.u, row.u95, row.truth) if isinstance(row, RunRow) else ()
    for values in (row.values,) if isinstance(row, Told) else named:
        yield from (value for value in values.values() if value is not None)
    if isinstance(row, Added):
        for interval in (row.expected or {}).values():
            yield from interval


def need(is_right: bool) -> None:
    """Raise ValueError if something in the folder of a study is not as this version writes it."""
    if not is_right:
        raise ValueError("not of this version")


def _are_counts(*values: int) -> bool:
    return all(0 <= value < 2**63 for value in values)


def is_run_of(run: PlannedRun, factors: Sequence[FactorInfo]) -> bool:
    """Return whether a run has a value of each factor, and numbers that can be."""
    return (
        _are_counts(run.number, run.point, run.replicate, run.block, run.seed, run.tool)
        and run.settings.keys() == {factor.key for factor in factors}
        and all(is_within(factor, run.settings[factor.key]) for factor in factors)
    )


def bench_of(port: str) -> str:
    """Return the whole path of the file of a virtual bench; empty for every other machine."""
    file = MachineAddress(port).bench_file
    return "" if file is None else str(file.resolve())


@dataclass(frozen=True, slots=True)
class StudyFolder:
    """A study that is run, or was: its fields never change, `read` returns its progress.

    changes : hold for every run beside what the file says
    """

    path: Path
    source: StudySource
    plan: StudyPlan
    recipes: Mapping[int, tuple[str, str]]
    version: str
    changes: tuple[str, ...] = ()
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
        """Return the state of the study by its rows."""
        rows = read_rows(self.rows)
        planned, factors = len(self.plan.runs), self.plan.factors
        added = [run for run in rows.added if run.number > planned and is_run_of(run, factors)]
        return StudyState(self, rows, tuple(map(rows.of, (*self.plan.runs, *added))))

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

    @property
    def plan(self) -> StudyPlan:
        """The plan of the study."""
        return self.folder.plan

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


def _taken(path: Path, planned: PlannedStudy) -> RunFileError:
    """Return the error of a folder that contains something: this study, another one, or no study at all."""
    if not (path / PLAN).exists():
        return failures.study_folder_not_empty(path=path)
    try:
        there = open_folder(path)
    except EdmError as error:
        return failures.folder_has_unreadable_study(path=path, message=error.message)
    has_same_file = there.source.text == planned.source.text
    if has_same_file and (there.plan, there.changes) == (planned.plan, planned.changes):
        return failures.folder_has_this_study(path=path, command=there.command("status"))
    what = f"another study, {there.plan.name}"
    if has_same_file:
        what = "a study of the same file with another plan: its profile or setup was changed since"
    if there.changes != planned.changes:
        what = f"a study with {' '.join(there.changes) or 'nothing changed'}"
    return failures.folder_has_another_study(path=path, what=what, command=there.command("status"))


def _files(planned: PlannedStudy) -> dict[str, bytes]:
    """All files of a folder, the plan with the hashes of the others."""
    contents = {name: text.encode() for name, text in _texts(planned).items()}
    document = {
        "schema": SCHEMA,
        "edmctl": __version__,
        "sha256": {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()},
        "recipes": {str(point): list(one) for point, one in planned.recipes.items()},
        "plan": asdict(planned.plan),
    }
    if planned.changes:
        document["changes"] = list(planned.changes)
    body = json.dumps(document, ensure_ascii=False, allow_nan=False)
    digest = hashlib.sha256(body.encode()).hexdigest()
    written = json.dumps({"sha256": digest, "study": document}, ensure_ascii=False, indent=1, allow_nan=False)
    return {**contents, PLAN: f"{written}\n".encode()}


def _texts(planned: PlannedStudy) -> dict[str, str]:
    """The files that a study is based on, each complete by itself."""
    import tomli_w

    assert planned.base.profile is not None
    chain = read_chain(find_profile(planned.base.profile))
    texts = {STUDY: planned.source.text, PROFILE: chain.sources[0].text}
    if len(chain.sources) > 1:
        texts[PROFILE] = tomli_w.dumps(chain.table)
    if planned.base.setup is not None:
        source = read_source(planned.base.setup)
        table = parse(source)
        actuator = table.get("actuator")
        texts[SETUP] = source.text
        if isinstance(actuator, dict) and isinstance(actuator.get("calibration"), str):
            calibration = user_path(actuator["calibration"], planned.base.setup.parent)
            texts[CALIBRATION] = read_source(calibration).text
            actuator["calibration"] = CALIBRATION
            texts[SETUP] = tomli_w.dumps(table)
    return texts


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
    plan, source = study.plan, study_of(texts[STUDY].decode(), path / STUDY)
    factors, wrong = factors_of(source)
    points = {run.point for run in plan.runs}
    need(not wrong and replace(plan, **stated_in(source, factors)) == plan)
    need(plan.model in (SENSITIVITY, *LADDERS[0], *LADDERS[1]))
    need((plan.model == SENSITIVITY) == (source.file.design.kind == SENSITIVITY))
    need(plan.points == len(points) > 0 and study.recipes.keys() == points)
    for number, run in enumerate(plan.runs, 1):
        need(run.number == number and is_run_of(run, factors) and run.replicate <= plan.replicates)
        need(run.kind in (RunKind.DESIGN, RunKind.CENTER))
    return StudyFolder(path, source, plan, study.recipes, study.edmctl, study.changes, SETUP in names)


def _changed(path: Path, name: str) -> PreconditionError:
    return failures.study_file_changed(path=path / name)


def version_warning(folder: StudyFolder) -> list[Diagnostic]:
    """Return a warning where another version began the study."""
    if folder.version == __version__:
        return []
    return [failures.study_of_another_version(version=folder.version, own_version=__version__)]
