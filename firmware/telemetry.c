/* Streams and events; rules in telemetry.h, layout of the frames in link.h. */
#include "firmware/telemetry.h"

#include "firmware/link.h"

/* The codes of events, and how many bytes one has. */
#define EVENT(name, code, fields, description) EVENT_##name = (code),
enum {
#include "firmware/messages.def"
    EVENT_NONE = 0
};

/* ---- Signals ---- */

#define BYTES_u16 2
#define BYTES_i16 2
#define BYTES_u32 4
#define BYTES_i32 4

/* sizeof does not evaluate: the text takes no memory. */
#define TEXT_LENGTH(text) ((u16)(sizeof(#text) - 1U))

static u16 signal_bytes(u16 id) {
    switch (id) {
#define SIGNAL(name, type, unit, q_bits, expression, description) \
    case SIGNAL_ID_##name:                                        \
        return BYTES_##type;
#include "firmware/telemetry.def"
#undef SIGNAL
        default:
            return 0;
    }
}

static u32 signal_value(const telemetry *t, u16 id) {
    const control_loop_telemetry *control = &t->loop->telemetry;
    switch (id) {
#define SIGNAL(name, type, unit, q_bits, expression, description) \
    case SIGNAL_ID_##name:                                        \
        return (u32)(type)(expression);
#include "firmware/telemetry.def"
#undef SIGNAL
        default:
            return 0;
    }
}

/* CRC of the table, as telemetry.h says. */
static u16 fingerprint(void) {
    u16 crc = FRAME_CRC_START;
#define SIGNAL(name, type, unit, q_bits, expression, description)          \
    crc = frame_crc(frame_crc(crc, TEXT_LENGTH(name)), TEXT_LENGTH(unit)); \
    crc = frame_crc(frame_crc(crc, BYTES_##type), (q_bits));
#include "firmware/telemetry.def"
#undef SIGNAL
    return crc;
}

/* ---- Streams ---- */

telemetry_status telemetry_set_stream(telemetry *t, u16 stream, u16 period_ms, const u16 *signal,
                                      u16 signals) {
    telemetry_stream *target;
    u16 bytes = LINK_HEADER_BYTES;
    u16 i;
    if (stream >= TELEMETRY_STREAMS)
        return TELEMETRY_UNKNOWN_ID;
    if (signals > TELEMETRY_SIGNALS_MAX)
        return TELEMETRY_TOO_LONG;
    for (i = 0; i < signals; i++) {
        if (signal[i] >= SIGNAL_COUNT)
            return TELEMETRY_UNKNOWN_ID;
        bytes = (u16)(bytes + signal_bytes(signal[i]));
    }
    if (bytes > FRAME_CONTENT_MAX)
        return TELEMETRY_TOO_LONG;
    target = &t->stream[stream];
    for (i = 0; i < signals; i++)
        target->signal[i] = signal[i];
    target->signals = signals;
    target->period_ms = signals == 0 ? 0 : period_ms;
    target->age_ms = 0;
    target->due = 0;
    return TELEMETRY_OK;
}

static void advance(telemetry *t, telemetry_stream *stream) {
    if (stream->period_ms == 0)
        return;
    stream->age_ms++;
    if (stream->age_ms < stream->period_ms)
        return;
    stream->age_ms = 0;
    if (stream->due) {
        stream->sequence++;
        t->counters.samples_lost++;
    }
    stream->due = 1;
}

/* 1 when a frame has gone out. */
static u16 send_sample(telemetry *t, u16 index) {
    telemetry_stream *stream = &t->stream[index];
    u16 i;
    if (!stream->due)
        return 0;
    link_begin(t->frame, (u16)(LINK_TELEMETRY + index), stream->sequence);
    for (i = 0; i < stream->signals; i++) {
        const u16 id = stream->signal[i];
        const u32 value = signal_value(t, id);
        if (signal_bytes(id) == 4) {
            frame_add_u32(t->frame, value);
        } else {
            frame_add_u16(t->frame, (u16)(value & U16_MAX));
        }
    }
    if (!frame_send(t->frame, TELEMETRY_LEAVE_FREE))
        return 0;
    stream->due = 0;
    stream->sequence++;
    return 1;
}

static void send_streams(telemetry *t) {
    u16 n;
    for (n = 0; n < TELEMETRY_STREAMS; n++) {
        const u16 index = t->turn;
        t->turn = (u16)((t->turn + 1) % TELEMETRY_STREAMS);
        if (send_sample(t, index))
            return;
    }
}

/* ---- Events ---- */

static u16 send_event(telemetry *t, u16 code, const u16 *field, u16 fields) {
    u16 i;
    link_begin(t->frame, LINK_EVENT, t->event_sequence);
    frame_add_u8(t->frame, code);
    frame_add_u32(t->frame, t->time_ms);
    for (i = 0; i < fields; i++)
        frame_add_u8(t->frame, field[i]);
    if (!frame_send(t->frame, TELEMETRY_LEAVE_FREE))
        return 0;
    t->event_sequence++;
    return 1;
}

/* Tells the fields if they differ from those told; 1 when an event has gone out. */
static u16 tell_change(telemetry *t, u16 code, const u16 *field, u16 *told, u16 fields) {
    u16 i;
    u16 changed = 0;
    for (i = 0; i < fields; i++)
        changed |= field[i] != told[i];
    if (!changed || !send_event(t, code, field, fields))
        return 0;
    for (i = 0; i < fields; i++)
        told[i] = field[i];
    return 1;
}

static u16 tell_boot(telemetry *t) {
    u16 field[2];
    if (t->boot_told)
        return 0;
    field[0] = (u16)hal_read_reset_cause();
    field[1] = t->store_told;
    t->boot_told = send_event(t, EVENT_boot, field, 2);
    return t->boot_told;
}

static u16 tell_state(telemetry *t) {
    const control_loop_telemetry *control = &t->loop->telemetry;
    u16 field[3];
    field[0] = (u16)control->state;
    field[1] = (u16)control->fault;
    field[2] = control->fault_wheel;
    return tell_change(t, EVENT_state, field, t->state_told, 3);
}

static u16 tell_store(telemetry *t) {
    const u16 status = (u16)t->store->status;
    return tell_change(t, EVENT_store, &status, &t->store_told, 1);
}

static u16 tell_limit(telemetry *t) {
    u16 field[2];
    if (t->limit_age_ms < TELEMETRY_LIMIT_PERIOD_MS) {
        t->limit_age_ms++;
        return 0;
    }
    field[0] = (u16)t->loop->telemetry.limit;
    field[1] = t->loop->telemetry.limit_wheel;
    if (!tell_change(t, EVENT_limit, field, t->limit_told, 2))
        return 0;
    t->limit_age_ms = 0;
    return 1;
}

/* ---- Both ---- */

void telemetry_init(telemetry *t, const control_loop *loop, const parameter_store *store,
                    frame_writer *frame) {
    u16 i;
    t->loop = loop;
    t->store = store;
    t->frame = frame;
    t->table = fingerprint();
    t->time_ms = 0;
    t->counters.bad_frames = 0;
    t->counters.bytes_lost = 0;
    t->counters.answers_lost = 0;
    t->counters.samples_lost = 0;
    for (i = 0; i < WHEEL_COUNT; i++)
        t->duty_sum_q15[i] = 0;
    for (i = 0; i < TELEMETRY_STREAMS; i++) {
        t->stream[i].sequence = 0;
        telemetry_set_stream(t, i, 0, 0, 0);
    }
    t->turn = 0;
    t->event_sequence = 0;
    t->boot_told = 0;
    for (i = 0; i < 3; i++)
        t->state_told[i] = 0;
    t->limit_told[0] = 0;
    t->limit_told[1] = 0;
    t->limit_age_ms = 0;
    t->store_told = (u16)store->status;
}

void telemetry_tick(telemetry *t) {
    u16 i;
    for (i = 0; i < TELEMETRY_STREAMS; i++)
        advance(t, &t->stream[i]);
    if (!tell_boot(t) && !tell_state(t) && !tell_store(t) && !tell_limit(t))
        send_streams(t);
    for (i = 0; i < WHEEL_COUNT; i++) {
        const i32 duty_q15 = t->loop->telemetry.duty_q15[i];
        t->duty_sum_q15[i] = t->duty_sum_q15[i] + (u32)duty_q15;
    }
    t->time_ms++;
}
