/* Frames: the CRC against its definition, stuffing and unstuffing, and what damage does. */
#include <string.h>
#include <unity.h>

#include "firmware/frame.h"
#include "tests/firmware/reference.h"

static uint64_t seed;

void setUp(void) {
    seed = 5;
}
void tearDown(void) {}

/* ---- CRC ---- */

static u16 crc_bit_by_bit(u16 crc, u16 byte) {
    u32 shifted = crc ^ (u32)(byte & 0xFF) << 8;
    for (int bit = 0; bit < 8; bit++)
        shifted = shifted & 0x8000 ? (shifted << 1 ^ 0x1021) & 0xFFFF : shifted << 1;
    return (u16)shifted;
}

static void crc_is_that_of_the_polynomial(void) {
    for (u32 crc = 0; crc < 65536; crc += 7) {
        for (u16 byte = 0; byte < 256; byte++) {
            if (frame_crc((u16)crc, byte) != crc_bit_by_bit((u16)crc, byte))
                TEST_FAIL_MESSAGE("frame_crc differs from its definition");
        }
    }
}

static void crc_of_the_check_string(void) {
    u16 crc = FRAME_CRC_START;
    for (const char *c = "123456789"; *c; c++)
        crc = frame_crc(crc, (u16)*c);
    TEST_ASSERT_EQUAL_HEX16(0x29B1, crc);
}

static void crc_takes_eight_bits_of_a_byte(void) {
    TEST_ASSERT_EQUAL_HEX16(frame_crc(0x1234, 0x56), frame_crc(0x1234, 0xAB56));
    TEST_ASSERT_EQUAL_HEX16(frame_crc(frame_crc(0x1234, 0x78), 0x56),
                            frame_crc_u16(0x1234, 0x5678));
}

/* ---- whole frames ---- */

static void build(frame_writer *frame, const u16 *content, u16 length) {
    frame_begin(frame);
    for (u16 i = 0; i < length; i++)
        frame_add_u8(frame, content[i]);
    frame_finish(frame);
}

/* The status after the last of these bytes. */
static frame_status receive(frame_reader *reader, const u16 *wire, u16 length) {
    frame_status status = FRAME_PENDING;
    for (u16 i = 0; i < length; i++)
        status = frame_receive(reader, wire[i]);
    return status;
}

static void wire_format_by_hand(void) {
    /* CRC of 00 11 00 is FCDEh */
    static const u16 content[] = {0x00, 0x11, 0x00};
    static const u16 wire[] = {0x01, 0x02, 0x11, 0x03, 0xDE, 0xFC, 0x00};
    frame_writer frame;
    build(&frame, content, 3);
    TEST_ASSERT_EQUAL_UINT16(7, frame.length);
    TEST_ASSERT_EQUAL_HEX16_ARRAY(wire, frame.byte, 7);
}

static void numbers_are_little_endian(void) {
    frame_writer frame;
    frame_begin(&frame);
    frame_add_u8(&frame, 0xAB12);
    frame_add_u16(&frame, 0x3456);
    frame_add_u32(&frame, 0x789ABCDE);
    static const u16 content[] = {0x12, 0x56, 0x34, 0xDE, 0xBC, 0x9A, 0x78};
    TEST_ASSERT_EQUAL_HEX16_ARRAY(content, frame.byte + 1, 7);
    TEST_ASSERT_EQUAL_HEX16(0x3456, frame_u16(content + 1));
    TEST_ASSERT_EQUAL_HEX32(0x789ABCDE, frame_u32(content + 3));
    static const u16 minus_two[] = {0xFE, 0xFF, 0xFF, 0xFF}, lowest[] = {0, 0, 0, 0x80};
    TEST_ASSERT_EQUAL_INT16(-2, frame_i16(minus_two));
    TEST_ASSERT_EQUAL_INT32(-2, frame_i32(minus_two));
    TEST_ASSERT_EQUAL_INT32(I32_MIN, frame_i32(lowest));
}

/* Fills with bytes of which one in `one_in` is not zero. */
static void fill(u16 *content, u16 length, u16 one_in) {
    for (u16 i = 0; i < length; i++) {
        content[i] = reference_random(&seed) % one_in ? 0 : 1 + reference_random(&seed) % 255u;
    }
}

static void any_content_comes_through(void) {
    static frame_reader reader;
    u16 content[FRAME_RECEIVE_MAX];
    frame_writer frame;
    frame_reader_reset(&reader);
    for (int n = 0; n < REFERENCE_CASES(20000); n++) {
        const u16 length = (u16)(1 + n % FRAME_RECEIVE_MAX);
        fill(content, length, (u16)(1 + n / FRAME_RECEIVE_MAX % 5));
        build(&frame, content, length);
        TEST_ASSERT_EQUAL_UINT16(length + FRAME_OVERHEAD, frame.length);
        for (u16 i = 0; i + 1 < frame.length; i++)
            TEST_ASSERT_NOT_EQUAL(0, frame.byte[i]);
        TEST_ASSERT_EQUAL(FRAME_WHOLE, receive(&reader, frame.byte, frame.length));
        TEST_ASSERT_EQUAL_UINT16(length, reader.length);
        TEST_ASSERT_EQUAL_HEX16_ARRAY(content, reader.byte, length);
    }
}

/* ---- lengths ---- */

static void content_that_does_not_fit_is_not_sent(void) {
    frame_writer frame;
    frame_begin(&frame);
    for (int i = 0; i < FRAME_CONTENT_MAX; i++)
        frame_add_u8(&frame, 1);
    frame_finish(&frame);
    TEST_ASSERT_EQUAL_UINT16(FRAME_CONTENT_MAX + FRAME_OVERHEAD, frame.length);
    frame_begin(&frame);
    for (int i = 0; i < FRAME_CONTENT_MAX + 1000; i++)
        frame_add_u8(&frame, 1);
    frame_finish(&frame);
    TEST_ASSERT_EQUAL_UINT16(0, frame.length);
    frame_begin(&frame);
    frame_finish(&frame);
    TEST_ASSERT_EQUAL_UINT16(0, frame.length);
}

static void longer_frames_than_the_reader_holds_are_broken(void) {
    frame_reader reader;
    frame_writer frame;
    u16 content[FRAME_CONTENT_MAX];
    fill(content, FRAME_CONTENT_MAX, 1);
    frame_reader_reset(&reader);
    for (u16 length = FRAME_RECEIVE_MAX + 1; length <= FRAME_CONTENT_MAX; length++) {
        build(&frame, content, length);
        TEST_ASSERT_EQUAL(FRAME_BROKEN, receive(&reader, frame.byte, frame.length));
    }
    build(&frame, content, FRAME_RECEIVE_MAX);
    TEST_ASSERT_EQUAL(FRAME_WHOLE, receive(&reader, frame.byte, frame.length));
}

/* Whatever the reader keeps of it: here that alone would be a valid frame. */
static void a_longer_frame_is_not_taken_for_its_beginning(void) {
    frame_reader reader;
    frame_writer frame;
    u16 content[FRAME_RECEIVE_MAX + 4] = {0};
    u16 crc = FRAME_CRC_START;
    for (int i = 0; i < FRAME_RECEIVE_MAX; i++)
        crc = frame_crc(crc, content[i]);
    content[FRAME_RECEIVE_MAX] = crc & 0xFF;
    content[FRAME_RECEIVE_MAX + 1] = crc >> 8;
    frame_reader_reset(&reader);
    build(&frame, content, FRAME_RECEIVE_MAX + 4);
    TEST_ASSERT_EQUAL(FRAME_BROKEN, receive(&reader, frame.byte, frame.length));
    build(&frame, content, FRAME_RECEIVE_MAX);
    TEST_ASSERT_EQUAL(FRAME_WHOLE, receive(&reader, frame.byte, frame.length));
}

static void endless_bytes_without_a_delimiter_do_no_harm(void) {
    frame_reader reader;
    frame_reader_reset(&reader);
    for (u32 n = 0; n < 200000; n++)
        TEST_ASSERT_EQUAL(FRAME_PENDING, frame_receive(&reader, (u16)(1 + n % 255)));
    TEST_ASSERT_EQUAL(FRAME_BROKEN, frame_receive(&reader, 0));
}

static void empty_frames_are_nothing(void) {
    frame_reader reader;
    static const u16 no_content[] = {1, 0}, no_crc[] = {2, 7, 0}, only_crc[] = {3, 0xFF, 0xFF, 0};
    frame_reader_reset(&reader);
    for (int n = 0; n < 10; n++)
        TEST_ASSERT_EQUAL(FRAME_PENDING, frame_receive(&reader, 0));
    TEST_ASSERT_EQUAL(FRAME_BROKEN, receive(&reader, no_content, 2));
    TEST_ASSERT_EQUAL(FRAME_BROKEN, receive(&reader, no_crc, 3));
    TEST_ASSERT_EQUAL(FRAME_BROKEN, receive(&reader, only_crc, 4));
}

/* ---- damage ---- */

/* A velocity command, say. */
static const u16 sample[] = {1, 0x10, 7, 0xDC, 0x05, 0, 0, 0x2C, 0x01};
#define SAMPLE_LENGTH 9

/* How many whole frames come out of these bytes. */
static int whole_frames(const u16 *wire, u16 length) {
    frame_reader reader;
    int whole = 0;
    frame_reader_reset(&reader);
    for (u16 i = 0; i < length; i++)
        whole += frame_receive(&reader, wire[i]) == FRAME_WHOLE;
    return whole;
}

static void a_byte_has_eight_bits(void) {
    frame_writer frame;
    build(&frame, sample, SAMPLE_LENGTH);
    for (u16 i = 0; i < frame.length; i++)
        frame.byte[i] |= 0xA500;
    TEST_ASSERT_EQUAL_INT(1, whole_frames(frame.byte, frame.length));
}

static void every_damaged_byte_is_found(void) {
    frame_writer frame;
    build(&frame, sample, SAMPLE_LENGTH);
    for (u16 at = 0; at < frame.length; at++) {
        for (u16 change = 1; change < 256; change++) {
            frame.byte[at] ^= change;
            TEST_ASSERT_EQUAL_INT(0, whole_frames(frame.byte, frame.length));
            frame.byte[at] ^= change;
        }
    }
    TEST_ASSERT_EQUAL_INT(1, whole_frames(frame.byte, frame.length));
}

static void every_lost_or_doubled_byte_is_found(void) {
    frame_writer frame;
    u16 wire[SAMPLE_LENGTH + FRAME_OVERHEAD + 1];
    build(&frame, sample, SAMPLE_LENGTH);
    for (u16 at = 0; at + 1 < frame.length; at++) {
        memcpy(wire, frame.byte, at * sizeof *wire);
        memcpy(wire + at, frame.byte + at + 1, (size_t)(frame.length - at - 1) * sizeof *wire);
        TEST_ASSERT_EQUAL_INT(0, whole_frames(wire, (u16)(frame.length - 1)));
        memcpy(wire, frame.byte, (size_t)(at + 1) * sizeof *wire);
        memcpy(wire + at + 1, frame.byte + at, (size_t)(frame.length - at) * sizeof *wire);
        TEST_ASSERT_EQUAL_INT(0, whole_frames(wire, (u16)(frame.length + 1)));
    }
}

static void a_frame_cut_short_does_not_harm_the_next(void) {
    frame_writer frame;
    u16 wire[2 * (SAMPLE_LENGTH + FRAME_OVERHEAD) + 1];
    build(&frame, sample, SAMPLE_LENGTH);
    for (u16 cut = 0; cut < frame.length; cut++) {
        memcpy(wire, frame.byte, cut * sizeof *wire);
        wire[cut] = 0;
        memcpy(wire + cut + 1, frame.byte, frame.length * sizeof *wire);
        TEST_ASSERT_EQUAL_INT(1 + (cut == frame.length - 1),
                              whole_frames(wire, (u16)(cut + 1 + frame.length)));
    }
}

static void noise_makes_no_frame_and_the_frame_after_it_comes_through(void) {
    frame_reader reader;
    frame_writer frame;
    int whole = 0;
    build(&frame, sample, SAMPLE_LENGTH);
    frame_reader_reset(&reader);
    for (int n = 0; n < REFERENCE_CASES(2000); n++) {
        for (int i = 0; i < 50; i++)
            whole += frame_receive(&reader, reference_random(&seed) % 256u) == FRAME_WHOLE;
        frame_receive(&reader, 0);
        TEST_ASSERT_EQUAL(FRAME_WHOLE, receive(&reader, frame.byte, frame.length));
    }
    /* 100000 bytes hold some 400 runs of three bytes and more: by chance one in 65536 is valid */
    TEST_ASSERT_EQUAL_INT(0, whole);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(crc_is_that_of_the_polynomial);
    RUN_TEST(crc_of_the_check_string);
    RUN_TEST(crc_takes_eight_bits_of_a_byte);
    RUN_TEST(wire_format_by_hand);
    RUN_TEST(numbers_are_little_endian);
    RUN_TEST(any_content_comes_through);
    RUN_TEST(content_that_does_not_fit_is_not_sent);
    RUN_TEST(longer_frames_than_the_reader_holds_are_broken);
    RUN_TEST(a_longer_frame_is_not_taken_for_its_beginning);
    RUN_TEST(endless_bytes_without_a_delimiter_do_no_harm);
    RUN_TEST(empty_frames_are_nothing);
    RUN_TEST(a_byte_has_eight_bits);
    RUN_TEST(every_damaged_byte_is_found);
    RUN_TEST(every_lost_or_doubled_byte_is_found);
    RUN_TEST(a_frame_cut_short_does_not_harm_the_next);
    RUN_TEST(noise_makes_no_frame_and_the_frame_after_it_comes_through);
    return UNITY_END();
}
