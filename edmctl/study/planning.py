"""The plan of a study: every run in its order, checked as a job, and what all of them will take."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, ProfileError
from edmctl.files import user_path
from edmctl.jobs.plan import JobRequest, Plan, check
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.planning.removal import PAD_MARGIN_UM, WALL_UM
from edmctl.profile.folders import as_value, is_path
from edmctl.profile.read import SET_OPTION
from edmctl.study import responses
from edmctl.study.design import (
    AS_LEVELS,
    LEVELS,
    OWN_KEYS,
    PAIRS,
    Points,
    center_of,
    degrees_of_freedom,
    factors_of,
    mixing,
    model_of,
    points_of,
    settings_key,
    terms_of,
)
from edmctl.study.results import (
    ConstraintInfo,
    FactorInfo,
    PlanCosts,
    PlannedRun,
    ResponseInfo,
    RunKind,
    StudyPlan,
    Value,
)
from edmctl.study.study_file import StudyMachine, StudySource
from edmctl.toml_text import toml_value
from edmctl.wording import length, plural

if TYPE_CHECKING:
    from numpy.random import Generator

TRIED_ORDERS = 200
LADDERS = (("quadratic", "interactions", "main"), (PAIRS, LEVELS))
"""Models that are tried in turn if the study file names none."""


@dataclass(frozen=True, slots=True)
class PlannedStudy:
    """A study file with its plan, the request of its profile, and the hashes of each point's recipe.

    recipes : by point, hashes of the recipe and of the `[sim]` table in effect
    """

    source: StudySource
    plan: StudyPlan
    base: JobRequest
    recipes: Mapping[int, tuple[str, str]]
    warnings: tuple[Diagnostic, ...]


def request_of(base: JobRequest, settings: Mapping[str, Value]) -> JobRequest:
    """Return the request of a study with the settings of a run."""
    overrides = (f"{key}={toml_value(value)}" for key, value in settings.items())
    return replace(base, overrides=(*base.overrides, *overrides))


def base_request(source: StudySource) -> JobRequest:
    """Return the job that all runs of a study begin with; it names files relative to the study file."""
    study, folder = source.file.study, source.path.parent
    return JobRequest(
        profile=as_value(user_path(study.profile, folder)) if is_path(study.profile) else study.profile,
        overrides=tuple(study.set),
        setup=user_path(study.setup, folder) if study.setup else None,
        port="sim:",
    )


def grid_of(machine: StudyMachine) -> list[tuple[float, float]]:
    """Return the places of the grid, row by row, µm."""
    return [
        (machine.first_x_um + column * machine.pitch_x_um, machine.first_y_um + row * machine.pitch_y_um)
        for row in range(machine.rows)
        for column in range(machine.columns)
    ]


def plan_study(source: StudySource, surroundings: Surroundings = NONE) -> PlannedStudy:
    """Check a study file and every run of it. Raises ProfileError, and what `check` of a job raises."""
    factors = factors_of(source)
    _check_keys(source)
    _check_responses(source)
    _check_bounds(source)
    draft = _Draft(source, factors, points_of(source, factors))
    draft.check(surroundings)
    draft.check_responses()
    draft.check_machine()
    draft.check_blocks()
    recipes = {point: job.loaded.recipe for point, job in draft.jobs.items()}
    return PlannedStudy(source, draft.plan(), draft.base, recipes, draft.warnings())


def _check_keys(source: StudySource) -> None:
    """Raise ProfileError for a key that the kind of the design does not use."""
    design = source.file.design
    for key in dict.fromkeys(itertools.chain(*OWN_KEYS.values())):
        is_used = key not in design.model_fields_set or key in OWN_KEYS.get(design.kind, ())
        kinds = ", ".join(kind for kind, keys in OWN_KEYS.items() if key in keys)
        message = f"{key} has no effect on a design of kind {design.kind}"
        source.require(is_used, message, f"remove it; it belongs to {kinds}", "design", key)


def _check_responses(source: StudySource) -> None:
    """Raise ProfileError for a response that does not exist, or whose keys do not fit its source."""
    file, names = source.file, [one.name for one in source.file.responses]
    objectives = {objective.response for objective in file.objectives}
    taken = {*(f.key for f in file.factors), *(f.name for f in file.factors), *responses.COLUMNS}
    for number, response in enumerate(file.responses):
        name, place = response.name, ("responses", number)
        is_known, low, high = name in responses.KNOWN, response.low, response.high
        message = f"{name} is listed twice"
        source.require(names.index(name) == number, message, "give each response once", *place, "name")
        if response.source == "job":
            for key in ("low", "high"):
                message = f"{key} has no effect on {name}, which is not a manual response"
                hint = "remove it; a limit of a recipe belongs to [[constraints]]"
                source.require(getattr(response, key) is None, message, hint, *place, key)
            hint = f'{responses.near(name)}; a response measured by hand has source = "manual"'
            source.require(is_known, f"no job answers {name}", hint, *place, "name")
        else:
            is_free = not (is_known or name in taken or name.endswith("_u95"))
            hint = "give the manual response another name"
            source.require(is_free, f"a column is called {name} already", hint, *place, "name")
        if low is not None and high is not None:
            message = f"low = {low:g} of {name} is not below high = {high:g}"
            source.require(low < high, message, "swap them", *place, "low")
        has_target = response.better != "nominal" or response.target is not None
        message = f"{name} is a nominal objective without a target"
        source.require(has_target or name not in objectives, message, "add target", *place, "name")


def _check_bounds(source: StudySource) -> None:
    """Raise ProfileError for a bound of a response that is not listed, or that it cannot reach."""
    file, names = source.file, [one.name for one in source.file.responses]
    for table in ("constraints", "objectives"):
        for number, bound in enumerate(getattr(file, table)):
            hint = f"add it to [[responses]]; there are {', '.join(names)}"
            message = f"{bound.response} is none of the responses"
            source.require(bound.response in names, message, hint, table, number, "response")
    bounds: list[tuple[str, int, str, str, float | None]] = []
    for number, one in enumerate(file.constraints):
        has_one = (one.at_most is None) != (one.at_least is None)
        source.require(
            has_one, "a constraint has one bound", "give at_most or at_least", "constraints", number
        )
        bounds.append(("constraints", number, "at_most", one.response, one.at_most))
        bounds.append(("constraints", number, "at_least", one.response, one.at_least))
    for number, response in enumerate(file.responses):
        if response.source == "job":
            bounds.append(("responses", number, "target", response.name, response.target))
    for table, number, key, name, value in bounds:
        low, high = responses.range_of(name)
        if value is not None and not low <= value <= high:
            limits = f"between {low:g} and {high:g}" if math.isfinite(high) else f"never below {low:g}"
            hint = f"a share is not a percentage: write {value / 100:g}" if 1 < value <= 100 else "correct it"
            raise source.wrong(f"{key} = {value:g}, but {name} is {limits}", hint, table, number, key)


def _set_key(diagnostic: Diagnostic) -> str:
    """Return the key of the override that a diagnostic is about; empty for others."""
    where = diagnostic.where
    is_of_set = where is not None and where.file == SET_OPTION
    return where.source_line.partition("=")[0].strip() if where is not None and is_of_set else ""


class _Draft:
    """A plan in the making: the runs of a study file, and the checked job of each point."""

    def __init__(self, source: StudySource, factors: tuple[FactorInfo, ...], points: Points) -> None:
        self.source, self.file, self.base = source, source.file, base_request(source)
        self.factors, self.points = factors, points
        self.machine, self.design = source.file.machine, source.file.design
        self.holes_per_tool = self.machine.holes_per_tool if self.machine is not None else None
        self.runs = self._ordered()
        self.by_point = {run.point: run for run in self.runs}
        self.jobs: dict[int, Plan] = {}

    def _ordered(self) -> list[PlannedRun]:
        """Return every run in its order: replicate by replicate, block by block, shuffled within."""
        import numpy as np

        design, machine = self.design, self.machine
        rng = np.random.default_rng(design.seed)
        settings = [*self.points.settings, center_of(self.source, self.factors)]
        of_center = len(settings) - 1
        numbers: dict[str, int] = {}
        point_of = [numbers.setdefault(settings_key(one), len(numbers) + 1) for one in settings]
        is_machine_a_run = machine is None and design.seeds == "run"
        ends = [of_center] if machine is not None and machine.center_runs else []
        runs: list[PlannedRun] = []
        for replicate, block in itertools.product(range(design.replicates), range(design.blocks)):
            members = [n for n, block_of in enumerate(self.points.blocks) if block_of == block]
            centers = design.center_points // design.blocks + (block < design.center_points % design.blocks)
            members += [of_center] * centers
            if machine is None and not is_machine_a_run:
                # A virtual machine makes the same run twice alike: the second has no information.
                members = list({point_of[n]: n for n in reversed(members)}.values())[::-1]
            tools = 1
            if self.holes_per_tool is not None:
                tools = math.ceil(len(members) / max(1, self.holes_per_tool - 2 * len(ends)))
            bounds = [round(n * len(members) / tools) for n in range(tools + 1)]
            if design.order == "random":
                members = self._shuffled(members, bounds, rng)
            number = replicate * design.blocks + block + 1
            before = max((run.tool for run in runs), default=0) if self.holes_per_tool is not None else 0
            for part, (begin, end) in enumerate(itertools.pairwise(bounds), 1):
                tool = before + part if machine is not None else 0
                block_number = 1 if is_machine_a_run else tool if self.holes_per_tool else number
                for n in (*ends, *members[begin:end], *ends):
                    kind = RunKind.CENTER if n == of_center else RunKind.DESIGN
                    seed = design.seed + (len(runs) if is_machine_a_run else number - 1)
                    fields = (kind, point_of[n], replicate + 1, block_number, seed, settings[n], tool)
                    runs.append(PlannedRun(len(runs) + 1, *fields))
        return runs

    def _shuffled(self, members: list[int], bounds: Sequence[int], rng: Generator) -> list[int]:
        """Shuffle the runs of a block; of many orders return the one that mixes tools and factors least."""
        import numpy as np

        tools = len(bounds) - 1
        orders: list[list[int]] = [
            rng.permutation(members).tolist() for _ in range(TRIED_ORDERS if tools > 1 else 1)
        ]
        if tools == 1:
            return orders[0]
        tool_of = np.repeat(np.arange(tools), np.diff(bounds)).tolist()
        return min(orders, key=lambda order: mixing(self.points, order, tool_of))

    def check(self, surroundings: Surroundings) -> None:
        """Check the job of each point. Raises ProfileError at the factors in the study file."""
        refused: list[tuple[Diagnostic, ...]] = []
        for point, run in self.by_point.items():
            try:
                self.jobs[point] = check(request_of(self.base, run.settings), surroundings)
            except ProfileError as error:
                errors = (one for one in error.diagnostics if not one.is_warning)
                refused.append(tuple(self._of_run(one, run) for one in errors))
        if refused:
            message = f"{len(refused)} of {len(self.by_point)} settings are refused"
            count = self.source.wrong(message, "correct the profile, or narrow the factors", "factors")
            raise ProfileError((*refused[0], *(count.diagnostics if len(refused) > 1 else ())))

    def _placed(self, diagnostic: Diagnostic) -> Diagnostic:
        """Return a diagnostic of an override at the factor or the entry of `set` in the study file."""
        key, texts = _set_key(diagnostic), self.file.study.set
        keys = [factor.key for factor in self.factors]
        if key in keys:
            return replace(diagnostic, where=self.source.sources.value(("factors", keys.index(key), "key")))
        if key and diagnostic.where is not None and diagnostic.where.source_line in texts:
            place = ("study", "set", texts.index(diagnostic.where.source_line))
            return replace(diagnostic, where=self.source.sources.value(place))
        return diagnostic

    def _of_run(self, diagnostic: Diagnostic, run: PlannedRun) -> Diagnostic:
        """Return a diagnostic of a run with its settings."""
        at = ", ".join(f"{factor.name} = {run.settings[factor.key]}" for factor in self.factors)
        return self._placed(replace(diagnostic, message=f"{diagnostic.message} (at {at})"))

    def warnings(self) -> tuple[Diagnostic, ...]:
        """Return the first warning of each code, with its settings."""
        by_code: dict[str, Diagnostic] = {}
        for point, job in self.jobs.items():
            for warning in job.loaded.warnings:
                by_code.setdefault(warning.code, self._of_run(warning, self.by_point[point]))
        return tuple(by_code.values())

    def check_responses(self) -> None:
        """Raise ProfileError for a response that a run of the study never has."""
        profiles = [job.loaded.profile for job in self.jobs.values()]
        kinds = sorted({"channel" if one.path else one.target.kind for one in profiles})
        for (number, one), kind in itertools.product(enumerate(self.file.responses), kinds):
            is_absent = one.name in responses.KNOWN and kind in responses.KNOWN[one.name].absent
            message, hint = (
                f"a job of the kind {kind} has no {one.name}",
                "take wear_um or time_s, for example",
            )
            self.source.require(not is_absent, message, hint, "responses", number, "name")

    def check_machine(self) -> None:
        """Raise ProfileError if a tool would wear too short, or the grid of a machine has no room."""
        machine, runs, require = self.machine, self.runs, self.source.require
        if machine is None:
            return
        job = next(iter(self.jobs.values()))
        profile, holes = job.loaded.profile, machine.holes_per_tool
        require(
            not profile.sites and profile.path is None,
            "a run on a machine is one hole; the profile has sites or a path",
            "name a profile of one hole",
            *("study", "profile"),
        )
        require(
            holes is None or not machine.center_runs or holes >= 3,
            f"{holes} holes a tool leave none beside the centre runs that open and close a block",
            "take 3 or more, or center_runs = false",
            *("machine", "holes_per_tool"),
        )
        limit_um = profile.tool.max_wear_um
        for tool, wear_um in self._wear_by_tool().items():
            require(
                wear_um <= limit_um,
                f"tool {tool} would lose {length(wear_um)}; tool.max_wear_um is {length(limit_um)}",
                "set holes_per_tool lower, or make the holes shallower",
                *("machine", "holes_per_tool"),
            )
        places = machine.columns * machine.rows
        message = f"the grid has {plural(places, 'place')} for {plural(len(runs), 'run')}"
        require(places >= len(runs), message, "set columns or rows higher", "machine", "columns")
        profiles = [one.loaded.profile for one in self.jobs.values()]
        radius_um = max(one.tool.diameter_um / 2 + one.work.side_gap_um for one in profiles)
        least_um, clear_um = 2 * radius_um + WALL_UM, 2 * radius_um + PAD_MARGIN_UM
        for name, count in (("pitch_x_um", machine.columns), ("pitch_y_um", machine.rows)):
            pitch_um = getattr(machine, name)
            message = f"holes of {length(2 * radius_um)} {pitch_um:g} µm apart run into each other"
            hint = f"set it to {math.ceil(least_um)} or more"
            require(count == 1 or abs(pitch_um) >= least_um, message, hint, "machine", name)
        pad_um = job.setup.stage.reference_x_um, job.setup.stage.reference_y_um
        for x_um, y_um in grid_of(machine)[: len(runs)]:
            message = f"the place at {x_um:g}, {y_um:g} µm is on the reference pad"
            hint = f"keep {math.ceil(clear_um)} µm away from it"
            require(math.dist((x_um, y_um), pad_um) >= clear_um, message, hint, "machine", "first_x_um")

    def check_blocks(self) -> None:
        """Raise ProfileError if the effect of a factor cannot be separated from that of the blocks."""
        runs = [run for run in self.runs if run.kind is RunKind.DESIGN]
        blocks = [run.block for run in runs]
        if len(set(blocks)) < 2:
            return
        terms = terms_of(LEVELS, self.factors, blocks=True)
        settings = [run.settings for run in runs]
        _, lost = degrees_of_freedom(terms, self.factors, settings, blocks, as_levels=False)
        mixed = [factor.name for factor in self.factors if factor.name in lost]
        if mixed and len(runs) > len(set(blocks)) + len(self.factors):
            place = ("machine", "holes_per_tool") if self.holes_per_tool else ("design", "blocks")
            message = f"{mixed[0]} cannot be separated from the blocks: its values change with them alone"
            raise self.source.wrong(message, "take fewer or larger blocks, or replicates", *place)

    def _wear_by_tool(self) -> dict[int, float]:
        """Return the forecast wear of each tool, µm."""
        worn: dict[int, float] = {}
        for run in self.runs:
            worn[run.tool] = worn.get(run.tool, 0.0) + self.jobs[run.point].forecast.tool_wear_um
        return worn

    def plan(self) -> StudyPlan:
        """Return the plan. Raises ProfileError if the model of the study file needs other runs."""
        forecasts = [self.jobs[run.point].forecast for run in self.runs]
        profile = next(iter(self.jobs.values())).loaded.profile
        costs = PlanCosts(
            time_s=math.fsum(one.time_s for one in forecasts),
            machining_time_s=math.fsum(one.machining_time_s for one in forecasts),
            tool_wear_um=tuple(self._wear_by_tool().values()) if self.machine is not None else (),
            most_wear_um=profile.tool.max_wear_um,
            places=len(grid_of(self.machine)) if self.machine is not None else 0,
        )
        model, dof, notes = self._model()
        return StudyPlan(
            **stated_in(self.source, self.factors),
            kind=self.points.name,
            runs=tuple(self.runs),
            points=len(self.by_point),
            model=model,
            dof=dof,
            aliases=self.points.aliases,
            notes=(*self.points.notes, *notes, *self._notes()),
            costs=costs,
        )

    def _model(self) -> tuple[str, dict[str, int], list[str]]:
        """Return the model that the runs determine, its degrees of freedom, and notes on it."""
        first = model_of(self.source, self.factors, self.points)
        is_stated = self.file.analysis.model != "auto"
        ladder = next((one for one in LADDERS if first in one), (first,))
        models = (first,) if is_stated else ladder[ladder.index(first) :]
        settings, blocks = [run.settings for run in self.runs], [run.block for run in self.runs]
        for model in models:
            terms = terms_of(model, self.factors, blocks=len(set(blocks)) > 1)
            as_levels = model in AS_LEVELS
            dof, lost = degrees_of_freedom(terms, self.factors, settings, blocks, as_levels=as_levels)
            is_fraction = self.design.kind == "fractional" and model == "interactions" and not is_stated
            # Products that leave no degree of freedom for the error test nothing.
            if lost or dof["error"] < (model == PAIRS or is_fraction):
                continue
            notes = []
            if model != first:
                notes.append(f"the runs do not determine a {first} model; {model} is fitted")
            if dof["error"] == 0:
                notes.append("the error has no degrees of freedom: F needs replicates or pooled terms")
            return model, dof, notes
        names = ", ".join(lost)
        if is_stated:
            message = f"the runs do not determine the {first} model: {names}"
            hint = "take a simpler model, more levels or more runs"
            raise self.source.wrong(message, hint, "analysis", "model")
        return models[-1], dof, [f"the runs determine no model of all factors: not {names}"]

    def _notes(self) -> list[str]:
        """Return what limits the conclusions of the study."""
        design, machine, runs, optimize = self.design, self.machine, self.runs, self.file.optimize
        points, distinct = len(self.points.settings), len(set(map(settings_key, self.points.settings)))
        shares_machines = machine is None and design.seeds != "run"
        is_limited = bool(self.file.objectives) and "runs" in optimize.model_fields_set
        profile = next(iter(self.jobs.values())).loaded.profile
        adaptive, seeks = profile.adaptive, profile.adaptive.seek_reference
        keys = {factor.key for factor in self.factors}
        moved = ["jump.period_s"]
        moved += ["servo.reference"] if adaptive.reference_step and not seeks else []
        moved += ["pulse.duty"] if adaptive.duty_step else []
        varied = [key for key in moved if key in keys]
        is_adaptive = profile.jump.mode == "adaptive" and "jump.mode" not in keys
        again = "each virtual machine makes them once" if shares_machines else "the others are replicates"
        notes = (
            (
                distinct < points,
                f"{points} points have {distinct} different settings: {again}",
            ),
            (
                machine is None and len({run.seed for run in runs}) == 1,
                "one machine (seed) in all: its sensor errors are in every run alike; replicates would show them",
            ),
            (
                is_limited and optimize.runs < 2 * len(runs),
                f"[optimize] runs = {optimize.runs} leaves {max(0, optimize.runs - len(runs))} suggestions after "
                f"the {len(runs)} runs of the design: a search needs about as many as the design",
            ),
            (
                seeks and "servo.reference" in keys,
                "adaptive.seek_reference changes servo.reference during a run: the study cannot show its effect",
            ),
            (
                is_adaptive and bool(varied),
                f"{', '.join(varied)}: a run begins there, and the supervisor moves it when arcs or shorts occur "
                '(jump.mode = "adaptive"); set = ["jump.mode=\'fixed\'"] holds it',
            ),
        )
        return [text for holds, text in notes if holds]


def stated_in(source: StudySource, factors: tuple[FactorInfo, ...]) -> dict[str, Any]:
    """Return the fields of a plan that the study file states, by name."""
    file = source.file
    constraints = [
        ConstraintInfo(bound.response, bound.at_least or 0.0, -1)
        if bound.at_most is None
        else ConstraintInfo(bound.response, bound.at_most, 1)
        for bound in file.constraints
    ]
    stated = []
    for one in file.responses:
        is_manual = one.source == "manual"
        unit = one.unit if is_manual else responses.unit_of(one.name)
        stated.append(ResponseInfo(one.name, unit, one.better, is_manual, one.log, one.target))
    return {
        "name": file.study.name,
        "description": file.study.description,
        "factors": factors,
        "responses": tuple(stated),
        "constraints": tuple(constraints),
        "objectives": tuple((one.response, one.weight) for one in file.objectives),
        "replicates": file.design.replicates,
    }
