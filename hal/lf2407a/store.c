/* Parameter store: an SPI EEPROM of the 25xx640 kind (8 K bytes, pages of 32, write cycle 5 ms).
 *
 * Word w lies at byte 2 w, high byte first, so no word crosses a page. SPI mode 0 at 2 MHz, the
 * most that these parts take at 3.3 V. Chip select is IOPC5. A read moves five bytes, about 30 us;
 * "busy" asks the EEPROM only while a write of ours may be in progress.
 */
#include "hal/hal.h"
#include "hal/lf2407a/drivers.h"
#include "hal/lf2407a/registers.h"
#include "hal/lf2407a/target.h"

#define SPI_DIVIDER 19 /* CLKOUT / (19 + 1) = 2 MHz */
#define EEPROM_WRITE 0x02U
#define EEPROM_READ 0x03U
#define EEPROM_READ_STATUS 0x05U
#define EEPROM_WRITE_ENABLE 0x06U
#define EEPROM_WRITING 0x01U
/* 8 bits take 160 cycles; a loop pass takes more than two. The SPI of a chip that runs cannot fail
 * to finish; the bound keeps a dead one from holding the tick. */
#define POLLS_MAX 100U

DRIVER_DATA u16 writing;

static void chip_select(void) {
    REGISTER_WRITE(PCDATDIR, PCDATDIR_IOPC5_OUTPUT);
}

static void chip_release(void) {
    REGISTER_WRITE(PCDATDIR, PCDATDIR_IOPC5_OUTPUT | PCDATDIR_IOPC5);
}

void store_start(void) {
    chip_release();
    REGISTER_WRITE(SPICCR, SPICCR_8_BITS);
    REGISTER_WRITE(SPICTL, SPICTL_PHASE | SPICTL_MASTER | SPICTL_TALK);
    REGISTER_WRITE(SPIBRR, SPI_DIVIDER);
    REGISTER_WRITE(SPICCR, SPICCR_8_BITS | SPICCR_RUN);
    /* A write from before the reset may still run. */
    writing = 1;
}

/* Sends a byte and returns the one that came back. */
static u16 exchange(u16 byte) {
    u16 polls = 0;
    REGISTER_WRITE(SPITXBUF, (byte & 0x00FFU) << 8);
    while (!(REGISTER_READ(SPISTS) & SPISTS_INT_FLAG) && polls < POLLS_MAX)
        ++polls;
    return REGISTER_READ(SPIRXBUF) & 0x00FFU;
}

static void send_address(u16 word_address) {
    const u16 byte_address = (u16)(word_address << 1);
    (void)exchange(byte_address >> 8);
    (void)exchange(byte_address);
}

u16 hal_store_busy(void) {
    if (writing) {
        chip_select();
        (void)exchange(EEPROM_READ_STATUS);
        writing = (u16)(exchange(0) & EEPROM_WRITING);
        chip_release();
    }
    return writing;
}

u16 hal_store_read(u16 address) {
    u16 word;
    chip_select();
    (void)exchange(EEPROM_READ);
    send_address(address);
    word = (u16)(exchange(0) << 8);
    word = (u16)(word | exchange(0));
    chip_release();
    return word;
}

void hal_store_write(u16 address, u16 word) {
    chip_select();
    (void)exchange(EEPROM_WRITE_ENABLE);
    chip_release();
    chip_select();
    (void)exchange(EEPROM_WRITE);
    send_address(address);
    (void)exchange(word >> 8);
    (void)exchange(word);
    chip_release();
    writing = 1;
}
