"""The composition root: from a port selector to a machine that answers.

It stands here because `machine/` may not know the simulator, and the simulator shares nothing with the host
but the wire.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl.errors import Diagnostic, UsageError
from edmctl.files import path_variable, read_bytes
from edmctl.jobs.connected_machine import ConnectedMachine
from edmctl.jobs.plan import FRESH, MachineAddress, where_is
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.jobs.sweep import seed_to_use
from edmctl.planning.erosion import of_tool, of_work
from edmctl.process.erosion import ErosionLaw
from edmctl.process.gap_conditions import GapLaw
from edmctl.profile.folders import is_file, own_setup_path

if TYPE_CHECKING:
    from edmctl.link.transport import Transport
    from edmctl.machine.controller import LinkMachine
    from edmctl.planning.rules.load import LoadedProfile
    from edmctl.profile.setup import Setup
    from edmctl.simulator import BenchConfig, VirtualBench


def seed_warning(where: MachineAddress, asked: int | None) -> list[Diagnostic]:
    """Return what is to be said of a seed that no machine will use."""
    if asked is None or where.seed_of(asked) is not None:
        return []
    if where.in_process:
        message = f"Seed {asked} has no effect on the bench that {where.bench_file} keeps already."
        hint = "Leave it out, or name a new file for another machine."
    else:
        message = f"Seed {asked} has no effect on the controller at {where.selector}."
        hint = "Give the seed to `edmctl simulate serve` where the controller is a virtual one."
    return [Diagnostic("W4101", message, hint, is_warning=True)]


def controller_warning(where: MachineAddress, asked: str | None) -> list[Diagnostic]:
    """Return what is to be said of a `--controller` for a machine that is not in this process."""
    if not asked or where.in_process:
        return []
    message = f"--controller {asked} has no effect on the controller at {where.selector}."
    hint = "Give it to `edmctl simulate serve` where the controller is a virtual one."
    return [Diagnostic("W4102", message, hint, is_warning=True)]


@contextmanager
def connected(
    loaded: LoadedProfile | None,
    setup: Setup,
    seed: int,
    say: Callable[[str], None],
    where: MachineAddress = FRESH,
    surroundings: Surroundings = NONE,
    *,
    wires_known: bool = True,
) -> Iterator[ConnectedMachine]:
    """Open the machine and say hello. From then on `surroundings` may stop it in order, with a word to `say`.

    loaded : what stands on a virtual bench in this process; None where neither tool nor work matters. In a bench
    that a file keeps the tool is changed by `Bench.begin`.
    wires_known : what the machine tells is believed, and a tool that is out is waited for.

    Raises LinkLost and ProtocolMismatch.
    """
    from edmctl.link.session import Session
    from edmctl.machine.controller import LinkMachine

    line: Transport
    on: Callable[[LinkMachine], ConnectedMachine] = ConnectedMachine
    with ExitStack() as held:
        if where.in_process:
            line, on = held.enter_context(_virtual(loaded, setup, seed, say, where))
        else:
            line = line_to(where, setup, say, surroundings.environ)
        session = Session(line)
        held.callback(session.close)
        stop = surroundings.stop(say)
        session.open(setup.link.hello_s)
        with surroundings.guard(stop, session.abort):
            machine = LinkMachine(session, stop)
            if wires_known:
                machine.wait_for_rest()
            own = own_setup(where, setup, machine.identity.serial, surroundings.environ)
            yield replace(on(machine), own_setup=own)


def own_setup(where: MachineAddress, setup: Setup, serial: str, environ: Mapping[str, str]) -> Setup | None:
    """Return the setup in the file of the machine with that serial number, if none was named and there is one.

    A virtual machine in this process uses a setup only if it is named. Raises ProfileError.
    """
    path = own_setup_path(serial, environ)
    if where.in_process or setup.file is not None or not is_file(path):
        return None
    from edmctl.profile.setup import load_setup

    return load_setup(path)


def introduction(where: MachineAddress, bench: ConnectedMachine) -> str:
    """Return what is said of the machine at the start of a run."""
    identity, under = bench.machine.identity, driver(bench.virtual)
    if where.bench_file is not None:
        new = "" if bench.seed is None else f", new with seed {bench.seed}"
        return f"simulated run on the virtual machine {identity.serial} of {where.bench_file}{under}{new}"
    if where.in_process:
        return f"simulated run on the virtual machine{under}, seed {bench.seed}"
    if identity.simulated:
        return f"simulated run on the virtual controller {identity.serial} at {identity.transport}"
    return f"machine {identity.serial} at {identity.transport}, firmware {identity.firmware}"


def driver(bench: VirtualBench | None) -> str:
    """Return the words on what drives a virtual machine; none for the usual controller."""
    from edmctl.simulator.config import FIRMWARE

    kind = FIRMWARE if bench is None else bench.plant.config.controller
    return "" if kind == FIRMWARE else f" under the controller {kind}"


@contextmanager
def _virtual(
    loaded: LoadedProfile | None, setup: Setup, seed: int, say: Callable[[str], None], where: MachineAddress
) -> Iterator[tuple[Transport, Callable[[LinkMachine], ConnectedMachine]]]:
    """Open a virtual bench, fresh or that of a file: the line to it, and what it is with a machine behind that."""
    config, made_by = bench_config(loaded, setup), where.seed_of(seed)
    if where.controller:
        config = replace(config, controller=where.controller)
    if where.bench_file is None:
        from edmctl.simulator import open_bench

        fresh = open_bench(config, seed)
        yield fresh.direct_line(), lambda machine: ConnectedMachine(machine, fresh, made_by)
        return
    from edmctl.jobs.persistent_simulator import fit, kept_line

    with kept_line(where.bench_file, config, seed, where.wait_s) as (bench, line):

        def begin() -> None:
            if loaded is not None:
                fit(bench, loaded, config, say)
            line.begin()

        yield (
            line,
            lambda machine: ConnectedMachine(
                machine, bench, made_by, begin, line.keep_worn, line.keep_all, line.kept_s
            ),
        )


def known_controller(name: str) -> str:
    """Return what can drive a virtual machine. Raises UsageError E2049 for what cannot."""
    from edmctl.profile.model import CONTROLLER_SYNONYMS
    from edmctl.simulator.config import CONTROLLERS

    name = CONTROLLER_SYNONYMS.get(name, name)
    if name not in CONTROLLERS:
        raise UsageError(
            f"There is no controller {name}: it is one of {', '.join(CONTROLLERS)}.",
            hint="Name one of them, or leave it out.",
            code="E2049",
        )
    return name


def bench_config(loaded: LoadedProfile | None, setup: Setup) -> BenchConfig:
    """Put the profile's tool and work on a bench that erodes by its `[sim]` table, with or without a sensor."""
    from edmctl.simulator.config import BenchConfig, DischargeConstants, SensorConstants

    sensor = setup.sensor
    sensors = SensorConstants(
        fitted=sensor.fitted,
        noise_um=sensor.noise_um,
        gain_sd=sensor.gain_u_rel,
        nonlinearity_um=2.0 * sensor.linearity_u_um,
        drift_sd_um_s=sensor.drift_um_per_s,
        walk_um=setup.drift.walk_um_per_sqrt_s,
        tilt_sd_mrad=setup.surface.tilt_u_mrad,
        stage_sd_um=0.5 * setup.stage.repeatability_um,
    )
    if loaded is None:
        return BenchConfig(sensors=sensors)
    sim = loaded.sim
    drawn: dict[str, Any] = {
        "gain_sd": sim.sensor_gain_sd,
        "drift_sd_um_s": sim.sensor_drift_sd_um_s,
        "machine_drift_sd_um_s": sim.machine_drift_sd_um_s,
        "tilt_sd_mrad": sim.tilt_sd_mrad,
    }
    removal, wear = of_work(loaded.profile).factor, of_tool(loaded.profile).factor

    def part(kind: type[Any]) -> Any:
        names = [field.name for field in fields(kind)]
        return kind(**{name: getattr(sim, name) for name in names if hasattr(sim, name)})

    return BenchConfig(
        tool_diameter_um=loaded.profile.tool.diameter_um,
        work_removal=removal if sim.work_removal is None else sim.work_removal,
        tool_wear=wear if sim.tool_wear is None else sim.tool_wear,
        tool_negative=loaded.profile.pulse.polarity == "tool-negative",
        spread=sim.spread,
        controller=sim.controller,
        tool_label=loaded.profile.tool.label,
        tip_rounding_um=sim.tip_rounding_um,
        offset_um=loaded.profile.approach.offset_um,
        thickness_um=loaded.profile.work.thickness_um,
        discharge=replace(part(DischargeConstants), erosion=part(ErosionLaw), gap=part(GapLaw)),
        sensors=replace(sensors, **{name: sd for name, sd in drawn.items() if sd is not None}),
    )


def line_to(
    where: MachineAddress, setup: Setup, say: Callable[[str], None], environ: Mapping[str, str]
) -> Transport:
    """Open the line to a controller that is not in this process. Raises LinkLost, UsageError E2047."""
    from edmctl.link.probing import open_selector

    link = setup.link
    return open_selector(
        where.selector,
        link.usb_ids,
        link.candidates,
        link.baud,
        link.hello_s,
        where.wait_s,
        say,
        secret_of(link.secret_file, environ) if asks_for_secret(where.selector, *link.candidates) else b"",
    )


SEED = 1
"""Of a fresh virtual machine, which a question does not depend on. One that will be kept is any machine."""


@contextmanager
def machine_at(
    setup: Setup,
    port: str | None,
    wait_s: float,
    say: Callable[[str], None],
    surroundings: Surroundings,
) -> Iterator[ConnectedMachine]:
    """Connect to the machine that the option or the setup names.

    Raises LinkLost and ProtocolMismatch.
    """
    where = where_is(port, setup, wait_s)
    seed = SEED if where.bench_file is None else seed_to_use(None)
    with connected(None, setup, seed, say, where, surroundings) as bench:
        bench.begin()
        yield bench


SECRET_VARIABLE = "EDMCTL_SECRET_FILE"


def asks_for_secret(*ports: str) -> bool:
    """Whether one of the ports may ask for a secret."""
    from edmctl.link.ports import SOCKET, scheme_of

    return any(scheme_of(port) == SOCKET for port in ports)


def secret_of(named: str | None, environ: Mapping[str, str]) -> bytes:
    """Return the secret in the file that $EDMCTL_SECRET_FILE names, else in that `named`; empty without either."""
    path = path_variable(SECRET_VARIABLE, environ) or named
    return read_secret(Path(path)) if path else b""


def read_secret(path: Path) -> bytes:
    """Return what a secret file holds, without blanks about it.

    Raises UsageError E2047: it cannot be read, others may read it, or it is too short.
    """
    from edmctl.link.gate import LEAST_SECRET

    try:
        secret, mode = read_bytes(path).strip(), path.stat().st_mode
    except OSError as error:
        raise _unfit(f"Cannot read the secret file {path}: {error.strerror}.") from error
    if os.name == "posix" and mode & 0o077:
        raise _unfit(f"Others may read the secret file {path}.", f"`chmod 600 {path}`")
    if len(secret) < LEAST_SECRET:
        raise _unfit(f"The secret in {path} is shorter than {LEAST_SECRET} bytes.")
    return secret


def _unfit(message: str, remedy: str = "") -> UsageError:
    made = "`(umask 077; openssl rand -hex 32 > FILE)` makes one; the computers at both ends need the same."
    return UsageError(message, hint=remedy or made, code="E2047")
