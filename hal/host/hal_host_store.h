/* Model of the EEPROM behind hal_store_*, for plants on a PC: words that survive, writes that take
 * time, power that fails in the middle of one.
 *
 * Power fails during the write that brings writes_until_cut to 0: that word becomes torn_word, and
 * nothing is written or read until hal_host_store_power_on.
 */
#ifndef HAL_HOST_HAL_HOST_STORE_H
#define HAL_HOST_HAL_HOST_STORE_H

#include <stdint.h>

#include "hal/hal.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    uint16_t word[HAL_STORE_WORDS];
    uint16_t busy_polls; /* how often "busy" is answered after a write */
    uint16_t busy_polls_left;
    uint32_t writes_until_cut; /* 0: power does not fail */
    uint16_t torn_word;
    uint16_t power_failed;
    uint32_t writes;
    uint32_t misuses; /* accesses while busy or beyond the end: mistakes of the firmware */
} hal_host_store;

/* All words FFFFh, no cut planned. */
void hal_host_store_blank(hal_host_store *store, uint16_t busy_polls);
/* Power comes (back): not busy, no cut planned. */
void hal_host_store_power_on(hal_host_store *store);

uint16_t hal_host_store_busy(hal_host_store *store);
uint16_t hal_host_store_read(hal_host_store *store, uint16_t address);
void hal_host_store_write(hal_host_store *store, uint16_t address, uint16_t word);

#ifdef __cplusplus
}
#endif

#endif
