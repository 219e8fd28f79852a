"""Finding, extending and overriding profiles."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edmctl.errors import ProfileError, UsageError
from edmctl.failures import Code
from edmctl.planning.rules.load import _sha256, load_profile
from edmctl.profile.folders import shipped_profiles, shipped_studies
from edmctl.profile.model import ProfileFile, profile_schema
from edmctl.profile.read import changes, extend
from edmctl.profile.setup import load_setup
from edmctl.profile.tables import field_at
from edmctl.simulator.config import DischargeConstants
from edmctl.study.planning import base_request
from edmctl.study.study_file import read_study
from tests.planning.rules.documents import copy_shipped, loaded, problems, shipped_text


@pytest.mark.parametrize("name", shipped_profiles())
def test_shipped_profiles_load_without_a_warning(name: str) -> None:
    assert problems(name) == ()


def test_a_bare_word_is_a_shipped_profile_and_a_path_must_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    assert found.code == Code.EXTENDS
    assert found.where is not None
    assert found.where.line == 1
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


def test_the_text_is_kept_verbatim(tmp_path: Path) -> None:
    text = shipped_text("cu270").replace("\n", "\r\n")
    path = tmp_path / "crlf.toml"
    path.write_bytes(text.encode())
    assert load_profile(str(path)).text == text


def test_extends_inherits_and_lists_what_it_overrides() -> None:
    w = load_profile("w252")
    assert w.profile.pulse == load_profile("cu270").profile.pulse
    assert w.profile.wear.max_cuts == 5
    assert 'tool.material = "W" (was "Cu", w252.toml)' in w.overrides
    assert "target.depth_um = 240.0 (was 180.0, w252.toml)" in w.overrides


def test_values_that_are_removed_are_listed_in_the_order_of_the_file() -> None:
    before: dict[str, object] = {"target": {f"key_{number}": number for number in range(20)}}
    removed = [f"target.key_{number} removed (was {number}, --set)" for number in range(20)]
    assert list(changes(before, {}, "--set")) == removed


def test_an_override_lists_old_and_new_value_and_keeps_the_rest() -> None:
    p = loaded("servo.reference=0.82", "log.pulses=full")
    assert p.profile.servo.reference == 0.82
    assert p.profile.log.pulses == "full"
    assert p.overrides == (
        "servo.reference = 0.82 (was 0.8, --set)",
        'log.pulses = "full" (was "blocks", --set)',
    )


def test_the_latest_override_of_a_key_holds() -> None:
    assert loaded("servo.reference=0.82", "servo.reference=0.85").profile.servo.reference == 0.85


def test_a_table_as_override_replaces_the_table() -> None:
    target = loaded('target={kind="feed",feed_um=250}').profile.target
    assert target.kind == "feed"
    assert target.feed_um == 250.0


def test_an_inherited_target_of_another_kind_is_replaced_whole(tmp_path: Path) -> None:
    copy_shipped(tmp_path)
    child = tmp_path / "child.toml"
    child.write_text('extends = "cu270"\n[target]\nkind = "feed"\nfeed_um = 200\n', encoding="utf-8")
    target = load_profile(str(child)).profile.target
    assert target.kind == "feed"


def test_the_hash_is_of_the_recipe_in_effect_and_the_simulators_apart() -> None:
    plain, same = loaded(), loaded("servo.reference=0.8")
    assert plain.sha256 == same.sha256
    assert loaded("servo.reference=0.81").sha256 != plain.sha256
    bench = loaded("sim.tool_wear=0.4")
    assert bench.sha256 == plain.sha256
    assert bench.sim_sha256 != plain.sim_sha256
    # Runs, series and studies of earlier versions continue, whichever controller they stated.
    assert loaded("sim.controller='python'").sim_sha256 == plain.sim_sha256
    stated = _sha256(plain.sim)
    assert stated != plain.sim_sha256
    assert (plain.sha256, stated) in loaded("sim.controller='firmware'").recipes
    assert loaded("sim.controller='firmware-float'").sim_sha256 != plain.sim_sha256


def test_a_reference_in_volts_becomes_a_share() -> None:
    text = shipped_text("cu270")
    servo = loaded("servo={reference_v=9.6}").profile.servo
    assert servo.reference == pytest.approx(0.80)
    assert servo.reference_v is None
    assert "reference = 0.80" in text


def test_a_time_limit_not_given_is_three_forecasts() -> None:
    p = loaded("limits={stroke_v_max=120}")
    assert 3 * 870 < p.profile.limits.max_time_s < 3 * 1300


@pytest.mark.parametrize(("voltage_v", "gap_um"), [(40.0, 3.2), (80.0, 6.9), (30.0, 2.37)])
def test_a_working_gap_not_given_goes_by_the_pulses(voltage_v: float, gap_um: float) -> None:
    p = load_profile("cu270", (f"pulse.open_voltage_v={voltage_v:g}",)).profile
    assert p.measure.expected_gap_um == pytest.approx(gap_um, abs=0.1)
    stated = load_profile(
        "cu270", (f"pulse.open_voltage_v={voltage_v:g}", "measure.expected_gap_um=5")
    ).profile
    assert stated.measure.expected_gap_um == 5.0


def test_what_materials_and_pulses_let_expect_is_stated_or_filled_in() -> None:
    p = load_profile("cu270").profile
    assert 0.038 < p.work.removal_um3_per_uj < 0.044
    assert p.work.side_gap_um == pytest.approx(8.0)
    assert (p.work.removal_u_rel, p.wear.ratio_u_rel) == (0.10, 0.10)
    steel = load_profile("cu270", ("work.material=steel",)).profile
    assert steel.work.removal_um3_per_uj == pytest.approx(0.8 * p.work.removal_um3_per_uj, rel=0.1)
    assert steel.work.removal_u_rel > 0.3  # assumed, and said to be
    unknown = load_profile("cu270", ("work.material=cheese",)).profile
    assert unknown.work.removal_u_rel > steel.work.removal_u_rel
    stated = load_profile("cu270", ("work.removal_um3_per_uj=0.05", "work.side_gap_um=9")).profile
    assert (stated.work.removal_um3_per_uj, stated.work.side_gap_um) == (0.05, 9.0)


def test_a_wear_ratio_not_given_follows_from_tool_work_and_polarity(tmp_path: Path) -> None:
    text = shipped_text("cu270")
    path = tmp_path / "open.toml"
    path.write_text("".join(line for line in text.splitlines(keepends=True) if "expected_ratio" not in line))
    ratios = [
        load_profile(str(path), overrides).profile.wear.expected_ratio
        for overrides in (
            ("target.depth_um=60",),
            ("target.depth_um=60", "tool.material=W"),
            ("target.depth_um=60", "pulse.polarity=tool-positive"),
        )
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
    assert first.code == code
    assert first.where is not None
    assert (first.where.file, first.where.line, first.where.column) == ("--set", 1, column)
    assert first.where.source_line == override


def test_all_wrong_keys_are_reported_at_once(tmp_path: Path) -> None:
    text = shipped_text("cu270").replace("duty = 0.30", "duty = 0.99").replace('kind = "blind"', "kind = 3")
    text = text.replace("touches = 3", "touchs = 3")
    path = tmp_path / "p.toml"
    path.write_text(text, encoding="utf-8")
    found = problems(path)
    assert [d.code for d in found] == [Code.NOT_A_CHOICE, Code.OUT_OF_RANGE, Code.UNKNOWN_KEY]
    assert found[1].hint == "write a number from 0.05 to 0.85 (on-time over period)"
    assert found[2].hint == "did you mean touches?"


def test_all_violated_rules_are_reported_at_once() -> None:
    codes = {
        d.code
        for d in problems("cu270", "servo.reference=0.5", "target.depth_um=250", "approach.offset_um=40")
    }
    assert codes == {Code.REFERENCE_WINDOW, Code.STROKE, Code.OFFSET}


@pytest.mark.parametrize(
    ("overrides", "codes"),
    [
        (("servo.refrence=1", "target.depth_um=320"), [Code.UNKNOWN_KEY, Code.STROKE]),
        (("pulse.duty=0.99", "target.depth_um=320"), [Code.OUT_OF_RANGE, Code.STROKE]),
        (("pulse.duty=0.99", "approach.offset_um=44"), [Code.OUT_OF_RANGE, Code.OFFSET]),
        (("pulse=3", "approach.offset_um=44"), [Code.WRONG_TYPE, Code.OFFSET]),
        (("target.kind=deep", "approach.offset_um=44"), [Code.NOT_A_CHOICE, Code.OFFSET]),
        (("tool.colour=red", "servo.reference_v=9.6"), [Code.UNKNOWN_KEY, Code.REFERENCE_ONCE]),
        (("servo.reference_v=9.6", "approach.offset_um=44"), [Code.OFFSET, Code.REFERENCE_ONCE]),
    ],
)
def test_wrong_keys_and_violated_rules_are_reported_together(
    overrides: tuple[str, ...], codes: list[Code]
) -> None:
    assert sorted(d.code for d in problems("cu270", *overrides)) == sorted(codes)


@pytest.mark.parametrize(
    "override",
    [
        "target.depth_um=-1",
        "servo.reference=2",
        "servo={refrence=0.5}",
        "servo={reference_v=500}",
        "tool.diameter_um=1",
        'target={kind="feed",feed=9999}',
        "limits={stroke_v_maxi=20}",
    ],
)
def test_a_rule_says_nothing_of_a_value_that_could_not_be_read(override: str) -> None:
    assert {d.code[:3] for d in problems("cu270", override)} == {"E30"}


@pytest.mark.parametrize("override", ["jump.period_max_s=1.5", "log.waveforms=off"])
def test_keys_without_an_effect_are_unknown(override: str) -> None:
    assert [d.code for d in problems("cu270", override)] == [Code.UNKNOWN_KEY]


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ("tool", "free_length_um"),
    ],
)
def test_keys_that_are_only_recorded_say_so(table: str, key: str) -> None:
    found = field_at(ProfileFile, (table, key))
    assert found is not None
    assert "recorded, not acted on" in (found.description or "")


def test_a_key_in_the_wrong_table_is_sent_home() -> None:
    assert problems("cu270", "tool.duty=0.3")[0].hint == "duty belongs to [pulse]"


def test_a_key_of_the_other_kind_of_target_is_told_so() -> None:
    first = problems("cu270", 'target={kind="feed",feed_um=250,depth_um=1}')[0]
    assert first.code == Code.UNKNOWN_KEY
    assert "this kind of target" in first.hint


def test_a_syntax_error_has_its_line_and_column(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text('[meta]\nname = "x"\nduty = = 3\n', encoding="utf-8")
    (found,) = problems(path)
    assert found.code == Code.SYNTAX
    assert found.where is not None
    assert (found.where.file, found.where.line, found.where.column) == (str(path), 3, 8)
    assert found.where.source_line == "duty = = 3"


@pytest.mark.parametrize(("written", "meant"), [("0,18", "0.18"), (" -5,0 # comment", "-5.0")])
def test_a_decimal_comma_is_named(tmp_path: Path, written: str, meant: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'extends = "cu270"\n[target]\ndepth_um ={written}\n', encoding="utf-8")
    (in_file,) = problems(path)
    (on_line,) = problems("cu270", f"target.depth_um={written}")
    assert in_file.hint == on_line.hint == f"a number has a decimal point, not a comma: {meant}"


def test_a_text_that_ends_too_soon_is_located_at_its_end(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text("[meta]\nname = [1,", encoding="utf-8")
    (found,) = problems(path)
    assert found.where is not None
    assert (found.where.line, found.where.column) == (2, 11)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_bytes(b"name = \xff")
    assert problems(path)[0].code == Code.UNREADABLE


def test_profiles_that_extend_in_a_circle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('extends = "b.toml"\n', encoding="utf-8")
    (tmp_path / "b.toml").write_text('# b\nextends = "a.toml"\n', encoding="utf-8")
    (found,) = problems(tmp_path / "a.toml")
    assert found.code == Code.EXTENDS
    assert "a.toml -> b.toml -> a.toml" in found.message
    assert found.where is not None
    assert (Path(found.where.file).name, found.where.line, found.where.column) == ("b.toml", 2, 11)


@pytest.mark.parametrize("value", ['"gone.toml"', "3"])
def test_a_parent_that_is_not_there_is_located(tmp_path: Path, value: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f"extends = {value}\n", encoding="utf-8")
    (found,) = problems(path)
    assert found.code == Code.EXTENDS
    assert found.where is not None
    assert found.where.column == 11


def test_setup_has_defaults_and_its_errors_have_places(tmp_path: Path) -> None:
    assert load_setup().actuator.gain_um_per_v == 2.967
    path = tmp_path / "setup.toml"
    path.write_text("[controller]\nservo_period_us = 2000\n", encoding="utf-8")
    assert load_setup(path).controller.servo_period_s == pytest.approx(2e-3)
    path.write_text("[controller]\nservo_period_us = 1\n", encoding="utf-8")
    with pytest.raises(ProfileError) as caught:
        load_setup(path)
    assert caught.value.where is not None
    assert (caught.value.where.line, caught.value.where.column) == (2, 19)


@pytest.mark.parametrize(
    ("line", "code", "hint"),
    [
        ("servo_period_us = 1500", Code.NOT_A_MULTIPLE, "a multiple of 1000"),
        ("servo_period_us = 1500", Code.NOT_A_MULTIPLE, "the controller ticks every 1000 µs"),
        ("servo_period_us = 0", Code.OUT_OF_RANGE, "from 1000"),
        ("telemetry_hz = 1001.0", Code.OUT_OF_RANGE, "to 1000"),
    ],
)
def test_the_setup_cannot_ask_for_more_than_the_controllers_tick(
    tmp_path: Path, line: str, code: Code, hint: str
) -> None:
    path = tmp_path / "setup.toml"
    path.write_text(f"[controller]\n{line}\n", encoding="utf-8")
    with pytest.raises(ProfileError) as caught:
        load_setup(path)
    assert caught.value.code == code
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
            found = field_at(ProfileFile, (table, key))
            if found is not None and found.annotation is float:
                assert found.metadata, f"{table}.{key}"
                assert found.description, f"{table}.{key}"


def test_loading_a_profile_needs_no_numpy() -> None:
    load = "from edmctl.planning.rules.load import load_profile; load_profile('cu270')"
    program = f"import sys; {load}; assert 'numpy' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True)


tables = st.recursive(
    st.integers(), lambda inner: st.dictionaries(st.sampled_from("abc"), inner, max_size=3), max_leaves=8
).filter(lambda t: isinstance(t, dict))


@given(tables, tables)
def test_extending_keeps_all_keys_of_both(base: dict[str, object], child: dict[str, object]) -> None:
    merged = extend(base, child)
    assert merged.keys() == base.keys() | child.keys()
    assert extend(merged, child) == merged
