"""`edmctl firmware build`, and jobs on virtual machines that the firmware's core drives."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.cli.commands import SHALLOW

if TYPE_CHECKING:
    from tests.cli.commands import Here

JOB = ("machine", *SHALLOW, "--seed", "1", "--json")

pytestmark = pytest.mark.skipif(
    not any(shutil.which(name) for name in ("cc", "gcc", "clang")), reason="there is no C compiler"
)


def test_build_says_what_it_used_and_where_the_library_is(here: Here) -> None:
    said = here("firmware", "build", "--real", "double", "--json")
    (made,) = said.document["result"]["builds"]
    assert (said.exit_code, made["real"]) == (0, "double")
    assert Path(made["path"]).is_file()
    assert made["compiler"]


def test_build_refuses_another_arithmetic(here: Here) -> None:
    said = here("firmware", "build", "--real", "half", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (2, "E2048")


def test_the_main_job_comes_out_the_same_under_the_core(here: Here) -> None:
    results = []
    for controller in ("python", "firmware"):
        said = here(*JOB, "--controller", controller, "--out", controller)
        assert said.exit_code == 0, said.err
        assert ("under the controller firmware, seed 1" in said.err) == (controller == "firmware")
        results.append({key: value for key, value in said.document["result"].items() if key != "journal"})
    assert results[0] == results[1]


def test_another_controller_is_refused(here: Here) -> None:
    said = here(*JOB, "--controller", "wood")
    assert said.exit_code == 3
    assert "firmware" in str(said.document["error"])
