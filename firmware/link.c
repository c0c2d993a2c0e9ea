/* Requests of a host; the protocol is specified in link.h. */
#include "firmware/link.h"

#define FIRST_CODE_THAT_ACTS 0x10U
#define HALF_TURN_MRAD_Q13 (ODOMETRY_FULL_TURN_MRAD_Q13 / 2)

#define REQUEST(name, code, bytes, more, fields, answer, description) REQUEST_##name = (code),
enum {
#include "firmware/messages.def"
    REQUEST_NONE = 0
};

/* An id of a parameter or a signal is one byte. */
typedef int link_ids_fit_a_byte[(PARAMETER_COUNT <= 256 && SIGNAL_COUNT <= 256) * 2 - 1];

void link_begin(frame_writer *frame, u16 kind, u16 sequence) {
    frame_begin(frame);
    frame_add_u8(frame, LINK_VERSION);
    frame_add_u8(frame, kind);
    frame_add_u8(frame, sequence);
}

typedef struct {
    u16 code;
    u16 sequence;
    u16 crc;
    const u16 *field;
    u16 bytes; /* of the fields */
} request;

/* ---- What each request does; its length has been checked ---- */

static link_result granted(u16 allowed) {
    return allowed ? LINK_RESULT_ACCEPTED : LINK_RESULT_STATE;
}

static u16 within_half_turn(i32 theta_mrad_q13) {
    return theta_mrad_q13 >= -HALF_TURN_MRAD_Q13 && theta_mrad_q13 <= HALF_TURN_MRAD_Q13;
}

/* A load changes the parameters tick by tick: until it is done nothing may start to drive. */
static u16 loading(const link_parts *parts) {
    return parts->store->status == PARAMETER_STORE_LOADING;
}

/* ...reading */

static link_result handle_identify(link_state *link, const request *r) {
    frame_writer *frame = link->parts.frame;
    (void)r;
    link->known = 0;
    frame_add_u8(frame, PARAMETER_COUNT);
    frame_add_u16(frame, link->parts.store->table);
    frame_add_u8(frame, SIGNAL_COUNT);
    frame_add_u16(frame, link->parts.told->table);
    frame_add_u8(frame, (u16)hal_read_reset_cause());
    frame_add_u8(frame, (u16)link->parts.store->status);
    frame_add_u32(frame, link->parts.told->time_ms);
    return LINK_RESULT_ACCEPTED;
}

static link_result handle_parameter_get(link_state *link, const request *r) {
    i32 value = 0;
    if (parameters_get(link->parts.settings, r->field[0], &value) != PARAMETERS_OK)
        return LINK_RESULT_ID;
    frame_add_u16(link->parts.frame, (u16)value);
    return LINK_RESULT_ACCEPTED;
}

static link_result handle_parameter_describe(link_state *link, const request *r) {
    frame_writer *frame = link->parts.frame;
    parameter_info info;
    if (r->field[0] >= PARAMETER_COUNT)
        return LINK_RESULT_ID;
    parameters_describe(r->field[0], &info);
    frame_add_u16(frame, (u16)link->parts.settings->value[r->field[0]]);
    frame_add_u16(frame, (u16)info.minimum);
    frame_add_u16(frame, (u16)info.maximum);
    frame_add_u16(frame, (u16)info.initial);
    frame_add_u8(frame, info.q_bits);
    frame_add_u8(frame, r->field[0] >= PARAMETER_FIRST_TUNABLE);
    return LINK_RESULT_ACCEPTED;
}

/* ...driving */

static link_result handle_velocity(link_state *link, const request *r) {
    if (loading(&link->parts))
        return LINK_RESULT_BUSY;
    return granted(control_loop_command_velocity(link->parts.loop, frame_i16(r->field),
                                                 frame_i16(r->field + 2), frame_i16(r->field + 4)));
}

static void read_pose(const u16 *field, odometry_pose *pose) {
    pose->x_mm_q13 = frame_i32(field);
    pose->y_mm_q13 = frame_i32(field + 4);
    pose->theta_mrad_q13 = frame_i32(field + 8);
}

static link_result handle_pose(link_state *link, const request *r) {
    odometry_pose goal;
    kinematics_velocity arrival;
    read_pose(r->field, &goal);
    arrival.x_m_s_q13 = frame_i16(r->field + 12);
    arrival.y_m_s_q13 = frame_i16(r->field + 14);
    arrival.omega_rad_s_q11 = frame_i16(r->field + 16);
    if (!within_half_turn(goal.theta_mrad_q13))
        return LINK_RESULT_RANGE;
    if (loading(&link->parts))
        return LINK_RESULT_BUSY;
    switch (control_loop_command_pose(link->parts.loop, &goal, &arrival)) {
        case TRAJECTORY_OK:
            return LINK_RESULT_ACCEPTED;
        case TRAJECTORY_TOO_FAR:
            return LINK_RESULT_TOO_FAR;
        default:
            return LINK_RESULT_STATE;
    }
}

static link_result handle_duty(link_state *link, const request *r) {
    i16 duty_q15[WHEEL_COUNT];
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++)
        duty_q15[i] = frame_i16(r->field + 2 * i);
    if (loading(&link->parts))
        return LINK_RESULT_BUSY;
    return granted(control_loop_command_duty(link->parts.loop, duty_q15));
}

static link_result handle_stop(link_state *link, const request *r) {
    (void)r;
    control_loop_stop(link->parts.loop);
    return LINK_RESULT_ACCEPTED;
}

/* ...power stage and faults */

static link_result handle_arm(link_state *link, const request *r) {
    (void)r;
    return loading(&link->parts) ? LINK_RESULT_BUSY : granted(control_loop_arm(link->parts.loop));
}

static link_result handle_disarm(link_state *link, const request *r) {
    (void)r;
    return granted(control_loop_disarm(link->parts.loop));
}

static link_result handle_clear_fault(link_state *link, const request *r) {
    (void)r;
    return granted(control_loop_clear_fault(link->parts.loop));
}

static link_result handle_outside_pose(link_state *link, const request *r) {
    odometry_pose pose;
    read_pose(r->field, &pose);
    if (!within_half_turn(pose.theta_mrad_q13))
        return LINK_RESULT_RANGE;
    return control_loop_outside_pose(link->parts.loop, &pose, frame_i16(r->field + 12))
               ? LINK_RESULT_ACCEPTED
               : LINK_RESULT_RANGE;
}

/* ...parameters */

/* What forbids a change of the parameters now: of any, or of those that describe the robot. */
static link_result change_of_parameters(const link_parts *parts, u16 all) {
    if (parameter_store_at_work(parts->store))
        return LINK_RESULT_BUSY;
    return all && parts->loop->supervision.state == SUPERVISOR_STATE_DRIVE ? LINK_RESULT_DRIVING
                                                                           : LINK_RESULT_ACCEPTED;
}

static link_result handle_parameter_set(link_state *link, const request *r) {
    link_result result;
    if (r->field[0] >= PARAMETER_COUNT)
        return LINK_RESULT_ID;
    result = change_of_parameters(&link->parts, r->field[0] < PARAMETER_FIRST_TUNABLE);
    if (result != LINK_RESULT_ACCEPTED)
        return result;
    return parameters_set(link->parts.settings, r->field[0], frame_i16(r->field + 1)) ==
                   PARAMETERS_OK
               ? LINK_RESULT_ACCEPTED
               : LINK_RESULT_RANGE;
}

static link_result handle_parameters_save(link_state *link, const request *r) {
    (void)r;
    if (parameter_store_at_work(link->parts.store))
        return LINK_RESULT_BUSY;
    parameter_store_save(link->parts.store);
    return LINK_RESULT_ACCEPTED;
}

static link_result handle_parameters_load(link_state *link, const request *r) {
    const link_result result = change_of_parameters(&link->parts, 1);
    (void)r;
    if (result == LINK_RESULT_ACCEPTED)
        parameter_store_load(link->parts.store);
    return result;
}

static link_result handle_parameters_default(link_state *link, const request *r) {
    const link_result result = change_of_parameters(&link->parts, 1);
    (void)r;
    if (result == LINK_RESULT_ACCEPTED)
        parameters_set_defaults(link->parts.settings);
    return result;
}

/* ...telemetry */

static link_result handle_stream(link_state *link, const request *r) {
    switch (telemetry_set_stream(link->parts.told, r->field[0], frame_u16(r->field + 1),
                                 r->field + 3, (u16)(r->bytes - 3))) {
        case TELEMETRY_OK:
            return LINK_RESULT_ACCEPTED;
        case TELEMETRY_TOO_LONG:
            return LINK_RESULT_TOO_LONG;
        default:
            return LINK_RESULT_ID;
    }
}

/* ---- From a frame to an answer ---- */

/* Bytes beyond the fixed ones; too few wrap to very many. */
#define BYTES_MORE(r, fixed) ((u16)((r)->bytes - (fixed)))

static link_result carry_out(link_state *link, const request *r) {
    switch (r->code) {
#define REQUEST(name, code, bytes, more, fields, answer, description) \
    case REQUEST_##name:                                              \
        return BYTES_MORE(r, bytes) > (more) ? LINK_RESULT_LENGTH : handle_##name(link, r);
#include "firmware/messages.def"
        default:
            return LINK_RESULT_UNKNOWN;
    }
}

static u16 is_repetition(const link_state *link, const request *r) {
    return link->known && link->last_sequence == r->sequence && link->last_crc == r->crc;
}

static link_result carry_out_once(link_state *link, const request *r) {
    if (r->code < FIRST_CODE_THAT_ACTS)
        return carry_out(link, r);
    if (!is_repetition(link, r)) {
        link->last_result = carry_out(link, r);
        link->known = 1;
        link->last_sequence = r->sequence;
        link->last_crc = r->crc;
    }
    return link->last_result;
}

/* Fields that the request adds come behind the result, which is known only then. */
static void answer(link_state *link) {
    const u16 *content = link->reader.byte;
    frame_writer *frame = link->parts.frame;
    link_result result = LINK_RESULT_VERSION;
    u16 place_of_result;
    request r;
    r.code = content[1];
    r.sequence = content[2];
    r.crc = frame_u16(&content[link->reader.length]);
    r.field = content + LINK_HEADER_BYTES;
    r.bytes = (u16)(link->reader.length - LINK_HEADER_BYTES);
    link_begin(frame, LINK_ANSWER, r.sequence);
    frame_add_u8(frame, r.code);
    place_of_result = frame_add_u8(frame, 0);
    if (content[0] == LINK_VERSION)
        result = carry_out_once(link, &r);
    frame->byte[place_of_result] = (u16)result;
    if (!frame_send(frame, 0))
        link->parts.told->counters.answers_lost++;
}

/* Whole, valid and long enough to be a request. */
static u16 is_request(const link_state *link, frame_status status) {
    return status == FRAME_WHOLE && link->reader.length >= LINK_HEADER_BYTES;
}

void link_tick(link_state *link) {
    telemetry_counters *counters = &link->parts.told->counters;
    u16 byte = 0;
    u16 bytes;
    counters->bytes_lost = (u16)(counters->bytes_lost + hal_serial_lost());
    for (bytes = 0; bytes < LINK_BYTES_PER_TICK && hal_serial_read(&byte); bytes++) {
        const frame_status status = frame_receive(&link->reader, byte);
        if (is_request(link, status)) {
            answer(link);
        } else if (status != FRAME_PENDING) {
            counters->bad_frames++;
        }
    }
}

void link_init(link_state *link, const link_parts *parts) {
    link->parts = *parts;
    frame_reader_reset(&link->reader);
    link->known = 0;
}
