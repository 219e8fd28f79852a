/* The pulses of a millisecond, one by one: ignition, arcs, shorts, bridges, removal, wear and debris.
 *
 * The ignition delay is exponential (Laue) about a mean that grows with a power of the gap. Particles make chains that
 * short a gap of their size; a channel that has not lost its conductivity in the off-time ignites again at once, as an
 * arc; and sparks in a dirty gap that follow each other without delay arc too. What a discharge removes is in tables
 * over its burning time. Sources: edmctl/process/erosion.py; constants: edmctl/simulator/config.py.
 * Of each pulse `decide` is a uniform number that decides bridge, arc and side discharge in turn, `shape` one that
 * picks roughness and crater scatter from their tables, `delay` a unit exponential. */
#include "plant.h"

#include "../math/elementary.h"

#define MOST_DEBRIS 0.6
#define SHAPES ((double)TABLE * TABLE)
#define DEBRIS_GAP_UM 0.3 /* debris does not get thinner than this [assumed] */
#define LEAST_GAP_UM 0.02
#define LEAST_WALL_UM 20.0 /* a shallower hole has as much wall as one of this depth [assumed] */
#define CARBON_RUN 20      /* arcs in a row after which carbon grows [assumed] */
#define CARBON_ARCING 50.0 /* carbon that arcs */
#define CARBON_ARC_SHARE 0.9
#define CARBON_HEALING 0.01 /* less a spark */

/* The gap between two pulses: a copy of the plant's state, so that the loop need not store it for each pulse. */
struct gap {
    double depth_um, wear_um, debris_um3, bridge_until_um, carbon;
    double wall_um, arc_um3, crater_um3, crater_um6;
    double previous_burning, previous_arc; /* of the pulse before; -1 where there was none */
    int64_t arc_run;
};

/* A pulse that is being struck. */
struct pulse {
    double width_um, debris, local_um; /* gap, its debris fraction, gap at the place of the pulse */
    int shape;                         /* places in two tables in one number */
    double low, width;                 /* interval in which `decide` is still uniform */
    double delay_us, plateau_v, discharge_us, energy_uj;
    double burning; /* table step of the burning time, -1 without a discharge */
    double arc;
};

/* base to the power of a whole exponent; between two of them, their powers in proportion. */
static inline double power(double base, double exponent) {
    int whole = (int)exponent;
    double result = 1.0;
    for (int k = 0; k < whole; k++) {
        result *= base;
    }
    double rest = exponent - whole;
    return result * (1.0 - rest + rest * base);
}

/* Decide with the given share; the interval of the number becomes the part that it fell into. */
static inline bool falls(struct pulse *x, double number, double share) {
    double hit = share * x->width;
    if (number - x->low < hit) {
        x->width = hit;
        return true;
    }
    x->low += hit;
    x->width -= hit;
    return false;
}

/* A bridge breaks when the gap is wide enough, or by chance. */
static inline void break_bridge(const struct unit *unit, struct gap *g, struct pulse *x, double number) {
    if (x->width_um > g->bridge_until_um) {
        g->bridge_until_um = 0.0;
    } else if (number < unit->bridge_clear) {
        g->bridge_until_um = 0.0;
        x->width = unit->bridge_clear;
    }
}

/* A chain of particles: its chance is that of one, to the power of how many there have to be. Few pulses fall below a
 * bound of it, and only these need the power. */
static inline void make_bridge(const struct unit *unit, struct gap *g, struct pulse *x, double number,
                               double per_particle) {
    double particles = x->width_um * per_particle - 0.5, bound = 0.5;
    if (particles >= 1.0) {
        bound = lesser(0.5, unit->bridge_base * (particles >= 2.0 ? x->debris * x->debris : x->debris));
    }
    bound *= x->width;
    if (number >= bound) {
        x->low = bound;
        x->width -= bound;
        return;
    }
    double limit = lesser(bound, unit->bridge_base * edm_pow(x->debris, particles) * x->width);
    if (number < limit) {
        g->bridge_until_um = greater(x->width_um, LEAST_GAP_UM) + (1.5 + 40.0 * x->debris) * unit->particle_um;
    } else {
        x->low = limit;
        x->width = bound - limit;
    }
}

/* Chance that the channel of the discharge before ignites again: what its conductivity has left after the off-time. */
static inline double again(const struct unit *unit, const struct gap *g, const struct pulse *x) {
    if (g->previous_burning < 0.0 || !(unit->off_time_us < unit->longest_memory_us)) {
        return 0.0;
    }
    double memory_us = unit->deionisation_us[(int)g->previous_burning] * (1.0 + unit->deionisation_debris * x->debris);
    if (g->previous_arc > 0.0) {
        memory_us *= unit->deionisation_after_arc;
    }
    return edm_exp(-unit->off_time_us / memory_us);
}

/* Chance that a discharge that ignites after this delay is an arc. */
static inline double arc_share(const struct unit *unit, const struct gap *g, const struct pulse *x, double ignition_us) {
    if (g->carbon > CARBON_ARCING) {
        return CARBON_ARC_SHARE;
    }
    if (!(g->previous_burning >= 0.0)) {
        return unit->arc_base;
    }
    double dense = lesser(1.0, x->debris * x->debris * unit->arc_debris * (1.0 + 8.0 * g->previous_arc));
    double after = ignition_us / (unit->arc_delay_us * (1.0 + g->previous_arc));
    return lesser(1.0, unit->arc_base + dense * unit->arc_pause * edm_exp(-after));
}

/* What a discharge removes from work and tool, where, and what it leaves in the gap. */
static inline void erode(const struct machine *m, struct gap *g, struct pulse *x, int64_t at, double per_burning,
                         double side_slope) {
    const struct unit *unit = m->unit;
    bool arcs = x->arc > 0.0;
    double work_share = arcs ? unit->arc_work * unit->work_factor : unit->work_factor;
    double tool_share = arcs ? unit->arc_tool * unit->tool_factor : unit->tool_factor;
    double place = x->discharge_us * per_burning;
    int step = place > 0.0 && place < BURNING ? (int)place : place > 0.0 ? BURNING - 1 : 0;
    double molten_uj = greater(0.0, x->energy_uj - unit->threshold_uj) *
                       m->lognormal[x->shape / TABLE];
    double lost = x->debris * unit->per_redeposition;
    double removal_um3 = work_share * unit->work_um3_per_uj[step] * molten_uj / (1.0 + lost * lost);
    double worn_um3 = tool_share * unit->tool_um3_per_uj[step] * molten_uj;
    g->debris_um3 += removal_um3 + worn_um3;
    if (m->decide[at] - x->low >= (unit->side_base + side_slope * x->debris) * x->width) {
        g->depth_um += removal_um3 * m->plant->per_hole_area;
        g->wear_um += worn_um3 * unit->per_tool_area;
    } else {
        g->wall_um += removal_um3 * unit->per_rim_um / greater(g->depth_um, LEAST_WALL_UM);
    }
    g->crater_um3 += removal_um3;
    g->crater_um6 += removal_um3 * removal_um3;
    if (arcs) {
        g->arc_um3 += removal_um3;
    }
    x->burning = step;
}

/* A discharge begins: a spark after its delay, or an arc at once. */
static inline void discharge(const struct unit *unit, struct gap *g, struct pulse *x, bool arcs, double ignition_us) {
    if (arcs) {
        x->delay_us = 0.0;
        x->plateau_v = unit->arc_plateau_v;
        g->arc_run++;
        g->carbon += g->arc_run > CARBON_RUN ? 1.0 : 0.0;
    } else {
        x->delay_us = ignition_us;
        x->plateau_v = unit->discharge_v;
        g->arc_run = 0;
        g->carbon = greater(0.0, g->carbon - CARBON_HEALING);
    }
    x->arc = arcs ? 1.0 : 0.0;
    x->discharge_us = unit->on_time_us - x->delay_us;
    if (unit->discharge_set_us > 0.0) {
        x->discharge_us = lesser(x->discharge_us, unit->discharge_set_us);
    }
}

/* What an open gap does with a pulse; returns its charge in µC. */
static inline double ignite(const struct machine *m, struct gap *g, struct pulse *x, int64_t at, double tau_us,
                            double per_burning, double side_slope) {
    const struct unit *unit = m->unit;
    double share = again(unit, g, x);
    double ignition_us = unit->formative_us + tau_us * power(x->local_um * unit->per_open_gap, unit->gap_exponent) * m->delay[at];
    bool ignites = ignition_us < unit->on_time_us;
    if (!ignites && !(share > 0.0)) {
        return 0.0;
    }
    bool arcs = falls(x, m->decide[at], share);
    if (!arcs && ignites) {
        arcs = falls(x, m->decide[at], arc_share(unit, g, x, ignition_us));
    }
    if (!arcs && !ignites) {
        return 0.0;
    }
    discharge(unit, g, x, arcs, ignition_us);
    double charge_uc = greater(0.0, unit->open_v - x->plateau_v) * unit->siemens * x->discharge_us;
    x->energy_uj = x->plateau_v * charge_uc;
    erode(m, g, x, at, per_burning, side_slope);
    return charge_uc;
}

static inline struct gap gap_of(const struct plant *p) {
    return (struct gap){.depth_um = p->depth_um,
                        .wear_um = p->wear_um,
                        .debris_um3 = p->debris_um3,
                        .bridge_until_um = p->bridge_until_um,
                        .carbon = p->carbon,
                        .wall_um = p->wall_um,
                        .arc_um3 = p->arc_um3,
                        .crater_um3 = p->crater_um3,
                        .crater_um6 = p->crater_um6,
                        .previous_burning = p->previous_burning,
                        .previous_arc = p->previous_arc,
                        .arc_run = p->true_arc_run};
}

static inline void put_gap(struct plant *p, const struct gap *g) {
    p->depth_um = g->depth_um;
    p->wear_um = g->wear_um;
    p->debris_um3 = g->debris_um3;
    p->bridge_until_um = g->bridge_until_um;
    p->carbon = g->carbon;
    p->wall_um = g->wall_um;
    p->arc_um3 = g->arc_um3;
    p->crater_um3 = g->crater_um3;
    p->crater_um6 = g->crater_um6;
    p->previous_burning = g->previous_burning;
    p->previous_arc = g->previous_arc;
    p->true_arc_run = g->arc_run;
}

void edm_strike_pulses(const struct machine *m) {
    const struct unit *unit = m->unit;
    struct plant *p = m->plant;
    struct scope *scope = m->scope;
    struct readings *r = m->readings;
    int64_t begin_ns = r->tick * PLANT_TICK_NS, end_ns = begin_ns + PLANT_TICK_NS;
    /* A controller that was switched on again counts its starts anew. */
    if (m->drive->pulse_starts != p->pulse_starts || p->next_pulse_ns < begin_ns) {
        p->pulse_starts = m->drive->pulse_starts;
        p->next_pulse_ns = begin_ns;
    }
    struct gap g = gap_of(p);
    double reach_um = p->surface_um - p->true_z_um, tau_us = unit->tau_reference_us * p->rarity;
    double per_particle = 1.0 / unit->particle_um, per_burning = BURNING / unit->on_time_us;
    double per_period = 1e3 / (double)unit->pulse_period_ns;
    double side_slope = unit->side_debris * lesser(1.0, g.depth_um * 0.01);
    double voltage_sum = 0.0, charge_uc = 0.0;
    bool away = unit->mode_stuck == STUCK_AT_CONTACT; /* the pulses end at the mode switch, the gap has no voltage */
    double stuck_v = away && unit->gap_stuck_v < 0.0 ? 0.0 : unit->gap_stuck_v;
    double read = greater(0.0, unit->gap_wire); /* a converter has no negative voltage */
    int64_t next_ns = p->next_pulse_ns, at = p->random_at, count = 0;
    r->first_pulse_ns = next_ns;

    for (; next_ns < end_ns && count < MOST_PULSES; next_ns += unit->pulse_period_ns, at++, count++) {
        struct pulse x = {.width = 1.0, .delay_us = unit->on_time_us, .plateau_v = unit->open_v, .burning = -1.0};
        x.width_um = reach_um + g.depth_um + g.wear_um;
        x.debris = lesser(MOST_DEBRIS, g.debris_um3 * unit->per_tool_area / greater(x.width_um, DEBRIS_GAP_UM));
        x.shape = (int)(m->shape[at] * SHAPES);
        x.local_um = greater(LEAST_GAP_UM, x.width_um * (1.0 - unit->debris_gap_factor * x.debris)) -
                     unit->roughness_um * m->half_normal[x.shape % TABLE] - unit->gap_closed_um;
        if (g.bridge_until_um > 0.0) {
            break_bridge(unit, &g, &x, m->decide[at]);
        }
        if (g.bridge_until_um == 0.0 && x.debris > 0.0) {
            make_bridge(unit, &g, &x, m->decide[at], per_particle);
        }
        if (!away && (x.width_um <= 0.0 || g.bridge_until_um > 0.0 || x.local_um <= 0.0)) {
            x.delay_us = 0.0;
            x.plateau_v = unit->short_plateau_v;
            x.discharge_us = unit->on_time_us;
            charge_uc += greater(0.0, unit->open_v - x.plateau_v) * unit->siemens * x.discharge_us;
        } else if (!away) {
            charge_uc += ignite(m, &g, &x, at, tau_us, per_burning, side_slope);
        }
        g.previous_burning = x.burning;
        g.previous_arc = x.arc;
        g.debris_um3 *= p->clearing;
        voltage_sum += (x.delay_us * unit->open_v + x.discharge_us * x.plateau_v) * per_period;
        r->delay_us[count] = x.delay_us;
        r->discharge_us[count] = x.discharge_us;
        r->plateau_v[count] = read * (stuck_v < 0.0 ? x.plateau_v : stuck_v);
        r->energy_uj[count] = x.energy_uj;
        int64_t newest = scope->at++ & (SCOPE_PULSES - 1);
        scope->start_ns[newest] = (double)next_ns;
        scope->delay_us[newest] = x.delay_us;
        scope->discharge_us[newest] = x.discharge_us;
        scope->plateau_v[newest] = x.plateau_v;
        scope->siemens[newest] = unit->siemens;
        scope->leak_a[newest] = unit->off_time_a;
        scope->stuck_v[newest] = stuck_v;
    }
    put_gap(p, &g);
    p->random_at = at;
    p->next_pulse_ns = next_ns;
    if (charge_uc > 0.0 && unit->off_time_a > 0.0) {
        charge_uc += unit->off_time_a * ((double)unit->pulse_period_ns * 1e-3 - unit->on_time_us) * (double)count;
    }
    if (stuck_v >= 0.0) {
        voltage_sum = stuck_v * (double)count;
    }
    r->pulses = count;
    r->charge_uc = charge_uc;
    r->gap_v = count > 0 ? read * voltage_sum / (double)count : NOT_A_NUMBER;
    r->generator_siemens = charge_uc > 0.0 ? unit->siemens : 0.0;
    r->off_time_a = unit->off_time_a;
}
