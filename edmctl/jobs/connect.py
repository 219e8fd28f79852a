"""Connect to a machine by its port selector.

This is the only place that knows both sides: `machine/` does not import the simulator, and the simulator shares
only the wire with the host.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.dataclasses import replace
from edmctl.errors import Diagnostic
from edmctl.files import path_variable, read_bytes
from edmctl.jobs.connected_machine import ConnectedMachine
from edmctl.jobs.plan import FRESH, MachineAddress, where_is
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.jobs.sweep import seed_to_use
from edmctl.link.ports import SOCKET, scheme_of
from edmctl.planning.removal import of_tool, of_work
from edmctl.planning.rules.load import LoadedProfile
from edmctl.process.erosion import ErosionLaw, GapLaw
from edmctl.profile.folders import is_file, own_setup_path
from edmctl.profile.setup import Setup, load_setup

if TYPE_CHECKING:
    from edmctl.link.transport import Transport
    from edmctl.machine.controller import LinkMachine
    from edmctl.simulator import BenchConfig, VirtualBench

SEED = 1
"""Of a new virtual machine whose answers do not depend on its seed."""
SECRET_VARIABLE = "EDMCTL_SECRET_FILE"


def seed_warning(where: MachineAddress, seed: int | None) -> list[Diagnostic]:
    """Return a warning (W4101) if no machine will use the seed."""
    if seed is None or where.seed_of(seed) is not None:
        return []
    if where.in_process:
        return [failures.seed_without_effect_on_bench(seed=seed, file=where.bench_file)]
    return [failures.seed_without_effect_at_port(seed=seed, port=where.selector)]


def controller_warning(where: MachineAddress, controller: str | None) -> list[Diagnostic]:
    """Return a warning (W4102) if `--controller` has no effect."""
    if not controller or where.in_process:
        return []
    return [failures.controller_option_without_effect(asked=controller, selector=where.selector)]


def known_controller(name: str) -> str:
    """Return the name of a controller. Raises UsageError E2049 if it is unknown."""
    from edmctl.simulator.config import CONTROLLERS

    if name not in CONTROLLERS:
        raise failures.controller_unknown(name=name, controllers=", ".join(CONTROLLERS))
    return name


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
    """Open the machine and exchange hello. From then on `surroundings` may stop it in order.

    loaded : what is on a new virtual bench; None if neither tool nor workpiece matters
    say : prints a note
    wires_known : trust the machine's state, and wait until an extended tool is retracted

    Raises LinkLost and ProtocolMismatch.
    """
    from edmctl.link.session import LATE_BEAT_S, Session
    from edmctl.machine.controller import LinkMachine

    line: Transport
    on: Callable[[LinkMachine], ConnectedMachine] = ConnectedMachine
    with ExitStack() as held:
        if where.in_process:
            line, on = held.enter_context(_virtual(loaded, setup, seed, say, where))
        else:
            line = line_to(where, setup, say, surroundings.environ)
        session = Session(line, first_beat_s=LATE_BEAT_S)
        held.callback(session.close)
        stop = surroundings.stop(say)
        session.open(setup.link.hello_s)
        with surroundings.guard(stop, session.abort):
            machine = LinkMachine(session, stop)
            if wires_known:
                machine.wait_for_rest()
            own_setup = None
            if not (where.in_process or setup.file is not None):
                path = own_setup_path(machine.identity.serial, surroundings.environ)
                own_setup = load_setup(path) if is_file(path) else None
            yield replace(on(machine), own_setup=own_setup)


@contextmanager
def machine_at(
    setup: Setup, port: str | None, wait_s: float, say: Callable[[str], None], surroundings: Surroundings
) -> Iterator[ConnectedMachine]:
    """Connect to the machine that the option or the setup names. Raises LinkLost and ProtocolMismatch."""
    where = where_is(port, setup, wait_s)
    seed = SEED if where.bench_file is None else seed_to_use(None)
    with connected(None, setup, seed, say, where, surroundings) as bench:
        bench.begin()
        yield bench


def introduction(where: MachineAddress, bench: ConnectedMachine) -> str:
    """Return the description of the machine that is printed at the start of a run."""
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
    """Return the words for an unusual controller of a virtual machine, else an empty text."""
    from edmctl.simulator.config import FIRMWARE

    kind = FIRMWARE if bench is None else bench.plant.config.controller
    return "" if kind == FIRMWARE else f" under the controller {kind}"


@contextmanager
def _virtual(
    loaded: LoadedProfile | None, setup: Setup, seed: int, say: Callable[[str], None], where: MachineAddress
) -> Iterator[tuple[Transport, Callable[[LinkMachine], ConnectedMachine]]]:
    """Open a virtual bench; give its line and a function that describes the connected machine."""
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

        kept = (begin, line.keep_worn, line.keep_all, line.kept_s)
        yield line, lambda machine: ConnectedMachine(machine, bench, made_by, *kept)


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
    profile, sim = loaded.profile, loaded.sim
    stated: dict[str, Any] = {
        "gain_sd": sim.sensor_gain_sd,
        "drift_sd_um_s": sim.sensor_drift_sd_um_s,
        "machine_drift_sd_um_s": sim.machine_drift_sd_um_s,
        "tilt_sd_mrad": sim.tilt_sd_mrad,
    }
    removal, wear = of_work(profile).factor, of_tool(profile).factor

    def part(kind: type[Any]) -> Any:
        names = [field.name for field in fields(kind)]
        return kind(**{name: getattr(sim, name) for name in names if hasattr(sim, name)})

    return BenchConfig(
        tool_diameter_um=profile.tool.diameter_um,
        work_removal=removal if sim.work_removal is None else sim.work_removal,
        tool_wear=wear if sim.tool_wear is None else sim.tool_wear,
        tool_negative=profile.pulse.polarity == "tool-negative",
        spread=sim.spread,
        controller=sim.controller,
        tool_label=profile.tool.label,
        tip_rounding_um=sim.tip_rounding_um,
        offset_um=profile.approach.offset_um,
        thickness_um=profile.work.thickness_um,
        discharge=replace(part(DischargeConstants), erosion=part(ErosionLaw), gap=part(GapLaw)),
        sensors=replace(sensors, **{name: sd for name, sd in stated.items() if sd is not None}),
    )


def line_to(
    where: MachineAddress, setup: Setup, say: Callable[[str], None], environ: Mapping[str, str]
) -> Transport:
    """Open the line to a controller that is not in this process. Raises LinkLost, UsageError E2047."""
    from edmctl.link.probing import open_selector

    link = setup.link
    secret = secret_for((where.selector, *link.candidates), link.secret_file, environ)
    ports = (where.selector, link.usb_ids, link.candidates)
    return open_selector(*ports, link.baud, link.hello_s, where.wait_s, say, secret)


def secret_for(ports: Sequence[str], named: str | None, environ: Mapping[str, str]) -> bytes:
    """Return the secret in the file that $EDMCTL_SECRET_FILE names, else in that `named`.

    It is empty without either, and if no port may require one. Raises UsageError E2047.
    """
    if all(scheme_of(port) != SOCKET for port in ports):
        return b""
    path = path_variable(SECRET_VARIABLE, environ) or named
    return read_secret(Path(path)) if path else b""


def read_secret(path: Path) -> bytes:
    """Return the content of a secret file without surrounding blanks."""
    from edmctl.link.gate import LEAST_SECRET

    remedy = "`(umask 077; openssl rand -hex 32 > FILE)` makes one; the computers at both ends need the same."
    try:
        secret, mode = read_bytes(path).strip(), path.stat().st_mode
    except OSError as error:
        problem = f"Cannot read the secret file {path}: {error.strerror}."
        raise failures.secret_file_unusable(problem=problem, remedy=remedy) from error
    if os.name == "posix" and mode & 0o077:
        problem, remedy = f"Others may read the secret file {path}.", f"`chmod 600 {path}`"
    elif len(secret) < LEAST_SECRET:
        problem = f"The secret in {path} is shorter than {LEAST_SECRET} bytes."
    else:
        return secret
    raise failures.secret_file_unusable(problem=problem, remedy=remedy)
