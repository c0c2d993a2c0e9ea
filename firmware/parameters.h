/* Parameters of the firmware: one table (parameters.def), from which ids, storage, limits and
 * defaults are made.
 *
 * Every value is an i16 in the Q format and unit that its name and its line in the table state.
 * Read with PARAMETER_GET(p, name); the four values of a quantity
 * per wheel through PARAMETER_WHEELS(p, name_of_wheel_1), a pointer to four values in a row.
 *
 * Only the values take data memory. Limits and defaults are numbers in the program; names and units
 * stay in the table, where hosts read them: text would take 2000 words of a memory of 2500. The
 * fingerprint tells whether a host, or a stored set, goes by the same table.
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

/* The parameters before this one describe the robot and change only while it does not drive; those
 * from here on are gains and limits and change at any time. */
#define PARAMETER_FIRST_TUNABLE PARAMETER_ID_slip_compensation

typedef struct {
    i16 value[PARAMETER_COUNT];
} parameters;

typedef struct {
    u16 q_bits;
    i16 minimum;
    i16 maximum;
    i16 initial;
    u16 name_length;
    u16 unit_length;
} parameter_info;

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
/* What the table says about a parameter. */
parameters_status parameters_describe(u16 id, parameter_info *info);

/* CRC-16 (frame.h) over the table, per line in order: length of name, length of unit (a byte each),
 * q_bits, minimum, maximum, default (two bytes each, low byte first). It changes when a line is
 * added, removed, moved among unlike ones or given other numbers; not with a description. */
u16 parameters_fingerprint(void);

#ifdef __cplusplus
}
#endif

#endif
