"""Finding, extending and overriding profiles."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from edmctl.cli.render.diagnostics import render_diagnostics
from edmctl.errors import EdmError, ProfileError, UsageError
from edmctl.failures import Code
from edmctl.planning.rules.load import load_profile
from edmctl.profile.diagnose import MOST_SHOWN
from edmctl.profile.folders import shipped_profiles, shipped_studies
from edmctl.profile.model import FeedTarget, ProfileFile, profile_schema
from edmctl.profile.setup import load_setup
from edmctl.profile.tables import fields_at
from edmctl.simulator.config import DischargeConstants
from edmctl.study.planning import base_request
from edmctl.study.study_file import read_study
from tests.planning.rules.documents import loaded, place_of, problems, shipped_text, written


@pytest.mark.parametrize("name", shipped_profiles())
def test_shipped_profiles_load_without_a_warning(name: str) -> None:
    assert problems(name) == ()


def test_a_path_must_exist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "profiles").mkdir()
    monkeypatch.chdir(tmp_path)
    mine = shipped_text("cu270").replace("diameter_um = 270.0", "diameter_um = 271.0")
    for name in ("cu270.toml", "profiles/cu270.toml", "./cu270", str(tmp_path / "cu270.toml")):
        with pytest.raises(UsageError, match="There is no profile file") as caught:
            load_profile(name)
        assert "Write cu270 for the shipped profile." in caught.value.hint
        path = Path(name)
        path.write_text(mine, encoding="utf-8")
        assert load_profile(name).profile.tool.diameter_um == 271.0
        assert load_profile("cu270").profile.tool.diameter_um == 270.0
        path.unlink()
    Path("mine").write_text(mine, encoding="utf-8")
    with pytest.raises(UsageError, match="There is no shipped profile 'mine'") as caught:
        load_profile("mine")
    assert "Write ./mine for the file of that name." in caught.value.hint


def test_extends_and_profile_of_a_study_follow_the_same_rule(tmp_path: Path) -> None:
    child = tmp_path / "child.toml"
    child.write_text('extends = "cu150.toml"\n[meta]\nname = "p"\n', encoding="utf-8")
    (found,) = problems(child)
    assert (found.code, place_of(found)[1]) == (Code.EXTENDS, 1)
    assert "Write cu150 for the shipped profile." in found.hint
    study = tmp_path / "study.toml"
    study.write_text(shipped_studies()["taguchi-l9"].read_text(encoding="utf-8"), encoding="utf-8")
    assert base_request(read_study(study)).profile == "cu270"
    text = study.read_text(encoding="utf-8").replace('profile = "cu270"', 'profile = "./cu270"')
    study.write_text(text, encoding="utf-8")
    assert base_request(read_study(study)).profile == str(tmp_path / "cu270")


def test_an_unknown_name_is_a_usage_error_that_names_the_shipped_ones() -> None:
    with pytest.raises(UsageError) as caught:
        load_profile("cu27")
    assert caught.value.exit_code == 2
    assert "Did you mean cu270?" in caught.value.hint
    assert "w252" in caught.value.hint


def test_the_text_is_kept_verbatim_and_must_be_one(tmp_path: Path) -> None:
    text = shipped_text("cu270").replace("\n", "\r\n")
    path = tmp_path / "crlf.toml"
    path.write_bytes(text.encode())
    assert load_profile(str(path)).text == text
    path.write_bytes(b"name = \xff")
    assert problems(path)[0].code == Code.UNREADABLE


def test_extends_inherits_and_lists_what_it_overrides() -> None:
    w = load_profile("w252")
    assert w.profile.pulse == load_profile("cu270").profile.pulse
    assert w.profile.wear.max_cuts == 5
    assert 'tool.material = "W" (was "Cu", w252.toml)' in w.overrides
    assert "target.depth_um = 240.0 (was 180.0, w252.toml)" in w.overrides


def test_an_override_lists_old_and_new_value_and_keeps_the_rest() -> None:
    p = loaded("servo.reference=0.82", "log.pulses=full")
    assert p.profile.servo.reference == 0.82
    assert p.profile.log.pulses == "full"
    assert p.overrides == (
        "servo.reference = 0.82 (was 0.8, --set)",
        'log.pulses = "full" (was "blocks", --set)',
    )
    assert loaded("servo.reference=0.82", "servo.reference=0.85").profile.servo.reference == 0.85


def test_a_table_as_override_and_a_target_of_another_kind_replace_the_table(tmp_path: Path) -> None:
    child = written(tmp_path, 'extends = "cu270"\n[target]\nkind = "feed"\nfeed_um = 250\n')
    for profile in (loaded('target={kind="feed",feed_um=250}'), load_profile(str(child))):
        assert profile.profile.target == FeedTarget(kind="feed", feed_um=250.0)


def test_the_hash_is_of_the_recipe_in_effect_and_the_simulators_apart() -> None:
    plain, same = loaded(), loaded("servo.reference=0.8")
    assert plain.sha256 == same.sha256
    assert loaded("servo.reference=0.81").sha256 != plain.sha256
    bench = loaded("sim.tool_wear=0.4")
    assert bench.sha256 == plain.sha256
    assert bench.sim_sha256 != plain.sim_sha256
    assert loaded("sim.controller='firmware-float'").sim_sha256 != plain.sim_sha256


def test_a_reference_in_volts_becomes_a_share() -> None:
    servo = loaded("servo={reference_v=9.6}").profile.servo
    assert servo.reference == pytest.approx(0.80)
    assert servo.reference_v is None


@pytest.mark.parametrize(("voltage_v", "gap_um"), [(40.0, 3.2), (80.0, 6.9), (30.0, 2.37)])
def test_a_working_gap_not_given_goes_by_the_pulses(voltage_v: float, gap_um: float) -> None:
    pulses = f"pulse.open_voltage_v={voltage_v:g}"
    assert loaded(pulses).profile.measure.expected_gap_um == pytest.approx(gap_um, abs=0.1)
    assert loaded(pulses, "measure.expected_gap_um=5").profile.measure.expected_gap_um == 5.0


def test_what_materials_and_pulses_let_expect_is_stated_or_filled_in() -> None:
    p = loaded().profile
    assert 0.038 < p.work.removal_um3_per_uj < 0.044
    assert p.work.side_gap_um == pytest.approx(8.0)
    assert (p.work.removal_u_rel, p.wear.ratio_u_rel) == (0.10, 0.10)
    steel, unknown = loaded("work.material=steel").profile.work, loaded("work.material=cheese").profile.work
    assert steel.removal_um3_per_uj == pytest.approx(0.8 * p.work.removal_um3_per_uj, rel=0.1)
    assert unknown.removal_u_rel > steel.removal_u_rel > 0.3  # assumed, and said to be
    stated = loaded("work.removal_um3_per_uj=0.05", "work.side_gap_um=9").profile.work
    assert (stated.removal_um3_per_uj, stated.side_gap_um) == (0.05, 9.0)


def test_a_wear_ratio_not_given_follows_from_tool_work_and_polarity(tmp_path: Path) -> None:
    lines = shipped_text("cu270").splitlines(keepends=True)
    path = str(written(tmp_path, "".join(line for line in lines if "expected_ratio" not in line)))
    ratios = [
        load_profile(path, ("target.depth_um=60", *change)).profile.wear.expected_ratio
        for change in ((), ("tool.material=W",), ("pulse.polarity=tool-positive",))
    ]
    assert ratios[0] == pytest.approx(0.389, rel=0.05)
    assert ratios[1] == pytest.approx(0.106 * ratios[0], rel=0.15)
    assert ratios[2] > 2.0 * ratios[0]  # short pulses wear a positive tool


@pytest.mark.parametrize(
    ("override", "code", "column"),
    [
        ("servo.reference=2", Code.OUT_OF_RANGE, 17),
        ("servo.refrence=0.8", Code.UNKNOWN_KEY, 7),
        ("servo.mode = fuzzy", Code.NOT_A_CHOICE, 14),
        ("target.depth_um=300", Code.STROKE, 17),
        ("servo", Code.OVERRIDE, 1),
        ("meta.name.x=1", Code.OVERRIDE, 1),
        ("a=1\nb=2", Code.OVERRIDE, 1),
        ("servo.reference=.8", Code.OVERRIDE, 1),
        ("=1", Code.OVERRIDE, 1),
    ],
)
def test_a_wrong_override_is_located_on_the_command_line(override: str, code: Code, column: int) -> None:
    first = problems("cu270", "log.pulses=off", override)[0]
    assert (first.code, place_of(first)) == (code, ("--set", 1, column))
    assert first.where is not None
    assert first.where.source_line == override


def test_all_wrong_keys_are_reported_at_once(tmp_path: Path) -> None:
    text = shipped_text("cu270").replace("duty = 0.30", "duty = 0.99").replace('kind = "blind"', "kind = 3")
    found = problems(written(tmp_path, text.replace("touches = 3", "touchs = 3")))
    assert [d.code for d in found] == [Code.NOT_A_CHOICE, Code.OUT_OF_RANGE, Code.UNKNOWN_KEY]
    assert found[1].hint == "write a number from 0.05 to 0.85 (on-time over period)"
    assert found[2].hint == "did you mean touches?"


def test_all_violated_rules_are_reported_together_once_every_value_can_be_read() -> None:
    wrong = ("servo.reference=0.5", "target.depth_um=250", "approach.offset_um=40")
    assert sorted(d.code for d in problems("cu270", *wrong)) == [
        Code.REFERENCE_WINDOW,
        Code.STROKE,
        Code.OFFSET,
    ]
    assert [d.code for d in problems("cu270", *wrong, "tool.colour=red")] == [Code.UNKNOWN_KEY]
    assert [d.code for d in problems("cu270", *wrong, "servo.reference_v=9.6")] == [Code.REFERENCE_ONCE]


@pytest.mark.parametrize(
    ("override", "hint"),
    [
        ("jump.period_max_s=1.5", "period_min_s"),
        ("log.waveforms=off", "remove it"),
        ("tool.duty=0.3", "duty belongs to [pulse]"),
        ('target={kind="feed",feed_um=250,depth_um=1}', "this kind of target"),
    ],
)
def test_keys_without_an_effect_are_unknown(override: str, hint: str) -> None:
    (found,) = problems("cu270", override)
    assert found.code == Code.UNKNOWN_KEY
    assert hint in found.hint


@pytest.mark.parametrize(
    ("text", "line", "column", "code"),
    [
        ('[meta]\nname = "x"\nduty = = 3\n', 3, 8, Code.SYNTAX),
        ("[meta]\nname = [1,", 2, 11, Code.SYNTAX),
        ('extends = "gone.toml"\n', 1, 11, Code.EXTENDS),
        ("extends = 3\n", 1, 11, Code.EXTENDS),
    ],
)
def test_errors_of_files_are_located(tmp_path: Path, text: str, line: int, column: int, code: Code) -> None:
    path = written(tmp_path, text)
    (found,) = problems(path)
    assert (found.code, place_of(found)) == (code, ("p.toml", line, column))
    assert found.where is not None
    assert found.where.file == str(path)
    assert found.where.source_line == text.split("\n")[line - 1]


def test_profiles_that_extend_in_a_circle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('extends = "b.toml"\n', encoding="utf-8")
    (tmp_path / "b.toml").write_text('# b\nextends = "a.toml"\n', encoding="utf-8")
    (found,) = problems(tmp_path / "a.toml")
    assert (found.code, place_of(found)) == (Code.EXTENDS, ("b.toml", 2, 11))
    assert "a.toml -> b.toml -> a.toml" in found.message


@pytest.mark.parametrize(
    ("table", "line", "code", "hint"),
    [
        ("controller", "servo_period_us = 1500", Code.NOT_A_MULTIPLE, "a multiple of 1000"),
        ("controller", "servo_period_us = 1500", Code.NOT_A_MULTIPLE, "the controller ticks every 1000 µs"),
        ("controller", "servo_period_us = 0", Code.OUT_OF_RANGE, "from 1000"),
        ("controller", "telemetry_hz = 1001.0", Code.OUT_OF_RANGE, "to 1000"),
        ("actuator", "slew_v_s = 50.0", Code.OUT_OF_RANGE, "at most 50 V/s"),
    ],
)
def test_a_wrong_value_of_a_setup_is_pointed_at(
    tmp_path: Path, table: str, line: str, code: Code, hint: str
) -> None:
    with pytest.raises(ProfileError) as caught:
        load_setup(written(tmp_path, f"[{table}]\n{line}\n"))
    assert (caught.value.code, place_of(caught.value)[1:]) == (code, (2, line.index("=") + 3))
    assert hint in caught.value.hint


def test_the_simulators_constants_keep_their_names_and_values() -> None:
    bench, sim = DischargeConstants(), load_profile("cu270").sim
    for part in (bench, bench.erosion, bench.gap):
        named = {name: getattr(part, name) for name in part.__slots__ if name not in {"erosion", "gap"}}
        assert {name: getattr(sim, name) for name in named} == named


def test_the_schema_describes_every_table_and_extends() -> None:
    schema = profile_schema()
    assert {"meta", "servo", "target", "sim", "extends"} <= schema["properties"].keys()
    assert schema["$defs"]["Pulse"]["properties"]["duty"]["maximum"] == 0.85
    assert "schema" in schema["$defs"]["Meta"]["properties"]


def test_every_number_of_a_profile_has_limits_and_a_description() -> None:
    for table, info in ProfileFile.model_fields.items():
        for key in getattr(info.annotation, "model_fields", {}):
            for field in fields_at(ProfileFile, (table, key)):
                assert field.annotation is not float or (field.metadata and field.description), (
                    f"{table}.{key}"
                )


def test_loading_a_profile_needs_no_numpy() -> None:
    load = "from edmctl.planning.rules.load import load_profile; load_profile('cu270')"
    program = f"import sys; {load}; assert 'numpy' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True)


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
def test_hostile_values_are_refused(override: str, tmp_path: Path) -> None:
    key, _, value = override.partition("=")
    table, _, key = key.partition(".")
    for name, overrides in (
        ("cu270", [override]),
        (str(written(tmp_path, f'extends = "cu270"\n[{table}]\n{key} = {value}\n')), []),
    ):
        with pytest.raises(ProfileError):
            load_profile(name, overrides)


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


@pytest.mark.parametrize("name", ["x" * 5000, "a\x00b"])
def test_a_name_that_no_file_can_have_is_no_profile(name: str, tmp_path: Path) -> None:
    with pytest.raises(EdmError):
        load_profile(name)


def test_a_long_chain_of_profiles_is_refused(tmp_path: Path) -> None:
    for number in range(25):
        (tmp_path / f"p{number}.toml").write_text(f'extends = "p{number + 1}.toml"\n', encoding="utf-8")
    with pytest.raises(ProfileError, match="more than 20"):
        load_profile(str(tmp_path / "p0.toml"))


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
    with pytest.raises(ProfileError) as refused:
        load_profile(str(written(tmp_path, f'extends = "cu270"\n{HOSTILE[name]}')))
    assert len(refused.value.diagnostics) <= MOST_SHOWN + 1
    assert len(render_diagnostics(refused.value.diagnostics)) < 100_000
