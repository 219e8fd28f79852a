"""Input that nobody means: told as a mistake of the file, never as a bug."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.errors import EdmError, ProfileError
from edmctl.profile import load_profile
from edmctl.profile.load import load_setup
from tests.profile.documents import shipped_text

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    "override",
    [
        'meta.name="a\\u0000b"',
        'tool.material="Cu\\u001b"',
        f"tool.diameter_um={'9' * 5000}",
        f"tool.diameter_um={'[' * 2000}",
        f"{'.'.join('a' * 3000)}=1",
    ],
)
def test_hostile_overrides_are_refused(override: str) -> None:
    with pytest.raises(ProfileError):
        load_profile("cu270", [override])


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 2000])
def test_hostile_values_in_a_file_are_refused(value: str, tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f"x = {value}\n{shipped_text('cu270')}", encoding="utf-8")
    with pytest.raises(ProfileError):
        load_profile(str(path))


@pytest.mark.parametrize("name", ["x" * 5000, "a\x00b"])
def test_a_name_that_no_file_can_have_is_no_profile(name: str, tmp_path: Path) -> None:
    with pytest.raises(EdmError):
        load_profile(name)


def test_a_long_chain_of_profiles_is_refused(tmp_path: Path) -> None:
    for number in range(25):
        (tmp_path / f"p{number}.toml").write_text(f'extends = "p{number + 1}.toml"\n', encoding="utf-8")
    with pytest.raises(ProfileError, match="more than 20"):
        load_profile(str(tmp_path / "p0.toml"))


def test_conditioning_is_not_faster_than_the_actuator(tmp_path: Path) -> None:
    path = tmp_path / "setup.toml"
    path.write_text("[actuator]\nslew_v_s = 50.0\n", encoding="utf-8")
    with pytest.raises(ProfileError, match="60 V/s"):
        load_setup(path)
