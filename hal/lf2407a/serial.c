/* Serial line: SCI at 115200 baud, 8N1, rings between interrupt and tick.
 *
 * BRR = CLKOUT / (8 baud) - 1 = 42: 116279 baud, 0.94 % fast; a frame of ten bits allows 5 % in
 * all. The SCI has no FIFO: the next byte overruns this one after 87 us.
 *
 * Each ring has one writer of `head` and one of `tail`, both single words. The transmit interrupt
 * is enabled only while the transmitter is busy and bytes wait, so that it works whether the chip
 * takes "ready" as an event or as a level.
 */
#include "hal/hal.h"
#include "hal/lf2407a/drivers.h"
#include "hal/lf2407a/registers.h"
#include "hal/lf2407a/target.h"

#define BAUD_DIVIDER 42 /* 40 MHz */
#define RECEIVE_SIZE 64U
#define TRANSMIT_SIZE 128U

typedef struct {
    volatile u16 head; /* bytes put in */
    volatile u16 tail; /* bytes taken out */
} ring;

DRIVER_DATA u16 received[RECEIVE_SIZE];
DRIVER_DATA u16 waiting[TRANSMIT_SIZE];
DRIVER_DATA ring receive_ring;
DRIVER_DATA ring transmit_ring;
DRIVER_DATA volatile u16 lost; /* counted by the interrupt, not reset: no write from two sides */
DRIVER_DATA u16 lost_reported;

static void run_sci(void) {
    REGISTER_WRITE(SCICTL1, SCICTL1_TXENA | SCICTL1_RXENA);
    REGISTER_WRITE(SCICTL1, SCICTL1_TXENA | SCICTL1_RXENA | SCICTL1_RUN);
}

void serial_start(void) {
    receive_ring.head = 0;
    receive_ring.tail = 0;
    transmit_ring.head = 0;
    transmit_ring.tail = 0;
    lost = 0;
    lost_reported = 0;
    REGISTER_WRITE(SCICTL1, SCICTL1_TXENA | SCICTL1_RXENA);
    REGISTER_WRITE(SCICCR, SCICCR_8N1);
    REGISTER_WRITE(SCIHBAUD, BAUD_DIVIDER >> 8);
    REGISTER_WRITE(SCILBAUD, BAUD_DIVIDER & 0x00FF);
    REGISTER_WRITE(SCICTL2, SCICTL2_RX_INT);
    REGISTER_WRITE(SCIPRI, SCIPRI_TX_LOW | SCIPRI_RX_LOW);
    run_sci();
}

static u16 fill(const ring *r) {
    return (u16)(r->head - r->tail);
}

/* With interrupts masked: sends if the transmitter is ready, asks for the interrupt if not. */
static void feed_transmitter(void) {
    u16 more = fill(&transmit_ring);
    if (more != 0 && (REGISTER_READ(SCICTL2) & SCICTL2_TXRDY)) {
        REGISTER_WRITE(SCITXBUF, waiting[transmit_ring.tail % TRANSMIT_SIZE]);
        transmit_ring.tail = (u16)(transmit_ring.tail + 1U);
        --more;
    }
    REGISTER_WRITE(SCICTL2, more != 0 ? SCICTL2_RX_INT | SCICTL2_TX_INT : SCICTL2_RX_INT);
}

void serial_transmit(void) {
    feed_transmitter();
}

void serial_receive(void) {
    const u16 status = REGISTER_READ(SCIRXST);
    const u16 byte = REGISTER_READ(SCIRXBUF) & 0x00FFU;
    const u16 good = (u16)((status & SCIRXST_RXERROR) == 0);
    if (good && fill(&receive_ring) < RECEIVE_SIZE) {
        received[receive_ring.head % RECEIVE_SIZE] = byte;
        receive_ring.head = (u16)(receive_ring.head + 1U);
    } else {
        lost = (u16)(lost + 1U);
    }
    if (!good) {
        /* Only this clears the error; it also drops the byte being sent, so sending starts anew. */
        run_sci();
        feed_transmitter();
    }
}

u16 hal_serial_read(u16 *byte) {
    if (fill(&receive_ring) == 0)
        return 0;
    *byte = received[receive_ring.tail % RECEIVE_SIZE];
    receive_ring.tail = (u16)(receive_ring.tail + 1U);
    return 1;
}

u16 hal_serial_space(void) {
    return (u16)(TRANSMIT_SIZE - fill(&transmit_ring));
}

void hal_serial_write(u16 byte) {
    if (hal_serial_space() == 0)
        return;
    waiting[transmit_ring.head % TRANSMIT_SIZE] = byte & 0x00FFU;
    transmit_ring.head = (u16)(transmit_ring.head + 1U);
    INTERRUPTS_OFF;
    feed_transmitter();
    INTERRUPTS_ON;
}

u16 hal_serial_lost(void) {
    const u16 since = (u16)(lost - lost_reported);
    lost_reported = (u16)(lost_reported + since);
    return since;
}
