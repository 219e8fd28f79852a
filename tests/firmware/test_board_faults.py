"""The image on the emulated board in a running cut, and what breaks: pulses off, cause told, latched, tool back."""

from __future__ import annotations

import importlib
import itertools
import sys
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import pytest

from edmctl.link.messages import ResetCause
from tests.conformance import acts, layouts
from tests.conformance.lines import STM32, InProcess
from tests.conformance.peer import STATE, STATUS, Peer
from tests.needs import EMULATOR

pytestmark = EMULATOR

CAUSE = layouts.enum("ResetCause")
CRASH_MEMORY, CRASH_BUS, CRASH_USAGE, CRASH_SUPPLY = 3, 4, 5, 7  # enum crash of board.h
ABORT_RUN, PIEZO_TRACK, PIEZO_OV, STUCK_CONTACT = 1002, 2002, 2003, 2006
GAP_SENSOR, GEN_FAULT, NO_SPARK, ESTOP, DOOR, RESET = 3003, 3004, 3005, 4001, 4002, 5001
SPARE_FLASH_AT = 0x08100000
FLASH_AT, SRAM_AT, CCM_AT = 0x08000000, 0x20000000, 0x10000000
HANGS = bytes.fromhex("62b6 fee7")  # cpsie i; b .
HANGS_WITH_INTERRUPTS_OFF = bytes.fromhex("72b6 fee7")
RECURSES = bytes.fromhex("62b6 ffb5 fde7")  # push {r0-r7, lr} for ever
TAKES_1100_BYTES = bytes.fromhex("adf2 4c4d 0090 0df2 4c4d 7047")  # sub sp; str r0, [sp]; add sp; bx lr
READS_NOWHERE = bytes.fromhex("4ff0c040 0068")  # mov.w r0, #0x60000000; ldr r0, [r0]
JUMP = {"height_um": 1.0, "speed_um_s": 50.0, "dwell_s": 0.1, "clearance_um": 0.0}
UNDEFINED = bytes.fromhex("00de")
RETURNS = bytes.fromhex("7047")
BACKUP_REGISTERS = slice(
    10 * 0x100 + (0x50 >> 2), 10 * 0x100 + (0x70 >> 2)
)  # of the RTC, in the emulator's words
WWDG_TICKS = 3  # 1.56 ms after the last feed, in whole ticks from the one that was fed last


def registers_of(rig: Rig) -> Any:
    """The module of the emulator with the numbers of the chip's registers."""
    return sys.modules[rig.controller._loop.__globals__["run"].__module__].reg


def emulator_of(part: object) -> Any:
    """The module of the emulator that a part of it comes from."""
    return sys.modules[type(part).__module__]


class Rig:
    """A board in a cut, its host, and the hands that break it."""

    def __init__(self) -> None:
        self.line = InProcess(STM32)
        self.peer = Peer(self.line)
        self.controller = self.line.bench.controller
        self.bench, self.chip, self.plant = (
            self.controller.bench,
            self.controller.chip,
            self.controller.plant,
        )
        self.flash = self.chip.flash.copy()

    def mend(self) -> None:
        """Everything as it was built."""
        self.chip.flash[:] = self.flash
        self.chip._engine.ctl_flush_tb()
        bench = self.bench
        bench.over_current = bench.line_low = bench.adc_stuck = bench.slow_stuck = bench.dac_dead = 0
        bench.chatters = bench.chain_ms = bench.supply_low = bench.halted = 0
        bench.input_ms = emulator_of(bench).INPUT_MS
        self.plant.estop = self.plant.door_open = False

    def cut(self) -> None:
        """Lead into a cut whose pulses strike."""
        self.mend()
        acts.settle(self.peer)
        acts.start_sparks(self.peer)
        assert self.peer.wait(lambda: self.plant.readings.charge_uc > 0.0, 2.0, 0.001)
        self.peer.boots.clear()
        assert self.controller.state == STATE["MACHINING"]
        assert self.pulses_on

    @property
    def pulses_on(self) -> bool:
        return bool(self.plant.drive.pulses_on)

    def memory(self, name: str) -> Any:
        """Bytes of a variable of the image."""
        at, size = self.chip.image.symbols[name]
        if at >= SRAM_AT:
            return self.chip.sram[at - SRAM_AT :][:size]
        return self.chip.ccm[at - CCM_AT :][:size]

    def patch(self, at: int | str, code: bytes) -> None:
        """Put other instructions into the flash."""
        place = (self.chip.image.symbols[at][0] & ~1 if isinstance(at, str) else at) - FLASH_AT
        self.chip.flash[place : place + len(code)] = list(code)
        self.chip._engine.ctl_flush_tb()

    def derail(self, code: bytes) -> None:
        """Let the main loop go on with other instructions from the next tick on."""
        self.patch(SPARE_FLASH_AT, code)
        self.chip.core[emulator_of(self.chip).PC] = SPARE_FLASH_AT

    def ticks_until_off(self, most: int) -> int:
        """Whole milliseconds in which pulses could still begin; each is looked at."""
        for n in range(most + 1):
            self.controller.advance(1)
            if not self.pulses_on:
                return n
        raise AssertionError(f"pulses after {most} ms")

    def reset_within(self, ticks: int) -> str:
        """Let time pass until the chip has been reset; its cause."""
        before = len(self.chip.resets)
        for _ in range(ticks):
            self.controller.advance(1)
            if len(self.chip.resets) > before:
                assert len(self.chip.resets) == before + 1
                return str(self.chip.resets[-1].name)
        raise AssertionError(f"no reset within {ticks} ms")

    def starts_anew(self, cause: str = "WATCHDOG", *, moves: bool = True) -> None:
        """Mended, it tells the cause of its reset by one BOOT and has the fault of a reset."""
        self.mend()
        self.boot_tells(cause)
        self.peer.hello()
        self.latched(RESET, moves=moves)

    def boot_tells(self, cause: str) -> None:
        """Nothing but one BOOT, of that cause."""
        assert self.peer.wait(lambda: self.peer.boots, 0.5, 0.001)
        assert [boot["reset_cause"] for boot in self.peer.boots] == [CAUSE[cause]]

    def latched(self, code: int, *, moves: bool = True) -> None:
        """A fault holds, and nothing but CLEAR_FAULT with its number ends it, once the tool is back."""
        peer, starts = self.peer, self.plant.drive.pulse_starts
        status = peer.ok("GET_STATUS")
        assert status.fault == code
        assert status.state == STATE["ESTOP" if code == ESTOP else "FAULT"]
        peer.refused("ARM", "BAD_STATE", param_crc=layouts.profile_crc())
        peer.refused("PULSE_ENABLE", "BAD_STATE", on=1)
        assert (
            peer.command("SERVO_START", gap_ref_v=20.0, z_limit_um=10.0, max_time_s=1.0).status
            != STATUS["OK"]
        )
        peer.refused("CLEAR_FAULT", "OUT_OF_RANGE", fault=code + 1)
        if moves:
            assert peer.wait(lambda: self.plant.state.amplifier_v < 0.5, 3.0)
        assert peer.ok("GET_STATUS").fault == code
        self.mend()
        peer.pump(0.1)  # with everything mended, it holds still
        assert peer.ok("GET_STATUS").fault == code
        acts.clear(peer)
        assert peer.state() == "IDLE"
        peer.pump(0.1)
        assert self.plant.drive.pulse_starts == starts
        assert not self.pulses_on


@pytest.fixture(scope="module")
def shared_rig() -> Rig:
    return Rig()


@pytest.fixture
def rig(shared_rig: Rig) -> Iterator[Rig]:
    """A board in a running cut. Whatever breaks, the image is without error to its chip."""
    shared_rig.cut()
    yield shared_rig
    shared_rig.mend()
    assert shared_rig.chip.errors == (0, None)


# ------------------------------------------------------------------------------------------ faults of the program
def hang_in_the_handler_of_a_fault(rig: Rig) -> None:
    rig.patch("startup_crash", UNDEFINED)
    rig.derail(UNDEFINED)


def halt_by_a_debugger(rig: Rig) -> None:
    """OpenOCD sets the bits of both watchdogs when it comes: the image takes them away."""
    rig.chip.r[registers_of(rig).DEBUG_FREEZE] = 1 << 11 | 1 << 12 | 1 << 5
    rig.controller.advance(2)
    assert rig.chip.r[registers_of(rig).DEBUG_FREEZE] == 1 << 5
    rig.bench.halted = 1


HANGS_OF: dict[str, tuple[Callable[[Rig], None], int]] = {
    "main loop": (lambda rig: rig.derail(HANGS), 1),
    "interrupts off": (lambda rig: rig.derail(HANGS_WITH_INTERRUPTS_OFF), 2),
    "tick": (lambda rig: rig.patch("main_tick", HANGS[2:]), 1),
    "handler of a fault": (hang_in_the_handler_of_a_fault, 2),
    "debugger": (halt_by_a_debugger, 1),
}
"""Programs that go on no more, and in which millisecond the gate is off."""


@pytest.mark.parametrize("name", HANGS_OF)
def test_a_program_that_hangs_loses_the_gate_and_is_ended_by_the_watchdog(rig: Rig, name: str) -> None:
    hang, off_after = HANGS_OF[name]
    hang(rig)
    resets = len(rig.chip.resets)
    assert rig.ticks_until_off(3) == off_after
    rig.controller.advance(0 if len(rig.chip.resets) > resets else WWDG_TICKS)
    assert [reset.name for reset in rig.chip.resets[resets:]] == ["WINDOW_WATCHDOG"]
    rig.starts_anew()


@pytest.mark.parametrize(
    ("code", "crash"),
    [(RECURSES, CRASH_MEMORY), (READS_NOWHERE, CRASH_BUS), (UNDEFINED, CRASH_USAGE)],
    ids=["stack", "address", "instruction"],
)
def test_a_program_that_faults_is_off_at_once_and_started_anew(rig: Rig, code: bytes, crash: int) -> None:
    at, end = (rig.chip.image.symbols[name][0] - SRAM_AT for name in ("guard_begin", "guard_end"))
    guard = rig.chip.sram[at:end].copy()
    rig.derail(code)
    assert rig.ticks_until_off(1) == 0
    assert rig.chip.resets[-1].name == "SOFTWARE"
    assert (rig.chip.sram[at:end] == guard).all()
    rig.starts_anew()
    assert rig.memory("crash_before").view("<u4")[0] == crash


@pytest.mark.parametrize("code", [RECURSES[2:], TAKES_1100_BYTES], ids=["for ever", "a little"])
def test_a_tick_beyond_its_stack_is_off_at_once(rig: Rig, code: bytes) -> None:
    """It does not write into the main loop's."""
    at = rig.chip.image.symbols["guard_end"][0] - SRAM_AT  # nothing comes so deep
    rig.chip.sram[at : at + 64] = 0xA5
    rig.patch("main_tick", code)
    assert rig.ticks_until_off(1) == 0
    assert rig.chip.resets[-1].name == "SOFTWARE"
    assert (rig.chip.sram[at : at + 64] == 0xA5).all()
    rig.starts_anew()
    assert rig.memory("crash_before").view("<u4")[0] == CRASH_MEMORY


def test_a_program_that_faults_again_and_again_never_switches_on(rig: Rig) -> None:
    rig.patch("edm_tick_begin", UNDEFINED)
    assert rig.ticks_until_off(1) == 0
    starts, resets = rig.plant.drive.pulse_starts, len(rig.chip.resets)
    for _ in range(40):
        rig.controller.advance(1)
        assert not rig.pulses_on
    assert len(rig.chip.resets) > resets + 5
    assert rig.plant.drive.pulse_starts == starts
    rig.mend()
    rig.controller.advance(20)
    rig.peer.hello()
    rig.latched(RESET, moves=False)


# ------------------------------------------------------------------------------------------------ memory and supply
NO_INIT = ("kept_words", "kept_codes", "stands_before", "wave_kept", "wave_ring", "crash_word", "controller")


def spoil(rig: Rig, names: tuple[str, ...], random: Random, share: float) -> None:
    """Random bits into what outlasts a reset."""
    for name in names:
        if name == "backup":
            rig.chip.r[BACKUP_REGISTERS] = [random.getrandbits(32) for _ in range(8)]
            continue
        memory = rig.memory(name)
        for at in range(len(memory)):
            if random.random() < share:
                memory[at] = random.getrandbits(8)


def test_memory_spoilt_in_any_way_starts_no_pulse(rig: Rig) -> None:
    starts, random = rig.plant.drive.pulse_starts, Random(7)
    for cause in (ResetCause.WATCHDOG, ResetCause.EXTERNAL, ResetCause.BROWN_OUT, ResetCause.COMMANDED) * 6:
        names = tuple(random.sample((*NO_INIT[:4], *NO_INIT[5:], "backup"), random.randrange(1, 6)))
        spoil(rig, names, random, random.choice((0.001, 0.02, 0.5)))
        rig.controller.reset(cause)
        for _ in range(12):
            rig.controller.advance(1)
            assert not rig.pulses_on
        assert rig.controller.state in (STATE["BOOT"], STATE["IDLE"], STATE["FAULT"], STATE["ESTOP"])
    assert rig.plant.drive.pulse_starts == starts
    rig.peer.hello()
    acts.settle(rig.peer)


def hangs_in_the_tick(rig: Rig) -> None:
    """The program is in its tick, and stays there."""
    rig.patch("main_tick", HANGS[2:])
    rig.controller.advance(1)
    assert rig.pulses_on


@pytest.mark.parametrize(
    "program",
    [lambda rig: None, lambda rig: rig.derail(HANGS), hangs_in_the_tick],
    ids=["works", "hangs", "hangs in the tick"],
)
def test_a_supply_that_drops_takes_the_pulses_at_once(rig: Rig, program: Callable[[Rig], None]) -> None:
    """Whatever the program does; nothing starts before the supply is there again, then cause and fault are told."""
    program(rig)
    starts = rig.plant.drive.pulse_starts
    rig.bench.supply_low = 1
    assert rig.ticks_until_off(1) == 0
    assert rig.chip.resets[-1].name == "SOFTWARE"
    rig.controller.advance(20)
    assert rig.memory("crash_word").view("<u4")[0] == CRASH_SUPPLY
    assert not rig.peer.boots
    assert not rig.pulses_on
    rig.starts_anew("BROWN_OUT")
    assert rig.memory("crash_before").view("<u4")[0] == CRASH_SUPPLY
    assert rig.plant.drive.pulse_starts == starts


def test_a_supply_that_is_not_there_is_waited_for_until_the_watchdog_comes(rig: Rig) -> None:
    rig.bench.supply_low = 1
    assert rig.ticks_until_off(1) == 0
    resets = len(rig.chip.resets)
    rig.controller.advance(600)
    assert {reset.name for reset in rig.chip.resets[resets:]} == {"INDEPENDENT_WATCHDOG"}
    rig.starts_anew("BROWN_OUT")


def test_a_supply_that_drops_in_the_start_lets_no_pulse_out(rig: Rig) -> None:
    """Interrupts are off then; the detector's is pending, and comes before the first tick."""
    rig.controller.reset(ResetCause.EXTERNAL)
    starts, resets = rig.plant.drive.pulse_starts, len(rig.chip.resets)
    rig.controller.advance(1)
    rig.bench.supply_low = 1
    for _ in range(20):
        rig.controller.advance(1)
        assert not rig.pulses_on
    assert rig.chip.resets[-1].name == "SOFTWARE"
    assert len(rig.chip.resets) == resets + 1
    rig.peer.pump(0.002)  # the BOOT of the start that was ended
    rig.peer.boots.clear()
    rig.starts_anew("BROWN_OUT", moves=False)
    assert rig.plant.drive.pulse_starts == starts


def test_a_supply_that_goes_is_told_and_leaves_the_machine_at_rest(rig: Rig) -> None:
    starts = rig.plant.drive.pulse_starts
    rig.controller.reset(ResetCause.POWER_ON)
    assert rig.ticks_until_off(1) == 0
    rig.boot_tells("POWER_ON")
    rig.peer.hello()
    assert rig.peer.state() == "IDLE"
    assert rig.peer.wait(lambda: rig.plant.state.amplifier_v < 0.5, 0.5)
    assert rig.plant.drive.pulse_starts == starts


# ---------------------------------------------------------------------------------------------------- break input
def press_estop(rig: Rig) -> None:
    rig.plant.estop = True


def open_door(rig: Rig) -> None:
    rig.plant.door_open = True


BREAK_US = 10_000  # BREAK_TICKS of the image
BREAKS: dict[str, tuple[Callable[[Rig], None], int, int, int]] = {
    "over-current": (lambda rig: setattr(rig.bench, "over_current", 1), GEN_FAULT, 0, BREAK_US),
    "moment": (lambda rig: setattr(rig.bench, "breaks", 1), GEN_FAULT, 0, BREAK_US),
    "estop": (press_estop, ESTOP, layouts.enum("Interlocks")["ESTOP"], 0),
    "door": (open_door, DOOR, layouts.enum("Interlocks")["DOOR"], 0),
}


@pytest.mark.parametrize("name", BREAKS)
def test_the_break_chain_is_off_at_once_and_told(rig: Rig, name: str) -> None:
    acts_on, code, detail, later_us = BREAKS[name]
    acts_on(rig)
    at_us, starts = rig.controller.time_us, rig.plant.drive.pulse_starts
    assert rig.ticks_until_off(1) == 0
    fault = rig.peer.fault(0.5)
    assert (fault["code"], fault["detail"]) == (code, detail)
    told_us = (fault["t_us"] - at_us) % 2**32
    assert later_us <= told_us <= later_us + (1000 if later_us else 3000)  # the inputs follow by 1.5 ms
    assert rig.plant.drive.pulse_starts == starts
    rig.latched(code)


@pytest.mark.parametrize("name", ["estop", "door"])
@pytest.mark.parametrize("input_ms", range(9))
def test_an_input_that_follows_its_break_is_what_is_told(rig: Rig, name: str, input_ms: int) -> None:
    acts_on, code, detail, _ = BREAKS[name]
    rig.bench.input_ms = input_ms
    acts_on(rig)
    drive, at_us = rig.plant.drive, rig.controller.time_us
    starts, command_v = drive.pulse_starts, drive.actuator_v
    assert rig.ticks_until_off(1) == 0
    while rig.controller.fault == 0:
        assert not rig.pulses_on
        assert abs(drive.actuator_v - command_v) < 0.05  # nothing feeds meanwhile
        rig.controller.advance(1)
    fault = rig.peer.fault(0.5)
    assert (fault["code"], fault["detail"]) == (code, detail)
    assert 1000 * input_ms <= (fault["t_us"] - at_us) % 2**32 <= 1000 * (input_ms + 1)
    assert drive.pulse_starts == starts
    rig.latched(code)


@pytest.mark.parametrize("name", ["estop", "door"])
@pytest.mark.parametrize("chain_ms", [1, 3, 8])
def test_an_input_that_is_there_before_its_break_is_told(rig: Rig, name: str, chain_ms: int) -> None:
    acts_on, code, detail, _ = BREAKS[name]
    rig.bench.input_ms, rig.bench.chain_ms = 0, chain_ms
    acts_on(rig)
    at_us = rig.controller.time_us
    assert rig.ticks_until_off(2) == 1  # by the program
    fault = rig.peer.fault(0.5)
    assert (fault["code"], fault["detail"]) == (code, detail)
    assert (fault["t_us"] - at_us) % 2**32 <= 1000
    rig.latched(code)


def test_an_emergency_stop_behind_an_over_current_is_told(rig: Rig) -> None:
    rig.bench.over_current = 1
    rig.controller.advance(4)
    assert rig.controller.fault == 0
    press_estop(rig)
    assert rig.peer.fault(0.5)["code"] == ESTOP
    rig.latched(ESTOP)


def test_nothing_opens_the_gate_until_the_break_is_told(rig: Rig) -> None:
    """An over-current that is over with its pulses, and a host that asks for the next ones at once."""
    starts = rig.plant.drive.pulse_starts
    rig.bench.breaks = 1
    rig.controller.advance(1)
    peer = rig.peer
    assert peer.command("SERVO_STOP").status == STATUS["OK"]
    start = peer.command("SERVO_START", gap_ref_v=20.0, z_limit_um=10.0, max_time_s=1.0)
    assert start.status == STATUS["OK"]
    assert rig.controller.fault == 0
    assert rig.peer.fault(0.5)["code"] == GEN_FAULT
    assert rig.plant.drive.pulse_starts == starts
    rig.latched(GEN_FAULT)


def test_a_break_while_the_gate_is_being_opened_lets_no_pulse_out(rig: Rig) -> None:
    """It comes after the look at the input and is over before MOE is set: its flag alone tells."""
    peer = rig.peer
    assert peer.command("SERVO_STOP").status == STATUS["OK"]
    peer.pump(0.05)
    assert not rig.pulses_on
    starts, seen = rig.plant.drive.pulse_starts, []
    addresses = sys.modules[emulator_of(rig.chip).__name__.rpartition(".")[0] + ".addresses"]

    def break_for_an_instant(*_: object) -> None:
        seen.append(True)
        rig.chip.r[addresses.register(addresses.TIM1, addresses.TIM_SR)] |= addresses.BIF

    at = rig.chip.image.symbols["inputs_put_mode"][0] & ~1
    engine, code = rig.chip._engine, importlib.import_module("unicorn.unicorn_const").UC_HOOK_CODE
    hook = engine.hook_add(code, break_for_an_instant, begin=at, end=at)
    engine.ctl_flush_tb()
    try:
        start = peer.command("SERVO_START", gap_ref_v=20.0, z_limit_um=10.0, max_time_s=1.0)
        assert start.status == STATUS["OK"]
        rig.controller.advance(2)
    finally:
        engine.hook_del(hook)
        engine.ctl_flush_tb()
    assert seen
    assert peer.fault(0.5)["code"] == GEN_FAULT
    assert rig.plant.drive.pulse_starts == starts
    rig.latched(GEN_FAULT)


@pytest.mark.parametrize(("command", "values"), [("JUMP", JUMP), ("DISARM", {})])
def test_what_the_host_asks_for_before_a_break_is_told_changes_nothing_of_it(
    rig: Rig, command: str, values: dict[str, float]
) -> None:
    rig.bench.input_ms = 8
    open_door(rig)
    rig.controller.advance(1)
    assert rig.peer.command(command, **values).status == STATUS["OK"]
    assert rig.controller.fault == 0
    assert rig.peer.fault(0.5)["code"] == DOOR
    rig.latched(DOOR)


def test_the_waveforms_of_an_over_current_are_those_about_its_break(rig: Rig) -> None:
    peer = rig.peer
    rig.bench.over_current = 1
    rig.controller.advance(1)
    break_us = rig.controller.time_us
    assert peer.fault(0.5)["code"] == GEN_FAULT
    peer.pump(0.1)
    first = peer.ok("WAVEFORM_READ", offset=0)
    before_us = (break_us - first.t0_us) % 2**32
    period_us = rig.plant.unit.pulse_period_ns / 1000.0
    assert 20.0 * period_us < before_us < 65.0 * period_us
    assert before_us + 15.0 * period_us < first.total < before_us + 17.0 * period_us
    rig.latched(GEN_FAULT)


def test_the_break_chain_needs_no_program(rig: Rig) -> None:
    rig.derail(HANGS_WITH_INTERRUPTS_OFF)
    rig.bench.over_current = 1
    assert rig.ticks_until_off(1) == 0
    assert rig.reset_within(WWDG_TICKS) == "WINDOW_WATCHDOG"
    starts = rig.plant.drive.pulse_starts
    rig.starts_anew()
    assert rig.plant.drive.pulse_starts == starts


# ------------------------------------------------------------------------------------------- converters and lines
@pytest.mark.parametrize(("converter", "fault"), [("adc_stuck", GAP_SENSOR), ("slow_stuck", PIEZO_OV)])
def test_converters_that_stop_are_a_sensor_that_failed(rig: Rig, converter: str, fault: int) -> None:
    """The fast ones that of the gap, the slow ones that of the amplifier."""
    setattr(rig.bench, converter, 1)
    assert rig.ticks_until_off(5) == 1  # with the end of the millisecond that they did not measure
    assert rig.peer.fault(0.5)["code"] == fault
    rig.latched(fault)


@pytest.mark.parametrize("phase", range(0, 10_500, 700))
def test_a_slow_converter_that_comes_back_has_every_channel_in_its_place(shared_rig: Rig, phase: int) -> None:
    """Wherever a scan is when the program starts the stream anew: some of these are in the middle of one."""
    rig = shared_rig
    if phase == 0:
        rig.mend()
        acts.settle(rig.peer)
    before = rig.peer.ok("GET_STATUS")
    rig.bench.scan_phase, rig.bench.slow_stuck = phase, 1
    rig.controller.advance(7)
    assert rig.peer.ok("GET_STATUS").temperature_c != pytest.approx(before.temperature_c, abs=1.0)
    rig.bench.slow_stuck = 0
    rig.controller.advance(5)
    status = rig.peer.ok("GET_STATUS")
    rig.bench.scan_phase = 0
    for name in ("monitor_v", "displacement_um", "temperature_c", "flow_lpm"):
        assert status.fields[name] == pytest.approx(before.fields[name], abs=1.0), name


def test_an_actuator_that_does_not_follow_is_told(rig: Rig) -> None:
    rig.bench.dac_dead = 1
    parameters = layouts.PARAMETERS
    apart_v = parameters["track_error"].default * parameters["track_error"].scale * 150.0
    most_ticks = round(parameters["track_s"].default * parameters["track_s"].scale * 1000.0)
    apart_ticks = 0
    for _ in range(8000):
        rig.peer.step(0.001)
        if not rig.pulses_on:
            break
        apart = abs(rig.controller.loop.command_v - rig.plant.readings.monitor_v) > apart_v
        apart_ticks = apart_ticks + 1 if apart else 0
    assert not rig.pulses_on
    assert most_ticks <= apart_ticks <= 2 * most_ticks  # it creeps past the edge, and the monitor has noise
    assert rig.peer.fault(0.5)["code"] == PIEZO_TRACK
    rig.latched(PIEZO_TRACK, moves=False)


def test_a_line_held_low_is_an_abort(rig: Rig) -> None:
    rig.bench.line_low = 1
    assert rig.ticks_until_off(5) <= 2
    rig.bench.line_low = 0
    assert rig.peer.fault(0.5)["code"] == ABORT_RUN
    rig.latched(ABORT_RUN)


def test_an_alive_pin_that_stands_still_takes_the_high_voltage(rig: Rig) -> None:
    holds = emulator_of(rig.bench).PUMP_TICKS
    rig.patch("inputs_toggle_alive", RETURNS)
    assert rig.ticks_until_off(holds + 2) == holds
    assert rig.peer.fault(0.5)["code"] == NO_SPARK
    rig.latched(NO_SPARK)


def test_a_generator_that_does_not_switch_off_is_found_while_armed(shared_rig: Rig) -> None:
    rig = shared_rig
    rig.mend()
    acts.settle(rig.peer)
    acts.arm(rig.peer)
    rig.peer.pump(0.1)
    assert not rig.peer.faults
    at_us, starts = rig.controller.time_us, rig.plant.drive.pulse_starts
    rig.plant.unit.stray_pulses = 1
    fault = rig.peer.fault(0.5)
    assert fault["code"] == GEN_FAULT
    assert (fault["t_us"] - at_us) % 2**32 <= 5000
    rig.plant.unit.stray_pulses = 0
    assert rig.plant.drive.pulse_starts == starts
    rig.latched(GEN_FAULT)


# -------------------------------------------------------------------------------------------------------- contact
def touch(rig: Rig) -> None:
    """Begin to touch the work five times."""
    rig.mend()
    acts.settle(rig.peer)
    acts.arm(rig.peer)
    acts.move_x(rig.peer, acts.WORK_X_UM)
    values = {"fast_um_s": 20.0, "fast_to_um": 10.0, "speed_um_s": 10.0, "z_max_um": 100.0}
    rig.peer.ok("TOUCH_OFF", **values, back_off_um=5.0, dwell_s=0.1, touches=5)


def places(rig: Rig) -> list[float]:
    code = layouts.enum("EventCode")["TOUCH"]
    return [event["displacement_um"] for event in rig.peer.events if event["code"] == code]


def test_a_contact_that_bounces_is_a_touch_at_the_same_place(shared_rig: Rig) -> None:
    rig = shared_rig
    starts = rig.plant.drive.pulse_starts
    touch(rig)
    rig.peer.event("TOUCH_DONE", 20.0)
    sound = places(rig)
    acts.disarm(rig.peer)
    touch(rig)
    rig.bench.chatters = 1
    rig.peer.event("TOUCH_DONE", 20.0)
    bounced = places(rig)
    assert len(sound) == len(bounced) == 5
    assert abs(sum(sound) - sum(bounced)) / 5 < 1.0
    assert rig.plant.drive.pulse_starts == starts
    rig.mend()
    acts.rest(rig.peer)


def test_a_contact_that_comes_and_goes_by_itself_is_told(shared_rig: Rig) -> None:
    rig = shared_rig
    starts = rig.plant.drive.pulse_starts
    touch(rig)
    rig.bench.chatters = 2
    assert rig.peer.fault(20.0)["code"] == STUCK_CONTACT
    assert rig.plant.drive.pulse_starts == starts
    rig.latched(STUCK_CONTACT)


# ------------------------------------------------------------------------------------------------------ the clock
def test_a_clock_that_goes_with_the_plug_leaves_nobody_near_the_work(rig: Rig) -> None:
    """The chip's own oscillator takes the tool back; gate and high voltage stay off until the clock is back."""
    assert rig.plant.state.amplifier_v > 1.0
    registers = registers_of(rig)
    rig.chip.r[registers.CLOCK_LOST] = 1
    rig.chip.core[emulator_of(rig.chip).PC] = rig.chip.image.symbols["nmi_handler"][0] & ~1
    starts, before = rig.plant.drive.pulse_starts, len(rig.chip.resets)
    put_v = [float(rig.plant.drive.actuator_v)]
    for _ in range(3000):
        rig.controller.advance(1)
        assert not rig.pulses_on
        put_v.append(float(rig.plant.drive.actuator_v))
    assert [reset.name for reset in rig.chip.resets[before:]] == ["SOFTWARE"]
    assert all(later <= sooner for sooner, later in itertools.pairwise(put_v))
    assert put_v[-1] == 0.0
    assert rig.plant.state.amplifier_v < 0.5
    assert rig.controller.fault == RESET
    assert rig.bench.alive_ticks > 2000, "the high voltage has gone"
    rig.peer.hello()
    acts.clear(rig.peer)
    acts.arm(rig.peer)
    rig.peer.ok("PULSE_ENABLE", on=1)
    acts.servo_start(rig.peer)
    rig.peer.pump(0.05)
    assert rig.plant.drive.pulse_starts == starts
    rig.chip.r[registers.CLOCK_LOST] = 0
    assert rig.reset_within(3) == "SOFTWARE"
    rig.controller.advance(30)
    rig.peer.hello()
    acts.settle(rig.peer)
    acts.start_pulses(rig.peer)
    rig.peer.pump(0.05)
    assert rig.plant.drive.pulse_starts > starts


def test_a_board_without_a_clock_begins_when_it_comes(rig: Rig) -> None:
    registers = registers_of(rig)
    rig.chip.r[registers.CLOCK_LOST] = 1
    rig.controller.reset(ResetCause.POWER_ON)
    rig.controller.advance(100)
    resets = len(rig.chip.resets)
    rig.chip.r[registers.CLOCK_LOST] = 0
    assert rig.reset_within(3) == "SOFTWARE"
    rig.controller.advance(30)
    assert len(rig.chip.resets) == resets + 1
    rig.peer.hello()
    assert rig.peer.state() == "IDLE"
