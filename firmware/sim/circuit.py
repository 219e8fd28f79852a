"""What lies between chip and plant: the scales of the circuit, and what it keeps from one millisecond to the next.

The scales are those of firmware/board/scale.h, written here once more from the circuit's side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.core.library import Record, record, series

if TYPE_CHECKING:
    from edmctl.array_types import Array

QUEUE = 256
"""Pulses whose edges are kept; a power of two."""

# Volts, amperes, micrometres, degrees Celsius and litres a minute at 3.3 V; pairs begin with what is meant by 0 V.
GAP_V, GAP_A = 330.0, 12.0
MONITOR_V = (-5.0, 165.0)
DISPLACEMENT_UM = (-50.0, 450.0)
TEMPERATURE_C, FLOW_LPM = 100.0, 5.0
SET_V, SET_A = 330.0, 12.0
DAC_V = 0.0025  # a count of the actuator's converter
STEP_UM, STEP_DEG = 0.1, 0.001
STAGE_TICKS = 10  # the work under a moving tool is looked up so often
REST_TICKS = 3  # without a step: the stages have arrived
PUMP_TICKS = 3  # the charge pump of the high voltage holds so long [assumed]
INPUT_MS = 1.5  # an input behind its optocoupler follows a loop that opens so much later: 10 kΩ and 100 nF
INPUTS = 5  # on pins 0 to 4 of port G: e-stop, door, high-voltage supply, level, limit switches
SWITCH_OFF_NS = 5000.0  # from MOE to the open switch; the protocol asks for 10 µs


@record
class Bench(Record):
    """What lies between chip and plant."""

    ticks: int  # since the chip's timers were started
    rate: int  # bytes of the line in 1000 s
    receives: int  # share of a byte that the line has left, of 1000 s
    sends: int
    rx_head: int  # bytes of `rx` before it are in the chip's ring
    rx_tail: int
    tx_size: int  # bytes in `tx`
    frame_bytes: int  # of the frame that is being sent, and its type
    frame_type: int
    urgent: int  # 1: a frame has gone out that somebody waits for
    line_low: int  # 1: something holds the line low
    alive_ticks: int  # since the pump last saw an edge
    alive_edges: int
    gate_starts: int
    was_on: int
    off_ns: float  # when the switch opened last, and pulses in flight ended
    noise_at: int
    queue_head: int  # of the pulses, in the order of their begin
    starts_at: int  # next pulse whose edge is to come, channel by channel
    ignitions_at: int
    ends_at: int
    had_contact: int
    comparator_chatters: int  # so often the current's comparator falls and rises within a discharge
    chatters: int  # the contact's wire: 1: a closed contact bounces, 2: it does with an open one too
    estop: int
    door: int
    hv_ok: int
    halted: int  # 1: a debugger has halted the core
    supply_low: int  # of the chip: below what its voltage detector is set to
    level_ok: int
    limit: int
    input_ms: float  # from a loop that opens to its input; one that closes is there at once
    chain_ms: float  # from e-stop or door to the break chain, which has contacts of its own
    chain_loop: int  # 1: these are open
    chain_ticks: int  # since when
    over_current: int
    breaks: int  # 1: the chain opens and closes again before the program has looked
    flow_lpm: float
    temperature_c: float
    adc_stuck: int  # the fast converters say what they said
    slow_stuck: int  # and the slow one
    scan_phase: int  # clocks of 168 MHz between a scan of the slow one and the begin of a millisecond
    dac_dead: int  # the actuator's converter says nothing
    actuator_code: int
    moved: int  # 0: the stages rest; 1: steps have come; 2: and are over
    tick_jitter: int  # counts of a step timer, 24 ns, that an interrupt comes late at most
    travels: int
    rest_ticks: int  # since the last step
    steps: Array = series(3)  # of the stages, signed, since they were last taken
    open_ticks: Array = series(INPUTS)  # milliseconds since the loops of the inputs have opened
    start_ns: Array = series(QUEUE)
    ignition_ns: Array = series(QUEUE)  # no discharge: -1
    end_ns: Array = series(QUEUE)
