/* Parameter store: what survives which accident. Power is cut after every single word of a save. */
#include <string.h>
#include <unity.h>

#include "tests/firmware/reference.h"
#include "tests/firmware/robot_bench.h"

#define BANK PARAMETER_STORE_BANK_WORDS
#define SET_WORDS (PARAMETER_COUNT + 5)

static robot_bench bench;
static parameters p;
static parameter_store store;

void setUp(void) {
    robot_bench_reset(&bench);
}
void tearDown(void) {
    TEST_ASSERT_EQUAL_UINT32(0, bench.store.misuses);
}

/* ---- helpers ---- */

/* Sets of values within the limits; set 0 are the defaults. */
static i16 value_of(u16 id, int set) {
    parameter_info info;
    parameters_describe(id, &info);
    return set == 0 ? info.initial
                    : (i16)(info.minimum +
                            (set * 7919L + id * 101L) % ((i32)info.maximum - info.minimum + 1));
}

static void assume(int set) {
    for (u16 id = 0; id < PARAMETER_COUNT; id++)
        p.value[id] = value_of(id, set);
}

static void assert_set(int set) {
    for (u16 id = 0; id < PARAMETER_COUNT; id++)
        TEST_ASSERT_EQUAL_INT16(value_of(id, set), p.value[id]);
}

/* As after a reset: whatever the variables held. */
static void restart(void) {
    memset(&p, 0x55, sizeof p);
    memset(&store, 0x55, sizeof store);
    hal_host_store_power_on(&bench.store);
    parameter_store_start(&store, &p);
}

/* Until the store rests or power fails; ticks. */
static int finish(void) {
    int ticks = 0;
    while (parameter_store_at_work(&store) && !bench.store.power_failed) {
        const uint32_t writes = bench.store.writes;
        parameter_store_tick(&store, &p);
        TEST_ASSERT_TRUE(bench.store.writes <= writes + 1);
        TEST_ASSERT_TRUE(++ticks < 5000);
    }
    return ticks;
}

static parameter_store_status save(int set) {
    assume(set);
    parameter_store_save(&store);
    finish();
    return store.status;
}

static uint16_t *bank_words(int bank) {
    return bench.store.word + bank * BANK;
}

static void refusals_change_nothing(void) {
    restart();
    TEST_ASSERT_EQUAL(PARAMETERS_UNKNOWN_ID, parameters_set(&p, PARAMETER_COUNT, 0));
    TEST_ASSERT_EQUAL(PARAMETERS_OUT_OF_RANGE, parameters_set(&p, 0, -32768));
    TEST_ASSERT_EQUAL(PARAMETERS_OUT_OF_RANGE, parameters_set(&p, 0, 32768));
    assert_set(0);
}

static void repair_crc(int bank) {
    uint16_t *word = bank_words(bank);
    u16 crc = FRAME_CRC_START;
    for (u16 at = 1; at < 4 + word[3]; at++)
        crc = frame_crc_u16(crc, word[at]);
    word[4 + word[3]] = crc;
}

/* ---- saving and loading ---- */

static void blank_store_gives_the_defaults(void) {
    restart();
    TEST_ASSERT_EQUAL(PARAMETER_STORE_BLANK, store.status);
    assert_set(0);
    TEST_ASSERT_EQUAL_UINT32(0, bench.store.writes);
}

static void a_saved_set_comes_back(void) {
    restart();
    for (int set = 1; set < 6; set++) {
        TEST_ASSERT_EQUAL(PARAMETER_STORE_SAVED, save(set));
        assume(0);
        restart();
        TEST_ASSERT_EQUAL(PARAMETER_STORE_LOADED, store.status);
        assert_set(set);
    }
}

static void layout_is_the_one_documented(void) {
    restart();
    save(1);
    save(2);
    for (int bank = 0; bank < 2; bank++) {
        const uint16_t *word = bank_words(bank);
        const uint16_t crc = word[4 + PARAMETER_COUNT];
        TEST_ASSERT_EQUAL_HEX16(0x5AC3, word[0]);
        TEST_ASSERT_EQUAL_HEX16(parameters_fingerprint(), word[2]);
        TEST_ASSERT_EQUAL_HEX16(PARAMETER_COUNT, word[3]);
        repair_crc(bank);
        TEST_ASSERT_EQUAL_HEX16(crc, word[4 + PARAMETER_COUNT]);
        TEST_ASSERT_EQUAL_HEX16(0xFFFF, word[SET_WORDS]);
    }
    TEST_ASSERT_EQUAL_HEX16(2, bank_words(store.current)[1]); /* sequence */
    TEST_ASSERT_EQUAL_HEX16(1, bank_words(1 - store.current)[1]);
}

static void load_brings_back_what_was_saved(void) {
    restart();
    save(2);
    assume(1);
    parameter_store_load(&store);
    TEST_ASSERT_EQUAL(PARAMETER_STORE_LOADING, store.status);
    finish();
    TEST_ASSERT_EQUAL(PARAMETER_STORE_LOADED, store.status);
    assert_set(2);
}

static void a_save_takes_the_ticks_that_the_memory_needs(void) {
    restart();
    save(1);
    save(2);
    assume(1);
    parameter_store_save(&store);
    /* n + 6 writes, 5 polls of "busy" after each, n + 4 words and a marker read back */
    TEST_ASSERT_EQUAL_INT((SET_WORDS + 1) * 6 + SET_WORDS, finish());
}

static void sequence_of_saves_wraps(void) {
    restart();
    save(1);
    save(2);
    bank_words(store.current)[1] = 0xFFFF;
    bank_words(1 - store.current)[1] = 0xFFFE;
    repair_crc(0);
    repair_crc(1);
    restart();
    assert_set(2);
    for (int set = 3; set < 6; set++) {
        save(set);
        restart();
        assert_set(set);
    }
    TEST_ASSERT_EQUAL_HEX16(2, bank_words(store.current)[1]);
}

/* ---- power cuts ---- */

/* What the word under way may read as. The marker and the fingerprint are the nastiest. */
static uint16_t torn_word(int kind, uint64_t *seed) {
    const uint16_t nasty[] = {0, 0xFFFF, PARAMETER_STORE_WHOLE, parameters_fingerprint()};
    return kind < 4 ? nasty[kind] : (uint16_t)reference_random(seed);
}

/* Cuts the power in write `cut` of a save of set 2 over what is stored, then starts again. Returns
 * 1 when the save had ended before. Set `old` or 2 must be loaded, and saving works again. */
static int cut_save(uint32_t cut, uint16_t torn, int old) {
    int complete;
    restart();
    assert_set(old);
    bench.store.writes_until_cut = cut;
    bench.store.torn_word = torn;
    save(2);
    complete = !bench.store.power_failed;
    restart();
    if (complete || p.value[0] == value_of(0, 2)) {
        assert_set(2);
    } else {
        assert_set(old);
    }
    if (store.status == PARAMETER_STORE_LOADED_OLDER)
        assert_set(old);
    TEST_ASSERT_TRUE(store.status == PARAMETER_STORE_LOADED ||
                     store.status == PARAMETER_STORE_LOADED_OLDER ||
                     (old == 0 && store.status == PARAMETER_STORE_CORRUPT) ||
                     (old == 0 && store.status == PARAMETER_STORE_BLANK));
    TEST_ASSERT_EQUAL(PARAMETER_STORE_SAVED, save(4));
    restart();
    TEST_ASSERT_EQUAL(PARAMETER_STORE_LOADED, store.status);
    assert_set(4);
    return complete;
}

static void cut_every_word_of_a_save_over(const uint16_t image[HAL_STORE_WORDS], int old) {
    uint64_t seed = 3;
    for (int kind = 0; kind < 8; kind++) {
        uint32_t cut = 0;
        int complete = 0;
        while (!complete) {
            memcpy(bench.store.word, image, sizeof bench.store.word);
            complete = cut_save(++cut, torn_word(kind, &seed), old);
        }
        /* with a bank to open: marker, set, marker; one write more than that is never cut */
        TEST_ASSERT_TRUE(cut == SET_WORDS + 1 || cut == SET_WORDS + 2);
    }
}

static void cut_in_the_first_save(void) {
    const hal_host_store blank = bench.store;
    cut_every_word_of_a_save_over(blank.word, 0);
}

static void cut_in_the_second_save(void) {
    restart();
    save(1);
    const hal_host_store saved = bench.store;
    cut_every_word_of_a_save_over(saved.word, 1);
}

/* Both banks in turn: with three saves the current set is in one, with four in the other. */
static void cut_in_later_saves(void) {
    for (int saves = 3; saves <= 4; saves++) {
        hal_host_store_blank(&bench.store, 1);
        restart();
        for (int n = 0; n < saves; n++)
            save(3);
        const hal_host_store saved = bench.store;
        cut_every_word_of_a_save_over(saved.word, 3);
    }
}

/* The bank that a cut has left half written, cut again in the repetition of the save. */
static void cut_twice(void) {
    for (uint32_t first = 1; first <= SET_WORDS + 1; first += 13) {
        hal_host_store_blank(&bench.store, 1);
        restart();
        save(3);
        save(3);
        bench.store.writes_until_cut = first;
        bench.store.torn_word = 0x1234;
        save(1);
        restart();
        if (p.value[0] != value_of(0, 3))
            continue; /* cut in the last word, and whole */
        const hal_host_store cut_once = bench.store;
        cut_every_word_of_a_save_over(cut_once.word, 3);
    }
}

/* ---- rot ---- */

static void any_changed_word_of_the_set_in_use_gives_the_older_set(void) {
    static const uint16_t changes[] = {1, 0x8000, 0xFFFF, 0x00FF, 0x1021};
    for (int at = 0; at < SET_WORDS; at++) {
        for (int k = 0; k < 5; k++) {
            hal_host_store_blank(&bench.store, 0);
            restart();
            save(1);
            save(2);
            bank_words(store.current)[at] ^= changes[k];
            restart();
            TEST_ASSERT_EQUAL(PARAMETER_STORE_LOADED_OLDER, store.status);
            assert_set(1);
        }
    }
}

static void a_word_that_rots_in_the_older_set_is_told(void) {
    restart();
    save(1);
    save(2);
    bank_words(1 - store.current)[20]++;
    restart();
    TEST_ASSERT_EQUAL(PARAMETER_STORE_LOADED_OLDER, store.status);
    assert_set(2);
}

static void rot_in_both_banks_gives_the_defaults(void) {
    restart();
    save(1);
    save(2);
    bank_words(0)[9]++;
    bank_words(1)[30]++;
    restart();
    TEST_ASSERT_EQUAL(PARAMETER_STORE_CORRUPT, store.status);
    assert_set(0);
}

static void random_words_give_the_defaults(void) {
    uint64_t seed = 11;
    for (int n = 0; n < REFERENCE_CASES(2000); n++) {
        for (int at = 0; at < HAL_STORE_WORDS; at++)
            bench.store.word[at] = (uint16_t)reference_random(&seed);
        for (int known = 0; known < n % 5; known++) { /* right up to word 0, 2, 3 */
            bank_words(0)[0] = PARAMETER_STORE_WHOLE;
            if (known > 1)
                bank_words(0)[2] = parameters_fingerprint();
            if (known > 2)
                bank_words(0)[3] = PARAMETER_COUNT;
        }
        restart();
        TEST_ASSERT_EQUAL(PARAMETER_STORE_CORRUPT, store.status);
        assert_set(0);
    }
}

static void a_value_out_of_its_limits_is_not_used(void) {
    restart();
    save(1);
    bank_words(store.current)[4 + PARAMETER_ID_command_timeout_ms] = 0;
    repair_crc(store.current);
    restart();
    TEST_ASSERT_EQUAL(PARAMETER_STORE_CORRUPT, store.status);
    assert_set(0);
}

/* ---- other tables ---- */

static void a_set_of_another_table_is_not_used_but_kept(void) {
    static const uint16_t counts[] = {PARAMETER_COUNT, PARAMETER_COUNT - 1, PARAMETER_COUNT + 3, 0};
    for (int k = 0; k < 4; k++) {
        uint16_t before[BANK];
        hal_host_store_blank(&bench.store, 0);
        restart();
        save(2);
        const int bank = store.current;
        bank_words(bank)[2] ^= 0x0101;
        bank_words(bank)[3] = counts[k];
        repair_crc(bank);
        memcpy(before, bank_words(bank), sizeof before);
        restart();
        TEST_ASSERT_EQUAL(PARAMETER_STORE_OTHER_TABLE, store.status);
        assert_set(0);
        TEST_ASSERT_EQUAL(PARAMETER_STORE_SAVED, save(1));
        TEST_ASSERT_EQUAL_HEX16_ARRAY(before, bank_words(bank), BANK);
        restart();
        TEST_ASSERT_EQUAL(PARAMETER_STORE_LOADED, store.status);
        assert_set(1);
    }
}

static void a_count_that_does_not_fit_the_table_or_the_bank_is_rot(void) {
    static const uint16_t counts[] = {PARAMETER_COUNT + 1, BANK - 4, BANK, 0x7FFF, 0xFFFF};
    for (int k = 0; k < 10; k++) {
        hal_host_store_blank(&bench.store, 0);
        restart();
        save(2);
        if (k >= 5)
            bank_words(store.current)[2] ^= 1;
        bank_words(store.current)[3] = counts[k % 5];
        restart();
        TEST_ASSERT_EQUAL(PARAMETER_STORE_CORRUPT, store.status);
        assert_set(0);
    }
}

/* ---- memories that do not work ---- */

static void a_memory_that_does_not_take_words_is_told(void) {
    restart();
    save(1);
    const hal_host_store saved = bench.store;
    for (uint32_t dead_from = 1; dead_from <= SET_WORDS; dead_from++) { /* the last: the marker */
        bench.store = saved;
        restart();
        bench.store.writes_until_cut = dead_from;
        bench.store.torn_word = 0x4321;
        assume(2);
        parameter_store_save(&store);
        for (int n = 0; n < 2000; n++)
            parameter_store_tick(&store, &p);
        TEST_ASSERT_EQUAL(PARAMETER_STORE_SAVE_FAILED, store.status);
        assert_set(2);
        restart();
        assert_set(1);
    }
}

static void a_memory_that_is_always_busy_does_not_hold_the_start(void) {
    bench.store.busy_polls_left = 0xFFFF;
    memset(&p, 0x55, sizeof p);
    parameter_store_start(&store, &p);
    TEST_ASSERT_EQUAL(PARAMETER_STORE_CORRUPT, store.status);
    assert_set(0);
}

/* Between the check of a set and its use memory may rot: the limits are asked again. */
static void a_word_that_changes_after_its_check_is_not_used(void) {
    restart();
    save(1);
    save(2);
    parameter_store_load(&store);
    for (int ticks = 0; ticks < 2 * SET_WORDS; ticks++)
        parameter_store_tick(&store, &p);
    bank_words(store.current)[4 + PARAMETER_ID_command_timeout_ms] = 0;
    finish();
    TEST_ASSERT_EQUAL(PARAMETER_STORE_CORRUPT, store.status);
    assert_set(0);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(blank_store_gives_the_defaults);
    RUN_TEST(refusals_change_nothing);
    RUN_TEST(a_saved_set_comes_back);
    RUN_TEST(layout_is_the_one_documented);
    RUN_TEST(load_brings_back_what_was_saved);
    RUN_TEST(a_save_takes_the_ticks_that_the_memory_needs);
    RUN_TEST(sequence_of_saves_wraps);
    RUN_TEST(cut_in_the_first_save);
    RUN_TEST(cut_in_the_second_save);
    RUN_TEST(cut_in_later_saves);
    RUN_TEST(cut_twice);
    RUN_TEST(any_changed_word_of_the_set_in_use_gives_the_older_set);
    RUN_TEST(a_word_that_rots_in_the_older_set_is_told);
    RUN_TEST(rot_in_both_banks_gives_the_defaults);
    RUN_TEST(random_words_give_the_defaults);
    RUN_TEST(a_value_out_of_its_limits_is_not_used);
    RUN_TEST(a_set_of_another_table_is_not_used_but_kept);
    RUN_TEST(a_count_that_does_not_fit_the_table_or_the_bank_is_rot);
    RUN_TEST(a_memory_that_does_not_take_words_is_told);
    RUN_TEST(a_memory_that_is_always_busy_does_not_hold_the_start);
    RUN_TEST(a_word_that_changes_after_its_check_is_not_used);
    return UNITY_END();
}
