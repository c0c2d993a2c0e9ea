/* Parameter table, made from parameters.def. */
#include "firmware/parameters.h"

#include "firmware/frame.h"

/* sizeof does not evaluate: the text takes no memory. */
#define TEXT_LENGTH(text) ((u16)(sizeof(#text) - 1U))

parameters_status parameters_describe(u16 id, parameter_info *info) {
    switch (id) {
#define PARAMETER(name, unit, q, low, high, start, description) \
    case PARAMETER_ID_##name:                                   \
        info->q_bits = (q);                                     \
        info->minimum = (low);                                  \
        info->maximum = (high);                                 \
        info->initial = (start);                                \
        info->name_length = TEXT_LENGTH(name);                  \
        info->unit_length = TEXT_LENGTH(unit);                  \
        return PARAMETERS_OK;
#include "firmware/parameters.def"
#undef PARAMETER
        default:
            return PARAMETERS_UNKNOWN_ID;
    }
}

void parameters_set_defaults(parameters *p) {
    parameter_info info;
    u16 id;
    for (id = 0; id < PARAMETER_COUNT; id++) {
        parameters_describe(id, &info);
        p->value[id] = info.initial;
    }
}

parameters_status parameters_set(parameters *p, u16 id, i32 value) {
    parameter_info info;
    if (id >= PARAMETER_COUNT)
        return PARAMETERS_UNKNOWN_ID;
    /* For the proof: each line of the table by itself. */
    /*@ split id; */
    parameters_describe(id, &info);
    if (value < info.minimum || value > info.maximum)
        return PARAMETERS_OUT_OF_RANGE;
    p->value[id] = (i16)value;
    return PARAMETERS_OK;
}

parameters_status parameters_get(const parameters *p, u16 id, i32 *value) {
    if (id >= PARAMETER_COUNT)
        return PARAMETERS_UNKNOWN_ID;
    *value = p->value[id];
    return PARAMETERS_OK;
}

u16 parameters_fingerprint(void) {
    parameter_info info;
    u16 crc = FRAME_CRC_START;
    u16 id;
    for (id = 0; id < PARAMETER_COUNT; id++) {
        parameters_describe(id, &info);
        crc = frame_crc(frame_crc(crc, info.name_length), info.unit_length);
        crc = frame_crc_u16(crc, info.q_bits);
        crc = frame_crc_u16(crc, (u16)info.minimum);
        crc = frame_crc_u16(crc, (u16)info.maximum);
        crc = frame_crc_u16(crc, (u16)info.initial);
    }
    return crc;
}
