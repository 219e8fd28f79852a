/* What outlasts a reset: fault, count of boots and event number in the backup registers (RM0090 26.6.20, battery-backed),
 * nonces in memory that the start does not clear, each with a check; and why the chip was reset (RM0090 6.3.21). */
#include "board.h"

#include "../../core/core.h"

enum { BACKUP_BOOTS, BACKUP_FAULT_AND_EVENT, BACKUP_CHECK };

extern uint32_t crash_word; /* startup.c */
uint32_t crash_before;      /* enum crash of the run before, for whoever looks with a debugger */

NO_INIT struct {
    struct edm_persistent words; /* of which the nonces count */
    uint32_t check;
} kept_words;

static uint32_t check_of(const void *bytes, size_t size) {
    return ~frame_crc(0x45444D43u, bytes, size); /* neither all zeros nor all ones have their own check */
}

static uint32_t backup_check(uint32_t boots, uint32_t fault_and_event) {
    const uint32_t words[] = {boots, fault_and_event};
    return check_of(words, sizeof words);
}

void hal_persist(void *board, const struct edm_persistent *words) {
    (void)board;
    uint32_t fault_and_event = (uint32_t)words->fault << 16 | words->event_no;
    RTC_BKP[BACKUP_FAULT_AND_EVENT] = fault_and_event;
    RTC_BKP[BACKUP_BOOTS] = words->boot_count;
    RTC_BKP[BACKUP_CHECK] = backup_check(words->boot_count, fault_and_event);
    kept_words.words = *words;
    kept_words.check = check_of(&kept_words.words, sizeof kept_words.words);
}

/* The words of before. Registers that are wrong but not empty may have held a fault: then the latched one is 5001. */
const struct edm_persistent *keep_words(void) {
    static struct edm_persistent words;
    clocks_on(&RCC->APB1ENR, RCC_APB1_PWR);
    PWR->CR |= PWR_CR_DBP;
    barrier();
    uint32_t boots = RTC_BKP[BACKUP_BOOTS], fault_and_event = RTC_BKP[BACKUP_FAULT_AND_EVENT];
    uint32_t check = RTC_BKP[BACKUP_CHECK];
    if (kept_words.check == check_of(&kept_words.words, sizeof kept_words.words)) {
        words = kept_words.words;
    }
    words.boot_count = boots;
    words.fault = (uint16_t)(fault_and_event >> 16);
    words.event_no = (uint16_t)fault_and_event;
    if (check != backup_check(boots, fault_and_event)) {
        bool empty = (boots | fault_and_event | check) == 0;
        words.boot_count = 0;
        words.event_no = 0;
        words.fault = empty ? 0 : FAULT_RESET;
    }
    return &words;
}

/* Why the chip was reset. The flags are forgotten then. */
uint8_t keep_cause(void) {
    uint32_t flags = RCC->CSR;
    RCC->CSR |= RCC_CSR_RMVF;
    crash_before = crash_word;
    crash_word = CRASH_NONE;
    bool crashed = crash_before != CRASH_NONE && crash_before <= CRASH_IRQ;
    bool starved = crash_before == CRASH_SUPPLY;
    if ((flags & RCC_CSR_PORRSTF) != 0) {
        return RESET_CAUSE_POWER_ON;
    }
    if (starved || (flags & RCC_CSR_BORRSTF) != 0) {
        return RESET_CAUSE_BROWN_OUT;
    }
    if (crashed || (flags & (RCC_CSR_IWDGRSTF | RCC_CSR_WWDGRSTF | RCC_CSR_LPWRRSTF)) != 0) {
        return RESET_CAUSE_WATCHDOG;
    }
    return (flags & RCC_CSR_SFTRSTF) != 0 ? RESET_CAUSE_COMMANDED : RESET_CAUSE_EXTERNAL;
}
