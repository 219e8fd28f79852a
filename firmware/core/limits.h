/* Sizes of memories, and what the generator can do. What stands in #ifndef a board may set otherwise (-D). */
#ifndef EDM_LIMITS_H
#define EDM_LIMITS_H

#define EDM_SERVO_HZ 1000 /* the tick: every duration of the core is counted in it, so no board sets it otherwise */
#define TICK_US 1000
#define TICK_NS 1000000
#define TICK_S R(0.001)

/* Memories. */
#ifndef EDM_BOX_SAMPLES
#define EDM_BOX_SAMPLES 2048 /* milliseconds in the black box: 512, 1024 or 2048 */
#endif
#ifndef EDM_BOX_LASTS
#define EDM_BOX_LASTS 1 /* 0: no reset keeps memory here, and samples get no check */
#endif
#define EDM_EVENTS 32     /* events kept until they are acknowledged; these figures are the protocol's */
#define EDM_REPLIES 8     /* kept replies (Delivery) */
#define EDM_NONCES 8      /* nonces of former sessions (Session) */
#define EDM_PATH_LINES 16 /* lines of a scan that wait */
#ifndef EDM_MOST_PULSES
#define EDM_MOST_PULSES 64 /* pulses of one tick: 50 kHz and some */
#endif
#ifndef EDM_LINGER_TICKS
#define EDM_LINGER_TICKS 1 /* telemetry is sent at least so often */
#endif
#define EDM_PENDING_SAMPLES (14 + EDM_LINGER_TICKS)
#define EDM_PENDING_PULSES (38 + 52 * EDM_LINGER_TICKS)

/* The generator (PULSE_CONFIG). */
#define EDM_PERIOD_NS_MIN 20000u
#define EDM_PERIOD_NS_MAX 1000000000u
#ifndef EDM_OFF_NS_MIN
#define EDM_OFF_NS_MIN 10000 /* least off-time: the switch opens 5 us after its gate, the current is given 3 us to settle, and
                              * two samples show that it has ended; with less nothing tells pulses from direct current */
#endif
#ifndef EDM_OPEN_V_MAX
#define EDM_OPEN_V_MAX R(300.0)
#endif
#ifndef EDM_CURRENT_A_MAX
#define EDM_CURRENT_A_MAX R(10.0)
#endif

/* The converter of the actuator: counts of 2.5 mV, as on the wire. */
#define STEPS_PER_V R(400.0)
#define DAC_V R(0.0025)

#endif
