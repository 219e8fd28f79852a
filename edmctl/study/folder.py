"""The folder of a study: file, profile, setup and plan as they were at the start, and the rows of its runs.

DIR/study.toml profile.toml setup.toml plan.json    written once; plan.json has the hashes of the others
DIR/rows/*.jsonl                                    appended, one file a writer
DIR/runs/*.h5                                       run files, with ledger and journals on a persistent machine
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import Diagnostic, ProfileError, RunFileError, UsageError
from edmctl.files import json_of, open_descriptor, read_bytes, user_path
from edmctl.jobs.output_files import make_folder, unwritable, write
from edmctl.jobs.plan import SIMULATOR, JobRequest, MachineAddress
from edmctl.profile.folders import find_profile
from edmctl.profile.read import parse, read_chain, read_source
from edmctl.record.disk import exclusive_lock, retried
from edmctl.record.json_rows import RowWriter, read_lines
from edmctl.study.design import factors_of, is_within
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
MOMENT_S = 0.5
ADDING_S = 30.0
"""Runs are added one after the other: reading all rows takes a moment."""
STUDY, PROFILE, SETUP, CALIBRATION = "study.toml", "profile.toml", "setup.toml", "calibration.toml"
PLAN, ROWS, RUNS = "plan.json", "rows", "runs"


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
    """Why the study stopped before a run on a persistent machine."""

    number: int
    why: str


@dataclass(frozen=True, slots=True)
class OnMachine:
    """The port of the persistent machine on which the runs are made; a virtual bench by its absolute path."""

    port: str


_KINDS = {
    "run": RunRow,
    "told": Told,
    "judged": Judged,
    "planned": Added,
    "paused": Paused,
    "machine": OnMachine,
}
"""The records of rows, by the kind that a row names."""


class StudyWriter(RowWriter):
    """Appends the rows of a study."""

    def _add(self, record: RunRow | Told | Judged | Added | Paused | OnMachine) -> None:
        self.append(next(kind for kind, schema in _KINDS.items() if type(record) is schema), asdict(record))

    def run(self, row: RunRow) -> None:
        """Append the outcome of a run."""
        self._add(row)

    def told(self, run: StudyRun, values: Mapping[str, float | None]) -> None:
        """Append reported values of a run, of its first attempt if it is not made yet; None withdraws."""
        self._add(Told(run.planned.number, values, run.attempts or 1))

    def judged(self, run: StudyRun, judgement: Judgement, reason: str) -> None:
        """Append a judgement of a run's last attempt."""
        self._add(Judged(run.planned.number, run.attempts, judgement, reason))

    def paused(self, run: StudyRun, why: str) -> None:
        """Append why the study stops before a run."""
        self._add(Paused(run.planned.number, why))

    def on_machine(self, port: str) -> None:
        """Append the port of the machine on which the runs are made."""
        self._add(OnMachine(absolute_port(port)))

    def planned(self, runs: Sequence[PlannedRun], expected: Mapping[str, Interval] | None = None) -> None:
        """Append runs that are not in the plan: all of them in one line, or none.

        `expected` is stored with confirmations: later runs do not change it.
        """
        if expected is not None:
            expected = {name: values for name, values in expected.items() if all(map(math.isfinite, values))}
        self._add(Added(tuple(runs), expected))


@dataclass(frozen=True, slots=True)
class Rows:
    """All rows of a study: attempts by run, reported values and judgements, added runs, and damaged lines (`torn`).

    reports : by run, in the order of time
    expected : of confirmations, by run
    port : of the persistent machine on which the runs are made, if any
    """

    attempts: Mapping[int, Sequence[RunRow]]
    reports: Mapping[int, Sequence[Told | Judged]]
    added: tuple[PlannedRun, ...]
    expected: Mapping[int, Mapping[str, Interval]]
    paused: Paused | None = None
    port: str = ""
    torn: int = 0

    def of(self, planned: PlannedRun) -> StudyRun:
        """Return a run with all that is known of its last attempt."""
        attempts = self.attempts.get(planned.number, ())
        last = attempts[-1] if attempts else None
        attempt = last.attempt if last else 0
        values: dict[str, float | None] = {}
        judgement, reason = None, ""
        for report in self.reports.get(planned.number, ()):
            if isinstance(report, Told) and report.attempt == max(1, attempt):
                values.update(report.values)
            elif isinstance(report, Judged) and report.attempt == attempt:
                judgement, reason = report.judgement, report.reason
        known = {name: value for name, value in values.items() if value is not None}
        return StudyRun(planned, last, known, judgement, reason, attempt)


@cache
def _schemas() -> dict[str, TypeAdapter[Any]]:
    from pydantic import TypeAdapter

    return {kind: TypeAdapter(schema) for kind, schema in _KINDS.items()}


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
            need(are_possible(values))
            row = schema.validate_json(json.dumps(values), strict=True)
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
            port = row.port
    by_number = {number: [rows[n] for n in sorted(rows)] for number, rows in attempts.items()}
    in_order = tuple(added[number] for number in sorted(added))
    return Rows(by_number, reports, in_order, expected, paused, port, torn)


def are_possible(value: object) -> bool:
    """Return whether all numbers in a JSON value are in the range that a study can have."""
    if isinstance(value, dict | list):
        return all(map(are_possible, value.values() if isinstance(value, dict) else value))
    return not isinstance(value, int | float) or abs(value) <= (
        LARGEST if isinstance(value, float) else 2**63
    )


def need(is_right: bool) -> None:
    """Raise ValueError if something in the folder of a study is not as this version writes it."""
    if not is_right:
        raise ValueError("not of this version")


def is_run_of(run: PlannedRun, factors: Sequence[FactorInfo]) -> bool:
    """Return whether a run has a permitted value of each factor, and counts and a seed of 0 or more."""
    return (
        min(run.number, run.point, run.replicate, run.block, run.seed, run.tool) >= 0
        and run.settings.keys() == {factor.key for factor in factors}
        and all(is_within(factor, run.settings[factor.key]) for factor in factors)
    )


def bench_of(port: str) -> Path | None:
    """Return the absolute path of the file of a virtual bench; None for other machines."""
    file = MachineAddress(port).bench_file
    return None if file is None else file.resolve()


def absolute_port(port: str) -> str:
    """Return a port that means the same machine from every folder."""
    bench = bench_of(port)
    return port if bench is None else f"{SIMULATOR}{bench}"


@dataclass(frozen=True, slots=True)
class StudyFolder:
    """A study on disk: its fields never change, `read` returns its progress."""

    path: Path
    source: StudySource
    plan: StudyPlan
    recipes: Mapping[int, tuple[str, str]]
    version: str
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
        folder = self.path.resolve()  # for workers with another working folder
        setup = folder / SETUP if self.has_setup else None
        return replace(base_request(self.source), profile=str(folder / PROFILE), setup=setup)

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

    def add(
        self, runs_of: Callable[[StudyState], list[PlannedRun]], wait_s: float = MOMENT_S
    ) -> list[PlannedRun]:
        """Add runs that follow from the rows, and return them; commands that add runs do so one after the other."""
        with self.claimed("suggestions", wait_s), self.writer() as writer:
            runs = runs_of(self.read())
            if runs:
                writer.planned(runs)
        return runs

    @contextmanager
    def claimed(self, part: str = "all", wait_s: float = MOMENT_S) -> Iterator[None]:
        """Hold a lock of the study: `all` to make runs, `suggestions` to add them.

        Raises PreconditionError E8201 if another command holds it for longer than `wait_s`.
        """
        self.rows.mkdir(parents=True, exist_ok=True)
        path = self.rows / f"{part}.lock"
        with ExitStack() as held:
            try:
                descriptor = open_descriptor(path, os.O_CREAT | os.O_RDWR)
                held.callback(os.close, descriptor)
                retried(lambda: held.enter_context(exclusive_lock(descriptor)), wait_s)
            except BlockingIOError:
                command = self.command("status")
                raise failures.study_is_running(path=self.path, command=command) from None
            except OSError as refused:
                raise failures.study_folder_not_locked(path=path, reason=refused.strerror) from refused
            yield


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

    def making_command(self, name: str = "resume") -> str:
        """Return a command that makes runs, at the port of the machine on which they are made."""
        port = ["--port", self.rows.port] if self.rows.port else []
        return self.folder.command(name, *port)

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
        raise _taken(path)
    make_folder(path.parent)
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    make_folder(draft)
    try:
        for name, content in _files(planned).items():
            write(draft / name, content)
        draft.replace(path)  # onto nothing, or onto an empty folder
    except OSError as refused:
        if (path / PLAN).exists():
            raise _taken(path) from None
        raise unwritable(f"into {path}", str(refused.strerror), "Check the path.") from refused
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return open_folder(path)


def _taken(path: Path) -> RunFileError:
    if (path / PLAN).exists():
        return failures.folder_has_a_study(path=path, quoted_path=shlex.quote(str(path)))
    return failures.study_folder_not_empty(path=path)


def _files(planned: PlannedStudy) -> dict[str, bytes]:
    """All files of a folder, the plan with the hashes of the others."""
    contents = {name: text.encode() for name, text in _texts(planned).items()}
    document = {
        "schema": SCHEMA,
        "edmctl": __version__,
        "sha256": {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()},
        "recipes": {str(point): list(hashes) for point, hashes in planned.recipes.items()},
        "plan": asdict(planned.plan),
    }
    digest = hashlib.sha256(_body(document)).hexdigest()
    written = json.dumps({"sha256": digest, "study": document}, ensure_ascii=False, indent=1, allow_nan=False)
    return {**contents, PLAN: f"{written}\n".encode()}


def _body(document: object) -> bytes:
    """Return the bytes of a plan document that its hash is of."""
    return json.dumps(document, ensure_ascii=False, allow_nan=False).encode()


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

    Raises UsageError E2101 if it is none, PreconditionError E8202 if one of its files was changed, or if its plan is
    of another version.
    """
    from pydantic import TypeAdapter

    try:
        content = read_bytes(path / PLAN, PLAN_BYTES)
    except OSError as refused:
        raise failures.folder_without_study(path=path, plan=PLAN, reason=refused.strerror) from refused
    try:
        document = json_of(content)
        study = document["study"]
        body = _body(study)
        is_whole = hashlib.sha256(body).hexdigest() == document["sha256"]
    except (ValueError, KeyError, TypeError):
        is_whole = False
    if not is_whole:
        raise failures.study_file_changed(path=path / PLAN)
    try:
        need(are_possible(study))
        return _folder_of(path, TypeAdapter(PlanDocument).validate_json(body, strict=True))
    except (ValueError, ProfileError, UsageError) as refused:
        made_by = study.get("edmctl") if isinstance(study, dict) else None
        raise failures.plan_of_another_version(path=path / PLAN, made_by=made_by) from refused


def _folder_of(path: Path, study: PlanDocument) -> StudyFolder:
    """Check the contents of `plan.json` and the other files. Raises ValueError, ProfileError or UsageError."""
    names = study.sha256.keys()
    need(study.schema == SCHEMA and {STUDY, PROFILE} <= names <= {STUDY, PROFILE, SETUP, CALIBRATION})
    texts: dict[str, bytes] = {}
    for name, digest in study.sha256.items():
        with suppress(OSError):
            texts[name] = read_bytes(path / name)
        if hashlib.sha256(texts.get(name, b"")).hexdigest() != digest:
            raise failures.study_file_changed(path=path / name)
    plan, source = study.plan, study_of(texts[STUDY].decode(), path / STUDY)
    factors = factors_of(source)
    points = {run.point for run in plan.runs}
    need(replace(plan, **stated_in(source, factors)) == plan)
    need(plan.model in (*LADDERS[0], *LADDERS[1]))
    need(plan.points == len(points) > 0 and study.recipes.keys() == points)
    for number, run in enumerate(plan.runs, 1):
        need(run.number == number and is_run_of(run, factors) and run.replicate <= plan.replicates)
        need(run.kind in (RunKind.DESIGN, RunKind.CENTER))
    return StudyFolder(path, source, plan, study.recipes, study.edmctl, SETUP in names)


def version_warning(folder: StudyFolder) -> list[Diagnostic]:
    """Return a warning if another version began the study."""
    is_same = folder.version == __version__
    warning = failures.study_of_another_version(version=folder.version, own_version=__version__)
    return [] if is_same else [warning]
