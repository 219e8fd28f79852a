"""The plan of a study: every run in its order, checked as a job is, and what all of them will take."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, EdmError, ProfileError
from edmctl.failures import Code
from edmctl.files import user_path
from edmctl.jobs.plan import JobRequest, Plan, check
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.planning.removal import PAD_MARGIN_UM, WALL_UM
from edmctl.profile.folders import as_value, is_path
from edmctl.profile.positions import SET_OPTION, KeyPath
from edmctl.study import responses
from edmctl.study.design import (
    AS_LEVELS,
    LEVELS,
    PAIRS,
    SENSITIVITY,
    Points,
    Refused,
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
    TRUTH,
    ConstraintInfo,
    FactorInfo,
    PlanCosts,
    PlannedRun,
    ResponseInfo,
    RunKind,
    StudyPlan,
    Value,
)
from edmctl.study.study_file import Refusals, StudyMachine, StudySource
from edmctl.toml_text import toml_value
from edmctl.wording import length, plural

if TYPE_CHECKING:
    from numpy.random import Generator

MOST_REFUSED = 5
"""Refused settings that are shown; the others are counted."""
TRIED_ORDERS = 200
LADDERS = (("quadratic", "interactions", "main"), (PAIRS, LEVELS))
"""Models that are tried in turn where none was asked for."""
OF_ONE_VALUE = (
    *(Code.UNKNOWN_KEY, Code.WRONG_TYPE, Code.OUT_OF_RANGE),
    *(Code.NOT_A_CHOICE, Code.NOT_A_MULTIPLE, Code.OVERRIDE),
)
"""Findings on a value that hold whatever the others are."""
OWN_KEYS = {
    "fractional": ("resolution", "generators"),
    "taguchi": ("array", "columns"),
    "ccd": ("alpha",),
    "lhs": ("runs",),
    "sobol": ("runs",),
    "sensitivity": ("base",),
    "csv": ("file",),
}
"""Keys of [design] that belong to one kind of it."""


@dataclass(frozen=True, slots=True)
class PlannedStudy:
    """A study file with its plan, the request of its profile, and the hash of each point's recipe.

    recipes : by point, hashes of the recipe and of the `[sim]` table in effect
    changes : hold for every run beside what the file says, as `--set` takes them
    """

    source: StudySource
    plan: StudyPlan
    base: JobRequest
    recipes: Mapping[int, tuple[str, str]]
    warnings: tuple[Diagnostic, ...]
    changes: tuple[str, ...] = ()


def request_of(base: JobRequest, settings: Mapping[str, Value]) -> JobRequest:
    """Return the request of a study with the settings of a run."""
    own = (f"{key}={toml_value(value)}" for key, value in settings.items())
    return replace(base, overrides=(*base.overrides, *own))


def base_request(source: StudySource, changes: Sequence[str] = ()) -> JobRequest:
    """Return the job that all runs of a study file begin with, and `changes`; files are beside the study file."""
    study, folder = source.file.study, source.path.parent
    return JobRequest(
        profile=as_value(user_path(study.profile, folder)) if is_path(study.profile) else study.profile,
        overrides=(*study.set, *changes),
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


def plan_study(
    source: StudySource,
    surroundings: Surroundings = NONE,
    observe: Callable[[int, int], None] = lambda done, total: None,
    changes: tuple[str, ...] = (),
) -> PlannedStudy:
    """Check a study file and every run of it; `observe` gets the numbers of checked and of all settings.

    `changes` hold for every run, after what the file sets.

    Raises ProfileError with every diagnostic, and what `check` of a job raises.
    """
    factors, wrong = factors_of(source)
    wrong += [*source.wrong, *_foreign_keys(source), *_wrong_responses(source), *_wrong_bounds(source)]
    base = base_request(source, changes)
    points = Points("", ())
    try:
        if len(factors) == len(source.file.factors) and ("design",) not in source.damaged:
            points = points_of(source, factors)
    except Refused as refused:
        wrong.add(refused.hint, refused.message, "design", refused.key or "kind")
    if wrong:
        wrong += _wrong_values(source, base, factors, surroundings)
        raise ProfileError(
            tuple(sorted(dict.fromkeys(wrong), key=lambda one: one.where.line if one.where else 0))
        )
    draft = _Draft(source, base, factors, points)
    draft.check(surroundings, observe)
    draft.refuse_absent()
    draft.refuse_undoable()
    draft.refuse_mixed()
    recipes = {point: (one.loaded.sha256, one.loaded.sim_sha256) for point, one in draft.checked.items()}
    return PlannedStudy(source, draft.plan(), base, recipes, draft.warnings(), changes)


def _foreign_keys(source: StudySource) -> Refusals:
    """Refuse keys that the kind of their design or factor does not use."""
    design, wrong = source.file.design, Refusals(source)
    if ("design",) in source.damaged:
        return wrong
    own = OWN_KEYS.get(design.kind, ())
    for key in dict.fromkeys(itertools.chain(*OWN_KEYS.values())):
        if key in design.model_fields_set and key not in own:
            kinds = ", ".join(kind for kind, keys in OWN_KEYS.items() if key in keys)
            message = f"{key} says nothing to a design of kind {design.kind}"
            wrong.add(f"remove it; it belongs to {kinds}", message, "design", key)
    for number, factor in enumerate(source.file.factors):
        if ("factors", number) not in source.damaged and factor.step is not None and factor.low is None:
            message = f"step says nothing to the levels of {factor.key}"
            wrong.add("remove it, or give low and high", message, "factors", number, "step")
    return wrong


def _wrong_responses(source: StudySource) -> Refusals:
    """Refuse responses that do not exist, or whose keys do not fit their source."""
    file, wrong = source.file, Refusals(source)
    names = [one.name for one in file.responses]
    objectives = {objective.response for objective in file.objectives}
    taken = {*(f.key for f in file.factors), *(f.name for f in file.factors), *responses.COLUMNS}
    for number, one in enumerate(file.responses):
        path = ("responses", number)
        if path in source.damaged:
            continue
        is_known = one.name in responses.KNOWN
        if names.index(one.name) != number:
            wrong.add("give each response once", f"{one.name} is asked for twice", *path, "name")
        if one.source == "job":
            for key in ("low", "high"):
                if getattr(one, key) is not None:
                    hint = "remove it; a limit of a recipe stands in [[constraints]]"
                    wrong.add(hint, f"{key} says nothing to {one.name}, which no hand tells", *path, key)
            if not is_known:
                hint = f'{responses.near(one.name)}; what is told later has source = "manual"'
                wrong.add(hint, f"no job answers {one.name}", *path, "name")
        elif is_known or one.name in taken or one.name.endswith("_u95"):
            message = f"{one.name} has that name already"
            wrong.add("give what is told by hand another", message, *path, "name")
        if one.low is not None and one.high is not None and not one.low < one.high:
            message = f"low = {one.low:g} of {one.name} is not below high = {one.high:g}"
            wrong.add("swap them", message, *path, "low")
        if one.better == "nominal" and one.target is None and one.name in objectives:
            message = f"{one.name} is wanted nominal, and its target is missing"
            wrong.add("add target", message, *path, "name")
    return wrong


def _wrong_bounds(source: StudySource) -> Refusals:
    """Refuse bounds of responses that are not requested, and those that a response cannot reach."""
    file, wrong = source.file, Refusals(source)
    names = [one.name for one in file.responses]
    if not any(path[0] == "responses" for path in source.damaged):
        for table in ("constraints", "objectives"):
            for number, bound in enumerate(getattr(file, table)):
                if bound.response not in names and (table, number) not in source.damaged:
                    hint = f"add it to [[responses]]; there are {', '.join(names)}"
                    message = f"{bound.response} is none of the responses"
                    wrong.add(hint, message, table, number, "response")
    bounds: list[tuple[KeyPath, str, float | None]] = []
    for number, constraint in enumerate(file.constraints):
        path = ("constraints", number)
        if path not in source.damaged and (constraint.at_most is None) == (constraint.at_least is None):
            wrong.add("give at_most or at_least", "a constraint has one bound", *path)
        bounds += [((*path, key), constraint.response, getattr(constraint, key)) for key in _BOUND_KEYS]
    for number, one in enumerate(file.responses):
        if one.source == "job":
            bounds.append((("responses", number, "target"), one.name, one.target))
    for place, name, value in bounds:
        low, high = responses.range_of(name)
        if value is None or low <= value <= high:
            continue
        between = f"lies between {low:g} and {high:g}" if math.isfinite(high) else f"is never below {low:g}"
        hint = f"a share is no percentage: write {value / 100:g}" if 1 < value <= 100 else "correct it"
        wrong.add(hint, f"{place[-1]} = {value:g}, and {name} {between}", *place)
    return wrong


_BOUND_KEYS = ("at_most", "at_least")


def _wrong_values(
    source: StudySource, base: JobRequest, factors: Sequence[FactorInfo], surroundings: Surroundings
) -> list[Diagnostic]:
    """Keys that no profile has and values that it does not take, each factor by itself."""
    numbers = {factor.key: number for number, factor in enumerate(source.file.factors)}
    wrong = []
    for factor, value in ((one, value) for one in factors for value in one.values):
        try:
            check(request_of(base, {factor.key: value}), surroundings)
        except ProfileError as error:
            where = source.sources.value(("factors", numbers[factor.key], "key"))
            wrong += [
                replace(one, where=where)
                for one in error.diagnostics
                if one.code in OF_ONE_VALUE and _set_key(one) == factor.key
            ]
        except EdmError:
            break  # there is no such profile, or no such setup
    return wrong


def _set_key(one: Diagnostic) -> str:
    """The key of the override that a diagnostic is about; empty for others."""
    is_of_set = one.where is not None and one.where.file == SET_OPTION
    return one.where.source_line.partition("=")[0].strip() if is_of_set and one.where else ""


class _Draft:
    """A plan in the making: the runs of a study file, and the checked job of each point."""

    def __init__(
        self, source: StudySource, base: JobRequest, factors: tuple[FactorInfo, ...], points: Points
    ) -> None:
        self.source, self.file, self.base = source, source.file, base
        self.factors, self.points = factors, points
        self.machine, self.design = source.file.machine, source.file.design
        self.holes_per_tool = self.machine.holes_per_tool if self.machine is not None else None
        self.runs = self._ordered()
        self.by_point = {run.point: run for run in self.runs}
        self.checked: dict[int, Plan] = {}

    def _ordered(self) -> list[PlannedRun]:
        """Return every run in its order: replicate by replicate, block by block, shuffled within."""
        import numpy as np

        design, machine = self.design, self.machine
        rng = np.random.default_rng(design.seed)
        settings = [*self.points.settings, center_of(self.source, self.factors)]
        of_center = len(settings) - 1
        numbers: dict[str, int] = {}
        point_of = [numbers.setdefault(settings_key(one), len(numbers) + 1) for one in settings]
        if design.kind == SENSITIVITY:  # a sample whose order counts
            point_of = list(range(1, len(settings) + 1))
        is_machine_a_run = machine is None and design.seeds == "run"
        ends = [of_center] if machine is not None and machine.center_runs else []
        runs: list[PlannedRun] = []
        for replicate, block in itertools.product(range(design.replicates), range(design.blocks)):
            members = [n for n, own in enumerate(self.points.blocks) if own == block]
            centers = design.center_points // design.blocks + (block < design.center_points % design.blocks)
            members += [of_center] * centers
            if machine is None and not is_machine_a_run and design.kind != SENSITIVITY:
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
                for n in (*ends, *members[begin:end], *ends):
                    of_block = tool if self.holes_per_tool else number
                    runs.append(
                        PlannedRun(
                            number=len(runs) + 1,
                            kind=RunKind.CENTER if n == of_center else RunKind.DESIGN,
                            point=point_of[n],
                            replicate=replicate + 1,
                            block=1 if is_machine_a_run else of_block,
                            seed=design.seed + (len(runs) if is_machine_a_run else number - 1),
                            settings=settings[n],
                            tool=tool,
                        )
                    )
        return runs

    def _shuffled(self, members: list[int], bounds: Sequence[int], rng: Generator) -> list[int]:
        """Shuffle the runs of a block; of many orders the one that mixes tools and factors least."""
        import numpy as np

        tools = len(bounds) - 1
        tries = range(TRIED_ORDERS if tools > 1 else 1)
        orders: list[list[int]] = [rng.permutation(members).tolist() for _ in tries]
        if tools == 1:
            return orders[0]
        tool_of = np.repeat(np.arange(tools), np.diff(bounds)).tolist()
        return min(orders, key=lambda order: mixing(self.points, order, tool_of))

    def check(self, surroundings: Surroundings, observe: Callable[[int, int], None]) -> None:
        """Check each point once. Raises ProfileError with the places of the factors in the study file."""
        try:
            check(self.base, surroundings)
        except ProfileError as error:
            # The profile is wrong without any of the settings, unless they are what is missing.
            try:
                check(request_of(self.base, self.runs[0].settings), surroundings)
            except ProfileError:
                raise ProfileError(tuple(map(self._of_set, error.diagnostics))) from error
        refused: list[Diagnostic] = []
        wrong_points = 0
        for done, (point, run) in enumerate(self.by_point.items()):
            observe(done, len(self.by_point))
            try:
                self.checked[point] = check(request_of(self.base, run.settings), surroundings)
            except ProfileError as error:
                wrong_points += 1
                if wrong_points <= MOST_REFUSED:
                    refused += [self._of_run(one, run) for one in error.diagnostics if not one.is_warning]
        observe(len(self.by_point), len(self.by_point))
        if wrong_points > MOST_REFUSED:
            count = f"{wrong_points} of {len(self.by_point)} settings are refused"
            message = f"{count}; these are the first {MOST_REFUSED}"
            refused.append(self.source.refusal(("factors",), message, "narrow the factors"))
        if refused:
            raise ProfileError(tuple(dict.fromkeys(refused)))

    def _of_set(self, one: Diagnostic) -> Diagnostic:
        """A diagnostic of a value in `set`, at its place in the study file."""
        texts = self.file.study.set
        if not _set_key(one) or one.where is None or one.where.source_line not in texts:
            return one
        place = ("study", "set", texts.index(one.where.source_line))
        return replace(one, where=self.source.sources.value(place))

    def _of_run(self, one: Diagnostic, run: PlannedRun) -> Diagnostic:
        """A diagnostic of a run with its settings, at the place of the factor in the study file."""
        at = ", ".join(f"{factor.name} = {run.settings[factor.key]}" for factor in self.factors)
        found = replace(one, message=f"{one.message} (at {at})")
        keys = [factor.key for factor in self.file.factors]
        if (key := _set_key(one)) in keys:
            return replace(found, where=self.source.sources.value(("factors", keys.index(key), "key")))
        return self._of_set(found)

    def warnings(self) -> tuple[Diagnostic, ...]:
        """One warning of a kind, with the settings that it is about and how many others there are."""
        found: dict[str, dict[int, Diagnostic]] = {}
        for point, plan in self.checked.items():
            for one in plan.loaded.warnings:
                found.setdefault(one.code, {}).setdefault(point, self._of_run(one, self.by_point[point]))
        return tuple(
            replace(one, message=f"{one.message}, and {len(rest)} more settings") if rest else one
            for one, *rest in map(dict.values, found.values())
        )

    def refuse_absent(self) -> None:
        """Raise ProfileError for a response that a run of the study never has."""
        profiles, wrong = [one.loaded.profile for one in self.checked.values()], Refusals(self.source)
        kinds = {"channel" if one.path else one.target.kind for one in profiles}
        for number, one in enumerate(self.file.responses):
            for kind in sorted(kinds):
                if one.name in responses.KNOWN and kind in responses.KNOWN[one.name].absent:
                    hint = "take another response, such as wear_um or time_s"
                    message = f"a job of the kind {kind} has no {one.name}"
                    wrong.add(hint, message, "responses", number, "name")
        wrong.check()

    def refuse_undoable(self) -> None:
        """Raise ProfileError if a tool would wear too short, or the grid of a machine has no room."""
        machine, runs = self.machine, self.runs
        if machine is None:
            return
        some, wrong = next(iter(self.checked.values())), Refusals(self.source)
        profile, per_tool = some.loaded.profile, machine.holes_per_tool
        if profile.sites or profile.path is not None:
            message = (
                "a run of a study on a machine is one hole, and the profile has sites or a path of its own"
            )
            wrong.add("name a profile of one hole", message, "study", "profile")
        if per_tool is not None and machine.center_runs and per_tool < 3:
            message = f"{per_tool} holes a tool leave none beside the centre runs that open and close a block"
            wrong.add("take 3 or more, or center_runs = false", message, "machine", "holes_per_tool")
        limit_um = profile.tool.max_wear_um
        worn = [(tool, um) for tool, um in self._wear_by_tool().items() if um > limit_um]
        for tool, wear_um in worn[:1]:
            message = (
                f"tool {tool} would lose {length(wear_um)} in all, and tool.max_wear_um is {length(limit_um)}"
            )
            hint = "set holes_per_tool lower, or make the holes shallower"
            wrong.add(hint, message, "machine", "holes_per_tool")
        places = machine.columns * machine.rows
        if places < len(runs):
            message = f"the grid has {plural(places, 'place')} for {plural(len(runs), 'run')}"
            wrong.add("set columns or rows higher", message, "machine", "columns")
        profiles = [one.loaded.profile for one in self.checked.values()]
        radius_um = max(one.tool.diameter_um / 2 + one.work.side_gap_um for one in profiles)
        least_um, clear_um = 2 * radius_um + WALL_UM, 2 * radius_um + PAD_MARGIN_UM
        for name, count in (("pitch_x_um", machine.columns), ("pitch_y_um", machine.rows)):
            pitch_um = getattr(machine, name)
            if count > 1 and abs(pitch_um) < least_um:
                message = f"holes of {length(2 * radius_um)} {pitch_um:g} µm apart run into each other"
                wrong.add(f"set it to {math.ceil(least_um)} or more", message, "machine", name)
        pad_um = some.setup.stage.reference_x_um, some.setup.stage.reference_y_um
        hit = [place for place in grid_of(machine)[: len(runs)] if math.dist(place, pad_um) < clear_um]
        for x_um, y_um in hit[:1]:
            message = f"the place at {x_um:g}, {y_um:g} µm lies on the reference pad"
            wrong.add(f"keep {math.ceil(clear_um)} µm away from it", message, "machine", "first_x_um")
        wrong.check()

    def refuse_mixed(self) -> None:
        """Raise ProfileError where the effect of a factor cannot be separated from that of the blocks."""
        own = [run for run in self.runs if run.kind is RunKind.DESIGN]
        blocks = [run.block for run in own]
        if len(set(blocks)) < 2 or self.design.kind == SENSITIVITY:
            return
        terms = terms_of(LEVELS, self.factors, blocks=True)
        settings = [run.settings for run in own]
        _, lost = degrees_of_freedom(terms, self.factors, settings, blocks, as_levels=False)
        mixed = [factor for factor in self.factors if factor.name in lost]
        if mixed and len(own) > len(set(blocks)) + len(self.factors):
            what = "tools" if self.holes_per_tool else "blocks"
            message = f"{mixed[0].name} cannot be told from the {what}: its values change with them alone"
            key: KeyPath = ("machine", "holes_per_tool") if what == "tools" else ("design", "blocks")
            hint = "take fewer or larger blocks, or replicates"
            raise ProfileError((self.source.refusal(key, message, hint),))

    def _wear_by_tool(self) -> dict[int, float]:
        """Return what each tool loses by the forecasts, µm."""
        worn: dict[int, float] = {}
        for run in self.runs:
            worn[run.tool] = worn.get(run.tool, 0.0) + self.checked[run.point].forecast.tool_wear_um
        return worn

    def plan(self) -> StudyPlan:
        """Return the plan. Raises ProfileError where the model that was asked for needs other runs."""
        forecasts = [self.checked[run.point].forecast for run in self.runs]
        profile = next(iter(self.checked.values())).loaded.profile
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
            notes=(*self.points.notes, *notes, *self._notes(), *self._adapted()),
            costs=costs,
        )

    def _model(self) -> tuple[str, dict[str, int], list[str]]:
        """Return the model that the runs determine, its degrees of freedom, and notes on it."""
        if self.design.kind == SENSITIVITY:
            return SENSITIVITY, {"error": 0}, []
        first = model_of(self.source, self.factors, self.points)
        is_asked = self.file.analysis.model != "auto"
        ladder = next((one for one in LADDERS if first in one), (first,))
        models = (first,) if is_asked else ladder[ladder.index(first) :]
        settings, blocks = [run.settings for run in self.runs], [run.block for run in self.runs]
        for model in models:
            terms = terms_of(model, self.factors, blocks=len(set(blocks)) > 1)
            as_levels = model in AS_LEVELS
            dof, lost = degrees_of_freedom(terms, self.factors, settings, blocks, as_levels=as_levels)
            is_fraction = self.design.kind == "fractional" and model == "interactions" and not is_asked
            # Products that leave nothing for the error test nothing.
            least = 1 if model == PAIRS or is_fraction else 0
            if not lost and dof["error"] >= least:
                notes = (
                    []
                    if model == first
                    else [f"the runs do not determine a {first} model; {model} is fitted"]
                )
                if dof["error"] == 0:
                    notes.append(
                        "no degrees of freedom are left for the error: F needs replicates, or terms that are pooled"
                    )
                return model, dof, notes
        names = ", ".join(lost)
        if is_asked:
            message = f"the runs do not determine the {first} model: {names}"
            hint = "take a simpler model, more levels or more runs"
            raise ProfileError((self.source.refusal(("analysis", "model"), message, hint),))
        return models[-1], dof, [f"the runs determine no model of all factors: not {names}"]

    def _notes(self) -> list[str]:
        design, machine, runs, optimize = self.design, self.machine, self.runs, self.file.optimize
        settings = self.points.settings
        rows, distinct = len(settings), len(set(map(settings_key, settings)))
        shares_machines = machine is None and design.seeds != "run"
        again = (
            "a virtual machine would make them alike, so each machine makes them once; replicates make them anew"
            if shares_machines
            else "they are replicates of one point"
        )
        centers = sum(run.kind is RunKind.CENTER for run in runs)
        opens_tools = machine is not None and machine.center_runs and self.holes_per_tool is not None
        is_limited = bool(self.file.objectives) and "runs" in optimize.model_fields_set
        return _that_hold(
            (
                distinct < rows and design.kind != SENSITIVITY,
                f"{rows} points have {distinct} different settings: {again}",
            ),
            (
                machine is None and len({run.seed for run in runs}) == 1,
                "one machine (seed) in all: what its sensor errs by stands in every run alike, and may follow the "
                "time that a run takes; replicates would show it",
            ),
            (
                opens_tools and 2 * centers >= len(runs),
                f"{centers} of {len(runs)} holes are centre runs, which open and close the holes of each tool: a "
                "higher holes_per_tool, or center_runs = false, makes fewer",
            ),
            (
                shares_machines and design.center_points > design.blocks,
                "a virtual machine makes the same run twice alike: a centre point is made once a machine; "
                'replicates, blocks or seeds = "run" make more that differ',
            ),
            (
                is_limited and optimize.runs < 2 * len(runs),
                f"[optimize] runs = {optimize.runs} leaves {max(0, optimize.runs - len(runs))} suggestions after "
                f"the {len(runs)} runs of the design: a search needs about as many as the design",
            ),
            (
                any(one.name.startswith(TRUTH) for one in self.file.responses),
                "truth.* is what the virtual machine knows: no real machine answers it",
            ),
        )

    def _adapted(self) -> list[str]:
        """Note what the supervisor moves during a run, although the study varies it."""
        keys = {factor.key for factor in self.factors}
        profile = next(iter(self.checked.values())).loaded.profile
        adaptive, seeks = profile.adaptive, profile.adaptive.seek_reference
        moved = ["jump.period_s"]
        moved += ["servo.reference"] if adaptive.reference_step and not seeks else []
        moved += ["pulse.duty"] if adaptive.duty_step else []
        varied = [key for key in moved if key in keys]
        is_adaptive = profile.jump.mode == "adaptive" and "jump.mode" not in keys
        return _that_hold(
            (
                seeks and "servo.reference" in keys,
                "adaptive.seek_reference finds the reference during a run: servo.reference tells nothing of it",
            ),
            (
                is_adaptive and bool(varied),
                f"{', '.join(varied)}: a run begins there, and the supervisor moves it where arcs or shorts ask for "
                'it (jump.mode = "adaptive"); set = ["jump.mode=\'fixed\'"] holds it',
            ),
        )


def _that_hold(*notes: tuple[bool, str]) -> list[str]:
    return [text for holds, text in notes if holds]


def stated_in(source: StudySource, factors: tuple[FactorInfo, ...]) -> dict[str, Any]:
    """Return the fields of a plan that the study file states, by name."""
    file = source.file
    constraints = []
    for bound in file.constraints:
        limit, sign = (bound.at_least or 0.0, -1) if bound.at_most is None else (bound.at_most, 1)
        constraints.append(ConstraintInfo(bound.response, limit, sign))
    asked = []
    for one in file.responses:
        is_manual = one.source == "manual"
        unit = one.unit if is_manual else responses.unit_of(one.name)
        asked.append(ResponseInfo(one.name, unit, one.better, is_manual, one.log, one.target))
    return {
        "name": file.study.name,
        "description": file.study.description,
        "factors": factors,
        "responses": tuple(asked),
        "constraints": tuple(constraints),
        "objectives": tuple((one.response, one.weight) for one in file.objectives),
        "replicates": file.design.replicates,
    }
