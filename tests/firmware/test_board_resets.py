"""What the image on the emulated board makes of a reset that comes at the wrong moment, or finds memory spoilt."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator

import pytest

from edmctl.link.messages import ResetCause
from tests.conformance import acts, layouts, wire
from tests.conformance.peer import STATE, STATUS, Peer
from tests.conformance.test_delivery import REBOOT_MAGIC
from tests.firmware.test_board_faults import BACKUP_REGISTERS, ESTOP, FLASH_AT, PIEZO_TRACK, RESET, Rig
from tests.needs import EMULATOR

pytestmark = EMULATOR

RETREAT_MS = 1500  # of the start, so that ARM would be taken
IMAGE_CHECK_AT = 20  # in `edm_image`
SLEW_STEP_V = 0.5  # a millisecond of the usual retreat, and a bit of the amplifier's own lag


@pytest.fixture(scope="module")
def shared_rig() -> Rig:
    return Rig()


@pytest.fixture
def rig(shared_rig: Rig) -> Iterator[Rig]:
    """A board at rest, tool at 0 V. Whatever breaks, the image is without error to its chip."""
    shared_rig.mend()
    acts.settle(shared_rig.peer)
    shared_rig.peer.boots.clear()
    yield shared_rig
    unit = shared_rig.plant.unit
    unit.monitor_gain, unit.monitor_zero_v = 1.0, 0.0
    shared_rig.mend()
    assert shared_rig.chip.errors == (0, None)


def restart(rig: Rig, cause: ResetCause, ms: int = 30) -> list[float]:
    """Reset the chip; what its converter puts out, V, before it and with each millisecond that follows."""
    put_v = [float(rig.plant.drive.actuator_v)]
    rig.controller.reset(cause)
    for _ in range(ms):
        rig.controller.advance(1)
        put_v.append(float(rig.plant.drive.actuator_v))
    return put_v


def steps_of(put_v: list[float]) -> list[float]:
    return [after - before for before, after in itertools.pairwise(put_v)]


def extend(peer: Peer, volts: float) -> None:
    """Lead the tool out and leave it there."""
    acts.arm(peer)
    peer.ok("PIEZO_SET", actuator_v=volts, slew_v_s=100.0)
    peer.event("MOVE_DONE", 3.0)


# ------------------------------------------------------------------------------------------------------ the actuator
@pytest.mark.parametrize("cause", [ResetCause.EXTERNAL, ResetCause.WATCHDOG, ResetCause.BROWN_OUT])
def test_a_monitor_that_is_wrong_moves_no_tool_out(rig: Rig, cause: ResetCause) -> None:
    """The converter holds 0 V; what the monitor says is no reason to put it out."""
    rig.plant.unit.monitor_gain, rig.plant.unit.monitor_zero_v = 0.0, 140.0
    assert max(restart(rig, cause)) == 0.0
    rig.peer.hello()
    if cause is ResetCause.EXTERNAL:
        assert rig.peer.state() == "IDLE"
        assert rig.peer.command("ARM", param_crc=layouts.profile_crc()).status == STATUS["OK"]
        rig.peer.fault(1.0)
        assert rig.controller.fault == PIEZO_TRACK


@pytest.mark.parametrize(
    ("gain", "zero_v"), [(1.0, 0.0), (0.0, 0.3), (0.0, 140.0)], ids=["right", "0", "140"]
)
def test_a_tool_that_is_out_comes_back_by_its_ramp(rig: Rig, gain: float, zero_v: float) -> None:
    extend(rig.peer, 60.0)
    rig.plant.unit.monitor_gain, rig.plant.unit.monitor_zero_v = gain, zero_v
    put_v = restart(rig, ResetCause.EXTERNAL, 100)
    assert put_v[0] == 60.0
    assert all(-SLEW_STEP_V <= step <= 0.0 for step in steps_of(put_v)), steps_of(put_v)
    assert put_v[-1] < 60.0


def test_a_brown_out_that_took_the_converter_too_puts_out_nothing(rig: Rig) -> None:
    """It stands at 0 V then, as the monitor says; what the memory holds would be a step towards the work."""
    extend(rig.peer, 60.0)
    rig.plant.unit.monitor_gain = 0.0
    rig.controller.reset(ResetCause.BROWN_OUT)
    rig.chip.r[sys.modules[type(rig.chip).__module__].reg.DAC_CODE] = 0
    for _ in range(30):
        rig.controller.advance(1)
        assert rig.plant.drive.actuator_v == 0.0
    rig.peer.hello()


def test_a_place_that_did_not_last_is_no_place(rig: Rig) -> None:
    """One copy is enough; with none 0 V are put out, whatever the monitor reads."""
    extend(rig.peer, 60.0)
    rig.memory("kept_codes")[1] ^= 4
    assert all(-SLEW_STEP_V <= step <= 0.0 for step in steps_of(restart(rig, ResetCause.EXTERNAL, 10)))
    rig.peer.hello()
    acts.settle(rig.peer)
    extend(rig.peer, 60.0)
    for at in (1, 14):
        rig.memory("kept_codes")[at] ^= 4
    assert restart(rig, ResetCause.EXTERNAL, 10)[5:] == [0.0] * 6  # once the program is in its main loop
    rig.peer.hello()


@pytest.mark.parametrize("word", [0x0000FFFF, 0x00FFFF00, 0x102AEFD5, 0x15A0EA5F, 0, 0xFFFFFFFF])
def test_what_another_program_left_in_memory_is_no_place(rig: Rig, word: int) -> None:
    """A program that flashes works in this memory, and the image before had other things there: no power goes."""
    rig.memory("kept_codes").view("<u4")[:] = word
    assert max(restart(rig, ResetCause.EXTERNAL)) == 0.0
    rig.peer.hello()


def test_a_place_that_another_image_noted_is_no_place(rig: Rig) -> None:
    extend(rig.peer, 60.0)
    at = rig.chip.image.symbols["edm_image"][0] - FLASH_AT + IMAGE_CHECK_AT
    rig.chip.flash[at] ^= 1
    assert restart(rig, ResetCause.EXTERNAL, 10)[5:] == [0.0] * 6
    rig.peer.hello()


# -------------------------------------------------------------------------------------------------- nonces and fault
def recorded_session(rig: Rig) -> list[bytes]:
    """Frames that lead into a cut, as somebody on the line has heard them."""
    peer, sent = rig.peer, []
    write = peer.line.write

    def heard(data: bytes) -> None:
        sent.append(bytes(data))
        write(data)

    peer.line.write = heard  # type: ignore[method-assign]
    peer.hello()
    acts.arm(peer)
    peer.ok("PULSE_ENABLE", on=1)
    acts.servo_start(peer)
    peer.line.write = write  # type: ignore[method-assign]
    peer.pump(0.1)
    assert rig.pulses_on
    return sent


def replay(rig: Rig, frames: list[bytes]) -> int:
    """Say them again; how often pulses were started."""
    starts = rig.plant.drive.pulse_starts
    for data in frames:
        rig.peer.line.write(data)
        rig.controller.advance(3)
    rig.controller.advance(5)
    return int(rig.plant.drive.pulse_starts - starts)


@pytest.mark.parametrize("copy", [0, 1])
@pytest.mark.parametrize("bit", [0, 3, 5])
def test_one_bit_forgets_no_session(rig: Rig, copy: int, bit: int) -> None:
    frames = recorded_session(rig)
    memory = rig.memory("kept_words")
    half = len(memory) // 2
    memory[copy * half + 20 + bit] ^= 1 << bit
    rig.controller.reset(ResetCause.EXTERNAL)
    rig.controller.advance(RETREAT_MS)
    assert rig.controller.fault == 0
    assert replay(rig, frames) == 0
    assert rig.controller.state == STATE["IDLE"]
    rig.peer.hello()


def test_without_any_nonce_nothing_starts_before_somebody_has_looked(rig: Rig) -> None:
    frames = recorded_session(rig)
    memory = rig.memory("kept_words")
    memory[20] ^= 1
    memory[len(memory) // 2 + 20] ^= 1
    rig.controller.reset(ResetCause.EXTERNAL)
    rig.controller.advance(RETREAT_MS)
    assert replay(rig, frames) == 0
    assert rig.controller.fault == RESET
    rig.peer.hello()
    rig.latched(RESET)


def latch_an_emergency_stop(rig: Rig) -> None:
    rig.plant.estop = True
    rig.peer.pump(0.05)
    rig.plant.estop = False
    assert rig.controller.fault == ESTOP


def test_a_reset_between_two_stores_keeps_fault_and_boots(rig: Rig) -> None:
    """The registers are written in their order; at every place the copy before or the one behind is right."""
    latch_an_emergency_stop(rig)
    registers = rig.chip.r
    for count in range(9):
        before = registers[BACKUP_REGISTERS].copy()
        rig.peer.hello()  # which is kept: one more write of all
        after = registers[BACKUP_REGISTERS].copy()
        assert (before != after).any()
        boots = rig.controller.boot_count
        registers[BACKUP_REGISTERS][:count] = after[:count]
        registers[BACKUP_REGISTERS][count:] = before[count:]
        rig.controller.reset(ResetCause.EXTERNAL)
        rig.controller.advance(30)
        assert (rig.controller.fault, rig.controller.boot_count) == (ESTOP, boots + 1), count
    rig.peer.hello()


@pytest.mark.parametrize("register", range(8))
def test_one_wrong_register_loses_nothing(rig: Rig, register: int) -> None:
    latch_an_emergency_stop(rig)
    boots = rig.controller.boot_count
    rig.chip.r[BACKUP_REGISTERS][register] ^= 1 << 16
    rig.controller.reset(ResetCause.EXTERNAL)
    rig.controller.advance(30)
    assert (rig.controller.fault, rig.controller.boot_count) == (ESTOP, boots + 1)
    rig.peer.hello()


def test_a_reset_while_a_fault_is_being_latched_leaves_one(rig: Rig) -> None:
    """The first store is of the fault: from there on one is latched, its own number or 5001."""
    registers = rig.chip.r
    before = registers[BACKUP_REGISTERS].copy()
    latch_an_emergency_stop(rig)
    after = registers[BACKUP_REGISTERS].copy()
    for count in range(1, 9):
        registers[BACKUP_REGISTERS][:count] = after[:count]
        registers[BACKUP_REGISTERS][count:] = before[count:]
        rig.controller.reset(ResetCause.EXTERNAL)
        rig.controller.advance(30)
        assert rig.controller.fault == (RESET if count < 4 else ESTOP), count
    rig.peer.hello()


# ------------------------------------------------------------------------------------------------------------ REBOOT
def ms_until_reset(rig: Rig, most: int) -> int:
    """Milliseconds from REBOOT on the line to the reset of the chip."""
    before = len(rig.chip.resets)
    rig.peer.send("REBOOT", magic=REBOOT_MAGIC)
    for ms in range(most):
        rig.controller.advance(1)
        if len(rig.chip.resets) > before:
            assert rig.chip.resets[-1].name == "SOFTWARE"
            return ms
    raise AssertionError(f"no reset within {most} ms")


@pytest.mark.parametrize("period_us", [0, 1000], ids=["no telemetry", "1 kHz"])
def test_a_reboot_waits_for_its_reply_and_for_nothing_else(rig: Rig, period_us: int) -> None:
    if period_us:
        rig.peer.ok("TLM_START", period_us=period_us, batch=1, pulse_log=0)
        rig.peer.pump(0.05)
    rig.peer.frames.clear()
    assert ms_until_reset(rig, 150) <= 10
    rig.peer.pump(0.05)
    replies = [frame for frame in rig.peer.frames if frame.type_id == layouts.NAMES["REBOOT"] | wire.REPLY]
    assert len(replies) == 1
    rig.boot_tells("COMMANDED")
    rig.peer.hello()
