"""Every cross-field rule: a value that passes, one that is refused or doubted, and the numbers it says."""

from __future__ import annotations

import re
from dataclasses import dataclass

import pytest

import edmctl
from edmctl.errors import ProfileError
from edmctl.failures import Code
from edmctl.planning.rules.load import load_profile
from edmctl.profile.setup import Controller, Setup
from tests.planning.rules.documents import marked, problems

FEED_TARGET = 'target={kind="feed",feed_um=250}'
THROUGH = 'target={kind="through"}'


@dataclass(frozen=True, slots=True)
class Case:
    """Overrides on cu270 that keep a rule and that break it; the break is blamed on `key`."""

    code: Code
    passing: tuple[str, ...]
    breaking: tuple[str, ...]
    numbers: tuple[str, ...]
    key: str


def case(row: str) -> Case:
    """Return a case; without a key, that of the last override that breaks the rule is blamed."""
    code, both, passing, breaking, numbers, key = (one.strip() for one in f"{row} |".split("|")[:6])
    broken = (*both.split(), *breaking.split())
    kept = (*both.split(), *passing.split())
    return Case(Code[code], kept, broken, (*numbers.split("; "),), key or broken[-1].partition("=")[0])


# rule | overrides of both | one that passes | one that breaks it | numbers of the message | key that is blamed
TABLE = """
PAD_DISTANCE |  | measure.site_dx_um=328 | measure.site_dx_um=327 | 327 µm; 270; 8; 50; 328 µm
REFERENCE_WINDOW |  | servo.reference=0.60 | servo.reference=0.59 | 0.59; 0.60 to 0.95; 0.55
REFERENCE_WINDOW |  | servo.reference=0.95 | servo.reference=0.96 | 0.96; 0.95
REFERENCE_WINDOW |  | servo={reference_v=9.6} | servo={reference_v=6.0} | 6 V; 0.500; 0.60 to 0.95 |
    servo.reference_v
REFERENCE_WINDOW | servo.reference=0.9 | pulse.open_voltage_v=28 | pulse.open_voltage_v=27 | 27 V; 22 V
STROKE |  | target.depth_um=209 | target.depth_um=210 | 210 µm; 50; 292; 15; 357 µm; 356 µm
STROKE | limits.stroke_v_max=150 | target.depth_um=273 | target.depth_um=274 | 274 µm; 445 µm
STROKE |  | target={kind="feed",feed_um=291} | target={kind="feed",feed_um=292} | 292 µm; 357 µm; 356 µm |
    target.feed_um
SLOPE_BELOW_FEED | pulse.current_a=0.5 | servo.forward_um_s=0.9 | servo.forward_um_s=0.8 |
    0.8 µm/s; 1.1 times; 0.73 µm/s
SLOPE_NEAR_FEED |  | servo.forward_um_s=0.9 | servo.forward_um_s=0.8 | 0.8 µm/s; 2.8 times; 0.29 µm/s
LIMIT_CYCLE_LARGE |  | servo.forward_um_s=43 | servo.forward_um_s=45 | ±0.52 µm; 45 µm/s; 11 ms; 0.5 µm
RAMP_ORDER |  | servo.back_um_s=2.5 | servo.back_um_s=2.4 | 2.4 µm/s; 5 µm/s
RAMP_ORDER | servo.short_back_um_s=5 |  | servo.back_um_s=6 | 5 µm/s; 6 µm/s | servo.short_back_um_s
OFFSET |  | approach.offset_um=45 | approach.offset_um=44 | 44 µm; 45 µm; 35 µm; 10 µm
JUMP_TOO_LOW |  | jump.height_um=33 | jump.height_um=32 | 32 µm; 180 µm; 8 µm; 33 µm
JUMP | jump.mode=fixed | jump.height_um=300 | jump.height_um=301 | 301 µm; 300 µm; 0 V
JUMP | jump.mode=fixed jump.speed_um_s=60 | jump.period_s=7 | jump.period_s=6 | 34 %; 60 µm; 20 ms; 6 s; 30 %
PULSE_ENERGY | servo.forward_um_s=10 | pulse.current_a=0.69 | pulse.current_a=0.70 |
    22 V; 0.7 A; 130.4 µs; 2009 µJ; 2000
PULSE_ENERGY | jump.height_um=100 servo.forward_um_s=10 | tool.diameter_um=100 | tool.diameter_um=99 |
    344.3 µJ; 99 µm; 200 µJ | pulse.current_a
PULSE_TIMES | pulse.duty=0.06 | pulse.frequency_hz=12000 servo.reference=0.8 | pulse.frequency_hz=12100 |
    4.96 µs; 5 µs
PULSE_TIMES | pulse.duty=0.50 | pulse.frequency_hz=25000 | pulse.frequency_hz=25100 | 19.9 µs; 20 µs
THROUGH_STROKE | target={kind="through"} work.kind=through | work.thickness_um=112 |
    work.thickness_um=113 | 113 µm; 135 for; offset 50; reserve 15; 357 µm; 356 µm
THROUGH_STROKE | target={kind="through",completion_um=20} work.kind=through | work.thickness_um=195 |
    work.thickness_um=196 | 20 for the worn tip; 357 µm
TARGET_KIND | target={kind="through"} work.thickness_um=50 | work.kind=through |  | 50 µm; "blind" | target.kind
NOT_THROUGH | work.kind=through | target={kind="through"} work.thickness_um=50 |
    target.kind=depth work.thickness_um=100 | a depth of 180 µm; 100 µm | target.kind
ADAPTIVE |  | jump.period_min_s=10 | jump.period_min_s=10.1 | 10.1 s; 10 s
ADAPTIVE |  | adaptive.arc_low=0.049 | adaptive.arc_low=0.05 | 0.05
ADAPTIVE |  | adaptive.short_low=0.02 | adaptive.short_low=0.03 | 0.03
ADAPTIVE |  | adaptive.reference_max=0.80 | adaptive.reference_max=0.79 | 0.79; 0.8
ADAPTIVE |  | adaptive.duty_min=0.30 | adaptive.duty_min=0.31 | 0.31; 0.3
JUMP |  | jump.period_min_s=0.27 | jump.period_min_s=0.26 | 31 %; 0.08 s; 0.26 s; 30 %
TOLERANCE |  | target.tolerance_um=0.58 | target.tolerance_um=0.57 | 0.57 µm; 3 touches; 0.5 µm; 0.58 µm
LESS_THAN_TOLERANCE |  | target.depth_um=2.1 | target.depth_um=2 | 2 µm
NOT_SHOWN |  | target.tolerance_um=1.3 | target.tolerance_um=1 | ± 1.1; 1 µm; exit code 7
FILTER |  | servo.filter_hz=115 | servo.filter_hz=116 | 116 Hz; 115 Hz; 2300 Hz
FEED_REMEASURE | target={kind="feed",feed_um=250} | wear.remeasure=never | wear.remeasure=2 | 250 µm; 2 times
DISCHARGE_TIME | pulse.mode=isopulse | pulse.discharge_us=120 | pulse.discharge_us=121 | 121 µs; 10 µs; 120.4 µs
DISCHARGE_TIME | pulse.mode=isopulse | pulse.discharge_us=50 |  | discharge_us | pulse.mode
DISCHARGE_TIME |  |  | pulse.discharge_us=50 | 50
REFERENCE_ONCE |  | servo={reference_v=9.6} | servo.reference_v=9.6 | 0.8; 9.6 V
TOOL_WEAR |  | tool.max_wear_um=71 | tool.max_wear_um=70 | 70 µm
APPROACH_TRAVEL |  | approach.max_travel_um=51 | approach.max_travel_um=50 | 50 µm
BLIND_DEPTH |  | work.thickness_um=181 | work.thickness_um=180 | 180 µm
TIME_LIMIT |  | limits.max_time_s=1400 | limits.max_time_s=900 | 900 s
UNKNOWN_MATERIAL |  | tool.material=copper | tool.material=cheese | cheese
UNKNOWN_MATERIAL |  | work.material=steel | work.material=cheese | cheese
UNKNOWN_MATERIAL |  | work.material=steel | work.material=W | W
SIM_CONTRADICTS |  | sim.tool_wear=1.2 | sim.tool_wear=0.1 | 0.1
SIM_CONTRADICTS |  | sim.work_removal=0.7 | sim.work_removal=2 | 2
SIM_CONTRADICTS |  |  | pulse.discharge_voltage_v=30 | 30 V
SIM_CONTRADICTS |  |  | sim.discharge_v=30 | 30 V | pulse
BEYOND_LAWS |  | pulse.current_a=1 pulse.frequency_hz=1000 pulse.open_voltage_v=100 servo.reference=0.5 |
    pulse.current_a=2 | 2 A lies outside 0.03 to 1
BEYOND_LAWS |  | pulse.frequency_hz=1000 | pulse.frequency_hz=800 | 375 µs of on-time lies outside 5 to 300 |
    pulse.duty
STATED_CONTRADICTS |  | wear.expected_ratio=0.6 | wear.expected_ratio=0.1 | 0.1
STATED_CONTRADICTS |  |  | work.removal_um3_per_uj=0.5 | 0.5
STATED_CONTRADICTS |  |  | work.material=steel pulse.polarity=tool-positive |  | wear.expected_ratio
"""
CASES = [case(row) for row in TABLE.strip().replace("\n    ", " ").split("\n")]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.code}-{'-'.join(case.breaking)}")
def test_a_rule_passes_refuses_and_says_its_numbers(case: Case) -> None:
    assert case.code not in {d.code for d in problems("cu270", *case.passing)}
    found = next(d for d in problems("cu270", *case.breaking) if d.code == case.code)
    for number in case.numbers:
        assert number in found.message
    assert found.hint
    assert found.is_warning == case.code.startswith("W")
    assert found.where is not None
    line, (table, _, key) = found.where.source_line, case.key.rpartition(".")
    value = line.partition("=")[2].strip().partition(" ")[0]
    assert key in line
    assert marked(found) in (value, key) or line.startswith(f"{table}={{")


@pytest.mark.parametrize(
    ("code", "key", "value", "others"),
    [
        (Code.REFERENCE_WINDOW, "servo.reference", "0.5", ()),
        (Code.STROKE, "target.depth_um", "300", ()),
        (Code.SLOPE_NEAR_FEED, "servo.forward_um_s", "0.5", ()),
        (Code.LIMIT_CYCLE, "servo.forward_um_s", "50", ("servo.filter_hz=4", "servo.back_um_s=50")),
        (Code.LIMIT_CYCLE_LARGE, "servo.forward_um_s", "45", ("servo.back_um_s=50",)),
        (Code.RAMP_ORDER, "servo.back_um_s", "1", ()),
        (Code.OFFSET, "approach.offset_um", "20", ()),
        (Code.JUMP_TOO_LOW, "jump.height_um", "10", ()),
        (Code.JUMP, "jump.height_um", "400", ("jump.mode=fixed",)),
        (Code.JUMP, "jump.period_s", "2", ("jump.speed_um_s=50", "jump.mode=fixed")),
        (Code.JUMP, "jump.period_min_s", "1", ("jump.speed_um_s=400",)),
        (Code.THROUGH_STROKE, "work.thickness_um", "200", (THROUGH, "work.kind=through")),
        (Code.PULSE_TIMES, "pulse.frequency_hz", "40000", ()),
        (Code.TOLERANCE, "target.tolerance_um", "0.1", ("measure.max_sd_um=3",)),
        (Code.FILTER, "servo.filter_hz", "200", ()),
        (Code.NOT_SHOWN, "target.tolerance_um", "1", ()),
        (Code.TOOL_WEAR, "tool.max_wear_um", "10", ()),
        (Code.TIME_LIMIT, "limits.max_time_s", "10", ()),
    ],
)
def test_the_number_in_the_hint_cures_it(code: Code, key: str, value: str, others: tuple[str, ...]) -> None:
    hint = next(d.hint for d in problems("cu270", *others, f"{key}={value}") if d.code == code)
    number = re.search(r"\d+(\.\d+)?", hint)
    assert number is not None
    assert code not in {d.code for d in problems("cu270", *others, f"{key}={number[0]}")}


@pytest.mark.parametrize(
    ("name", "change"),
    [("array-3x3", "target.depth_um=0.02"), ("foil-through", "work.thickness_um=0.05")],
)
def test_millimetres_are_told_of_arrays_and_sheets_too(name: str, change: str) -> None:
    codes = [warning.code for warning in load_profile(name, (change,)).warnings]
    assert Code.LESS_THAN_TOLERANCE in codes
    assert Code.LESS_THAN_TOLERANCE not in [warning.code for warning in load_profile(name).warnings]


def test_every_code_of_a_rule_is_tested_here() -> None:
    elsewhere = {Code.PATH_KEYS, Code.SITES_OR_PATH, Code.SITES, Code.OVERLAP}
    elsewhere |= {Code.ARRAY_WEAR, Code.ARRAY_STROKE, Code.LAYER, Code.REGIMES, Code.NO_REMOVAL}
    elsewhere.add(Code.OUT_OF_REACH)
    tested = {case.code for case in CASES} | {Code.LIMIT_CYCLE, Code.ACTUATOR_VOLTAGE} | elsewhere
    assert tested == {code for code in Code if code[1:3] == "31"}


def slow_loop(period_ms: float) -> Setup:
    return Setup(controller=Controller(servo_period_us=round(1e3 * period_ms), latency=1))


def test_a_ramp_of_20_with_a_loop_of_100_ms_is_refused_with_its_numbers() -> None:
    ramp = ("servo.forward_um_s=20", "servo.back_um_s=20")
    with pytest.raises(ProfileError) as caught:
        load_profile("cu270", ramp, slow_loop(100.0))
    found = caught.value.diagnostics[0]
    assert (found.code, caught.value.exit_code) == (Code.LIMIT_CYCLE, 3)
    for number in ("±3.20 µm", "20 µm/s", "160 ms", "100 ms", "1 µm"):
        assert number in found.message
    assert "3.1 µm/s" in found.hint
    assert problems("cu270", *ramp, setup=slow_loop(1.0)) == ()
    assert problems("cu270", *ramp, "servo.mode=pi", setup=slow_loop(100.0)) == ()


def test_the_voltage_limit_is_the_actuators() -> None:
    (found,) = problems("cu270", setup=Setup.model_validate({"actuator": {"stroke_v": 110.0}}))
    assert found.code == Code.ACTUATOR_VOLTAGE
    assert "120 V" in found.message
    assert "110 V" in found.message


@pytest.mark.parametrize(
    ("name", "volts", "depth_um"),
    [("cu270", 120, 209), ("w252", 120, 279), ("cu270", 150, 273), ("w252", 150, 364)],
)
def test_the_deepest_hole_is_told(name: str, volts: int, depth_um: int) -> None:
    found = problems(name, "target.depth_um=600", f"limits.stroke_v_max={volts}")
    hint = next(d.hint for d in found if d.code == Code.STROKE)
    assert f"at most {depth_um} µm deep" in hint


def test_adaptive_jumps_go_only_as_far_up_as_the_tool_is_down() -> None:
    shallow = ("target.depth_um=20", "limits.max_time_s=1e5")
    assert problems("cu150", *shallow) == ()
    (found,) = problems("cu150", *shallow, "jump.mode=fixed")
    assert found.code == Code.JUMP
    assert found.hint == "use at most 78.5 µm; 6.8 µm are enough to flush"


@pytest.mark.parametrize(
    ("overrides", "codes"),
    [
        (("jump.mode=off", "jump.height_um=5"), []),
        ((FEED_TARGET,), []),
        (("target.depth_um=180", "work.kind=through", "work.thickness_um=400"), [Code.NOT_THROUGH]),
        ((FEED_TARGET, "work.kind=through", "work.thickness_um=400"), [Code.NOT_THROUGH]),
    ],
)
def test_rules_that_need_each_other_agree(overrides: tuple[str, ...], codes: list[Code]) -> None:
    assert [d.code for d in problems("cu270", *overrides)] == codes


def test_pulses_that_remove_nothing_are_refused() -> None:
    isopulse = ('pulse.mode="isopulse"', "pulse.discharge_us=1")
    with pytest.raises(ProfileError, match=r"a pulse of 0\.66 µJ removes nothing") as refused:
        load_profile("cu270", (*isopulse, "pulse.current_a=0.03"))
    assert refused.value.code == Code.NO_REMOVAL
    load_profile("cu270", (*isopulse, "pulse.current_a=0.06"))


@pytest.mark.parametrize("current_a", [1.3, 2.0, 2.9])
def test_a_forecast_beyond_the_laws_stays_within_reason(current_a: float) -> None:
    usual_s = edmctl.forecast("cu270", overrides={"target.depth_um": 8}).time_s
    far_s = edmctl.forecast("cu270", overrides={"target.depth_um": 8, "pulse.current_a": current_a}).time_s
    assert 0.5 < far_s / usual_s < 3.0
