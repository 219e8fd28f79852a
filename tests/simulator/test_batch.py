"""Machines that run at once do what each does alone, and a copy brings one back to where it was."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy

import pytest

from edmctl.link import messages as m
from edmctl.simulator import VirtualBench, run_many
from tests.simulator.conftest import Rig

TICKS = 200


def told(bench: VirtualBench) -> tuple[bytes, bytes]:
    """Return what the controller has sent since it was asked last, and the state of the plant."""
    return bench.controller.link.take_output(), bytes(bench.plant.state)


@pytest.fixture
def cutting(rig: Callable[..., Rig]) -> list[VirtualBench]:
    """Three machines with their tools in sparks."""
    benches = []
    for seed in (1, 2, 3):
        one = rig(seed=seed)
        one.session.request(m.TlmStart(1000, 10, m.PulseLog.FULL))
        one.arm()
        one.to_pad()
        one.start_sparking()
        one.session.pump(2.0)
        one.bench.controller.host_heard()
        told(one.bench)
        benches.append(one.bench)
    return benches


def test_machines_at_once_do_what_each_does_alone(cutting: list[VirtualBench]) -> None:
    alone = deepcopy(cutting)
    for bench in alone:
        bench.controller.advance(TICKS)
    run_many(cutting, TICKS, threads=2)
    expected = [told(bench) for bench in alone]
    assert [told(bench) for bench in cutting] == expected
    assert len({sent for sent, _ in expected}) == len(cutting)
    assert all(len(sent) > 1000 for sent, _ in expected)


def test_a_copy_brings_a_machine_back(cutting: list[VirtualBench]) -> None:
    first, *_ = cutting
    before = deepcopy(first)
    run_many([first], TICKS, threads=1)
    again = deepcopy(before)
    run_many([again], TICKS, threads=1)
    assert told(again) == told(first)
    assert again.plant.readings.tick == before.plant.readings.tick + TICKS


def test_what_goes_wrong_on_one_machine_is_raised(
    cutting: list[VirtualBench], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise ValueError("no reading")

    monkeypatch.setattr(cutting[1].plant, "inputs", fail)
    with pytest.raises(ValueError, match="no reading"):
        run_many(cutting, TICKS, threads=2)
