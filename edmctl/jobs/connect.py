"""Connect to a machine by its port selector.

This is the only place that knows both sides: `machine/` does not import the simulator, and the simulator shares
only the wire with the host.
"""

from __future__ import annotations

import glob
import json
import os
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from edmctl import failures
from edmctl.errors import Diagnostic, UsageError
from edmctl.files import json_of, path_variable, read_bytes
from edmctl.jobs.connected_machine import ConnectedMachine
from edmctl.jobs.plan import FRESH, MachineAddress, where_is
from edmctl.jobs.surroundings import NONE, Surroundings
from edmctl.jobs.sweep import seed_to_use
from edmctl.link.ports import SOCKET, PortInfo, scheme_of
from edmctl.planning.removal import of_tool, of_work
from edmctl.planning.rules.load import LoadedProfile
from edmctl.process.erosion import ErosionLaw, GapLaw
from edmctl.profile.folders import data_folder, is_file, own_setup_path
from edmctl.profile.setup import Setup, load_setup
from edmctl.record.locks import is_alive

if TYPE_CHECKING:
    from edmctl.link.transport import Transport
    from edmctl.machine.controller import LinkMachine
    from edmctl.simulator import BenchConfig, VirtualBench


def seed_warning(where: MachineAddress, asked: int | None) -> list[Diagnostic]:
    """Return a warning (W4101) if no machine will use the seed."""
    if asked is None or where.seed_of(asked) is not None:
        return []
    if where.in_process:
        return [failures.seed_without_effect_on_bench(seed=asked, file=where.bench_file)]
    return [failures.seed_without_effect_at_port(seed=asked, port=where.selector)]


def controller_warning(where: MachineAddress, asked: str | None) -> list[Diagnostic]:
    """Return a warning (W4102) if `--controller` has no effect."""
    if not asked or where.in_process:
        return []
    return [failures.controller_option_without_effect(asked=asked, selector=where.selector)]


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
            own = own_setup(where, setup, machine.identity.serial, surroundings.environ)
            yield replace(on(machine), own_setup=own)


def own_setup(where: MachineAddress, setup: Setup, serial: str, environ: Mapping[str, str]) -> Setup | None:
    """Return the setup in the file of the machine with that serial number, if none was named and there is one.

    A virtual machine in this process uses a setup only if it is named. Raises ProfileError.
    """
    path = own_setup_path(serial, environ)
    if where.in_process or setup.file is not None or not is_file(path):
        return None
    return load_setup(path)


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

        yield (
            line,
            lambda machine: ConnectedMachine(
                machine, bench, made_by, begin, line.keep_worn, line.keep_all, line.kept_s
            ),
        )


def known_controller(name: str) -> str:
    """Return the name of a controller. Raises UsageError E2049 if it is unknown."""
    from edmctl.simulator.config import CONTROLLERS

    if name not in CONTROLLERS:
        raise failures.controller_unknown(name=name, controllers=", ".join(CONTROLLERS))
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
    """Whether a port may require a secret."""
    return any(scheme_of(port) == SOCKET for port in ports)


def secret_of(named: str | None, environ: Mapping[str, str]) -> bytes:
    """Return the secret in the file that $EDMCTL_SECRET_FILE names, else in that `named`; empty without either."""
    path = path_variable(SECRET_VARIABLE, environ) or named
    return read_secret(Path(path)) if path else b""


def read_secret(path: Path) -> bytes:
    """Return the content of a secret file without surrounding blanks.

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
    return failures.secret_file_unusable(problem=message, remedy=remedy or made)


@contextmanager
def announced(port: str, serial: str, environ: Mapping[str, str]) -> Iterator[None]:
    """Announce a served port during a `with` block, if the note can be written."""
    note = _folder(environ) / f"{socket.gethostname()}-{os.getpid()}.json"
    with suppress(OSError):
        note.parent.mkdir(parents=True, exist_ok=True)
        where = port if "://" in port else str(Path(port).absolute())
        note.write_text(json.dumps({"port": where, "serial": serial}), encoding="utf-8")
    try:
        yield
    finally:
        with suppress(OSError):
            note.unlink()
            note.parent.rmdir()  # unless others serve too
            note.parent.parent.rmdir()  # unless anything else is kept there


def served_ports(environ: Mapping[str, str]) -> list[PortInfo]:
    """Return the ports that living processes of this user serve; notes that a killed one has left are removed."""
    found = []
    with suppress(OSError):
        # A home may be that of several computers: what another one serves is neither here nor gone.
        for note in sorted(_folder(environ).glob(f"{glob.escape(socket.gethostname())}-*.json")):
            noted, number = _read(note), note.stem.rpartition("-")[2]
            if noted is None or not (number.isascii() and number.isdigit() and is_alive(int(number))):
                with suppress(OSError):
                    note.unlink()
            else:
                found.append(PortInfo(noted[0], f"virtual controller {noted[1]}, served by process {number}"))
    return found


def _folder(environ: Mapping[str, str]) -> Path:
    return data_folder(environ) / "served"


def _read(note: Path) -> tuple[str, str] | None:
    try:
        noted = json_of(read_bytes(note))
        return str(noted["port"]), str(noted["serial"])
    except (OSError, ValueError, TypeError, KeyError):
        return None
