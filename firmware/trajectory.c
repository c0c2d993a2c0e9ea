/* Moving target; equations in trajectory.h. */
#include "firmware/trajectory.h"

#include "firmware/fixed_point.h"

#define LONGEST_TICKS 60000U
#define SHORTEST_TICKS 8U
#define HALVINGS 4

/* Formats of one test of the limits: translation speed Q13, acceleration Q10; rotation Q11 and Q8.
 */
typedef struct {
    i16 v0[2];
    i16 v1[2];
    i16 mean[2];
} curve;

static i32 to_position_q13(i32 velocity_q22) {
    return fixed_shift_right(velocity_q22, 9);
}

static void limit_speed(const parameters *p, kinematics_velocity *velocity) {
    const i16 limit_q13 = PARAMETER_GET(p, speed_limit_q13);
    const u16 speed_q13 = fixed_hypot(velocity->x_m_s_q13, velocity->y_m_s_q13);
    if (speed_q13 > (u16)limit_q13) {
        const i16 scale_q15 = (i16)fixed_divide(limit_q13, speed_q13, 15); /* Q13 / Q13 * 2^15 */
        velocity->x_m_s_q13 = fixed_multiply_q15(velocity->x_m_s_q13, scale_q15);
        velocity->y_m_s_q13 = fixed_multiply_q15(velocity->y_m_s_q13, scale_q15);
    }
    velocity->omega_rad_s_q11 =
        fixed_clamp_i16(velocity->omega_rad_s_q11, PARAMETER_GET(p, omega_limit_q11));
}

static void set_velocity(traction_change *velocity, const kinematics_velocity *world) {
    velocity->axis_q22[0] = (i32)world->x_m_s_q13 * 512;        /* Q13 -> Q22 */
    velocity->axis_q22[1] = (i32)world->y_m_s_q13 * 512;        /* Q13 -> Q22 */
    velocity->axis_q22[2] = (i32)world->omega_rad_s_q11 * 2048; /* Q11 -> Q22 */
}

static void clear_fraction(trajectory *t) {
    u16 axis;
    for (axis = 0; axis < 3; axis++)
        t->fraction_q22[axis] = 0;
}

void trajectory_start(trajectory *t, const odometry_pose *pose, const kinematics_velocity *body) {
    kinematics_velocity world = *body;
    odometry_rotate(odometry_binary_angle(pose->theta_mrad_q13), &world.x_m_s_q13,
                    &world.y_m_s_q13);
    t->position_q13[0] = pose->x_mm_q13;
    t->position_q13[1] = pose->y_mm_q13;
    t->position_q13[2] = pose->theta_mrad_q13;
    set_velocity(&t->velocity, &world);
    t->goal_velocity = t->velocity;
    t->ticks_left = 0;
    clear_fraction(t);
}

/* ---- The limits of a curve of T ticks ---- */

static u16 length(i32 x, i32 y) {
    return fixed_hypot(fixed_saturate_i16(x), fixed_saturate_i16(y));
}

/* |6 u - 4 a - 2 b| with 4 fractional bits less than the speeds */
static u16 end_change(const curve *c, const i16 a[2], const i16 b[2]) {
    const i32 x = 6 * (i32)c->mean[0] - 4 * (i32)a[0] - 2 * (i32)b[0];
    const i32 y = 6 * (i32)c->mean[1] - 4 * (i32)a[1] - 2 * (i32)b[1];
    return length(fixed_shift_right(x, 4), fixed_shift_right(y, 4));
}

static int speed_fits(const curve *c, u16 limit) {
    const i32 middle_x = 3 * (i32)c->mean[0] - c->v0[0] - c->v1[0];
    const i32 middle_y = 3 * (i32)c->mean[1] - c->v0[1] - c->v1[1];
    return length((c->v0[0] + middle_x) / 2, (c->v0[1] + middle_y) / 2) <= limit &&
           length((c->v1[0] + middle_x) / 2, (c->v1[1] + middle_y) / 2) <= limit &&
           length((c->v0[0] + 2 * middle_x + c->v1[0]) / 4,
                  (c->v0[1] + 2 * middle_y + c->v1[1]) / 4) <= limit;
}

static int curve_fits(const curve *c, u16 ticks, i16 speed_limit, i16 acceleration_limit) {
    /* m/s2 Q10 * ms / 1000 -> m/s Q10 -> Q9; the same for rad/s2 Q8 -> rad/s Q7 */
    const u32 change_limit = (u32)acceleration_limit * ticks / 2000U;
    return speed_fits(c, (u16)speed_limit) && end_change(c, c->v0, c->v1) <= change_limit &&
           end_change(c, c->v1, c->v0) <= change_limit;
}

static i16 mean_speed(i32 distance_q13, u16 ticks, u16 shift_right) {
    return fixed_saturate_i16(fixed_shift_right(fixed_divide(distance_q13, ticks, 9), shift_right));
}

static int plan_fits(const trajectory *t, const parameters *p, u16 ticks) {
    curve moving, turning;
    u16 i;
    for (i = 0; i < 2; i++) {
        moving.v0[i] = fixed_saturate_i16(to_position_q13(t->velocity.axis_q22[i]));
        moving.v1[i] = fixed_saturate_i16(to_position_q13(t->goal_velocity.axis_q22[i]));
        moving.mean[i] =
            mean_speed(fixed_subtract_i32(t->goal_position_q13[i], t->position_q13[i]), ticks, 9);
        turning.v0[i] = 0;
        turning.v1[i] = 0;
        turning.mean[i] = 0;
    }
    turning.v0[0] = fixed_saturate_i16(fixed_shift_right(t->velocity.axis_q22[2], 11));
    turning.v1[0] = fixed_saturate_i16(fixed_shift_right(t->goal_velocity.axis_q22[2], 11));
    turning.mean[0] = mean_speed(t->goal_position_q13[2] - t->position_q13[2], ticks, 11);
    return curve_fits(&moving, ticks, PARAMETER_GET(p, speed_limit_q13),
                      PARAMETER_GET(p, acceleration_limit_q10)) &&
           curve_fits(&turning, ticks, PARAMETER_GET(p, omega_limit_q11),
                      PARAMETER_GET(p, angular_acceleration_limit_q8));
}

/* The number of ticks of trajectory.h, or 0 when none was found. */
static u16 shortest_ticks(const trajectory *t, const parameters *p) {
    u16 fits = SHORTEST_TICKS;
    u16 fails = SHORTEST_TICKS;
    u16 i;
    while (!plan_fits(t, p, fits)) {
        if (fits == LONGEST_TICKS)
            return 0;
        fails = fits;
        fits = fits > LONGEST_TICKS / 5U * 4U ? LONGEST_TICKS : (u16)(fits + fits / 4U);
    }
    for (i = 0; i < HALVINGS; i++) {
        const u16 trial = (u16)(fails + (fits - fails) / 2U);
        if (plan_fits(t, p, trial)) {
            fits = trial;
        } else {
            fails = trial;
        }
    }
    return fits;
}

trajectory_status trajectory_plan(trajectory *t, const parameters *p, const odometry_pose *goal,
                                  const kinematics_velocity *arrival) {
    trajectory planned = *t;
    kinematics_velocity limited = *arrival;
    i32 turn_mrad_q13 = goal->theta_mrad_q13 % ODOMETRY_FULL_TURN_MRAD_Q13;
    limit_speed(p, &limited);
    planned.position_q13[2] = odometry_wrap_mrad_q13(t->position_q13[2]);
    turn_mrad_q13 = odometry_wrap_mrad_q13(turn_mrad_q13 - planned.position_q13[2]);
    planned.goal_position_q13[0] = goal->x_mm_q13;
    planned.goal_position_q13[1] = goal->y_mm_q13;
    planned.goal_position_q13[2] = planned.position_q13[2] + turn_mrad_q13;
    set_velocity(&planned.goal_velocity, &limited);
    planned.ticks_left = shortest_ticks(&planned, p);
    if (planned.ticks_left == 0)
        return TRAJECTORY_TOO_FAR;
    *t = planned;
    return TRAJECTORY_OK;
}

/* ---- One tick ---- */

static void move(trajectory *t, u16 axis, i32 step_q22) {
    const i32 sum_q22 = t->fraction_q22[axis] + step_q22;
    t->position_q13[axis] = fixed_add_i32(t->position_q13[axis], sum_q22 >> 9);
    t->fraction_q22[axis] = (i16)(sum_q22 & 511L);
}

/* The exact first tick of the cubic over the ticks left:
 *     p += v + a/2 + j/6,  v += a + j/2,  a = a(0),  j = (a(T) - a(0)) / T */
static void step_axis(trajectory *t, u16 axis) {
    const u16 ticks = t->ticks_left;
    const i32 distance_q13 = fixed_subtract_i32(t->goal_position_q13[axis], t->position_q13[axis]);
    const i32 mean_q22 =
        fixed_divide(distance_q13, ticks, 9) - t->fraction_q22[axis] / (i32)ticks; /* Q13 -> Q22 */
    const i32 v0_q22 = t->velocity.axis_q22[axis];
    const i32 v1_q22 = t->goal_velocity.axis_q22[axis];
    const i32 a_q22 = (6 * mean_q22 - 4 * v0_q22 - 2 * v1_q22) / (i32)ticks;
    const i32 j_q22 = (6 * v0_q22 + 6 * v1_q22 - 12 * mean_q22) / (i32)ticks / (i32)ticks;
    move(t, axis, v0_q22 + a_q22 / 2 + j_q22 / 6);
    t->velocity.axis_q22[axis] = v0_q22 + a_q22 + j_q22 / 2;
}

static void arrive(trajectory *t) {
    u16 axis;
    for (axis = 0; axis < 3; axis++)
        t->position_q13[axis] = t->goal_position_q13[axis];
    t->velocity = t->goal_velocity;
    t->position_q13[2] = odometry_wrap_mrad_q13(t->position_q13[2]);
    clear_fraction(t);
}

static void coast(trajectory *t) {
    u16 axis;
    for (axis = 0; axis < 3; axis++)
        move(t, axis, t->velocity.axis_q22[axis]);
    t->position_q13[2] = odometry_wrap_mrad_q13(t->position_q13[2]);
}

void trajectory_step_to_pose(trajectory *t) {
    u16 axis;
    if (t->ticks_left == 0) {
        coast(t);
        return;
    }
    if (t->ticks_left == 1) {
        arrive(t);
    } else {
        for (axis = 0; axis < 3; axis++)
            step_axis(t, axis);
    }
    t->ticks_left--;
}

/* acceleration limit Q10 (rotation Q8) for 1 ms -> Q22: times 2^12 / 1000 = 2097 / 2^9 */
static i32 change_limit_q22(i16 limit_q10) {
    return fixed_shift_right((i32)limit_q10 * 2097, 9);
}

/* The component of a vector of length limit along a component of a vector of this size. */
static i32 along_q22(i16 component, u16 size, i32 limit_q22) {
    return fixed_multiply_i32_q15(limit_q22, fixed_saturate_i16(fixed_divide(component, size, 15)));
}

static void limit_acceleration(const parameters *p, traction_change *change) {
    const i32 limit_q22 = change_limit_q22(PARAMETER_GET(p, acceleration_limit_q10));
    const i32 turning_limit_q22 =
        change_limit_q22(PARAMETER_GET(p, angular_acceleration_limit_q8)) *
        4; /* Q8 is 2 bits less */
    /* Q12, since a reversal at full speed is twice the range of Q13 */
    const i16 x_q12 = fixed_saturate_i16(fixed_shift_right(change->axis_q22[0], 10));
    const i16 y_q12 = fixed_saturate_i16(fixed_shift_right(change->axis_q22[1], 10));
    const u16 size_q12 = fixed_hypot(x_q12, y_q12);
    if ((i32)size_q12 * 1024 > limit_q22) {
        change->axis_q22[0] = along_q22(x_q12, size_q12, limit_q22);
        change->axis_q22[1] = along_q22(y_q12, size_q12, limit_q22);
    }
    if (change->axis_q22[2] > turning_limit_q22)
        change->axis_q22[2] = turning_limit_q22;
    if (change->axis_q22[2] < -turning_limit_q22)
        change->axis_q22[2] = -turning_limit_q22;
}

u16 trajectory_step_velocity(trajectory *t, const parameters *p, const kinematics_velocity *body) {
    const u16 heading = odometry_binary_angle(t->position_q13[2]);
    kinematics_velocity world = *body;
    traction_change change;
    u16 limited, axis;
    limit_speed(p, &world);
    odometry_rotate(heading, &world.x_m_s_q13, &world.y_m_s_q13);
    set_velocity(&t->goal_velocity, &world);
    for (axis = 0; axis < 3; axis++) {
        change.axis_q22[axis] =
            fixed_subtract_i32(t->goal_velocity.axis_q22[axis], t->velocity.axis_q22[axis]);
    }
    limit_acceleration(p, &change);
    limited = traction_limit(p, heading, &change);
    for (axis = 0; axis < 3; axis++)
        t->velocity.axis_q22[axis] += change.axis_q22[axis];
    coast(t);
    t->ticks_left = 0;
    return limited;
}
