/* Pulses of a millisecond: when they began, ignited and ended, by edges; voltage and current by samples. */
#include "measure.h"

#include "scale.h"

#define SAMPLES_MOST 8u    /* that a mean is made of; fewer where pulses follow each other fast */
#define SAMPLES_LEAST 2u
#define COUNTS_PER_SAMPLE (10u * COUNTS_PER_US) /* of the period: at 50 kHz there are two */
#define TWO_TOPS 0x10001u  /* added to a word at full scale it carries into bits 12 and 28 */
#define TOP_VOLTS (1u << 12)
#define TOP_AMPS (1u << 28)
#define SETTLE_COUNTS (3u * COUNTS_PER_US) /* of the voltage after the gate opens, of the current after it closes */
#define STRIKE_COUNTS (COUNTS_PER_US / 2u) /* of voltage and current after ignition */
#define MARGIN_COUNTS (2u * COUNTS_PER_US) /* an edge of the gate itself may come so late */
#define LEAST_A R(0.02)    /* less is no current */
#define LEAST_GAP_V R(1.0) /* less, without pulses, is no voltage */
#define LEAST_DROP R(0.05) /* of the open voltage: with less no conductance can be told */
#define SAME_OPEN R(0.02)  /* of the open voltage: a divider that agrees so well with the supply says nothing new */
#define NOT_A_NUMBER R(__builtin_nanf(""))
#define LOOKS_MOST 8u      /* pulses of a millisecond whose open voltage and off-time are looked at */
#define PULSES_AT_ONCE 16u /* of so many first all edges, ring by ring, then all samples: registers are few */
#define NOINLINE __attribute__((noinline))
#define SCANS_MEANT 16u
#define REST_STRIDE 4u     /* without pulses, each so many samples are looked at */
#define EDGES_MOST (EDGES - 1u - EDGES / 4u) /* that wait in a ring; while they are read, others come */
#define NEVER_COUNTS (1u << 30) /* from now: no pulse lasts so long */

/* Samples of a millisecond, and how many of them make a mean. */
struct view {
    const volatile uint32_t *ring;
    uint32_t size, at, held;
    uint32_t now, most;
};

/* Sum of samples that follow each other, voltage and current as in a sample: the halves have room for SAMPLES_MOST. */
struct sum {
    uint32_t both, count;
    uint32_t tops;       /* TOP_VOLTS, TOP_AMPS: one was at full scale */
};

/* Their means, V and A; NaN without any, or with one at full scale. */
struct means {
    real volts, amps;
};

/* Edges of a ring, one after the other. */
struct walk {
    const volatile uint32_t *ring;
    uint32_t at, end;
    uint32_t next;       /* time of the one at `at`, or never */
    uint32_t never;
};

/* One pulse. Without current `ignition` and `end` are when its gate closes. */
struct pulse {
    uint32_t start;
    uint32_t rise, last_rise; /* of the comparator */
    uint32_t ignition, end; /* of the current, counts since its begin */
};

static real us_of(uint32_t counts) {
    return (real)counts / R(84.0);
}

static bool is_before(uint32_t a, uint32_t b) {
    return (int32_t)(a - b) < 0;
}

/* Samples that lie in [from, to), counts of the timer; `limit` at most, from their middle. */
static struct sum sum_of(const struct view *v, uint32_t from, uint32_t to, uint32_t limit) {
    struct sum sum = {0};
    int32_t from_back = (int32_t)(v->now - from), to_back = (int32_t)(v->now - to);
    uint32_t from_us = (uint32_t)from_back / COUNTS_PER_US; /* whole microseconds back from now, rounded towards now */
    uint32_t to_us = to_back > 0 ? (uint32_t)to_back / COUNTS_PER_US : 0;
    from_us = from_us < v->held ? from_us : v->held;
    if (from_back <= 0 || from_us <= to_us) {
        return sum;
    }
    uint32_t count = from_us - to_us;
    if (count > limit) {
        from_us -= (count - limit) / 2u;
        count = limit;
    }
    uint32_t at = v->at >= from_us ? v->at - from_us : v->at + v->size - from_us;
    sum.count = count;
    do {
        uint32_t word = v->ring[at];
        sum.both += word;
        sum.tops |= word + TWO_TOPS;
        at = at + 1u == v->size ? 0 : at + 1u;
    } while (--count > 0);
    return sum;
}

static inline struct means means_of(const struct sum *sum) {
    struct means means = {NOT_A_NUMBER, NOT_A_NUMBER};
    if (sum->count == 0) {
        return means;
    }
    real full = (real)(sum->count * ADC_TOP);
    if ((sum->tops & TOP_VOLTS) == 0) {
        means.volts = (real)(sum->both & 0xFFFFu) / full * EDM_GAP_FULL_V;
    }
    if ((sum->tops & TOP_AMPS) == 0) {
        means.amps = (real)(sum->both >> 16) / full * EDM_GAP_FULL_A;
    }
    return means;
}

static void look_on(struct walk *walk) {
    walk->next = walk->at == walk->end ? walk->never : walk->ring[walk->at];
}

/* From where the reading has come to. */
static struct walk begin_walk(const struct edges *edges, const struct follower *follower, uint32_t now) {
    struct walk walk = {.ring = edges->ring, .at = follower->at, .end = edges->at, .never = now + NEVER_COUNTS};
    look_on(&walk);
    return walk;
}

/* Takes the next edge, of which there is one where `next` is before anything. */
static uint32_t take_edge(struct walk *walk) {
    uint32_t time = walk->next;
    walk->at = (walk->at + 1u) % EDGES;
    look_on(walk);
    return time;
}

static void skip_edges(struct walk *walk, uint32_t before) {
    while (is_before(walk->next, before)) {
        take_edge(walk);
    }
}

/* What stands where the mark is: behind as many edges as may wait. */
static uint32_t mark_of(const struct edges *edges, uint32_t at) {
    return edges->ring[(at + EDGES_MOST) % EDGES];
}

/* Whether the ring holds every edge that has come since it was read, and will until it has been. Else it is passed over. */
static bool has_all(const struct edges *edges, struct follower *follower) {
    if (mark_of(edges, follower->at) == follower->mark && (edges->at - follower->at) % EDGES < EDGES_MOST) {
        return true;
    }
    follower->at = edges->at;
    return false;
}

static void set_mark(const struct edges *edges, struct follower *follower) {
    follower->mark = mark_of(edges, follower->at);
}

/* Passes over edges before a time; returns how many. */
static uint32_t pass_over(const struct edges *edges, struct follower *follower, uint32_t now, uint32_t before) {
    struct walk walk = begin_walk(edges, follower, now);
    skip_edges(&walk, before);
    uint32_t count = (walk.at - follower->at) % EDGES;
    follower->at = walk.at;
    return count;
}

/* Begins of the next pulses whose gate time has ended, PULSES_AT_ONCE at most; returns their end. */
static NOINLINE struct pulse *find_starts(const struct edges *edges, struct follower *follower, struct pulse *pulses,
                                          uint32_t now, uint32_t on_counts) {
    struct walk gates = begin_walk(edges, follower, now);
    uint32_t closed = now - on_counts + 1u;
    struct pulse *pulse = pulses;
    while (pulse < pulses + PULSES_AT_ONCE && is_before(gates.next, closed)) {
        pulse->start = take_edge(&gates);
        pulse++;
    }
    follower->at = gates.at;
    return pulse;
}

/* Finds current in pulses by the edges of the comparator: from the first rise to the last fall in the gate's time. Without a
 * rise the current was there before; without a fall it lasts as long as the gate. A fall just after the begin is that of the
 * pulse before. First the rises. */
static NOINLINE void find_rises(const struct edges *edges, struct follower *follower, struct pulse *pulse,
                                const struct pulse *end, uint32_t now, uint32_t on_counts) {
    struct walk rises = begin_walk(edges, follower, now);
    for (; pulse < end; pulse++) {
        uint32_t start = pulse->start, gate_end = start + on_counts;
        pulse->rise = gate_end;
        pulse->last_rise = start;
        skip_edges(&rises, start);
        if (is_before(rises.next, gate_end)) {
            pulse->rise = rises.next;
            do {
                pulse->last_rise = take_edge(&rises);
            } while (is_before(rises.next, gate_end));
        }
    }
    follower->at = rises.at;
}

/* Then the falls. */
static NOINLINE void find_falls(const struct edges *edges, struct follower *follower, struct pulse *pulse,
                                const struct pulse *end, uint32_t now, uint32_t on_counts) {
    struct walk falls = begin_walk(edges, follower, now);
    for (; pulse < end; pulse++) {
        uint32_t start = pulse->start, gate_end = start + on_counts, rise = pulse->rise, fall = gate_end;
        while (is_before(falls.next, rise) && is_before(falls.next, start + MARGIN_COUNTS)) {
            take_edge(&falls);
        }
        if (is_before(falls.next, gate_end)) {
            rise = is_before(falls.next, rise) ? start : rise;
            do {
                fall = take_edge(&falls);
            } while (is_before(falls.next, gate_end));
            fall = is_before(fall, pulse->last_rise) ? gate_end : fall;
        }
        pulse->ignition = rise - start;
        pulse->end = fall - start;
    }
    follower->at = falls.at;
}

/* The next pulses and their current; returns their end. */
static const struct pulse *find_pulses(struct measure *m, const struct records *r, uint32_t on_counts,
                                       struct pulse *pulses) {
    const struct pulse *end = find_starts(&r->gates, &m->gates, pulses, r->now, on_counts);
    struct pulse *pulse = pulses;
    for (; m->blind && pulse < end; pulse++) {
        if (!is_before(pulse->start, m->blind_until)) {
            m->blind = false;
            break;
        }
        pulse->ignition = pulse->end = on_counts;
    }
    find_rises(&r->ignitions, &m->ignitions, pulse, end, r->now, on_counts);
    find_falls(&r->ends, &m->ends, pulse, end, r->now, on_counts);
    return end;
}

/* Open voltage by the samples before ignition; what is set where there are none, or where they agree with it. */
static real open_voltage(const struct view *v, const struct pulse *pulse, real set_v) {
    if (pulse->ignition <= SETTLE_COUNTS) {
        return set_v;
    }
    uint32_t span = v->most * COUNTS_PER_US;
    uint32_t begin = pulse->ignition - SETTLE_COUNTS > span ? pulse->ignition - span : SETTLE_COUNTS;
    struct sum sum = sum_of(v, pulse->start + begin, pulse->start + pulse->ignition, v->most);
    if (sum.count == 0) {
        return set_v;
    }
    real seen_v = means_of(&sum).volts;
    return magnitude(seen_v - set_v) <= SAME_OPEN * set_v ? set_v : seen_v;
}

/* Samples of a discharge: from its middle, or else the first one behind ignition, which may be after its end. */
static struct sum discharge_of(const struct view *v, const struct pulse *pulse) {
    uint32_t from = pulse->start + pulse->ignition;
    if (pulse->end - pulse->ignition > 2u * STRIKE_COUNTS) {
        struct sum sum = sum_of(v, from + STRIKE_COUNTS, pulse->start + pulse->end, v->most);
        if (sum.count > 0) {
            return sum;
        }
    }
    from += STRIKE_COUNTS / 2u;
    return sum_of(v, from, from + COUNTS_PER_US, 1);
}

/* Samples of a pulse that no comparator tells of: they say whether there was current, then from its begin on. */
static struct sum find_by_samples(const struct view *v, struct pulse *pulse, uint32_t on_counts) {
    uint32_t from = pulse->start, to = from + on_counts;
    struct sum sum = sum_of(v, from + on_counts / 2u, to, v->most);
    if (sum.count == 0) {
        return sum_of(v, from, from + COUNTS_PER_US, 1);
    }
    if (!(means_of(&sum).amps < LEAST_A)) {
        pulse->ignition = 0;
    }
    return sum;
}

/* Greater of two; what is no number is the greatest. */
static real most_or_nan(real a, real b) {
    return a >= b || a != a ? a : b;
}

/* What the pulses of a millisecond make together. */
struct total {
    real volt_us, charge_uc, generator_siemens;
    real open_v;         /* of the pulse before */
    real least_drop_v;   /* of a conductance */
    uint32_t off_amps, off_count, off_tops; /* samples before pulses, when the ones before should have gone out */
};

/* Samples before a pulse, when the one before it should have gone out. */
static void add_off_time(struct total *total, const struct view *v, uint32_t start, const struct gate *gate) {
    uint32_t off = gate->period_counts - gate->on_counts;
    uint32_t span = v->most * COUNTS_PER_US;
    if (off <= SETTLE_COUNTS + COUNTS_PER_US) {
        return;
    }
    uint32_t back = off - SETTLE_COUNTS < span ? off - SETTLE_COUNTS : span;
    struct sum sum = sum_of(v, start - back, start - COUNTS_PER_US / 2u, v->most);
    total->off_amps += sum.both >> 16;
    total->off_count += sum.count;
    total->off_tops |= sum.tops;
}

/* Mean current of the off-times, A. */
static real off_time_current(const struct total *total) {
    if (total->off_count == 0) {
        return 0;
    }
    if ((total->off_tops & TOP_AMPS) != 0) {
        return NOT_A_NUMBER;
    }
    real amps = (real)total->off_amps / (real)(total->off_count * ADC_TOP) * EDM_GAP_FULL_A;
    return amps < LEAST_A ? 0 : amps;
}

/* Takes what one pulse says into the readings, as pulse i; its open voltage is looked at, or that of the one before holds. */
static void read_pulse(struct edm_readings *out, uint32_t i, const struct view *v, struct pulse *pulse,
                       const struct gate *gate, struct total *total, bool looks) {
    uint32_t on_counts = gate->on_counts;
    struct sum sum = pulse->ignition < on_counts ? discharge_of(v, pulse) : find_by_samples(v, pulse, on_counts);
    if (looks) {
        total->open_v = open_voltage(v, pulse, gate->open_v);
    }
    struct means means = means_of(&sum);
    real delay_us = us_of(pulse->ignition);
    out->delay_us[i] = delay_us;
    out->plateau_v[i] = means.volts;
    if (pulse->ignition == on_counts) {
        out->discharge_us[i] = out->energy_uj[i] = 0;
        total->volt_us += delay_us * total->open_v;
        return;
    }
    uint32_t discharge = pulse->end - pulse->ignition;
    real discharge_us = us_of(discharge);
    /* An edge on the grid of the timer is a discharge, however short. */
    out->discharge_us[i] = discharge > 0 ? discharge_us : us_of(1);
    out->energy_uj[i] = means.volts * means.amps * discharge_us;
    total->charge_uc += means.amps * discharge_us;
    real drop_v = total->open_v - means.volts;
    if (!(drop_v < total->least_drop_v)) {
        total->generator_siemens = most_or_nan(means.amps / drop_v, total->generator_siemens);
    }
    total->volt_us += delay_us * total->open_v + discharge_us * means.volts;
}

/* Pulses whose gate time has ended. */
static void read_pulses(struct measure *m, const struct records *r, const struct gate *gate, struct edm_readings *out) {
    uint32_t means = gate->period_counts / COUNTS_PER_SAMPLE;
    means = means < SAMPLES_LEAST ? SAMPLES_LEAST : means < SAMPLES_MOST ? means : SAMPLES_MOST;
    const struct view view = {r->samples.ring, r->samples.size, r->samples.at, r->samples.good ? r->samples.held : 0,
                              r->now, means};
    struct total total = {.open_v = gate->open_v, .least_drop_v = LEAST_DROP * gate->open_v};
    struct pulse pulses[PULSES_AT_ONCE];
    const struct pulse *end;
    uint32_t count = 0;
    if (m->changes != gate->changes) {
        pass_over(&r->gates, &m->gates, r->now, gate->on_since - MARGIN_COUNTS);
        m->first = true;
    }
    while ((end = find_pulses(m, r, gate->on_counts, pulses)) != pulses) {
        if (count == 0) {
            int64_t age = (int32_t)(r->now - pulses[0].start);
            out->first_pulse_ns = r->now_ns - age * 1000 / (int64_t)COUNTS_PER_US;
        }
        for (struct pulse *pulse = pulses; pulse < end && count < EDM_MOST_PULSES; pulse++, count++) {
            bool looks = count < LOOKS_MOST;
            if (looks && !m->first) {
                add_off_time(&total, &view, pulse->start, gate);
            }
            m->first = false;
            read_pulse(out, count, &view, pulse, gate, &total, looks);
        }
    }
    out->pulses = (uint8_t)count;
    if (count > 0) {
        real mean_v = total.volt_us / (us_of(gate->period_counts) * (real)count);
        out->gap_v = r->samples.good ? mean_v : NOT_A_NUMBER;
        out->charge_uc = total.charge_uc;
        out->generator_siemens = total.generator_siemens;
        out->off_time_a = off_time_current(&total);
    }
}

/* Edges of the gate while it is off: something else opens it. */
static void count_strays(struct measure *m, const struct records *r, const struct gate *gate, struct edm_readings *out) {
    if (m->changes != gate->changes) {
        pass_over(&r->gates, &m->gates, r->now, gate->off_since + MARGIN_COUNTS);
    }
    uint32_t strays = out->stray_pulses + pass_over(&r->gates, &m->gates, r->now, r->now);
    out->stray_pulses = (uint8_t)(strays < UINT8_MAX ? strays : UINT8_MAX);
    pass_over(&r->ignitions, &m->ignitions, r->now, r->now);
    pass_over(&r->ends, &m->ends, r->now, r->now);
    m->blind = false;
}

/* Looks whether edges were lost. Those of the comparator are absent then from both its rings, for every pulse that began before:
 * the samples speak. Without those of the gate there are no pulses while it is on; while it is off, all of them are strays. */
static void look_for_losses(struct measure *m, const struct records *r, const struct gate *gate, struct edm_readings *out) {
    bool has_rises = has_all(&r->ignitions, &m->ignitions), has_falls = has_all(&r->ends, &m->ends);
    if (!has_rises || !has_falls) {
        m->ignitions.at = r->ignitions.at;
        m->ends.at = r->ends.at;
        m->blind = true;
        m->blind_until = r->now;
    }
    if (!has_all(&r->gates, &m->gates)) {
        m->first = true;
        out->stray_pulses = gate->on ? 0 : UINT8_MAX;
    }
}

/* Voltage of a gap without pulses; NaN where there is none. */
static real resting_voltage(const struct samples *s) {
    uint32_t count = s->held < 1000u ? s->held : 1000u, volts = 0, looked = 0;
    if (!s->good) {
        return NOT_A_NUMBER;
    }
    for (uint32_t back = count; back >= REST_STRIDE; back -= REST_STRIDE) {
        volts += s->ring[(s->at + s->size - back) % s->size] & 0xFFFu;
        looked++;
    }
    if (looked == 0 || volts == looked * ADC_TOP) {
        return NOT_A_NUMBER;
    }
    real v = (real)volts / (real)(looked * ADC_TOP) * EDM_GAP_FULL_V;
    return v > LEAST_GAP_V ? v : NOT_A_NUMBER;
}

void measure_millisecond(struct measure *m, const struct records *records, const struct gate *gate,
                         struct edm_readings *readings) {
    readings->pulses = readings->stray_pulses = 0;
    readings->charge_uc = readings->generator_siemens = readings->off_time_a = 0;
    readings->first_pulse_ns = records->now_ns;
    readings->gap_v = NOT_A_NUMBER;
    readings->sensor_um = measure_slow(&records->scans, SLOW_DISPLACEMENT);
    readings->monitor_v = measure_slow(&records->scans, SLOW_MONITOR);
    look_for_losses(m, records, gate, readings);
    if (gate->on) {
        read_pulses(m, records, gate, readings);
    } else {
        count_strays(m, records, gate, readings);
        readings->gap_v = resting_voltage(&records->samples);
    }
    m->changes = gate->changes;
    set_mark(&records->gates, &m->gates);
    set_mark(&records->ignitions, &m->ignitions);
    set_mark(&records->ends, &m->ends);
}

real measure_slow(const struct scans *scans, enum slow channel) {
    static const struct {
        real least, most;
        bool live_zero; /* 0 is no reading of it */
    } ranges[SLOW_CHANNELS] = {
        [SLOW_MONITOR] = {EDM_MONITOR_LEAST_V, EDM_MONITOR_MOST_V, true},
        [SLOW_DISPLACEMENT] = {EDM_SENSOR_LEAST_UM, EDM_SENSOR_MOST_UM, true},
        [SLOW_TEMPERATURE] = {0, EDM_TEMPERATURE_FULL_C, false},
        [SLOW_FLOW] = {0, EDM_FLOW_FULL_LPM, false},
    };
    uint32_t lowest = ranges[channel].live_zero, in_range = ADC_TOP - lowest;
    uint32_t sum = 0, railed = 0;
    uint32_t at = scans->at / SLOW_CHANNELS * SLOW_CHANNELS + (uint32_t)channel; /* of the scan under way */
    for (uint32_t i = 0; i < SCANS_MEANT; i++) {
        at = at >= SLOW_CHANNELS ? at - SLOW_CHANNELS : at + scans->size - SLOW_CHANNELS;
        uint32_t count = scans->ring[at] & 0xFFFu;
        sum += count;
        railed += count - lowest >= in_range;
    }
    if (!scans->good || railed > SCANS_MEANT / 2u) {
        return NOT_A_NUMBER;
    }
    real share = (real)sum / (real)(SCANS_MEANT * ADC_TOP);
    return ranges[channel].least + share * (ranges[channel].most - ranges[channel].least);
}
