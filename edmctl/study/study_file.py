"""A study file: factors, design, responses, and how its runs are made; read with positions, as profiles are."""

import shlex
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from edmctl import failures
from edmctl.dataclasses import dataclass
from edmctl.errors import Diagnostic, ProfileError
from edmctl.failures import Code
from edmctl.profile.diagnose import schema_diagnostics, schema_problems
from edmctl.profile.read import Source, Sources, parse, read_source
from edmctl.profile.tables import ONE_LINE, FileName, Table

NAME = r"^[A-Za-z_][A-Za-z0-9_.-]*$"
"""Names of responses: they head columns."""
DesignKind = Literal["full", "fractional", "taguchi", "bbd", "ccd", "lhs", "sobol", "csv"]
AnalysisModel = Literal["auto", "levels", "main", "interactions", "quadratic"]
Value = bool | int | float | str


class StudyTable(Table):
    """What is studied."""

    name: str = Field(
        min_length=1, max_length=100, pattern=ONE_LINE, description="heads every table and page"
    )
    description: str = Field("", pattern=ONE_LINE, description="what the study asks, in a sentence")
    profile: FileName = Field(description="name of a shipped profile, or a file beside this one")
    setup: FileName | None = Field(None, description="setup of the machine, a file beside this one")
    set: list[str] = Field([], description="KEY=VALUE that hold for every run")
    run_files: bool = Field(False, description="keep the run file of every run on virtual machines too")


class Factor(Table):
    """One key of the profile that is varied: by levels, between two bounds, or over categories."""

    key: str = Field(min_length=1, pattern=ONE_LINE, description="a key of the profile")
    name: str = Field("", pattern=ONE_LINE, max_length=40, description="how tables call it")
    levels: list[bool | int | float | str] = Field([], max_length=100, description="values, at least two")
    low: int | float | None = Field(None, description="least value")
    high: int | float | None = Field(None, description="largest value")
    scale: Literal["linear", "log"] = Field("linear", description="how values lie between the bounds")
    step: float | None = Field(None, gt=0.0, description="values are multiples of it")
    categories: list[bool | int | float | str] = Field([], max_length=100, description="values without order")


class Design(Table):
    """Which runs are made."""

    kind: DesignKind = Field(description="how points are chosen")
    array: str | None = Field(None, description="orthogonal array, e.g. L9 or L18 (2^1 3^7)")
    resolution: int | None = Field(None, ge=3, le=9, description="of a fractional factorial")
    generators: list[str] = Field([], description="of a fractional factorial, e.g. D = ABC")
    alpha: float | Literal["face", "rotatable"] = Field("face", description="axial points of a ccd")
    runs: int | None = Field(None, ge=2, le=10_000, description="points of lhs and sobol")
    file: FileName | None = Field(None, description="table with a column a factor key, beside this file")
    replicates: int = Field(1, ge=1, le=1000, description="times that every point is run")
    center_points: int = Field(0, ge=0, le=1000, description="runs in the middle of all factors, a replicate")
    blocks: int = Field(
        1, ge=1, le=64, description="parts of each replicate, each on a machine (seed) of its own"
    )
    seeds: Literal["replicate", "run"] = Field(
        "replicate",
        description="one machine for each replicate and block, which saves runs, or one for each run",
    )
    seed: int = Field(1, ge=0, le=2**62, description="of the order, of samples, and of the first machine")
    order: Literal["random", "standard"] = Field("random", description="of the runs in each block")


class Response(Table):
    """One column of the table: measured by the job, or told later."""

    name: str = Field(pattern=NAME, max_length=60, description="letters, digits and _ . -")
    source: Literal["job", "manual"] = Field("job", description="result of the job, or told by hand")
    unit: str = Field("", pattern=ONE_LINE, max_length=20, description="of a manual response")
    better: Literal["larger", "smaller", "nominal"] = Field("smaller", description="what is wanted of it")
    target: float | None = Field(None, description="value that is wanted, of a nominal response")
    low: float | None = Field(None, description="least value that can be told, of a manual response")
    high: float | None = Field(None, description="largest value that can be told, of a manual response")
    log: bool = Field(False, description="model its logarithm")


class Constraint(Table):
    """A bound of a response that a recipe has to keep."""

    response: str = Field(description="name of a response")
    at_most: float | None = Field(None, description="upper bound, in the unit of the response")
    at_least: float | None = Field(None, description="lower bound")


class Objective(Table):
    """A response that is wanted good, and how much it counts beside the others."""

    response: str = Field(description="name of a response")
    weight: float = Field(1.0, gt=0.0, le=1e6, description="beside the other objectives")


class Analysis(Table):
    """What is fitted to the responses."""

    model: AnalysisModel = Field(
        "auto",
        description="levels: a mean a level; main: straight lines; interactions: products of pairs too; "
        "quadratic: squares too; auto: by the design",
    )


class Optimize(Table):
    """Runs after the design, each where the models expect most."""

    runs: int = Field(24, ge=4, le=1000, description="runs in all, those of the design among them")
    batch: int = Field(1, ge=1, le=64, description="suggestions at a time, made side by side")


class StudyMachine(Table):
    """How the runs are made on a machine that lasts: one hole a run, on a grid of places."""

    holes_per_tool: int | None = Field(None, ge=1, le=10_000, description="runs with one tool: a block")
    center_runs: bool = Field(
        True, description="a run in the middle of all factors opens and closes each block"
    )
    approval: Literal["none", "suggestions", "each"] = Field(
        "suggestions", description="which runs somebody has to approve before sparks"
    )
    first_x_um: float = Field(600.0, ge=-1e6, le=1e6, description="place of the first hole, µm")
    first_y_um: float = Field(0.0, ge=-1e6, le=1e6, description="place of the first hole, µm")
    pitch_x_um: float = Field(500.0, ge=-1e5, le=1e5, description="to the next hole of a row, µm")
    pitch_y_um: float = Field(500.0, ge=-1e5, le=1e5, description="to the next row, µm")
    columns: int = Field(10, ge=1, le=1000, description="holes in a row")
    rows: int = Field(10, ge=1, le=1000, description="rows of holes")


class StudyFile(Table):
    """A study file as written."""

    study: StudyTable
    factors: list[Factor] = Field(min_length=1, max_length=24)
    design: Design
    responses: list[Response] = Field(min_length=1, max_length=60)
    constraints: list[Constraint] = Field([], max_length=60)
    objectives: list[Objective] = Field([], max_length=20)
    analysis: Analysis = Analysis()
    optimize: Optimize = Optimize()
    machine: StudyMachine | None = None


@dataclass(frozen=True, slots=True)
class StudySource:
    """A study file with the positions of its values."""

    file: StudyFile
    path: Path
    sources: Sources

    @property
    def text(self) -> str:
        """The file verbatim."""
        return self.sources.file.text

    @property
    def steps(self) -> dict[str, float | None]:
        """The step of each factor, by its key."""
        return {factor.key: factor.step for factor in self.file.factors}

    def wrong(self, message: str, hint: str, *path: str | int) -> ProfileError:
        """Return the error of the value at `path`."""
        return ProfileError((Diagnostic(Code.STUDY, message, hint, self.sources.value(path)),))

    def require(self, condition: object, message: str, hint: str, *path: str | int) -> None:
        """Raise ProfileError for the value at `path` unless `condition` holds."""
        if not condition:
            raise self.wrong(message, hint, *path)


def read_study(path: Path) -> StudySource:
    """Read a study file. Raises ProfileError for unknown keys and wrong values, UsageError E2100 without a file."""
    if path.is_dir() and (path / "plan.json").is_file():
        raise failures.folder_instead_of_study_file(path=path, quoted_path=shlex.quote(str(path)))
    source = read_source(path)
    sources, table = Sources((source,), source), parse(source)
    if "study" not in table and {"servo", "target", "extends"} & set(table):
        message = f"{path} is a profile, not a study"
        hint = "a study names the profile it varies: profile = in [study]; docs/study.md has an example"
        raise ProfileError((Diagnostic(Code.UNKNOWN_KEY, message, hint, source.start()),))
    try:
        return StudySource(StudyFile.model_validate(table), path, sources)
    except ValidationError as error:
        problems = schema_problems(error, StudyFile, table)
        raise ProfileError(tuple(schema_diagnostics(problems, StudyFile, table, sources))) from None


def study_of(text: str, path: Path) -> StudySource:
    """Return the study of a text that was planned before."""
    source = Source(str(path), text)
    return StudySource(StudyFile.model_validate(parse(source)), path, Sources((source,), source))
