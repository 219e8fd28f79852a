"""The fuzz targets run and hold on their seeds and some changes of them; the long runs are made with atheris."""

from __future__ import annotations

import pytest

from tests.fuzz import fuzz_controller, fuzz_decoder
from tests.fuzz.driver import drive, recorded_frames


@pytest.mark.parametrize("seed", range(3))
def test_the_decoder_holds(seed: int) -> None:
    drive(fuzz_decoder.one_input, recorded_frames(), 300, seed)


@pytest.mark.slow
def test_the_controller_holds() -> None:
    drive(fuzz_controller.one_input, fuzz_controller.seeds(), 150, 1)
