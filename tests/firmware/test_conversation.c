/* The transcript link_conversation.txt, played to the robot word for word. The assembler puts it
 * into the program: a processor without an operating system has no files. */
#include <ctype.h>
#include <stdlib.h>
#include <string.h>
#include <unity.h>

#include "tests/firmware/robot_bench.h"

__asm__(
    ".section .rodata\n"
    ".global transcript\n"
    "transcript: .incbin \"" OMNISLIP_CONVERSATION
    "\"\n"
    ".byte 0\n"
    ".previous\n");
extern const char transcript[];

static robot_bench bench;

void setUp(void) {
    robot_bench_reset(&bench);
}
void tearDown(void) {
    TEST_ASSERT_EQUAL_UINT32(0, bench.overflowed);
}

/* Bytes of hexadecimal text up to the end of the line; their number. */
static size_t read_hex(const char *text, uint16_t *byte) {
    size_t bytes = 0;
    char *end;
    for (;;) {
        while (isspace((unsigned char)*text))
            text++;
        if (*text == 0)
            return bytes;
        byte[bytes++] = (uint16_t)strtoul(text, &end, 16);
        TEST_ASSERT_TRUE_MESSAGE(end == text + 2, text);
        text = end;
    }
}

static void play_line(const char *line) {
    uint16_t byte[256];
    const char *wire = strchr(line, '|');
    if (line[0] == '#' || !wire)
        return;
    const size_t bytes = read_hex(wire + 1, byte);
    if (strncmp(line, "host ", 5) == 0) {
        robot_bench_send(&bench, byte, bytes);
        while (bench.to_robot_out < bench.to_robot_in)
            robot_bench_tick(&bench);
        return;
    }
    TEST_ASSERT_EQUAL_INT_MESSAGE(0, strncmp(line, "robot ", 6), line);
    for (int n = 0; n < 100 && bench.from_robot_in - bench.from_robot_out < bytes; n++)
        robot_bench_tick(&bench);
    TEST_ASSERT_TRUE_MESSAGE(bench.from_robot_in - bench.from_robot_out >= bytes, line);
    for (size_t i = 0; i < bytes; i++)
        TEST_ASSERT_EQUAL_HEX8_MESSAGE(byte[i], bench.from_robot[bench.from_robot_out++], line);
}

static void the_robot_keeps_to_the_transcript(void) {
    static char line[512];
    const char *text = transcript;
    int lines = 0;
    robot_bench_start(&bench);
    while (*text) {
        const size_t length = strcspn(text, "\n");
        TEST_ASSERT_TRUE(text[length] == '\n' && length < sizeof line);
        memcpy(line, text, length);
        line[length] = 0;
        play_line(line);
        text += length + 1;
        lines++;
    }
    TEST_ASSERT_TRUE(lines > 20);
    TEST_ASSERT_EQUAL_INT(bench.from_robot_in, bench.from_robot_out);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(the_robot_keeps_to_the_transcript);
    return UNITY_END();
}
