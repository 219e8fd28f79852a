/* The gate of the generator (TIM1, RM0090 17.3 and 17.4), the end of an isopulse (TIM3, RM0090 18.3.10), set points of the
 * supply (DAC, RM0090 14). MOE, without which no pulse leaves the pin, is set in hal_gate and nowhere else. */
#include "board.h"

#define GATE_COUNTS 168u   /* of TIM1, a microsecond */
#define LEAST_OFF_COUNTS ((EDM_OFF_NS_MIN * GATE_COUNTS + 999u) / 1000u)
#define TIMER_TOP 65536u
#define END_COUNTS 84u     /* an isopulse's end is shown for 1 us: the reference of the gate then stays low for its period */
#define LEAST_DROP_V R(0.1)

static struct gate state;
static bool locked;        /* the main loop is late: nothing opens the gate before the reset */
static bool broken;        /* the break input has closed it, or kept it closed, and the core has not latched why */

/* TIM1 holds the pin low before the pin is handed over to it. Break: low level, no automatic restart; locked until reset. */
void gate_start(void) {
    clocks_on(&RCC->APB2ENR, RCC_APB2_TIM1);
    clocks_on(&RCC->APB1ENR, RCC_APB1_TIM3 | RCC_APB1_DAC);
    TIM1->CR1 = TIM_CR1_ARPE;
    TIM1->SMCR = TIM_SMCR_ETF_4;
    TIM1->CCMR1 = TIM_CCMR1_OC1_PWM1;
    TIM1->CCER = TIM_CCER_CC1E;
    TIM1->BDTR = TIM_BDTR_LOCK_3 | TIM_BDTR_OSSI | TIM_BDTR_OSSR | TIM_BDTR_BKE;
    barrier();
    pins_set(PIN_GATE);
    TIM3->CCMR1 = TIM_CCMR1_CC1_TI1 | TIM_CCMR1_OC2_PWM2;
    DAC->CR = DAC_CR_EN1 | DAC_CR_EN2;
}

/* Switches the gate off, from the main loop or from the tick. */
void gate_off(void) {
    TIM1->BDTR &= ~TIM_BDTR_MOE;
    if (state.on) {
        broken = broken || (TIM1->SR & TIM_SR_BIF) != 0;
        state.on = false;
        state.off_since = TIM5->CNT;
        state.changes++;
    }
}

/* Off until the reset. */
void gate_lock(void) {
    locked = true;
    gate_off();
}

const struct gate *gate_state(void) {
    return &state;
}

/* Whether the break input has switched the gate off, or kept it closed; until gate_release nothing opens it. */
bool gate_broken(void) {
    if ((TIM1->SR & TIM_SR_BIF) != 0) {
        gate_off();
        TIM1->SR = ~TIM_SR_BIF; /* has no effect while the chain is open */
    }
    return broken;
}

/* The core has latched a fault for the break. */
void gate_release(void) {
    broken = false;
}

/* Opens the gate with the begin of a pulse, or closes it. With an open break chain it stays closed: the input holds MOE at
 * 0 (RM0090 17.3.12), and a break that the core has latched no fault of forbids it here. */
void hal_gate(void *board, bool on) {
    (void)board;
    gate_off();
    if (!on || locked) {
        return;
    }
    broken = broken || !pins_high(PIN_BREAK_CHAIN) || (TIM1->SR & TIM_SR_BIF) != 0;
    if (broken) {
        return;
    }
    inputs_put_mode(true);
    state.on = true;
    state.on_since = TIM5->CNT;
    state.changes++;
    TIM1->EGR = TIM_EGR_UG;
    interrupts_off();
    if (!locked) {
        TIM1->BDTR |= TIM_BDTR_MOE;
    }
    interrupts_on();
    if ((TIM1->SR & TIM_SR_BIF) != 0) { /* a break that came and went after the look: MOE was set behind it */
        gate_off();
    }
}

/* The least divider of a 16-bit timer whose period is so many counts of its clock. */
static uint32_t divider_for(uint32_t counts) {
    return (counts + TIMER_TOP - 1u) / TIMER_TOP;
}

static uint32_t divided(uint32_t counts, uint32_t divider) {
    return (counts + divider / 2u) / divider;
}

static uint32_t between(uint32_t value, uint32_t low, uint32_t high) {
    return value < low ? low : value > high ? high : value;
}

/* TIM3: started by ignition, it shows the end of an isopulse after the discharge time. */
static void set_isopulse(uint32_t counts) {
    TIM3->CR1 = 0;
    TIM3->SMCR = 0;
    TIM3->CCER = 0;
    TIM1->CCMR1 = TIM_CCMR1_OC1_PWM1 | (counts > 0 ? TIM_CCMR1_OC1CE : 0);
    if (counts == 0) {
        return;
    }
    uint32_t divider = divider_for(counts + END_COUNTS);
    uint32_t discharge = between(divided(counts, divider), 1, TIMER_TOP - 2u);
    TIM3->PSC = divider - 1u;
    TIM3->CCR[1] = discharge;
    TIM3->ARR = discharge + between(END_COUNTS / divider, 1, TIMER_TOP - 1u - discharge) - 1u;
    TIM3->EGR = TIM_EGR_UG;
    TIM3->SR = 0;
    TIM3->CCER = TIM_CCER_CC2E;
    TIM3->SMCR = TIM_SMCR_SMS_TRIGGER | TIM_SMCR_TS_TI1FP1;
    TIM3->CR1 = TIM_CR1_OPM;
}

static uint32_t counts_of(real value, real full) {
    int64_t counts = nearest(value / full * (real)ADC_TOP);
    return counts < 0 ? 0u : counts > ADC_TOP ? (uint32_t)ADC_TOP : (uint32_t)counts;
}

/* Sets times and set points. A period of more than 390 us makes the grid of the times coarser: 16 bits of it; on every grid
 * the off-time is the least one at least. */
real hal_set_generator(void *board, const struct edm_generator *setting) {
    (void)board;
    gate_off();
    uint32_t period = (uint32_t)nearest((setting->on_time_us + setting->off_time_us) * R(168.0));
    uint32_t divider = divider_for(period);
    uint32_t least_off = (LEAST_OFF_COUNTS + divider - 1u) / divider;
    uint32_t period_ticks = between(divided(period, divider), least_off + 1u, TIMER_TOP);
    uint32_t on_ticks = divided((uint32_t)nearest(setting->on_time_us * R(168.0)), divider);
    on_ticks = between(on_ticks, 1, period_ticks - least_off);
    TIM1->CR1 = TIM_CR1_ARPE;
    TIM1->PSC = divider - 1u;
    TIM1->ARR = period_ticks - 1u;
    TIM1->CCR[0] = on_ticks;
    TIM1->EGR = TIM_EGR_UG;
    TIM1->CR1 = TIM_CR1_ARPE | TIM_CR1_CEN;
    state.period_counts = period_ticks * divider / 2u;
    state.on_counts = on_ticks * divider / 2u;
    state.discharge_counts = (uint32_t)nearest(setting->discharge_us * R(84.0));
    state.open_v = setting->open_v;
    set_isopulse(state.discharge_counts);
    DAC->DHR12RD = counts_of(setting->open_v, EDM_OPEN_FULL_V) | counts_of(setting->peak_a, EDM_PEAK_FULL_A) << 16;
    return setting->peak_a / most(setting->open_v - EDM_NORMAL_PLATEAU_V, LEAST_DROP_V);
}
