"""The plan of a study: every run in its order, checked as a job is, and what all of them will take."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from edmctl.dataclasses import dataclass, replace
from edmctl.errors import Diagnostic, EdmError, ProfileError
from edmctl.failures import Code
from edmctl.files import user_path
from edmctl.jobs.plan import JobRequest, Plan, check
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.profile.findings import PAD_MARGIN_UM, WALL_UM
from edmctl.profile.folders import as_value, is_path
from edmctl.profile.model import Profile
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
from edmctl.study.rows import is_run_of, need
from edmctl.study.study_file import Refusals, Response, StudyMachine, StudySource
from edmctl.toml_text import toml_value
from edmctl.wording import length, plural

if TYPE_CHECKING:
    from numpy.random import Generator


def parts_of(members: int, machine: StudyMachine | None) -> int:
    """Return by how many tools the runs of a block are made."""
    if machine is None or machine.holes_per_tool is None:
        return 1
    return math.ceil(members / max(1, machine.holes_per_tool - (2 if machine.center_runs else 0)))


def bounds_of(count: int, parts: int) -> list[int]:
    """Return where each of so many parts of a row begins, and where the last one ends."""
    return [round(n * count / parts) for n in range(parts + 1)]


def by_tool(
    members: list[int], machine: StudyMachine | None, before: Sequence[PlannedRun]
) -> list[tuple[list[int], int]]:
    """Return the runs of a block by the tool that makes them; tools are numbered on from the runs before."""
    if machine is None:
        return [(members, 0)]
    if machine.holes_per_tool is None:
        return [(members, 1)]
    parts = parts_of(len(members), machine)
    first = max((run.tool for run in before), default=0) + 1
    bounds = bounds_of(len(members), parts)
    return [(members[bounds[n] : bounds[n + 1]], first + n) for n in range(parts)]


def grid_of(machine: StudyMachine) -> list[tuple[float, float]]:
    """Return the places of the grid, row by row, µm."""
    return [
        (machine.first_x_um + column * machine.pitch_x_um, machine.first_y_um + row * machine.pitch_y_um)
        for row in range(machine.rows)
        for column in range(machine.columns)
    ]


def wear_by_tool(runs: Sequence[PlannedRun], checked: Mapping[int, Plan]) -> dict[int, float]:
    """Return what each tool loses by the forecasts, µm."""
    worn: dict[int, float] = {}
    for run in runs:
        worn[run.tool] = worn.get(run.tool, 0.0) + checked[run.point].forecast.tool_wear_um
    return worn


def refuse_undoable(source: StudySource, runs: Sequence[PlannedRun], checked: Mapping[int, Plan]) -> None:
    """Raise ProfileError if a tool would wear too short, or the grid has no room."""
    machine = source.file.machine
    if machine is None:
        return
    some, wrong = next(iter(checked.values())), Refusals(source)
    profile = some.loaded.profile
    if profile.sites or profile.path is not None:
        message = "a run of a study on a machine is one hole, and the profile has sites or a path of its own"
        wrong.add("name a profile of one hole", message, "study", "profile")
    per_tool = machine.holes_per_tool
    if per_tool is not None and machine.center_runs and per_tool < 3:
        message = f"{per_tool} holes a tool leave none beside the centre runs that open and close a block"
        wrong.add("take 3 or more, or center_runs = false", message, "machine", "holes_per_tool")
    limit_um = profile.tool.max_wear_um
    worn = [(tool, um) for tool, um in wear_by_tool(runs, checked).items() if um > limit_um]
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
    radius_um = max(
        one.loaded.profile.tool.diameter_um / 2 + one.loaded.profile.work.side_gap_um
        for one in checked.values()
    )
    least_um, clear_um = 2 * radius_um + WALL_UM, 2 * radius_um + PAD_MARGIN_UM
    for name, count in (("pitch_x_um", machine.columns), ("pitch_y_um", machine.rows)):
        pitch_um = getattr(machine, name)
        if count > 1 and abs(pitch_um) < least_um:
            message = f"holes of {length(2 * radius_um)} {pitch_um:g} µm apart run into each other"
            wrong.add(f"set it to {math.ceil(least_um)} or more", message, "machine", name)
    pad_um = some.setup.stage.reference_x_um, some.setup.stage.reference_y_um
    hit = [place_um for place_um in grid_of(machine)[: len(runs)] if math.dist(place_um, pad_um) < clear_um]
    for x_um, y_um in hit[:1]:
        message = f"the place at {x_um:g}, {y_um:g} µm lies on the reference pad"
        wrong.add(f"keep {math.ceil(clear_um)} µm away from it", message, "machine", "first_x_um")
    wrong.check()


MOST_REFUSED = 5
"""So many refused settings are told; the others are counted."""


@dataclass(frozen=True, slots=True)
class PlannedStudy:
    """A study file with its plan, the request of its profile, and the hash of each point's recipe."""

    source: StudySource
    plan: StudyPlan
    base: JobRequest
    recipes: Mapping[int, tuple[str, str]]
    """By point: hashes of the recipe and of the `[sim]` table in effect."""
    warnings: tuple[Diagnostic, ...]
    changes: tuple[str, ...] = ()
    """What holds for every run beside what the file says, as `--set` takes it."""


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


def plan_study(
    source: StudySource,
    surroundings: Surroundings = NONE,
    observe: Callable[[int, int], None] = lambda done, total: None,
    changes: tuple[str, ...] = (),
) -> PlannedStudy:
    """Check a study file and every run of it; `observe` is told how many settings of how many are checked.

    `changes` hold for every run, after what the file sets.

    Raises ProfileError with every diagnostic, and what `check` of a job raises.
    """
    factors, wrong = factors_of(source)
    wrong += [*source.wrong, *_foreign_keys(source), *_wrong_names(source)]
    base = base_request(source, changes)
    points = Points("", (), ())
    try:
        if len(factors) == len(source.file.factors) and ("design",) not in source.damaged:
            points = points_of(source, factors)
    except Refused as refused:
        wrong.append(source.refusal(("design", refused.key), refused.message, refused.hint))
    if wrong:
        wrong += _wrong_values(source, base, factors, surroundings)
        raise ProfileError(
            tuple(sorted(dict.fromkeys(wrong), key=lambda one: one.where.line if one.where else 0))
        )
    runs = _runs(source, points, center_of(source, factors))
    checked = _checked(source, base, factors, runs, surroundings, observe)
    _refuse_absent(source, checked)
    refuse_undoable(source, runs, checked)
    plan = _plan(source, factors, points, runs, checked)
    recipes = {point: (one.loaded.sha256, one.loaded.sim_sha256) for point, one in checked.items()}
    return PlannedStudy(source, plan, base, recipes, _warnings(source, runs, checked, factors), changes)


def _refuse_absent(source: StudySource, checked: Mapping[int, Plan]) -> None:
    """Raise ProfileError for a response that a run of the study never has."""
    profiles, wrong = [one.loaded.profile for one in checked.values()], Refusals(source)
    kinds = {"channel" if one.path else one.target.kind for one in profiles}
    for number, one in enumerate(source.file.responses):
        for kind in sorted(kinds):
            if one.name in responses.KNOWN and kind in responses.KNOWN[one.name].absent:
                hint = "take another response, such as wear_um or time_s"
                wrong.add(hint, f"a job of the kind {kind} has no {one.name}", "responses", number, "name")
    wrong.check()


def _wrong_values(
    source: StudySource, base: JobRequest, factors: Sequence[FactorInfo], surroundings: Surroundings
) -> list[Diagnostic]:
    """Keys that no profile has and values that it does not take, each factor by itself."""
    numbers = {factor.key: number for number, factor in enumerate(source.file.factors)}
    wrong = []
    for factor in factors:
        for value in factor.values:
            try:
                check(request_of(base, {factor.key: value}), surroundings)
            except ProfileError as error:
                where = source.sources.value(("factors", numbers[factor.key], "key"))
                wrong += [
                    replace(one, where=where)
                    for one in error.diagnostics
                    if one.code in OF_ONE_VALUE
                    and one.where is not None
                    and one.where.file == SET_OPTION
                    and one.where.source_line.partition("=")[0] == factor.key
                ]
            except EdmError:
                return wrong  # there is no such profile, or no such setup
    return wrong


OF_ONE_VALUE = (
    Code.UNKNOWN_KEY,
    Code.WRONG_TYPE,
    Code.OUT_OF_RANGE,
    Code.NOT_A_CHOICE,
    Code.NOT_A_MULTIPLE,
    Code.OVERRIDE,
)
"""What can be said of a value whatever the others are."""
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


def _foreign_keys(source: StudySource) -> list[Diagnostic]:
    """Refuse keys that the kind of their design or factor does not use."""
    design, wrong = source.file.design, Refusals(source)
    if ("design",) in source.damaged:
        return []
    own = OWN_KEYS.get(design.kind, ())
    for key in dict.fromkeys(key for keys in OWN_KEYS.values() for key in keys):
        if key in design.model_fields_set and key not in own:
            kinds = ", ".join(kind for kind, keys in OWN_KEYS.items() if key in keys)
            message = f"{key} says nothing to a design of kind {design.kind}"
            wrong.add(f"remove it; it belongs to {kinds}", message, "design", key)
    for number, factor in enumerate(source.file.factors):
        if ("factors", number) not in source.damaged and factor.step is not None and factor.low is None:
            message = f"step says nothing to the levels of {factor.key}"
            wrong.add("remove it, or give low and high", message, "factors", number, "step")
    return wrong


def _wrong_names(source: StudySource) -> list[Diagnostic]:
    """Refuse responses that do not exist, and constraints and objectives of responses that are not requested."""
    file, wrong = source.file, Refusals(source)
    names = [one.name for one in file.responses]
    wanted = {objective.response for objective in file.objectives}
    taken = {
        *(factor.key for factor in file.factors),
        *(factor.name for factor in file.factors),
        *responses.COLUMNS,
    }
    for number, one in enumerate(file.responses):
        if ("responses", number) in source.damaged:
            continue
        path: KeyPath = ("responses", number, "name")
        is_known = one.name in responses.KNOWN
        if names.index(one.name) != number:
            wrong.add("give each response once", f"{one.name} is asked for twice", *path)
        if one.source == "job":
            for key in ("low", "high"):
                if getattr(one, key) is not None:
                    hint = "remove it; a limit of a recipe stands in [[constraints]]"
                    wrong.add(hint, f"{key} says nothing to {one.name}, which no hand tells", *path[:2], key)
            if not is_known:
                hint = f'{responses.near(one.name)}; what is told later has source = "manual"'
                wrong.add(hint, f"no job answers {one.name}", *path)
        elif is_known or one.name in taken or one.name.endswith("_u95"):
            wrong.add("give what is told by hand another", f"{one.name} has that name already", *path)
        if one.low is not None and one.high is not None and not one.low < one.high:
            message = f"low = {one.low:g} of {one.name} is not below high = {one.high:g}"
            wrong.add("swap them", message, *path[:2], "low")
        if one.better == "nominal" and one.target is None and one.name in wanted:
            wrong.add("add target", f"{one.name} is wanted nominal, and its target is missing", *path)
    if not any(path[0] == "responses" for path in source.damaged):
        for table in ("constraints", "objectives"):
            for number, bound in enumerate(getattr(file, table)):
                if bound.response not in names and (table, number) not in source.damaged:
                    hint = f"add it to [[responses]]; there are {', '.join(names)}"
                    message = f"{bound.response} is none of the responses"
                    wrong.add(hint, message, table, number, "response")
    for number, constraint in enumerate(file.constraints):
        has_one = (constraint.at_most is None) != (constraint.at_least is None)
        if not has_one and ("constraints", number) not in source.damaged:
            wrong.add("give at_most or at_least", "a constraint has one bound", "constraints", number)
    return [*wrong, *_bounds_beyond(source)]


def _bounds_beyond(source: StudySource) -> list[Diagnostic]:
    """Refuse bounds and targets that a response cannot reach, such as a percentage for a share."""
    wrong = Refusals(source)
    wanted = [
        *(
            (("constraints", number, key), one.response, getattr(one, key))
            for number, one in enumerate(source.file.constraints)
            for key in ("at_most", "at_least")
        ),
        *(
            (("responses", number, "target"), one.name, one.target)
            for number, one in enumerate(source.file.responses)
            if one.source == "job"
        ),
    ]
    for path, name, value in wanted:
        low, high = responses.range_of(name)
        if value is None or low <= value <= high:
            continue
        between = f"lies between {low:g} and {high:g}" if math.isfinite(high) else f"is never below {low:g}"
        hint = f"a share is no percentage: write {value / 100:g}" if 1 < value <= 100 else "correct it"
        wrong.add(hint, f"{path[-1]} = {value:g}, and {name} {between}", *path)
    return wrong


def _runs(source: StudySource, points: Points, center: dict[str, Value]) -> list[PlannedRun]:
    """Return every run in its order: replicate by replicate, block by block, shuffled within."""
    import numpy as np

    design, machine = source.file.design, source.file.machine
    rng = np.random.default_rng(design.seed)
    of_center = len(points.settings)
    point_of = _point_numbers([*points.settings, center], are_ordered=design.kind == SENSITIVITY)
    makes_twins = machine is None and design.seeds != "run" and design.kind != SENSITIVITY
    runs: list[PlannedRun] = []
    for replicate in range(design.replicates):
        for block in range(design.blocks):
            members = [n for n, own in enumerate(points.blocks) if own == block]
            centers = design.center_points // design.blocks + (block < design.center_points % design.blocks)
            members += [of_center] * centers
            if makes_twins:  # a virtual machine makes the same run twice alike: the second would tell nothing
                members = list({point_of[n]: n for n in reversed(members)}.values())[::-1]
            parts = parts_of(len(members), machine)
            if design.order == "random":
                members = _shuffled(members, parts, points, rng)
            number = replicate * design.blocks + block + 1
            seed = design.seed + number - 1
            for part, tool in by_tool(members, machine, runs):
                ends = [of_center] if machine is not None and machine.center_runs else []
                for point in (*ends, *part, *ends):
                    is_center = point == of_center
                    own = machine is None and design.seeds == "run"
                    runs.append(
                        PlannedRun(
                            number=len(runs) + 1,
                            kind=RunKind.CENTER if is_center else RunKind.DESIGN,
                            point=point_of[point],
                            replicate=replicate + 1,
                            block=1
                            if own
                            else tool
                            if machine is not None and machine.holes_per_tool
                            else number,
                            seed=design.seed + len(runs) if own else seed,
                            settings=center if is_center else points.settings[point],
                            tool=tool,
                        )
                    )
    return runs


def _point_numbers(settings: Sequence[Mapping[str, Value]], *, are_ordered: bool) -> list[int]:
    """Numbers of points: equal settings are one, but in a sample whose order counts."""
    if are_ordered:
        return list(range(1, len(settings) + 1))
    numbers: dict[str, int] = {}
    return [numbers.setdefault(settings_key(one), len(numbers) + 1) for one in settings]


TRIED_ORDERS = 200


def _shuffled(members: list[int], parts: int, points: Points, rng: Generator) -> list[int]:
    """Shuffle the runs of a block; where several tools make them, of many orders the one that mixes them least."""
    import numpy as np

    orders: list[list[int]] = [
        rng.permutation(members).tolist() for _ in range(TRIED_ORDERS if parts > 1 else 1)
    ]
    if parts == 1:
        return orders[0]
    bounds = bounds_of(len(members), parts)
    part_of = np.repeat(np.arange(parts), np.diff(bounds)).tolist()
    return min(orders, key=lambda order: mixing(points, order, part_of))


def _checked(
    source: StudySource,
    base: JobRequest,
    factors: Sequence[FactorInfo],
    runs: Sequence[PlannedRun],
    surroundings: Surroundings,
    observe: Callable[[int, int], None],
) -> dict[int, Plan]:
    """Check each point once; every refused one is told of the factors' places in the study file."""
    try:
        check(base, surroundings)
    except ProfileError as error:
        # Not the study's: its profile is wrong without any of the settings, unless they are what is missing.
        if not _mends(base, runs, surroundings):
            raise ProfileError(tuple(_of_set(one, source) for one in error.diagnostics)) from error
    by_point = {run.point: run for run in runs}
    checked: dict[int, Plan] = {}
    refused: list[Diagnostic] = []
    wrong_points = 0
    for done, (point, run) in enumerate(by_point.items()):
        observe(done, len(by_point))
        try:
            checked[point] = check(request_of(base, run.settings), surroundings)
        except ProfileError as error:
            wrong_points += 1
            if wrong_points <= MOST_REFUSED:
                refused += [
                    _of_factor(one, source, run, factors) for one in error.diagnostics if not one.is_warning
                ]
    observe(len(by_point), len(by_point))
    if refused:
        if wrong_points > MOST_REFUSED:
            message = (
                f"{wrong_points} of {len(by_point)} settings are refused; these are the first {MOST_REFUSED}"
            )
            refused.append(source.refusal(("factors",), message, "narrow the factors"))
        raise ProfileError(tuple(dict.fromkeys(refused)))
    return checked


def _warnings(
    source: StudySource,
    runs: Sequence[PlannedRun],
    checked: Mapping[int, Plan],
    factors: Sequence[FactorInfo],
) -> tuple[Diagnostic, ...]:
    """One warning of a kind, with the settings that it is about and how many others there are."""
    by_point = {run.point: run for run in runs}
    first: dict[str, Diagnostic] = {}
    points: dict[str, set[int]] = {}
    for point, plan in checked.items():
        for one in plan.loaded.warnings:
            first.setdefault(one.code, _of_factor(one, source, by_point[point], factors))
            points.setdefault(one.code, set()).add(point)
    return tuple(
        replace(one, message=f"{one.message}, and {len(points[code]) - 1} more settings")
        if len(points[code]) > 1
        else one
        for code, one in first.items()
    )


def _mends(base: JobRequest, runs: Sequence[PlannedRun], surroundings: Surroundings) -> bool:
    try:
        check(request_of(base, runs[0].settings), surroundings)
    except ProfileError:
        return False
    return True


def _of_set(one: Diagnostic, source: StudySource) -> Diagnostic:
    """A diagnostic of a value in `set`, at its place in the study file."""
    if one.where is None or one.where.file != "--set":
        return one
    texts = source.file.study.set
    if one.where.source_line in texts:
        where = source.sources.value(("study", "set", texts.index(one.where.source_line)))
        return replace(one, where=where)
    return one


def _of_factor(
    one: Diagnostic, source: StudySource, run: PlannedRun, factors: Sequence[FactorInfo]
) -> Diagnostic:
    """A diagnostic of a setting, at the factor's place in the study file, with the settings that it takes."""
    at = ", ".join(f"{factor.name} = {run.settings[factor.key]}" for factor in factors)
    message = f"{one.message} (at {at})"
    if one.where is None or one.where.file != "--set":
        return replace(one, message=message)
    key = one.where.source_line.partition("=")[0].strip()
    keys = [factor.key for factor in source.file.factors]
    if key in keys:
        return replace(one, message=message, where=source.sources.value(("factors", keys.index(key), "key")))
    return replace(_of_set(one, source), message=message)


def _plan(
    source: StudySource,
    factors: tuple[FactorInfo, ...],
    points: Points,
    runs: Sequence[PlannedRun],
    checked: Mapping[int, Plan],
) -> StudyPlan:
    file = source.file
    forecasts = [checked[run.point].forecast for run in runs]
    worn = wear_by_tool(runs, checked)
    costs = PlanCosts(
        time_s=math.fsum(one.time_s for one in forecasts),
        machining_time_s=math.fsum(one.machining_time_s for one in forecasts),
        tool_wear_um=tuple(worn.values()) if file.machine is not None else (),
        most_wear_um=next(iter(checked.values())).loaded.profile.tool.max_wear_um,
        places=len(grid_of(file.machine)) if file.machine is not None else 0,
    )
    _refuse_mixed(source, factors, runs)
    model, dof, notes = _model(source, factors, points, runs)
    profile = next(iter(checked.values())).loaded.profile
    notes = [*points.notes, *notes, *_notes(source, points, runs), *_adapted(factors, profile)]
    return StudyPlan(
        **stated_in(source, factors),
        kind=points.name,
        runs=tuple(runs),
        points=len({run.point for run in runs}),
        model=model,
        dof=dof,
        aliases=points.aliases,
        notes=tuple(notes),
        costs=costs,
    )


def check_plan(plan: StudyPlan, source: StudySource) -> None:
    """Raise ValueError if a plan that was read is none of its study file: other factors, runs beyond them."""
    factors, wrong = factors_of(source)
    need(not wrong and replace(plan, **stated_in(source, factors)) == plan)
    need((plan.model == SENSITIVITY) == (source.file.design.kind == SENSITIVITY))
    need(plan.model in (SENSITIVITY, *LADDERS[0], *LADDERS[1]))
    need(plan.points == len({run.point for run in plan.runs}) > 0)
    for number, run in enumerate(plan.runs, 1):
        need(run.number == number and is_run_of(run, factors) and run.replicate <= plan.replicates)
        need(run.kind in (RunKind.DESIGN, RunKind.CENTER))


def stated_in(source: StudySource, factors: tuple[FactorInfo, ...]) -> dict[str, Any]:
    """Return the fields of a plan that the study file states, by name."""
    file = source.file
    return {
        "name": file.study.name,
        "description": file.study.description,
        "factors": factors,
        "responses": tuple(map(_response, file.responses)),
        "constraints": tuple(
            ConstraintInfo(
                one.response, one.at_most if one.at_most is not None else one.at_least or 0.0, sign
            )
            for one in file.constraints
            for sign in [1 if one.at_most is not None else -1]
        ),
        "objectives": tuple((one.response, one.weight) for one in file.objectives),
        "replicates": file.design.replicates,
    }


def _response(one: Response) -> ResponseInfo:
    is_manual = one.source == "manual"
    unit = one.unit if is_manual else responses.unit_of(one.name)
    return ResponseInfo(one.name, unit, one.better, is_manual, one.log, one.target)


LADDERS = (("quadratic", "interactions", "main"), (PAIRS, LEVELS))
"""Models that are tried in turn where nobody asked for one."""


def _model(
    source: StudySource, factors: Sequence[FactorInfo], points: Points, runs: Sequence[PlannedRun]
) -> tuple[str, dict[str, int], list[str]]:
    """Return the model that the runs determine, its degrees of freedom, and what there is to say of it.

    Raises ProfileError where the model that was asked for needs other runs.
    """
    if source.file.design.kind == SENSITIVITY:
        return SENSITIVITY, {"error": 0}, []
    first = model_of(source, factors, points)
    asked = source.file.analysis.model != "auto"
    ladder = next((one for one in LADDERS if first in one), (first,))
    models = (first,) if asked else ladder[ladder.index(first) :]
    settings, blocks = [run.settings for run in runs], [run.block for run in runs]
    lost: list[str] = []
    dof: dict[str, int] = {}
    for model in models:
        terms = terms_of(model, factors, blocks=len(set(blocks)) > 1)
        dof, lost = degrees_of_freedom(terms, factors, settings, blocks, as_levels=model in AS_LEVELS)
        is_fraction = source.file.design.kind == "fractional" and model == "interactions" and not asked
        # Products that leave nothing for the error test nothing.
        wants_error = (model == PAIRS or is_fraction) and dof["error"] < 1
        if not lost and dof["error"] >= 0 and not wants_error:
            skipped = (
                [] if model == first else [f"the runs do not determine a {first} model; {model} is fitted"]
            )
            if dof["error"] == 0:
                skipped.append(
                    "no degrees of freedom are left for the error: F needs replicates, or terms that are pooled"
                )
            return model, dof, skipped
    if asked:
        message = f"the runs do not determine the {first} model: {', '.join(lost)}"
        raise ProfileError(
            (
                source.refusal(
                    ("analysis", "model"), message, "take a simpler model, more levels or more runs"
                ),
            )
        )
    note = f"the runs determine no model of all factors: not {', '.join(lost)}"
    return models[-1], dof, [note]


def _refuse_mixed(source: StudySource, factors: Sequence[FactorInfo], runs: Sequence[PlannedRun]) -> None:
    """Raise ProfileError where no run tells a factor's effect from that of the blocks."""
    own = [run for run in runs if run.kind is RunKind.DESIGN]
    blocks = [run.block for run in own]
    if len(set(blocks)) < 2 or source.file.design.kind == SENSITIVITY:
        return
    terms = terms_of(LEVELS, factors, blocks=True)
    _, lost = degrees_of_freedom(terms, factors, [run.settings for run in own], blocks, as_levels=False)
    mixed = [factor for factor in factors if factor.name in lost]
    if mixed and len(own) > len(set(blocks)) + len(factors):
        what = "tools" if source.file.machine is not None and source.file.machine.holes_per_tool else "blocks"
        message = f"{mixed[0].name} cannot be told from the {what}: its values change with them alone"
        key: KeyPath = ("machine", "holes_per_tool") if what == "tools" else ("design", "blocks")
        raise ProfileError((source.refusal(key, message, "take fewer or larger blocks, or replicates"),))


def _adapted(factors: Sequence[FactorInfo], profile: Profile) -> list[str]:
    """What the supervisor moves during a run, although the study varies it."""
    keys = {factor.key for factor in factors}
    notes = []
    if profile.adaptive.seek_reference and "servo.reference" in keys:
        notes.append(
            "adaptive.seek_reference finds the reference during a run: servo.reference tells nothing of it"
        )
    if profile.jump.mode == "adaptive" and "jump.mode" not in keys:
        moved = ["jump.period_s"]
        moved += (
            ["servo.reference"]
            if profile.adaptive.reference_step and not profile.adaptive.seek_reference
            else []
        )
        moved += ["pulse.duty"] if profile.adaptive.duty_step else []
        if varied := [key for key in moved if key in keys]:
            notes.append(
                f"{', '.join(varied)}: a run begins there, and the supervisor moves it where arcs or shorts ask for "
                'it (jump.mode = "adaptive"); set = ["jump.mode=\'fixed\'"] holds it'
            )
    return notes


def _notes(source: StudySource, points: Points, runs: Sequence[PlannedRun]) -> list[str]:
    notes = []
    rows, distinct = len(points.settings), len(set(map(settings_key, points.settings)))
    if distinct < rows and source.file.design.kind != SENSITIVITY:
        again = (
            "a virtual machine would make them alike, so each machine makes them once; replicates make them anew"
            if source.file.machine is None and source.file.design.seeds != "run"
            else "they are replicates of one point"
        )
        notes.append(f"{rows} points have {distinct} different settings: {again}")
    if source.file.machine is None and len({run.seed for run in runs}) == 1:
        notes.append(
            "one machine (seed) in all: what its sensor errs by stands in every run alike, and may follow the time "
            "that a run takes; replicates would show it"
        )
    design, machine = source.file.design, source.file.machine
    centers = sum(run.kind is RunKind.CENTER for run in runs)
    if machine is not None and machine.center_runs and machine.holes_per_tool and 2 * centers >= len(runs):
        notes.append(
            f"{centers} of {len(runs)} holes are centre runs, which open and close the holes of each tool: a higher "
            "holes_per_tool, or center_runs = false, makes fewer"
        )
    if machine is None and design.seeds != "run" and design.center_points > design.blocks:
        notes.append(
            "a virtual machine makes the same run twice alike: a centre point is made once a machine; replicates, "
            'blocks or seeds = "run" make more that differ'
        )
    optimize = source.file.optimize
    if source.file.objectives and "runs" in optimize.model_fields_set and optimize.runs < 2 * len(runs):
        left = max(0, optimize.runs - len(runs))
        notes.append(
            f"[optimize] runs = {optimize.runs} leaves {left} suggestions after the {len(runs)} runs of the design: "
            "a search needs about as many as the design"
        )
    if any(one.name.startswith(TRUTH) for one in source.file.responses):
        notes.append("truth.* is what the virtual machine knows: no real machine answers it")
    return notes
