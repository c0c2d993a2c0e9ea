/* A robot on the bench; see robot_bench.h. */
#include "tests/firmware/robot_bench.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hal/host/hal_host.h"

static const double pi = 3.14159265358979323846;

static void require(int condition, const char *message) {
    if (condition)
        return;
    fprintf(stderr, "robot_bench: %s\n", message);
    abort();
}

static void read_counts(void *context, uint16_t counts[4]) {
    const robot_bench *bench = context;
    for (int i = 0; i < 4; i++)
        counts[i] = (uint16_t)(int32_t)floor(bench->angle_rad[i] / (2.0 * pi) * 2000.0);
}
static void write_duty(void *context, const int16_t duty_q15[4]) {
    memcpy(((robot_bench *)context)->duty_q15, duty_q15, 4 * sizeof *duty_q15);
}
static uint16_t read_supply(void *context) {
    return ((const robot_bench *)context)->supply_mv;
}
static void enable_bridges(void *context, uint16_t on) {
    ((robot_bench *)context)->bridges_on = on;
}
static uint16_t serial_read(void *context, uint16_t *byte) {
    robot_bench *bench = context;
    if (bench->to_robot_out == bench->to_robot_in)
        return 0;
    *byte = bench->to_robot[bench->to_robot_out++];
    return 1;
}
static uint16_t serial_space(void *context) {
    return (uint16_t)(BENCH_SEND_BUFFER - ((const robot_bench *)context)->waiting_bytes);
}
static void serial_write(void *context, uint16_t byte) {
    robot_bench *bench = context;
    if (bench->waiting_bytes == BENCH_SEND_BUFFER) {
        bench->overflowed++;
    } else {
        bench->waiting[bench->waiting_bytes++] = byte & 0xFF;
    }
}
static uint16_t serial_lost(void *context) {
    robot_bench *bench = context;
    const uint16_t lost = bench->receive_lost;
    bench->receive_lost = 0;
    return lost;
}
static uint16_t store_busy(void *context) {
    return hal_host_store_busy(&((robot_bench *)context)->store);
}
static uint16_t store_read(void *context, uint16_t address) {
    return hal_host_store_read(&((robot_bench *)context)->store, address);
}
static void store_write(void *context, uint16_t address, uint16_t word) {
    hal_host_store_write(&((robot_bench *)context)->store, address, word);
}
static uint16_t read_reset_cause(void *context) {
    return ((const robot_bench *)context)->reset_cause;
}
static void service_watchdog(void *context) {
    ((robot_bench *)context)->services++;
}
static uint16_t read_overruns(void *context) {
    robot_bench *bench = context;
    const uint16_t overruns = bench->overruns;
    bench->overruns = 0;
    return overruns;
}

void robot_bench_reset(robot_bench *bench) {
    const hal_host_plant plant = {.context = bench,
                                  .read_encoder_counts = read_counts,
                                  .write_duty = write_duty,
                                  .read_supply_mv = read_supply,
                                  .enable_bridges = enable_bridges,
                                  .serial_read = serial_read,
                                  .serial_space = serial_space,
                                  .serial_write = serial_write,
                                  .serial_lost = serial_lost,
                                  .store_busy = store_busy,
                                  .store_read = store_read,
                                  .store_write = store_write,
                                  .read_reset_cause = read_reset_cause,
                                  .service_watchdog = service_watchdog,
                                  .read_tick_overruns = read_overruns};
    memset(bench, 0, sizeof *bench);
    memset(&bench->r, 0xA5, sizeof bench->r); /* memory after a reset holds anything */
    hal_host_store_blank(&bench->store, 5);
    bench->supply_mv = 24000;
    bench->line_bytes_per_tick = 11.52;
    hal_host_attach(&plant);
}

void robot_bench_start(robot_bench *bench) {
    robot_init(&bench->r);
}

static void turn_wheels(robot_bench *bench) {
    for (int i = 0; i < 4; i++) {
        const double no_load_rad_s = bench->duty_q15[i] / 32768.0 * 941.0;
        bench->shaft_rad_s[i] += (no_load_rad_s - bench->shaft_rad_s[i]) * 0.001 / 0.2;
        bench->angle_rad[i] += bench->shaft_rad_s[i] * 0.001;
    }
}

static void run_line(robot_bench *bench) {
    bench->line_credit += bench->line_bytes_per_tick;
    while (bench->line_credit >= 1.0) {
        bench->line_credit -= 1.0;
        if (bench->waiting_bytes == 0)
            continue;
        if (bench->from_robot_out == bench->from_robot_in)
            bench->from_robot_out = bench->from_robot_in = 0;
        require(bench->from_robot_in < BENCH_LINE_BYTES, "the line from the robot is full");
        bench->from_robot[bench->from_robot_in++] = (uint8_t)bench->waiting[0];
        bench->waiting_bytes--;
        memmove(bench->waiting, bench->waiting + 1, bench->waiting_bytes * sizeof *bench->waiting);
    }
}

void robot_bench_tick(robot_bench *bench) {
    robot_tick(&bench->r);
    turn_wheels(bench);
    run_line(bench);
}

void robot_bench_ticks(robot_bench *bench, int ticks) {
    for (int n = 0; n < ticks; n++)
        robot_bench_tick(bench);
}

void robot_bench_send(robot_bench *bench, const uint16_t *byte, size_t bytes) {
    if (bench->to_robot_out == bench->to_robot_in)
        bench->to_robot_out = bench->to_robot_in = 0;
    require(bench->to_robot_in + bytes <= BENCH_LINE_BYTES, "the line to the robot is full");
    for (size_t i = 0; i < bytes; i++)
        bench->to_robot[bench->to_robot_in++] = (uint8_t)byte[i];
}

void robot_bench_send_content(robot_bench *bench, const uint16_t *content, size_t bytes) {
    frame_writer frame;
    frame_begin(&frame);
    for (size_t i = 0; i < bytes; i++)
        frame_add_u8(&frame, content[i]);
    frame_finish(&frame);
    robot_bench_send(bench, frame.byte, frame.length);
}

/* Unstuffs by copying zeros forward, unlike the firmware's reader, and checks the CRC bit by bit.
 */
int robot_bench_receive(robot_bench *bench, uint16_t content[FRAME_CONTENT_MAX]) {
    static const char damaged[] = "the robot has sent a damaged frame";
    const uint8_t *wire = bench->from_robot + bench->from_robot_out;
    size_t end = 0, zero;
    uint32_t crc = 0xFFFF;
    while (bench->from_robot_out + end < bench->from_robot_in && wire[end] != 0)
        end++;
    if (bench->from_robot_out + end >= bench->from_robot_in)
        return -1;
    bench->from_robot_out += end + 1;
    require(end >= 4 && end - 3 <= FRAME_CONTENT_MAX, damaged);
    uint16_t plain[FRAME_CONTENT_MAX + 3];
    for (size_t i = 0; i < end; i++)
        plain[i] = wire[i];
    for (zero = 0; zero < end;) {
        const size_t next = zero + wire[zero];
        plain[zero] = 0;
        zero = next;
    }
    require(zero == end, damaged);
    for (size_t i = 1; i < end - 2; i++) {
        crc ^= (uint32_t)plain[i] << 8;
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 0x8000 ? (crc << 1 ^ 0x1021) & 0xFFFF : crc << 1;
        content[i - 1] = plain[i];
    }
    require(crc == (uint32_t)(plain[end - 2] | plain[end - 1] << 8), damaged);
    return (int)end - 3;
}
