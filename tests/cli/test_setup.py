"""Which setup a command uses, and that lengths that were measured under another one are refused."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from edmctl.record.reader import reading
from edmctl.simulator import VirtualBench
from edmctl.simulator.config import BenchConfig
from tests.cli.commands import SHALLOW, Here, Said
from tests.golden import once
from tests.serving import serving

KEPT = ("--port", "sim:bench.h5")
SHOP = "[stage]\nreference_x_um = 8000.0\npark_x_um = -4000.0\n"
AWAY = ("--setup", "shop.toml")
EACH_COMMAND = [
    ("measure-wear",),
    ("machine", *SHALLOW),
    ("machine", *SHALLOW, "--dry-run"),
    ("approach", *SHALLOW, "--contact"),
    ("measure-drift",),
    ("jump-flush", *SHALLOW),
    ("machine", *SHALLOW, "--set", "tool.diameter_um=200", "--new-tool"),
]


@pytest.fixture
def shop(here: Here, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A job that was made under the setup of another pad; returns its setup file."""

    def make(folder: Path) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            Path("shop.toml").write_text(SHOP, encoding="utf-8")
            job = ("machine", *SHALLOW, *KEPT, *AWAY, "--seed", "5", "--run-id", "a", "--quiet")
            assert here(*job).exit_code == 0

    shutil.copytree(once(tmp_path_factory, "shop", make), Path.cwd(), dirs_exist_ok=True)
    return Path("shop.toml")


@pytest.mark.parametrize("command", EACH_COMMAND, ids=lambda command: " ".join(command[:1] + command[-1:]))
def test_a_reference_on_another_pad_is_refused_and_not_used(
    here: Here, shop: Path, command: tuple[str, ...]
) -> None:
    said = here(*command, *KEPT, "--json", "--quiet")
    assert (said.exit_code, code_of(said)) == (8, "E8059")
    message = said.document["error"]["message"]
    assert "the reference pad was at (8000, 0) µm and is at (0, 0) µm" in message
    assert "the parking place was at (−4000, 0) µm and is at (−5000, 0) µm" in message
    assert "EDMCTL_SETUP" in said.document["error"]["hint"]


def test_a_ledger_without_setups_still_knows_its_pad_until_there_is_a_new_reference(
    here: Here, shop: Path
) -> None:
    ledger = Path("runs/ledger.jsonl")
    lines = [json.loads(line) for line in ledger.read_text(encoding="utf-8").splitlines()]
    for line in lines:
        line["v"] = 3
        for key in ("park_x_um", "park_y_um", "setup_sha256"):
            line.pop(key, None)
    ledger.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    refused = here("measure-wear", *KEPT, "--json", "--quiet")
    assert refused.exit_code == 8
    assert "parking place" not in refused.document["error"]["message"]
    assert here("measure-wear", *KEPT, *AWAY, "--dry-run").exit_code == 0
    assert here("measure-wear", "--reference", *KEPT, "--quiet").exit_code == 0
    said = here("measure-wear", *KEPT, "--json", "--quiet")
    assert said.exit_code == 0, said.out
    assert abs(said.document["result"]["wear_um"]) <= 2.0 * said.document["result"]["wear_u95_um"]


def code_of(said: Said) -> str:
    return str(json.loads(said.out)["error"]["code"])


def run_line(said: Said) -> str:
    return next(line for line in said.err.splitlines() if line.startswith("simulated run on"))


def test_the_setup_of_the_environment_is_used_and_another_comment_is_the_same_setup(
    here: Here, shop: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shop.write_text(f"# after cleaning\n{SHOP}speed_um_s = 900.0\n", encoding="utf-8")
    monkeypatch.setenv("EDMCTL_SETUP", "shop.toml")
    said = here("measure-wear", *KEPT, "--json")
    assert said.exit_code == 0, said.err
    assert run_line(said).endswith("; setup shop.toml; recipe of runs/a.h5")
    result = said.document["result"]
    assert abs(result["wear_um"] - result["truth"]["wear_um"]) <= 2.0 * result["wear_u95_um"]
    used = result["setup"]
    assert (used["file"], used["reference_x_um"], used["park_x_um"]) == ("shop.toml", 8000.0, -4000.0)
    with reading(Path(said.document["run_file"])) as run:
        assert run.text("/entry/machine/setup_path") == "shop.toml"
        assert run.text("/entry/machine/setup_sha256") == used["sha256"]


def own_setup(serial: str) -> Path:
    """Write the setup that is found by a serial number."""
    file = Path(os.environ["EDMCTL_HOME"]) / f"setup-{serial}.toml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(SHOP, encoding="utf-8")
    return file


def test_a_machine_at_a_port_has_its_own_setup_by_its_serial_number(here: Here) -> None:
    bench = VirtualBench(BenchConfig(), 6)
    file = own_setup(bench.plant.serial)
    Path("empty.toml").touch()
    with serving(bench) as port:
        said = here("machine", *SHALLOW, "--port", port, "--run-id", "a", "--json")
        looked = here("doctor", "--port", port, "--json")
        forgotten = here("measure-wear", "--port", port, "--setup", "empty.toml", "--json", "--quiet")
    assert said.exit_code == 0, said.err
    assert run_line(said).endswith(f"; setup {file}")
    assert said.document["result"]["setup"]["file"] == str(file)
    (site,) = said.document["result"]["sites"]
    assert site["x_um"] == 8500.0
    checks = {check["name"]: check for check in looked.document["result"]["checks"]}
    assert str(file) in checks["setup"]["message"]
    assert code_of(forgotten) == "E8059"
    anew = f"`edmctl measure-wear --reference --setup empty.toml --port {port}`"
    assert anew in forgotten.document["error"]["hint"]


def test_a_virtual_machine_in_this_process_takes_no_setup_by_itself(here: Here) -> None:
    own_setup("SIM-7")
    said = here("machine", *SHALLOW, "--seed", "7", "--run-id", "a", "--json")
    assert run_line(said).endswith("; default setup")
    assert said.document["result"]["sites"][0]["x_um"] == 500.0
    assert said.document["result"]["setup"]["file"] is None


def test_a_run_is_not_resumed_under_a_setup_that_was_found_since(here: Here) -> None:
    bench = VirtualBench(BenchConfig(), 8)
    with serving(bench) as port:
        limit = ("--set", "limits.max_time_s=100")
        assert here("machine", *SHALLOW, "--port", port, "--run-id", "a", *limit, "--quiet").exit_code != 0
        own_setup(bench.plant.serial)
        said = here("machine", "--resume", "a", "--port", port, "--json", "--quiet")
    assert code_of(said) == "E8053"
    assert "setup" in said.document["error"]["message"]


def test_without_a_profile_wear_is_measured_by_the_recipe_of_the_run(here: Here) -> None:
    recipe = ("--set", "measure.touches=5", "--set", "approach.offset_um=70", "--set", "tool.diameter_um=200")
    assert here("machine", *SHALLOW, *recipe, *KEPT, "--seed", "9", "--run-id", "a", "--quiet").exit_code == 0
    said = here("measure-wear", *KEPT, "--json")
    assert said.exit_code == 0, said.err
    assert run_line(said).endswith("; recipe of runs/a.h5")
    assert said.document["result"]["site"]["run_file"] == "a.h5"
    with reading(Path("runs/a.h5")) as made, reading(Path(said.document["run_file"])) as measured:
        before, after = made.profile_values(), measured.profile_values()
        differ = {key for key in before if before[key] != after.get(key) and not key.startswith("sim.")}
        assert differ <= {"meta.name", "meta.description"}
        assert (after["measure.touches"], after["approach.offset_um"]) == (5, 70.0)
    changed = here("measure-wear", *KEPT, "--set", "measure.touches=4", "--json", "--quiet")
    with reading(Path(changed.document["run_file"])) as measured:
        assert measured.profile_value("measure.touches") == 4
    Path("runs/a.h5").unlink()
    said = here("measure-wear", *KEPT, "--json", "--quiet")
    assert (said.exit_code, code_of(said)) == (8, "E8063")
    assert here("measure-wear", *SHALLOW, *recipe, *KEPT, "--quiet").exit_code == 0
