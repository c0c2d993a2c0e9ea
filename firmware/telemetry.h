/* What the robot tells unasked: streams of signals that a host has chosen, and events.
 *
 * A stream sends its signals (telemetry.def) every period_ms, in the order asked for. A frame goes
 * out only if TELEMETRY_LEAVE_FREE bytes stay free for answers, one frame a tick at most; streams
 * take turns. A sample that has found no space when the next is due is counted as lost, and its
 * sequence number is skipped, so the host sees the gap.
 *
 * Bytes of a stream: (7 + bytes of its signals) * 1000 / period_ms per second; the line carries
 * 11520. A log (time, four duty_sum, four counts, supply, four currents: 38 bytes) every 5 ms takes
 * 9000 of them.
 *
 * Events compare the present state with the one last told, so none waits in a queue: of changes
 * faster than the line only the last is told.
 */
#ifndef FIRMWARE_TELEMETRY_H
#define FIRMWARE_TELEMETRY_H

#include "firmware/control_loop.h"
#include "firmware/frame.h"
#include "firmware/parameter_store.h"

#define TELEMETRY_STREAMS 3
#define TELEMETRY_SIGNALS_MAX 20
#define TELEMETRY_LEAVE_FREE 32
#define TELEMETRY_LIMIT_PERIOD_MS 50

#ifdef __cplusplus
extern "C" {
#endif

#define SIGNAL(name, type, unit, q_bits, expression, description) SIGNAL_ID_##name,
typedef enum {
#include "firmware/telemetry.def"
    SIGNAL_COUNT
} signal_id;
#undef SIGNAL

typedef struct {
    u16 signal[TELEMETRY_SIGNALS_MAX];
    u16 signals;
    u16 period_ms; /* 0: off */
    u16 age_ms;    /* since a sample was last due */
    u16 due;
    u16 sequence;
} telemetry_stream;

typedef struct {
    u16 bad_frames;
    u16 bytes_lost;
    u16 answers_lost;
    u16 samples_lost;
} telemetry_counters;

typedef struct {
    const control_loop *loop;
    const parameter_store *store;
    frame_writer *frame;
    /* CRC-16 (frame.h) over telemetry.def, per line in order: length of name, length of unit, bytes
     * of the type, q_bits; a byte each. */
    u16 table;
    u32 time_ms;
    u32 duty_sum_q15[WHEEL_COUNT];
    telemetry_counters counters;
    telemetry_stream stream[TELEMETRY_STREAMS];
    u16 turn;
    u16 event_sequence;
    u16 boot_told;
    u16 state_told[3];
    u16 limit_told[2];
    u16 limit_age_ms;
    u16 store_told;
} telemetry;

typedef enum { TELEMETRY_OK = 0, TELEMETRY_UNKNOWN_ID, TELEMETRY_TOO_LONG } telemetry_status;

/* Keeps the pointers; `frame` is working space. */
void telemetry_init(telemetry *t, const control_loop *loop, const parameter_store *store,
                    frame_writer *frame);
/* Replaces a stream; period_ms 0 or no signals end it. Other than TELEMETRY_OK changes nothing. */
telemetry_status telemetry_set_stream(telemetry *t, u16 stream, u16 period_ms, const u16 *signal,
                                      u16 signals);
/* Once a tick, after the control loop. */
void telemetry_tick(telemetry *t);

#ifdef __cplusplus
}
#endif

#endif
