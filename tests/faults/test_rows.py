"""Every row of the faults, from the command line: brought about, named, in time, safe, repaired, and machined on."""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from edmctl.link.faults import FAULTS, FaultRow
from edmctl.link.messages import State
from edmctl.record import disk, writer
from edmctl.record.rows import RunEvent
from tests.cli.commands import CU270, Here, Said
from tests.faults.workshop import Workshop
from tests.tiers import tiers

QUICK = (
    'target={kind="depth",depth_um=6.0,tolerance_um=5.0}',
    'jump.mode="off"',
    'log.pulses="off"',
    "approach.speed_um_s=5.0",
    "measure.settle_s=0.2",
    "measure.touches=1",
    "measure.dwell_s=0.1",
    "measure.fast_um_s=50.0",
    "measure.site_dx_um=400.0",
    "pulse.current_a=0.5",
    "wear.max_cuts=1",
)
SETUP = "[stage]\npark_x_um = -5000.0\nspeed_um_s = 50000.0\n[actuator]\nconditioning_slew_v_s = 50.0\n"
UNCONDITIONED = SETUP + "conditioning_cycles = 0\n"
CONDITIONED = SETUP + "conditioning_cycles = 1\n"

ROWS = list(FAULTS.values())
DEFAULT = [*ROWS[::4], next(row for row in ROWS if row.name == "LOG")]
SAMPLE = tiers(*DEFAULT, slow=[row for row in ROWS if row not in DEFAULT])

HOST_GRANULARITY_S = 0.2
"""A host looks ten times a second, on samples that are as old."""

WAYS: dict[str, tuple[str, ...]] = {
    "TRAVEL_LIMIT": ("limits.stroke_v_max=27.0", "servo.forward_um_s=20.0", "servo.back_um_s=20.0"),
    "NO_SPARK": ('target={kind="depth",depth_um=30.0,tolerance_um=5.0}',),
    "Z_MISMATCH": ('target={kind="depth",depth_um=60.0,tolerance_um=5.0}',),
    "STROKE_END": ("limits.stroke_v_max=44.0", "approach.max_travel_um=60.0"),
    "SETUP": ('target={kind="depth",depth_um=20.0,tolerance_um=5.0}',),
    "TIMEOUT": ("limits.max_time_s=20.0",),
}
"""What some rows need of the recipe."""
INJECTIONS = {"STROKE_END": "ACTUATOR_WEAK@arm+0", "TIMEOUT": "", "LOG": ""}
NEEDS_SWINGS = ("COLLISION", "STROKE_END")
SHOWS_LATER = ("TRAVEL_LIMIT", "STAGE_LIMIT", "COLLISION")
"""What is wrong in these from the arming on is met only on the way."""
DECISIONS = {
    "Z_MISMATCH": RunEvent.Z_MISMATCH,
    "SETUP": RunEvent.SETUP_WRONG,
    "STROKE_END": RunEvent.CUT_GIVEN_UP,
}
"""What the host sees first in rows of its own whose cause grows slowly."""


@pytest.fixture
def machine_with(
    here: Here, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., tuple[Workshop, Callable[..., Said]]]:
    """Return a maker of a workshop and of the command that machines in it."""

    def make(inject: str, *, fine: bool, latent: bool, setup: str) -> tuple[Workshop, Callable[..., Said]]:
        workshop = Workshop(inject, fine=fine, latent=latent)
        monkeypatch.setattr("edmctl.simulator.open_bench", workshop)
        setup_file = tmp_path / "setup.toml"
        setup_file.write_text(setup)

        def machine(*overrides: str, more: tuple[str, ...] = ()) -> Said:
            options = [word for value in (*QUICK, *overrides) for word in ("--set", value)]
            return here(
                "machine",
                "--profile",
                CU270,
                *options,
                "--setup",
                str(setup_file),
                "--seed",
                "1",
                "--json",
                *more,
            )

        return workshop, machine

    return make


def told(row: FaultRow) -> str:
    """The beginning of a row's message, before its first figure."""
    return row.message.split("{", maxsplit=1)[0].removesuffix(".")


def machined_after(run_file: Path, code: RunEvent) -> float:
    """How long a run machined on after its first event of this kind, s."""
    with h5py.File(run_file) as run:
        events, servo = run["/entry/events"][()], run["/entry/servo"]
        first_s = events["time"][events["code"] == code].min()
        times_s = servo["time"][()][servo["state"][()] == State.MACHINING]
    return max(0.0, float(times_s.max() - first_s))


TRIED_AGAIN = {"ARC_BURN"}
"""Faults that the host clears some times and goes on after, before it gives up."""


@pytest.mark.parametrize("row", SAMPLE, ids=lambda row: row.name)
def test_a_row_is_told_in_time_and_safely_and_the_machine_goes_on_after_it(
    row: FaultRow,
    machine_with: Callable[..., tuple[Workshop, Callable[..., Said]]],
    here: Here,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    swings = row.name in NEEDS_SWINGS
    workshop, machine = machine_with(
        INJECTIONS.get(row.name, row.inject),
        fine=row.who == "controller",
        latent=row.name in SHOWS_LATER,
        setup=CONDITIONED if swings else UNCONDITIONED,
    )
    more: tuple[str, ...] = ()
    if row.name == "Z_MISMATCH":
        more = ("--calibration", str(request.getfixturevalue("calibration")))
    with monkeypatch.context() as patch:
        if row.name == "LOG":
            patch.setattr(writer, "FLUSH_INTERVAL_S", 0.0)
            patch.setattr(disk, "reserve", full_while_machining(workshop, patch))
        said = machine(*WAYS.get(row.name, ()), more=more)

    error = said.document["error"]
    assert (said.exit_code, error["code"]) == (row.exit_code, row.error), error
    if row.exit_code in (6, 7):
        assert told(row) in error["message"]
        assert row.hint.removesuffix(".") in error["hint"]
    assert (f"`edmctl reset --ack {row.code}`" in error["hint"]) == (row.latched and row.exit_code == 6)
    if row.name in DECISIONS:
        after_s = machined_after(Path(said.document["run_file"]), DECISIONS[row.name])
    elif row.name in TRIED_AGAIN:
        after_s = workshop.pulses_off_after_s
    else:
        after_s = workshop.pulses_after_cause_s
    assert after_s <= row.pulses_off_s + (HOST_GRANULARITY_S if row.who == "host" else 0.0)
    assert_retracts(workshop)

    workshop.repair()
    if row.latched:
        refused = machine()
        assert (refused.exit_code, refused.document["error"]["code"]) == (8, "E8010")
        assert f"edmctl reset --ack {row.code}" in refused.document["error"]["hint"]
        cleared = here("reset", "--ack", str(row.code))
        assert cleared.exit_code == 0, cleared.err
    # Beside the hole that the fault has left: from a bottom that nobody expects no depth would be shown.
    again = machine("measure.site_dx_um=800.0")
    assert again.exit_code == 0, again.err


def assert_retracts(workshop: Workshop) -> None:
    """Pulses off, and the tool at 0 V as soon as it can be, with nobody at the line."""
    controller = workshop.bench.controller
    assert not controller.plant.drive.pulses_on
    controller.advance(1000)
    assert not controller.plant.drive.pulses_on
    assert controller.loop.command_v == 0.0
    assert controller.state in (State.IDLE, State.FAULT, State.ESTOP)


def full_while_machining(workshop: Workshop, patch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A disk that fills up in the middle of a cut, which waits for whoever writes to find that out."""
    is_full, look = threading.Event(), workshop.look

    def is_machining() -> bool:
        return bool(workshop.bench.controller.state is State.MACHINING)

    def look_and_wait() -> None:
        look()
        if is_machining():
            is_full.wait(0.05)

    def reserve(*_: object) -> None:
        if is_machining():
            is_full.set()
            raise OSError(errno.ENOSPC, "No space left on device")

    patch.setattr(workshop, "look", look_and_wait)
    return reserve
