"""A second host at the port of a running job: one that asks for the lock is refused, one that does not is safe."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from edmctl.jobs.connect import bench_config
from edmctl.link import messages as m
from edmctl.link.frame import encode_frame
from edmctl.link.wire import Message
from edmctl.planning.rules.load import load_profile
from edmctl.profile.setup import Setup
from edmctl.simulator import VirtualBench, open_bench
from tests.cli.commands import CU270, SHALLOW, Here, Said, in_process_of_its_own
from tests.cli.left_jobs import at_time_of_cut
from tests.serving import serving

CUT_S = 1.0
"""So long the first cut has gone on when the second host comes."""
JOB = ("machine", *SHALLOW, "--run-id", "first", "--json", "--quiet")


@pytest.fixture
def bench() -> VirtualBench:
    return open_bench(bench_config(load_profile(CU270, ()), Setup()), 3)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What comes of the job when nobody else is there."""
    said = in_process_of_its_own(*JOB, "--seed", "3", cwd=tmp_path_factory.mktemp("alone"))
    return hole_of(said)


def hole_of(said: Said) -> dict[str, Any]:
    """What the host knows of the hole."""
    assert said.exit_code == 0, said.err
    (hole,) = said.document["result"]["sites"]
    return {key: value for key, value in hole.items() if key != "truth"}


@contextmanager
def heeding_no_lock(port: str) -> Iterator[int]:
    """A program that opens the port as any program can."""
    number = os.open(port, os.O_RDWR | os.O_NOCTTY)
    try:
        yield number
    finally:
        os.close(number)


@pytest.mark.slow
def test_whatever_its_surroundings_it_is_refused_and_the_job_goes_on(
    here: Here, bench: VirtualBench, undisturbed: dict[str, Any], tmp_path: Path
) -> None:
    elsewhere = dict.fromkeys(
        ("HOME", "TMPDIR", "EDMCTL_HOME", "XDG_DATA_HOME", "XDG_RUNTIME_DIR"), str(tmp_path)
    )
    link = tmp_path / "other-name"
    refused: list[Said] = []
    with serving(bench) as port:
        link.symlink_to(port)

        def others_come() -> None:
            for command in (("machine", *SHALLOW), ("reset",), ("doctor",)):
                for name in (port, str(link)):
                    there = (*command, "--port", name, "--json")
                    refused.append(in_process_of_its_own(*there, cwd=tmp_path, USER="else", **elsewhere))

        with at_time_of_cut(CUT_S, others_come):
            said = here(*JOB, "--port", port)
    assert hole_of(said) == undisturbed
    assert [other.exit_code for other in refused] == [4] * 6
    for other in refused:
        assert f"is held by process {os.getpid()} " in other.out
    assert not (tmp_path / "runs").exists()
    assert said.document["result"]["link"]["controller_dropped_frames"] == 0


@pytest.mark.slow
def test_frames_of_another_session_do_nothing_to_the_job(
    here: Here, bench: VirtualBench, undisturbed: dict[str, Any]
) -> None:
    sent = 0

    def another_sends() -> None:
        nonlocal sent
        stops: tuple[Message, ...] = (m.Disarm(), m.ServoStop(), m.PulseEnable(0), m.PiezoSet(0.0, 500.0))
        with heeding_no_lock(port) as number:
            for session in set(range(1, 256)) - {bench.controller.seen.session}:
                for stop in stops:
                    os.write(number, encode_frame(stop.ID, session, session, 0, stop.pack()))
                    sent += 1

    with serving(bench) as port, at_time_of_cut(CUT_S, another_sends):
        said = here(*JOB, "--port", port)
    assert hole_of(said) == undisturbed
    assert said.document["result"]["link"]["controller_dropped_frames"] == sent == 4 * 254


def test_a_hello_that_heeds_no_lock_ends_the_job_safely_and_is_named(here: Here, bench: VirtualBench) -> None:
    def another_says_hello() -> None:
        hello = m.Hello(m.PROTO_MAJOR, m.PROTO_MINOR, 1, m.SCHEMA_HASH)
        session = bench.controller.seen.session % 255 + 1
        with heeding_no_lock(port) as number:
            os.write(number, encode_frame(hello.ID, 1, session, 0, hello.pack()))

    with serving(bench) as port, at_time_of_cut(CUT_S, another_says_hello):
        said = here(*JOB, "--port", port)
    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (4, "E4013")
    assert "Another host" in error["message"]
    assert bench.is_safe
    assert bench.controller.fault == 1001
