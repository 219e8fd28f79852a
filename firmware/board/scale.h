/* What the signals of the machine mean: the ends of every analogue range, the size of a step. One machine, one set of
 * figures; another one sets them with -D. [assumed, until a machine has been calibrated] */
#ifndef SCALE_H
#define SCALE_H

#include "../core/real.h"

#define ADC_TOP 4095 /* count at 3.3 V, of ADCs and DACs */

/* Gap: 0 to this at full scale. */
#ifndef EDM_GAP_FULL_V
#define EDM_GAP_FULL_V R(330.0)
#endif
#ifndef EDM_GAP_FULL_A
#define EDM_GAP_FULL_A R(12.0)
#endif

/* Actuator's monitor and displacement sensor, at 0 and at full scale. */
#ifndef EDM_MONITOR_LEAST_V
#define EDM_MONITOR_LEAST_V R(-5.0)
#endif
#ifndef EDM_MONITOR_MOST_V
#define EDM_MONITOR_MOST_V R(165.0)
#endif
#ifndef EDM_SENSOR_LEAST_UM
#define EDM_SENSOR_LEAST_UM R(-50.0)
#endif
#ifndef EDM_SENSOR_MOST_UM
#define EDM_SENSOR_MOST_UM R(450.0)
#endif

/* Dielectric: 0 to this at full scale. */
#ifndef EDM_FLOW_FULL_LPM
#define EDM_FLOW_FULL_LPM R(5.0)
#endif
#ifndef EDM_TEMPERATURE_FULL_C
#define EDM_TEMPERATURE_FULL_C R(100.0)
#endif

/* Set points of the generator at the DACs' full scale, and the gap voltage of a normal discharge. */
#ifndef EDM_OPEN_FULL_V
#define EDM_OPEN_FULL_V R(330.0)
#endif
#ifndef EDM_PEAK_FULL_A
#define EDM_PEAK_FULL_A R(12.0)
#endif
#ifndef EDM_NORMAL_PLATEAU_V
#define EDM_NORMAL_PLATEAU_V R(22.0)
#endif

/* Stages. */
#ifndef EDM_STEP_UM
#define EDM_STEP_UM R(0.1)
#endif
#ifndef EDM_STEP_DEGREES
#define EDM_STEP_DEGREES R(0.001)
#endif
#ifndef EDM_PARKED_X_UM
#define EDM_PARKED_X_UM R(-5000.0) /* where X stands when the supply comes: beside the work */
#endif
#ifndef EDM_MOST_STEPS_PER_MS
#define EDM_MOST_STEPS_PER_MS 100
#endif

#endif
