"""The least off-time of a board: what its switch cannot do, it refuses."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from edmctl.board.settings import settings_of
from edmctl.core.build import source_folder
from edmctl.planning.rules.load import load_profile
from tests.conformance import acts
from tests.conformance.lines import STM32, InProcess
from tests.conformance.peer import Peer
from tests.conformance.test_identity import PULSES
from tests.needs import EMULATOR

pytestmark = EMULATOR

LEAST_US = settings_of(source_folder())["EDM_OFF_NS_MIN"].value / 1000.0
SWITCH_US, SETTLE_US, SAMPLES_US = 5.0, 3.0, 2.0


@pytest.fixture(scope="module")
def peer() -> Peer:
    peer = Peer(InProcess(STM32))
    acts.settle(peer)
    return peer


def test_the_least_off_time_is_that_of_switch_current_and_samples() -> None:
    assert LEAST_US >= SWITCH_US + SETTLE_US + SAMPLES_US


@pytest.mark.parametrize(("on_us", "off_us"), [(20.0, 0.0), (19.994, 0.006), (1e6, 0.0), (16.1, 3.9)])
def test_an_off_time_that_the_switch_cannot_make_is_refused(peer: Peer, on_us: float, off_us: float) -> None:
    peer.refused("PULSE_CONFIG", "OUT_OF_RANGE", **PULSES | {"on_time_us": on_us, "off_time_us": off_us})


def test_the_least_is_taken_and_a_nanosecond_less_is_not(peer: Peer) -> None:
    peer.ok("PULSE_CONFIG", **PULSES | {"on_time_us": 20.0, "off_time_us": LEAST_US})
    less = {"on_time_us": 20.0, "off_time_us": LEAST_US - 0.001}
    peer.refused("PULSE_CONFIG", "OUT_OF_RANGE", **PULSES | less)


@pytest.mark.parametrize("file", sorted(Path("profiles").glob("*.toml")), ids=lambda file: file.stem)
def test_shipped_profiles_are_taken(peer: Peer, file: Path) -> None:
    pulse = load_profile(str(file)).profile.pulse
    times = {"on_time_us": round(pulse.on_time_us, 3), "off_time_us": round(pulse.off_time_us, 3)}
    peer.ok("PULSE_CONFIG", **PULSES | times)


def test_every_off_time_that_a_profile_may_have_is_taken(peer: Peer) -> None:
    """A host refuses less than 20 µs; 50 kHz with a duty of 0.3 has 14."""
    for on_us, off_us in ((6.0, 14.0), (10.0, 10.0), (8500.0, 1500.0), (113.333, 20.0)):
        peer.ok("PULSE_CONFIG", **PULSES | {"on_time_us": on_us, "off_time_us": off_us})


@pytest.mark.parametrize(("off_counts", "on_us"), [(1000, 14.05), (830, 1e6 - 4.94), (1, 1e6)])
def test_the_emulated_switch_does_not_open_in_less_time_than_it_takes(
    peer: Peer, off_counts: int, on_us: float
) -> None:
    """Counts of TIM1, 168 a microsecond, of a period of 20 µs: below 5 µs it is one long pulse."""
    controller = peer.line.bench.controller
    peer.ok("PULSE_CONFIG", **PULSES | {"on_time_us": 8.0, "off_time_us": 12.0})
    peer.pump(0.01)
    generator_of = type(controller)._set_generator.__globals__["generator_of"]
    addresses = sys.modules[generator_of.py_func.__module__.rpartition(".")[0] + ".addresses"]
    registers = controller.chip.r.copy()
    registers[addresses.word(addresses.TIM1, addresses.TIM_CCR1)] = 3360 - off_counts
    on_time_us, off_time_us, *_ = generator_of(registers)
    assert off_time_us == pytest.approx(off_counts / 168.0)
    assert on_time_us == pytest.approx(on_us, abs=0.01)


@pytest.mark.parametrize("on_us", [19_510.7, 210_000.0, 328_162.0, 331_512.7, 999_990.0])
def test_the_grid_of_a_long_period_leaves_the_least_off_time(peer: Peer, on_us: float) -> None:
    """Behind its divider a count of TIM1 is up to 15 µs: 10 µs may be two of them, and never one of 5 µs."""
    controller = peer.line.bench.controller
    peer.ok("PULSE_CONFIG", **PULSES | {"on_time_us": on_us, "off_time_us": LEAST_US})
    peer.pump(0.01)
    on_time_us, off_time_us, *_ = type(controller)._set_generator.__globals__["generator_of"](
        controller.chip.r
    )
    assert LEAST_US - 0.001 <= off_time_us < LEAST_US + 16.0
    assert on_time_us == pytest.approx(on_us, abs=32.0)
