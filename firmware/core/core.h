/* What the files of the core offer each other; the names begin with the file. */
#ifndef EDM_CORE_H
#define EDM_CORE_H

#include "../edm.h"

/* frame.c */
uint32_t frame_crc(uint32_t crc, const uint8_t *bytes, size_t size);
size_t frame_encode(uint8_t *out, uint8_t type, uint8_t seq, uint8_t session, uint8_t flags, const uint8_t *payload,
                    size_t size);
size_t frame_fill(struct edm_receiver *r, const uint8_t *bytes, size_t size);
bool frame_aborts(const struct edm_receiver *r);
bool frame_end(struct edm_receiver *r, struct edm_frame *frame);

/* delivery.c */
void delivery_handle(struct edm_controller *c, const struct edm_frame *frame);
void delivery_send(struct edm_controller *c, uint8_t type, const uint8_t *payload, size_t size);
void delivery_answer(struct edm_controller *c, uint8_t type, uint8_t seq, uint8_t session);
void delivery_answer_now(struct edm_controller *c, const struct edm_frame *frame);
void delivery_execute(struct edm_controller *c, const struct edm_frame *frame);

/* session.c */
void session_begin(struct edm_controller *c, uint8_t session);
void session_greet(struct edm_controller *c, const struct edm_frame *frame);

/* events.c */
void events_emit(struct edm_controller *c, uint16_t code);
void events_emit_touch(struct edm_controller *c);
void events_emit_arg(struct edm_controller *c, uint16_t code, int32_t arg);
void events_emit_fault(struct edm_controller *c, uint16_t code, int32_t detail);
bool events_take_faults(const struct edm_controller *c);
void events_acknowledge(struct edm_controller *c, uint16_t last);
void events_repeat(struct edm_controller *c);

/* parameters.c */
void parameters_reset(struct edm_controller *c);
bool parameters_stage(struct edm_controller *c, uint16_t id, int32_t value);
bool parameters_commit(struct edm_controller *c, uint32_t crc);
int parameters_row(uint16_t id);
void parameters_set_generator(struct edm_controller *c, const struct edm_generator *setting, int32_t period_ns);

/* states.c */
void states_enter(struct edm_controller *c, uint8_t state);
void states_raise(struct edm_controller *c, uint16_t code, int32_t detail);
void states_clear_fault(struct edm_controller *c);
void states_stop_motion(struct edm_controller *c);

/* commands.c, motion_commands.c */
uint8_t commands_execute(struct edm_controller *c, const struct edm_frame *frame);
uint8_t motion_commands_execute(struct edm_controller *c, const struct edm_frame *frame);

/* motion.c */
void motion_enter(struct edm_controller *c, enum edm_mode mode);
void motion_hold(struct edm_controller *c);
bool motion_feeds(const struct edm_controller *c, real target_v);
void motion_ramp(struct edm_controller *c, real target_v, real slew_v_s);
void motion_gate(struct edm_controller *c, bool on);
void motion_open_gate(struct edm_controller *c);
void motion_pulses_on(struct edm_controller *c);
int motion_end(struct edm_controller *c, int happened);
int motion_tick(struct edm_controller *c);
void motion_command(struct edm_controller *c);

/* stages.c */
void stages_start(struct edm_controller *c, uint8_t axis, real target, real speed);
void stages_stop(struct edm_controller *c);
bool stages_arrived(const struct edm_controller *c);
void stages_look(struct edm_controller *c);
uint8_t stages_judge_speed(struct edm_controller *c, uint8_t axis, real speed);

/* servo.c */
int servo_tick(struct edm_controller *c);
int servo_watch(struct edm_controller *c);
bool servo_is_deep(const struct edm_controller *c);

/* jump.c, touch.c, self_test.c */
real jump_command(const struct edm_controller *c);
int jump_tick(struct edm_controller *c);
int touch_tick(struct edm_controller *c);
void self_test_begin(struct edm_controller *c);
int self_test_tick(struct edm_controller *c);
void self_test_judge(struct edm_controller *c);

/* scan.c */
void scan_begin(struct edm_controller *c);
bool scan_append(struct edm_controller *c, const struct edm_line *line);
void scan_end(struct edm_controller *c);
void scan_release(struct edm_controller *c);
int scan_tick(struct edm_controller *c);

/* What a failed reading counts as: no displacement is that far. */
#define DISPLACEMENT_FAILED_UM R(2e6)

/* pulses.c, gap.c */
int pulses_judge(struct edm_controller *c);
int gap_rest(struct edm_controller *c);
real gap_place(const struct edm_controller *c);
real gap_charge(const struct edm_controller *c);
int gap_wait(struct edm_controller *c);
int gap_measure(struct edm_controller *c, int shorts);

/* guards.c, watchdog.c */
uint16_t guards_interlocks(struct edm_controller *c, struct edm_inputs *inputs);
uint16_t guards_fault_of(uint16_t interlocks);
bool guards_too_noisy(struct edm_controller *c);
int guards_monitor(struct edm_controller *c);
void watchdog_feed(struct edm_controller *c);
int64_t watchdog_tick(const struct edm_controller *c);

/* telemetry.c */
uint8_t telemetry_start(struct edm_controller *c, const struct tlm_start *request);
void telemetry_stop(struct edm_controller *c);
void telemetry_forget(struct edm_controller *c);
void telemetry_flush(struct edm_controller *c);
void telemetry_send_full(struct edm_controller *c);
void telemetry_sample(struct edm_controller *c, uint8_t flags);
void telemetry_write(uint8_t *p, const struct edm_sample *sample, int32_t ticks);
void telemetry_log_pulses(struct edm_controller *c, const uint8_t *classes);

/* blackbox.c */
void blackbox_record(struct edm_controller *c, uint8_t flags);
void blackbox_freeze(struct edm_controller *c);
void blackbox_thaw(struct edm_controller *c);
bool blackbox_recover(struct edm_controller *c);
void blackbox_read(struct edm_controller *c, uint16_t offset, struct edm_reply *reply);

/* waveforms.c */
void waveforms_note_pulses(struct edm_controller *c);
void waveforms_forget(struct edm_controller *c);
void waveforms_freeze(struct edm_controller *c);
void waveforms_thaw(struct edm_controller *c);
uint8_t waveforms_read(struct edm_controller *c, uint32_t offset, struct edm_reply *reply);

/* Controller time, µs since its start. */
static inline uint64_t time_us(const struct edm_controller *c) {
    return (uint64_t)(c->tick - c->boot_tick) * TICK_US;
}

/* The voltage that the actuator's converter makes of one asked for, V. */
static inline real on_grid(real voltage_v) {
    return (real)floor_of(voltage_v * STEPS_PER_V + R(0.5)) * DAC_V;
}

/* A duration of the host's time in ticks of the controller's; they are the same but on simulated ones. */
static inline int64_t host_ticks(const struct edm_controller *c, int32_t ticks) {
    return nearest((real)ticks * c->identity.host_time_scale);
}

#endif
