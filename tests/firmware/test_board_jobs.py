"""Jobs with the image of the board on its emulated chip: results hold the truth, faults end as they must."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import edmctl
from edmctl.errors import EdmError, LinkLost, MachineFault
from edmctl.machine.interface import EventCode
from edmctl.simulator import BenchConfig
from edmctl.simulator.config import FIRMWARE, STM32
from edmctl.simulator.injection import parse_injection
from tests.needs import EMULATOR
from tests.procedures.conftest import Shop
from tests.tiers import tiers

pytestmark = EMULATOR

HURRIED = ("approach.speed_um_s=5", "measure.fast_um_s=50", "measure.settle_s=0.2", "measure.dwell_s=0.1")
AT_A_TOUCH_UM = 3.0  # between two machines of a seed whose noise is not the same: drift of the sensor between


def on_the_board(config: BenchConfig) -> BenchConfig:
    """The same machine with the image."""
    return replace(config, controller=STM32)


def connected(controller: str, seed: int, home: Path) -> edmctl.Machine:
    """A virtual machine, freshly set up."""
    return edmctl.connect("sim:", seed=seed, controller=controller, home=home)


def holds(site: Any) -> None:
    """Depth, wear and feed are within three standard uncertainties."""
    for name in ("depth", "wear", "feed"):
        found, u, true = (site[f"{name}_um"], site[f"{name}_u_um"], site["truth"][f"{name}_um"])
        assert abs(found - true) <= 3.0 * u, name


@pytest.mark.parametrize("seed", tiers(1, slow=(2,)))
def test_a_quick_job_holds_the_truth(seed: int) -> None:
    s = Shop(seed=seed, changed=on_the_board)
    (site,) = s.run_job().sites
    truth_um = s.bench.truth()[0].depth_um
    assert abs(site.depth_um - truth_um) <= 3.0 * site.depth_u_um
    assert abs(site.wear_um - s.bench.tool_wear_um) <= 3.0 * site.wear_u_um
    assert s.bench.is_safe


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 5])
def test_the_main_job(seed: int, tmp_path: Path) -> None:
    """Copper of 150 µm, 30 µm deep: cuts with jumps, three touches, the way back."""
    report = connected(STM32, seed, tmp_path).machine(
        "cu150", overrides=("target.depth_um=30", *HURRIED), out=tmp_path
    )
    told: Any = report.to_dict()
    (site,) = told["sites"]
    assert (site["finished"], site["in_doubt"], site["depth_basis"]) == (True, False, "touched")
    assert site["depth_um"] == pytest.approx(30.0, abs=3.0)
    assert site["pulses"] > 50_000
    holds(site)
    assert told["link"]["bad_frames"] == told["link"]["lost_frames"] == told["link"]["retries"] == 0
    assert report.run_file is not None
    with edmctl.open_run(report.run_file) as run:
        assert sum(run.table("/entry/events")["code"] == EventCode.JUMP_DONE) >= 2


@pytest.mark.slow
def test_a_touch_finds_the_surface_that_is_there(tmp_path: Path) -> None:
    found: list[Any] = [
        connected(controller, 4, tmp_path)
        .approach("cu270", contact=True, overrides=HURRIED, out=tmp_path)
        .to_dict()
        for controller in (FIRMWARE, STM32)
    ]
    assert found[0]["touches"] == found[1]["touches"] > 1
    assert abs(found[1]["displacement_um"] - found[0]["displacement_um"]) < AT_A_TOUCH_UM
    assert found[1]["sd_um"] < 1.0


@pytest.mark.slow
def test_jumps_are_as_high_as_with_the_virtual_controller(tmp_path: Path) -> None:
    series: list[Any] = [
        connected(controller, 4, tmp_path)
        .jump_flush("cu270", count=4, overrides=HURRIED, out=tmp_path)
        .to_dict()
        for controller in (FIRMWARE, STM32)
    ]
    for expected, jump in zip(series[0]["jumps"], series[1]["jumps"], strict=True):
        assert jump["height_model_um"] == pytest.approx(expected["height_model_um"], abs=0.3)
        assert jump["height_um"] == pytest.approx(expected["height_um"], rel=0.02)
        assert jump["residual_um"] < 2.0


FAULTS = {
    "SAMPLES_LOST@sparks+1": (LinkLost, "E4022"),
    "SAMPLES_FROZEN@sparks+1": (MachineFault, "E67009"),
    "ESTOP@sparks+1": (MachineFault, "E64001"),
}


@pytest.mark.parametrize(
    "injection", tiers("SAMPLES_FROZEN@sparks+1", slow=[k for k in FAULTS if "FROZEN" not in k])
)
def test_a_fault_in_a_job_ends_it_safely(injection: str) -> None:
    kind, code = FAULTS[injection]
    s = Shop(changed=on_the_board)
    s.bench.inject(parse_injection(injection))
    with pytest.raises(EdmError) as caught:
        s.run_job()
    assert (type(caught.value), caught.value.code) == (kind, code)
    assert s.bench.is_safe
    ((_, tick),) = s.bench.controller.injector.applied
    assert s.bench.controller.tick - tick < 6000
    assert not math.isnan(s.bench.controller.plant.readings.sensor_um)
