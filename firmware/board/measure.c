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
#define SCANS_MEANT 16u
#define REST_STRIDE 4u     /* without pulses, each so many samples are looked at */

/* Sums of samples. */
struct sum {
    uint32_t volts, amps, count;
    uint32_t tops;       /* TOP_VOLTS, TOP_AMPS: one was at full scale */
};

/* One pulse: times are counts since its begin. */
struct pulse {
    uint32_t start;
    uint32_t samples;    /* for each mean */
    uint32_t ignition, end; /* of the current */
    bool ignited;
};

static real us_of(uint32_t counts) {
    return (real)counts / R(84.0);
}

static bool is_before(uint32_t a, uint32_t b) {
    return (int32_t)(a - b) < 0;
}

/* Adds samples that lie in [from, to), counts of the timer; `limit` at most, from their middle. */
static void add_samples(struct sum *sum, const struct records *r, uint32_t from, uint32_t to, uint32_t limit) {
    const struct samples *s = &r->samples;
    uint32_t from_us = (r->now - from) / COUNTS_PER_US; /* whole microseconds back from now, rounded towards now */
    uint32_t to_us = is_before(to, r->now) ? (r->now - to) / COUNTS_PER_US : 0;
    from_us = from_us < s->held ? from_us : s->held;
    if (!s->good || !is_before(from, r->now) || from_us <= to_us) {
        return;
    }
    uint32_t count = from_us - to_us;
    if (count > limit) {
        from_us -= (count - limit) / 2u;
        count = limit;
    }
    uint32_t at = s->at >= from_us ? s->at - from_us : s->at + s->size - from_us;
    uint32_t both = 0; /* halves do not run over: 12 bits, and at most SAMPLES_MOST of them */
    for (uint32_t i = 0; i < count; i++) {
        uint32_t word = s->ring[at];
        both += word;
        sum->tops |= word + TWO_TOPS;
        at = at + 1u == s->size ? 0 : at + 1u;
    }
    sum->volts += both & 0xFFFFu;
    sum->amps += both >> 16;
    sum->count += count;
}

/* Mean voltage of samples, V; NaN without any, or with one at full scale. */
static real mean_volts(const struct sum *sum) {
    if (sum->count == 0 || (sum->tops & TOP_VOLTS) != 0) {
        return NOT_A_NUMBER;
    }
    return (real)sum->volts / (real)(sum->count * ADC_TOP) * EDM_GAP_FULL_V;
}

/* Mean current of samples, A; NaN as for the voltage. */
static real mean_amps(const struct sum *sum) {
    if (sum->count == 0 || (sum->tops & TOP_AMPS) != 0) {
        return NOT_A_NUMBER;
    }
    return (real)sum->amps / (real)(sum->count * ADC_TOP) * EDM_GAP_FULL_A;
}

/* Takes the next edge that is before `until`; `*at` then stands behind it. */
static bool next_edge(const struct edges *edges, uint32_t *at, uint32_t until, uint32_t *time) {
    if (*at == edges->at) {
        return false;
    }
    *time = edges->ring[*at];
    if (!is_before(*time, until)) {
        return false;
    }
    *at = *at + 1u == edges->size ? 0 : *at + 1u;
    return true;
}

/* Passes over edges before a time. */
static void skip_edges(const struct edges *edges, uint32_t *at, uint32_t before) {
    uint32_t time;
    while (next_edge(edges, at, before, &time)) {
    }
}

/* Finds current in a pulse by the edges of the comparator: from the first rise to the last fall in the gate's time. Without
 * a rise the current was there before; without a fall it lasts as long as the gate. A fall just after the begin is that of
 * the pulse before. */
static void find_current(struct measure *m, const struct records *r, struct pulse *pulse, uint32_t on_counts) {
    uint32_t gate_end = pulse->start + on_counts;
    uint32_t rise = gate_end, last_rise = pulse->start, fall = 0, time;
    bool rose = false, fell = false;
    while (next_edge(&r->ignitions, &m->ignitions_at, gate_end, &time)) {
        if (is_before(time, pulse->start)) {
            continue;
        }
        rise = rose ? rise : time;
        last_rise = time;
        rose = true;
    }
    while (next_edge(&r->ends, &m->ends_at, gate_end, &time)) {
        if (is_before(time, pulse->start + MARGIN_COUNTS) && is_before(time, rise)) {
            continue;
        }
        rise = !fell && is_before(time, rise) ? pulse->start : rise;
        fall = time;
        fell = true;
    }
    pulse->ignited = rose || fell;
    pulse->ignition = rise - pulse->start;
    pulse->end = fell && !is_before(fall, last_rise) ? fall - pulse->start : on_counts;
}

/* Open voltage by the samples before ignition; what is set where there are none, or where they agree with it. */
static real open_voltage(const struct records *r, const struct pulse *pulse, real set_v) {
    struct sum sum = {0};
    if (pulse->ignition > SETTLE_COUNTS) {
        uint32_t span = pulse->samples * COUNTS_PER_US;
        uint32_t begin = pulse->ignition - SETTLE_COUNTS > span ? pulse->ignition - span : SETTLE_COUNTS;
        add_samples(&sum, r, pulse->start + begin, pulse->start + pulse->ignition, pulse->samples);
    }
    if (sum.count == 0) {
        return set_v;
    }
    real seen_v = mean_volts(&sum);
    return magnitude(seen_v - set_v) <= SAME_OPEN * set_v ? set_v : seen_v;
}

/* Adds the samples of a discharge: from its middle, or else the first one behind ignition, which may be after its end. */
static void add_discharge(struct sum *sum, const struct records *r, const struct pulse *pulse) {
    uint32_t from = pulse->start + pulse->ignition, to = pulse->start + pulse->end;
    if (pulse->end - pulse->ignition > 2u * STRIKE_COUNTS) {
        add_samples(sum, r, from + STRIKE_COUNTS, to, pulse->samples);
    }
    if (sum->count == 0) {
        from += STRIKE_COUNTS / 2u;
        add_samples(sum, r, from, from + COUNTS_PER_US, 1);
    }
}

/* Greater of two; what is no number is the greatest. */
static real most_or_nan(real a, real b) {
    return a >= b || a != a ? a : b;
}

/* Takes what one pulse says into the readings; returns its share of the mean gap voltage, V us. `open_v` is that of the
 * pulse before, and then its own. */
static real read_pulse(struct edm_readings *out, const struct records *r, struct pulse *pulse, const struct gate *gate,
                       real *open_v) {
    uint8_t i = out->pulses++;
    struct sum sum = {0};
    if (!pulse->ignited) { /* a comparator that does not speak: the samples do */
        add_samples(&sum, r, pulse->start + gate->on_counts / 2u, pulse->start + gate->on_counts, pulse->samples);
        real amps = mean_amps(&sum);
        pulse->ignited = sum.count > 0 && !(amps < LEAST_A);
        pulse->ignition = pulse->ignited ? 0 : gate->on_counts;
        pulse->end = gate->on_counts;
        if (sum.count == 0) {
            add_samples(&sum, r, pulse->start, pulse->start + COUNTS_PER_US, 1);
        }
    } else {
        add_discharge(&sum, r, pulse);
    }
    if (i < LOOKS_MOST) {
        *open_v = open_voltage(r, pulse, gate->open_v);
    }
    real delay_us = us_of(pulse->ignition), discharge_us = us_of(pulse->end - pulse->ignition);
    real plateau_v = mean_volts(&sum), amps = mean_amps(&sum);
    out->delay_us[i] = delay_us;
    out->plateau_v[i] = plateau_v;
    out->discharge_us[i] = out->energy_uj[i] = 0;
    if (!pulse->ignited) {
        return delay_us * *open_v;
    }
    /* An edge on the grid of the timer is a discharge, however short. */
    out->discharge_us[i] = discharge_us > 0 ? discharge_us : us_of(1);
    out->energy_uj[i] = plateau_v * amps * discharge_us;
    out->charge_uc += amps * discharge_us;
    real drop_v = *open_v - plateau_v;
    if (!(drop_v < LEAST_DROP * gate->open_v)) {
        out->generator_siemens = most_or_nan(amps / drop_v, out->generator_siemens);
    }
    return delay_us * *open_v + discharge_us * plateau_v;
}

/* Samples before a pulse, when the one before it should have gone out. */
static void add_off_time(struct sum *sum, const struct records *r, const struct pulse *pulse, const struct gate *gate) {
    uint32_t off = gate->period_counts - gate->on_counts;
    uint32_t span = pulse->samples * COUNTS_PER_US;
    if (off <= SETTLE_COUNTS + COUNTS_PER_US) {
        return;
    }
    uint32_t back = off - SETTLE_COUNTS < span ? off - SETTLE_COUNTS : span;
    add_samples(sum, r, pulse->start - back, pulse->start - COUNTS_PER_US / 2u, pulse->samples);
}

/* Pulses whose gate time has ended. */
static void read_pulses(struct measure *m, const struct records *r, const struct gate *gate, struct edm_readings *out) {
    uint32_t time;
    uint32_t samples = gate->period_counts / COUNTS_PER_SAMPLE;
    samples = samples < SAMPLES_LEAST ? SAMPLES_LEAST : samples < SAMPLES_MOST ? samples : SAMPLES_MOST;
    struct sum off = {0};
    real volt_us = 0, open_v = gate->open_v;
    if (m->changes != gate->changes) {
        skip_edges(&r->gates, &m->gates_at, gate->on_since - MARGIN_COUNTS);
        m->first = true;
    }
    while (next_edge(&r->gates, &m->gates_at, r->now - gate->on_counts + 1u, &time)) {
        if (out->pulses == EDM_MOST_PULSES) {
            continue;
        }
        struct pulse pulse = {.start = time, .samples = samples};
        if (out->pulses == 0) {
            int64_t age = (int32_t)(r->now - time);
            out->first_pulse_ns = r->now_ns - age * 1000 / (int64_t)COUNTS_PER_US;
        }
        find_current(m, r, &pulse, gate->on_counts);
        if (!m->first && out->pulses < LOOKS_MOST) {
            add_off_time(&off, r, &pulse, gate);
        }
        m->first = false;
        volt_us += read_pulse(out, r, &pulse, gate, &open_v);
    }
    if (out->pulses > 0) {
        real mean_v = volt_us / (us_of(gate->period_counts) * (real)out->pulses);
        out->gap_v = r->samples.good ? mean_v : NOT_A_NUMBER;
        real off_a = off.count > 0 ? mean_amps(&off) : 0;
        out->off_time_a = off_a < LEAST_A ? 0 : off_a;
    }
}

/* Edges of the gate while it is off: something else opens it. */
static void count_strays(struct measure *m, const struct records *r, const struct gate *gate, struct edm_readings *out) {
    uint32_t time;
    if (m->changes != gate->changes) {
        skip_edges(&r->gates, &m->gates_at, gate->off_since + MARGIN_COUNTS);
    }
    while (next_edge(&r->gates, &m->gates_at, r->now, &time)) {
        out->stray_pulses = (uint8_t)(out->stray_pulses < UINT8_MAX ? out->stray_pulses + 1 : UINT8_MAX);
    }
    skip_edges(&r->ignitions, &m->ignitions_at, r->now);
    skip_edges(&r->ends, &m->ends_at, r->now);
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
    if (gate->on) {
        read_pulses(m, records, gate, readings);
    } else {
        count_strays(m, records, gate, readings);
        readings->gap_v = resting_voltage(&records->samples);
    }
    m->changes = gate->changes;
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
    uint32_t sum = 0, railed = 0;
    uint32_t at = scans->at / SLOW_CHANNELS * SLOW_CHANNELS + (uint32_t)channel; /* of the scan under way */
    for (uint32_t i = 0; i < SCANS_MEANT; i++) {
        at = at >= SLOW_CHANNELS ? at - SLOW_CHANNELS : at + scans->size - SLOW_CHANNELS;
        uint32_t count = scans->ring[at] & 0xFFFu;
        sum += count;
        railed += count == ADC_TOP || (ranges[channel].live_zero && count == 0);
    }
    if (!scans->good || railed > SCANS_MEANT / 2u) {
        return NOT_A_NUMBER;
    }
    real share = (real)sum / (real)(SCANS_MEANT * ADC_TOP);
    return ranges[channel].least + share * (ranges[channel].most - ranges[channel].least);
}
