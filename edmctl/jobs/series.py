"""A series of simulated runs in a folder: what was asked for, and a row of each run that is finished.

An interrupted series goes on from its rows: a run that is there is not made again.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.errors import PreconditionError, UsageError
from edmctl.files import user_path
from edmctl.jobs.batch import Task
from edmctl.jobs.plan import SIMULATOR, JobRequest
from edmctl.profile.folders import is_path
from edmctl.record.appended_rows import RowWriter, read_lines
from edmctl.results.declared import result_of
from edmctl.results.simulation import SimulatedRun

ROWS = "series"
"""Folder of the rows, in that of the run files."""
BEGUN, DONE = "series", "run"


@dataclass(frozen=True, slots=True)
class Series:
    """What was asked for: a job, the sweeps of its keys, how many runs each, and the first seed."""

    request: JobRequest
    sweeps: tuple[str, ...]
    runs: int
    first_seed: int


class SeriesRows:
    """The rows of a series in its folder, and the writer that adds to them. A context manager."""

    def __init__(self, folder: Path) -> None:
        self._writer = RowWriter(folder / ROWS)
        self._lines, _ = read_lines(folder / ROWS)

    def begin(self, series: Series) -> None:
        """Write down what was asked for, before the first run."""
        request = {name: _plain(value) for name, value in asdict(series.request).items()}
        profile = series.request.profile
        if profile is not None and is_path(profile):
            request["profile"] = str(user_path(profile).resolve())
        values = {**asdict(series), "request": request, "sweeps": list(series.sweeps)}
        self._writer.append(BEGUN, values)

    def keep(self, task: Task, run: SimulatedRun) -> None:
        """Write down a run that is finished."""
        values = {"run_id": task.run_id, "recipe": task.recipes[0], "run": _without_nan(asdict(run))}
        self._writer.append(DONE, values)

    def finished(self, tasks: Sequence[Task]) -> dict[int, SimulatedRun]:
        """Return the runs of these tasks that are there, by the number of the task.

        Raises PreconditionError E8213 where one was made by another recipe.
        """
        recipes = {task.run_id: task.recipes for task in tasks}
        found: dict[str, SimulatedRun] = {}
        for line in self._lines:
            if line.get("row") != DONE or line.get("run_id") not in recipes:
                continue
            if line.get("recipe") not in recipes[line["run_id"]]:
                raise PreconditionError(
                    f"The recipe of {line['run_id']} is not the one that its series was begun with.",
                    hint="Put profile and setup back as they were, or begin another series in another folder.",
                    code="E8213",
                )
            try:
                found[str(line["run_id"])] = result_of(SimulatedRun, line["run"])
            except (KeyError, TypeError, ValueError):
                continue
        return {number: found[task.run_id] for number, task in enumerate(tasks) if task.run_id in found}

    def refuse_begun(self, folder: Path) -> None:
        """Raise UsageError E2112 where the folder has a series already."""
        if any(line.get("row") == BEGUN for line in self._lines):
            raise UsageError(
                f"{folder} has a series of runs already.",
                hint=f"Go on with it: `edmctl simulate --resume {shlex.quote(str(folder))}`; or choose another "
                "folder with --out.",
                code="E2112",
            )

    def series(self, folder: Path) -> Series:
        """Return what was asked for. Raises UsageError E2111 where the folder has no series."""
        begun = [line for line in self._lines if line.get("row") == BEGUN]
        try:
            last: dict[str, Any] = begun[-1]
            request = JobRequest(**last["request"])
        except (IndexError, KeyError, TypeError):
            raise UsageError(
                f"{folder} has no series of simulated runs.",
                hint="Name the folder that `edmctl simulate … --out DIR` has made.",
                code="E2111",
            ) from None
        setup, calibration = (
            Path(given) if (given := last["request"].get(name)) else None for name in ("setup", "calibration")
        )
        request = replace(
            request,
            overrides=tuple(request.overrides),
            port=SIMULATOR,
            setup=setup,
            calibration=calibration,
        )
        return Series(request, tuple(last["sweeps"]), int(last["runs"]), int(last["first_seed"]))

    def __enter__(self) -> SeriesRows:
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()


def _without_nan(value: Any) -> Any:
    """Plain values to the last digit; JSON has no NaN."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {name: _without_nan(one) for name, one in value.items()}
    return [_without_nan(one) for one in value] if isinstance(value, list | tuple) else value


def _plain(value: object) -> object:
    if isinstance(value, Path):
        return str(value.resolve())
    return list(value) if isinstance(value, tuple) else value
