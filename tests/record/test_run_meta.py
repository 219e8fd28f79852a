"""What the command line tells a run file before its first row."""

from __future__ import annotations

import tomllib
from datetime import UTC, datetime
from pathlib import Path

from edmctl.jobs.corrections import Choice, ModelUsed
from edmctl.jobs.plan import JobRequest, check
from edmctl.jobs.run_header import name_run, run_meta
from edmctl.machine.interface import MachineIdentity
from edmctl.profile.setup import Setup
from edmctl.record.rows import RunMeta, unit_of

PROFILES = Path(__file__).parents[2] / "profiles"


def meta_of(profile: str, *overrides: str, setup: Path | None = None) -> RunMeta:
    plan = check(JobRequest(profile, overrides, setup, None))
    name = name_run(Path("runs"), "r", plan.loaded, datetime(2026, 1, 1, tzinfo=UTC))
    identity = MachineIdentity("sim:", "VIRTUAL", "1.0.0", "1.0", simulated=True)
    choice = Choice(None, ModelUsed(False, None, None, None, "quick, from"))
    return run_meta(name, plan, 1, identity, choice, "machine")


def test_every_file_of_a_chain_of_profiles_is_kept(tmp_path: Path) -> None:
    child = tmp_path / "child.toml"
    child.write_text(f'extends = "{PROFILES / "cu150.toml"}"\n[servo]\nreference = 0.82\n', encoding="utf-8")
    meta = meta_of(str(child))
    assert meta.profile_text == child.read_text(encoding="utf-8")
    assert [Path(parent.path).name for parent in meta.profile_parents] == ["cu150.toml", "cu270.toml"]
    for parent in meta.profile_parents:
        assert parent.text == Path(parent.path).read_text(encoding="utf-8")


def test_the_constants_of_the_plant_are_among_the_values() -> None:
    values = meta_of("cu270", "sim.flush_time_s=3").profile_leaves
    names = ("sim.flush_time_s", "sim.removal_um3_per_uj", "pulse.open_voltage_v")
    assert [values[name] for name in names] == [3.0, 0.0811, 40.0]
    assert [unit_of(name) for name in names] == ["s", "um3/uJ", "V"]


def test_recipe_and_plant_have_hashes_of_their_own() -> None:
    stock, other_plant = meta_of("cu270"), meta_of("cu270", "sim.flush_time_s=3")
    assert stock.profile_sha256 == other_plant.profile_sha256
    assert stock.sim_sha256 != other_plant.sim_sha256


def test_the_setup_in_effect_is_written_in_full(tmp_path: Path) -> None:
    stock = meta_of("cu270")
    assert stock.setup_text == ""
    assert Setup.model_validate(tomllib.loads(stock.setup_toml)) == Setup()
    file = tmp_path / "setup.toml"
    file.write_text('port = "sim:"\n[sensor]\nnoise_um = 0.2\n', encoding="utf-8")
    own = meta_of("cu270", setup=file)
    assert own.setup_text == file.read_text(encoding="utf-8")
    found = tomllib.loads(own.setup_toml)
    assert found["port"] == "sim:"
    assert found["sensor"]["noise_um"] == 0.2
    assert found["stage"]["speed_um_s"] == 1000.0
