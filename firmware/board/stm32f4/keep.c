/* What outlasts a reset: fault, count of boots and event number in the backup registers (RM0090 26.6.20, battery-backed),
 * nonces in memory that the start does not clear; and why the chip was reset (RM0090 6.3.21). Both are kept twice, each copy
 * with a number and a check, and written one behind the other: a reset between two stores leaves the copy before or the one
 * behind, a bit that flips leaves the other one. The newest that is right counts. */
#include "board.h"

#include "../../core/core.h"

#define COPIES 2u

enum { BANK_FAULT_AND_EVENT, BANK_BOOTS, BANK_NUMBER, BANK_CHECK, BANK_SIZE }; /* in this order they are written */

extern uint32_t crash_word; /* startup.c */
uint32_t crash_before;      /* enum crash of the run before, for whoever looks with a debugger */

NO_INIT struct kept {
    struct edm_persistent words; /* of which the nonces count */
    uint32_t number;
    uint32_t check;
} kept_words[COPIES];

static uint32_t bank_number, kept_number; /* of the newest */

static uint32_t check_of(const void *bytes, size_t size) {
    return ~frame_crc(0x45444D43u, bytes, size); /* neither all zeros nor all ones have their own check */
}

static void put_bank(uint32_t bank, const struct edm_persistent *words) {
    const uint32_t values[BANK_CHECK] = {
        [BANK_FAULT_AND_EVENT] = (uint32_t)words->fault << 16 | words->event_no,
        [BANK_BOOTS] = words->boot_count,
        [BANK_NUMBER] = bank_number,
    };
    for (uint32_t i = 0; i < BANK_CHECK; i++) {
        RTC_BKP[bank * BANK_SIZE + i] = values[i];
    }
    RTC_BKP[bank * BANK_SIZE + BANK_CHECK] = check_of(values, sizeof values);
}

void hal_persist(void *board, const struct edm_persistent *words) {
    (void)board;
    bank_number++;
    kept_number++;
    for (uint32_t i = 0; i < COPIES; i++) {
        put_bank(i, words);
    }
    for (uint32_t i = 0; i < COPIES; i++) {
        struct kept *kept = &kept_words[i];
        kept->words = *words;
        kept->number = kept_number;
        kept->check = check_of(kept, offsetof(struct kept, check));
        barrier(); /* before the other copy is touched */
    }
}

/* Nonces of before; false where no copy of them is right. */
static bool take_nonces(struct edm_persistent *words) {
    bool found = false;
    for (uint32_t i = 0; i < COPIES; i++) {
        const struct kept *kept = &kept_words[i];
        bool whole = kept->check == check_of(kept, offsetof(struct kept, check));
        if (whole && (!found || (int32_t)(kept->number - kept_number) > 0)) {
            *words = kept->words;
            kept_number = kept->number;
            found = true;
        }
    }
    return found;
}

/* Fault, boots and event number. Registers that are wrong but not empty may have held a fault: without a right copy, or where
 * that has none and the wrong one has, the latched one is 5001. */
static void take_banks(struct edm_persistent *words) {
    bool found = false, suspect = false, empty = true;
    words->boot_count = 0;
    words->fault = words->event_no = 0;
    for (uint32_t bank = 0; bank < COPIES; bank++) {
        uint32_t values[BANK_SIZE];
        for (uint32_t i = 0; i < BANK_SIZE; i++) {
            values[i] = RTC_BKP[bank * BANK_SIZE + i];
            empty = empty && values[i] == 0;
        }
        uint16_t fault = (uint16_t)(values[BANK_FAULT_AND_EVENT] >> 16);
        if (values[BANK_CHECK] != check_of(values, BANK_CHECK * sizeof values[0])) {
            suspect = suspect || fault != 0;
        } else if (!found || (int32_t)(values[BANK_NUMBER] - bank_number) > 0) {
            words->fault = fault;
            words->event_no = (uint16_t)values[BANK_FAULT_AND_EVENT];
            words->boot_count = values[BANK_BOOTS];
            bank_number = values[BANK_NUMBER];
            found = true;
        }
    }
    if (words->fault == 0 && (suspect || (!found && !empty))) {
        words->fault = FAULT_RESET;
    }
}

/* The words of before. A reset that is not of the supply leaves the nonces; where it has not, a former session could be opened
 * anew by a copy of its HELLO: fault 5001, so that whoever stands at the machine has to clear it before anything starts. */
const struct edm_persistent *keep_words(uint8_t cause) {
    static struct edm_persistent words;
    clocks_on(&RCC->APB1ENR, RCC_APB1_PWR);
    PWR->CR |= PWR_CR_DBP;
    barrier();
    bool has_nonces = take_nonces(&words);
    take_banks(&words);
    if (!has_nonces && cause != RESET_CAUSE_POWER_ON && words.fault == 0) {
        words.fault = FAULT_RESET;
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
