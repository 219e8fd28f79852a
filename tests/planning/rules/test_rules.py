"""Every cross-field rule: a value that passes, one that is refused or doubted, and the numbers it says."""

from __future__ import annotations

import re
from dataclasses import dataclass

import pytest

from edmctl.errors import ProfileError
from edmctl.failures import Code
from edmctl.planning.rules.load import load_profile
from edmctl.profile.model import Measure
from edmctl.profile.setup import Controller, Setup
from tests.planning.rules.documents import problems

FEED_TARGET = 'target={kind="feed",feed_um=250}'
THROUGH = 'target={kind="through"}'


@dataclass(frozen=True, slots=True)
class Case:
    """Overrides on cu270 that keep a rule and that break it; the break is blamed on `key`."""

    code: Code
    passing: tuple[str, ...]
    breaking: tuple[str, ...]
    key: str
    numbers: tuple[str, ...]


def case(code: Code, passing: str, breaking: str, numbers: str, key: str = "") -> Case:
    """Return a case of overrides with spaces between and numbers with `; ` between; `key` is the last one broken."""
    broken = breaking.split()
    return Case(
        code, (*passing.split(),), (*broken,), key or broken[-1].partition("=")[0], (*numbers.split("; "),)
    )


CASES = [
    case(Code.PAD_DISTANCE, "measure.site_dx_um=328", "measure.site_dx_um=327", "327 µm; 270; 8; 50; 328 µm"),
    case(Code.REFERENCE_WINDOW, "servo.reference=0.60", "servo.reference=0.59", "0.59; 0.60 to 0.95; 0.55"),
    case(Code.REFERENCE_WINDOW, "servo.reference=0.95", "servo.reference=0.96", "0.96; 0.95"),
    case(
        Code.REFERENCE_WINDOW,
        "servo={reference_v=9.6}",
        "servo={reference_v=6.0}",
        "6 V; 0.500; 0.60 to 0.95",
        "servo.reference_v",
    ),
    case(
        Code.REFERENCE_WINDOW,
        "pulse.open_voltage_v=28 servo.reference=0.9",
        "pulse.open_voltage_v=27 servo.reference=0.9",
        "27 V; 22 V",
        "pulse.open_voltage_v",
    ),
    case(Code.STROKE, "target.depth_um=209", "target.depth_um=210", "210 µm; 50; 292; 15; 357 µm; 356 µm"),
    case(
        Code.STROKE,
        "target.depth_um=273 limits.stroke_v_max=150",
        "target.depth_um=274 limits.stroke_v_max=150",
        "274 µm; 445 µm",
        "target.depth_um",
    ),
    case(
        Code.STROKE,
        'target={kind="feed",feed_um=291}',
        'target={kind="feed",feed_um=292}',
        "292 µm; 357 µm; 356 µm",
        "target.feed_um",
    ),
    case(
        Code.SLOPE_BELOW_FEED,
        "pulse.current_a=0.5 servo.forward_um_s=0.9",
        "pulse.current_a=0.5 servo.forward_um_s=0.8",
        "0.8 µm/s; 1.1 times; 0.73 µm/s",
    ),
    case(
        Code.SLOPE_NEAR_FEED,
        "servo.forward_um_s=0.9",
        "servo.forward_um_s=0.8",
        "0.8 µm/s; 2.8 times; 0.29 µm/s",
    ),
    case(
        Code.LIMIT_CYCLE_LARGE,
        "servo.forward_um_s=43",
        "servo.forward_um_s=45",
        "±0.52 µm; 45 µm/s; 11 ms; 0.5 µm",
    ),
    case(Code.RAMP_ORDER, "servo.back_um_s=2.5", "servo.back_um_s=2.4", "2.4 µm/s; 5 µm/s"),
    case(
        Code.RAMP_ORDER,
        "servo.short_back_um_s=5",
        "servo.back_um_s=6 servo.short_back_um_s=5",
        "5 µm/s; 6 µm/s",
    ),
    case(Code.OFFSET, "approach.offset_um=45", "approach.offset_um=44", "44 µm; 45 µm; 35 µm; 10 µm"),
    case(Code.JUMP_TOO_LOW, "jump.height_um=33", "jump.height_um=32", "32 µm; 180 µm; 8 µm; 33 µm"),
    case(
        Code.JUMP,
        "jump.mode=fixed jump.height_um=300",
        "jump.mode=fixed jump.height_um=301",
        "301 µm; 300 µm; 0 V",
    ),
    case(
        Code.JUMP,
        "jump.mode=fixed jump.speed_um_s=60 jump.period_s=7",
        "jump.mode=fixed jump.speed_um_s=60 jump.period_s=6",
        "34 %; 60 µm; 20 ms; 6 s; 30 %",
    ),
    case(
        Code.PULSE_ENERGY,
        "pulse.current_a=0.69 servo.forward_um_s=10",
        "pulse.current_a=0.70 servo.forward_um_s=10",
        "22 V; 0.7 A; 130.4 µs; 2009 µJ; 2000",
        "pulse.current_a",
    ),
    case(
        Code.PULSE_ENERGY,
        "tool.diameter_um=100 jump.height_um=100 servo.forward_um_s=10",
        "tool.diameter_um=99 jump.height_um=100 servo.forward_um_s=10",
        "344.3 µJ; 99 µm; 200 µJ",
        "pulse.current_a",
    ),
    case(
        Code.PULSE_TIMES,
        "pulse.frequency_hz=12000 pulse.duty=0.06 servo.reference=0.8",
        "pulse.frequency_hz=12100 pulse.duty=0.06",
        "4.96 µs; 5 µs",
        "pulse.frequency_hz",
    ),
    case(
        Code.PULSE_TIMES,
        "pulse.frequency_hz=25000 pulse.duty=0.50",
        "pulse.frequency_hz=25100 pulse.duty=0.50",
        "19.9 µs; 20 µs",
        "pulse.frequency_hz",
    ),
    case(
        Code.THROUGH_STROKE,
        'target={kind="through"} work.kind=through work.thickness_um=112',
        'target={kind="through"} work.kind=through work.thickness_um=113',
        "offset 50; reserve 15; 113 x 1.389; 135; 357 µm; 356 µm",
    ),
    case(
        Code.THROUGH_STROKE,
        'target={kind="through",completion_um=20} work.kind=through work.thickness_um=195',
        'target={kind="through",completion_um=20} work.kind=through work.thickness_um=196',
        "+ 20 for the worn tip; 357 µm",
    ),
    case(
        Code.TARGET_KIND,
        'target={kind="through"} work.kind=through work.thickness_um=50',
        'target={kind="through"} work.thickness_um=50',
        '50 µm; "blind"',
        "target.kind",
    ),
    case(
        Code.NOT_THROUGH,
        'target={kind="through"} work.kind=through work.thickness_um=50',
        "target.kind=depth work.kind=through work.thickness_um=100",
        "a depth of 180 µm; 100 µm",
        "target.kind",
    ),
    case(Code.ADAPTIVE, "jump.period_min_s=10", "jump.period_min_s=10.1", "10.1 s; 10 s"),
    case(Code.ADAPTIVE, "adaptive.arc_low=0.049", "adaptive.arc_low=0.05", "0.05"),
    case(Code.ADAPTIVE, "adaptive.short_low=0.02", "adaptive.short_low=0.03", "0.03"),
    case(Code.ADAPTIVE, "adaptive.reference_max=0.80", "adaptive.reference_max=0.79", "0.79; 0.8"),
    case(Code.ADAPTIVE, "adaptive.duty_min=0.30", "adaptive.duty_min=0.31", "0.31; 0.3"),
    case(Code.JUMP, "jump.period_min_s=0.27", "jump.period_min_s=0.26", "31 %; 0.08 s; 0.26 s; 30 %"),
    case(
        Code.TOLERANCE,
        "target.tolerance_um=0.58",
        "target.tolerance_um=0.57",
        "0.57 µm; 3 touches; 0.5 µm; 0.58 µm",
    ),
    case(Code.LESS_THAN_TOLERANCE, "target.depth_um=2.1", "target.depth_um=2", "2 µm"),
    case(Code.NOT_SHOWN, "target.tolerance_um=1.3", "target.tolerance_um=1", "± 1.1; 1 µm; exit code 7"),
    case(Code.FILTER, "servo.filter_hz=115", "servo.filter_hz=116", "116 Hz; 115 Hz; 2300 Hz"),
    case(
        Code.FEED_REMEASURE,
        'target={kind="feed",feed_um=250} wear.remeasure=never',
        'target={kind="feed",feed_um=250} wear.remeasure=2',
        "250 µm; 2 times",
    ),
    case(
        Code.DISCHARGE_TIME,
        "pulse.mode=isopulse pulse.discharge_us=120",
        "pulse.mode=isopulse pulse.discharge_us=121",
        "121 µs; 10 µs; 120.4 µs",
    ),
    case(
        Code.DISCHARGE_TIME,
        "pulse.mode=isopulse pulse.discharge_us=50",
        "pulse.mode=isopulse",
        "discharge_us",
    ),
    case(Code.DISCHARGE_TIME, "", "pulse.discharge_us=50", "50"),
    case(Code.REFERENCE_ONCE, "servo={reference_v=9.6}", "servo.reference_v=9.6", "0.8; 9.6 V"),
    case(Code.TOOL_WEAR, "tool.max_wear_um=71", "tool.max_wear_um=70", "70 µm"),
    case(Code.APPROACH_TRAVEL, "approach.max_travel_um=51", "approach.max_travel_um=50", "50 µm"),
    case(Code.BLIND_DEPTH, "work.thickness_um=181", "work.thickness_um=180", "180 µm"),
    case(Code.TIME_LIMIT, "limits.max_time_s=1400", "limits.max_time_s=900", "900 s"),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.code}-{'-'.join(case.breaking)}")
def test_a_rule_passes_refuses_and_says_its_numbers(case: Case) -> None:
    assert case.code not in {d.code for d in problems("cu270", *case.passing)}
    found = next(d for d in problems("cu270", *case.breaking) if d.code == case.code)
    for number in case.numbers:
        assert number in found.message
    assert found.hint
    assert found.is_warning == case.code.startswith("W")
    where = found.where
    assert where is not None
    blamed = where.source_line[where.column - 1 : where.column - 1 + where.length]
    table, _, key = case.key.partition(".")
    assert key in where.source_line
    assert blamed == where.source_line.partition("=")[2].strip().partition(" ")[
        0
    ] or where.source_line.startswith(f"{table}={{")


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
    elsewhere |= {Code.ARRAY_WEAR, Code.ARRAY_STROKE, Code.LAYER, Code.UNKNOWN_MATERIAL, Code.SIM_CONTRADICTS}
    elsewhere |= {Code.BEYOND_LAWS, Code.REGIMES, Code.NO_REMOVAL, Code.STATED_CONTRADICTS, Code.OUT_OF_REACH}
    tested = {case.code for case in CASES} | {Code.LIMIT_CYCLE, Code.ACTUATOR_VOLTAGE} | elsewhere
    assert tested == {code for code in Code if code[1:3] == "31"}


def slow_loop(period_ms: float) -> Setup:
    return Setup(controller=Controller(servo_period_us=round(1e3 * period_ms), latency=1))


def test_a_ramp_of_20_with_a_loop_of_100_ms_is_refused_with_its_numbers() -> None:
    with pytest.raises(ProfileError) as caught:
        load_profile("cu270", ["servo.forward_um_s=20", "servo.back_um_s=20"], slow_loop(100.0))
    found = caught.value.diagnostics[0]
    assert found.code == Code.LIMIT_CYCLE
    for number in ("±3.20 µm", "20 µm/s", "160 ms", "100 ms", "1 µm"):
        assert number in found.message
    assert "3.1 µm/s" in found.hint
    assert caught.value.exit_code == 3


def test_the_same_ramp_with_a_loop_of_1_ms_passes() -> None:
    assert problems("cu270", "servo.forward_um_s=20", "servo.back_um_s=20", setup=slow_loop(1.0)) == ()


def test_the_pi_law_has_no_limit_cycle_to_refuse() -> None:
    overrides = ("servo.forward_um_s=20", "servo.back_um_s=20", "servo.mode=pi")
    assert problems("cu270", *overrides, setup=slow_loop(100.0)) == ()


def test_the_voltage_limit_is_the_actuators() -> None:
    weak = Setup.model_validate({"actuator": {"stroke_v": 110.0}})
    (found,) = problems("cu270", setup=weak)
    assert found.code == Code.ACTUATOR_VOLTAGE
    assert "120 V" in found.message
    assert "110 V" in found.message


@pytest.mark.parametrize(
    ("name", "volts", "depth_um"),
    [("cu270", 120, 209), ("w252", 120, 279), ("cu270", 150, 273), ("w252", 150, 364)],
)
def test_the_deepest_hole_is_told(name: str, volts: int, depth_um: int) -> None:
    found = next(
        d
        for d in problems(name, "target.depth_um=600", f"limits.stroke_v_max={volts}")
        if d.code == Code.STROKE
    )
    assert f"at most {depth_um} µm deep" in found.hint


def test_one_touch_speed_serves_z1_z2_and_z3() -> None:
    speeds = {key for key in Measure.model_fields if "speed" in key}
    assert speeds == {"speed_um_s"}


def test_a_feed_target_goes_with_the_shipped_profile() -> None:
    assert problems("cu270", FEED_TARGET) == ()


def test_adaptive_jumps_go_only_as_far_up_as_the_tool_is_down() -> None:
    shallow = ("target.depth_um=20", "limits.max_time_s=1e5")
    assert problems("cu150", *shallow) == ()
    (found,) = problems("cu150", *shallow, "jump.mode=fixed")
    assert found.code == Code.JUMP
    assert found.hint == "use at most 78.5 µm; 6.8 µm are enough to flush"


def test_a_sheet_of_any_thickness_goes_with_a_depth() -> None:
    for target in ("target.depth_um=180", FEED_TARGET):
        found = problems("cu270", target, "work.kind=through", "work.thickness_um=400")
        assert [d.code for d in found] == [Code.NOT_THROUGH]


def test_no_jumps_need_no_flushing_height() -> None:
    assert problems("cu270", "jump.mode=off", "jump.height_um=5") == ()
