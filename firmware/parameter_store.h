/* Parameters that survive power off, in the words of hal_store_*, two banks of
 * PARAMETER_STORE_BANK_WORDS:
 *
 *     0         marker: 5AC3h = whole, FFFFh = blank, anything else = being written
 *     1         sequence: counts the saves, wrapping; the newer of two whole banks counts
 *     2         fingerprint of the parameter table (parameters.h)
 *     3         number n of parameters
 *     4 .. n+3  values
 *     n+4       CRC-16 (frame.h) over words 1 to n+3, low byte first
 *
 * A save goes to the bank that does not hold the set in use:
 *
 *     if marker = 5AC3h: marker := 0;  words 1 to n+4;  read all back;  marker := 5AC3h;  read it
 *
 * Power lost at any point leaves the other bank untouched, and this one with its old set, or with a
 * marker that is not 5AC3h, or with the new set. The word being written when power fails may read
 * as anything; the marker is only written while the rest of the bank is a whole set, old or new. So
 * which set is loaded after a cut does not hang on the CRC; the CRC finds words that have rotted.
 *
 * A set of another table is not used: its values may belong to other parameters. Nor is one with a
 * value out of limits.
 *
 * One word a tick: a save takes up to n + 6 writes, of about 5 ms each with an EEPROM. Parameters
 * must not change while parameter_store_at_work().
 */
#ifndef FIRMWARE_PARAMETER_STORE_H
#define FIRMWARE_PARAMETER_STORE_H

#include "firmware/parameters.h"
#include "hal/hal.h"

#define PARAMETER_STORE_BANK_WORDS (HAL_STORE_WORDS / 2)
#define PARAMETER_STORE_WHOLE 0x5AC3U

#ifdef __cplusplus
extern "C" {
#endif

#define STORE_STATUS(name, description) PARAMETER_STORE_##name,
typedef enum {
#include "firmware/messages.def"
    PARAMETER_STORE_STATUS_COUNT
} parameter_store_status;

typedef struct {
    parameter_store_status status;
    u16 table; /* fingerprint of ours */
    u16 step;
    u16 bank;
    u16 at; /* word of the bank that is next */
    u16 crc;
    u16 count; /* of the bank being checked */
    u16 found[2];
    u16 sequence[2];
    u16 current; /* the bank that a save must not touch */
} parameter_store;

/* Loads on the spot, in at most 4000 calls of the HAL; for use before the first tick. Without a
 * usable set the parameters are the defaults. The result stands in `status`. */
void parameter_store_start(parameter_store *store, parameters *p);
/* Begin what parameter_store_tick carries out; not while at work. */
void parameter_store_load(parameter_store *store);
void parameter_store_save(parameter_store *store);
u16 parameter_store_at_work(const parameter_store *store);
/* Reads or writes one word at most. */
void parameter_store_tick(parameter_store *store, parameters *p);

#ifdef __cplusplus
}
#endif

#endif
