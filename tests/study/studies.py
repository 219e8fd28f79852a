"""Small studies whose holes take a tenth of a second."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path

from edmctl.dataclasses import replace
from edmctl.study.folder import StudyFolder, StudyState, create_folder
from edmctl.study.planning import plan_study
from edmctl.study.results import PlannedRun, RunState
from edmctl.study.running import bare_row, evaluate, task_of
from edmctl.study.study_file import read_study
from edmctl.study.table import OF_EXECUTION, table_of

HURRIED = """
set = [
    "target.depth_um=5", "jump.mode='off'", "log.pulses='off'", "approach.speed_um_s=5", "measure.fast_um_s=50",
    "measure.settle_s=0.2", "measure.dwell_s=0.1", "wear.remeasure='never'",
]
"""
HEAD = f"""
[study]
name = "A small study"
profile = "cu270"
{HURRIED}
"""
TWO_FACTORS = """
[[factors]]
key = "servo.reference"
name = "reference"
levels = [0.7, 0.8]

[[factors]]
key = "pulse.duty"
name = "duty"
levels = [0.2, 0.4]
"""
THREE_FACTORS = f"""{TWO_FACTORS}
[[factors]]
key = "pulse.frequency_hz"
name = "frequency"
levels = [1500, 3100]
"""
RANGES = TWO_FACTORS.replace("levels = [0.7, 0.8]", "low = 0.7\nhigh = 0.8").replace(
    "levels = [0.2, 0.4]", "low = 0.2\nhigh = 0.4"
)
RESPONSES = """
[[responses]]
name = "machining_time_s"
log = true

[[responses]]
name = "wear_ratio_lin"

[[responses]]
name = "ra_um"
source = "manual"
unit = "µm"

[[objectives]]
response = "machining_time_s"
"""
FULL = """
[design]
kind = "full"
"""
SMALL = HEAD + TWO_FACTORS + FULL + RESPONSES
MACHINE = SMALL + "\n[machine]\nholes_per_tool = 4\n"
TIME = "[[responses]]\nname = 'machining_time_s'\n"


class Unseen:
    """Watches nothing."""

    def runs(self, done: int, total: int) -> None:
        """Ignore it."""

    def note(self, text: str) -> None:
        """Ignore it."""

    def progress(self, p: object) -> None:
        """Ignore it."""


def written(folder: Path, text: str = SMALL) -> Path:
    """Write a study file."""
    file = folder / "study.toml"
    file.write_text(text, encoding="utf-8")
    return file


def made(folder: Path, text: str = SMALL) -> StudyFolder:
    """Plan a study into a folder of its own."""
    return create_folder(folder / "made", plan_study(read_study(written(folder, text))))


def make_some(study: StudyFolder, *numbers: int) -> None:
    """Make some of the open runs."""
    with study.writer() as writer:
        for run in study.read().runs:
            if run.planned.number in numbers and run.state is RunState.OPEN:
                writer.run(evaluate(task_of(study, run)))


def come_to(folder: StudyFolder, law: Callable[[PlannedRun], Mapping[str, float | None]]) -> None:
    """Write the rows of the open runs by a law of their responses."""
    with folder.writer() as writer:
        for run in folder.read().runs:
            if run.row is None:
                row = bare_row(run.planned, 1, run.planned.seed, datetime.now(UTC))
                writer.run(replace(row, responses=law(run.planned)))


def outcome(state: StudyState) -> list[dict[str, object]]:
    """The table without time and computer."""
    return [
        {name: value for name, value in row.items() if name not in OF_EXECUTION} for row in table_of(state)
    ]
