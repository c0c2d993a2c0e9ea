/* The drivers of hal/lf2407a on the virtual board. */
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>

#include "tests/sim/board/bench.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

extern "C" void setUp() {}
extern "C" void tearDown() {}

static double on_pins(std::int16_t duty_q15) {
    return std::round(duty_q15 * 2000.0 / 32768.0) / 2000.0;
}

static void write_duty(const std::array<std::int16_t, 4> &duty_q15) {
    hal_write_duty(duty_q15.data());
}

/* ---- start-up ---- */

struct Step {
    const char *name;
    std::uint16_t value;
    const char *rule = ""; /* of this write and those below it without one */
};

/* Every write from reset to the running tick, with the rule that puts it there. */
static const Step kStartUp[] = {
    {"WDCR", 0x00AF,
     "Watchdog first: out of reset it overflows within milliseconds. Check pattern 101, slowest"},
    {"WDKEY", 0x0055},
    {"WDKEY", 0x00AA},
    {"SCSR1", 0x00ED,
     "Clocks before any register of a peripheral: times 4, ADC SCI SPI EVB EVA; ILLADR cleared"},
    {"SCSR2", 0x000B, "Flash, SARAM as data, bus driven; the watchdog's override is not touched"},
    {"WSGR", 0x0050, "In I/O space: 2 wait states for data (CPLD), 1 for I/O, none for program"},
    {"IMR", 0x0000, "Not defined by reset: mask first, then flags"},
    {"IFR", 0x003F},
    {"T1CON", 0x0000,
     "EVA: stopped timer, period, units that never match, pins forced low; then the compare units "
     "with outputs still off; protection enabled; the timer last"},
    {"GPTCONA", 0x0000},
    {"T1CNT", 0x0000},
    {"T1PR", 0x07CF},
    {"CMPR1", 0x07D0},
    {"CMPR2", 0x07D0},
    {"ACTRA", 0x0000},
    {"DBTCONA", 0x0000},
    {"COMCONA", 0x8000},
    {"EVAIMRA", 0x0001},
    {"T1CON", 0x9040},
    {"T3CON", 0x0000, "EVB the same, half a period later"},
    {"GPTCONB", 0x0000},
    {"T3CNT", 0x03E8},
    {"T3PR", 0x07CF},
    {"CMPR4", 0x07D0},
    {"CMPR5", 0x07D0},
    {"ACTRB", 0x0000},
    {"DBTCONB", 0x0000},
    {"COMCONB", 0x8000},
    {"EVBIMRA", 0x0001},
    {"T3CON", 0x9040},
    {"CPLD LATCH", 0x0000, "CPLD: first positions"},
    {"ADCTRL1", 0x4000,
     "ADC: reset, window, five channels in order, sequencer reset and armed for EVA; T2 starts it"},
    {"ADCTRL1", 0x0100},
    {"MAXCONV", 0x0004},
    {"CHSELSEQ1", 0x3210},
    {"CHSELSEQ2", 0x0004},
    {"ADCTRL2", 0x4300},
    {"GPTCONA", 0x0600},
    {"SCICTL1", 0x0003,
     "SCI: held in reset while format and rate change, both interrupts at INT5, then released"},
    {"SCICCR", 0x0007},
    {"SCIHBAUD", 0x0000},
    {"SCILBAUD", 0x002A},
    {"SCICTL2", 0x0002},
    {"SCIPRI", 0x0060},
    {"SCICTL1", 0x0003},
    {"SCICTL1", 0x0023},
    {"PCDATDIR", 0x2020,
     "SPI: EEPROM deselected before anything moves; held in reset while the mode changes"},
    {"SPICCR", 0x0007},
    {"SPICTL", 0x000E},
    {"SPIBRR", 0x0013},
    {"SPICCR", 0x0087},
    {"MCRA", 0x03C3, "Pins last; MCRB keeps its emulator bits"},
    {"MCRB", 0xFE1C},
    {"MCRC", 0x001E},
    {"T2CON", 0x0000,
     "Tick: stopped timer, period and compare, flag cleared by its single bit, then enabled"},
    {"T2CNT", 0x0000},
    {"T2PR", 0x1387},
    {"T2CMPR", 0x1323},
    {"EVAIFRB", 0x0001},
    {"EVAIMRB", 0x0001},
    {"T2CON", 0x9342},
    {"IMR", 0x0014, "Interrupts last"},
};

static std::string name_of(const BoardAccess &access) {
    if (access.io_space)
        return "WSGR";
#define CPLD_REGISTER(name, offset, access_, bits, description) \
    if (access.address == CPLD_BASE + (offset))                 \
        return "CPLD " #name;
#include "hal/cpld/registers.def"
#undef CPLD_REGISTER
    return Board::register_name(access.address);
}

static void start_up_writes_what_the_manual_asks_for(void) {
    Bench bench;
    bench.board.record_accesses(true);
    bench.start();
    std::size_t at = 0;
    for (const BoardAccess &access : bench.board.accesses()) {
        if (!access.write)
            continue;
        const std::string name = name_of(access);
        const std::string line = std::to_string(at + 1) + ": " + name;
        TEST_ASSERT_LESS_THAN_size_t(std::size(kStartUp), at);
        TEST_ASSERT_EQUAL_STRING_MESSAGE(kStartUp[at].name, name.c_str(), line.c_str());
        TEST_ASSERT_EQUAL_HEX16_MESSAGE(kStartUp[at].value, access.value, line.c_str());
        ++at;
    }
    TEST_ASSERT_EQUAL_size_t(std::size(kStartUp), at);
    TEST_ASSERT_TRUE(bench.drives.empty());
}

/* Nothing depends on zeroed memory: the second start does exactly what the first did. */
static void a_warm_start_is_a_cold_start(void) {
    Bench bench;
    bench.start();
    hal_enable_bridges(1);
    bench.run_ms(5, [] { write_duty({20000, -20000, 1, -32768}); });
    bench.board.reset(true);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
    bench.board.record_accesses(true);
    bench.start();
    TEST_ASSERT_EQUAL(HAL_RESET_WATCHDOG, hal_read_reset_cause());
    std::size_t writes = 0;
    for (const BoardAccess &access : bench.board.accesses())
        writes += access.write;
    TEST_ASSERT_EQUAL_size_t(std::size(kStartUp), writes);
    bench.run_ms(3, [] { write_duty({20000, -20000, 1, -32768}); });
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
}

/* ---- tick ---- */

static void a_thousand_ticks_a_second(void) {
    Bench bench;
    bench.start();
    std::vector<BoardTime> times;
    TEST_ASSERT_EQUAL(100, bench.run_ms(100.5, [&] { times.push_back(bench.board.now()); }));
    for (std::size_t i = 1; i < times.size(); ++i)
        TEST_ASSERT_INT64_WITHIN(0, kTickOfBoard, times[i] - times[i - 1]);
    TEST_ASSERT_EQUAL_UINT16(0, hal_read_tick_overruns());
}

static void a_tick_that_takes_too_long_is_counted(void) {
    Bench bench;
    bench.start();
    int ticks = bench.run_ms(1.5);
    ticks += bench.run_ms(10.0, [&] { bench.board.spend(100000); }); /* 2.5 ms */
    ticks += bench.run_ms(1.5);
    const int due = static_cast<int>((bench.board.now() - 640) / kTickOfBoard);
    TEST_ASSERT_LESS_THAN(8, ticks);
    TEST_ASSERT_EQUAL(due, ticks + hal_read_tick_overruns());
    TEST_ASSERT_EQUAL_UINT16(0, hal_read_tick_overruns());
}

/* ---- PWM ---- */

static void no_motor_moves_before_the_bridges_are_enabled(void) {
    Bench bench;
    bench.start();
    bench.run_ms(3, [] { write_duty({32767, -32768, 100, -100}); });
    TEST_ASSERT_TRUE(bench.drives.empty());
    hal_enable_bridges(1);
    bench.run_ms(1);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]); /* not the duty of before */
    bench.run_ms(2, [] { write_duty({32767, -32768, 100, -100}); });
    TEST_ASSERT_EQUAL_DOUBLE(1.0, bench.duty()[0]);
    TEST_ASSERT_EQUAL_DOUBLE(-1.0, bench.duty()[1]);
    TEST_ASSERT_EQUAL_DOUBLE(on_pins(100), bench.duty()[2]);
    hal_enable_bridges(0);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
    TEST_ASSERT_INT64_WITHIN(100, bench.board.now(), bench.drives.back().time);
}

/* Resolution 1/2000; rounding to it errs by at most a quarter of a thousandth. */
static void duty_on_the_pins_is_the_demand_rounded_to_a_two_thousandth(void) {
    Bench bench;
    bench.start();
    hal_enable_bridges(1);
    double worst = 0.0;
    for (int value = -32768; value <= 32767; value += 7) {
        const auto duty_q15 = static_cast<std::int16_t>(value);
        write_duty({duty_q15, 0, 0, duty_q15});
        bench.board.spend(4100);
        hal_service_watchdog();
        TEST_ASSERT_EQUAL_DOUBLE(on_pins(duty_q15), bench.duty()[0]);
        TEST_ASSERT_EQUAL_DOUBLE(on_pins(duty_q15), bench.duty()[3]);
        worst = std::fmax(worst, std::fabs(bench.duty()[0] - value / 32768.0));
    }
    TEST_ASSERT_TRUE(worst <= 1.0 / 4000.0 + 1e-12);
    TEST_ASSERT_TRUE(worst > 0.9 / 4000.0);
    std::printf("duty from the registers: resolution 1/2000, largest error %.2e\n", worst);
}

/* Wherever the period starts within the writes, a pin pair shows the old duty, zero or the new
 * one: never one's sign with the other's magnitude. */
static void no_order_of_writes_and_underflow_makes_a_glitch(void) {
    std::minstd_rand random(1);
    std::uniform_int_distribution<int> any(-32768, 32767);
    long straddled = 0;
    for (int trial = 0; trial < 300; ++trial) {
        Bench bench;
        bench.start();
        hal_enable_bridges(1);
        std::array<std::int16_t, 4> before, after;
        for (std::size_t i = 0; i < 4; ++i) {
            before[i] = static_cast<std::int16_t>(trial % 3 == 0 ? 0 : any(random));
            after[i] = static_cast<std::int16_t>(trial % 5 == 0 ? -before[i] : any(random));
        }
        write_duty(before);
        bench.board.spend(4100);
        /* The writes of EVA start `lead` cycles before an underflow of T1. */
        const int lead = trial % 80;
        const int count = bench.board.read(EVA + T1CNT);
        bench.board.spend(4000 - count - lead);
        bench.drives.clear();
        write_duty(after);
        bench.board.spend(4100);
        std::array<std::vector<double>, 4> shown;
        for (const Bench::Drive &drive : bench.drives) {
            for (std::size_t i = 0; i < 4; ++i)
                shown[i].push_back(drive.duty[i]);
        }
        for (std::size_t i = 0; i < 4; ++i) {
            for (const double duty : shown[i]) {
                const bool allowed =
                    duty == on_pins(before[i]) || duty == 0.0 || duty == on_pins(after[i]);
                TEST_ASSERT_TRUE(allowed);
                straddled += duty == 0.0 && on_pins(after[i]) != 0.0;
            }
            TEST_ASSERT_TRUE(shown[i].empty() ? on_pins(before[i]) == on_pins(after[i])
                                              : shown[i].back() == on_pins(after[i]));
        }
    }
    TEST_ASSERT_GREATER_THAN(0, straddled); /* the case did occur */
}

/* ---- protection ---- */

static void protection_while_driving_latches_until_switched_on_again(void) {
    Bench bench;
    bench.start();
    hal_enable_bridges(1);
    const auto drive = [] { write_duty({16384, 16384, 16384, 16384}); };
    bench.run_ms(3, drive);
    bench.board.set_protection_pin(1, false);
    TEST_ASSERT_EQUAL_DOUBLE(0.5, bench.duty()[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[2]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[3]);
    bench.run_ms(3, drive);
    TEST_ASSERT_EQUAL_HEX16(2, hal_read_bridge_faults());
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[2]);
    /* The cause is still there: wheels 3 and 4 stay off, and the fault stays. */
    hal_enable_bridges(0);
    hal_enable_bridges(1);
    bench.run_ms(3, drive);
    TEST_ASSERT_EQUAL_HEX16(2, hal_read_bridge_faults());
    TEST_ASSERT_EQUAL_DOUBLE(0.5, bench.duty()[0]);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[2]);
    /* It has gone: only switching on brings them back. */
    bench.board.set_protection_pin(1, true);
    bench.run_ms(3, drive);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[2]);
    hal_enable_bridges(0);
    hal_enable_bridges(1);
    bench.run_ms(3, drive);
    TEST_ASSERT_EQUAL_HEX16(0, hal_read_bridge_faults());
    TEST_ASSERT_EQUAL_DOUBLE(0.5, bench.duty()[2]);
}

/* ---- counters ---- */

/* 11 bits in the CPLD, 16 in the firmware: exact for any walk below half of them a tick. */
static void counters_are_extended_without_loss(void) {
    std::minstd_rand random(2);
    constexpr int kLargest = (1 << (CPLD_COUNT1_BITS - 1)) - 1;
    std::uniform_int_distribution<int> step(-kLargest, kLargest);
    Bench bench;
    bench.start();
    bench.run_ms(1000.5, [&] {
        std::uint16_t counts[4];
        for (double &count : bench.counts)
            count += step(random);
        hal_service_watchdog();
        hal_read_encoder_counts(counts);
        for (std::size_t i = 0; i < 4; ++i) {
            const auto whole = static_cast<std::int64_t>(bench.counts[i]);
            TEST_ASSERT_EQUAL_UINT16(static_cast<std::uint16_t>(whole), counts[i]);
        }
    });
}

static void decoder_errors_are_reported_once(void) {
    Bench bench;
    bench.start();
    std::uint16_t counts[4];
    bench.counters.inject_error(2);
    hal_read_encoder_counts(counts);
    TEST_ASSERT_EQUAL_HEX16(4, hal_read_encoder_errors());
    hal_read_encoder_counts(counts);
    TEST_ASSERT_EQUAL_HEX16(0, hal_read_encoder_errors());
}

struct NoCpld : BusDevice {
    int wait_states() const override {
        return 0;
    }
    std::uint16_t read(std::uint16_t, BoardTime) override {
        return 0xFFFF;
    }
    void write(std::uint16_t, std::uint16_t, BoardTime) override {}
};

static void a_missing_cpld_is_an_error_of_every_wheel(void) {
    Bench bench;
    NoCpld nothing;
    Board board(bench, nothing, board_vectors());
    board.attach();
    board_start();
    for (int i = 0; i < 3; ++i)
        TEST_ASSERT_EQUAL_HEX16(0xF, hal_read_encoder_errors());
}

/* ---- analog ---- */

static void analog_values_are_right_to_half_a_code_and_of_this_tick(void) {
    Bench bench;
    bench.start();
    bench.volt = {1.65 + 0.5, 1.65 - 0.5, 0.0, 3.3, 2.4};
    bench.run_ms(1.5, [] {
        std::int16_t current_ma[4];
        hal_read_currents_ma(current_ma);
        const double per_volt = 64.0 * 1024 / 3.3;
        TEST_ASSERT_INT16_WITHIN(33, static_cast<std::int16_t>(0.5 * per_volt), current_ma[0]);
        TEST_ASSERT_INT16_WITHIN(33, static_cast<std::int16_t>(-0.5 * per_volt), current_ma[1]);
        TEST_ASSERT_EQUAL_INT16(-32736, current_ma[2]);
        TEST_ASSERT_EQUAL_INT16(32736, current_ma[3]);
        TEST_ASSERT_UINT16_WITHIN(17, 24000, hal_read_supply_mv());
    });
}

/* A tick so late that the next conversion runs when it asks: it keeps the values it has. */
static void a_running_conversion_is_not_read(void) {
    Bench bench;
    bench.start();
    bench.run_ms(1.2);
    bool hit = false;
    for (int late = 0; late < 40; ++late) {
        bench.board.spend(static_cast<int>(kTickOfBoard) - 180 + late * 4 -
                          static_cast<int>(bench.board.now() % kTickOfBoard));
        hit |= (bench.board.read(ADCTRL2) & ADCTRL2_SEQ1_BSY) != 0;
        analog_collect();
        bench.run_ms(1.2);
        hal_service_watchdog();
    }
    TEST_ASSERT_TRUE(hit);
}

/* ---- serial line ---- */

static std::vector<std::uint8_t> random_bytes(std::size_t count) {
    std::minstd_rand random(3);
    std::vector<std::uint8_t> bytes(count);
    for (std::uint8_t &byte : bytes)
        byte = static_cast<std::uint8_t>(random() >> 7);
    return bytes;
}

/* Both directions at full rate, echoed by a tick that takes 16 bytes: nothing is lost. */
static void a_full_line_in_both_directions_loses_nothing(void) {
    Bench bench;
    bench.start();
    const std::vector<std::uint8_t> sent = random_bytes(5760); /* half a second */
    bench.board.serial().send(sent);
    const double ms = 520.0;
    bench.run_ms(ms, [&] {
        std::uint16_t byte;
        hal_service_watchdog();
        bench.board.spend(12000); /* a control tick */
        for (int i = 0; i < 16 && hal_serial_read(&byte); ++i)
            hal_serial_write(byte);
        TEST_ASSERT_EQUAL_UINT16(0, hal_serial_lost());
    });
    const std::vector<std::uint8_t> echo = bench.board.serial().take_received();
    TEST_ASSERT_EQUAL_size_t(sent.size(), echo.size());
    TEST_ASSERT_TRUE(echo == sent);
    TEST_ASSERT_EQUAL(0, bench.board.serial().unreadable());
    const double cycles = static_cast<double>(bench.board.interrupt_cycles(5));
    std::printf(
        "serial line: %.0f bytes/s each way, %ld interrupts, %.0f cycles each, %.1f %% CPU\n",
        static_cast<double>(echo.size()) / 0.5, bench.board.interrupts(5),
        cycles / static_cast<double>(bench.board.interrupts(5)),
        100.0 * cycles / (500.0 * kTickOfBoard));
}

static void what_does_not_fit_is_counted_or_refused(void) {
    Bench bench;
    bench.start();
    bench.board.serial().send(random_bytes(100));
    bench.run_ms(10); /* nobody reads: 64 are kept */
    TEST_ASSERT_EQUAL_UINT16(36, hal_serial_lost());
    TEST_ASSERT_EQUAL_UINT16(0, hal_serial_lost());
    std::uint16_t byte = 0, count = 0;
    while (hal_serial_read(&byte))
        ++count;
    TEST_ASSERT_EQUAL_UINT16(64, count);
    TEST_ASSERT_EQUAL_UINT16(128, hal_serial_space());
    for (int i = 0; i < 200; ++i)
        hal_serial_write(static_cast<std::uint16_t>(i));
    TEST_ASSERT_EQUAL_UINT16(0, hal_serial_space());
    bench.run_ms(20);
    TEST_ASSERT_EQUAL_UINT16(128, hal_serial_space());
    const auto received = bench.board.serial().take_received();
    TEST_ASSERT_UINT32_WITHIN(2, 130, received.size()); /* shifter and buffer hold two more */
}

/* Interrupts kept away for longer than a byte: the overrun is counted and the line recovers. */
static void an_overrun_is_counted_and_the_line_goes_on(void) {
    Bench bench;
    bench.start();
    bench.board.mask_interrupts(true);
    bench.board.serial().send({1, 2, 3});
    bench.board.spend(12000);
    bench.board.mask_interrupts(false);
    bench.board.spend(10);
    TEST_ASSERT_EQUAL_UINT16(1, hal_serial_lost());
    bench.board.serial().send({4, 5});
    bench.run_ms(2);
    std::uint16_t byte = 0;
    TEST_ASSERT_EQUAL_UINT16(1, hal_serial_read(&byte));
    TEST_ASSERT_EQUAL_UINT16(4, byte);
    TEST_ASSERT_EQUAL_UINT16(1, hal_serial_read(&byte));
    TEST_ASSERT_EQUAL_UINT16(5, byte);
    TEST_ASSERT_EQUAL_UINT16(0, hal_serial_read(&byte));
}

/* The recovery from a bad byte drops the byte being sent, but never stops the transmitter. */
static void noise_on_the_line_does_not_stop_the_transmitter(void) {
    Bench bench;
    bench.start();
    std::minstd_rand random(4);
    long written = 0;
    bench.run_ms(500, [&] {
        hal_service_watchdog();
        for (int i = 0; i < 11 && hal_serial_space() > 0; ++i, ++written)
            hal_serial_write(0x55);
        if (random() % 4 == 0)
            bench.board.serial().send_break(11 + static_cast<int>(random() % 5));
    });
    bench.run_ms(20);
    TEST_ASSERT_EQUAL_UINT16(128, hal_serial_space());
    const long lost = hal_serial_lost();
    const long received = static_cast<long>(bench.board.serial().take_received().size());
    TEST_ASSERT_GREATER_THAN(50, lost);
    /* A reset of the SCI may cost the byte in the shifter and the one behind it. */
    TEST_ASSERT_TRUE(received <= written);
    TEST_ASSERT_TRUE(received >= written - 2 * lost);
}

/* ---- store ---- */

static void wait_for_store(Bench &bench) {
    int polls = 0;
    while (hal_store_busy()) {
        bench.board.spend(4000);
        hal_service_watchdog();
        TEST_ASSERT_LESS_THAN(60, ++polls);
    }
}

static void words_come_back_from_the_store(void) {
    Bench bench;
    bench.start();
    wait_for_store(bench);
    TEST_ASSERT_EQUAL_HEX16(0xFFFF, hal_store_read(0));
    for (const std::uint16_t address : {0, 1, 15, 16, 255, HAL_STORE_WORDS - 1}) {
        hal_store_write(address, static_cast<std::uint16_t>(0x1234 + 0x0101 * address));
        TEST_ASSERT_EQUAL_UINT16(1, hal_store_busy());
        wait_for_store(bench);
    }
    for (const std::uint16_t address : {0, 1, 15, 16, 255, HAL_STORE_WORDS - 1}) {
        const auto expected = static_cast<std::uint16_t>(0x1234 + 0x0101 * address);
        TEST_ASSERT_EQUAL_HEX16(expected, hal_store_read(address));
        TEST_ASSERT_EQUAL_HEX8(expected >> 8,
                               bench.board.eeprom().bytes()[static_cast<std::size_t>(2 * address)]);
    }
    TEST_ASSERT_EQUAL_HEX16(0xFFFF, hal_store_read(2));
}

/* Power fails at every stage of a write: this word is old, new or undefined, no other changes. */
static void a_power_cut_spoils_only_the_word_under_way(void) {
    for (int cut = 0; cut < 230000; cut += 2300) {
        Bench bench;
        bench.start();
        wait_for_store(bench);
        for (std::uint16_t address = 0; address < 3; ++address) {
            hal_store_write(address, 0x1111);
            wait_for_store(bench);
        }
        hal_store_write(1, 0x2222);
        bench.board.spend(cut);
        bench.board.eeprom().cut_power(static_cast<unsigned>(cut));
        bench.board.reset(false);
        board_start();
        wait_for_store(bench);
        TEST_ASSERT_EQUAL_HEX16(0x1111, hal_store_read(0));
        TEST_ASSERT_EQUAL_HEX16(0x1111, hal_store_read(2));
        if (cut > static_cast<int>(Eeprom::kWriteCycle))
            TEST_ASSERT_EQUAL_HEX16(0x2222, hal_store_read(1));
    }
}

/* A watchdog reset leaves the EEPROM writing: the drivers ask it before they trust it. */
static void a_reset_during_a_write_waits_for_its_end(void) {
    Bench bench;
    bench.start();
    wait_for_store(bench);
    hal_store_write(7, 0xCAFE);
    bench.board.reset(true);
    board_start();
    TEST_ASSERT_EQUAL_UINT16(1, hal_store_busy());
    wait_for_store(bench);
    TEST_ASSERT_EQUAL_HEX16(0xCAFE, hal_store_read(7));
}

/* ---- watchdog ---- */

static void a_tick_that_stops_is_reset_and_the_cause_is_known(void) {
    Bench bench;
    bench.start();
    TEST_ASSERT_EQUAL(HAL_RESET_POWER_ON, hal_read_reset_cause());
    hal_enable_bridges(1);
    bench.run_ms(1000, [] {
        hal_service_watchdog();
        write_duty({16384, 16384, 16384, 16384});
    });
    const BoardTime last = bench.board.now();
    TEST_ASSERT_EQUAL_DOUBLE(0.5, bench.duty()[0]);
    TEST_ASSERT_TRUE(resets([&] { bench.run_ms(1000); }));
    const double ms = static_cast<double>(bench.board.now() - last) / kTickOfBoard;
    TEST_ASSERT_TRUE(ms > 200.0 && ms < 211.0);
    bench.board.reset(true);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
    bench.start();
    TEST_ASSERT_EQUAL(HAL_RESET_WATCHDOG, hal_read_reset_cause());
    bench.board.reset(false);
    bench.start();
    TEST_ASSERT_EQUAL(HAL_RESET_POWER_ON, hal_read_reset_cause());
}

static void print_start_up(void) {
    Bench bench;
    bench.board.record_accesses(true);
    bench.start();
    std::size_t writes = 0;
    for (const BoardAccess &access : bench.board.accesses()) {
        const bool listed = access.write && writes < std::size(kStartUp);
        std::printf("%9.3f us  %s %-13s %04X  %s\n",
                    static_cast<double>(access.time) * kBoardTime_s * 1e6,
                    access.write ? "write" : "read ", name_of(access).c_str(), access.value,
                    listed ? kStartUp[writes].rule : "");
        writes += access.write;
    }
}

int main(int argc, char **argv) {
    if (argc == 2 && std::string(argv[1]) == "--start-up") {
        print_start_up();
        return 0;
    }
    UNITY_BEGIN();
    (void)argv;
    RUN_TEST(start_up_writes_what_the_manual_asks_for);
    RUN_TEST(a_warm_start_is_a_cold_start);
    RUN_TEST(a_thousand_ticks_a_second);
    RUN_TEST(a_tick_that_takes_too_long_is_counted);
    RUN_TEST(no_motor_moves_before_the_bridges_are_enabled);
    RUN_TEST(duty_on_the_pins_is_the_demand_rounded_to_a_two_thousandth);
    RUN_TEST(no_order_of_writes_and_underflow_makes_a_glitch);
    RUN_TEST(protection_while_driving_latches_until_switched_on_again);
    RUN_TEST(counters_are_extended_without_loss);
    RUN_TEST(decoder_errors_are_reported_once);
    RUN_TEST(a_missing_cpld_is_an_error_of_every_wheel);
    RUN_TEST(analog_values_are_right_to_half_a_code_and_of_this_tick);
    RUN_TEST(a_running_conversion_is_not_read);
    RUN_TEST(a_full_line_in_both_directions_loses_nothing);
    RUN_TEST(what_does_not_fit_is_counted_or_refused);
    RUN_TEST(an_overrun_is_counted_and_the_line_goes_on);
    RUN_TEST(noise_on_the_line_does_not_stop_the_transmitter);
    RUN_TEST(words_come_back_from_the_store);
    RUN_TEST(a_power_cut_spoils_only_the_word_under_way);
    RUN_TEST(a_reset_during_a_write_waits_for_its_end);
    RUN_TEST(a_tick_that_stops_is_reset_and_the_cause_is_known);
    return UNITY_END();
}
