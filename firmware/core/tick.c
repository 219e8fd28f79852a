/* The millisecond: edm_tick_begin commands, the machine lives through it, edm_tick_end judges and records it. */
#include "core.h"

void edm_tick_begin(struct edm_controller *c) {
    c->drive.stage_moves = 0;
    motion_command(c);
    motion_open_gate(c);
}

/* TlmFlags of now. */
static uint8_t flags_of(const struct edm_controller *c) {
    int bits = c->drive.pulses_on ? TLM_FLAGS_PULSES_ON : 0;
    bits |= c->readings.contact ? TLM_FLAGS_CONTACT : 0;
    bits |= c->servo.direction > 0 ? TLM_FLAGS_ADVANCING : 0;
    bits |= c->gap.shorted ? TLM_FLAGS_SHORTED : 0;
    bits |= c->motion.limit_ticks > 0 ? TLM_FLAGS_AT_LIMIT : 0;
    bits |= c->motion.slewed ? TLM_FLAGS_SLEW_LIMITED : 0;
    return (uint8_t)bits;
}

/* Judges the pulses of the millisecond, or that there were none. */
static int judge_gap(struct edm_controller *c) {
    if (!c->drive.pulses_on) {
        return gap_rest(c);
    }
    c->gap.stray_ticks = 0;
    if (c->readings.pulses == 0) {
        return gap_wait(c);
    }
    return gap_measure(c, pulses_judge(c));
}

/* Takes over the displacement, µm, and low-passes it. */
static void read_displacement(struct edm_controller *c) {
    real displacement = c->readings.sensor_um;
    if (c->settings.sensor_missing) {
        displacement = c->drive.actuator_v / c->settings.v_per_um;
    }
    if (!(magnitude(displacement) < DISPLACEMENT_FAILED_UM)) {
        displacement = DISPLACEMENT_FAILED_UM;
    }
    struct edm_gap *gap = &c->gap;
    gap->displacement_um = displacement;
    if (displacement >= DISPLACEMENT_FAILED_UM || gap->slow_displacement_um >= DISPLACEMENT_FAILED_UM) {
        gap->slow_displacement_um = displacement; /* nothing of a failed reading stays in the filter */
    } else {
        gap->slow_displacement_um += c->settings.displacement_alpha * (displacement - gap->slow_displacement_um);
    }
}

int edm_tick_end(struct edm_controller *c) {
    c->tick++;
    if (c->readings.pulses > EDM_MOST_PULSES) {
        c->readings.pulses = EDM_MOST_PULSES;
    }
    c->telemetry.charge_uc += gap_charge(c);
    int happened = judge_gap(c);
    read_displacement(c);
    int sequence = motion_tick(c);
    if (happened == NOTHING) {
        happened = sequence;
    }
    if (c->armed) {
        int voltage = guards_monitor(c);
        if (voltage != NOTHING) {
            happened = voltage;
        }
    }
    if (c->scan.scanning && happened == NOTHING) {
        happened = scan_tick(c);
    }
    uint8_t flags = flags_of(c);
    blackbox_record(c, flags);
    c->telemetry.contact = c->telemetry.contact || c->readings.contact;
    if (c->tick == c->telemetry.next) {
        telemetry_sample(c, flags);
    }
    return happened;
}
