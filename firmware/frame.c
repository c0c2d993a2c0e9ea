/* Frames on the serial line; format in frame.h. */
#include "firmware/frame.h"

#include "hal/hal.h"

#define BYTE 0xFFU

/* The eight steps of a byte at once. The bits that leave at the top, q, put 1021h q below; bits of
 * q that tap 12 sends back to the top are the upper four once more: q = t ^ (t >> 4). */
u16 frame_crc(u16 crc, u16 byte) {
    u16 q = (u16)((crc >> 8) ^ (byte & BYTE));
    q = (u16)(q ^ (q >> 4));
    return (u16)((u16)(crc << 8) ^ (u16)(q << 12) ^ (u16)(q << 5) ^ q);
}

u16 frame_crc_u16(u16 crc, u16 word) {
    return frame_crc(frame_crc(crc, word), (u16)(word >> 8));
}

/* ---- Sending ---- */

/* byte[0] is kept free for the first distance, the content stands behind it. */
#define TOO_LONG (FRAME_CONTENT_MAX + 1)

void frame_begin(frame_writer *frame) {
    frame->length = 0;
}

u16 frame_add_u8(frame_writer *frame, u16 value) {
    if (frame->length < TOO_LONG)
        frame->length++;
    frame->byte[frame->length] = value & BYTE;
    return frame->length;
}

void frame_add_u16(frame_writer *frame, u16 value) {
    frame_add_u8(frame, value);
    frame_add_u8(frame, (u16)(value >> 8));
}

void frame_add_u32(frame_writer *frame, u32 value) {
    frame_add_u16(frame, (u16)(value & U16_MAX));
    frame_add_u16(frame, (u16)(value >> 16));
}

static void append_crc(frame_writer *frame) {
    u16 crc = FRAME_CRC_START;
    u16 i;
    for (i = 1; i <= frame->length; i++)
        crc = frame_crc(crc, frame->byte[i]);
    frame->byte[++frame->length] = crc & BYTE;
    frame->byte[++frame->length] = crc >> 8;
}

void frame_finish(frame_writer *frame) {
    u16 next_zero, i;
    if (frame->length == TOO_LONG || frame->length == 0) {
        frame->length = 0;
        return;
    }
    append_crc(frame);
    next_zero = (u16)(frame->length + 1);
    frame->byte[next_zero] = 0; /* the delimiter */
    for (i = frame->length; i > 0; i--) {
        if (frame->byte[i] == 0) {
            frame->byte[i] = (u16)(next_zero - i);
            next_zero = i;
        }
    }
    frame->byte[0] = next_zero;
    frame->length = (u16)(frame->length + 2);
}

u16 frame_send(frame_writer *frame, u16 leave_free) {
    u16 i;
    frame_finish(frame);
    if (frame->length == 0 || hal_serial_space() < frame->length + leave_free)
        return 0;
    for (i = 0; i < frame->length; i++)
        hal_serial_write(frame->byte[i]);
    return 1;
}

/* ---- Receiving ---- */

void frame_reader_reset(frame_reader *frame) {
    frame->length = 0;
    frame->until_zero = 0;
    frame->inside = 0;
    frame->too_long = 0;
}

static void keep(frame_reader *frame, u16 byte) {
    if (frame->length < FRAME_RECEIVE_MAX + 2) {
        frame->byte[frame->length++] = byte;
    } else {
        frame->too_long = 1;
    }
}

static frame_status check(frame_reader *frame) {
    u16 crc = FRAME_CRC_START;
    u16 i;
    if (frame->too_long || frame->until_zero != 0 || frame->length < 3)
        return FRAME_BROKEN;
    frame->length = (u16)(frame->length - 2);
    for (i = 0; i < frame->length; i++)
        crc = frame_crc(crc, frame->byte[i]);
    return crc == frame_u16(&frame->byte[frame->length]) ? FRAME_WHOLE : FRAME_BROKEN;
}

frame_status frame_receive(frame_reader *frame, u16 byte) {
    const u16 inside = frame->inside;
    byte &= BYTE;
    frame->inside = byte != 0;
    if (byte == 0)
        return inside ? check(frame) : FRAME_PENDING;
    if (!inside) {
        frame->length = 0;
        frame->too_long = 0;
        frame->until_zero = (u16)(byte - 1);
    } else if (frame->until_zero == 0) {
        keep(frame, 0);
        frame->until_zero = (u16)(byte - 1);
    } else {
        keep(frame, byte);
        frame->until_zero--;
    }
    return FRAME_PENDING;
}

u16 frame_u16(const u16 *byte) {
    return (u16)(byte[0] | (u16)(byte[1] << 8));
}

u32 frame_u32(const u16 *byte) {
    return frame_u16(byte) | (u32)frame_u16(byte + 2) << 16;
}

i16 frame_i16(const u16 *byte) {
    return (i16)frame_u16(byte);
}

i32 frame_i32(const u16 *byte) {
    return (i32)frame_u32(byte);
}
