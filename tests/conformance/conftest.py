"""Which controller the suite runs against: `--controller-port URL` names a board, without it a virtual machine.

`--controller firmware-float` runs the firmware's core in a board's arithmetic, `--controller stm32` the image of a
board on an emulated chip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from tests.conformance.acts import settle
from tests.conformance.lines import InProcess, Line, Serial, chip_errors, served
from tests.conformance.peer import Peer

PROCESS, PTY, BOARD = "process", "pty", "board"


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("conformance")
    group.addoption(
        "--controller-port",
        metavar="URL",
        help="run the conformance suite on this port (pyserial name or URL)",
    )
    group.addoption(
        "--controller",
        choices=["firmware", "firmware-float", "stm32"],
        default="firmware",
        help="what drives the virtual machine: the firmware's core in either arithmetic, or a board's image",
    )
    group.addoption("--controller-baud", type=int, default=500_000, help="baud of that port")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "backend" in metafunc.fixturenames:
        port = metafunc.config.getoption("--controller-port", default=None)
        metafunc.parametrize("backend", [BOARD] if port else [PROCESS, PTY], scope="session")


@pytest.fixture(scope="session")
def shared_line(backend: str, request: pytest.FixtureRequest) -> Iterator[Line | None]:
    """A line that all tests of a back-end share; None where each gets its own."""
    if backend == PROCESS:
        yield None
    elif backend == PTY:
        with served(request.config.getoption("--controller")) as line:
            yield line
    else:
        line = _board(request.config)
        yield line
        line.close()


def _board(config: pytest.Config) -> Serial:
    """The line to the board; one that cannot be opened ends the run, not each of its tests."""
    import serial

    port = config.getoption("--controller-port")
    try:
        return Serial(port, config.getoption("--controller-baud"))
    except (serial.SerialException, ValueError) as error:
        pytest.exit(
            f"--controller-port {port} cannot be opened: {error}", returncode=pytest.ExitCode.USAGE_ERROR
        )


@pytest.fixture
def line(shared_line: Line | None, request: pytest.FixtureRequest) -> Iterator[Line]:
    """The line to the controller under test. Whatever is asked of an image, it is without error to its chip."""
    line = shared_line or InProcess(request.config.getoption("--controller", default="firmware"))
    yield line
    assert chip_errors(line.bench) == (0, None)


@pytest.fixture
def peer(line: Line) -> Iterator[Peer]:
    """A host with an open session on a controller that rests in IDLE; afterwards it is brought back there."""
    host = Peer(line)
    settle(host)
    yield host
    if line.bench is None:  # a board is not left armed; a virtual one meets the next test's settle
        settle(Peer(line, seed=2))


@pytest.fixture
def inject(peer: Peer) -> Iterator[Callable[[str], None]]:
    """Spoil the virtual machine by name; it is repaired afterwards. Skips where there is no virtual machine."""
    bench = peer.line.bench
    if bench is None:
        pytest.skip("faults are injected on the virtual machine only")
    from edmctl.simulator.injection import parse_injection

    def spoil(text: str) -> None:
        bench.inject(parse_injection(text))

    yield spoil
    bench.clear_injections()


@pytest.fixture
def over_work(peer: Peer) -> Peer:
    """A host whose machine may spark. Skips on a board, whose machine the suite does not know."""
    if peer.line.bench is None:
        pytest.skip("sparks need a machine that the suite knows: the virtual one")
    return peer
