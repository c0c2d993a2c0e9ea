/* The protocol, spoken over the bench's serial line with a whole robot behind it. */
#include <stdlib.h>
#include <string.h>
#include <unity.h>

#include "tests/firmware/reference.h"
#include "tests/firmware/robot_bench.h"

#define REQUEST(name, code, bytes, more, fields, answer, description) \
    CODE_##name = (code), BYTES_##name = (bytes), MORE_##name = (more),
enum {
#include "firmware/messages.def"
    CODE_NONE
};
#define EVENT(name, code, fields, description) EVENT_##name = (code),
enum {
#include "firmware/messages.def"
    EVENT_NONE = 0
};

static robot_bench bench;
static u16 sequence;
/* The frame that was last waited for. */
static u16 content[FRAME_CONTENT_MAX];
static int length;
/* Request under construction. */
static u16 asked[FRAME_CONTENT_MAX];
static size_t asked_bytes;

/* ---- helpers ---- */

static void begin(u16 code) {
    asked[0] = LINK_VERSION;
    asked[1] = code;
    asked[2] = sequence;
    asked_bytes = 3;
}
static void add_u8(u16 value) {
    asked[asked_bytes++] = value & 0xFF;
}
static void add_u16(int value) {
    add_u8((u16)value);
    add_u8((u16)((unsigned)value >> 8));
}
static void add_u32(i32 value) {
    add_u16((int)((u32)value & 0xFFFF));
    add_u16((int)((u32)value >> 16));
}

/* Drops frames until one of this kind. */
static int take(u16 kind) {
    do {
        length = robot_bench_receive(&bench, content);
    } while (length >= 0 && content[1] != kind);
    return length >= 0;
}

/* Drops what the robot has sent so far. */
static void skip(void) {
    while (robot_bench_receive(&bench, content) >= 0)
        continue;
}

/* Ticks until the robot has sent a frame of this kind; at most `ticks`. */
static int wait_for(u16 kind, int ticks) {
    while (!take(kind)) {
        if (ticks-- == 0)
            return 0;
        robot_bench_tick(&bench);
    }
    return 1;
}

static link_result answered(void) {
    TEST_ASSERT_TRUE_MESSAGE(wait_for(LINK_ANSWER, 30), "no answer");
    TEST_ASSERT_EQUAL_HEX16(LINK_VERSION, content[0]);
    TEST_ASSERT_EQUAL_HEX16(asked[2], content[2]);
    TEST_ASSERT_EQUAL_HEX16(asked[1], content[3]);
    TEST_ASSERT_TRUE(content[4] == LINK_RESULT_ACCEPTED || length == 5);
    return (link_result)content[4];
}

/* Sends what was built, once more if repeated, and returns the result. */
static link_result send_again(void) {
    robot_bench_send_content(&bench, asked, asked_bytes);
    return answered();
}
static link_result send(void) {
    const link_result result = send_again();
    sequence = (sequence + 1) & 0xFF;
    return result;
}
static link_result ask(u16 code) {
    begin(code);
    return send();
}
static link_result ask_velocity(int x_mm_s) {
    begin(CODE_velocity);
    add_u16(x_mm_s);
    add_u16(0);
    add_u16(0);
    return send();
}
static link_result ask_set(u16 id, int value) {
    begin(CODE_parameter_set);
    add_u8(id);
    add_u16(value);
    return send();
}
static link_result ask_stream(u16 stream, u16 period_ms, const u16 *signal, int signals) {
    begin(CODE_stream);
    add_u8(stream);
    add_u16(period_ms);
    for (int i = 0; i < signals; i++)
        add_u8(signal[i]);
    return send();
}

static i16 value_of(u16 id) {
    return bench.r.settings.value[id];
}
static supervisor_state state(void) {
    return bench.r.loop.telemetry.state;
}
static int moving(void) {
    return bench.duty_q15[0] || bench.duty_q15[1] || bench.duty_q15[2] || bench.duty_q15[3];
}

static void drive(void) {
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_arm));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_velocity(800));
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_DRIVE, state());
}

void setUp(void) {
    sequence = 40;
    robot_bench_reset(&bench);
    robot_bench_start(&bench);
    robot_bench_tick(&bench);
}
void tearDown(void) {
    TEST_ASSERT_EQUAL_UINT32(0, bench.overflowed);
    TEST_ASSERT_EQUAL_UINT32(0, bench.store.misuses);
}

/* ---- reading ---- */

static void identify_tells_tables_and_start(void) {
    robot_bench_ticks(&bench, 299);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_identify));
    TEST_ASSERT_EQUAL_INT(5 + 12, length);
    TEST_ASSERT_EQUAL_UINT16(PARAMETER_COUNT, content[5]);
    TEST_ASSERT_EQUAL_HEX16(parameters_fingerprint(), frame_u16(content + 6));
    TEST_ASSERT_EQUAL_UINT16(SIGNAL_COUNT, content[8]);
    TEST_ASSERT_EQUAL_HEX16(bench.r.told.table, frame_u16(content + 9));
    TEST_ASSERT_EQUAL_UINT16(HAL_RESET_POWER_ON, content[11]);
    TEST_ASSERT_EQUAL_UINT16(PARAMETER_STORE_BLANK, content[12]);
    TEST_ASSERT_EQUAL_UINT32(300, frame_u32(content + 13));
}

static void fingerprints_are_those_of_the_tables(void) {
    static const u16 signals[][4] = {
#define SIGNAL(name, type, unit, q_bits, expression, description) \
    {sizeof #name - 1, sizeof #unit - 1, sizeof(type), q_bits},
#include "firmware/telemetry.def"
#undef SIGNAL
    };
    static const struct {
        u16 name_length, unit_length;
        i16 number[4];
    } values[] = {
#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) \
    {sizeof #name - 1, sizeof #unit - 1, {q_bits, minimum, maximum, initial}},
#include "firmware/parameters.def"
#undef PARAMETER
    };
    u16 crc = FRAME_CRC_START;
    for (int i = 0; i < SIGNAL_COUNT; i++) {
        for (int k = 0; k < 4; k++)
            crc = frame_crc(crc, signals[i][k]);
    }
    TEST_ASSERT_EQUAL_HEX16(crc, bench.r.told.table);
    crc = FRAME_CRC_START;
    for (int i = 0; i < PARAMETER_COUNT; i++) {
        crc = frame_crc(frame_crc(crc, values[i].name_length), values[i].unit_length);
        for (int k = 0; k < 4; k++)
            crc = frame_crc_u16(crc, (u16)values[i].number[k]);
    }
    TEST_ASSERT_EQUAL_HEX16(crc, parameters_fingerprint());
}

static void every_parameter_is_described_and_read(void) {
    parameter_info info;
    for (u16 id = 0; id < PARAMETER_COUNT; id++) {
        begin(CODE_parameter_describe);
        add_u8(id);
        TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send());
        parameters_describe(id, &info);
        TEST_ASSERT_EQUAL_INT(5 + 10, length);
        TEST_ASSERT_EQUAL_INT16(value_of(id), frame_i16(content + 5));
        TEST_ASSERT_EQUAL_INT16(info.minimum, frame_i16(content + 7));
        TEST_ASSERT_EQUAL_INT16(info.maximum, frame_i16(content + 9));
        TEST_ASSERT_EQUAL_INT16(info.initial, frame_i16(content + 11));
        TEST_ASSERT_EQUAL_UINT16(info.q_bits, content[13]);
        TEST_ASSERT_EQUAL_UINT16(id >= PARAMETER_FIRST_TUNABLE, content[14]);
        begin(CODE_parameter_get);
        add_u8(id);
        TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send());
        TEST_ASSERT_EQUAL_INT16(value_of(id), frame_i16(content + 5));
    }
}

static void unknown_ids_are_refused(void) {
    static const u16 codes[] = {CODE_parameter_get, CODE_parameter_describe};
    for (int k = 0; k < 2; k++) {
        for (u16 id = PARAMETER_COUNT; id < 256; id++) {
            begin(codes[k]);
            add_u8(id);
            TEST_ASSERT_EQUAL(LINK_RESULT_ID, send());
        }
    }
    TEST_ASSERT_EQUAL(LINK_RESULT_ID, ask_set(PARAMETER_COUNT, 0));
    TEST_ASSERT_EQUAL(LINK_RESULT_ID, ask_set(255, 0));
}

/* ---- the form of requests ---- */

static void only_known_codes_with_their_lengths_are_carried_out(void) {
    static const struct {
        u16 code, bytes, more;
    } table[] = {
#define REQUEST(name, code, bytes, more, fields, answer, description) {code, bytes, more},
#include "firmware/messages.def"
    };
    static u16 known[256];
    for (size_t k = 0; k < sizeof table / sizeof *table; k++) {
        known[table[k].code] = 1;
        for (u16 bytes = 0; bytes <= FRAME_RECEIVE_MAX - LINK_HEADER_BYTES; bytes++) {
            const int fits = bytes >= table[k].bytes && bytes <= table[k].bytes + table[k].more;
            begin(table[k].code);
            for (u16 i = 0; i < bytes; i++)
                add_u8(0);
            const link_result result = send();
            TEST_ASSERT_TRUE((result != LINK_RESULT_LENGTH) == fits);
            while (parameter_store_at_work(&bench.r.store))
                robot_bench_tick(&bench);
        }
    }
    for (u16 code = 0; code < 256; code++) {
        if (!known[code])
            TEST_ASSERT_EQUAL(LINK_RESULT_UNKNOWN, ask(code));
    }
}

static void another_version_is_answered_but_not_carried_out(void) {
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_arm));
    begin(CODE_disarm);
    asked[0] = LINK_VERSION + 1;
    TEST_ASSERT_EQUAL(LINK_RESULT_VERSION, send());
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, state());
}

static void a_frame_without_a_header_is_not_answered(void) {
    static const u16 short_ones[] = {LINK_VERSION, CODE_stop};
    robot_bench_send_content(&bench, short_ones, 1);
    robot_bench_send_content(&bench, short_ones, 2);
    TEST_ASSERT_FALSE(wait_for(LINK_ANSWER, 10));
    TEST_ASSERT_EQUAL_UINT16(2, bench.r.told.counters.bad_frames);
}

/* ---- driving ---- */

static void nothing_drives_before_it_is_armed(void) {
    TEST_ASSERT_EQUAL(LINK_RESULT_STATE, ask_velocity(500));
    begin(CODE_duty);
    for (int i = 0; i < 4; i++)
        add_u16(9000);
    TEST_ASSERT_EQUAL(LINK_RESULT_STATE, send());
    begin(CODE_pose);
    for (int i = 0; i < 3; i++)
        add_u32(8192000);
    for (int i = 0; i < 3; i++)
        add_u16(0);
    TEST_ASSERT_EQUAL(LINK_RESULT_STATE, send());
    robot_bench_ticks(&bench, 50);
    TEST_ASSERT_FALSE(moving());
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_arm));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_velocity(500));
    robot_bench_ticks(&bench, 50);
    TEST_ASSERT_TRUE(moving());
}

static void velocity_reaches_the_loop_in_its_units(void) {
    ask(CODE_arm);
    begin(CODE_velocity);
    add_u16(1000);
    add_u16(-2000);
    add_u16(-3000);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send());
    TEST_ASSERT_EQUAL_INT16(8192, bench.r.loop.command_velocity.x_m_s_q13);
    TEST_ASSERT_EQUAL_INT16(-16384, bench.r.loop.command_velocity.y_m_s_q13);
    TEST_ASSERT_EQUAL_INT16(-6144, bench.r.loop.command_velocity.omega_rad_s_q11);
}

static void ask_pose(i32 x_mm_q13, i32 theta_mrad_q13) {
    begin(CODE_pose);
    add_u32(x_mm_q13);
    add_u32(-819200);
    add_u32(theta_mrad_q13);
    add_u16(100);
    add_u16(-200);
    add_u16(300);
}

static void pose_reaches_the_loop_in_its_units(void) {
    const i32 pi_q13 = ODOMETRY_FULL_TURN_MRAD_Q13 / 2;
    ask(CODE_arm);
    ask_pose(4096000, -pi_q13);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send());
    TEST_ASSERT_EQUAL(CONTROL_MODE_POSE, bench.r.loop.telemetry.mode);
    TEST_ASSERT_EQUAL_INT32(4096000, bench.r.loop.command_pose.x_mm_q13);
    TEST_ASSERT_EQUAL_INT32(-819200, bench.r.loop.command_pose.y_mm_q13);
    TEST_ASSERT_EQUAL_INT32(-pi_q13, bench.r.loop.command_pose.theta_mrad_q13);
    TEST_ASSERT_EQUAL_INT16(100, bench.r.loop.command_arrival.x_m_s_q13);
    TEST_ASSERT_EQUAL_INT16(-200, bench.r.loop.command_arrival.y_m_s_q13);
    TEST_ASSERT_EQUAL_INT16(300, bench.r.loop.command_arrival.omega_rad_s_q11);
    ask_pose(0, pi_q13 + 1);
    TEST_ASSERT_EQUAL(LINK_RESULT_RANGE, send());
    ask_pose(0, I32_MIN);
    TEST_ASSERT_EQUAL(LINK_RESULT_RANGE, send());
    ask_pose(I32_MAX, 0);
    TEST_ASSERT_EQUAL(LINK_RESULT_TOO_FAR, send());
    TEST_ASSERT_EQUAL_INT32(4096000, bench.r.loop.command_pose.x_mm_q13);
}

static void duty_reaches_the_bridges(void) {
    static const i16 duty_q15[4] = {1000, -2000, 3000, -4000};
    ask(CODE_arm);
    begin(CODE_duty);
    for (int i = 0; i < 4; i++)
        add_u16(duty_q15[i]);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send());
    TEST_ASSERT_EQUAL_INT16_ARRAY(duty_q15, bench.duty_q15, 4);
}

static void stop_and_disarm_end_the_drive(void) {
    drive();
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_stop));
    TEST_ASSERT_FALSE(moving());
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, state());
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_velocity(500));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_disarm));
    TEST_ASSERT_FALSE(moving());
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, state());
    TEST_ASSERT_EQUAL_UINT16(0, bench.bridges_on);
}

static void a_fault_is_left_on_request(void) {
    drive();
    bench.overruns = 1;
    robot_bench_tick(&bench);
    TEST_ASSERT_FALSE(moving());
    TEST_ASSERT_EQUAL(LINK_RESULT_STATE, ask_velocity(500));
    TEST_ASSERT_EQUAL(LINK_RESULT_STATE, ask(CODE_arm));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_clear_fault));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_arm));
}

static void outside_pose_corrects_a_robot_that_stands(void) {
    begin(CODE_outside_pose);
    add_u32(1234L * 8192);
    add_u32(-77L * 8192);
    add_u32(500L * 8192);
    add_u16(30);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send());
    const odometry_pose *pose = &bench.r.loop.telemetry.pose;
    const double share = PARAMETER_GET(&bench.r.settings, outside_pose_gain_q15) / 32768.0;
    TEST_ASSERT_TRUE(share > 0.0);
    TEST_ASSERT_TRUE(pose->x_mm_q13 > 0 && pose->y_mm_q13 < 0 && pose->theta_mrad_q13 > 0);
    asked[15] = 0xFF; /* an age below zero */
    asked[16] = 0xFF;
    TEST_ASSERT_EQUAL(LINK_RESULT_RANGE, send());
    begin(CODE_outside_pose);
    add_u32(0);
    add_u32(0);
    add_u32(I32_MAX);
    add_u16(30);
    TEST_ASSERT_EQUAL(LINK_RESULT_RANGE, send());
}

/* ---- damage and repetition ---- */

/* Armed, and the velocity frame with any one byte changed: no wheel turns. */
static void a_damaged_command_does_not_move_the_robot(void) {
    frame_writer frame;
    uint64_t seed = 1;
    ask(CODE_arm);
    begin(CODE_velocity);
    add_u16(800);
    add_u16(100);
    add_u16(0);
    for (int n = 0; n < REFERENCE_CASES(5000); n++) {
        frame_begin(&frame);
        for (size_t i = 0; i < asked_bytes; i++)
            frame_add_u8(&frame, asked[i]);
        frame_finish(&frame);
        frame.byte[reference_random(&seed) % frame.length] ^= 1u + reference_random(&seed) % 255u;
        robot_bench_send(&bench, frame.byte, frame.length);
        robot_bench_tick(&bench);
        TEST_ASSERT_FALSE(moving());
        TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, state());
    }
    TEST_ASSERT_FALSE(take(LINK_ANSWER));
    TEST_ASSERT_TRUE(bench.r.told.counters.bad_frames > REFERENCE_CASES(4000));
    robot_bench_send(&bench, (const uint16_t[]){0}, 1); /* ends what the last one may have left */
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_velocity(800));
}

static void half_a_command_does_not_move_the_robot(void) {
    frame_writer frame;
    ask(CODE_arm);
    begin(CODE_velocity);
    for (int i = 0; i < 3; i++)
        add_u16(700);
    frame_begin(&frame);
    for (size_t i = 0; i < asked_bytes; i++)
        frame_add_u8(&frame, asked[i]);
    frame_finish(&frame);
    for (u16 i = 0; i + 1 < frame.length; i++) {
        robot_bench_send(&bench, frame.byte + i, 1);
        robot_bench_ticks(&bench, 3);
        TEST_ASSERT_FALSE(moving());
    }
    robot_bench_send(&bench, frame.byte + frame.length - 1, 1);
    robot_bench_tick(&bench);
    TEST_ASSERT_TRUE(moving());
}

static void a_repetition_is_answered_but_not_carried_out(void) {
    bench.overruns = 1;
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, state());
    begin(CODE_clear_fault);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send_again());
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, state());
    bench.overruns = 1;
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send_again());
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, state());
    asked[2]++; /* a new request */
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send_again());
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, state());
}

static void a_repetition_of_a_refusal_is_refused_again(void) {
    begin(CODE_velocity);
    for (int i = 0; i < 3; i++)
        add_u16(700);
    TEST_ASSERT_EQUAL(LINK_RESULT_STATE, send_again());
    control_loop_arm(&bench.r.loop);
    TEST_ASSERT_EQUAL(LINK_RESULT_STATE, send_again());
    TEST_ASSERT_FALSE(moving());
}

static void the_same_sequence_with_other_content_is_a_new_request(void) {
    const u16 same = sequence;
    ask(CODE_arm);
    sequence = same;
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_velocity(300));
    TEST_ASSERT_TRUE(moving());
}

static void a_new_host_is_not_taken_for_the_old_one(void) {
    const u16 same = sequence;
    ask(CODE_arm);
    bench.overruns = 1;
    robot_bench_tick(&bench);
    ask(CODE_clear_fault);
    ask(CODE_identify);
    sequence = (u16)(same + 1);
    bench.overruns = 1;
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_clear_fault));
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, state());
}

static void a_repeated_command_does_not_stay_alive(void) {
    ask(CODE_arm);
    begin(CODE_velocity);
    for (int i = 0; i < 3; i++)
        add_u16(200);
    for (int n = 0; n < 210; n++) {
        if (n % 20 == 0)
            TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, send_again());
        robot_bench_tick(&bench);
    }
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, state());
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_COMMAND_TIMEOUT, bench.r.loop.telemetry.fault);
}

static void reading_is_repeated_with_present_values(void) {
    begin(CODE_parameter_get);
    add_u8(PARAMETER_ID_speed_gain_q15);
    send_again();
    TEST_ASSERT_EQUAL_INT16(value_of(PARAMETER_ID_speed_gain_q15), frame_i16(content + 5));
    bench.r.settings.value[PARAMETER_ID_speed_gain_q15] = 77;
    send_again();
    TEST_ASSERT_EQUAL_INT16(77, frame_i16(content + 5));
}

/* ---- parameters ---- */

static void parameters_are_set_within_their_limits(void) {
    parameter_info info;
    for (u16 id = 0; id < PARAMETER_COUNT; id++) {
        parameters_describe(id, &info);
        TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_set(id, info.minimum));
        TEST_ASSERT_EQUAL_INT16(info.minimum, value_of(id));
        TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_set(id, info.maximum));
        TEST_ASSERT_EQUAL_INT16(info.maximum, value_of(id));
        TEST_ASSERT_EQUAL(LINK_RESULT_RANGE, ask_set(id, info.minimum - 1));
        TEST_ASSERT_EQUAL_INT16(info.maximum, value_of(id));
    }
}

static void while_driving_gains_change_and_the_robot_does_not(void) {
    parameter_info info;
    for (u16 id = 0; id < PARAMETER_COUNT; id++) {
        setUp();
        drive();
        parameters_describe(id, &info);
        TEST_ASSERT_EQUAL(id < PARAMETER_FIRST_TUNABLE ? LINK_RESULT_DRIVING : LINK_RESULT_ACCEPTED,
                          ask_set(id, info.initial));
    }
    TEST_ASSERT_EQUAL(LINK_RESULT_DRIVING, ask(CODE_parameters_default));
    TEST_ASSERT_EQUAL(LINK_RESULT_DRIVING, ask(CODE_parameters_load));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_stop));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_set(PARAMETER_ID_mass_q8, 6000));
}

static void wait_for_store(void) {
    int ticks = 0;
    while (parameter_store_at_work(&bench.r.store)) {
        robot_bench_tick(&bench);
        TEST_ASSERT_TRUE(++ticks < 3000);
    }
}

static void saved_parameters_survive_a_restart(void) {
    ask_set(PARAMETER_ID_mass_q8, 6000);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_parameters_save));
    TEST_ASSERT_EQUAL(LINK_RESULT_BUSY, ask_set(PARAMETER_ID_mass_q8, 7000));
    TEST_ASSERT_EQUAL(LINK_RESULT_BUSY, ask(CODE_parameters_save));
    TEST_ASSERT_EQUAL(LINK_RESULT_BUSY, ask(CODE_parameters_load));
    TEST_ASSERT_EQUAL(LINK_RESULT_BUSY, ask(CODE_parameters_default));
    wait_for_store();
    TEST_ASSERT_EQUAL(PARAMETER_STORE_SAVED, bench.r.store.status);
    ask_set(PARAMETER_ID_mass_q8, 7000);
    robot_bench_start(&bench);
    TEST_ASSERT_EQUAL(PARAMETER_STORE_LOADED, bench.r.store.status);
    TEST_ASSERT_EQUAL_INT16(6000, value_of(PARAMETER_ID_mass_q8));
}

static void a_save_does_not_stop_a_drive(void) {
    drive();
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_parameters_save));
    while (parameter_store_at_work(&bench.r.store)) {
        TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_velocity(800));
        robot_bench_ticks(&bench, 20);
        TEST_ASSERT_TRUE(moving());
    }
    TEST_ASSERT_EQUAL(PARAMETER_STORE_SAVED, bench.r.store.status);
}

static void nothing_starts_to_drive_during_a_load(void) {
    ask(CODE_arm);
    ask(CODE_parameters_save);
    wait_for_store();
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_parameters_load));
    TEST_ASSERT_EQUAL(LINK_RESULT_BUSY, ask_velocity(500));
    TEST_ASSERT_EQUAL(LINK_RESULT_BUSY, ask(CODE_arm));
    ask_pose(4096000, 0);
    TEST_ASSERT_EQUAL(LINK_RESULT_BUSY, send());
    begin(CODE_duty);
    for (int i = 0; i < 4; i++)
        add_u16(100);
    TEST_ASSERT_EQUAL(LINK_RESULT_BUSY, send());
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_stop));
    TEST_ASSERT_FALSE(moving());
    wait_for_store();
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_velocity(500));
}

static void defaults_come_back_on_request(void) {
    ask_set(PARAMETER_ID_mass_q8, 6000);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_parameters_default));
    TEST_ASSERT_EQUAL_INT16(5120, value_of(PARAMETER_ID_mass_q8));
}

/* ---- telemetry ---- */

static const u16 log_signals[] = {
    SIGNAL_ID_time_ms,        SIGNAL_ID_duty_sum_1_q15, SIGNAL_ID_duty_sum_2_q15,
    SIGNAL_ID_duty_sum_3_q15, SIGNAL_ID_duty_sum_4_q15, SIGNAL_ID_counts_1,
    SIGNAL_ID_counts_2,       SIGNAL_ID_counts_3,       SIGNAL_ID_counts_4,
    SIGNAL_ID_supply_mv,      SIGNAL_ID_current_1_ma,   SIGNAL_ID_current_2_ma,
    SIGNAL_ID_current_3_ma,   SIGNAL_ID_current_4_ma};
#define LOG_SIGNALS 14
#define LOG_BYTES 38

static void a_stream_carries_its_signals_at_its_period(void) {
    const u16 signals[] = {SIGNAL_ID_time_ms, SIGNAL_ID_supply_mv, SIGNAL_ID_pose_x_mm_q13,
                           SIGNAL_ID_store_status};
    u32 time_ms;
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_stream(1, 7, signals, 4));
    TEST_ASSERT_TRUE(wait_for(LINK_TELEMETRY + 1, 20));
    TEST_ASSERT_EQUAL_INT(3 + 12, length);
    TEST_ASSERT_EQUAL_UINT16(0, content[2]);
    TEST_ASSERT_EQUAL_UINT16(24000, frame_u16(content + 7));
    TEST_ASSERT_EQUAL_UINT16(PARAMETER_STORE_BLANK, frame_u16(content + 13));
    time_ms = frame_u32(content + 3);
    for (u16 n = 1; n < 600; n++) {
        TEST_ASSERT_TRUE(wait_for(LINK_TELEMETRY + 1, 20));
        TEST_ASSERT_EQUAL_UINT16(n & 0xFF, content[2]);
        TEST_ASSERT_EQUAL_UINT32(time_ms + 7u * n, frame_u32(content + 3));
    }
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_stream(1, 0, signals, 4));
    robot_bench_ticks(&bench, 20);
    skip();
    TEST_ASSERT_FALSE(wait_for(LINK_TELEMETRY + 1, 100));
}

/* The content of the next frame of stream 0 that telemetry_tick alone makes; its length. */
static u16 next_sample(frame_reader *reader) {
    for (int n = 0; n < 10; n++) {
        frame_status status = FRAME_PENDING;
        telemetry_tick(&bench.r.told);
        for (size_t i = 0; i < bench.waiting_bytes; i++)
            status = frame_receive(reader, bench.waiting[i]);
        bench.waiting_bytes = 0;
        if (status == FRAME_WHOLE && reader->byte[1] == LINK_TELEMETRY)
            return reader->length;
    }
    return 0;
}

/* Words first, first + 1, ... into all of an object. */
static void fill(void *object, size_t size, u16 first) {
    for (size_t at = 0; at < size; at += sizeof first, first++)
        memcpy((char *)object + at, &first, sizeof first);
}

/* Every word of the control loop's telemetry gets a value of its own, the counters theirs: each
 * signal then has its own value, in the bytes of its type. */
static void every_signal_is_a_field_of_its_own(void) {
    static const u16 bytes[] = {
#define SIGNAL(name, type, unit, q_bits, expression, description) sizeof(type),
#include "firmware/telemetry.def"
#undef SIGNAL
    };
    static u32 value[SIGNAL_COUNT];
    telemetry *told = &bench.r.told;
    frame_reader reader;
    frame_reader_reset(&reader);
    robot_bench_ticks(&bench, 20);
    fill(&bench.r.loop.telemetry, sizeof bench.r.loop.telemetry, 1000);
    fill(&told->counters, sizeof told->counters, 500);
    fill(told->duty_sum_q15, sizeof told->duty_sum_q15, 700);
    for (u16 id = 0; id < SIGNAL_COUNT; id++) {
        TEST_ASSERT_EQUAL(TELEMETRY_OK, telemetry_set_stream(told, 0, 1, &id, 1));
        TEST_ASSERT_EQUAL_UINT16(LINK_HEADER_BYTES + bytes[id], next_sample(&reader));
        value[id] = bytes[id] == 4 ? frame_u32(reader.byte + 3) : frame_u16(reader.byte + 3);
        for (u16 other = 0; other < id; other++)
            TEST_ASSERT_NOT_EQUAL(value[other], value[id]);
    }
}

static void a_stream_of_too_many_signals_is_refused(void) {
    static u16 signals[TELEMETRY_SIGNALS_MAX + 1];
    for (int i = 0; i <= TELEMETRY_SIGNALS_MAX; i++)
        signals[i] = SIGNAL_ID_mode;
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_stream(0, 10, signals, TELEMETRY_SIGNALS_MAX));
    TEST_ASSERT_EQUAL(TELEMETRY_TOO_LONG, telemetry_set_stream(&bench.r.told, 0, 1, signals,
                                                               TELEMETRY_SIGNALS_MAX + 1));
}

static void a_content_that_does_not_fit_is_not_sent(void) {
    frame_writer frame;
    frame_begin(&frame);
    for (int i = 0; i <= FRAME_CONTENT_MAX; i++)
        frame_add_u8(&frame, 1);
    bench.waiting_bytes = 0;
    TEST_ASSERT_EQUAL_UINT16(0, frame_send(&frame, 0));
    TEST_ASSERT_EQUAL_INT(0, bench.waiting_bytes);
}

static void a_frame_goes_out_when_it_just_leaves_the_space_asked_for(void) {
    frame_writer frame;
    frame_begin(&frame);
    frame_add_u8(&frame, 7);
    bench.waiting_bytes = BENCH_SEND_BUFFER - (1 + FRAME_OVERHEAD) - 9;
    TEST_ASSERT_EQUAL_UINT16(0, frame_send(&frame, 10));
    frame_begin(&frame);
    frame_add_u8(&frame, 7);
    TEST_ASSERT_EQUAL_UINT16(1, frame_send(&frame, 9));
    TEST_ASSERT_EQUAL_INT(BENCH_SEND_BUFFER - 9, bench.waiting_bytes);
}

/* A sample of the old stream that still waits for space is not sent as one of the new. */
static void a_new_stream_starts_with_a_whole_period(void) {
    const u16 signal = SIGNAL_ID_time_ms;
    bench.line_bytes_per_tick = 0.0;
    robot_bench_ticks(&bench, 100);
    telemetry_set_stream(&bench.r.told, 0, 1, &signal, 1);
    robot_bench_ticks(&bench, 100);
    TEST_ASSERT_EQUAL_UINT16(1, bench.r.told.stream[0].due);
    telemetry_set_stream(&bench.r.told, 0, 50, &signal, 1);
    TEST_ASSERT_EQUAL_UINT16(0, bench.r.told.stream[0].due);
    TEST_ASSERT_EQUAL_UINT16(0, bench.r.told.stream[0].age_ms);
}

static void negative_values_keep_their_sign(void) {
    const u16 signals[] = {SIGNAL_ID_duty_1_q15, SIGNAL_ID_pose_y_mm_q13};
    bench.r.loop.telemetry.pose.y_mm_q13 = -123456;
    ask(CODE_arm);
    ask_stream(0, 1, signals, 2);
    begin(CODE_duty);
    for (int i = 0; i < 4; i++)
        add_u16(-5000);
    send();
    skip();
    TEST_ASSERT_TRUE(wait_for(LINK_TELEMETRY, 20));
    TEST_ASSERT_EQUAL_INT16(-5000, frame_i16(content + 3));
    TEST_ASSERT_TRUE(frame_i32(content + 5) < -100000);
}

static void streams_that_cannot_be_are_refused_and_change_nothing(void) {
    const u16 one[] = {SIGNAL_ID_time_ms};
    const u16 unknown[] = {SIGNAL_ID_time_ms, SIGNAL_COUNT};
    u16 many[TELEMETRY_SIGNALS_MAX];
    for (int i = 0; i < TELEMETRY_SIGNALS_MAX; i++)
        many[i] = SIGNAL_ID_time_ms;
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_stream(0, 10, one, 1));
    TEST_ASSERT_EQUAL(LINK_RESULT_ID, ask_stream(TELEMETRY_STREAMS, 10, one, 1));
    TEST_ASSERT_EQUAL(LINK_RESULT_ID, ask_stream(255, 10, one, 1));
    TEST_ASSERT_EQUAL(LINK_RESULT_ID, ask_stream(0, 10, unknown, 2));
    /* 15 * 4 bytes and the header fit into 64, 16 * 4 do not */
    TEST_ASSERT_EQUAL(LINK_RESULT_TOO_LONG, ask_stream(0, 10, many, 16));
    TEST_ASSERT_EQUAL_UINT16(1, bench.r.told.stream[0].signals);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_stream(0, 10, many, 15));
    TEST_ASSERT_TRUE(wait_for(LINK_TELEMETRY, 30));
    TEST_ASSERT_EQUAL_INT(63, length);
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_stream(0, 10, one, 0));
    TEST_ASSERT_EQUAL_UINT16(0, bench.r.told.stream[0].period_ms);
}

/* Two rows of the stream against what the bridges got between them. */
static void the_log_stream_holds_the_mean_duty(void) {
    static i32 applied_q15[500]; /* sum of the duty of wheel 1 over all ticks before this one */
    u32 first_ms = 0, first_sum = 0;
    i32 sum_q15 = 0;
    int rows = 0;
    drive();
    ask_stream(0, 5, log_signals, LOG_SIGNALS);
    TEST_ASSERT_TRUE(wait_for(LINK_TELEMETRY, 20));
    skip();
    const u32 start_ms = bench.r.told.time_ms;
    for (int n = 0; n < 500; n++) {
        applied_q15[n] = sum_q15;
        if (n % 100 == 0) {
            begin(CODE_velocity);
            add_u16(n % 200 ? 900 : -900);
            add_u16(300);
            add_u16(0);
            robot_bench_send_content(&bench, asked, asked_bytes);
            sequence++;
        }
        robot_bench_tick(&bench);
        sum_q15 += bench.duty_q15[0];
        while (take(LINK_TELEMETRY)) {
            const u32 time_ms = frame_u32(content + 3), duty_sum = frame_u32(content + 7);
            if (time_ms < start_ms)
                continue;
            if (rows++ == 0) {
                first_ms = time_ms;
                first_sum = duty_sum;
            }
            TEST_ASSERT_EQUAL_INT32(
                applied_q15[time_ms - start_ms] - applied_q15[first_ms - start_ms],
                (i32)(duty_sum - first_sum));
        }
    }
    TEST_ASSERT_INT_WITHIN(4, 100, rows);
    TEST_ASSERT_TRUE(labs(applied_q15[300]) > 100000);
}

/* At 200 Hz, with a second stream and commands at 50 Hz, nothing is lost at 115200 baud. */
static void the_line_carries_a_log_at_200_hz_and_more(void) {
    const u16 pose[] = {SIGNAL_ID_time_ms, SIGNAL_ID_pose_x_mm_q13, SIGNAL_ID_pose_y_mm_q13,
                        SIGNAL_ID_pose_theta_mrad_q13, SIGNAL_ID_limit};
    u16 expected = 0;
    int rows = 0;
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask(CODE_arm));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_stream(0, 5, log_signals, LOG_SIGNALS));
    TEST_ASSERT_EQUAL(LINK_RESULT_ACCEPTED, ask_stream(1, 20, pose, 5));
    TEST_ASSERT_TRUE(wait_for(LINK_TELEMETRY, 20));
    TEST_ASSERT_EQUAL_INT(3 + LOG_BYTES, length);
    expected = content[2];
    for (int n = 0; n < 5000; n++) {
        if (n % 20 == 0) {
            begin(CODE_velocity);
            add_u16(500);
            add_u16(n % 400);
            add_u16(0);
            robot_bench_send_content(&bench, asked, asked_bytes);
            sequence = (sequence + 1) & 0xFF;
        }
        robot_bench_tick(&bench);
        while (take(LINK_TELEMETRY)) {
            expected = (expected + 1) & 0xFF;
            TEST_ASSERT_EQUAL_UINT16(expected, content[2]);
            rows++;
        }
    }
    TEST_ASSERT_INT_WITHIN(2, 1000, rows);
    TEST_ASSERT_EQUAL_UINT16(0, bench.r.told.counters.samples_lost);
    TEST_ASSERT_EQUAL_UINT16(0, bench.r.told.counters.answers_lost);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_DRIVE, state());
}

/* Three streams that want twice the line: answers come at once, losses are counted and visible. */
static void too_much_telemetry_is_lost_visibly_and_starves_no_answer(void) {
    u16 last[TELEMETRY_STREAMS], seen[TELEMETRY_STREAMS] = {0, 0, 0};
    u16 gaps = 0;
    for (u16 k = 0; k < TELEMETRY_STREAMS; k++)
        ask_stream(k, 5, log_signals, LOG_SIGNALS);
    for (int n = 0; n < 2000; n++) {
        if (n % 10 == 0) {
            begin(CODE_stop);
            robot_bench_send_content(&bench, asked, asked_bytes);
            sequence = (sequence + 1) & 0xFF;
        }
        robot_bench_tick(&bench);
        while ((length = robot_bench_receive(&bench, content)) >= 0) {
            if (content[1] < LINK_TELEMETRY)
                continue;
            const u16 k = content[1] - LINK_TELEMETRY;
            if (seen[k] > 0)
                gaps = (u16)(gaps + ((content[2] - last[k] - 1) & 0xFF));
            last[k] = content[2];
            seen[k]++;
        }
    }
    TEST_ASSERT_EQUAL_UINT16(0, bench.r.told.counters.answers_lost);
    TEST_ASSERT_TRUE(bench.r.told.counters.samples_lost > 300);
    /* what was lost before the first and after the last frame of a stream shows no gap */
    TEST_ASSERT_INT_WITHIN(2 * TELEMETRY_STREAMS, bench.r.told.counters.samples_lost, gaps);
    for (u16 k = 0; k < TELEMETRY_STREAMS; k++)
        TEST_ASSERT_INT_WITHIN(seen[0] / 3, seen[0], seen[k]);
}

/* The longest a host waits for an answer on a line full of telemetry. */
static void an_answer_waits_for_no_more_than_the_send_buffer(void) {
    for (u16 k = 0; k < TELEMETRY_STREAMS; k++)
        ask_stream(k, 1, log_signals, LOG_SIGNALS);
    robot_bench_ticks(&bench, 100);
    for (int n = 0; n < 200; n++) {
        int ticks = 0;
        skip();
        begin(CODE_stop);
        robot_bench_send_content(&bench, asked, asked_bytes);
        while (!take(LINK_ANSWER)) {
            robot_bench_tick(&bench);
            ticks++;
        }
        TEST_ASSERT_TRUE(ticks <= 1 + BENCH_SEND_BUFFER / 11 + 1);
        sequence = (sequence + 1) & 0xFF;
    }
}

static void a_dead_line_stops_neither_commands_nor_ticks(void) {
    bench.line_bytes_per_tick = 0.0;
    begin(CODE_stream);
    add_u8(0);
    add_u16(1);
    add_u8(SIGNAL_ID_time_ms);
    robot_bench_send_content(&bench, asked, asked_bytes);
    robot_bench_ticks(&bench, 100);
    sequence++;
    begin(CODE_arm);
    robot_bench_send_content(&bench, asked, asked_bytes);
    robot_bench_tick(&bench);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_ARMED, state());
    TEST_ASSERT_TRUE(bench.r.told.counters.samples_lost > 50);
}

static void lost_bytes_are_counted(void) {
    const u16 signals[] = {SIGNAL_ID_bad_frames, SIGNAL_ID_bytes_lost};
    static const uint16_t noise[] = {3, 7, 7, 0};
    bench.receive_lost = 3;
    robot_bench_tick(&bench);
    bench.receive_lost = 4;
    robot_bench_send(&bench, noise, 4);
    robot_bench_tick(&bench);
    ask_stream(2, 5, signals, 2);
    TEST_ASSERT_TRUE(wait_for(LINK_TELEMETRY + 2, 20));
    TEST_ASSERT_EQUAL_UINT16(1, frame_u16(content + 3));
    TEST_ASSERT_EQUAL_UINT16(7, frame_u16(content + 5));
}

/* ---- events ---- */

static int event_is(u16 code) {
    return wait_for(LINK_EVENT, 200) && content[3] == code;
}

static void start_is_told_first(void) {
    bench.reset_cause = HAL_RESET_WATCHDOG;
    robot_bench_ticks(&bench, 20);
    skip();
    robot_bench_start(&bench);
    TEST_ASSERT_TRUE(event_is(EVENT_boot));
    TEST_ASSERT_EQUAL_UINT16(0, content[2]);
    TEST_ASSERT_EQUAL_UINT32(0, frame_u32(content + 4));
    TEST_ASSERT_EQUAL_UINT16(HAL_RESET_WATCHDOG, content[8]);
    TEST_ASSERT_EQUAL_UINT16(PARAMETER_STORE_BLANK, content[9]);
    TEST_ASSERT_TRUE(event_is(EVENT_state));
    TEST_ASSERT_EQUAL_UINT16(1, content[2]);
    TEST_ASSERT_EQUAL_UINT16(SUPERVISOR_STATE_FAULT, content[8]);
    TEST_ASSERT_EQUAL_UINT16(SUPERVISOR_FAULT_WATCHDOG, content[9]);
}

static void changes_of_state_are_told(void) {
    robot_bench_ticks(&bench, 20);
    skip();
    begin(CODE_arm);
    robot_bench_send_content(&bench, asked, asked_bytes);
    TEST_ASSERT_TRUE(event_is(EVENT_state));
    TEST_ASSERT_EQUAL_UINT16(SUPERVISOR_STATE_ARMED, content[8]);
    TEST_ASSERT_FALSE(wait_for(LINK_EVENT, 100));
    bench.overruns = 1;
    TEST_ASSERT_TRUE(event_is(EVENT_state));
    TEST_ASSERT_EQUAL_UINT16(SUPERVISOR_STATE_FAULT, content[8]);
    TEST_ASSERT_EQUAL_UINT16(SUPERVISOR_FAULT_OVERRUN, content[9]);
    TEST_ASSERT_EQUAL_UINT16(0, content[10]);
}

static void the_end_of_a_save_is_told(void) {
    robot_bench_ticks(&bench, 20);
    skip();
    begin(CODE_parameters_save);
    robot_bench_send_content(&bench, asked, asked_bytes);
    TEST_ASSERT_TRUE(event_is(EVENT_store));
    TEST_ASSERT_EQUAL_UINT16(PARAMETER_STORE_SAVING, content[8]);
    TEST_ASSERT_TRUE(wait_for(LINK_EVENT, 2000));
    TEST_ASSERT_EQUAL_UINT16(EVENT_store, content[3]);
    TEST_ASSERT_EQUAL_UINT16(PARAMETER_STORE_SAVED, content[8]);
}

/* A limit that comes and goes every tick is told every 50 ms at most, the last one always. */
static void limits_are_told_but_not_too_often(void) {
    telemetry *told = &bench.r.told;
    int events = 0;
    robot_bench_ticks(&bench, 60);
    skip();
    for (u16 n = 0; n < 1000; n++) {
        bench.r.loop.telemetry.limit = n % 2 ? CONTROL_LIMIT_TRACTION : CONTROL_LIMIT_VOLTAGE;
        bench.r.loop.telemetry.limit_wheel = 3;
        telemetry_tick(told);
        bench.waiting_bytes = 0;
        events += told->limit_age_ms == 0;
    }
    TEST_ASSERT_INT_WITHIN(1, 1000 / 51, events);
    for (int n = 0; n < 60; n++)
        telemetry_tick(told);
    TEST_ASSERT_EQUAL_UINT16(CONTROL_LIMIT_TRACTION, told->limit_told[0]);
    TEST_ASSERT_EQUAL_UINT16(3, told->limit_told[1]);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(identify_tells_tables_and_start);
    RUN_TEST(fingerprints_are_those_of_the_tables);
    RUN_TEST(every_parameter_is_described_and_read);
    RUN_TEST(unknown_ids_are_refused);
    RUN_TEST(only_known_codes_with_their_lengths_are_carried_out);
    RUN_TEST(another_version_is_answered_but_not_carried_out);
    RUN_TEST(a_frame_without_a_header_is_not_answered);
    RUN_TEST(nothing_drives_before_it_is_armed);
    RUN_TEST(velocity_reaches_the_loop_in_its_units);
    RUN_TEST(pose_reaches_the_loop_in_its_units);
    RUN_TEST(duty_reaches_the_bridges);
    RUN_TEST(stop_and_disarm_end_the_drive);
    RUN_TEST(a_fault_is_left_on_request);
    RUN_TEST(outside_pose_corrects_a_robot_that_stands);
    RUN_TEST(a_damaged_command_does_not_move_the_robot);
    RUN_TEST(half_a_command_does_not_move_the_robot);
    RUN_TEST(a_repetition_is_answered_but_not_carried_out);
    RUN_TEST(a_repetition_of_a_refusal_is_refused_again);
    RUN_TEST(the_same_sequence_with_other_content_is_a_new_request);
    RUN_TEST(a_new_host_is_not_taken_for_the_old_one);
    RUN_TEST(a_repeated_command_does_not_stay_alive);
    RUN_TEST(reading_is_repeated_with_present_values);
    RUN_TEST(parameters_are_set_within_their_limits);
    RUN_TEST(while_driving_gains_change_and_the_robot_does_not);
    RUN_TEST(saved_parameters_survive_a_restart);
    RUN_TEST(a_save_does_not_stop_a_drive);
    RUN_TEST(nothing_starts_to_drive_during_a_load);
    RUN_TEST(defaults_come_back_on_request);
    RUN_TEST(a_stream_carries_its_signals_at_its_period);
    RUN_TEST(every_signal_is_a_field_of_its_own);
    RUN_TEST(a_stream_of_too_many_signals_is_refused);
    RUN_TEST(a_content_that_does_not_fit_is_not_sent);
    RUN_TEST(a_frame_goes_out_when_it_just_leaves_the_space_asked_for);
    RUN_TEST(a_new_stream_starts_with_a_whole_period);
    RUN_TEST(negative_values_keep_their_sign);
    RUN_TEST(streams_that_cannot_be_are_refused_and_change_nothing);
    RUN_TEST(the_log_stream_holds_the_mean_duty);
    RUN_TEST(the_line_carries_a_log_at_200_hz_and_more);
    RUN_TEST(too_much_telemetry_is_lost_visibly_and_starves_no_answer);
    RUN_TEST(an_answer_waits_for_no_more_than_the_send_buffer);
    RUN_TEST(a_dead_line_stops_neither_commands_nor_ticks);
    RUN_TEST(lost_bytes_are_counted);
    RUN_TEST(start_is_told_first);
    RUN_TEST(changes_of_state_are_told);
    RUN_TEST(the_end_of_a_save_is_told);
    RUN_TEST(limits_are_told_but_not_too_often);
    return UNITY_END();
}
