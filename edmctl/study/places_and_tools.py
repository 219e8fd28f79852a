"""What a study on a machine that lasts needs of it: places for its holes, tools and what they lose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from edmctl.errors import Diagnostic, ProfileError
from edmctl.profile.findings import PAD_MARGIN_UM, WALL_UM
from edmctl.study.results import PlannedRun
from edmctl.wording import length, plural

if TYPE_CHECKING:
    from edmctl.jobs.plan import Plan
    from edmctl.study.study_file import StudyMachine, StudySource


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
    """Raise ProfileError where a tool would wear too short, or the grid has no room."""
    machine = source.file.machine
    if machine is None:
        return
    some = next(iter(checked.values()))
    profile = some.loaded.profile
    wrong: list[Diagnostic] = []
    if profile.sites or profile.path is not None:
        message = "a run of a study on a machine is one hole, and the profile has sites or a path of its own"
        wrong.append(source.refusal(("study", "profile"), message, "name a profile of one hole"))
    per_tool = machine.holes_per_tool
    if per_tool is not None and machine.center_runs and per_tool < 3:
        message = f"{per_tool} holes a tool leave none beside the centre runs that open and close a block"
        wrong.append(
            source.refusal(("machine", "holes_per_tool"), message, "take 3 or more, or center_runs = false")
        )
    for tool, wear_um in wear_by_tool(runs, checked).items():
        limit_um = profile.tool.max_wear_um
        if wear_um > limit_um:
            message = (
                f"tool {tool} would lose {length(wear_um)} in all, and tool.max_wear_um is {length(limit_um)}"
            )
            hint = "set holes_per_tool lower, or make the holes shallower"
            wrong.append(source.refusal(("machine", "holes_per_tool"), message, hint))
            break
    places, needed = machine.columns * machine.rows, len(runs)
    if places < needed:
        message = f"the grid has {plural(places, 'place')} for {plural(needed, 'run')}"
        wrong.append(source.refusal(("machine", "columns"), message, "set columns or rows higher"))
    radius_um = max(
        one.loaded.profile.tool.diameter_um / 2 + one.loaded.profile.work.side_gap_um
        for one in checked.values()
    )
    least_um = 2 * radius_um + WALL_UM
    pitches = [("pitch_x_um", machine.columns), ("pitch_y_um", machine.rows)]
    for name, count in pitches:
        if count > 1 and abs(getattr(machine, name)) < least_um:
            message = (
                f"holes of {length(2 * radius_um)} {getattr(machine, name):g} µm apart run into each other"
            )
            wrong.append(
                source.refusal(("machine", name), message, f"set it to {math.ceil(least_um)} or more")
            )
    clear_um = 2 * radius_um + PAD_MARGIN_UM
    stage = some.setup.stage
    for x_um, y_um in grid_of(machine)[: len(runs)]:
        if math.hypot(x_um - stage.reference_x_um, y_um - stage.reference_y_um) < clear_um:
            message = f"the place at {x_um:g}, {y_um:g} µm lies on the reference pad"
            wrong.append(
                source.refusal(
                    ("machine", "first_x_um"), message, f"keep {math.ceil(clear_um)} µm away from it"
                )
            )
            break
    if wrong:
        raise ProfileError(tuple(wrong))
