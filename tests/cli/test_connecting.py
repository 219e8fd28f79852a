"""The command line over a served controller: the same run as in process, and a clear error where there is none."""

from __future__ import annotations

import os
import select
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

import pytest

from edmctl.jobs.connect import bench_config
from edmctl.link.messages import Arm, param_crc
from edmctl.link.opening import open_line
from edmctl.link.session import Session
from edmctl.machine.interface import default_settings
from edmctl.planning.rules.load import load_profile
from edmctl.profile.setup import Setup
from edmctl.simulator import BenchConfig, VirtualBench, open_bench
from edmctl.simulator.injection import parse_injection
from edmctl.simulator.serve import PtyEndpoint, Server, SocketEndpoint
from tests.cli.commands import CU270, SHALLOW, Here, in_process_of_its_own
from tests.serving import bridged, serving
from tests.tiers import tiers

SEED = 3
CLEAR_ERROR_WITHIN_S = 2.0


def bench_of_the_profile(seed: int = SEED) -> VirtualBench:
    """The bench that `sim:` would make for the shallow job."""
    return open_bench(bench_config(load_profile(CU270, ()), Setup()), seed)


@contextmanager
def device(answer: Callable[[bytes], bytes] | None = None) -> Iterator[str]:
    """A port with something on it that is no controller; it says `answer` to what it gets, or nothing."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    over_r, over_w = os.pipe()

    def run() -> None:
        while over_r not in (ready := select.select([ours, over_r], [], [])[0]):
            if ready and answer:
                os.write(ours, answer(os.read(ours, 65536)))
            elif ready:
                os.read(ours, 65536)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        os.write(over_w, b"\0")
        thread.join()
        for number in (ours, theirs, over_r, over_w):
            os.close(number)


@pytest.fixture(scope="module")
def in_process(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The result of the job on the virtual machine of this process."""
    folder = tmp_path_factory.mktemp("in-process")
    said = in_process_of_its_own("machine", *SHALLOW, "--seed", str(SEED), "--json", "--quiet", cwd=folder)
    result: dict[str, Any] = said.document["result"]
    assert result["sites"][0].pop("truth")["depth_um"] > 0.0
    return result


@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")
@pytest.mark.parametrize("line", tiers("pty", slow=("RFC 2217",)))
def test_a_run_over_a_line_is_the_run_in_process(here: Here, in_process: dict[str, Any], line: str) -> None:
    endpoint = None if line == "pty" else SocketEndpoint("127.0.0.1", 0)
    with ExitStack() as stack:
        port = stack.enter_context(serving(bench_of_the_profile(), endpoint=endpoint))
        if line != "pty":
            port = stack.enter_context(bridged(port))
        said = here("machine", *SHALLOW, "--port", port, "--run-id", "b", "--json")
    document = said.document
    assert said.exit_code == 0, said.err
    assert (document["simulated"], document["seed"], document["warnings"]) == (True, None, [])
    assert f"simulated run on the virtual controller SIM-{SEED} at {port}" in said.err
    (site,) = document["result"]["sites"]
    # What only the simulator knows stays in its own process.
    assert not any(value is not None for value in (site.pop("truth") or {}).values())
    assert [site] == in_process["sites"]
    if line == "pty":
        assert document["result"]["time_s"] == in_process["time_s"]


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (("machine", *SHALLOW, "--seed", "5"), "W4101"),
        (("machine", *SHALLOW, "--controller", "firmware"), "W4102"),
        (("calibrate", "--controller", "firmware"), "W4102"),
    ],
)
def test_an_option_that_does_nothing_at_a_port_is_warned_of(
    here: Here, command: tuple[str, ...], code: str
) -> None:
    said = here(*command, "--port", "/dev/nothing-of-the-kind", "--json")
    assert (said.exit_code, said.document["error"]["code"]) == (4, "E4001")
    (warning,) = said.document["warnings"]
    assert warning["code"] == code
    words = "simulate serve" if code == "W4101" else "/dev/nothing-of-the-kind"
    assert words in f"{warning['message']} {warning['hint']}"


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        (lambda data: data, "bytes came"),
        (lambda _: b"AT\r\nAT+GCAP\r\n", "bytes came"),
        (None, "No controller answered"),
    ],
    ids=["echo", "modem", "silence"],
)
def test_whatever_is_on_the_port_is_told_in_the_time_of_the_setup(
    here: Here, answer: Callable[[bytes], bytes] | None, told: str, tmp_path: Path
) -> None:
    setup = tmp_path / "setup.toml"
    setup.write_text("[link]\nhello_s = 0.2\n")
    with device(answer) as port:
        begin_s = monotonic()
        said = here("machine", *SHALLOW, "--setup", str(setup), "--port", port, "--json")
        took_s = monotonic() - begin_s
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (4, "E4011")
    assert told in error["message"]
    assert "edmctl ports" in error["hint"]
    assert took_s < CLEAR_ERROR_WITHIN_S


def test_chatter_before_the_hello_and_hours_of_waiting_do_no_harm(here: Here) -> None:
    bench = open_bench(BenchConfig(), SEED)
    bench.controller.advance(300_000)
    with serving(bench) as port:
        chatty = open_line(port)
        chatty.write(b"AT\r\nAT+CGMI\r\n~x\0\x80\xff" * 20)
        chatty.close()
        for _ in range(2):
            said = here("reset", "--port", port)
            assert said.exit_code == 0, said.err


def test_a_setup_names_the_port_where_nothing_else_does(here: Here, tmp_path: Path) -> None:
    setup = tmp_path / "setup.toml"
    with serving(open_bench(BenchConfig(), SEED)) as port:
        setup.write_text(f'port = "{port}"\n')
        assert here("reset", "--setup", str(setup), "--json").document["simulated"] is True
        setup.write_text(f'port = "auto"\n[link]\ncandidates = ["{port}"]\nusb_ids = []\n')
        assert here("reset", "--setup", str(setup)).exit_code == 0
        assert here("reset", "--setup", str(setup), "--port", f"serial:SIM-{SEED}").exit_code == 0
        other = here("reset", "--setup", str(setup), "--port", "serial:SIM-99", "--json")
        assert (other.exit_code, other.document["error"]["code"]) == (4, "E4001")


def test_a_second_process_on_a_port_is_told_who_holds_it_and_may_wait(here: Here, tmp_path: Path) -> None:
    with serving(open_bench(BenchConfig(), SEED)) as port:
        line = open_line(port)
        said = in_process_of_its_own("reset", "--port", port, "--json", cwd=tmp_path)
        error = said.document["error"]
        assert (said.exit_code, error["code"]) == (4, "E4006")
        assert f"process {os.getpid()} " in error["message"]
        threading.Timer(0.1, line.close).start()
        waited = here("reset", "--port", port, "--wait", "30")
    assert waited.exit_code == 0, waited.err
    assert "Waiting up to 30 s." in waited.err


def test_a_controller_that_was_left_armed_is_stopped_by_the_next_host(here: Here) -> None:
    bench = bench_of_the_profile()
    job = ("machine", *SHALLOW, "--json", "--run-id")
    with serving(bench) as port:
        session = Session(open_line(port))
        session.open(5.0)
        session.request(Arm(param_crc(default_settings())))
        session.close()
        left = bench.controller.armed
        refused = here(*job, "refused", "--port", port)
        assert (bench.controller.armed, bench.controller.fault) == (False, 1001)
        assert here("reset", "--ack", "1001", "--port", port).exit_code == 0
        done = here(*job, "done", "--port", port)
    assert left
    error = refused.document["error"]
    assert (refused.exit_code, error["code"]) == (8, "E8010")
    assert f"`edmctl reset --ack 1001 --port {port}`" in error["hint"]
    assert done.exit_code == 0, done.err


@contextmanager
def cabled(bench: VirtualBench) -> Iterator[str]:
    """Serve `bench` on a pty that is gone as soon as the line is unplugged."""
    endpoint, over = PtyEndpoint(), threading.Event()
    server = Server(bench, endpoint, None)

    def run() -> None:
        server.run(over.is_set)
        endpoint.close()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield endpoint.name
    finally:
        over.set()
        thread.join()


@pytest.mark.parametrize(
    "command", [("calibrate",), ("machine", *SHALLOW, "--run-id", "r")], ids=["calibrate", "machine"]
)
def test_a_line_that_breaks_ends_the_command_at_once(here: Here, command: tuple[str, ...]) -> None:
    bench = bench_of_the_profile()
    bench.inject(parse_injection("UNPLUG@arm+5"))
    with cabled(bench) as port:
        said = here(*command, "--port", port, "--json", "--quiet")
    document = said.document
    assert (said.exit_code, document["error"]["code"], document["seed"]) == (4, "E4003", None)
    assert port in document["error"]["message"]
    assert document["error"]["hint"]


def test_a_simulation_goes_to_no_port(here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDMCTL_PORT", "/dev/ttyNONE")
    Path("setup.toml").write_text('port = "/dev/ttyNONE"\n', encoding="utf-8")
    said = here(
        "simulate", *SHALLOW, "--runs", "1", "--seed", "1", "--setup", "setup.toml", "--json", "--quiet"
    )
    assert said.exit_code == 0, said.err
    assert said.document["simulated"] is True
