/* Model of an EEPROM; see hal_host_store.h. */
#include "hal/host/hal_host_store.h"

void hal_host_store_blank(hal_host_store *store, uint16_t busy_polls) {
    int address;
    for (address = 0; address < HAL_STORE_WORDS; address++)
        store->word[address] = 0xFFFF;
    store->busy_polls = busy_polls;
    store->torn_word = 0xFFFF;
    store->writes = 0;
    store->misuses = 0;
    hal_host_store_power_on(store);
}

void hal_host_store_power_on(hal_host_store *store) {
    store->power_failed = 0;
    store->writes_until_cut = 0;
    store->busy_polls_left = 0;
}

/* 1 when an access is in order now. */
static int accessible(hal_host_store *store, uint16_t address) {
    if (store->busy_polls_left > 0 || address >= HAL_STORE_WORDS)
        store->misuses++;
    return !store->power_failed && address < HAL_STORE_WORDS;
}

uint16_t hal_host_store_busy(hal_host_store *store) {
    if (store->busy_polls_left == 0)
        return 0;
    store->busy_polls_left--;
    return 1;
}

uint16_t hal_host_store_read(hal_host_store *store, uint16_t address) {
    return accessible(store, address) ? store->word[address] : 0xFFFF;
}

void hal_host_store_write(hal_host_store *store, uint16_t address, uint16_t word) {
    if (!accessible(store, address))
        return;
    store->writes++;
    store->busy_polls_left = store->busy_polls;
    store->power_failed = store->writes_until_cut == 1;
    if (store->writes_until_cut > 0)
        store->writes_until_cut--;
    store->word[address] = store->power_failed ? store->torn_word : word;
}
