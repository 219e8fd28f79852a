"""Input that nobody means: told as a mistake of the file, never as a bug."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from edmctl.cli.render.diagnostics import render_diagnostics
from edmctl.errors import EdmError, ProfileError
from edmctl.planning.rules.load import load_profile
from edmctl.profile.diagnose import MOST_SHOWN
from edmctl.profile.setup import load_setup

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    "override",
    [
        'meta.name="a\\u0000b"',
        'tool.material="Cu\\u001b"',
        f"tool.diameter_um={'9' * 5000}",
        f"tool.diameter_um={'9' * 400}",
        f"tool.diameter_um=0x{'f' * 300}",
        f"measure.touches=-{'9' * 309}",
        f"tool.diameter_um={'[' * 2000}",
        f"{'.'.join('a' * 3000)}=1",
    ],
)
def test_hostile_overrides_are_refused(override: str) -> None:
    with pytest.raises(ProfileError):
        load_profile("cu270", [override])


@pytest.mark.parametrize(
    ("override", "code"),
    [
        ("pulse.open_voltage_v=20", "E3101"),
        ("pulse.discharge_voltage_v=40", "E3101"),
        ("pulse.discharge_voltage_v=39.9", "E3101"),
        ("work.removal_um3_per_uj=1e-320", "E3005"),
        ("target.depth_um=5e-324", "E3005"),
    ],
)
def test_values_that_no_rule_could_calculate_with_are_named(override: str, code: str) -> None:
    with pytest.raises(ProfileError) as refused:
        load_profile("cu270", [override])
    assert [one.code for one in refused.value.diagnostics] == [code]


@pytest.mark.parametrize("value", ["9" * 5000, "9" * 400, "[" * 2000])
def test_hostile_values_in_a_file_are_refused(value: str, tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'extends = "cu270"\n[target]\ndepth_um = {value}\n', encoding="utf-8")
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


HOSTILE = {
    "tables": "".join(f"[t{i}]\nx = 1\n" for i in range(5000)),
    "nested tables": "".join(f"[{'.'.join(['a'] * (i + 1))}]\n" for i in range(40)),
    "keys": "[servo]\n" + "".join(f"k{i} = 1\n" for i in range(200_000)),
    "parts": f"{'.'.join('a' * 20_000)} = 1\n",
    "parts of a header": f"[{'.'.join('a' * 20_000)}]\n",
    "quoted parts": f"""{".".join(['"a"'] * 20_000)} = 1\n""",
    "inline": f"x = {'{a = ' * 900}1{'}' * 900}\n",
    "brackets": f"x = {'[' * 5000}{']' * 5000}\n",
    "text": f'[meta]\nname = "{"x" * 1_900_000}"\n',
    "key": f"{'x' * 1_900_000} = 1\n",
    "places": '[[sites]]\nkind = "point"\nx_um = 1\n' * 60_000,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_more_than_anybody_writes_is_refused_in_few_words(name: str, tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'extends = "cu270"\n{HOSTILE[name]}', encoding="utf-8")
    with pytest.raises(ProfileError) as refused:
        load_profile(str(path))
    assert len(refused.value.diagnostics) <= MOST_SHOWN + 1
    assert len(render_diagnostics(refused.value.diagnostics)) < 100_000
