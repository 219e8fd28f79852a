"""Settings of a machine's owner: an image is built with them, does as they say and tells them."""

from __future__ import annotations

from pathlib import Path

import pytest

from edmctl.board.board_build import build_board
from edmctl.board.emulated import controller_class, image
from edmctl.board.image import Elf
from edmctl.board.settings import parse_settings, settings_in, settings_of
from edmctl.core.boards import STM32F4
from edmctl.core.build import source_folder
from edmctl.errors import UsageError
from edmctl.simulator import BenchConfig, open_bench
from tests.firmware.image_bytes import image_bytes
from tests.needs import EMULATOR

KNOWN = settings_of(source_folder())
WRONG = {
    "gap_ful_v=3": "Did you mean EDM_GAP_FULL_V?",
    "gap_full_v": "EDM_GAP_FULL_V=330",
    "gap_full_v=": "EDM_GAP_FULL_V=330",
    "gap_full_v=nan": "EDM_GAP_FULL_V=330",
    "gap_full_v=0": "Settings of the owner",
    "step_um=0,5": "EDM_STEP_UM=0.1",
    "baud=1.5": "Settings of the owner",
    "baud=1e18": "Settings of the owner",
    "most_steps_per_ms=141": "Settings of the owner",
    "off_ns_min=9999": "Settings of the owner",
    "off_ns_min=1": "Settings of the owner",
    "gap_full_v=1e39": "Settings of the owner",
    "step_um=1e-300": "Settings of the owner",
    "monitor_least_v=-1e39": "Settings of the owner",
    "gap_full_v=1_0": "EDM_GAP_FULL_V=330",
    "gap_full_v=١٢": "EDM_GAP_FULL_V=330",
    "monitor_least_v=200": "Set both",
    "monitor_most_v=140": "0 to 150 V",
    "monitor_least_v=0": "0 to 150 V",
    "open_v_max=500": "Set both",
    "gap_full_a=1.2": "Set both",
    "current_a_max=12": "Set both",
    "sensor_least_um=450": "Set both",
    "EDM_BOX_SAMPLES=512": "Settings of the owner",
}


def test_the_settings_are_those_of_the_sources() -> None:
    assert {"EDM_GAP_FULL_V", "EDM_STEP_UM", "EDM_PARKED_X_UM", "EDM_OPEN_V_MAX", "EDM_BAUD"} <= set(KNOWN)
    assert not {"EDM_BOX_SAMPLES", "EDM_BOX_LASTS", "EDM_LINGER_TICKS"} & set(KNOWN)
    assert (KNOWN["EDM_GAP_FULL_V"].value, KNOWN["EDM_GAP_FULL_V"].is_whole) == (330.0, False)
    assert KNOWN["EDM_MOST_STEPS_PER_MS"].is_whole


def test_names_come_in_small_letters_and_the_last_one_counts() -> None:
    chosen = parse_settings(["gap_full_a=12", "EDM_GAP_FULL_A=15", "Parked_X_um=-3"], KNOWN)
    assert chosen == {"EDM_GAP_FULL_A": 15.0, "EDM_PARKED_X_UM": -3.0}


@pytest.mark.parametrize("text", WRONG)
def test_what_is_wrong_is_refused_with_the_remedy(text: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_settings([text], KNOWN)
    assert caught.value.code == "E2094"
    assert WRONG[text] in (caught.value.hint or "")


def test_settings_are_read_from_an_image_and_bytes_that_look_alike_passed_over() -> None:
    image = image_bytes(settings="EDM_GAP_FULL_A=12.5 EDM_BAUD=1234567")
    settings = {"EDM_GAP_FULL_A": 12.5, "EDM_BAUD": 1234567.0}
    assert settings_in(b"xEDMS" + b"\xff" * 4 + b"\0EDMS\0" + image) == settings
    assert settings_in(b"EDMSEDM_X=1\0") == {"EDM_X": 1.0}
    assert settings_in(b"EDMSEDM_X=1") == {}  # cut off
    for text in ("EDM_X", "EDM_X=", "EDM_X=abc", "EDM_X=nan", "EDM_X=1_0", "1=2", "EDM_é=1", "EDM_X=1 y"):
        assert settings_in(b"EDMS" + text.encode("latin-1") + b"\0") == {}


@EMULATOR
def test_as_in_the_sources_nothing_is_told() -> None:
    _, data = image("zig").image()
    assert b"EDMS\0" in data
    assert settings_in(data) == {}


@EMULATOR
@pytest.mark.slow
def test_an_image_measures_by_what_was_set(tmp_path: Path) -> None:
    """The same voltage of the displacement sensor, 3.3 V meaning twice as much from another zero."""
    texts = ("sensor_least_um=0", "sensor_most_um=1000")
    made = build_board(STM32F4, tmp_path / "x.elf", "zig", settings=texts)
    sensor_um = []
    for elf in (image("zig"), Elf(made.elf.read_bytes())):
        controller = controller_class()(open_bench(BenchConfig(), 1).plant, elf)
        controller.advance(20)
        sensor_um.append(float(controller.bytes_of("readings", 4).view("<f4")[0]))
    assert sensor_um[1] == pytest.approx(2.0 * (sensor_um[0] + 50.0), abs=0.5)
