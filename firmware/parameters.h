/* Parameters of the firmware: one table (parameters.def), from which ids, storage, limits and
 * defaults are made.
 *
 * Every value is an i16 in the Q format and unit that its name and its line in the table state.
 * Read with PARAMETER_GET(p, name); the four values of a quantity
 * per wheel through PARAMETER_WHEELS(p, name_of_wheel_1), a pointer to four values in a row.
 *
 * Errors: parameters_set refuses an unknown id and a value out of its limits and changes nothing.
 */
#ifndef FIRMWARE_PARAMETERS_H
#define FIRMWARE_PARAMETERS_H

#include "firmware/integers.h"

#ifdef __cplusplus
extern "C" {
#endif

#define PARAMETER(name, unit, q_bits, minimum, maximum, initial, description) PARAMETER_ID_##name,
typedef enum {
#include "firmware/parameters.def"
    PARAMETER_COUNT
} parameter_id;
#undef PARAMETER

typedef struct {
    i16 value[PARAMETER_COUNT];
} parameters;

typedef enum {
    PARAMETERS_OK = 0,
    PARAMETERS_UNKNOWN_ID,
    PARAMETERS_OUT_OF_RANGE
} parameters_status;

#define PARAMETER_GET(p, name) ((p)->value[PARAMETER_ID_##name])
#define PARAMETER_WHEELS(p, first) (&(p)->value[PARAMETER_ID_##first])

void parameters_set_defaults(parameters *p);
parameters_status parameters_set(parameters *p, u16 id, i32 value);
parameters_status parameters_get(const parameters *p, u16 id, i32 *value);

#ifdef __cplusplus
}
#endif

#endif
