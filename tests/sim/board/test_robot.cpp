/* The whole robot on the virtual board, as main.c runs it: commands come in by the SCI, wheels turn
 * by the PWM pins, parameters rest in the EEPROM. */
#include <cmath>

#include "tests/sim/board/bench.h"
/* Names first. */
#include "firmware/robot.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

extern "C" void setUp() {}
extern "C" void tearDown() {}

static constexpr std::uint16_t kIdentify = 0x01, kVelocity = 0x10, kArm = 0x18, kClear = 0x1A,
                               kSet = 0x28, kSave = 0x29;

/* Four motors with a flywheel at 24 V: W' = (941 rad/s * duty - W) / 0.2 s. */
struct Wheels : Bench {
    static constexpr double kFree_rad_s = 941.0, kTime_s = 0.2, kCountsPerRad = 2000 / (2 * M_PI);
    robot r;
    std::array<double, 4> applied = {}, speed = {};
    BoardTime at = 0;
    std::uint16_t sequence = 0;

    Wheels() {
        hal_host_attach(&board_hal());
        power_up();
    }
    ~Wheels() override {
        hal_host_attach(nullptr);
    }

    void power_up() {
        board_start();
        robot_init(&r);
        board_run();
    }

    void run_to(BoardTime now) {
        const double t = static_cast<double>(now - at) * kBoardTime_s;
        at = now;
        for (std::size_t i = 0; i < 4; ++i) {
            const double free = kFree_rad_s * applied[i];
            const double left = std::exp(-t / kTime_s);
            counts[i] += kCountsPerRad * (free * t + (speed[i] - free) * kTime_s * (1.0 - left));
            speed[i] = free + (speed[i] - free) * left;
        }
    }
    void drive(const std::array<double, 4> &duty, BoardTime now) override {
        run_to(now);
        applied = duty;
        Bench::drive(duty, now);
    }
    double analog_v(int channel, BoardTime now) override {
        run_to(now);
        if (channel > 3)
            return Bench::analog_v(channel, now);
        const auto i = static_cast<std::size_t>(channel);
        const double current_a = 40.0 * (applied[i] - speed[i] / kFree_rad_s);
        return 1.65 + current_a / (0.064 * 1024) * 3.3;
    }
    std::array<double, 4> encoder_counts(BoardTime now) override {
        run_to(now);
        return counts;
    }

    void run(double ms) {
        run_ms(ms, [this] { robot_tick(&r); });
    }

    void send(std::uint16_t code, const std::vector<std::uint16_t> &fields = {}) {
        frame_writer frame;
        frame_begin(&frame);
        frame_add_u8(&frame, LINK_VERSION);
        frame_add_u8(&frame, code);
        frame_add_u8(&frame, ++sequence & 0xFF);
        for (const std::uint16_t field : fields)
            frame_add_u8(&frame, field);
        frame_finish(&frame);
        board.serial().send({frame.byte, frame.byte + frame.length});
    }

    /* Sends, and returns the result of the answer; -1 when none comes within 20 ms. */
    int ask(std::uint16_t code, const std::vector<std::uint16_t> &fields = {}) {
        board.serial().take_received();
        send(code, fields);
        run(20);
        frame_reader reader;
        frame_reader_reset(&reader);
        for (const std::uint8_t byte : board.serial().take_received()) {
            if (frame_receive(&reader, byte) == FRAME_WHOLE && reader.byte[1] == LINK_ANSWER &&
                reader.byte[3] == code)
                return reader.byte[4];
        }
        return -1;
    }

    bool accepted(std::uint16_t code, const std::vector<std::uint16_t> &fields = {}) {
        return ask(code, fields) == LINK_RESULT_ACCEPTED;
    }

    /* 0.5 m/s ahead, repeated as a host does. */
    void go(int times) {
        for (int i = 0; i < times; ++i)
            TEST_ASSERT_TRUE(accepted(kVelocity, {0xF4, 0x01, 0, 0, 0, 0}));
    }

    /* Rested: no store is in the EEPROM of a new board, and that is a fault to be cleared. */
    void wake() {
        run(5);
        if (r.loop.telemetry.state == SUPERVISOR_STATE_FAULT) {
            TEST_ASSERT_TRUE(accepted(kClear));
        }
        TEST_ASSERT_EQUAL(SUPERVISOR_STATE_IDLE, r.loop.telemetry.state);
    }
};

static void commands_by_the_serial_line_turn_the_wheels(void) {
    Wheels wheels;
    TEST_ASSERT_TRUE(wheels.accepted(kIdentify));
    wheels.wake();
    TEST_ASSERT_TRUE(wheels.ask(kVelocity, {0xF4, 0x01, 0, 0, 0, 0}) > 0); /* not armed */
    TEST_ASSERT_TRUE(wheels.drives.empty() || wheels.duty()[0] == 0.0);
    TEST_ASSERT_TRUE(wheels.accepted(kArm));
    wheels.go(50);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_DRIVE, wheels.r.loop.telemetry.state);
    /* Rolling at 0.5 m/s along x: rims at 0.5 sin 30, shafts 240 times that. */
    const double shaft_rad_s = 0.25 * 240.0;
    for (std::size_t i = 0; i < 4; ++i)
        TEST_ASSERT_DOUBLE_WITHIN(0.1 * shaft_rad_s, i < 2 ? -shaft_rad_s : shaft_rad_s,
                                  wheels.speed[i]);
    TEST_ASSERT_EQUAL_UINT16(0, hal_read_tick_overruns());
    /* Silence: the command dies of age. */
    wheels.run(400);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, wheels.duty()[0]);
}

static void protection_is_a_fault_within_one_tick_and_can_be_cleared(void) {
    Wheels wheels;
    wheels.wake();
    TEST_ASSERT_TRUE(wheels.accepted(kArm));
    wheels.go(20);
    wheels.board.set_protection_pin(1, false);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, wheels.duty()[2]);
    TEST_ASSERT_TRUE(wheels.duty()[0] != 0.0);
    wheels.run(1.3);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, wheels.r.loop.telemetry.state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_BRIDGE, wheels.r.loop.telemetry.fault);
    TEST_ASSERT_EQUAL_UINT16(3, wheels.r.loop.telemetry.fault_wheel);
    for (const double duty : wheels.duty())
        TEST_ASSERT_EQUAL_DOUBLE(0.0, duty);
    wheels.board.set_protection_pin(1, true);
    wheels.run(1000); /* it does not come back by itself */
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, wheels.r.loop.telemetry.state);
    TEST_ASSERT_TRUE(wheels.accepted(kClear));
    TEST_ASSERT_TRUE(wheels.accepted(kArm));
    wheels.go(20);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_DRIVE, wheels.r.loop.telemetry.state);
    TEST_ASSERT_TRUE(wheels.duty()[2] != 0.0);
}

static void a_hanging_program_ends_as_watchdog_fault(void) {
    Wheels wheels;
    wheels.wake();
    TEST_ASSERT_TRUE(wheels.accepted(kArm));
    wheels.go(20);
    /* The loop of main.c stops; interrupts go on. */
    TEST_ASSERT_TRUE(resets([&] { wheels.run_ms(1000); }));
    wheels.board.reset(true);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, wheels.duty()[0]);
    wheels.power_up();
    wheels.run(5);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, wheels.r.loop.telemetry.state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_WATCHDOG, wheels.r.loop.telemetry.fault);
    TEST_ASSERT_FALSE(wheels.accepted(kArm));
    TEST_ASSERT_TRUE(wheels.accepted(kClear));
    TEST_ASSERT_TRUE(wheels.accepted(kArm));
}

static void a_tick_above_a_millisecond_is_a_fault(void) {
    Wheels wheels;
    wheels.wake();
    TEST_ASSERT_TRUE(wheels.accepted(kArm));
    wheels.board.set_compute_cycles(45000);
    wheels.run(10);
    TEST_ASSERT_EQUAL(SUPERVISOR_STATE_FAULT, wheels.r.loop.telemetry.state);
    TEST_ASSERT_EQUAL(SUPERVISOR_FAULT_OVERRUN, wheels.r.loop.telemetry.fault);
}

static std::int32_t gain(const robot &r) {
    std::int32_t value = 0;
    parameters_get(&r.settings, PARAMETER_ID_position_gain_q20, &value);
    return value;
}

/* position_gain is saved through SCI, SPI and EEPROM; power fails at any time of the save. */
static void parameters_survive_power_failure_during_a_save(void) {
    const std::uint16_t id = PARAMETER_ID_position_gain_q20;
    for (int cut_ms = 0; cut_ms <= 900; cut_ms += 60) {
        Wheels wheels;
        wheels.wake();
        TEST_ASSERT_TRUE(wheels.accepted(kSet, {id, 0xE8, 0x03}));
        TEST_ASSERT_TRUE(wheels.accepted(kSave));
        wheels.run(900);
        TEST_ASSERT_EQUAL(PARAMETER_STORE_SAVED, wheels.r.store.status);
        TEST_ASSERT_TRUE(wheels.accepted(kSet, {id, 0xD0, 0x07}));
        TEST_ASSERT_TRUE(wheels.accepted(kSave));
        wheels.run(cut_ms + 0.01 * cut_ms);
        wheels.board.eeprom().cut_power(static_cast<unsigned>(cut_ms));
        wheels.board.reset(false);
        wheels.power_up();
        TEST_ASSERT_TRUE(wheels.r.store.status == PARAMETER_STORE_LOADED ||
                         wheels.r.store.status == PARAMETER_STORE_LOADED_OLDER);
        TEST_ASSERT_TRUE(gain(wheels.r) == 1000 || gain(wheels.r) == 2000);
        if (cut_ms == 0) {
            TEST_ASSERT_EQUAL_INT32(1000, gain(wheels.r));
        } else if (cut_ms == 900) {
            TEST_ASSERT_EQUAL_INT32(2000, gain(wheels.r));
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(commands_by_the_serial_line_turn_the_wheels);
    RUN_TEST(protection_is_a_fault_within_one_tick_and_can_be_cleared);
    RUN_TEST(a_hanging_program_ends_as_watchdog_fault);
    RUN_TEST(a_tick_above_a_millisecond_is_a_fault);
    RUN_TEST(parameters_survive_power_failure_during_a_save);
    return UNITY_END();
}
