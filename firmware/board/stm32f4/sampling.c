/* What is measured without the program: edges of gate and ignition (TIM2, TIM5: RM0090 18.3.5), gap voltage and current at
 * 1 MS/s (ADC1 and ADC2 together: RM0090 13.9.2, started by TIM8), slow channels at 16 kHz (ADC3, started by TIM4), all by
 * DMA (RM0090 10.3, tables 42 and 43). The samples of the gap are the ring of waveforms as well. */
#include "board.h"

#define SCANS 32u
#define SLOW_HALFWORDS (SCANS * SLOW_CHANNELS)
#define SLOW_PER_MS (16u * SLOW_CHANNELS)
#define SLOW_SLACK 8u
#define SCAN_COUNTS (84000u / 16u) /* of TIM4, between two scans */
#define SAMPLES_PER_MS 1000u
#define LAG_MOST 2         /* samples that a look may find more or less than time has passed */
#define LAST_LOOK 1050u    /* samples that come until the program has looked at those of a millisecond */

/* 80 periods of 2.3 kHz, a fifth of the whole behind the fault, and what comes until the ring is stopped. */
#define WAVE_MEMORY 34785u
#define WAVE_RING (WAVE_MEMORY + SAMPLES_PER_MS + 90u)
#define REST_RING 400u     /* goes on while the other one is kept; no divisor of a millisecond, so that a stop shows */
#define SUM_WORDS 1000u    /* of the check, a millisecond */
#define KEPT_MAGIC 0x57415645u

#define GATES (&DMA1->S[3])
#define IGNITIONS (&DMA1->S[5])
#define ENDS (&DMA1->S[6])
#define SAMPLES (&DMA2->S[4])
#define SLOW (&DMA2->S[0])
#define ALL_FLAGS 0x3Du
#define WAIT_MOST 1000u

NO_INIT volatile uint32_t wave_ring[WAVE_RING];
static volatile uint32_t rest_ring[REST_RING];
static volatile uint32_t gate_edges[EDGES], ignition_edges[EDGES], end_edges[EDGES];
static volatile uint16_t slow_ring[SLOW_HALFWORDS];

/* Where timer and streams stood when the tick came. */
static struct {
    uint32_t timer, gates, ignitions, ends, samples, slow;
} latched;

static uint32_t now;       /* the timer at the end of the millisecond */
static int64_t now_ns;     /* the same on the controller's clock */
static bool running;
static struct samples samples;
static bool anew;          /* the stream was started anew: where it stands has to be seen */
static uint32_t anew_timer;
static bool scans_anew;
static struct scans scans = {.ring = slow_ring, .size = SLOW_HALFWORDS};
static real slow[SLOW_CHANNELS]; /* in their units, however often they are asked for */

/* What a fault keeps of the ring. It outlasts a reset: its check is right then. */
NO_INIT struct {
    uint32_t magic, begin, total;
    uint32_t blank;        /* samples at its begin that were never taken: they read 0 */
    uint32_t sums[2];
    uint32_t times;        /* check of when the core says that it was */
} wave_kept;
static struct {
    bool pending, stopped, summed, lost;
    int64_t end_ns;
    uint32_t at, sums[2];
} keep;

static void stop_stream(struct dma_stream *stream) {
    stream->CR &= ~DMA_CR_EN;
    for (uint32_t i = 0; i < WAIT_MOST && (stream->CR & DMA_CR_EN) != 0; i++) {
    }
}

static void start_stream(struct dma_stream *stream, volatile void *from, volatile void *to, uint32_t count, uint32_t cr) {
    stream->PAR = (uint32_t)(uintptr_t)from;
    stream->M0AR = (uint32_t)(uintptr_t)to;
    stream->NDTR = count;
    stream->CR = cr | DMA_CR_MINC | DMA_CR_CIRC;
    stream->CR |= DMA_CR_EN;
}

static void start_samples(void) {
    DMA2->IFCR[1] = ALL_FLAGS; /* of stream 4 */
    start_stream(SAMPLES, &ADC_COMMON->CDR, (volatile void *)(uintptr_t)samples.ring, samples.size,
                 DMA_CR_CHSEL(0) | DMA_CR_PL(3) | DMA_CR_PSIZE(4) | DMA_CR_MSIZE(4));
    ADC_COMMON->CCR |= ADC_CCR_DMA_2;
}

/* Puts the stream of samples to a ring; an overrun, which a stopped stream makes, is over then (RM0090 13.8.1). */
static void restart_samples(const volatile uint32_t *ring, uint32_t size) {
    ADC_COMMON->CCR &= ~ADC_CCR_DMA_MASK;
    stop_stream(SAMPLES);
    samples = (struct samples){.ring = ring, .size = size};
    ADC1->SR = ~ADC_SR_OVR;
    ADC2->SR = ~ADC_SR_OVR;
    start_samples();
    anew = true;
    anew_timer = TIM5->CNT;
}

static void start_slow(void) {
    DMA2->IFCR[0] = ALL_FLAGS; /* of stream 0 */
    start_stream(SLOW, &ADC3->DR, slow_ring, SLOW_HALFWORDS,
                 DMA_CR_CHSEL(2) | DMA_CR_PL(1) | DMA_CR_PSIZE(2) | DMA_CR_MSIZE(2));
    ADC3->CR2 |= ADC_CR2_DMA;
}

/* 3 us at least, until converters that were switched on are steady. */
static void wait_until_steady(void) {
    for (volatile uint32_t i = 0; i < 200u; i++) {
    }
}

/* With TIM4 off: starts the stream anew, from the first channel on. A converter that is switched off forgets where in its
 * sequence it was; else the rest of a scan under way would come first, and every channel stand in another's place. */
static void reset_slow(void) {
    ADC3->CR2 &= ~(ADC_CR2_DMA | ADC_CR2_ADON);
    stop_stream(SLOW);
    ADC3->SR = ~ADC_SR_OVR;
    ADC3->CR2 |= ADC_CR2_ADON;
    wait_until_steady();
    start_slow();
}

/* TIM4 goes on where it would be: its scans stand to the tick as before. */
static void restart_slow(void) {
    TIM4->CR1 = 0;
    reset_slow();
    TIM4->CNT = (TIM5->CNT - now) % SCAN_COUNTS;
    TIM4->CR1 = TIM_CR1_CEN;
}

/* Sampling times: 3 cycles for the gap, 15 of 21 a sample; 84 for slow channels. ADC clock: 21 MHz (36 at most). */
static void start_adcs(void) {
    clocks_on(&RCC->APB2ENR, RCC_APB2_ADC1 | RCC_APB2_ADC2 | RCC_APB2_ADC3);
    ADC_COMMON->CCR = ADC_CCR_ADCPRE_4 | ADC_CCR_DUAL_REGULAR | ADC_CCR_DDS;
    ADC1->SQR1 = ADC2->SQR1 = ADC_SQR1_L(1);
    ADC1->SQR3 = 10u;
    ADC2->SQR3 = 13u;
    ADC3->CR1 = ADC_CR1_SCAN;
    ADC3->SMPR1 = 4u << 3u * (14u - 10u) | 4u << 3u * (15u - 10u);
    ADC3->SMPR2 = 4u << 3u * 8u | 4u << 3u * 9u;
    ADC3->SQR1 = ADC_SQR1_L(4);
    ADC3->SQR3 = 9u | 15u << 5 | 8u << 10 | 14u << 15; /* in the order of enum slow */
    ADC1->CR2 = ADC2->CR2 = ADC3->CR2 = ADC_CR2_ADON;
    wait_until_steady();
    start_slow();
    ADC3->CR2 |= ADC_CR2_DDS | ADC_CR2_EXTSEL_TIM4_CC4 | ADC_CR2_EXTEN_RISING;
    start_samples();
    ADC1->CR2 |= ADC_CR2_EXTSEL_TIM8_TRGO | ADC_CR2_EXTEN_RISING; /* ADC2 follows ADC1 */
}

static void start_edges(void) {
    const uint32_t words = DMA_CR_PL(2) | DMA_CR_PSIZE(4) | DMA_CR_MSIZE(4);
    start_stream(IGNITIONS, &TIM2->CCR[0], ignition_edges, EDGES, DMA_CR_CHSEL(3) | words);
    start_stream(ENDS, &TIM2->CCR[1], end_edges, EDGES, DMA_CR_CHSEL(3) | words);
    start_stream(GATES, &TIM5->CCR[3], gate_edges, EDGES, DMA_CR_CHSEL(6) | words);
    TIM2->CCMR1 = TIM_CCMR1_CC1_TI1 | TIM_CCMR1_CC2_TI1;
    TIM2->DIER = TIM_DIER_CC1DE | TIM_DIER_CC2DE;
    TIM2->CCER = TIM_CCER_CC1E | TIM_CCER_CC2E | TIM_CCER_CC2P;
    TIM5->CCMR2 = TIM_CCMR2_CC4_TI4;
    TIM5->DIER = TIM_DIER_CC4DE;
    TIM5->CCER = TIM_CCER_CC4E;
    TIM2->ARR = TIM5->ARR = UINT32_MAX;
}

/* All but the displacement, which is a reading of the millisecond. */
static void read_scans(void) {
    slow[SLOW_MONITOR] = measure_slow(&scans, SLOW_MONITOR);
    slow[SLOW_TEMPERATURE] = measure_slow(&scans, SLOW_TEMPERATURE);
    slow[SLOW_FLOW] = measure_slow(&scans, SLOW_FLOW);
}

/* Sets everything up, and brings the first scans of the slow channels: edm_create asks for the monitor. */
void sampling_start(void) {
    clocks_on(&RCC->AHB1ENR, RCC_AHB1_DMA1 | RCC_AHB1_DMA2);
    clocks_on(&RCC->APB1ENR, RCC_APB1_TIM2 | RCC_APB1_TIM4 | RCC_APB1_TIM5 | RCC_APB1_TIM7);
    clocks_on(&RCC->APB2ENR, RCC_APB2_TIM8);
    bool holds = keep.stopped;
    samples = holds ? (struct samples){.ring = rest_ring, .size = REST_RING}
                    : (struct samples){.ring = wave_ring, .size = WAVE_RING};
    TIM4->ARR = SCAN_COUNTS - 1u;
    TIM4->CCR[3] = SCAN_COUNTS / 2u;
    TIM4->CCMR2 = TIM_CCMR2_OC4_PWM1;
    TIM4->CCER = TIM_CCER_CC4E;
    TIM8->ARR = CPU_HZ / 1000000u - 1u;
    TIM8->CR2 = TIM_CR2_MMS_UPDATE;
    TIM7->PSC = 1u;
    TIM7->ARR = 41999u;
    TIM7->EGR = TIM_EGR_UG;
    TIM7->SR = 0;
    start_adcs();
    start_edges();
    TIM4->CR1 = TIM_CR1_CEN;
    for (uint32_t i = 0; i < 200000u && !scans.good; i++) {
        scans.good = SLOW_HALFWORDS - SLOW->NDTR >= SLOW_PER_MS;
    }
    scans.at = SLOW_PER_MS;
    read_scans();
    TIM4->CR1 = 0;
}

/* Starts the clock: timers and tick one behind the other. TIM8 begins at its end, so sample k is of k us. */
void sampling_run(void) {
    interrupts_off();
    reset_slow();
    TIM2->CNT = TIM4->CNT = TIM5->CNT = TIM7->CNT = 0;
    TIM8->CNT = TIM8->ARR;
    scans.at = 0;
    running = true;
    TIM7->DIER = TIM_DIER_UIE;
    NVIC_ISER[IRQ_TIM7 / 32] = 1u << IRQ_TIM7 % 32;
    TIM2->CR1 = TIM_CR1_CEN;
    TIM5->CR1 = TIM_CR1_CEN;
    TIM8->CR1 = TIM_CR1_CEN;
    TIM4->CR1 = TIM_CR1_CEN;
    TIM7->CR1 = TIM_CR1_CEN;
    interrupts_on();
}

/* In the tick: notes where everything stands. */
void sampling_latch(void) {
    latched.samples = SAMPLES->NDTR;
    latched.timer = TIM5->CNT;
    latched.gates = GATES->NDTR;
    latched.ignitions = IGNITIONS->NDTR;
    latched.ends = ENDS->NDTR;
    latched.slow = SLOW->NDTR;
}

static uint32_t place(uint32_t left, uint32_t size) {
    return (size - left) % size;
}

/* Which sample is of the end of the millisecond. A stream that has not brought one each microsecond is started anew, and
 * what it brought is no reading. */
static void look_at_samples(void) {
    int32_t size = (int32_t)samples.size;
    int32_t since = (int32_t)(latched.timer - now) / (int32_t)COUNTS_PER_US;
    int32_t seen = (int32_t)place(latched.samples, samples.size) - since; /* where the end of the millisecond is */
    uint32_t passed = anew ? (now - anew_timer) / COUNTS_PER_US : SAMPLES_PER_MS;
    uint32_t room = samples.size > 2u * LAST_LOOK ? samples.size - LAST_LOOK : samples.size - REST_RING / 4u;
    samples.at = (samples.at + passed) % samples.size;
    samples.held += passed;
    int32_t lag = ((int32_t)samples.at - seen) % size;
    lag = lag > size / 2 ? lag - size : lag < -size / 2 ? lag + size : lag;
    samples.good = lag <= LAG_MOST && lag >= -LAG_MOST;
    if (!samples.good) {
        keep.lost = keep.lost || keep.pending;
        restart_samples(samples.ring, samples.size);
        return;
    }
    if (anew) { /* it began in the middle of a microsecond */
        anew = false;
        samples.at = (uint32_t)((seen % size + size) % size);
        samples.held -= LAG_MOST;
    }
    samples.held = samples.held < room ? samples.held : room;
}

static void look_at_scans(void) {
    uint32_t at = place(latched.slow, SLOW_HALFWORDS);
    uint32_t moved = (at + SLOW_HALFWORDS - scans.at) % SLOW_HALFWORDS;
    scans.good = !scans_anew && moved >= SLOW_PER_MS - SLOW_SLACK && moved <= SLOW_PER_MS + SLOW_SLACK;
    scans.at = at;
    if (scans.good || scans_anew) { /* what a stream began in the middle of a millisecond is no mean of one */
        scans_anew = false;
        return;
    }
    restart_slow();
    scans.at = 0;
    scans_anew = true;
}

/* Follows the tick: what the streams hold at the end of the millisecond, whose time the controller knows. */
void sampling_look(struct records *records, int64_t time_ns) {
    now += COUNTS_PER_MS;
    now_ns = time_ns;
    look_at_samples();
    look_at_scans();
    read_scans();
    records->now = now;
    records->now_ns = time_ns;
    records->gates = (struct edges){gate_edges, place(latched.gates, EDGES)};
    records->ignitions = (struct edges){ignition_edges, place(latched.ignitions, EDGES)};
    records->ends = (struct edges){end_edges, place(latched.ends, EDGES)};
    records->samples = samples;
    records->scans = scans;
}

real sampling_slow(enum slow channel) {
    return slow[channel];
}

/* Waveforms: the ring goes on to the end that was asked for, then stands. */

static void add_to(uint32_t sums[2], uint32_t word) {
    sums[0] += word;
    sums[1] += sums[0];
}

/* Check of the core's times of a record. */
static uint32_t times_of(const struct edm_controller *c) {
    const struct edm_waveforms *w = &c->waveforms;
    const int64_t times[] = {w->begin_ns, w->end_ns, w->boot_ns};
    uint32_t sums[2] = {KEPT_MAGIC, w->frozen};
    for (int i = 0; i < 3; i++) {
        add_to(sums, (uint32_t)times[i]);
        add_to(sums, (uint32_t)(times[i] >> 32));
    }
    return sums[0] ^ sums[1];
}

static uint32_t word_of(uint32_t offset) {
    return wave_ring[(wave_kept.begin + offset) % WAVE_RING];
}

/* Sums up the next words of the record, until it is done. */
static void sum_up(uint32_t limit) {
    for (uint32_t i = 0; i < limit && keep.at < wave_kept.total; i++) {
        add_to(keep.sums, word_of(keep.at++));
    }
}

static void begin_sum(void) {
    keep.at = 0;
    keep.sums[0] = wave_kept.begin + (wave_kept.blank << 16);
    keep.sums[1] = wave_kept.total;
}

/* Once a millisecond, when it has been measured: stops the ring where it has to, and makes its check bit by bit. */
void sampling_tend(const struct edm_controller *c) {
    if (keep.pending && now_ns >= keep.end_ns) {
        restart_samples(rest_ring, REST_RING);
        keep.pending = false;
        keep.stopped = true;
        keep.summed = keep.lost;
        begin_sum();
    } else if (keep.stopped && !keep.summed) {
        sum_up(SUM_WORDS);
        if (keep.at == wave_kept.total) {
            wave_kept.sums[0] = keep.sums[0];
            wave_kept.sums[1] = keep.sums[1];
            wave_kept.times = times_of(c);
            wave_kept.magic = KEPT_MAGIC;
            keep.summed = true;
        }
    }
}

/* After a reset, before sampling starts: whether the record of a fault is still right. */
bool sampling_kept(const struct edm_controller *c) {
    bool whole = wave_kept.magic == KEPT_MAGIC && wave_kept.begin < WAVE_RING && wave_kept.total <= WAVE_RING &&
                 wave_kept.times == times_of(c);
    if (whole) {
        begin_sum();
        sum_up(WAVE_RING);
        whole = keep.sums[0] == wave_kept.sums[0] && keep.sums[1] == wave_kept.sums[1];
    }
    if (!whole) {
        wave_kept.magic = 0;
    }
    keep.stopped = keep.summed = whole;
    return whole;
}

uint32_t hal_wave_memory(void *board) {
    (void)board;
    return WAVE_MEMORY;
}

void hal_wave_keep(void *board, int64_t begin_ns, int64_t end_ns) {
    (void)board;
    if (!running || keep.stopped) {
        return;
    }
    uint32_t back = (uint32_t)((uint64_t)(now_ns - begin_ns) / 1000u) % WAVE_RING;
    wave_kept.magic = 0;
    wave_kept.blank = back > samples.held ? back - samples.held : 0;
    wave_kept.begin = (samples.at + WAVE_RING - back) % WAVE_RING;
    wave_kept.total = (uint32_t)((uint64_t)(end_ns - begin_ns) / 1000u);
    keep.end_ns = end_ns;
    keep.lost = !samples.good;
    keep.pending = true;
}

/* Counts of the wire, 10 mV and 1 mA; the greatest one for what is beyond it. */
static int16_t scaled(uint32_t count, uint32_t full) {
    uint32_t value = (2u * count * full + ADC_TOP) / (2u * ADC_TOP);
    return (int16_t)(value < INT16_MAX ? value : INT16_MAX);
}

void hal_wave_read(void *board, uint32_t offset, uint8_t n, int16_t *counts) {
    (void)board;
    for (uint32_t i = 0; i < n; i++) {
        uint32_t word = keep.lost || offset + i < wave_kept.blank ? 0 : word_of(offset + i);
        counts[2u * i] = scaled(word & 0xFFFu, (uint32_t)(EDM_GAP_FULL_V * R(100.0)));
        counts[2u * i + 1u] = scaled(word >> 16 & 0xFFFu, (uint32_t)(EDM_GAP_FULL_A * R(1000.0)));
    }
}

void hal_wave_forget(void *board, bool was_kept) {
    (void)board;
    if (!was_kept) {
        return; /* the core knows since when the samples are of one setting */
    }
    wave_kept.magic = 0;
    if (keep.stopped) {
        restart_samples(wave_ring, WAVE_RING);
    }
    keep.pending = keep.stopped = keep.summed = keep.lost = false;
}
