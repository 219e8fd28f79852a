/* The virtual machine's body: piezo actuator, gap with its discharges, work under the tool, sensors, stages.
 *
 * A tick is 1 ms. The plant reads `drive`, changes `plant` and shows `readings`; it shares nothing else with a
 * controller. Its records are declared in edmctl/simulator/records (plant_records.h is generated from them).
 * All numbers are double, and sums are written in one order: the same inputs give the same bytes everywhere
 * (build with -ffp-contract=off). */
#ifndef EDM_PLANT_H
#define EDM_PLANT_H

#include "../export.h"
#include "plant_records.h"

#include <stdbool.h>

#define PLANT_TICK_S 0.001
#define PLANT_TICK_NS 1000000

static inline double lesser(double a, double b) {
    return b < a ? b : a;
}

static inline double greater(double a, double b) {
    return b > a ? b : a;
}

/* One millisecond; true where the sheet gave way, so that the work under the tool has to be looked up again. */
EDM_EXPORT bool edm_plant_tick(const struct machine *m);
/* Follow the stages and the contact circuit; true after a way on which the work under the tool changes. */
EDM_EXPORT bool edm_plant_follow(const struct machine *m);

EDM_EXPORT void edm_actuator_tick(const struct unit *unit, struct plant *p, double applied_v);
EDM_EXPORT double edm_sensor(const struct unit *unit, struct plant *p, int64_t tick, const double *noise);
EDM_EXPORT void edm_pump(const struct unit *unit, struct plant *p, double opening_um);
EDM_EXPORT void edm_renew_clearing(const struct unit *unit, struct plant *p);
EDM_EXPORT void edm_strike_pulses(const struct machine *m);

/* Described where they are defined. */
EDM_EXPORT double edm_actuator_run(const struct machine *m, int64_t count, const double *command_v, double before_v,
                                   double slew_v_s, double highest_v, double *applied_v, double *free_um,
                                   double *sensor_um);
EDM_EXPORT bool edm_plant_run(const struct machine *m);
EDM_EXPORT double edm_work_look(const struct cells *f, double x, double y, double radius, double reach,
                                double rounding_um, double gone_um);
EDM_EXPORT int64_t edm_work_tabulate(const struct cells *f, double level_um, double *table, int64_t width,
                                     double *now, void *room);
EDM_EXPORT void edm_work_sink(const struct cells *f, double before_um, double after_um);
EDM_EXPORT void edm_pulse_signals(int64_t count, const double *t_us, double open_v, double delay_us, double opens_us,
                                  double plateau_v, double siemens, double *v, double *a);

#endif
