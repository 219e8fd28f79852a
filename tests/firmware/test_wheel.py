"""What an installed edmctl has of the firmware: its sources, and nothing of the emulator."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path

import pytest

from edmctl.core.build import is_whole

ROOT = Path(__file__).parents[2]
SOURCE = "edmctl/core/source/"
EMULATOR = "sim"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def _sources() -> Iterable[str]:
    """Sources in the tree, by their names in a wheel."""
    folder = ROOT / "firmware"
    for path in folder.rglob("*"):
        inside = path.relative_to(folder)
        if path.suffix in (".c", ".h", ".ld") and inside.parts[0] != EMULATOR:
            yield SOURCE + inside.as_posix()


@pytest.mark.slow
@pytest.mark.needs("hatchling")
def test_a_wheel_has_every_source_and_no_emulator(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    core = [name for name in names if name.startswith("edmctl/core/_core-")]
    zipfile.ZipFile(wheel).extractall(tmp_path, core)
    (library,) = (tmp_path / name for name in core if not name.endswith(".sha256"))
    assert is_whole(library)
    assert sorted(set(_sources()) - set(names)) == []
    assert [name for name in names if EMULATOR in Path(name).parts] == []
    assert [name for name in names if "unicorn" in zipfile.ZipFile(wheel).read(name).decode("latin-1")] == [
        name for name in names if name.endswith(("board/emulated.py", ".dist-info/METADATA"))
    ]


def test_all_that_stands_beside_the_emulator_is_packed() -> None:
    packed = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    firmware = {Path(name).parts[1] for name in packed if Path(name).parts[0] == "firmware"}
    there = {path.name for path in (ROOT / "firmware").iterdir() if not path.name.startswith((".", "_"))}
    assert firmware == there - {EMULATOR}


def test_unicorn_comes_with_the_emulator_alone() -> None:
    extras = PROJECT["project"]["optional-dependencies"]
    packages = {"": PROJECT["project"]["dependencies"], **extras}
    asks = [extra for extra, names in packages.items() if any(re.match(r"unicorn\b", n) for n in names)]
    assert asks == ["emulator"]
