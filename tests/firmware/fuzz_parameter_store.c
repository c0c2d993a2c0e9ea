/* libFuzzer: any words in the store, a save over them, power cut anywhere in it.
 *
 * First bytes: switches that make an image plausible (marker, table and CRC right), since no fuzzer
 * guesses a CRC; when the power fails; what the torn word reads. The rest is the image. Must hold:
 * what is loaded is within the limits, what is not loaded are the defaults, and after the cut
 * either the set from before or the one being saved is loaded.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/firmware/robot_bench.h"

static robot_bench bench;
static parameters p;
static parameter_store store;

static void require(int condition, const char *rule) {
    if (condition)
        return;
    fprintf(stderr, "fuzz_parameter_store: %s\n", rule);
    abort();
}

static void make_plausible(int bank, unsigned switches) {
    uint16_t *word = bench.store.word + bank * PARAMETER_STORE_BANK_WORDS;
    if (switches & 1)
        word[0] = PARAMETER_STORE_WHOLE;
    if (switches & 2)
        word[2] = parameters_fingerprint();
    if (switches & 4)
        word[3] = PARAMETER_COUNT;
    if (switches & 8 && word[3] < PARAMETER_STORE_BANK_WORDS - 4) {
        u16 crc = FRAME_CRC_START;
        for (int at = 1; at < 4 + word[3]; at++)
            crc = frame_crc_u16(crc, word[at]);
        word[4 + word[3]] = crc;
    }
}

static int usable(void) {
    return store.status == PARAMETER_STORE_LOADED || store.status == PARAMETER_STORE_LOADED_OLDER;
}

static void restart(void) {
    parameters defaults;
    parameter_info info;
    memset(&p, 0x55, sizeof p);
    memset(&store, 0x55, sizeof store);
    hal_host_store_power_on(&bench.store);
    parameter_store_start(&store, &p);
    require(!parameter_store_at_work(&store), "start without an end");
    parameters_set_defaults(&defaults);
    require(usable() || memcmp(&p, &defaults, sizeof p) == 0, "neither loaded nor defaults");
    for (u16 id = 0; id < PARAMETER_COUNT; id++) {
        parameters_describe(id, &info);
        require(p.value[id] >= info.minimum && p.value[id] <= info.maximum, "out of limits");
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    parameters before, after;
    if (size < 6)
        return 0;
    robot_bench_reset(&bench);
    for (size_t i = 6; i < size && i < 6 + 2 * HAL_STORE_WORDS; i++) {
        uint16_t *word = &bench.store.word[(i - 6) / 2];
        *word = (uint16_t)(i % 2 ? (*word & 0xFF) | data[i] << 8 : (*word & 0xFF00) | data[i]);
    }
    make_plausible(0, data[0] & 15u);
    make_plausible(1, data[0] >> 4);
    restart();
    before = p;
    for (u16 id = 0; id < PARAMETER_COUNT; id++)
        parameters_set(&p, id, (i16)(before.value[id] + (i16)(1 - 2 * (data[1] & 1))));
    after = p;
    bench.store.writes_until_cut = data[2];
    bench.store.torn_word = (uint16_t)(data[3] | data[4] << 8);
    parameter_store_save(&store);
    for (int n = 0; n < 2000 && !bench.store.power_failed; n++)
        parameter_store_tick(&store, &p);
    restart();
    require(memcmp(&p, &before, sizeof p) == 0 || memcmp(&p, &after, sizeof p) == 0, "mixed set");
    require(bench.store.misuses == 0, "store misused");
    return 0;
}
