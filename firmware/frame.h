/* Frames on the serial line: a content of bytes, guarded by a CRC, framed by COBS.
 *
 *     wire:     COBS(content, CRC low byte, CRC high byte), 00
 *     content:  1 to FRAME_CONTENT_MAX bytes
 *     CRC:      CRC-16/CCITT-FALSE of the content: x^16 + x^12 + x^5 + 1, start FFFFh, most
 *               significant bit first, not inverted; "123456789" gives 29B1h
 *     COBS:     consistent overhead byte stuffing (Cheshire and Baker, 1999). The only zero on the
 *               wire is the delimiter. Each zero of the data is replaced by the distance to the
 *               next one, the first such distance stands in front, the last counts to the
 *               delimiter. A frame is shorter than 254 bytes, so that is the whole rule.
 *
 * An empty frame (two delimiters in a row) is nothing: whoever opens the line sends a delimiter
 * first, which ends what noise may have begun.
 *
 * A byte is a u16 of which the low 8 bits count: char may have 16 bits.
 *
 * Errors: a frame that is too long, cut short, wrongly stuffed or whose CRC does not match is
 * dropped whole; the next delimiter starts afresh. Damage is missed with
 * a probability of about 2^-16.
 */
#ifndef FIRMWARE_FRAME_H
#define FIRMWARE_FRAME_H

#include "firmware/integers.h"

/* Of a frame that is sent; wire length at most FRAME_CONTENT_MAX + FRAME_OVERHEAD. */
#define FRAME_CONTENT_MAX 64
#define FRAME_OVERHEAD 4
/* Of a frame that is received. */
#define FRAME_RECEIVE_MAX 32

#define FRAME_CRC_START 0xFFFFU

#ifdef __cplusplus
extern "C" {
#endif

/* The CRC of the bytes so far and one more. */
u16 frame_crc(u16 crc, u16 byte);
/* The same for a word, low byte first. */
u16 frame_crc_u16(u16 crc, u16 word);

/* ---- Sending ---- */

typedef struct {
    u16 byte[FRAME_CONTENT_MAX + FRAME_OVERHEAD];
    u16 length; /* of the content; after frame_finish of the wire */
} frame_writer;

void frame_begin(frame_writer *frame);
/* Least significant byte first. What does not fit is dropped with the whole frame: frame_finish
 * then leaves length 0. The place of a u8 is its index in `byte`, where it may still be changed. */
u16 frame_add_u8(frame_writer *frame, u16 value);
void frame_add_u16(frame_writer *frame, u16 value);
void frame_add_u32(frame_writer *frame, u32 value);
/* Wire bytes in byte[0 .. length - 1]. */
void frame_finish(frame_writer *frame);
/* Finishes the frame and hands it to the serial line whole, if that leaves this much space there;
 * returns 1 when it was sent, else 0. */
u16 frame_send(frame_writer *frame, u16 leave_free);

/* ---- Receiving ---- */

typedef struct {
    u16 byte[FRAME_RECEIVE_MAX + 2]; /* content, CRC */
    u16 length;     /* of the content once frame_receive has returned FRAME_WHOLE */
    u16 until_zero; /* bytes before the next stuffed zero */
    u16 inside;     /* since the last delimiter a byte has come */
    u16 too_long;
} frame_reader;

typedef enum { FRAME_PENDING = 0, FRAME_WHOLE, FRAME_BROKEN } frame_status;

void frame_reader_reset(frame_reader *frame);
/* Takes the next byte of the wire. FRAME_WHOLE: content in byte[0 .. length - 1], until the next
 * call. FRAME_BROKEN: a frame has ended that is not valid. */
frame_status frame_receive(frame_reader *frame, u16 byte);

/* Little-endian fields of a content. */
u16 frame_u16(const u16 *byte);
u32 frame_u32(const u16 *byte);
i16 frame_i16(const u16 *byte);
i32 frame_i32(const u16 *byte);

#ifdef __cplusplus
}
#endif

#endif
