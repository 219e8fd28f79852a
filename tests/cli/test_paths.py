"""Paths of users: `~` everywhere, a name or a file without doubt, and which file is used."""

from __future__ import annotations

import math
import os
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, get_args

import pytest
from pydantic import BaseModel

from edmctl import api
from edmctl.app import command_tree
from edmctl.core.build import cache_folder
from edmctl.errors import ProfileError, UsageError
from edmctl.failures import Code
from edmctl.files import read_bytes, user_path
from edmctl.jobs.connect import secret_for
from edmctl.jobs.plan import MachineAddress, where_is
from edmctl.jobs.runs.opening import find_run
from edmctl.planning.rules.load import load_profile
from edmctl.profile.folders import data_folder, find_kept, shipped_folder
from edmctl.profile.model import ProfileFile
from edmctl.profile.setup import Setup, load_setup
from edmctl.profile.tables import NAMES_FILE
from edmctl.study.design import factors_of, points_of
from edmctl.study.planning import base_request
from edmctl.study.study_file import StudyFile, read_study
from tests.cli.commands import ROOT, Here

NAME_OR_FILE = {"profile", "profiles", "file", "resume", "port", "what", "address"}
"""Parameters whose texts are names as well: the command that takes one decides which."""


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home folder of its own, and an empty folder to work in."""
    folder = tmp_path / "me"
    (tmp_path / "work").mkdir()
    folder.mkdir()
    monkeypatch.setenv("HOME", str(folder))
    monkeypatch.setenv("USERPROFILE", str(folder))
    monkeypatch.chdir(tmp_path / "work")
    return folder


def commands(tree: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command and group, with the words that call it."""
    yield words, tree
    for name, inner in getattr(tree, "commands", {}).items():
        yield from commands(inner, (*words, name))


def test_every_path_on_the_command_line_is_read_by_one_function() -> None:
    wrong = []
    for words, command in commands(command_tree()):
        for parameter in command.params:
            reads = getattr(parameter.type, "func", None)
            names_file = re.search(r"FILE|DIR|FOLDER|PATH|PAGE|\.csv", parameter.metavar or "")
            if type(parameter.type).__name__ == "Path" or (
                names_file and reads is not user_path and parameter.name not in NAME_OR_FILE
            ):
                wrong.append(f"{' '.join(words)} {parameter.name}")
    assert wrong == []


def fields(model: type[BaseModel]) -> Iterator[tuple[str, Any, str]]:
    """Every field of a model and of the tables in it: name, annotation with its metadata, description."""
    for name, info in model.model_fields.items():
        annotation = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
        yield f"{model.__name__}.{name}", annotation, info.description or ""
        for inner in tables(info.annotation):
            yield from fields(inner)


def tables(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for argument in get_args(annotation) for table in tables(argument)]


def has(annotation: Any, kind: Any) -> bool:
    return annotation == kind or any(has(argument, kind) for argument in get_args(annotation))


def test_every_key_that_names_a_file_has_the_type_for_it() -> None:
    named, wrong = set(), []
    for model in (ProfileFile, Setup, StudyFile):
        for name, annotation, description in fields(model):
            if has(annotation, NAMES_FILE):
                named.add(name)
            elif has(annotation, Path) or (
                has(annotation, str) and re.search(r"\bfile\b|relative to", description)
            ):
                wrong.append(name)
    assert wrong == ["Meta.description"]  # the title of a run file
    assert named == {
        "FileSites.path",
        "Actuator.calibration",
        "Drift.file",
        "Link.secret_file",
        "StudyTable.profile",
        "StudyTable.setup",
        "Design.file",
    }


def test_the_home_folder_is_expanded_in_every_key(home: Path, tmp_path: Path) -> None:
    setup = tmp_path / "setup.toml"
    setup.write_text(
        'port = "sim:~/bench"\n[actuator]\ncalibration = "~/c.toml"\n[drift]\nfile = "d.toml"\n'
        '[link]\nsecret_file = "~/s"\n',
        encoding="utf-8",
    )
    read = load_setup(setup)
    assert read.actuator.calibration == str(home / "c.toml")
    assert read.drift.file == str(tmp_path / "d.toml")
    assert read.link.secret_file == str(home / "s")
    assert MachineAddress(read.port or "").bench_file == home / "bench"
    assert where_is("~/shop", read).selector == str(home / "shop")
    (home / "points.csv").write_text("tool.diameter_um\n100\n200\n", encoding="utf-8")
    (home / "mine.toml").write_text('extends = "cu270"\n', encoding="utf-8")
    study = tmp_path / "study.toml"
    study.write_text(
        '[study]\nname = "s"\nprofile = "~/mine.toml"\nsetup = "~/setup.toml"\n'
        '[[factors]]\nkey = "tool.diameter_um"\nlevels = [100.0, 200.0]\n'
        '[design]\nkind = "csv"\nfile = "~/points.csv"\n[[responses]]\nname = "time_s"\n',
        encoding="utf-8",
    )
    source = read_study(study)
    assert base_request(source).profile == str(home / "mine.toml")
    assert base_request(source).setup == home / "setup.toml"
    assert len(points_of(source, factors_of(source)).settings) == 2
    (home / "places.csv").write_text("x_um,y_um\n600,0\n", encoding="utf-8")
    array = tmp_path / "array.toml"
    array.write_text(
        'extends = "~/mine.toml"\n[target]\nkind = "depth"\ndepth_um = 20.0\n'
        '[[sites]]\nkind = "file"\npath = "~/places.csv"\n',
        encoding="utf-8",
    )
    assert load_profile(str(array)).places[0].x_um == 600.0


VARIABLES: dict[str, Callable[[dict[str, str]], object]] = {
    "EDMCTL_HOME": data_folder,
    "EDMCTL_CALIBRATION": lambda environ: find_kept("calibration", environ, None, None),
    "EDMCTL_DRIFT": lambda environ: find_kept("drift", environ, None, None),
    "EDMCTL_FIRMWARE_CACHE": cache_folder,
    "EDMCTL_SECRET_FILE": lambda environ: secret_for(["socket://h:1"], None, environ),
}


def test_the_home_folder_is_expanded_in_every_variable(home: Path) -> None:
    (home / "x").write_bytes(b"s" * 64)
    (home / "x").chmod(0o600)
    for name, read in VARIABLES.items():
        assert read({name: "~/x"}) in [home / "x", b"s" * 64], name
    sources = {path: path.read_text(encoding="utf-8") for path in (ROOT / "edmctl").rglob("*.py")}
    declared = [name for text in sources.values() for name in re.findall(r'_VARIABLE = "(EDMCTL_\w+)"', text)]
    assert set(declared) == {*VARIABLES, "EDMCTL_SETUP"}  # an option's, and of studies on a machine
    # No second way to read a variable, or to expand one.
    reads = re.compile(r"environ(?:\.get\(|\[)\s*(?:\"EDMCTL|(?!ZIG)\w+_VARIABLE)")
    assert [path.name for path, text in sources.items() if reads.search(text)] == []
    assert [path.name for path, text in sources.items() if "expanduser" in text] == ["files.py"]


@pytest.mark.parametrize(
    ("words", "code"),
    [
        *(
            (f"{command} ''", "E2007")
            for command in ("run recover", "run show", "run export", "study status")
        ),
        *((f"run recover {folder}", "E9005") for folder in (".", "/", "..")),
        ("machine --profile cu270 --dry-run --out=~nosuchuser/runs", "E2007"),
    ],
)
def test_a_path_that_names_no_file_is_refused(words: str, code: str, here: Here) -> None:
    said = here(*shlex.split(words))
    assert (said.exit_code, said.err.split()[0]) == (int(code[1]), f"error[{code}]:")
    assert "~" not in words or "./~nosuchuser/runs" in said.err


def test_a_path_has_no_zero_and_a_tilde_inside_is_a_letter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match=r"U\+0000"):
        user_path("a\0b")
    assert user_path("a~b/~") == Path("a~b/~")
    for wait_s in (math.nan, -1.0):
        with pytest.raises(UsageError, match="no length of time"):
            where_is("/dev/ttyACM0", Setup(), wait_s)
    # A file of the kernel that would let its reader wait, such as /proc/kmsg, is empty.
    reader, writer = os.pipe2(os.O_NONBLOCK)
    monkeypatch.setattr("edmctl.files.open_descriptor", lambda path, flags: reader)
    assert read_bytes(tmp_path) == b""
    os.close(writer)


@pytest.mark.parametrize("name", ["~nosuchuser/c.toml", "x" * 300])
def test_a_key_with_an_impossible_path_is_refused_with_its_place(name: str, tmp_path: Path) -> None:
    setup = tmp_path / "setup.toml"
    setup.write_text(f'[actuator]\ncalibration = "{name}"\n', encoding="utf-8")
    array = tmp_path / "array.toml"
    array.write_text(f'extends = "cu150"\n[[sites]]\nkind = "file"\npath = "{name}"\n', encoding="utf-8")
    for read, line in ((lambda: load_setup(setup), 2), (lambda: load_profile(str(array)), 4)):
        with pytest.raises(ProfileError) as caught:
            read()
        assert caught.value.code == Code.UNREADABLE
        assert caught.value.where is not None
        assert caught.value.where.line == line


def test_the_python_interface_expands_the_home_folder(home: Path) -> None:
    assert api._path("~/c.toml") == home / "c.toml"
    assert api._files("files", "~/a.csv") == (home / "a.csv",)
    (home / "mine.toml").write_text('extends = "cu150"\n', encoding="utf-8")
    assert api.load_profile("~/mine.toml").path == home / "mine.toml"
    with pytest.raises(UsageError, match="There is no profile file"):
        api.load_profile(Path("cu270"))  # a Path is never a name


def test_every_run_reports_which_file_it_uses(here: Here, tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text('extends = "cu270"\n', encoding="utf-8")
    for command in (["machine"], ["approach"], ["simulate", "--runs", "1"], ["jump-flush", "--count", "3"]):
        said = here(*command, "--profile", str(mine), "--dry-run", "--json")
        assert f"profile: {mine}\n" in said.err
        assert said.document["files"] == {"profile": str(mine)}
        assert (
            "profile: cu270 (shipped with edmctl)\n" in here(*command, "--profile", "cu270", "--dry-run").err
        )
    said = here("study", "plan", "taguchi-l9", "--json")
    assert "study: taguchi-l9 (shipped with edmctl)\nprofile: cu270 (shipped with edmctl)\n" in said.err
    assert Path(said.document["files"]["profile"]) == shipped_folder() / "cu270.toml"


def test_a_bare_word_is_the_id_of_a_run_and_a_name_with_an_ending_a_file(tmp_path: Path, home: Path) -> None:
    Path("runs").mkdir()
    for path in (Path("runs/a.h5"), Path("a"), Path("b.h5.partial")):
        path.write_bytes(b"")
    assert find_run(Path("a")) == Path("runs/a.h5")
    assert find_run(Path("a.h5")) == Path("a.h5")  # no such file: opening it reports that
    assert find_run(Path("b.h5")) == Path("b.h5.partial")
    assert find_run(Path("runs/a")) == Path("runs/a.h5")
    assert find_run(Path("c")) == Path("c")
