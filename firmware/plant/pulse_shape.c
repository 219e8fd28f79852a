/* What an oscilloscope would show of a pulse (edmctl/simulator/waveforms.py): the open voltage comes up through the
 * series resistor, breaks down to the plateau at ignition, and falls when the generator's switch opens. All time
 * constants are assumed. */
#include "plant.h"

#include "../math/elementary.h"

#define RISE_US 0.5      /* of the open voltage: series resistor and capacitance of gap and leads [assumed] */
#define BREAKDOWN_US 0.1 /* of the voltage at ignition [assumed] */
#define CURRENT_US 0.3   /* of the current, both ways: inductance of the leads [assumed] */
#define DECAY_US 2.0     /* of the voltage once the switch is open [assumed] */
#define SETTLED 40.0     /* time constants after which nothing is left to be seen in a double */

static double risen(double t_us, double tau_us) {
    return t_us > SETTLED * tau_us ? 1.0 : -edm_expm1(-t_us / tau_us);
}

static double left(double t_us, double tau_us) {
    return t_us > SETTLED * tau_us ? 0.0 : edm_exp(-t_us / tau_us);
}

/* Voltage in V and current in A of a pulse at `count` times since its begin. A pulse without ignition has
 * delay_us = opens_us, the time after which the switch opens. */
void edm_pulse_signals(int64_t count, const double *t_us, double open_v, double delay_us, double opens_us,
                       double plateau_v, double siemens, double *v, double *a) {
    double current_a = (open_v - plateau_v) * siemens, burning_us = opens_us - delay_us;
    double lit_v = open_v * risen(delay_us, RISE_US), last_v = lit_v, last_a = 0.0;
    if (burning_us > 0.0) {
        last_v = plateau_v + (lit_v - plateau_v) * left(burning_us, BREAKDOWN_US);
        last_a = current_a * risen(burning_us, CURRENT_US);
    }
    for (int64_t k = 0; k < count; k++) {
        if (t_us[k] < delay_us) {
            v[k] = open_v * risen(t_us[k], RISE_US);
            a[k] = 0.0;
        } else if (t_us[k] < opens_us) {
            v[k] = plateau_v + (lit_v - plateau_v) * left(t_us[k] - delay_us, BREAKDOWN_US);
            a[k] = current_a * risen(t_us[k] - delay_us, CURRENT_US);
        } else {
            v[k] = last_v * left(t_us[k] - opens_us, DECAY_US);
            a[k] = last_a * left(t_us[k] - opens_us, CURRENT_US);
        }
    }
}
