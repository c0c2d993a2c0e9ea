/* libFuzzer: whatever comes over the line, in whatever order with ticks and faults of the board.
 *
 * The input is a program of one-byte instructions. Besides raw bytes it sends requests in valid
 * frames, since no fuzzer guesses a CRC. Sanitizers watch the arithmetic of the whole firmware; in
 * every tick must hold: a duty only in DRIVE with the bridges on, parameters within their limits,
 * no byte written without space, no more than 16 read, every frame sent is valid.
 */
#include <stdio.h>
#include <stdlib.h>

#include "tests/firmware/robot_bench.h"

static robot_bench bench;
static unsigned sequence;

static void require(int condition, const char *rule) {
    if (condition)
        return;
    fprintf(stderr, "fuzz_link: %s\n", rule);
    abort();
}

static void check_parameters(void) {
    parameter_info info;
    for (u16 id = 0; id < PARAMETER_COUNT; id++) {
        const i16 value = bench.r.settings.value[id];
        parameters_describe(id, &info);
        require(value >= info.minimum && value <= info.maximum, "parameter out of its limits");
    }
}

static void tick(void) {
    u16 content[FRAME_CONTENT_MAX];
    const size_t out = bench.to_robot_out;
    robot_bench_tick(&bench);
    require(bench.to_robot_out - out <= LINK_BYTES_PER_TICK, "too many bytes in a tick");
    require(bench.overflowed == 0, "byte written without space");
    require(bench.store.misuses == 0, "store misused");
    for (int i = 0; i < 4; i++) {
        require(bench.duty_q15[i] == 0 ||
                    (bench.r.loop.telemetry.state == SUPERVISOR_STATE_DRIVE && bench.bridges_on),
                "duty outside of DRIVE");
    }
    while (robot_bench_receive(&bench, content) >= 0)
        require(content[0] == LINK_VERSION && content[1] >= LINK_ANSWER, "frame without a header");
    check_parameters();
}

/* The bytes of an argument, as many as there are. */
typedef struct {
    const uint8_t *data;
    size_t left;
} input;

static unsigned next(input *in) {
    if (in->left == 0)
        return 0;
    in->left--;
    return *in->data++;
}

static size_t take(input *in, uint16_t *byte, size_t bytes) {
    size_t taken = 0;
    while (taken < bytes && in->left > 0)
        byte[taken++] = (uint16_t)next(in);
    return taken;
}

static void board_fault(unsigned kind) {
    bench.overruns = kind & 1;
    bench.supply_mv = kind & 2 ? 9000 : 24000;
    bench.line_bytes_per_tick = kind & 4 ? 0.0 : 11.52;
    bench.receive_lost = kind & 8 ? 3 : 0;
    bench.store.writes_until_cut = kind & 16 ? 20 : 0;
    if (kind & 32)
        robot_bench_start(&bench);
}

/* A request of the table with the length it has, and up to 7 bytes more where it may have them. */
static void send_request(input *in, unsigned row, size_t more) {
    static const struct {
        u16 code, bytes, more;
    } table[] = {
#define REQUEST(name, code, bytes, more, fields, answer, description) {code, bytes, more},
#include "firmware/messages.def"
    };
    const size_t rows = sizeof table / sizeof *table;
    uint16_t content[FRAME_CONTENT_MAX] = {LINK_VERSION, table[row % rows].code, sequence++ & 0xFF};
    const size_t bytes = table[row % rows].bytes + (table[row % rows].more > 0 ? more : 0);
    take(in, content + 3, bytes);
    robot_bench_send_content(&bench, content, 3 + bytes);
    tick();
}

static void carry_out(unsigned instruction, input *in) {
    uint16_t byte[64];
    const size_t length = instruction & 31;
    switch (instruction >> 5) {
        case 0:
            robot_bench_send(&bench, byte, take(in, byte, length));
            break;
        case 1: /* a frame of any version and length */
            robot_bench_send_content(&bench, byte, take(in, byte, length));
            break;
        case 2:
            board_fault(next(in));
            break;
        case 3:
            for (size_t n = 0; n < length; n++)
                tick();
            break;
        default:
            send_request(in, length, instruction >> 5 & 3);
            break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    input in = {data, size};
    int instructions = 0;
    sequence = 0;
    robot_bench_reset(&bench);
    robot_bench_start(&bench);
    tick();
    while (in.left > 0 && instructions++ < 200)
        carry_out(next(&in), &in);
    for (int n = 0; n < 20; n++)
        tick();
    return 0;
}
