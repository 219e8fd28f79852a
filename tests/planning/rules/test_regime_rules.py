"""Rules of regimes, and what the forecast makes of them."""

from __future__ import annotations

import pytest

import edmctl
from edmctl.errors import ProfileError
from edmctl.failures import Code
from edmctl.planning.removal import recipes_of
from edmctl.planning.rules.load import load_profile

ROUGH = '{name="rough",share=0.75,current_a=0.3}'
FINE = '{name="fine",share=0.25,current_a=0.06,frequency_hz=7000,duty=0.35}'
BOTH = f"regimes=[{ROUGH},{FINE}]"


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ((f"regimes=[{ROUGH}]",), "the shares of all regimes are 0.75 together"),
        ((f"regimes=[{ROUGH},{FINE.replace('fine', 'rough')}]",), "two regimes are called rough"),
        ((BOTH, "sites=[{x_um=600}]"), "not for [[sites]]"),
        ((BOTH, 'wear.remeasure="never"'), "not for wear.remeasure"),
        ((BOTH, 'target={kind="feed",feed_um=50}'), 'not for target.kind = "feed"'),
        ((BOTH.replace("current_a=0.06", "reference=0.5"),), "regime fine: servo reference 0.5"),
    ],
)
def test_regimes_that_make_no_hole_are_refused(overrides: tuple[str, ...], said: str) -> None:
    with pytest.raises(ProfileError) as refused:
        load_profile("cu270", overrides)
    assert any(said in one.message for one in refused.value.diagnostics)


def test_a_warning_of_a_regime_names_it() -> None:
    found = load_profile("cu270", (BOTH.replace("=0.3}", "=1.5}"),)).warnings
    assert [one.message.partition(":")[0] for one in found if one.code == Code.BEYOND_LAWS] == [
        "regime rough"
    ]


def test_a_regime_goes_by_its_own_pulses_and_what_they_let_expect() -> None:
    profile = load_profile("cu270", (BOTH, "target.depth_um=60")).profile
    rough, fine = recipes_of(profile)
    assert (rough.from_um, rough.to_um, fine.to_um) == (0.0, 45.0, 60.0)
    assert rough.profile.pulse.current_a == 0.3
    assert rough.profile.pulse.frequency_hz == profile.pulse.frequency_hz
    assert fine.profile.pulse.on_time_us == pytest.approx(50.0)
    assert fine.profile.target.kind == "depth"
    assert fine.profile.target.tolerance_um == 2.0
    assert rough.profile.measure.expected_gap_um > fine.profile.measure.expected_gap_um
    assert rough.profile.wear.expected_ratio > fine.profile.wear.expected_ratio


def test_the_forecast_tells_each_regime() -> None:
    ahead = edmctl.forecast("cu270", overrides=(BOTH, "target.depth_um=60"))
    alone = edmctl.forecast("cu270", overrides={"target.depth_um": 60, "pulse.current_a": 0.06})
    rough, fine = ahead.regimes
    assert ahead.machining_time_s == pytest.approx(rough.machining_time_s + fine.machining_time_s)
    assert ahead.wear_um == pytest.approx(rough.wear_um + fine.wear_um)
    assert ahead.ra_um == fine.ra_um < 0.6 * rough.ra_um
    assert ahead.machining_time_s < alone.machining_time_s
    assert edmctl.forecast("cu270").regimes == ()


@pytest.mark.parametrize(
    ("regimes", "code", "said"),
    [
        ('[{name="a",share=1.0}]', "E3005", "regimes[0].share = 1.0 is out of range"),
        ('[{name="a",share=0.5,current_a=5},{name="b",share=0.5}]', "E3005", "regimes[0].current_a = 5"),
        ('[{name="",share=0.5},{name="b",share=0.5}]', "E3005", 'regimes[0].name = ""'),
        ('[{share=0.5},{name="b",share=0.5}]', "E3002", "regimes[0].name is missing"),
        ('[{name="a"}]', "E3002", "regimes[0].share is missing"),
        ("[1,2]", "E3004", "regimes[0] = 1 has the wrong type"),
        ("3", "E3004", "regimes = 3 has the wrong type"),
        ('[{name="a",share=0.5,amps=1},{name="b",share=0.5}]', "E3003", "unknown key regimes[0].amps"),
    ],
)
def test_a_wrong_value_of_a_regime_is_pointed_at(regimes: str, code: str, said: str) -> None:
    with pytest.raises(ProfileError) as refused:
        load_profile("cu270", (f"regimes={regimes}",))
    assert refused.value.diagnostics[0].code == code
    assert said in refused.value.diagnostics[0].message
    assert refused.value.diagnostics[0].where is not None


def test_what_is_wrong_with_the_profile_is_not_said_of_every_regime() -> None:
    same = 'regimes=[{name="rough",share=0.5},{name="fine",share=0.5,current_a=0.06}]'
    found = load_profile("cu270", (same, "pulse.current_a=1.5")).warnings
    assert [one.message.startswith("regime") for one in found if one.code == Code.BEYOND_LAWS] == [False]


def test_a_thin_fine_layer_leaves_some_of_the_rough_craters() -> None:
    def ra_um(share: float) -> float:
        rough = f'{{name="rough",share={1 - share},current_a=0.3}}'
        fine = f'{{name="fine",share={share},current_a=0.06}}'
        return (
            edmctl.forecast("cu270", overrides=(f"regimes=[{rough},{fine}]", "target.depth_um=40"))
            .regimes[-1]
            .ra_um
        )

    alone = edmctl.forecast("cu270", overrides={"pulse.current_a": 0.06}).ra_um
    assert ra_um(0.8) == pytest.approx(alone, rel=0.02)
    assert ra_um(0.8) < ra_um(0.1) < ra_um(0.03)
    assert ra_um(0.03) > 1.3 * alone


def test_a_regime_that_removes_nothing_is_refused() -> None:
    idle = 'regimes=[{name="a",share=0.5},{name="b",share=0.5,current_a=0.01,frequency_hz=20000,duty=0.05}]'
    with pytest.raises(ProfileError, match=r"regime b: a pulse of 0\.55 µJ removes nothing"):
        load_profile("cu270", (idle,))
