/* Controller and plant in turns, a millisecond each: the controller commands, the plant lives through it, the controller
 * judges, the plant follows. */
#include "host.h"

#define LOOK 99 /* happened beside what the core reports: the stages moved or the sheet gave way */

#define BEAT_TICKS 50 /* the host of a live line sends heartbeats so often */

#ifndef EDM_SOURCES
#define EDM_SOURCES "unknown"
#endif

EDM_EXPORT const char *edm_sources(void);
EDM_EXPORT const char *edm_records(void);
EDM_EXPORT int64_t edm_machine_run(int64_t ticks, const struct machine *m, struct edm_host *h);
EDM_EXPORT void edm_machine_advance(int64_t ticks, bool wakes, int64_t due, const struct machine *m,
                                    struct edm_host *h);

/* Digest of the sources of this library. */
const char *edm_sources(void) {
    return EDM_SOURCES;
}

/* Names and sizes of the records that Python shares. */
const char *edm_records(void) {
    return HOST_RECORDS " " PLANT_RECORDS;
}

/* Advance by up to `ticks` ms; stops early when something happened and returns what. There have to be random numbers
 * for every pulse, and two of the noise for every tick. */
int64_t edm_machine_run(int64_t ticks, const struct machine *m, struct edm_host *h) {
    for (int64_t k = 0; k < ticks; k++) {
        edm_host_begin(h);
        bool gives_way = edm_plant_tick(m);
        int64_t happened = edm_host_end(h);
        bool look = edm_plant_follow(m);
        if (happened != 0) {
            return happened;
        }
        if (look || gives_way) {
            return LOOK;
        }
    }
    return 0;
}

/* Advance by `ticks` ms with all that is due meanwhile; stops early when a memory for what is sent is half full and,
 * with `wakes`, when something was sent that the host answers. The model is asked at tick `due` and at those that it
 * names; it stops the advance by naming none later. */
void edm_machine_advance(int64_t ticks, bool wakes, int64_t due, const struct machine *m, struct edm_host *h) {
    const struct readings *r = m->readings;
    int64_t end = r->tick + ticks;
    do {
        int64_t until = edm_host_slice_end(h);
        until = due < until ? due : until;
        until = end < until ? end : until;
        int64_t happened = edm_machine_run(until > r->tick ? until - r->tick : 1, m, h);
        if (h->follows_path || happened == LOOK) {
            h->callbacks.follow(happened == LOOK);
        }
        edm_host_conclude(h, happened == LOOK ? 0 : happened);
        if (r->tick >= due) {
            due = h->callbacks.due();
        }
        h->inputs.monitor_v = m->unit->monitor_gain * m->plant->amplifier_v + m->unit->monitor_zero_v;
        if (h->seen.watched) {
            h->core.heard_tick = r->tick - r->tick % BEAT_TICKS;
        }
        edm_host_watch(h);
    } while (r->tick < end && r->tick < due && h->seen.out_bytes < OUT_BYTES / 2 && h->seen.sample_bytes < SAMPLES_BYTES / 2 &&
             !(wakes && h->urgent));
}
