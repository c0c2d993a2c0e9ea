/* Parameter table, made from parameters.def.
 *
 * The tables are not const: the TI compiler puts const objects into a section that is not copied
 * from flash to data memory, whereas initialised data is.
 */
#include "firmware/parameters.h"

#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) minimum,
static i16 minimum_value[PARAMETER_COUNT] = {
#include "firmware/parameters.def"
};
#undef PARAMETER

#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) maximum,
static i16 maximum_value[PARAMETER_COUNT] = {
#include "firmware/parameters.def"
};
#undef PARAMETER

#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) initial,
static i16 initial_value[PARAMETER_COUNT] = {
#include "firmware/parameters.def"
};
#undef PARAMETER

void parameters_set_defaults(parameters *p) {
    u16 id;
    for (id = 0; id < PARAMETER_COUNT; id++)
        p->value[id] = initial_value[id];
}

parameters_status parameters_set(parameters *p, u16 id, i32 value) {
    if (id >= PARAMETER_COUNT)
        return PARAMETERS_UNKNOWN_ID;
    if (value < minimum_value[id] || value > maximum_value[id])
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
