/* Plausibility of one wheel; reasons in wheel_monitor.h. */
#include "firmware/wheel_monitor.h"

#include "firmware/fixed_point.h"

#define FORCE_LIMIT_Q23 ((i32)2 << 23) /* times the grip */
#define STANDING_COUNTS 2              /* a counter on the edge of a slit */
#define REVERSED_RAD_S_Q5 (20 * 32)    /* slower ones are standing */
#define GLITCH_SCORE 64
#define GLITCH_LIMIT 128

static i32 magnitude(i32 value) {
    return value < 0 ? -value : value;
}

void wheel_monitor_reset(wheel_monitor *monitor, u16 count) {
    monitor->place_count = count;
    monitor->standing_ms = 0;
    monitor->reversed_ms = 0;
    monitor->glitch_score = 0;
    monitor->current_ma_q6 = 0;
}

static u16 leaves_its_place(const wheel_monitor *monitor, u16 count) {
    const u16 moved = (u16)(count - monitor->place_count);
    return (u16)(moved + STANDING_COUNTS) > 2 * STANDING_COUNTS; /* either way */
}

/* The time for which a condition has held without a break. */
static u16 lasting_ms(u16 before_ms, int holds) {
    return holds ? (u16)(before_ms + 1U) : 0;
}

static u16 is_stalled(const parameters *p, const wheel_monitor_input *input) {
    /* V Q9 * A/V Q10 = Q19 -> Q10, at most 32 A, as measured; 3/4 of it in mA: 750 / 2^10 */
    const i16 stall_current_a_q10 = fixed_saturate_i16(fixed_shift_right(
        magnitude(input->voltage_v_q9) * PARAMETER_GET(p, current_per_volt_q10), 9));
    return magnitude(input->current_ma) >= (i32)stall_current_a_q10 * 375 / 512;
}

static supervisor_fault impossible_force(wheel_monitor *monitor, const parameters *p,
                                         const wheel_monitor_input *input) {
    const int strained = magnitude((i32)input->force_n_q8 * PARAMETER_GET(p, grip_inverse_q15)) >
                         FORCE_LIMIT_Q23; /* Q8 * Q15 */
    const int against = magnitude(input->shaft_rad_s_q5) > REVERSED_RAD_S_Q5 &&
                        (input->shaft_rad_s_q5 < 0) != (input->voltage_v_q9 < 0) &&
                        input->voltage_v_q9 != 0;
    const int stands = !leaves_its_place(monitor, input->count);
    if (!stands)
        monitor->place_count = input->count;
    monitor->standing_ms = lasting_ms(monitor->standing_ms, strained && stands);
    monitor->reversed_ms = lasting_ms(monitor->reversed_ms, strained && against);
    if (monitor->reversed_ms >= WHEEL_MONITOR_REVERSED_MS)
        return SUPERVISOR_FAULT_ENCODER_REVERSED;
    if (monitor->standing_ms >= WHEEL_MONITOR_STANDING_MS)
        return is_stalled(p, input) ? SUPERVISOR_FAULT_WHEEL_STALLED
                                    : SUPERVISOR_FAULT_ENCODER_STUCK;
    return SUPERVISOR_FAULT_NONE;
}

static u16 glitches(wheel_monitor *monitor, u16 glitch) {
    if (glitch) {
        monitor->glitch_score += GLITCH_SCORE;
    } else if (monitor->glitch_score > 0) {
        monitor->glitch_score--;
    }
    return monitor->glitch_score > GLITCH_LIMIT;
}

supervisor_fault wheel_monitor_step(wheel_monitor *monitor, const parameters *p,
                                    const wheel_monitor_input *input) {
    const supervisor_fault force_fault = impossible_force(monitor, p, input);
    /* In this form it is plain that the mean stays within the range of what it is the mean of. */
    monitor->current_ma_q6 =
        fixed_shift_right(monitor->current_ma_q6 * 63, 6) + magnitude(input->current_ma);
    if (glitches(monitor, input->glitch) ||
        magnitude(input->step_counts) > PARAMETER_GET(p, encoder_step_limit)) {
        monitor->glitch_score = 0;
        return SUPERVISOR_FAULT_ENCODER_STEP;
    }
    if (force_fault != SUPERVISOR_FAULT_NONE || monitor->standing_ms > 0)
        return force_fault; /* a blocked wheel is not called by its current */
    return fixed_shift_right(monitor->current_ma_q6, 6) > PARAMETER_GET(p, current_limit_ma)
               ? SUPERVISOR_FAULT_OVER_CURRENT
               : SUPERVISOR_FAULT_NONE;
}
