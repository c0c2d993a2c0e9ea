/* The protocol between a host and the robot. This header and messages.def are its specification;
 * frames (CRC, COBS) are specified in frame.h, streams and signals in telemetry.h and
 * telemetry.def.
 *
 * Serial line 115200 baud, 8 data bits, no parity, 1 stop bit. Contents of frames, all numbers
 * little-endian:
 *
 *     host:   version, code, sequence, fields
 *     robot:  version, LINK_ANSWER,    sequence of the request, code of the request, result, fields
 *             version, LINK_EVENT,     sequence, code of the event, fields
 *             version, LINK_TELEMETRY + stream, sequence, signals
 *
 * One byte each up to the fields. version is LINK_VERSION.
 *
 * Requests. Every valid frame of a host is answered once, with a result of messages.def; fields
 * follow only after ACCEPTED. A frame that is not valid is counted and not answered: what is
 * damaged has no sequence number that could be trusted. Other than ACCEPTED, nothing has changed.
 *
 * Repetitions. A host numbers its requests, one more each time, and has at most one unanswered that
 * it would send again. The same frame sent again, after an answer that did not come, is answered
 * again but not carried out: neither does a correction of the pose count twice, nor does a late
 * copy clear a fault that nobody has seen. Same means same sequence number and same CRC. Requests
 * below 10h only read and are always carried out. `identify` forgets the last request: a new host
 * sends a delimiter and `identify` before anything else.
 *
 * A command to drive is kept alive by sending it again with a new sequence number; a repetition is
 * not a new command and does not make the old one younger.
 *
 * Sequences of the robot. Each stream and the events have their own; they skip the samples that
 * found no space, so any gap is a loss. They wrap at 256.
 *
 * Time. Received bytes are handled in the tick, LINK_BYTES_PER_TICK at most; the line brings 11.6.
 * An answer leaves in the tick that completes the request. One that finds no space is lost
 * (answers_lost); telemetry leaves space for it.
 *
 * Safety. Nothing is done with a frame before all of it has come and its CRC is right; then its
 * version, its length and the limits of its fields are checked, and only then the state is asked.
 */
#ifndef FIRMWARE_LINK_H
#define FIRMWARE_LINK_H

#include "firmware/control_loop.h"
#include "firmware/frame.h"
#include "firmware/parameter_store.h"
#include "firmware/telemetry.h"

#define LINK_VERSION 1
#define LINK_ANSWER 0x80
#define LINK_EVENT 0x81
#define LINK_TELEMETRY 0x90
#define LINK_HEADER_BYTES 3
#define LINK_BYTES_PER_TICK 16

#ifdef __cplusplus
extern "C" {
#endif

#define RESULT(name, description) LINK_RESULT_##name,
typedef enum {
#include "firmware/messages.def"
    LINK_RESULT_COUNT
} link_result;

/* What the requests act on. */
typedef struct {
    parameters *settings;
    control_loop *loop;
    parameter_store *store;
    telemetry *told;
    frame_writer *frame; /* working space */
} link_parts;

typedef struct {
    link_parts parts;
    frame_reader reader;
    u16 known; /* 1: the three below are of the last request carried out */
    u16 last_sequence;
    u16 last_crc;
    link_result last_result;
} link_state;

void link_init(link_state *link, const link_parts *parts);
/* Once a tick, before the control loop: reads what has come and answers. */
void link_tick(link_state *link);

/* Starts a content: version, kind, sequence. */
void link_begin(frame_writer *frame, u16 kind, u16 sequence);

#ifdef __cplusplus
}
#endif

#endif
