/* The virtual LF2407A by itself: what it refuses, what resets it, what its units do. */
#include "tests/sim/board/bench.h"

#include <unity.h> /* last: its macro isnan() would break C++ headers */

extern "C" void setUp() {}
extern "C" void tearDown() {}

#define ASSERT_FAULT(expected, ...)                                                    \
    do {                                                                               \
        const std::string text = fault_of([&] { __VA_ARGS__; });                       \
        TEST_ASSERT_TRUE_MESSAGE(                                                      \
            contains(text, expected),                                                  \
            ("expected '" + std::string(expected) + "', got '" + text + "'").c_str()); \
    } while (0)

static constexpr std::uint16_t kAllClocks = 0x00EC;

static Bench &clocked(Bench &bench) {
    bench.board.write(SCSR1, kAllClocks);
    return bench;
}

/* ---- refusals ---- */

static void a_fault_names_register_value_time_and_rule(void) {
    Bench bench;
    const std::string text = fault_of([&] { bench.board.write(EVA + COMCON, 0x8200); });
    TEST_ASSERT_EQUAL_STRING(
        "write COMCONA (7411h) = 8200h at 1.200 us: the clock of this peripheral is off (SCSR1): "
        "the chip ignores this",
        text.c_str());
}

static void a_register_without_clock_is_refused(void) {
    Bench bench;
    for (const int address : {SPIPRI, SCIPRI, MAXCONV, EVA + T1PR, EVB + T1PR})
        ASSERT_FAULT("clock", bench.board.write(static_cast<std::uint16_t>(address), 0));
    ASSERT_FAULT("clock", bench.board.read(SCIRXST));
    clocked(bench);
    for (const int address : {SPIPRI, SCIPRI, MAXCONV, EVA + T1PR, EVB + T1PR})
        bench.board.write(static_cast<std::uint16_t>(address), 0);
}

static void an_undefined_register_is_refused(void) {
    Bench bench;
    clocked(bench);
    for (const int address :
         {0x0000, 0x0005, 0x0100, 0x6FFF, 0x7000, 0x702A, 0x7412, 0x7532, 0x7600}) {
        ASSERT_FAULT("undefined", bench.board.write(static_cast<std::uint16_t>(address), 0));
        ASSERT_FAULT("undefined", bench.board.read(static_cast<std::uint16_t>(address)));
    }
}

static void a_reserved_bit_is_refused(void) {
    Bench bench;
    clocked(bench);
    ASSERT_FAULT("reserved", bench.board.write(SCSR1, kAllClocks | 0x8000));
    ASSERT_FAULT("reserved", bench.board.write(EVA + COMCON, 0x0001));
    ASSERT_FAULT("reserved", bench.board.write(EVA + T2CON, 0x2000));
    ASSERT_FAULT("reserved", bench.board.write(SCICTL1, 0x0010));
    ASSERT_FAULT("reserved", bench.board.write(IMR, 0x0040));
    ASSERT_FAULT("reserved", bench.board.write_wsgr(0x0800));
    ASSERT_FAULT("must stay 1", bench.board.write(MCRB, 0x001C));
    ASSERT_FAULT("read-only", bench.board.write(PIVR, 0));
    ASSERT_FAULT("read-only", bench.board.write(SCIRXST, 0));
}

static void clearing_several_flags_at_once_is_refused(void) {
    Bench bench;
    clocked(bench);
    bench.board.write(EVA + T1PR, 99);
    bench.board.write(EVA + T1CON, TCON_UP | TCON_ENABLE);
    bench.board.spend(1000);
    const std::uint16_t flags = bench.board.read(EVA + EVIFRA);
    TEST_ASSERT_EQUAL_HEX16(0x0380, flags);
    ASSERT_FAULT("several flags", bench.board.write(EVA + EVIFRA, flags));
    bench.board.write(EVA + T1CON, 0);
    bench.board.write(EVA + EVIFRA, 0x0080);
    TEST_ASSERT_EQUAL_HEX16(0x0300, bench.board.read(EVA + EVIFRA));
}

static void the_external_bus_needs_its_driver_and_its_wait_states(void) {
    Bench bench;
    ASSERT_FAULT("not driven", bench.board.write(CPLD_BASE + CPLD_LATCH, 0));
    bench.board.write(SCSR2, 0x000B);
    bench.board.write_wsgr((CPLD_WAIT_STATES - 1) << WSGR_DATA_SHIFT);
    ASSERT_FAULT("wait states", bench.board.write(CPLD_BASE + CPLD_LATCH, 0));
    bench.board.write_wsgr(CPLD_WAIT_STATES << WSGR_DATA_SHIFT);
    bench.board.write(CPLD_BASE + CPLD_LATCH, 0);
    ASSERT_FAULT("no register to read", bench.board.read(CPLD_BASE + CPLD_LATCH));
    ASSERT_FAULT("no register to write", bench.board.write(CPLD_BASE + CPLD_COUNT1, 0));
}

static void a_counter_without_latch_is_refused(void) {
    Bench bench;
    bench.board.write(SCSR2, 0x000B);
    ASSERT_FAULT("without LATCH", bench.board.read(CPLD_BASE + CPLD_COUNT1));
    bench.counts = {5.9, -0.1, 4096.0, 0.0};
    bench.board.write(CPLD_BASE + CPLD_LATCH, 0);
    bench.counts = {9.0, 9.0, 9.0, 9.0};
    TEST_ASSERT_EQUAL_UINT16(5, bench.board.read(CPLD_BASE + CPLD_COUNT1));
    TEST_ASSERT_EQUAL_HEX16(0x07FF, bench.board.read(CPLD_BASE + CPLD_COUNT2));
    TEST_ASSERT_EQUAL_UINT16(0, bench.board.read(CPLD_BASE + CPLD_COUNT3));
    ASSERT_FAULT("without LATCH", bench.board.read(CPLD_BASE + CPLD_COUNT1));
}

static void interrupts_without_a_mask_or_a_routine_are_refused(void) {
    Bench bench;
    ASSERT_FAULT("IMR", bench.board.mask_interrupts(false));
    clocked(bench);
    bench.board.write(EVA + T1PR, 99);
    bench.board.write(EVA + EVIMRA, 0x0080);
    bench.board.write(EVA + T1CON, TCON_UP | TCON_ENABLE);
    bench.board.write(IMR, 0x0002);
    ASSERT_FAULT("INT2 has no routine", bench.board.mask_interrupts(false);
                 bench.board.spend(1000));
}

static Board *board_of_routine = nullptr;
static int routine_calls = 0;
static void routine_that_forgets_its_flag(void) {
    ++routine_calls;
    board_of_routine->read(PIVR);
}

static void a_routine_that_leaves_its_flag_is_refused(void) {
    Bench bench;
    Board board(bench, bench.counters, {nullptr, routine_that_forgets_its_flag});
    board_of_routine = &board;
    board.write(SCSR1, kAllClocks);
    board.write(EVA + T1PR, 99);
    board.write(EVA + EVIMRA, 0x0080);
    board.write(EVA + T1CON, TCON_UP | TCON_ENABLE);
    board.write(IMR, 0x0002);
    ASSERT_FAULT("left the flag in EVAIFRA", board.mask_interrupts(false); board.spend(1000));
}

/* ---- watchdog ---- */

static void the_watchdog_resets_unless_it_is_served(void) {
    Bench bench;
    /* Out of reset CLKOUT is 5 MHz: 256 * 512 cycles. */
    TEST_ASSERT_FALSE(resets([&] { bench.board.spend(256 * 512 - 1); }));
    TEST_ASSERT_TRUE(resets([&] { bench.board.spend(1); }));
    bench.board.reset(true);
    TEST_ASSERT_EQUAL_HEX16(WDCR_WDFLAG, bench.board.read(WDCR) & WDCR_WDFLAG);
    bench.board.write(SCSR1, 0);
    bench.board.write(WDCR, 0x00AF);
    for (int i = 0; i < 20; ++i) {
        bench.board.spend(8000000); /* 200 of 209.7 ms */
        bench.board.write(WDKEY, 0x55);
        bench.board.write(WDKEY, 0x55);
        bench.board.write(WDKEY, 0xAA);
    }
    bench.board.write(WDKEY, 0xAA); /* a lone second key does nothing */
    TEST_ASSERT_TRUE(resets([&] { bench.board.spend(8388608); }));
}

static void a_wrong_key_or_check_pattern_resets_at_once(void) {
    Bench bench;
    TEST_ASSERT_TRUE(resets([&] { bench.board.write(WDKEY, 0x5A); }));
    TEST_ASSERT_TRUE(resets([&] { bench.board.write(WDCR, 0x0007); }));
}

static void the_override_cannot_be_taken_back(void) {
    Bench bench;
    bench.board.write(WDCR, 0x0068);
    bench.board.spend(10000000);
    bench.board.write(SCSR2, 0x002B);
    bench.board.write(SCSR2, 0x000B);
    TEST_ASSERT_EQUAL_HEX16(0x000B, bench.board.read(SCSR2));
    bench.board.write(WDCR, 0x0068);
    TEST_ASSERT_TRUE(resets([&] { bench.board.spend(256 * 512); }));
}

/* ---- event manager ---- */

static void output(Bench &bench, std::uint16_t mode, std::uint16_t period, std::uint16_t compare,
                   std::uint16_t actions, std::uint16_t dead_band = 0) {
    Board &board = clocked(bench).board;
    board.write(EVA + T1PR, period);
    board.write(EVA + CMPR1, compare);
    board.write(EVA + ACTR, actions);
    board.write(EVA + DBTCON, dead_band);
    board.write(EVA + T1CON, mode | TCON_ENABLE);
    board.write(EVA + COMCON, COMCON_CENABLE | COMCON_FCOMPOE);
    board.write(MCRA, 0x0FC0);
    board.spend(3 * period);
}

static void a_pin_is_high_for_the_share_that_the_manual_gives(void) {
    const struct {
        std::uint16_t mode, period, compare;
        double high;
    } cases[] = {{TCON_UP, 1999, 0, 1.0},           {TCON_UP, 1999, 1, 1999 / 2000.0},
                 {TCON_UP, 1999, 1999, 1 / 2000.0}, {TCON_UP, 1999, 2000, 0.0},
                 {TCON_UP_DOWN, 1000, 0, 1.0},      {TCON_UP_DOWN, 1000, 250, 0.75},
                 {TCON_UP_DOWN, 1000, 1000, 0.0}};
    for (const auto &c : cases) {
        Bench forward, inverted;
        output(forward, c.mode, c.period, c.compare, 0x2);
        TEST_ASSERT_EQUAL_DOUBLE(c.high, forward.duty()[0]);
        output(inverted, c.mode, c.period, c.compare, 0x4);
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, c.high - 1.0, inverted.duty()[0]);
    }
}

/* Complementary pair (10, 01): first pin loses the dead time, second starts that much later. */
static void dead_time_opens_a_gap(void) {
    Bench bench;
    output(bench, TCON_UP, 1999, 1000, 0x6, 0x0A20); /* 10 cycles, pair 1 */
    TEST_ASSERT_EQUAL_DOUBLE((1000 - 10 - (1000 - 10)) / 2000.0, bench.duty()[0]);
    Bench without;
    output(without, TCON_UP, 1999, 600, 0x6, 0x0A00);
    TEST_ASSERT_EQUAL_DOUBLE((1400 - 600) / 2000.0, without.duty()[0]);
}

static void shadow_registers_wait_for_the_underflow(void) {
    Bench bench;
    output(bench, TCON_UP, 1999, 1000, 0x2);
    Board &board = bench.board;
    board.spend(2000 - board.read(EVA + T1CNT) + 500);
    const std::size_t before = bench.drives.size();
    board.write(EVA + CMPR1, 500);
    board.write(EVA + ACTR, 0x8);
    board.spend(100);
    TEST_ASSERT_EQUAL_size_t(before, bench.drives.size());
    const std::uint16_t count = board.read(EVA + T1CNT);
    const BoardTime start = board.now() - board.cycles(count);
    board.spend(2000);
    TEST_ASSERT_EQUAL_size_t(before + 1, bench.drives.size());
    TEST_ASSERT_EQUAL_DOUBLE(-0.75, bench.duty()[0]);
    TEST_ASSERT_EQUAL_INT64(0, (bench.drives.back().time - start) % 2000);
}

static void outputs_are_high_impedance_until_they_are_enabled(void) {
    Bench bench;
    output(bench, TCON_UP, 1999, 0, 0x2);
    bench.board.write(EVA + COMCON, COMCON_CENABLE);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
    bench.board.write(EVA + COMCON, COMCON_CENABLE | COMCON_FCOMPOE);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, bench.duty()[0]);
    bench.board.write(MCRA, 0);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
}

static void the_protection_pin_beats_software(void) {
    Bench bench;
    output(bench, TCON_UP, 1999, 0, 0x2);
    bench.board.set_protection_pin(0, false);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
    TEST_ASSERT_EQUAL_INT64(bench.board.now(), bench.drives.back().time);
    TEST_ASSERT_EQUAL_HEX16(EVA_PDPINT, bench.board.read(EVA + EVIFRA) & EVA_PDPINT);
    bench.board.write(EVA + COMCON, COMCON_CENABLE | COMCON_FCOMPOE);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
    bench.board.set_protection_pin(0, true);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, bench.duty()[0]);
    bench.board.write(EVA + COMCON, COMCON_CENABLE | COMCON_FCOMPOE);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, bench.duty()[0]);
    bench.board.write(EVA + EVIMRA, 0);
    bench.board.set_protection_pin(0, false);
    TEST_ASSERT_EQUAL_DOUBLE(1.0, bench.duty()[0]);
}

/* ---- interrupts ---- */

static std::vector<std::uint16_t> served;
static void serve(void) {
    const std::uint16_t source = board_of_routine->read(PIVR);
    served.push_back(source);
    if (source == 0x20 || source == 0x19)
        board_of_routine->write(source == 0x20 ? EVA + EVIFRA : EVB + EVIFRA, EVA_PDPINT);
    if (source == 0x27)
        board_of_routine->write(EVA + EVIFRA, 0x0080);
    if (source == 0x29)
        board_of_routine->write(EVA + EVIFRA, 0x0200);
    if (source == PIVR_RXINT)
        board_of_routine->read(SCIRXBUF);
}

static void interrupts_come_by_level_then_by_rank(void) {
    Bench bench;
    Board board(bench, bench.counters, {serve, serve, serve, serve, serve, serve});
    board_of_routine = &board;
    served.clear();
    board.write(SCSR1, kAllClocks);
    board.write(EVA + T1PR, 99);
    board.write(EVA + EVIMRA, 0x0281);
    board.write(EVA + T1CON, TCON_UP | TCON_ENABLE);
    board.spend(200);
    board.write(EVA + T1CON, 0);
    board.set_protection_pin(1, false);
    board.set_protection_pin(0, false);
    board.write(IMR, 0x0003);
    board.mask_interrupts(false);
    board.spend(1);
    const std::vector<std::uint16_t> expected = {0x20, 0x19, 0x27, 0x29};
    TEST_ASSERT_TRUE(served == expected);
}

static void a_request_without_source_reads_as_phantom(void) {
    Bench bench;
    Board board(bench, bench.counters, {serve, serve, serve, serve, serve, serve});
    board_of_routine = &board;
    served.clear();
    board.write(SCSR1, kAllClocks);
    board.write(IMR, 0x0001);
    board.request(1, 0x20);
    board.request(1, 0x20);
    board.mask_interrupts(false);
    board.spend(1);
    TEST_ASSERT_EQUAL_size_t(2, served.size());
    TEST_ASSERT_EQUAL_HEX16(0, board.read(IFR));
}

/* ---- SCI ---- */

static Board &serial_board(Bench &bench, std::uint16_t divider) {
    Board &board = clocked(bench).board;
    board.write(SCICTL1, 0x03);
    board.write(SCICCR, 0x07);
    board.write(SCIHBAUD, divider >> 8);
    board.write(SCILBAUD, divider & 0xFF);
    board.write(SCICTL1, 0x23);
    board.write(MCRA, MCRA_SCI);
    return board;
}

static void a_byte_takes_ten_bits_and_an_unread_one_is_overrun(void) {
    Bench bench;
    Board &board = serial_board(bench, 42);
    const BoardTime start = board.now();
    board.serial().send({0x5A, 0xC3});
    while (!(board.read(SCIRXST) & SCIRXST_RXRDY)) {
    }
    /* Judged in the middle of the stop bit, or when the peer's is half over. */
    TEST_ASSERT_INT64_WITHIN(8, static_cast<BoardTime>(9.5 * 40e6 / 115200), board.now() - start);
    TEST_ASSERT_EQUAL_HEX16(0x5A, board.read(SCIRXBUF));
    TEST_ASSERT_EQUAL_HEX16(0, board.read(SCIRXST));
    board.spend(4000);
    board.serial().send({0x11});
    board.spend(4000);
    TEST_ASSERT_EQUAL_HEX16(SCIRXST_RXERROR | SCIRXST_RXRDY | SCIRXST_OE, board.read(SCIRXST));
    TEST_ASSERT_EQUAL_HEX16(0x11, board.read(SCIRXBUF));
    TEST_ASSERT_EQUAL_HEX16(SCIRXST_RXERROR | SCIRXST_OE, board.read(SCIRXST));
    board.write(SCICTL1, 0x03);
    board.write(SCICTL1, 0x23);
    TEST_ASSERT_EQUAL_HEX16(0, board.read(SCIRXST));
}

/* The stop bit is sampled 9.5 bits after the start: off by half a bit is off by 5.3 %. */
static void bytes_survive_five_percent_of_baud_error(void) {
    for (const double error : {-0.10, -0.06, -0.045, 0.0, 0.045, 0.06, 0.10}) {
        Bench bench;
        Board &board = serial_board(bench, 39); /* 125000 baud */
        board.serial().set_peer_baud(125000 * (1.0 + error));
        board.serial().send({0x00});
        board.spend(5000);
        const bool good = board.read(SCIRXST) == SCIRXST_RXRDY && board.read(SCIRXBUF) == 0x00;
        /* A faster peer ends in idle line, which reads as stop bit, but bit 7 is then its 1. */
        TEST_ASSERT_EQUAL(std::fabs(error) < 0.05, good);
    }
}

static void writing_a_full_transmitter_is_refused(void) {
    Bench bench;
    Board &board = serial_board(bench, 42);
    board.write(SCITXBUF, 'a');
    board.write(SCITXBUF, 'b');
    TEST_ASSERT_EQUAL_HEX16(0, board.read(SCICTL2) & 0x00C0);
    ASSERT_FAULT("a byte is lost", board.write(SCITXBUF, 'c'));
    board.spend(20 * 8 * 43);
    TEST_ASSERT_EQUAL_HEX16(0x00C0, board.read(SCICTL2) & 0x00C0);
    const std::vector<std::uint8_t> sent = {'a', 'b'};
    TEST_ASSERT_TRUE(board.serial().take_received() == sent);
    ASSERT_FAULT("SW RESET", board.write(SCILBAUD, 1));
}

static void a_software_reset_drops_the_byte_on_the_line(void) {
    Bench bench;
    Board &board = serial_board(bench, 42);
    board.write(SCITXBUF, 'a');
    board.write(SCICTL1, 0x03);
    board.write(SCICTL1, 0x23);
    board.write(SCITXBUF, 'b');
    board.spend(20 * 8 * 43);
    const std::vector<std::uint8_t> sent = {'b'};
    TEST_ASSERT_TRUE(board.serial().take_received() == sent);
}

static void a_break_is_seen(void) {
    Bench bench;
    Board &board = serial_board(bench, 42);
    board.serial().send_break(12);
    board.spend(8000);
    TEST_ASSERT_EQUAL_HEX16(SCIRXST_RXERROR | SCIRXST_RXRDY | SCIRXST_BRKDT | SCIRXST_FE,
                            board.read(SCIRXST));
}

/* ---- ADC ---- */

static void the_sequencer_converts_in_order_and_stops(void) {
    Bench bench;
    Board &board = clocked(bench).board;
    bench.volt = {0.0, 3.2999, -1.0, 9.0, 1.65};
    board.write(MAXCONV, 4);
    board.write(CHSELSEQ1, 0x3210);
    board.write(CHSELSEQ2, 0x0004);
    board.write(ADCTRL2, ADCTRL2_SOC_SEQ1);
    TEST_ASSERT_EQUAL_HEX16(ADCTRL2_SEQ1_BSY, board.read(ADCTRL2));
    ASSERT_FAULT("while a sequence runs", board.write(ADCTRL2, ADCTRL2_SOC_SEQ1));
    ASSERT_FAULT("result read", board.read(RESULT0));
    board.spend(100);
    const std::uint16_t expected[] = {0, 1023, 0, 1023, 512};
    for (int k = 0; k < 5; ++k)
        TEST_ASSERT_EQUAL_HEX16(expected[k] << 6,
                                board.read(static_cast<std::uint16_t>(RESULT0 + k)));
    ASSERT_FAULT("RST SEQ1", board.write(ADCTRL2, ADCTRL2_SOC_SEQ1));
    board.write(ADCTRL2, ADCTRL2_RST_SEQ1);
    board.write(ADCTRL2, ADCTRL2_SOC_SEQ1);
}

/* ---- SPI and EEPROM ---- */

static void the_eeprom_refuses_what_it_would_ignore(void) {
    Bench bench;
    Eeprom &eeprom = bench.board.eeprom();
    ASSERT_FAULT("chip select", eeprom.exchange(0x05));
    eeprom.select(true);
    ASSERT_FAULT("without WREN", eeprom.exchange(0x02));
    eeprom.select(false);
    eeprom.select(true);
    ASSERT_FAULT("unknown instruction", eeprom.exchange(0x77));
    eeprom.select(false);
    for (const int byte : {0x06, -1, 0x02, 0x00, 0x10, 0xAB, -1}) {
        eeprom.select(byte >= 0);
        if (byte >= 0)
            eeprom.exchange(static_cast<std::uint8_t>(byte));
    }
    TEST_ASSERT_EQUAL_HEX8(0xAB, eeprom.bytes()[0x10]);
    eeprom.select(true);
    ASSERT_FAULT("write cycle", eeprom.exchange(0x03));
}

static void the_spi_refuses_what_it_cannot_do(void) {
    Bench bench;
    Board &board = clocked(bench).board;
    board.write(PCDATDIR, PCDATDIR_IOPC5_OUTPUT);
    ASSERT_FAULT("SW RESET", board.write(SPITXBUF, 0));
    board.write(SPICCR, 0x07);
    board.write(SPICTL, 0x0E);
    board.write(SPICCR, 0x87);
    ASSERT_FAULT("pins", board.write(SPITXBUF, 0x0500));
    board.write(MCRB, MCRB_MUST_STAY | MCRB_SPI);
    board.write(SPIBRR, 18);
    ASSERT_FAULT("2 MHz", board.write(SPITXBUF, 0x0500)); /* CLKOUT is 40 MHz here */
    board.write(SPIBRR, 19);
    board.write(SPITXBUF, 0x0500);
    ASSERT_FAULT("during a transfer", board.write(SPITXBUF, 0x0500));
    ASSERT_FAULT("before the character", board.read(SPIRXBUF));
    board.spend(200);
    board.write(SPITXBUF, 0x0000);
    board.spend(200);
    TEST_ASSERT_EQUAL_HEX16(0x00C0, board.read(SPISTS)); /* the first byte was not read */
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(a_fault_names_register_value_time_and_rule);
    RUN_TEST(a_register_without_clock_is_refused);
    RUN_TEST(an_undefined_register_is_refused);
    RUN_TEST(a_reserved_bit_is_refused);
    RUN_TEST(clearing_several_flags_at_once_is_refused);
    RUN_TEST(the_external_bus_needs_its_driver_and_its_wait_states);
    RUN_TEST(a_counter_without_latch_is_refused);
    RUN_TEST(interrupts_without_a_mask_or_a_routine_are_refused);
    RUN_TEST(a_routine_that_leaves_its_flag_is_refused);
    RUN_TEST(the_watchdog_resets_unless_it_is_served);
    RUN_TEST(a_wrong_key_or_check_pattern_resets_at_once);
    RUN_TEST(the_override_cannot_be_taken_back);
    RUN_TEST(a_pin_is_high_for_the_share_that_the_manual_gives);
    RUN_TEST(dead_time_opens_a_gap);
    RUN_TEST(shadow_registers_wait_for_the_underflow);
    RUN_TEST(outputs_are_high_impedance_until_they_are_enabled);
    RUN_TEST(the_protection_pin_beats_software);
    RUN_TEST(interrupts_come_by_level_then_by_rank);
    RUN_TEST(a_request_without_source_reads_as_phantom);
    RUN_TEST(a_byte_takes_ten_bits_and_an_unread_one_is_overrun);
    RUN_TEST(bytes_survive_five_percent_of_baud_error);
    RUN_TEST(writing_a_full_transmitter_is_refused);
    RUN_TEST(a_software_reset_drops_the_byte_on_the_line);
    RUN_TEST(a_break_is_seen);
    RUN_TEST(the_sequencer_converts_in_order_and_stops);
    RUN_TEST(the_eeprom_refuses_what_it_would_ignore);
    RUN_TEST(the_spi_refuses_what_it_cannot_do);
    return UNITY_END();
}
