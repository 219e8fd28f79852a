"""`edmctl simulate serve`: a virtual controller that other programs reach as they reach a real one."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from edmctl import failures
from edmctl.cli.options import (
    NOTES,
    ControllerOption,
    ProfileOption,
    SeedOption,
    SetOption,
    SetupOption,
    command,
    controlled_by,
    option,
)
from edmctl.cli.outcome import Outcome, tell
from edmctl.cli.signals import requests_by_signal, stopping_signals
from edmctl.dataclasses import asdict, dataclass, replace
from edmctl.jobs.sweep import seed_to_use
from edmctl.machine.stop import StopRequest

if TYPE_CHECKING:
    from edmctl.simulator import BenchConfig, VirtualBench
    from edmctl.simulator.injection import Injection
    from edmctl.simulator.serve import Endpoint

FASTEST = "max"
LEAST_SPEED, MOST_SPEED = 0.05, 1000.0
REPAIR_SIGNAL = "SIGUSR1"
"""Mends what --fault broke, as the workshop would."""

LinkOption = Annotated[Path | None, option("--link PATH", "Name under which clients open the pty.")]
SocketOption = Annotated[
    str | None, option("--socket HOST:PORT", "Serve on a socket instead; port 0 takes any.")
]
RemoteOption = Annotated[
    bool, option("--allow-remote", "Let other computers reach the socket; only with a secret file.")
]
SecretOption = Annotated[
    Path | None, option("--secret-file FILE", "Take only clients of the socket that know what is in it.")
]
SpeedOption = Annotated[
    str, option("--speed N|max", "Controller seconds per second; max: time waits for the host.")
]
BaudOption = Annotated[
    int | None,
    option(
        "--baud N",
        "What the imitated UART carries; 0 for USB, without a limit. Default: 500000, of stm32 always "
        "921600.",
        min=0,
        show_default=False,
    ),
]
BenchOption = Annotated[
    Path | None, option("--bench FILE", "Keep work, tool and actuator in this file between runs.")
]
FaultOption = Annotated[
    list[str] | None, option("--fault NAME[@WHEN]", "Inject a fault, e.g. ESTOP@sparks+2. Repeatable.")
]
ForOption = Annotated[
    float | None, option("--for SECONDS", "End after this much of the controller's time.", min=0.0)
]


@dataclass(frozen=True, slots=True)
class _Request:
    """What to serve where, checked; `open_endpoint` takes what reports problems of clients."""

    config: "BenchConfig"
    seed: int
    speed: float | None
    baud: int
    injections: tuple["Injection", ...]
    bench_file: Path | None
    seconds: float | None
    open_endpoint: "Callable[[Callable[[str], None]], Endpoint]"


@command("simulate serve", NOTES)
def serve(
    outcome: Outcome,
    profile: ProfileOption = None,
    overrides: SetOption = None,
    setup: SetupOption = None,
    seed: SeedOption = None,
    controller: ControllerOption = None,
    link: LinkOption = None,
    socket: SocketOption = None,
    allow_remote: RemoteOption = False,
    secret_file: SecretOption = None,
    speed: SpeedOption = "1",
    baud: BaudOption = None,
    bench: BenchOption = None,
    fault: FaultOption = None,
    seconds: ForOption = None,
) -> None:
    """Serve a virtual controller on a pty or a socket until Ctrl-C.

    It is the machine of `sim:`, and keeps its state between the programs that connect one after the other. Faults of
    --fault last until SIGUSR1.
    """
    from edmctl.jobs.connect import bench_config
    from edmctl.planning.rules.load import load_profile
    from edmctl.profile.setup import load_setup

    outcome.simulated = True
    injections, factor = _injections(fault), _speed(speed)
    open_endpoint = _endpoint(link, socket, secret_file, allow_remote=allow_remote)
    if seconds is not None and not math.isfinite(seconds):
        raise failures.serving_time_impossible(seconds=seconds)
    settings = load_setup(setup)
    changes = (*(overrides or ()), *controlled_by(controller))
    loaded = load_profile(profile, changes, setup=settings) if profile else None
    if loaded is not None:
        outcome.uses(profile=loaded.path)
    config = bench_config(loaded, settings)
    if controller is not None and loaded is None:
        config = replace(config, controller=controller)
    rate = _baud(baud, config.controller)
    used_seed = seed_to_use(seed)
    # A kept bench is the machine that it is, whatever seed would make another.
    outcome.seed = used_seed if seed is not None or bench is None or not bench.exists() else None
    _serve(outcome, _Request(config, used_seed, factor, rate, injections, bench, seconds, open_endpoint))


def _serve(outcome: Outcome, request: _Request) -> None:
    from edmctl.jobs.connect import driver
    from edmctl.jobs.persistent_simulator import kept_bench
    from edmctl.simulator.plant import serial_number
    from edmctl.simulator.serve import EventMonitor, Server

    say = partial(tell, outcome.output)
    stop = StopRequest()
    with kept_bench(request.bench_file, request.config, request.seed) as (bench, keep):
        if outcome.seed is not None and bench.plant.serial != serial_number(outcome.seed):
            raise failures.bench_of_another_seed(
                bench_file=request.bench_file, serial=bench.plant.serial, seed=outcome.seed
            )
        for injection in request.injections:
            bench.inject(injection)
        controller = bench.controller
        controller.baud = request.baud
        serial = _serial(bench)
        end_tick = math.inf if request.seconds is None else controller.tick + round(1000.0 * request.seconds)
        endpoint = request.open_endpoint(say)
        try:
            news = EventMonitor(bench, say, keep)
            with (
                stopping_signals(stop, endpoint.close),
                requests_by_signal(REPAIR_SIGNAL) as repair_asked,
            ):
                pace = "as fast as its clients" if request.speed is None else f"at {request.speed:g}x"
                say(f"serving {serial}{driver(bench)} on {endpoint.name} {pace}; Ctrl-C ends it")

                def look_around() -> None:
                    if repair_asked():
                        bench.clear_injections()
                        say("repaired: nothing is broken any more")
                    news()

                server = Server(bench, endpoint, request.speed, look_around, say)
                server.run(lambda: stop.signal_number is not None or controller.tick >= end_tick)
        finally:
            endpoint.close()
            bench.settle()
        news()
        outcome.result = {
            "port": endpoint.name,
            "serial": serial,
            "speed": FASTEST if request.speed is None else request.speed,
            "time_s": controller.tick * 1e-3,
            "state": controller.state.name,
            "fault": controller.fault or None,
            "faults": news.faults,
            "injected": [str(injection) for injection, _ in controller.injector.applied],
            **asdict(server.traffic),
        }
        traffic, faults = server.traffic, ", ".join(map(str, news.faults)) or "none"
        late = f"; its clock was set back by {traffic.paused_s:.1f} s in all" if traffic.paused_s else ""
        outcome.text = (
            f"Served {serial}: {traffic.frames_in} frames in, {traffic.frames_out} out, "
            f"{traffic.dropped_frames} dropped; faults: {faults}{late}."
        )
    if bench.line.unplugged:
        say("the line is unplugged; nothing more to serve")
    stop.check()


def _serial(bench: "VirtualBench") -> str:
    """Return the serial number in HELLO: that of the machine, or of an emulated chip."""
    from edmctl.link.session import Session
    from edmctl.simulator import MemoryTransport
    from edmctl.simulator.config import STM32

    if bench.plant.config.controller != STM32:
        return bench.plant.serial
    return str(Session(MemoryTransport(bench.controller)).introduction().fields["serial"])


def _baud(asked: int | None, controller: str) -> int:
    """Return the baud rate. An image has one rate."""
    from edmctl.link.opening import BOARD_BAUD, DEFAULT_BAUD
    from edmctl.simulator.config import STM32

    if controller == STM32 and asked not in (None, BOARD_BAUD):
        raise failures.baud_fixed_by_image(asked=asked, controller=controller, only=BOARD_BAUD)
    usual = BOARD_BAUD if controller == STM32 else DEFAULT_BAUD
    return usual if asked is None else asked


def _speed(text: str) -> float | None:
    if text == FASTEST:
        return None
    try:
        factor = float(text)
    except ValueError:
        factor = 0.0
    if not LEAST_SPEED <= factor <= MOST_SPEED:
        raise failures.speed_unknown(
            text=text, least_speed=LEAST_SPEED, most_speed=MOST_SPEED, fastest=FASTEST
        )
    return factor


def _endpoint(
    link: Path | None, socket: str | None, secret_file: Path | None, *, allow_remote: bool
) -> "Callable[[Callable[[str], None]], Endpoint]":
    """Return what opens the socket, else a pty."""
    from edmctl.jobs.connect import read_secret
    from edmctl.simulator.serve import PtyEndpoint, SocketEndpoint, address_of, is_loopback

    if socket is None:
        if allow_remote or secret_file is not None:
            raise failures.remote_options_without_socket()
        return lambda _: PtyEndpoint(link)
    if link is not None:
        raise failures.link_and_socket()
    host, _, port = socket.rpartition(":")
    if not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise failures.socket_unreadable(text=socket)
    secret = b"" if secret_file is None else read_secret(secret_file)
    # What is checked is what is served on, whatever the name stands for later.
    address = address_of(host.strip("[]") or "127.0.0.1")
    if not is_loopback(address) and not (allow_remote and secret):
        raise failures.socket_open_to_others(text=socket)
    return lambda say: SocketEndpoint(address, int(port), say, secret)


def _injections(texts: list[str] | None) -> tuple["Injection", ...]:
    from edmctl.simulator.injection import parse_injection

    try:
        return tuple(parse_injection(text) for text in texts or ())
    except ValueError as error:
        raise failures.injection_unreadable(problem=error) from error
