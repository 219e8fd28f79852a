"""`edmctl simulate serve`: ready, ended, kept between runs, refused in words."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import pytest

from edmctl.link.messages import GetStatus, Interlocks
from edmctl.link.opening import BOARD_BAUD, open_line
from edmctl.link.session import Session
from edmctl.record.bench_file import bench_lock
from tests.cli.commands import CU270, Here, read_until, start
from tests.needs import EMULATOR
from tests.tiers import tiers

SERVE = ("simulate", "serve")


@pytest.mark.parametrize("number", tiers(signal.SIGINT, slow=(signal.SIGTERM, signal.SIGHUP)))
def test_a_signal_ends_it_with_its_result_and_without_its_link(
    number: signal.Signals, tmp_path: Path
) -> None:
    server = start(
        *SERVE, *["--link", "edm", "--seed", "3", "--json", "--bench", "b.h5", "--speed", "max"], cwd=tmp_path
    )
    line = read_until(server.stderr, "serving")
    assert "SIM-3 on edm" in line
    session = Session(open_line(str(tmp_path / "edm")))
    assert session.open().serial == "SIM-3"
    server.send_signal(number)
    out, err = server.communicate(timeout=30)
    session.close()
    assert (server.returncode, "Traceback" in err) == (-number, False)
    document = json.loads(out)
    assert (document["exit_code"], document["seed"], document["simulated"]) == (128 + number, 3, True)
    result = document["result"]
    known = {"port": "edm", "serial": "SIM-3", "speed": "max", "faults": []}
    assert {key: result[key] for key in known} == known
    assert min(result["frames_in"], result["frames_out"]) >= 2
    assert list(tmp_path.iterdir()) == [tmp_path / "b.h5"]


def test_what_a_fault_broke_is_mended_on_request(tmp_path: Path) -> None:
    server = start(*SERVE, *["--link", "edm", "--seed", "3", "--fault", "DOOR@0"], cwd=tmp_path)
    read_until(server.stderr, "serving")
    assert server.stderr is not None
    assert "DOOR@0 happened" in server.stderr.readline()
    session = Session(open_line(str(tmp_path / "edm")))
    session.open()
    assert session.request(GetStatus()).interlocks == Interlocks.DOOR
    server.send_signal(signal.SIGUSR1)
    assert server.stderr.readline() == "repaired: nothing is broken any more\n"
    assert session.request(GetStatus()).interlocks == 0
    session.close()
    server.terminate()
    assert server.wait(timeout=30) == -signal.SIGTERM
    server.communicate()


def test_it_ends_by_itself_after_its_time(here: Here) -> None:
    said = here(
        *SERVE, "--seed", "1", "--for", "1.0", "--speed", "20", "--fault", "ESTOP@0.2", "--socket", ":0"
    )
    assert said.exit_code == 0, said.err
    assert "serving SIM-1 on socket://127.0.0.1:" in said.err
    assert "ESTOP@0.2 happened" in said.err
    assert "fault 4001 ESTOP latched" in said.err
    assert said.out.startswith("Served SIM-1: 0 frames in, ")
    assert "faults: 4001" in said.out


def test_a_kept_bench_is_the_same_machine_the_next_time(here: Here, tmp_path: Path) -> None:
    bench, serials, times_s = tmp_path / "b.h5", [], []
    kept = (*SERVE, "--for", "0.1", "--speed", "20", "--bench", str(bench), "--json")
    for options in (("--seed", "5", "--profile", CU270), (), ("--seed", "5")):
        said = here(*kept, *options)
        assert said.exit_code == 0, said.err
        result: dict[str, Any] = said.document["result"]
        serials.append(result["serial"])
        times_s.append(result["time_s"])
    assert serials == ["SIM-5"] * 3
    assert 0.1 <= times_s[0] < times_s[1] < times_s[2]
    other = here(*kept, "--seed", "6")
    assert other.exit_code == 2
    assert "keeps SIM-5, not the machine of --seed 6" in other.err
    with bench_lock(bench):
        said = here(*kept)
    assert (said.exit_code, said.document["error"]["code"]) == (9, "E9023")


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ("--link a --socket :0", "E2040"),
        ("--link no/such/folder/edm", "E4021"),
        ("--link taken", "E4021"),
        ("--bench taken", "E9020"),
        ("--speed fast", "E2041"),
        ("--speed 0", "E2041"),
        ("--speed nan", "E2041"),
        ("--fault EARTHQUAKE", "E2043"),
        ("--fault ESTOP@noon", "E2043"),
        ("--controller stm32 --baud 9600", "E2049"),
        ("--controller stm32 --baud 0", "E2049"),
        ("--profile cu270 --set sim.controller=stm32 --baud 500000", "E2049"),
        ("--socket here", "E2042"),
        ("--socket :99999", "E2042"),
        # What others reach needs a secret that nobody else reads.
        ("--socket 0.0.0.0:0", "E2046"),
        ("--socket 0.0.0.0:0 --allow-remote", "E2046"),
        ("--socket [::]:0 --allow-remote", "E2046"),
        ("--allow-remote", "E2046"),
        ("--socket 127.0.0.1:0 --secret-file none", "E2047"),
        ("--socket 127.0.0.1:0 --secret-file short", "E2047"),
        ("--socket 127.0.0.1:0 --secret-file open", "E2047"),
    ],
)
def test_what_cannot_be_served_is_refused(options: str, code: str, here: Here) -> None:
    for name, text, mode in (("taken", "mine", 0o644), ("short", "abc", 0o600), ("open", "a" * 32, 0o644)):
        Path(name).write_text(text, encoding="utf-8")
        Path(name).chmod(mode)
    said = here(*SERVE, "--for", "0.1", "--json", *options.split())
    assert (said.exit_code, said.document["error"]["code"]) == (int(code[1]), code)
    assert said.document["error"]["hint"]
    assert Path("taken").read_text(encoding="utf-8") == "mine"


@pytest.mark.slow
def test_a_command_finds_the_secret_in_its_environment_or_setup(
    here: Here, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = tmp_path / "secret"
    secret.write_text("a secret of more than sixteen bytes\n", encoding="utf-8")
    secret.chmod(0o600)
    options = "--seed 3 --socket 127.0.0.1:0 --secret-file secret --speed max"
    server = start(*SERVE, *options.split(), cwd=tmp_path)
    port = read_until(server.stderr, "serving").split(" on ")[1].split(" ")[0]
    try:
        refused = here("reset", "--port", port, "--json")
        assert (refused.exit_code, refused.document["error"]["code"]) == (4, "E4023")
        setup = tmp_path / "setup.toml"
        setup.write_text(f'[link]\nsecret_file = "{secret}"\n', encoding="utf-8")
        assert here("reset", "--port", port, "--setup", str(setup), "--json").exit_code == 0
        setup.write_text(f'[link]\nsecret_file = "{secret}"\ncandidates = ["{port}"]\n', encoding="utf-8")
        assert here("reset", "--port", "auto", "--setup", str(setup), "--json").exit_code == 0
        probed = here("ports", "--probe", "--setup", str(setup), "--json").document["result"]["ports"]
        assert [row["controller"]["serial"] for row in probed if row["controller"]] == ["SIM-3"]
        monkeypatch.setenv("EDMCTL_SECRET_FILE", str(secret))
        assert here("reset", "--port", port, "--json").exit_code == 0
    finally:
        server.send_signal(signal.SIGINT)
        out, err = server.communicate(timeout=30)
    assert "sixteen" not in out + err


@EMULATOR
@pytest.mark.slow
def test_an_emulated_board_is_announced_by_the_number_and_baud_that_it_tells(tmp_path: Path) -> None:
    options = "--link edm --seed 3 --controller stm32 --speed max --json"
    server = start(*SERVE, *options.split(), cwd=tmp_path)
    line = read_until(server.stderr, "serving")
    session = Session(open_line(str(tmp_path / "edm")))
    told = session.open(5.0)
    session.close()
    server.terminate()
    out, _ = server.communicate(timeout=60)
    assert line.startswith(f"serving {told.serial} under the controller stm32 on edm")
    assert (json.loads(out)["result"]["serial"], told.baud) == (told.serial, BOARD_BAUD)
    assert not told.serial.startswith("SIM")
