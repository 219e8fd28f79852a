"""What is said about records that are no records, and that nothing is said about good ones."""

import numpy as np
import pytest
from numpy.typing import NDArray

from edmctl.actuator.identification import identify
from edmctl.actuator.record import Record, check_record
from edmctl.actuator.validation import validate
from edmctl.errors import RecordError
from tests.actuator.models import default_model

Array = NDArray[np.float64]


def loops(u_v: Array, um_per_v: float = 3.0) -> Array:
    """Displacement of four plays, a loop of a sixth of the range."""
    y_um = np.zeros(len(u_v))
    for threshold_v in float(np.ptp(u_v)) * np.array([0.0, 0.03, 0.1, 0.25]):
        play_v = float(u_v[0])
        for k, volts in enumerate(u_v.tolist()):
            play_v = max(volts - threshold_v, min(volts + threshold_v, play_v))
            y_um[k] += 0.25 * um_per_v * play_v
    return y_um


def swings(
    low_v: float = 0.0,
    high_v: float = 150.0,
    *,
    rate_hz: float = 200.0,
    frequency_hz: float = 1.0,
    n: int = 2000,
) -> Record:
    t_s = np.arange(n) / rate_hz
    u_v = low_v + (high_v - low_v) * 0.5 * (1.0 - np.cos(2.0 * np.pi * frequency_hz * t_s))
    noise_um = np.random.default_rng(1).normal(0.0, 0.15, n)
    return Record(t_s, u_v, loops(u_v) + noise_um, name="record.csv")


GOOD = swings()
"""1 Hz over 0 to 150 V at 200 Hz, 10 s, noise 0.15 µm."""


def refused(record: Record) -> RecordError:
    with pytest.raises(RecordError) as refusal:
        check_record(record)
    assert refusal.value.exit_code == 3
    assert refusal.value.message.startswith("record.csv: ")
    return refusal.value


def changed(values: Array, at: int, value: float) -> Array:
    other = values.copy()
    other[at] = value
    return other


def late(record: Record, samples: int) -> Record:
    """The displacement `samples` later; negative: earlier."""
    return record._replace(y_um=np.roll(record.y_um, samples))


@pytest.mark.parametrize(
    "record",
    [
        GOOD,
        swings(-150.0, 150.0, rate_hz=5000.0, n=40_000),
        swings(high_v=10.0)._replace(y_um=GOOD.y_um),
        swings(frequency_hz=0.01, n=20_000),
        swings(rate_hz=20_000.0, frequency_hz=100.0, n=101_000),
        GOOD._replace(u_v=np.round(GOOD.u_v), y_um=np.round(GOOD.y_um / 2.0) * 2.0),
        GOOD._replace(y_um=GOOD.y_um + 10.0 * GOOD.t_s),
        GOOD._replace(y_um=GOOD.y_um + np.random.default_rng(2).normal(0.0, 4.0, len(GOOD.t_s))),
        GOOD._replace(t_s=GOOD.t_s - 5.0),
    ],
    ids=["1 Hz", "bipolar", "command", "slow", "fast", "coarse", "drift", "noisy", "from minus 5 s"],
)
def test_a_good_record_passes_in_silence(record: Record) -> None:
    assert check_record(record) == ()


@pytest.mark.parametrize("lag_samples", [0, 20, 40, 60])
def test_a_delay_of_a_fast_swing_is_no_mistake(lag_samples: int) -> None:
    fast = swings(rate_hz=20_000.0, frequency_hz=100.0, n=101_000)
    assert check_record(late(fast, lag_samples)) == ()


def test_jumps_with_overshoot_are_no_spikes() -> None:
    u_v = np.where(np.arange(2000) % 400 < 200, 150.0, 30.0)
    y_um = loops(u_v)
    y_um[::200] += 0.08 * np.ptp(y_um) * np.sign(np.diff(u_v, prepend=30.0))[::200]
    assert check_record(Record(np.arange(2000) / 200.0, u_v, y_um)) == ()


def test_a_rare_jump_out_of_a_small_servo_swing_is_no_limit() -> None:
    u_v = 75.0 + np.sin(0.05 * np.arange(20_000))
    u_v[9000:9060] += np.bartlett(60) * 60.0
    assert check_record(Record(np.arange(20_000) / 200.0, u_v, loops(u_v))) == ()


def with_two(values: Array, value: float) -> Array:
    return changed(changed(values, 17, value), 90, value)


RANDOM = np.random.default_rng(6)


@pytest.mark.parametrize(
    ("changes", "code", "message", "hint"),
    [
        ({name: getattr(GOOD, name)[:199] for name in ("t_s", "u_v", "y_um")}, "E3611", "199 samples", ""),
        ({"t_s": with_two(GOOD.t_s, np.nan)}, "E3612", "2 of 2000 values of t_s", "no number"),
        ({"u_v": with_two(GOOD.u_v, np.inf)}, "E3612", "u_V are not finite, the first at sample 18", ""),
        ({"y_um": with_two(GOOD.y_um, np.nan)}, "E3612", "2 of 2000 values of y_um are not finite", ""),
        ({"t_s": changed(GOOD.t_s, 9, GOOD.t_s[8])}, "E3613", "stands still at sample 10", "more digits"),
        ({"t_s": np.r_[GOOD.t_s[:900], GOOD.t_s[:1100]]}, "E3613", "goes back at sample 901", "of their own"),
        ({"u_v": np.full(2000, 75.0)}, "E3614", "always 75 V", "over its range"),
        ({"u_v": RANDOM.normal(75.0, 0.01, 2000)}, "E3614", "noise about 75 V", "over its range"),
        ({"y_um": np.full(2000, 12.5)}, "E3615", "always 12.5 µm", "its cable"),
        ({"y_um": RANDOM.normal(0.0, 1.0, 2000)}, "E3615", "does not follow", "one clock"),
        ({"y_um": GOOD.t_s * 40.0}, "E3615", "does not follow", "one clock"),
        ({"y_um": late(GOOD, 50).y_um}, "E3615", "does not follow", "one clock"),
        ({"y_um": changed(-GOOD.y_um, 1000, 0.0)}, "E3617", "falls while", "Negate y_um"),
        ({"y_um": changed(-GOOD.y_um, 1000, 1e6)}, "E3617", "falls while", "Negate y_um"),
        ({"y_um": 1e-3 * GOOD.y_um}, "E3618", "", "y_um looks like mm: multiply it by 1000."),
        ({"y_um": 1e-3 * GOOD.y_um, "u_v": GOOD.u_v / 15.0}, "E3618", "", "mm: multiply it by 1000."),
        ({"y_um": 1e-6 * GOOD.y_um}, "E3618", "", "y_um looks like m: multiply it by 1e6."),
        ({"y_um": 1e3 * GOOD.y_um}, "E3618", "", "y_um looks like nm: multiply it by 0.001."),
        ({"u_v": 1e3 * GOOD.u_v}, "E3618", "", "u_V looks like mV: multiply it by 0.001."),
        ({"u_v": 1e-3 * GOOD.u_v}, "E3618", "", "u_V looks like kV: multiply it by 1000."),
        ({"t_s": 1e6 * GOOD.t_s}, "E3618", "", "If t_s is in µs, multiply it by 1e-6; in ms, by 0.001."),
        ({"u_v": GOOD.y_um, "y_um": GOOD.u_v}, "E3626", "ahead of the voltage", "exchanged"),
    ],
)
def test_what_is_no_record_is_refused(changes: dict[str, Array], code: str, message: str, hint: str) -> None:
    error = refused(Record(**{**GOOD._asdict(), **changes}))
    assert error.code == code
    assert message in error.message
    assert hint in error.hint


@pytest.mark.parametrize(
    ("end", "share", "noise_um"),
    [("upper", 0.1, 0.0), ("upper", 0.3, 0.15), ("lower", 0.1, 0.15), ("lower", 0.3, 0.0)],
)
def test_a_clipped_sensor_is_named(end: str, share: float, noise_um: float) -> None:
    y_um = loops(GOOD.u_v)[200:]
    cut_um = share * float(np.ptp(y_um))
    low_um, high_um = (None, y_um.max() - cut_um) if end == "upper" else (y_um.min() + cut_um, None)
    clipped_um = np.clip(y_um, low_um, high_um)
    clipped_um += np.random.default_rng(4).normal(0.0, noise_um, len(y_um))
    error = refused(GOOD._replace(t_s=GOOD.t_s[200:], u_v=GOOD.u_v[200:], y_um=clipped_um))
    assert error.code == "E3616"
    assert f"{end} end" in error.message


def spiked(height_um: float) -> Record:
    y_um = GOOD.y_um.copy()
    y_um[[400, 1200]] += height_um
    return GOOD._replace(y_um=y_um)


FAST = swings(rate_hz=5000.0, n=50_000)


@pytest.mark.parametrize(
    ("record", "words"),
    [
        (GOOD._replace(t_s=1e3 * GOOD.t_s), "sample period is 5 s. If t_s is in ms, multiply it by 0.001"),
        (FAST._replace(t_s=1e3 * FAST.t_s), "one swing takes 500 s. If t_s is in ms, multiply it by 0.001"),
        (
            GOOD._replace(t_s=GOOD.t_s + np.where(np.arange(2000) > 899, 3.0, 0.0)),
            "the longest of 3 s after sample 900",
        ),
        (
            swings(rate_hz=20_000.0, frequency_hz=100.0, n=4000),
            "0.2 s, which says next to nothing about creep",
        ),
        (spiked(80.0), "2 displacements stand out"),
        (spiked(-1e6), "the first at sample 401"),
        (GOOD._replace(y_um=3.0 * GOOD.u_v + 5.0), "the column of the sensor"),
    ],
    ids=["period", "swing", "gap", "short", "spikes", "deep spikes", "voltage"],
)
def test_a_doubtful_record_is_asked_about(record: Record, words: str) -> None:
    (doubt,) = check_record(record)
    assert words in doubt


def test_a_displacement_ahead_of_its_voltage_is_on_another_clock() -> None:
    fast = swings(rate_hz=20_000.0, frequency_hz=100.0, n=101_000)
    assert refused(late(fast, -20)).code == "E3626"


ODD_T_S: Array = 0.01 * np.arange(2000, dtype=np.float64)
ODD_V: Array = 75.0 - 75.0 * np.cos(ODD_T_S)
ODD_UM: Array = 3.0 * ODD_V + 0.1 * np.sin(50.0 * ODD_T_S)
FLAT = np.zeros(2000)
SPIKE = np.where(np.arange(2000) == 700, 100.0, 0.0)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("t_s", "u_v", "y_um"),
    [
        (ODD_T_S, FLAT, ODD_UM),
        (ODD_T_S, FLAT, FLAT),
        (ODD_T_S, SPIKE, ODD_UM),
        (ODD_T_S, ODD_V, FLAT + 5.0),
        (ODD_T_S, ODD_V, SPIKE),
        (ODD_T_S, ODD_V, 1e-200 * ODD_UM),
        (ODD_T_S, ODD_V, 1e20 * ODD_UM),
        (ODD_T_S, 1e160 * ODD_V, 1e160 * ODD_UM),
        (ODD_T_S, ODD_V, np.where(ODD_T_S == 5.0, np.nan, ODD_UM)),
        (np.repeat(ODD_T_S[:1000], 2), ODD_V, ODD_UM),
        (ODD_T_S[:2], ODD_V[:2], ODD_UM[:2]),
        (ODD_T_S[:0], ODD_V[:0], ODD_UM[:0]),
    ],
)
def test_odd_records_are_refused_without_a_warning(t_s: Array, u_v: Array, y_um: Array) -> None:
    with pytest.raises(RecordError):
        check_record(Record(t_s, u_v, y_um))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("u_v", "y_um"),
    [
        (ODD_V, FLAT + 5.0),
        (ODD_V, np.where(ODD_T_S == 5.0, np.nan, ODD_UM)),
        (1e160 * ODD_V, 1e160 * ODD_UM),
        (ODD_V[:0], ODD_UM[:0]),
        (ODD_V[:1], ODD_UM[:1]),
    ],
)
def test_nothing_is_judged_on_what_says_nothing(u_v: Array, y_um: Array) -> None:
    with pytest.raises(ValueError, match="record: "):
        validate(default_model(), Record(ODD_T_S[: len(u_v)], u_v, y_um))


@pytest.mark.filterwarnings("error")
def test_a_clock_in_the_wrong_unit_is_fitted_all_the_same() -> None:
    record = Record(1e-12 * ODD_T_S, ODD_V, ODD_UM)
    assert identify([record], resamples=0).samples > 1000


def test_a_sensor_in_coarse_steps_is_doubted_where_no_noise_shows_them() -> None:
    slow = swings(frequency_hz=0.05, n=8000)
    range_um = float(np.ptp(slow.y_um))

    def doubts(record: Record, step_um: float) -> tuple[str, ...]:
        return check_record(record._replace(y_um=step_um * np.round(record.y_um / step_um)))

    coarse_um = 0.01 * range_um
    (doubt,) = doubts(slow, coarse_um)
    assert f"goes in steps of {coarse_um:.3g} µm" in doubt
    assert "finer range" in doubt
    noise_um = np.random.default_rng(3).normal(0.0, coarse_um, len(slow.y_um))
    assert doubts(slow._replace(y_um=slow.y_um + noise_um), coarse_um) == ()
    assert doubts(GOOD, coarse_um) == ()  # so fast that the steps are noise
    assert doubts(slow, 0.0002 * range_um) == ()
