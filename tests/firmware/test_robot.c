/* The whole robot from power-on: start, watchdog, faults of the board, and a drive commanded,
 * watched and ended over the serial line alone. */
#include <unity.h>

#include "tests/firmware/reference.h"
#include "tests/firmware/robot_bench.h"

static robot_bench bench;

void setUp(void) {
    robot_bench_reset(&bench);
}
void tearDown(void) {
    TEST_ASSERT_EQUAL_UINT32(0, bench.overflowed);
    TEST_ASSERT_EQUAL_UINT32(0, bench.store.misuses);
}

static const control_loop_telemetry *seen(void) {
    return &bench.r.loop.telemetry;
}

/* ---- start ---- */

static void robot_comes_up_idle_with_the_power_stage_off(void) {
    robot_bench_start(&bench);
    robot_bench_ticks(&bench, 2);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, seen()->state);
    TEST_ASSERT_EQUAL_UINT16(0, bench.bridges_on);
    for (int i = 0; i < 4; i++)
        TEST_ASSERT_EQUAL_INT16(0, bench.duty_q15[i]);
    TEST_ASSERT_EQUAL_INT16(5120, PARAMETER_GET(&bench.r.settings, mass_q8));
    TEST_ASSERT_EQUAL_UINT32(2, bench.r.told.time_ms);
    for (int i = 0; i < 4; i++) {
        const u16 counters[] = {bench.r.told.counters.bad_frames, bench.r.told.counters.bytes_lost,
                                bench.r.told.counters.answers_lost,
                                bench.r.told.counters.samples_lost};
        TEST_ASSERT_EQUAL_UINT16(0, counters[i]);
        TEST_ASSERT_EQUAL_UINT32(0, bench.r.told.duty_sum_q15[i]);
    }
    for (int k = 0; k < TELEMETRY_STREAMS; k++)
        TEST_ASSERT_EQUAL_UINT16(0, bench.r.told.stream[k].period_ms);
}

static void watchdog_is_served_every_tick(void) {
    robot_bench_start(&bench);
    TEST_ASSERT_EQUAL_UINT32(0, bench.services);
    robot_bench_ticks(&bench, 500);
    TEST_ASSERT_EQUAL_UINT32(500, bench.services);
}

static void reset_by_the_watchdog_is_a_fault(void) {
    bench.reset_cause = HAL_RESET_WATCHDOG;
    robot_bench_start(&bench);
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, seen()->state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_WATCHDOG, seen()->fault);
    TEST_ASSERT_TRUE(control_loop_clear_fault(&bench.r.loop));
    robot_bench_ticks(&bench, 10);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, seen()->state);
}

static void store_without_a_whole_set_is_a_fault(void) {
    bench.store.word[0] = 7;
    robot_bench_start(&bench);
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, seen()->state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_STORE, seen()->fault);
    TEST_ASSERT_EQUAL_INT16(5120, PARAMETER_GET(&bench.r.settings, mass_q8));
}

static void set_of_another_table_is_a_fault(void) {
    robot_bench_start(&bench);
    parameter_store_save(&bench.r.store);
    robot_bench_ticks(&bench, 2000);
    TEST_ASSERT_EQUAL(PARAMETER_STORE_SAVED, bench.r.store.status);
    uint16_t *word = bench.store.word + bench.r.store.current * PARAMETER_STORE_BANK_WORDS;
    u16 crc = FRAME_CRC_START;
    word[2]++;
    for (int at = 1; at < 4 + PARAMETER_COUNT; at++)
        crc = frame_crc_u16(crc, word[at]);
    word[4 + PARAMETER_COUNT] = crc;
    robot_bench_start(&bench);
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(PARAMETER_STORE_OTHER_TABLE, bench.r.store.status);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_STORE, seen()->fault);
}

static void an_overrun_is_a_fault_and_zero_duty_in_the_same_tick(void) {
    robot_bench_start(&bench);
    robot_bench_tick(&bench);
    control_loop_arm(&bench.r.loop);
    control_loop_command_velocity(&bench.r.loop, 800, 0, 0);
    robot_bench_ticks(&bench, 50);
    TEST_ASSERT_NOT_EQUAL(0, bench.duty_q15[0]);
    bench.overruns = 1;
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_OVERRUN, seen()->fault);
    for (int i = 0; i < 4; i++)
        TEST_ASSERT_EQUAL_INT16(0, bench.duty_q15[i]);
}

/* ---- the line alone ---- */

static void noise_on_the_line_does_nothing_for_a_minute(void) {
    uint64_t seed = 1;
    robot_bench_start(&bench);
    for (u32 n = 0; n < REFERENCE_CASES(60000); n++) {
        uint16_t noise[12];
        for (int i = 0; i < 12; i++)
            noise[i] = reference_random(&seed) & 0xFF;
        robot_bench_send(&bench, noise, 12);
        robot_bench_tick(&bench);
    }
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, seen()->state);
    TEST_ASSERT_EQUAL_UINT16(0, bench.bridges_on);
}

/* A flood of bytes is worked off 16 a tick; nothing is skipped. */
static void a_flood_is_worked_off_in_its_order(void) {
    static const uint16_t get_first[] = {LINK_VERSION, 0x02, 0, 0};
    u16 content[FRAME_CONTENT_MAX];
    robot_bench_start(&bench);
    robot_bench_ticks(&bench, 20);
    while (robot_bench_receive(&bench, content) >= 0)
        continue;
    for (int n = 0; n < 100; n++)
        robot_bench_send_content(&bench, get_first, 4);
    const size_t bytes = bench.to_robot_in;
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL_INT(16, bench.to_robot_out);
    robot_bench_ticks(&bench, (int)(bytes / 16) + 40);
    TEST_ASSERT_EQUAL_INT(bytes, bench.to_robot_out);
    int answers = 0;
    while (robot_bench_receive(&bench, content) >= 0)
        answers += content[1] == LINK_ANSWER;
    TEST_ASSERT_EQUAL_INT(100, answers + bench.r.told.counters.answers_lost);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(robot_comes_up_idle_with_the_power_stage_off);
    RUN_TEST(watchdog_is_served_every_tick);
    RUN_TEST(reset_by_the_watchdog_is_a_fault);
    RUN_TEST(store_without_a_whole_set_is_a_fault);
    RUN_TEST(set_of_another_table_is_a_fault);
    RUN_TEST(an_overrun_is_a_fault_and_zero_duty_in_the_same_tick);
    RUN_TEST(noise_on_the_line_does_nothing_for_a_minute);
    RUN_TEST(a_flood_is_worked_off_in_its_order);
    return UNITY_END();
}
