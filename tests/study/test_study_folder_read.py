"""Every command that reads the folder of a study, given what is no file in it: a message, soon."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from edmctl.study.folder import StudyFolder
from tests.cli.commands import Here
from tests.cli.test_files_read import made
from tests.study import studies
from tests.tiers import tiers

FILES = ("plan.json", "study.toml", "profile.toml", "rows/0.jsonl", "rows/suggestions.lock")
LOCKING = ("suggest DIR --add", "extend DIR", "confirm DIR --workers 1")
"""Commands that take the lock of suggestions; the others do not look at it."""
STUDY_READERS = (
    *LOCKING,
    *("status DIR", "report DIR", "export DIR", "suggest DIR"),
    *("resume DIR --workers 1", "optimize DIR --workers 1"),
    *("tell DIR 1 ra_um=0.3", "import DIR ra.csv", "judge DIR 1 reject why"),
)
TABLE_READERS = ("plan FILE", "run FILE --out other", "import DIR FILE", "plan points.toml")


def put(folder: Path, file: str, name: str) -> None:
    """Replace a file of a study by a link to what has this name."""
    place = folder / file
    place.unlink(missing_ok=True)
    place.symlink_to(Path(name).absolute())


def write_names(name: str) -> None:
    """Write the files that commands name beside the study's folder."""
    points = studies.SMALL.replace('kind = "full"', f'kind = "csv"\nfile = "{name}"')
    Path("ra.csv").write_text("run,ra_um\n1,0.3\n", encoding="utf-8")
    Path("study.toml").write_text(studies.SMALL, encoding="utf-8")
    Path("points.toml").write_text(points, encoding="utf-8")


@pytest.mark.parametrize("kind", tiers("pipe", "vanished", slow=("endless", "folder", "long")))
@pytest.mark.parametrize("file", FILES)
def test_what_is_no_file_in_a_study_is_refused(here: Here, whole: StudyFolder, file: str, kind: str) -> None:
    shutil.copytree(whole.path, "DIR")
    write_names("ra.csv")
    put(Path("DIR"), file, made(kind))
    is_lock = file.endswith(".lock")
    if is_lock and kind in ("vanished", "long"):
        return  # a lock that is not there is made
    for reader in LOCKING if is_lock else STUDY_READERS:
        said = here("study", *reader.split())
        assert said.exit_code in {2, 3, 8, 9}, (reader, said.out, said.err)
        assert "error[E" in said.err, (reader, said.err)
        assert "Internal" not in said.err


@pytest.mark.parametrize("kind", tiers("pipe", "vanished", slow=("endless", "folder", "long")))
@pytest.mark.parametrize("reader", TABLE_READERS)
def test_what_is_no_file_beside_a_study_is_refused(
    here: Here, whole: StudyFolder, reader: str, kind: str
) -> None:
    shutil.copytree(whole.path, "DIR")
    name = made(kind)
    write_names(name)
    said = here("study", *(name if word == "FILE" else word for word in reader.split()))
    assert said.exit_code in {2, 3, 8, 9}, (said.out, said.err)
    assert "error[E" in said.err, said.err
    assert "Internal" not in said.err
