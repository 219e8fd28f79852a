/* The plant's millisecond: contact, gap without pulses, levels of the work, stages. */
#include "plant.h"

#include "../math/elementary.h"

#define SURFACE_UM 3.0        /* depth over which newer craters replace older ones: process/erosion.py */
#define CLEARING_LEAST 0.0625 /* range of the clearance by the width of the gap: process/erosion.py */
#define CLEARING_MOST 4.0
#define FLUSH_THROUGH_S 0.02 /* debris clearance of a gap that is all open below [assumed] */
#define LEAST_GAP_V 1.0      /* a gap sensor cannot tell a lower voltage from none */
#define STAGE_STEP_UM 2.5    /* way of the stages after which the work under the tool is another */

/* An opening gap draws clean oil in: the greater the stroke against the annulus, the cleaner. */
void edm_pump(const struct unit *unit, struct plant *p, double opening_um) {
    if (opening_um <= 0.0) {
        p->opening_um = 0.0;
        return;
    }
    double drawn_um = opening_um - p->opening_um;
    p->opening_um = opening_um;
    if (drawn_um > 0.0) {
        double refill = unit->annulus_area_um2 * p->depth_um + 3.0 * unit->tool_area_um2;
        p->debris_um3 *= edm_exp(-unit->tool_area_um2 * drawn_um / refill);
        p->carbon = 0.0;
    }
}

/* The work drifts away from the tool, for 64 ms. */
static void drift_apart(const struct unit *unit, struct plant *p) {
    double way_um = 64.0 * PLANT_TICK_S * unit->machine_drift_um_s;
    p->machine_um += way_um;
    p->surface_um += way_um;
}

/* How fast debris leaves the gap: slower the narrower it is and the deeper the hole. By the square of the gap: the flow
 * through a slit is its cube, and what it has to carry grows with it. A sheet that is open below clears too. */
void edm_renew_clearing(const struct unit *unit, struct plant *p) {
    double ratio = p->depth_um * unit->per_flush_depth;
    double gap = (p->surface_um + p->depth_um + p->wear_um - p->true_z_um) / unit->working_gap_um;
    double opened = lesser(CLEARING_MOST, greater(CLEARING_LEAST, gap > 0.0 ? gap * gap : 0.0));
    double rate = opened / (unit->flush_time_s * (1.0 + ratio * ratio)) + (1.0 - 1.0 / p->rarity) / FLUSH_THROUGH_S;
    p->clearing = edm_exp(-(double)unit->pulse_period_ns * 1e-9 * rate);
    p->tick_clearing = edm_exp(-PLANT_TICK_S * rate);
}

/* A floor that sinks shows its newest craters. */
static void forget_craters(struct plant *p) {
    double sunk_um = p->depth_um - p->crater_depth_um;
    if (sunk_um > 0.0) {
        double kept = edm_exp(-sunk_um / SURFACE_UM);
        p->crater_um3 *= kept;
        p->crater_um6 *= kept;
        p->arc_um3 *= kept;
    }
    p->crater_depth_um = p->depth_um;
}

/* The mode switch is one changeover; the gap sensor is on its gap side. */
static bool generator_at_gap(const struct unit *unit, const struct drive *drive) {
    if (unit->mode_stuck != 0) {
        return unit->mode_stuck == STUCK_AT_GENERATOR;
    }
    return drive->generator != 0 || drive->pulses_on != 0;
}

/* A millisecond without pulses: the gap clears itself, and a sound gap sensor has nothing to read. */
static void rest(const struct unit *unit, struct plant *p, const struct drive *drive, struct readings *r) {
    p->debris_um3 *= p->tick_clearing;
    p->bridge_until_um = 0.0;
    p->previous_burning = -1.0;
    r->pulses = 0;
    r->charge_uc = 0.0;
    r->stray_pulses = unit->stray_pulses;
    bool stuck = unit->gate_stuck == 1 && unit->supply_off == 0 && generator_at_gap(unit, drive);
    double applied_v = unit->gap_wire * (stuck ? unit->open_v : unit->battery_v);
    double at_rest_v = applied_v > LEAST_GAP_V ? applied_v : NOT_A_NUMBER;
    r->gap_v = unit->gap_stuck_v >= 0.0 ? unit->gap_stuck_v : at_rest_v;
}

/* Cells of the work join what sinks, or fall out of the sheet, where the level came to them. What was removed below a
 * level is spread over the area that sinks from there on, so that no volume is lost. True where nothing is left. */
static bool sink_levels(const struct machine *m) {
    struct plant *p = m->plant;
    int64_t at = p->level_at;
    while (p->depth_um >= m->level_um[at] && m->level_um[at] < INFINITE) { /* the last one is infinite */
        double level_um = m->level_um[at], share = m->level_share[at], rarity = m->level_rarity[at];
        if (share == 0.0 || rarity == INFINITE) {
            p->depth_um = level_um;
            return true;
        }
        double per_area = m->unit->per_disc_area / share;
        p->depth_um = level_um + (p->depth_um - level_um) * per_area / p->per_hole_area;
        p->per_hole_area = per_area;
        p->rarity = rarity;
        p->level_at = ++at;
    }
    p->next_level_um = m->level_um[at];
    return false;
}

bool edm_plant_tick(const struct machine *m) {
    const struct unit *unit = m->unit;
    struct plant *p = m->plant;
    struct readings *r = m->readings;
    int64_t tick = r->tick;
    edm_actuator_tick(unit, p, m->drive->actuator_v);
    double reach_um = p->surface_um + p->depth_um + p->wear_um, excess_um = p->free_z_um - reach_um;
    /* The work stops the tool, except for its own compliance. */
    p->true_z_um = excess_um <= 0.0 ? p->free_z_um : reach_um + unit->contact_compliance * excess_um;
    bool connected = unit->contact_open == 0 && unit->mode_stuck != STUCK_AT_GENERATOR;
    bool closed = excess_um >= -p->asperity_um && connected;
    r->contact = closed != (unit->contact_inverted == 1);
    double opening_um = reach_um - p->true_z_um - unit->free_gap_um;
    if (opening_um > 0.0 || p->opening_um != 0.0) {
        edm_pump(unit, p, opening_um);
    }
    if ((tick & 63) == 0) { /* depth changes by nanometres a tick */
        drift_apart(unit, p);
        edm_renew_clearing(unit, p);
        forget_craters(p);
    }
    if (m->drive->pulses_on == 1 && unit->gate_open == 0) {
        edm_strike_pulses(m);
    } else {
        rest(unit, p, m->drive, r);
    }
    bool gives_way = p->depth_um >= p->next_level_um && sink_levels(m);
    r->sensor_um = unit->sensor_wire * edm_sensor(unit, p, tick, m->noise);
    r->monitor_v = unit->monitor_gain * p->amplifier_v + unit->monitor_zero_v;
    r->tick = tick + 1;
    return gives_way;
}

bool edm_plant_follow(const struct machine *m) {
    struct plant *p = m->plant;
    const struct drive *drive = m->drive;
    if (drive->contact_tests != p->contact_tests) {
        p->contact_tests = drive->contact_tests;
        p->asperity_um = m->unit->contact_sd_um * m->noise[p->noise_at++];
    }
    if (drive->stage_moves == 0) {
        return false;
    }
    int64_t line = drive->stage_line;
    for (int64_t k = 0; k < drive->stage_lines_done; k++) {
        p->stage_error_x_um = p->line_error_x_um[line];
        p->stage_error_y_um = p->line_error_y_um[line];
        line = (line + 1) % PATH_LINES;
    }
    double share = drive->stage_share;
    if (share > 0.0) {
        p->stage_error_x_um += share * (p->line_error_x_um[line] - p->stage_error_x_um);
        p->stage_error_y_um += share * (p->line_error_y_um[line] - p->stage_error_y_um);
    }
    p->stage_way_um += drive->stage_way_um;
    return p->stage_way_um >= STAGE_STEP_UM;
}

/* The plant alone, for another controller: follows its drive, then lives through the millisecond. */
bool edm_plant_run(const struct machine *m) {
    bool look = edm_plant_follow(m);
    bool gives_way = edm_plant_tick(m);
    return look || gives_way;
}
