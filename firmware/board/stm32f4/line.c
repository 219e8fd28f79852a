/* The line: USART3 (RM0090 30.3) with a ring each way. Reception is circular DMA, so no byte waits for the program;
 * what is sent goes out in contiguous pieces (DMA: RM0090 10.3, table 42). */
#include "board.h"

#define RX_BYTES 1024u
#define TX_BYTES 4096u
#define READ_MOST 256u /* bytes a millisecond; the line brings 92 */

static uint8_t rx[RX_BYTES];     /* what stands before the place of the stream does not change for ten milliseconds */
static uint8_t tx[TX_BYTES];
static uint32_t rx_at;          /* next to be read */
static uint32_t tx_in, tx_out, tx_piece; /* next to be written, next to be sent, bytes under way */
static struct {
    bool suspected, told;
    uint32_t at;                /* of the receiving ring */
} held;

#define RX_STREAM (&DMA1->S[1])
#define TX_STREAM (&DMA1->S[4])
#define TX_FLAGS 0x3Du          /* of stream 4, in IFCR[1] */

void line_start(void) {
    clocks_on(&RCC->AHB1ENR, RCC_AHB1_DMA1);
    clocks_on(&RCC->APB1ENR, RCC_APB1_USART3);
    rx_at = tx_in = tx_out = tx_piece = 0;
    RX_STREAM->PAR = (uint32_t)(uintptr_t)&USART3->DR;
    RX_STREAM->M0AR = (uint32_t)(uintptr_t)rx;
    RX_STREAM->NDTR = RX_BYTES;
    RX_STREAM->CR = DMA_CR_CHSEL(4) | DMA_CR_PL(2) | DMA_CR_MINC | DMA_CR_CIRC;
    RX_STREAM->CR |= DMA_CR_EN;
    TX_STREAM->PAR = (uint32_t)(uintptr_t)&USART3->DR;
    USART3->BRR = (APB1_HZ + EDM_BAUD / 2u) / EDM_BAUD;
    USART3->CR3 = USART_CR3_DMAR | USART_CR3_DMAT;
    USART3->CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE;
}

static uint32_t received(void) {
    return (RX_BYTES - RX_STREAM->NDTR) % RX_BYTES;
}

/* Hands what has come to the core, up to the end of the ring and from its begin on. */
void line_read(struct edm_controller *c) {
    uint32_t end = received();
    for (uint32_t left = READ_MOST; left > 0 && rx_at != end;) {
        uint32_t n = (end > rx_at ? end : RX_BYTES) - rx_at;
        n = n < left ? n : left;
        edm_receive(c, rx + rx_at, n);
        rx_at = (rx_at + n) % RX_BYTES;
        left -= n;
    }
}

/* Whether the line is held low: a framing error, and a millisecond later low still with nothing received. Told once. */
bool line_is_held_low(void) {
    bool is_low = !pins_high(PIN_LINE_IN);
    uint32_t at = received();
    bool is_held = held.suspected && is_low && at == held.at;
    if (!is_low) {
        held.suspected = held.told = false;
    } else if ((USART3->SR & USART_SR_FE) != 0) {
        (void)USART3->DR; /* with the status read before, this clears the flag */
        held.suspected = true;
        held.at = received();
    } else if (at != held.at) {
        held.suspected = false;
    }
    if (!is_held || held.told) {
        return false;
    }
    held.told = true;
    return true;
}

/* Takes a whole frame, or none of it. */
void hal_send(void *board, const uint8_t *frame, size_t size) {
    (void)board;
    uint32_t room = (tx_out + TX_BYTES - tx_in - 1u) % TX_BYTES;
    if (size > room) {
        return;
    }
    size_t whole = size < TX_BYTES - tx_in ? size : TX_BYTES - tx_in; /* before the end of the ring */
    memcpy(tx + tx_in, frame, whole);
    memcpy(tx, frame + whole, size - whole);
    tx_in = (tx_in + size) % TX_BYTES;
}

/* Sends the next piece once the one before is out. */
void line_send(void) {
    if ((TX_STREAM->CR & DMA_CR_EN) != 0) {
        return;
    }
    tx_out = (tx_out + tx_piece) % TX_BYTES;
    tx_piece = tx_in >= tx_out ? tx_in - tx_out : TX_BYTES - tx_out;
    if (tx_piece == 0) {
        return;
    }
    DMA1->IFCR[1] = TX_FLAGS;
    USART3->SR = ~USART_SR_TC;
    TX_STREAM->M0AR = (uint32_t)(uintptr_t)&tx[tx_out];
    TX_STREAM->NDTR = tx_piece;
    TX_STREAM->CR = DMA_CR_CHSEL(7) | DMA_CR_PL(1) | DMA_CR_MINC | DMA_CR_MEMORY_TO_PERIPHERAL;
    barrier();
    TX_STREAM->CR |= DMA_CR_EN;
}

/* Whether all is out, the last stop bit too. */
bool line_is_sent(void) {
    return (TX_STREAM->CR & DMA_CR_EN) == 0 && (tx_out + tx_piece) % TX_BYTES == tx_in &&
           (USART3->SR & USART_SR_TC) != 0;
}
