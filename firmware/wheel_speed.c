/* Shaft speed from a 16-bit encoder counter; equation in wheel_speed.h. */
#include "firmware/wheel_speed.h"

#include "firmware/fixed_point.h"

void wheel_speed_reset(wheel_speed *state, u16 count) {
    u16 i;
    for (i = 0; i < WHEEL_SPEED_WINDOW; i++)
        state->history[i] = count;
    state->oldest = 0;
}

static i16 wrapped_difference(u16 newer, u16 older) {
    const u16 difference = (u16)((newer - older) & U16_MAX);
    return (i16)(difference > I16_MAX ? (i32)difference - 65536L : (i32)difference);
}

i16 wheel_speed_counts_since(const wheel_speed *state, u16 count) {
    const u16 newest = (u16)((state->oldest + WHEEL_SPEED_WINDOW - 1U) % WHEEL_SPEED_WINDOW);
    return wrapped_difference(count, state->history[newest]);
}

i16 wheel_speed_step_rad_s_q5(wheel_speed *state, const parameters *p, u16 count) {
    const i16 counts = wrapped_difference(count, state->history[state->oldest]);
    state->history[state->oldest] = count;
    state->oldest = (u16)((state->oldest + 1U) % WHEEL_SPEED_WINDOW);
    /* Q0 * Q10 / 4 -> Q5: 10 - 5 + 2 = 7 */
    return fixed_saturate_i16(
        fixed_shift_right_odd((i32)counts * PARAMETER_GET(p, shaft_speed_per_count_q10), 7));
}
