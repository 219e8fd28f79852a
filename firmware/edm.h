/* EDM Link controller: what a board calls. See hal.h for what it supplies, docs/firmware.md for how. */
#ifndef EDM_H
#define EDM_H

#include "core/controller.h"

/* Makes a controller in the caller's memory: parameters at their defaults, IDLE, tool taken to be where the monitor says.
 * `keeps` are the words that outlasted the supply or the reset, NULL for none. edm_start follows. */
void edm_create(struct edm_controller *c, void *board, const struct edm_identity *identity,
                const struct edm_persistent *keeps);
/* The same in memory that has outlasted the reset, with the clock, the black box and the waveforms in it: the black box as far
 * as its checks are right, `waveforms` if the board says that what it has kept of them is whole. */
void edm_create_again(struct edm_controller *c, void *board, const struct edm_identity *identity,
                      const struct edm_persistent *keeps, bool waveforms);
/* Where a reset has left the actuator, V, for a board that knows what its converter holds: instead of the monitor, whatever that
 * reads. Between edm_create_again and edm_start. */
void edm_stands_at(struct edm_controller *c, real actuator_v);
/* Starts it, as a reset of that cause does: no session, pulses off, tool back (after RESET_CAUSE_POWER_ON from 0 V, by no
 * ramp), BOOT sent (docs/protocol.md, Session). */
void edm_start(struct edm_controller *c, uint8_t cause);

/* Takes bytes of the line and carries out the commands in them; returns how many were taken. It stops early behind an
 * ADVANCE, the rest follows after edm_advanced. */
size_t edm_receive(struct edm_controller *c, const uint8_t *bytes, size_t size);
/* The line was low for 1 ms, or eight zeros were counted elsewhere: for boards that time or count in hardware. As every
 * function here: not from an interrupt of another one. */
void edm_abort(struct edm_controller *c);
/* What ends a call of edm_receive: a line that is too noisy. Call it after every read of the line. */
void edm_line_read(struct edm_controller *c);
/* Answers the ADVANCE that edm_receive stopped at. */
void edm_advanced(struct edm_controller *c);

/* Where the mode switch belongs in the millisecond that begins: the generator at the gap, else the contact circuit. */
bool edm_generator_at_gap(const struct edm_controller *c);
/* Begins a millisecond: reads the contact of the last one, sets c->drive. No message is sent. */
void edm_tick_begin(struct edm_controller *c);
/* Ends a millisecond: judges c->readings, records them; returns what happened (enum edm_happened). */
int edm_tick_end(struct edm_controller *c);
/* Follows a tick, or several in which nothing happened: sends telemetry, turns `happened` into states and events. */
void edm_conclude(struct edm_controller *c, int happened);
/* Sends telemetry frames that are full; edm_conclude does it too. */
void edm_send_full_frames(struct edm_controller *c);
/* What is due by the clock and by the inputs: stages, interlocks, watchdog, repetition of events. Call it every
 * millisecond, or at the latest at edm_next_deadline. */
void edm_watch(struct edm_controller *c);
/* The tick at which edm_watch has something to do by the clock; NEVER for none. */
int64_t edm_next_deadline(const struct edm_controller *c);

/* The board's hardware has ended the pulses, and which fault it is does not show yet: no pulses, tool and stages of what needs
 * them held, in a jump too, waveforms kept. Call it every millisecond until a fault is latched, which has to follow. */
void edm_pulses_broken(struct edm_controller *c);
/* A fault that the board itself has found. */
void edm_fault(struct edm_controller *c, uint16_t code, int32_t detail);

#endif
