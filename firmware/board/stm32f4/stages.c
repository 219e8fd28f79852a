/* Steps of the stages: each timer makes n pulses in a millisecond by PWM (TIM10, TIM11, TIM13: RM0090 19.3.9). What the
 * program plans acts from the next tick on. A change of direction waits for one millisecond without steps.
 * PWM mode 2: a period begins low and its pin rises in the middle, so a tick that restarts the timer early or late, by up
 * to a quarter of a period, finds the same n rising edges. With the compare value beyond the period there are none. */
#include "board.h"

#define AXES 3
#define STEP_KHZ 42000u    /* counts of the timers in a millisecond, behind their dividers */
#define MOST_STEPS EDM_MOST_STEPS_PER_MS

#define NEVER_HIGH STEP_KHZ    /* compare value: beyond every period */

/* Rounding of the period moves the last rising edge by MOST_STEPS / 2 counts at most. */
_Static_assert(MOST_STEPS <= 140, "a restart by a quarter of a period early or late finds the same steps");

struct axis {
    int32_t at, target;    /* steps */
    real per_ms;           /* steps of a travel */
    real rest;             /* of a step, not made yet */
    int32_t planned;       /* steps of the next millisecond */
    bool plus;             /* where it goes now */
    bool travels;
};
static struct axis axes[AXES];
static int32_t made[AXES]; /* steps of this millisecond */
static bool follows;       /* X and Y go where the core says */

/* Where the stages stand, steps: outlasts a reset of the chip. Steps are counted before they are made, so a reset in motion
 * leaves a place that nobody knows. */
#define STANDS_MAGIC 0x53544147u
NO_INIT struct {
    int32_t at[AXES];
    uint32_t moves;        /* steps are being made, or will be with the next tick */
    uint32_t check;
} stands_before;

static uint32_t check_of_stands(void) {
    uint32_t check = STANDS_MAGIC + stands_before.moves;
    for (int axis = 0; axis < AXES; axis++) {
        check = (check << 11 | check >> 21) + (uint32_t)stands_before.at[axis]; /* further than a millisecond's steps */
    }
    return check;
}

static void note_stands(void) {
    stands_before.moves = 0;
    for (int axis = 0; axis < AXES; axis++) {
        stands_before.at[axis] = axes[axis].at;
        stands_before.moves |= (uint32_t)(axes[axis].planned | made[axis]);
    }
    stands_before.check = check_of_stands();
}

static struct timer *timer_of(int axis) {
    return axis == AXIS_X ? TIM10 : axis == AXIS_Y ? TIM11 : TIM13;
}

static enum pin direction_of(int axis) {
    return axis == AXIS_X ? PIN_DIRECTION_X : axis == AXIS_Y ? PIN_DIRECTION_Y : PIN_DIRECTION_THETA;
}

static real step_of(int axis) {
    return axis == AXIS_THETA ? EDM_STEP_DEGREES : EDM_STEP_UM;
}

/* Steps from the zero; a place that 31 bits cannot count is held at their end. */
static int32_t steps_of(int axis, real place) {
    const real most_steps = R(2.0e9);
    return (int32_t)nearest(within(place / step_of(axis), most_steps));
}

/* Starts the timers, all pins low. The stages stand where they stood before a reset; after one in motion, and when the
 * supply comes, they are taken to be where they are parked. */
void stages_begin(bool kept) {
    bool known = kept && stands_before.check == check_of_stands() && stands_before.moves == 0;
    const int32_t parked[AXES] = {steps_of(AXIS_X, EDM_PARKED_X_UM), 0, 0};
    for (int axis = 0; axis < AXES; axis++) {
        axes[axis].at = axes[axis].target = known ? stands_before.at[axis] : parked[axis];
    }
    note_stands();
    clocks_on(&RCC->APB2ENR, RCC_APB2_TIM10 | RCC_APB2_TIM11);
    clocks_on(&RCC->APB1ENR, RCC_APB1_TIM13);
    TIM10->PSC = TIM11->PSC = CPU_HZ / 1000u / STEP_KHZ - 1u;
    TIM13->PSC = CPU_HZ / 2000u / STEP_KHZ - 1u;
    for (int axis = 0; axis < AXES; axis++) {
        struct timer *timer = timer_of(axis);
        timer->CCR[0] = NEVER_HIGH; /* before the mode: in this one, 0 is high all the time */
        timer->CCMR1 = TIM_CCMR1_OC1_PWM2_PRELOAD;
        timer->ARR = STEP_KHZ - 1u;
        timer->EGR = TIM_EGR_UG;
        timer->CCER = TIM_CCER_CC1E;
        timer->CR1 = TIM_CR1_ARPE | TIM_CR1_CEN;
    }
}

/* In the tick: puts out the planned steps. The nearest period: n of them end within n / 2 counts of a millisecond. */
void stages_put(void) {
    for (int axis = 0; axis < AXES; axis++) {
        struct timer *timer = timer_of(axis);
        uint32_t n = (uint32_t)axes[axis].planned;
        uint32_t period = n > 0 ? (STEP_KHZ + n / 2u) / n : STEP_KHZ;
        pins_put(direction_of(axis), axes[axis].plus);
        timer->ARR = period - 1u;
        timer->CCR[0] = n > 0 ? period / 2u : NEVER_HIGH;
        timer->EGR = TIM_EGR_UG;
        made[axis] = axes[axis].planned;
    }
}

/* In a tick that plans nothing: the timers would go on with the steps of the millisecond before. */
void stages_halt(void) {
    TIM10->CR1 = TIM11->CR1 = TIM13->CR1 = 0;
}

/* Steps of an axis in the next millisecond: towards its target, `most` at most. */
static void plan_axis(struct axis *axis, int32_t most_steps) {
    int32_t way = axis->target - axis->at;
    int32_t n = way < 0 ? -way : way;
    bool plus = way > 0;
    if (n == 0) {
        axis->planned = 0;
        return;
    }
    if (plus != axis->plus) {
        axis->plus = plus;
        axis->planned = 0;
        return;
    }
    n = n < most_steps ? n : most_steps;
    axis->planned = n;
    axis->at += plus ? n : -n;
}

static void plan_travel(struct axis *axis) {
    real steps = axis->per_ms + axis->rest;
    int32_t whole = floor_of(steps);
    plan_axis(axis, whole);
    axis->rest = steps - (real)whole;
    axis->travels = axis->at != axis->target;
}

/* Plans the next millisecond by the drive of the core. */
void stages_plan(const struct edm_controller *c) {
    interrupts_off(); /* all axes at one tick */
    for (int axis = 0; axis < AXES; axis++) {
        if (follows && axis != AXIS_THETA) {
            axes[axis].target = steps_of(axis, c->drive.stage_um[axis]);
            plan_axis(&axes[axis], MOST_STEPS);
        } else if (axes[axis].travels) {
            plan_travel(&axes[axis]);
        } else {
            axes[axis].planned = 0;
        }
    }
    interrupts_on();
    note_stands();
}

/* Tells the core where the stages stand: it takes the zero of all axes for it. */
void stages_tell(struct edm_controller *c) {
    for (int axis = 0; axis < AXES; axis++) {
        c->stages.at[axis] = (real)axes[axis].at * step_of(axis);
    }
}

/* Whether a travel is under way still, or a path further than the stages. */
bool stages_move(void) {
    for (int axis = 0; axis < AXES; axis++) {
        if (axes[axis].travels || (follows && axes[axis].at != axes[axis].target)) {
            return true;
        }
    }
    return false;
}

real hal_stage_speed_max(void *board, uint8_t axis) {
    (void)board;
    return R(MOST_STEPS) * step_of(axis) / TICK_S;
}

/* Steps that were planned are made: the tick may have begun them. */
real hal_stage_place(void *board, uint8_t axis, real at) {
    (void)board;
    return steps_of(axis, at) == axes[axis].at ? at : (real)axes[axis].at * step_of(axis);
}

static void stop(struct axis *axis) {
    axis->travels = false;
    axis->target = axis->at;
}

void hal_stage_start(void *board, uint8_t axis, real target, real speed) {
    (void)board;
    struct axis *a = &axes[axis];
    a->target = steps_of(axis, target);
    a->per_ms = most(0, least(speed * TICK_S / step_of(axis), R(MOST_STEPS)));
    a->rest = 0;
    a->travels = a->at != a->target;
}

/* Stops at once: nothing is planned any more; what runs are the steps of this millisecond. */
void hal_stage_stop(void *board, uint8_t axis, real at) {
    (void)board;
    (void)at;
    stop(&axes[axis]);
}

void hal_path_begin(void *board) {
    (void)board;
    stop(&axes[AXIS_X]);
    stop(&axes[AXIS_Y]);
    follows = true;
}

void hal_path_line(void *board, uint8_t row) {
    (void)board;
    (void)row;
}

void hal_path_end(void *board) {
    (void)board;
    follows = false;
    stop(&axes[AXIS_X]);
    stop(&axes[AXIS_Y]);
}
