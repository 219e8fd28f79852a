/* From raw records of a millisecond to what the core reads: pulses from the edges that timers have captured and from samples
 * of gap voltage and current, slow readings from their scans. No registers here: tests run it on a host.
 *
 * Times are counts of one free-running timer of 84 MHz, 32 bits; a sample is taken every microsecond. */
#ifndef MEASURE_H
#define MEASURE_H

#include <stddef.h>

#include "../hal.h"

#define COUNTS_PER_US 84u
#define COUNTS_PER_MS 84000u

/* A ring that DMA fills with times of edges; `at` is where the next one goes. */
#define EDGES 256u
struct edges {
    const volatile uint32_t *ring;
    uint32_t at;
};

/* A ring of samples: gap voltage in the low half of a word, current in the high half. */
struct samples {
    const volatile uint32_t *ring;
    uint32_t size;
    uint32_t at;         /* place of the sample of the end of this millisecond, which is not there yet */
    uint32_t held;       /* samples before it that are right */
    bool good;           /* they came as they should in this millisecond */
};

/* Rings of slow channels, scan by scan. */
enum slow { SLOW_MONITOR, SLOW_DISPLACEMENT, SLOW_TEMPERATURE, SLOW_FLOW, SLOW_CHANNELS };
struct scans {
    const volatile uint16_t *ring;
    uint32_t size, at;   /* halfwords */
    bool good;
};

/* What DMA and timers hold at the end of a millisecond. */
struct records {
    uint32_t now;        /* the timer */
    int64_t now_ns;      /* the same on the controller's clock */
    struct edges gates;  /* the gate driver's output rose */
    struct edges ignitions; /* current began */
    struct edges ends;   /* current ended */
    struct samples samples;
    struct scans scans;
};

/* The gate of the generator, as the board has put it. */
struct gate {
    bool on;
    uint32_t changes;    /* so often it went on or off */
    uint32_t on_since, off_since; /* the timer when it last did */
    uint32_t on_counts;  /* on-time, as the timer of the gate makes it */
    uint32_t period_counts;
    uint32_t discharge_counts; /* isopulse; 0: isofrequency */
    real open_v;         /* as set */
};

/* Where the reading of a ring has come to. `mark` stands behind it in the ring, where an edge is written before one that has
 * not been read: while it is there, no edge has been lost. */
struct follower {
    uint32_t at, mark;
};

/* Where the reading of the rings has come to. */
struct measure {
    struct follower gates, ignitions, ends;
    uint32_t changes;    /* of the gate, seen so far */
    uint32_t blind_until; /* of pulses that began before it, edges of the current may have been lost */
    bool blind;
    bool first;          /* the next pulse is the first one since the gate went on */
};

/* Fills the readings but for the contact, which is a pin. */
void measure_millisecond(struct measure *m, const struct records *records, const struct gate *gate,
                         struct edm_readings *readings);
/* A slow channel in its unit, the mean of the last millisecond; NaN for one at its rail or that does not come. */
real measure_slow(const struct scans *scans, enum slow channel);

#endif
