"""The records of a study: what was asked, the runs that are planned, their rows, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum

from edmctl.dataclasses import dataclass, field

Value = bool | int | float | str
Interval = tuple[float, float, float]
"""An expected value, and the bounds of its 95 % interval."""

TRUTH = "truth."
"""Begins the names of what only a virtual machine knows."""


class RunKind(StrEnum):
    """Why a run is made; a centre run, in the middle of all factors, shows curvature, drift and a worn tool."""

    DESIGN = "design"
    CENTER = "center"
    SUGGESTED = "suggested"
    CONFIRMATION = "confirmation"


class RunState(StrEnum):
    """How far a run has come; one that ended with an error has failed, until it is judged."""

    OPEN = "open"
    DONE = "done"
    FAILED = "failed"
    REJECTED = "rejected"


class Judgement(StrEnum):
    """An operator's verdict on a run."""

    ACCEPT = "accept"
    REJECT = "reject"
    REPEAT = "repeat"


@dataclass(frozen=True, slots=True)
class FactorInfo:
    """A factor as it was varied.

    values : levels or categories; the two bounds of a range
    """

    key: str
    name: str
    values: tuple[Value, ...]
    is_number: bool
    is_log: bool = False
    is_range: bool = False


@dataclass(frozen=True, slots=True)
class ResponseInfo:
    """A response as the study asks for it."""

    name: str
    unit: str
    better: str
    is_manual: bool = False
    is_log: bool = False
    target: float | None = None

    @property
    def label(self) -> str:
        return f"{self.name} ({self.unit})" if self.unit else self.name


@dataclass(frozen=True, slots=True)
class ConstraintInfo:
    """A bound of a response: `sign` is 1 for at most, −1 for at least."""

    response: str
    limit: float
    sign: int

    def __str__(self) -> str:
        return f"{self.response} {'≤' if self.sign > 0 else '≥'} {self.limit:g}"

    def excess(self, value: float) -> float:
        """Return by how much a value breaks the constraint; negative for one that keeps it."""
        return self.sign * (value - self.limit)


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One run: runs of one `point` have equal settings; `number` is its place in the order of all runs.

    block : what it shares with others beside its settings, a machine (seed) or a tool
    tool : 0 where every run has a machine of its own
    """

    number: int
    kind: RunKind
    point: int
    replicate: int
    block: int
    seed: int
    settings: Mapping[str, Value]
    tool: int = 0


@dataclass(frozen=True, slots=True)
class PlanCosts:
    """What the runs of a study will take, by the forecasts of each.

    tool_wear_um : of each tool; most_wear_um : what one tool may lose
    places : on the grid of a machine that lasts
    """

    time_s: float
    machining_time_s: float
    tool_wear_um: tuple[float, ...]
    most_wear_um: float
    places: int = 0


@dataclass(frozen=True, slots=True)
class StudyPlan:
    """A study as it will be run. Without `costs` it was not checked.

    kind : the design in words, `Taguchi L9 (3^4)`
    objectives : responses with their weights
    dof : degrees of freedom by term; `error` is what is left
    """

    name: str
    description: str
    kind: str
    factors: tuple[FactorInfo, ...]
    responses: tuple[ResponseInfo, ...]
    constraints: tuple[ConstraintInfo, ...]
    objectives: tuple[tuple[str, float], ...]
    runs: tuple[PlannedRun, ...]
    points: int
    replicates: int
    model: str
    dof: Mapping[str, int]
    aliases: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    costs: PlanCosts | None = None

    def is_of_design(self, run: PlannedRun) -> bool:
        """Return whether a run is one of the design: planned, or of a replicate that was added.

        Suggested and confirmation runs are not, nor the centre runs that open and close their tools.
        """
        is_planned = run.number <= len(self.runs) or run.replicate > self.replicates
        return is_planned and run.kind in (RunKind.DESIGN, RunKind.CENTER)

    def response(self, name: str) -> ResponseInfo | None:
        return next((one for one in self.responses if one.name == name), None)


@dataclass(frozen=True, slots=True)
class PlanDocument:
    """The contents of `plan.json`. The annotations are its schema.

    edmctl : version that planned the study
    sha256 : hash of each other file, by name
    recipes : by point, hashes of the recipe and of the `[sim]` table in effect
    """

    schema: str
    edmctl: str
    sha256: Mapping[str, str]
    recipes: Mapping[int, tuple[str, str]]
    plan: StudyPlan


@dataclass(frozen=True, slots=True)
class RunRow:
    """The outcome of one attempt at a run. A response without a value is None. The annotations are its schema.

    Fields of time and computer come last: in all others the rows of two executions of one study are equal.

    u, u95 : standard uncertainties, and halves of 95 % intervals
    truth : what a virtual machine knows and no estimate has seen
    order : place in the order in which runs were made on a machine that lasts, from 1
    """

    number: int
    kind: str
    point: int
    replicate: int
    block: int
    tool: int
    site_um: tuple[float, float] | None
    seed: int | None
    attempt: int
    settings: Mapping[str, Value]
    exit_code: int = 0
    error: str | None = None
    responses: Mapping[str, float | None] = field(default_factory=dict)
    u: Mapping[str, float | None] = field(default_factory=dict)
    u95: Mapping[str, float | None] = field(default_factory=dict)
    bases: Mapping[str, str] = field(default_factory=dict)
    truth: Mapping[str, float | None] = field(default_factory=dict)
    order: int = 0
    run_files: tuple[str, ...] = ()
    run_sha256: str = ""
    started: str = ""
    duration_s: float = 0.0
    host: str = ""

    @property
    def ok(self) -> bool:
        return self.exit_code == 0


@dataclass(frozen=True, slots=True)
class StudyRun:
    """A planned run with its last attempt and what was reported of that later."""

    planned: PlannedRun
    row: RunRow | None = None
    told: Mapping[str, float] = field(default_factory=dict)
    judgement: Judgement | None = None
    reason: str = ""
    attempts: int = 0

    @property
    def tool(self) -> int:
        """The tool that made it, else the one that is planned for it; 0 where every run has a machine of its own."""
        return self.planned.tool if self.row is None else self.row.tool

    @property
    def block(self) -> int:
        """What it shares with others: the tool that made it where tools are the blocks, else the planned block."""
        is_of_tool = self.planned.tool > 0 and self.planned.tool == self.planned.block
        return self.tool if is_of_tool else self.planned.block

    @property
    def state(self) -> RunState:
        """How far it has come; one that is rejected before it was made is not made."""
        if self.judgement is Judgement.REJECT:
            return RunState.REJECTED
        if self.row is None or self.judgement is Judgement.REPEAT:
            return RunState.OPEN
        return RunState.DONE if self.row.ok or self.judgement is Judgement.ACCEPT else RunState.FAILED

    def value(self, response: str) -> float | None:
        """Return a response of a run that is done, None where there is none; `truth.NAME` is of virtual machines."""
        return self.recorded(response) if self.state is RunState.DONE else None

    def recorded(self, response: str) -> float | None:
        """Return a response of a run in any state."""
        if response in self.told:
            return self.told[response]
        if self.row is None:
            return None
        if response.startswith(TRUTH):
            return self.row.truth.get(response.removeprefix(TRUTH))
        return self.row.responses.get(response)

    def u95(self, response: str) -> float | None:
        """Return half of the 95 % interval that the run itself gives; None for what was measured by hand."""
        is_measured = self.row is not None and response not in self.told
        return self.row.u95.get(response) if is_measured and self.row is not None else None


@dataclass(frozen=True, slots=True)
class Choice:
    """One point beside the others: means of its objectives, whether it keeps the constraints, rankings.

    upper : by constraint, the bound of the 95 % interval on the side of the limit
    """

    point: int
    settings: Mapping[str, Value]
    runs: int
    means: Mapping[str, float | None]
    upper: Mapping[str, float | None]
    is_feasible: bool
    is_pareto: bool = False
    grey_grade: float | None = None


@dataclass(frozen=True, slots=True)
class Recommendation:
    """Settings that are expected best, what is expected there, and whether the constraints are kept."""

    settings: Mapping[str, Value]
    expected: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]
    is_feasible: bool
    basis: str
    constraints: tuple[str, ...] = ()

    @property
    def intervals(self) -> dict[str, Interval]:
        """What is expected, and the bounds of its 95 % interval, by response."""
        return {name: (value, self.low[name], self.high[name]) for name, value in self.expected.items()}


@dataclass(frozen=True, slots=True)
class ConfirmedResponse:
    """A response at settings that were run anew on other machines, and what the models had expected of a run."""

    name: str
    expected: float
    low: float
    high: float
    measured: tuple[float, ...]

    @property
    def is_tested(self) -> bool:
        """Whether something was measured, and an interval was there to test."""
        return bool(self.measured) and math.isfinite(self.low)

    @property
    def held(self) -> int:
        return sum(self.low <= value <= self.high for value in self.measured)


@dataclass(frozen=True, slots=True)
class ConfirmedLimit:
    """A constraint with the mean of runs, and the 95 % bound of that mean on the side of the limit.

    upper : None for a single run, which has no scatter
    """

    constraint: ConstraintInfo
    mean: float
    upper: float | None

    @property
    def is_kept(self) -> bool:
        return self.constraint.excess(self.mean) <= 0

    @property
    def is_shown(self) -> bool:
        return self.upper is not None and self.constraint.excess(self.upper) <= 0

    @property
    def verdict(self) -> str:
        return "kept" if self.is_shown else "not shown to be kept" if self.is_kept else "NOT kept"


@dataclass(frozen=True, slots=True)
class Confirmation:
    """Runs at one point that no model had seen."""

    settings: Mapping[str, Value]
    runs: tuple[int, ...]
    responses: tuple[ConfirmedResponse, ...]
    limits: tuple[ConfirmedLimit, ...] = ()
