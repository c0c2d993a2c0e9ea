/* A robot on the bench: the firmware's `robot` on a host HAL whose serial line, store, bridges and
 * wheels the test holds in its hands.
 *
 * Wheels are motors with a flywheel, W' = (941 rad/s * duty - W) / 0.2 s: they do what they are
 * told, which is all these tests ask of them. The line takes `line_bytes_per_tick` from the
 * transmit buffer, kept apart into frames by the zeros.
 */
#ifndef TESTS_FIRMWARE_ROBOT_BENCH_H
#define TESTS_FIRMWARE_ROBOT_BENCH_H

#include <stddef.h>

#include "firmware/robot.h"
#include "hal/host/hal_host_store.h"

#define BENCH_SEND_BUFFER 128
/* Bytes that wait on either side to be taken; an AVR has 16 KiB for everything. */
#if INT_MAX == 32767
#define BENCH_LINE_BYTES 1536
#else
#define BENCH_LINE_BYTES 32768
#endif

typedef struct {
    robot r;
    hal_host_store store;
    double shaft_rad_s[4];
    double angle_rad[4];
    int16_t duty_q15[4];
    uint16_t supply_mv;
    uint16_t bridges_on;
    uint16_t reset_cause;
    uint16_t overruns;
    uint16_t receive_lost;
    uint32_t services; /* of the watchdog */
    /* Host to robot. */
    uint8_t to_robot[BENCH_LINE_BYTES];
    size_t to_robot_in, to_robot_out;
    /* Robot to host: what waits, and what the line has delivered. */
    double line_bytes_per_tick;
    double line_credit;
    uint16_t waiting[BENCH_SEND_BUFFER];
    size_t waiting_bytes;
    uint32_t overflowed; /* bytes written without space: mistakes of the firmware */
    uint8_t from_robot[BENCH_LINE_BYTES];
    size_t from_robot_in, from_robot_out;
} robot_bench;

/* A blank store, 24 V, the line at 115200 baud; attached to this thread, not yet started. */
void robot_bench_reset(robot_bench *bench);
/* robot_init, as after a reset: store and wheels stay as they are. */
void robot_bench_start(robot_bench *bench);
/* One tick of the firmware, then 1 ms of wheels and line. */
void robot_bench_tick(robot_bench *bench);
void robot_bench_ticks(robot_bench *bench, int ticks);

/* Puts bytes on the line to the robot. */
void robot_bench_send(robot_bench *bench, const uint16_t *byte, size_t bytes);
/* The same for a frame with this content, which may be of any version, code and length. */
void robot_bench_send_content(robot_bench *bench, const uint16_t *content, size_t bytes);
/* Takes the next whole frame that the robot has sent; its content and length, -1 when there is
 * none. A damaged frame ends the program: the robot must not send one. */
int robot_bench_receive(robot_bench *bench, uint16_t content[FRAME_CONTENT_MAX]);

#endif
