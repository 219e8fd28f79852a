/* Controller and plant in turns, a millisecond each: the controller commands, the plant lives through it, the controller
 * judges, the plant follows. */
#include "host.h"

#define LOOK 99 /* edmctl/simulator/controller.py: the work under the tool has to be looked up again */

#ifndef EDM_SOURCES
#define EDM_SOURCES "unknown"
#endif

EDM_EXPORT const char *edm_sources(void);
EDM_EXPORT int64_t edm_machine_run(int64_t ticks, const struct machine *m, struct edm_host *h);

/* Digest of the sources of this library. */
const char *edm_sources(void) {
    return EDM_SOURCES;
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
