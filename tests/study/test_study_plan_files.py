"""Plans and rows that are whole by their hashes and wrong: one error, and rows that count for nothing."""

from __future__ import annotations

import copy
import hashlib
import json
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edmctl.csv_text import table_text
from edmctl.errors import EdmError, PreconditionError
from edmctl.study.analysis import analysis_of
from edmctl.study.folder import open_folder
from edmctl.study.report import StudyReport, mapping_of, render_report
from edmctl.study.suggestions import (
    confirmation_runs,
    confirmations_of,
    extension_runs,
    recommended,
    suggestions,
)
from edmctl.study.table import render_plan, render_status, table_of
from tests.study.studies import FULL, SMALL, made
from tests.study.test_study_tables import add, make
from tests.tiers import tiers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    Change = Callable[[dict[str, Any]], object]

LIMITED = SMALL + "\n[[constraints]]\nresponse = 'wear_ratio_lin'\nat_most = 0.9\n"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with rows of its design, of suggestions and of confirmations, which tests put back as it was."""
    twice = LIMITED.replace(FULL, f"{FULL}replicates = 2\n")
    folder = made(tmp_path_factory.mktemp("plan"), twice)
    make(folder)
    add(folder, 2)
    with folder.writer() as writer:
        writer.planned(
            confirmation_runs(folder.read(), folder.plan.runs[0].settings, 2), {"ra_um": (1, 0, 2)}
        )
        writer.told(folder.read().runs[0], {"ra_um": 0.3})
    make(folder)
    return folder.path


def seal(path: Path, study: object) -> None:
    """Write a plan with the hash that fits."""
    body = json.dumps(study, ensure_ascii=False)
    digest = hashlib.sha256(body.encode(errors="surrogatepass")).hexdigest()
    (path / "plan.json").write_text(json.dumps({"sha256": digest, "study": study}), encoding="utf-8")


def used(path: Path) -> None:
    """Do with a folder what every command does that reads it."""
    folder = open_folder(path)
    state = folder.read()
    render_plan(folder.plan)
    render_status(state)
    table_text(table_of(state))
    json.dumps(table_of(state), allow_nan=False)
    analysis = analysis_of(state)
    confirmations = confirmations_of(state)
    report = StudyReport(analysis, state.runs, None, confirmations)
    mapping_of(report)
    render_report(report)
    for ask in (recommended, lambda one: suggestions(one, 1), extension_runs):
        with suppress(EdmError):
            ask(state)


def first_run(study: dict[str, Any]) -> dict[str, Any]:
    run: dict[str, Any] = study["plan"]["runs"][0]
    return run


WRONG: dict[str, Change] = {
    "no plan": lambda study: study.pop("plan"),
    "no files": lambda study: study.update(sha256={}),
    "another file": lambda study: study["sha256"].update({"../../secret": "0" * 64}),
    "another schema": lambda study: study.update(schema="edmctl-study/1"),
    "a recipe without a number": lambda study: study.update(recipes={"one": ["a", "b"]}),
    "no factors": lambda study: study["plan"].update(factors=[]),
    "factors without values": lambda study: study["plan"]["factors"][0].update(values=[]),
    "a factor of another name": lambda study: study["plan"]["factors"][0].update(name="other"),
    "a logarithmic factor below zero": lambda study: study["plan"]["factors"][0].update(
        is_log=True, values=[-1.0, 1.0]
    ),
    "an unknown model": lambda study: study["plan"].update(model="cubic"),
    "no runs": lambda study: study["plan"].update(runs=[]),
    "a run twice": lambda study: study["plan"]["runs"].append(first_run(study)),
    "an unknown kind": lambda study: first_run(study).update(kind="other"),
    "a suggestion in the plan": lambda study: first_run(study).update(kind="suggested"),
    "a run without a setting": lambda study: first_run(study).update(settings={}),
    "a setting beyond the factor": lambda study: first_run(study)["settings"].update({"pulse.duty": 9.0}),
    "a negative seed": lambda study: first_run(study).update(seed=-1),
    "an endless seed": lambda study: first_run(study).update(seed=10**400),
    "a constraint without a side": lambda study: study["plan"]["constraints"][0].update(sign=0),
    "a response by no hand": lambda study: study["plan"]["responses"][2].update(is_manual=False),
    "a note as number": lambda study: study["plan"].update(notes=[1]),
    "points that are not there": lambda study: study["plan"].update(points=99),
    "no replicate": lambda study: study["plan"].update(replicates=0),
}


@contextmanager
def changed(file: Path) -> Iterator[Path]:
    """A file that is as it was afterwards."""
    kept = file.read_bytes()
    try:
        yield file
    finally:
        file.write_bytes(kept)


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_plan_is_one_error(whole: Path, name: str) -> None:
    with changed(whole / "plan.json") as file:
        study = json.loads(file.read_bytes())["study"]
        WRONG[name](study)
        seal(whole, study)
        with pytest.raises(PreconditionError, match=r"is not a plan of this version of edmctl") as refused:
            open_folder(whole)
    assert refused.value.code == "E8202"
    assert "plan the study into a new folder" in refused.value.hint


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"sha256": 1, "study": 2}', "[" * 100_000, "NaN"])
def test_a_plan_without_its_hash_was_changed(whole: Path, text: str) -> None:
    with changed(whole / "plan.json") as file:
        file.write_text(text)
        with pytest.raises(PreconditionError, match="not what it was") as refused:
            open_folder(whole)
    assert refused.value.code == "E8202"


NUMBERS = (0, -1, 1.5, 1e308, -1e308, float("nan"), float("inf"), 10**30, 10**400)
TEXTS = ("", "design", "0.2", "\x1b[2J", "\ud800", "../..")
HOSTILE: st.SearchStrategy[Any] = st.sampled_from([None, True, *NUMBERS, *TEXTS, [], [1], [[]], {}, {"a": 1}])


def paths_of(value: object, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The place of every value in a document."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(place for key, one in inside for place in paths_of(one, (*path, key)))]


def mutated(document: Any, data: st.DataObject) -> Any:
    """A document with one to three values replaced, taken out or doubled."""
    document = copy.deepcopy(document)
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(paths_of(document)[1:] or [()]))
        if not path:
            return data.draw(HOSTILE)
        parent = document
        for key in path[:-1]:
            parent = parent[key]
        what = data.draw(st.sampled_from(["replace", "remove", "double"]))
        if what == "replace":
            parent[path[-1]] = copy.deepcopy(data.draw(HOSTILE))
        elif what == "remove":
            del parent[path[-1]]
        elif isinstance(parent, list):
            parent.append(parent[path[-1]])
        else:
            parent[f"{path[-1]}_"] = parent[path[-1]]
    return document


@pytest.mark.parametrize("examples", tiers(5, slow=[150]))
@pytest.mark.parametrize("part", ["plan", "row"])
def test_no_change_of_a_file_is_an_internal_error(whole: Path, part: str, examples: int) -> None:
    change = change_plan if part == "plan" else change_row

    @settings(max_examples=examples, deadline=None, derandomize=True)
    @given(data=st.data())
    def tried(data: st.DataObject) -> None:
        change(whole, data)

    tried()


def change_plan(whole: Path, data: st.DataObject) -> None:
    with changed(whole / "plan.json") as file:
        seal(whole, mutated(json.loads(file.read_bytes())["study"], data))
        with suppress(EdmError):
            used(whole)


def change_row(whole: Path, data: st.DataObject) -> None:
    with changed(data.draw(st.sampled_from(sorted((whole / "rows").glob("*.jsonl"))))) as file:
        lines = file.read_bytes().splitlines(keepends=True)
        number = data.draw(st.integers(0, len(lines) - 1))
        lines[number] = json.dumps(mutated(json.loads(lines[number]), data)).encode() + b"\n"
        file.write_bytes(b"".join(lines))
        with suppress(EdmError):
            used(whole)
