"""The command that goes on with a study, as messages name it: it works as it stands there."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import pytest

from edmctl.app import main
from edmctl.errors import RunFileError, UsageError
from edmctl.jobs.plan import MachineAddress
from edmctl.study.folder import create_folder
from edmctl.study.planning import plan_study
from edmctl.study.rows import MACHINE, PAUSED
from edmctl.study.running import bare_row, refuse_mixture
from edmctl.study.study_file import read_study
from edmctl.study.table import way_on, what_next
from tests.study.studies import SMALL, made, written

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from edmctl.study.folder import StudyFolder

PORT = "sim:my bench.h5"
ON = "--port 'sim:my bench.h5'"


def begun(folder: Path, numbers: Sequence[int], tool: int = 1) -> StudyFolder:
    """A study on a machine of which some runs are made."""
    study = made(folder, SMALL + "\n[machine]\nholes_per_tool = 4\n")
    with study.writer() as writer:
        writer.append(MACHINE, {"port": PORT})
        for number in numbers:
            run = study.read().run(number).planned
            writer.run(replace(bare_row(run, 1, None, datetime.now(UTC)), tool=tool))
    return study


def test_the_machine_of_a_study_is_named(tmp_path: Path) -> None:
    study = begun(tmp_path, [1, 2])
    assert way_on(study.read()) == f"edmctl study resume {study.path} {ON}"
    assert f"`{way_on(study.read())}`" in " ".join(what_next(study.read()))
    (study.runs).mkdir()
    (study.runs / "run0003.journal").touch()  # a hole that was begun
    assert "--new-tool" not in way_on(study.read())


def test_a_tool_that_is_done_is_changed_first(tmp_path: Path) -> None:
    study = begun(tmp_path, [1, 2, 3, 4])
    (told,) = [line for line in what_next(study.read(), "optimize") if "to make" in line]
    assert "with another tool" in told
    assert f"`edmctl study optimize {study.path} {ON} --new-tool`" in told


def test_a_worn_tool_is_changed_until_another_one_was_used(tmp_path: Path) -> None:
    study = begun(tmp_path, [1, 2])
    with study.writer() as writer:
        writer.append(PAUSED, {"number": 3, "why": "E8043: worn", "worn_tool": 1})
    assert way_on(study.read()).endswith(" --new-tool")
    with study.writer() as writer:
        writer.run(replace(bare_row(study.read().run(3).planned, 1, None, datetime.now(UTC)), tool=2))
    assert "--new-tool" not in way_on(study.read())


def test_the_command_that_was_called_is_named_again(tmp_path: Path) -> None:
    study = begun(tmp_path, [1])
    with pytest.raises(UsageError) as refused:
        refuse_mixture(study.read(), MachineAddress("sim:"), "confirm")
    assert f"`edmctl study confirm {study.path} {ON}`" in refused.value.hint


def test_a_repeated_run_on_a_machine_is_another_hole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = begun(tmp_path, [1])
    assert main(["study", "judge", str(study.path), "1", "repeat", "a chip"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{ON}` makes it again, as another hole" in said
    assert main(["study", "judge", str(study.path), "2", "repeat", "a chip"]) == 2
    assert f"`edmctl study resume {study.path} {ON}`" in capsys.readouterr().err


def test_nothing_is_added_where_runs_cannot_be_made(tmp_path: Path) -> None:
    study = begun(tmp_path, [1, 2, 3, 4])
    assert main(["study", "confirm", str(study.path)]) == 2
    assert not study.read().rows.added


def test_a_folder_says_whether_it_holds_the_same_study(tmp_path: Path) -> None:
    study = made(tmp_path)
    same = plan_study(read_study(written(tmp_path)))
    with pytest.raises(RunFileError, match="this study already") as taken:
        create_folder(study.path, same)
    assert f"Go on with it as `edmctl study status {study.path}` says" in taken.value.hint
    other = plan_study(read_study(written(tmp_path, SMALL.replace("0.7, 0.8", "0.7, 0.82"))))
    with pytest.raises(RunFileError, match="another study, A small study") as taken:
        create_folder(study.path, other)
    assert "resume" not in taken.value.hint
    (study.path / "study.toml").write_text("changed", encoding="utf-8")
    with pytest.raises(RunFileError, match="cannot be read"):
        create_folder(study.path, same)
