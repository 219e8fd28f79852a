/* From the reset to the main loop, and what a fault does (PM0214 2.3, 2.4; vectors: RM0090 12.2, table 62). The gate is off
 * before anything else. A fault handler takes a fresh stack, reads no memory, and ends in a reset. */
#include "board.h"

#define INTERRUPTS 91

extern uint32_t data_begin[], data_end[], data_from[], bss_begin[], bss_end[];
extern uint8_t main_stack_top[], loop_stack_top[];

NO_INIT uint32_t crash_word;

void startup_begin(void);
void startup_crash(uint32_t which);
void reset_handler(void);
void nmi_handler(void);
void hard_fault_handler(void);
void memory_fault_handler(void);
void bus_fault_handler(void);
void usage_fault_handler(void);
void other_handler(void);
void supply_handler(void);

typedef void (*vector)(void);
struct vectors {
    const void *stack;
    vector system[15];
    vector interrupts[INTERRUPTS];
};
extern const struct vectors vectors;

/* The pin of the gate low whatever the timer does, and no more alternation for the charge pump (RM0090 8.4). */
static void pins_safe(void) {
    clocks_on(&RCC->AHB1ENR, RCC_AHB1_GPIO(PORT_E) | RCC_AHB1_GPIO(PORT_F));
    GPIO_PORT(PORT_E)->BSRR = 1u << (9u + 16u);
    GPIO_PORT(PORT_E)->MODER = (GPIO_PORT(PORT_E)->MODER & ~(3u << 18)) | 1u << 18;
    GPIO_PORT(PORT_F)->BSRR = 1u << (15u + 16u);
    GPIO_PORT(PORT_F)->MODER = (GPIO_PORT(PORT_F)->MODER & ~(3u << 30)) | 1u << 30;
}

_Noreturn void startup_restart(void) {
    barrier();
    *SCB_AIRCR = SCB_AIRCR_RESET;
    for (;;) {
    }
}

/* The end of every fault. */
__attribute__((used, noreturn)) void startup_crash(uint32_t which) {
    clocks_on(&RCC->APB2ENR, RCC_APB2_TIM1);
    TIM1->BDTR &= ~TIM_BDTR_MOE;
    pins_safe();
    crash_word = which;
    startup_restart();
}

/* A handler: its stack is at its top again, whatever has happened to it. */
#define HANDLER(name, which)                                                                                             \
    __attribute__((naked)) void name(void) {                                                                             \
        __asm__ volatile("ldr r0, =main_stack_top\n\tmsr msp, r0\n\tmovs r0, %0\n\tb startup_crash" ::"i"(which));      \
    }
HANDLER(nmi_handler, CRASH_NMI)
HANDLER(hard_fault_handler, CRASH_HARD)
HANDLER(memory_fault_handler, CRASH_MEMORY)
HANDLER(bus_fault_handler, CRASH_BUS)
HANDLER(usage_fault_handler, CRASH_USAGE)
HANDLER(other_handler, CRASH_IRQ)
HANDLER(supply_handler, CRASH_SUPPLY)

/* Memory, as C asks for it; then the main loop on its own stack. */
__attribute__((used)) void startup_begin(void) {
    pins_safe();
    *SCB_VTOR = (uint32_t)(uintptr_t)&vectors;
    *SCB_CPACR |= SCB_CPACR_FPU;
    barrier();
    for (uint32_t *to = data_begin, *from = data_from; to < data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = bss_begin; to < bss_end;) {
        *to++ = 0;
    }
    *SCB_SHCSR |= SCB_SHCSR_FAULTS;
    watch_guard_stacks();
    main_run();
}

/* The main loop has the process stack; interrupts and faults have the main one (PM0214 2.1.2). */
__attribute__((naked)) void reset_handler(void) {
    __asm__ volatile("cpsid i\n\t"
                     "ldr r0, =loop_stack_top\n\t"
                     "msr psp, r0\n\t"
                     "movs r0, #2\n\t"
                     "msr control, r0\n\t"
                     "isb\n\t"
                     "bl startup_begin\n\t"
                     "b .");
}

__attribute__((section(".vectors"), used)) const struct vectors vectors = {
    .stack = main_stack_top,
    .system = {reset_handler, nmi_handler, hard_fault_handler, memory_fault_handler, bus_fault_handler,
               usage_fault_handler, other_handler, other_handler, other_handler, other_handler, other_handler,
               other_handler, other_handler, other_handler, other_handler},
    .interrupts = {[0 ... IRQ_PVD - 1] = other_handler, [IRQ_PVD] = supply_handler,
                   [IRQ_PVD + 1 ... IRQ_TIM7 - 1] = other_handler, [IRQ_TIM7] = main_tick,
                   [IRQ_TIM7 + 1 ... INTERRUPTS - 1] = other_handler},
};
