/* Moving target; equations in trajectory.h. */
#include "firmware/trajectory.h"

#include "firmware/fixed_point.h"

#define LONGEST_TICKS 60000U
#define SHORTEST_TICKS 8U
/* 16 m/s, 16 rad/s: 24 of them are below 2^31. */
#define FASTEST_Q22 ((i32)1 << 26)

/* 1 when it cuts the velocity. */
static u16 limit_speed(const parameters *p, kinematics_velocity *velocity) {
    const i16 omega_q11 =
        fixed_clamp_i16(velocity->omega_rad_s_q11, PARAMETER_GET(p, omega_limit_q11));
    const i16 limit_q13 = PARAMETER_GET(p, speed_limit_q13);
    const u16 too_fast = fixed_is_longer(velocity->x_m_s_q13, velocity->y_m_s_q13, limit_q13);
    const u16 cut = too_fast || velocity->omega_rad_s_q11 != omega_q11;
    if (too_fast) {
        const u16 speed_q13 = fixed_hypot(velocity->x_m_s_q13, velocity->y_m_s_q13);
        const i16 scale_q15 = (i16)fixed_divide(limit_q13, speed_q13, 15); /* Q13 / Q13 * 2^15 */
        velocity->x_m_s_q13 = fixed_multiply_q15(velocity->x_m_s_q13, scale_q15);
        velocity->y_m_s_q13 = fixed_multiply_q15(velocity->y_m_s_q13, scale_q15);
    }
    velocity->omega_rad_s_q11 = omega_q11;
    return cut;
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
    t->grip_acceleration_q10 = 0;
    t->grip_angular_acceleration_q8 = 0;
    t->ticks_left = 0;
    t->trial_ticks = 0;
    clear_fraction(t);
}

/* ---- The limits of a curve of T ticks ---- */

/* x, y m/s Q13; rotation rad/s Q11 */
typedef struct {
    i16 v0[3];
    i16 v1[3];
    i16 mean[3];
} curve;

static i16 speed_of(i32 velocity_q22, u16 axis) {
    return fixed_saturate_i16(fixed_shift_right(velocity_q22, axis == 2 ? 11 : 9));
}

static void set_ends(curve *c, const trajectory *t) {
    u16 axis;
    for (axis = 0; axis < 3; axis++) {
        c->v0[axis] = speed_of(t->velocity.axis_q22[axis], axis);
        c->v1[axis] = speed_of(t->goal_velocity.axis_q22[axis], axis);
    }
}

static i32 distance_q13(const trajectory *t, u16 axis) {
    return fixed_subtract_i32(t->goal_position_q13[axis], t->position_q13[axis]);
}

static u16 length(i32 x, i32 y) {
    return fixed_hypot(fixed_saturate_i16(x), fixed_saturate_i16(y));
}

/* length(x, y) > limit */
static u16 is_longer(i32 x, i32 y, i16 limit) {
    return fixed_is_longer(fixed_saturate_i16(x), fixed_saturate_i16(y), limit);
}

static u16 size_of(i32 value) {
    const i16 limited = fixed_clamp_i16(value, I16_MAX);
    return (u16)(limited < 0 ? -limited : limited);
}

static i16 smaller(i16 a, i16 b) {
    return a < b ? a : b;
}

/* m/s2 Q10 * ms / 1000 -> m/s Q10 -> Q9; the same for rad/s2 Q8 -> rad/s Q7 */
static u16 change_limit(i16 acceleration, u16 ticks) {
    const u32 change = (u32)acceleration * ticks / 2000U;
    return change > U16_MAX ? (u16)U16_MAX : (u16)change;
}

/* |6 u - 4 a - 2 b|, with 4 fractional bits less than the speeds, against the limits of T ticks. */
static int end_fits(const curve *c, const i16 a[3], const i16 b[3], const trajectory *t,
                    const parameters *p, u16 ticks) {
    const u16 grip_q9 = change_limit(t->grip_acceleration_q10, ticks);
    const u16 turning_grip_q7 = change_limit(t->grip_angular_acceleration_q8, ticks);
    i32 change[3];
    u16 moving_q9, turning_q7, axis;
    for (axis = 0; axis < 3; axis++) {
        change[axis] =
            fixed_shift_right(6 * (i32)c->mean[axis] - 4 * (i32)a[axis] - 2 * (i32)b[axis], 4);
    }
    moving_q9 = length(change[0], change[1]);
    turning_q7 = size_of(change[2]);
    return moving_q9 <= change_limit(PARAMETER_GET(p, acceleration_limit_q10), ticks) &&
           turning_q7 <= change_limit(PARAMETER_GET(p, angular_acceleration_limit_q8), ticks) &&
           moving_q9 <= grip_q9 && /* the sum of the shares, without a division */
           (u32)turning_q7 * grip_q9 <= (u32)(u16)(grip_q9 - moving_q9) * turning_grip_q7;
}

static int speed_fits(const curve *c, const parameters *p) {
    const i16 limit = PARAMETER_GET(p, speed_limit_q13);
    const u16 turning_limit = (u16)PARAMETER_GET(p, omega_limit_q11);
    i32 first[3], last[3]; /* corners of the polygon; between them lies their mean */
    u16 axis;
    for (axis = 0; axis < 3; axis++) {
        const i32 three_means = 3 * (i32)c->mean[axis];
        first[axis] = (three_means - c->v1[axis]) / 2;
        last[axis] = (three_means - c->v0[axis]) / 2;
    }
    return !is_longer(first[0], first[1], limit) && !is_longer(last[0], last[1], limit) &&
           size_of(first[2]) <= turning_limit && size_of(last[2]) <= turning_limit;
}

static int plan_fits(const trajectory *t, const parameters *p, u16 ticks) {
    curve c;
    u16 axis;
    set_ends(&c, t);
    for (axis = 0; axis < 3; axis++) {
        /* mm Q13 / ms -> m/s Q22 */
        c.mean[axis] = speed_of(fixed_divide(distance_q13(t, axis), ticks, 9), axis);
    }
    return speed_fits(&c, p) && end_fits(&c, c.v0, c.v1, t, p, ticks) &&
           end_fits(&c, c.v1, c.v0, t, p, ticks);
}

/* ---- A T to begin with ---- */

/* One of translation (mm, m/s Q13, m/s2 Q10) and rotation (mrad, rad/s Q11, rad/s2 Q8). */
typedef struct {
    u32 distance;
    u16 fastest;  /* max |v| */
    u32 reversal; /* |v1 - v0| + 6 |s| */
    i16 speed_limit;
    u16 speed_bits;
    i16 acceleration;
    u16 acceleration_bits;
} stretch;

static u32 larger(u32 a, u32 b) {
    return a > b ? a : b;
}

/* T of the triangle inequality; beyond LONGEST_TICKS when that does not suffice. */
static u32 stretch_ticks(const stretch *s) {
    const u16 acceleration = (u16)(s->acceleration > 0 ? s->acceleration : 1);
    /* m/s Q13 / m/s2 Q10 in ms: times 1000 / 2^3 = 125; the same for rotation */
    const u32 reversing = s->reversal * 125U / acceleration;
    const u32 ratio = 6000U * s->distance / acceleration;
    u32 coasting;
    /* fastest is beyond the limit only when the limit was lowered on the way. */
    i32 slack = 2 * (i32)s->speed_limit - (i32)s->fastest;
    if (slack < s->speed_limit)
        slack = s->speed_limit;
    coasting = (u32)fixed_divide((i32)(3U * s->distance), (u16)slack, s->speed_bits);
    if (ratio >= ((u32)LONGEST_TICKS * LONGEST_TICKS) >> s->acceleration_bits)
        return LONGEST_TICKS + 1UL;
    return larger(reversing + fixed_sqrt((ratio + 1U) << s->acceleration_bits) + 2U, coasting + 1U);
}

/* Millimetres or milliradians, rounded up; the largest of the format for what lies beyond it. */
static u32 whole_length(i32 x_q13, i32 y_q13) {
    u16 shift = 0;
    /*@ loop unroll 17; */
    while (x_q13 > I16_MAX || x_q13 < I16_MIN || y_q13 > I16_MAX || y_q13 < I16_MIN) {
        x_q13 >>= 1;
        y_q13 >>= 1;
        shift++;
    }
    /* +2 for what the shifts and the root cut off */
    return ((((u32)fixed_hypot((i16)x_q13, (i16)y_q13) + 2U) << shift) >> 13) + 1U;
}

static void set_translation(stretch *s, const trajectory *t, const parameters *p, const curve *c) {
    s->distance = whole_length(distance_q13(t, 0), distance_q13(t, 1));
    s->fastest = (u16)larger(length(c->v0[0], c->v0[1]), length(c->v1[0], c->v1[1]));
    /* halved, so that sums of two speeds do not saturate */
    s->reversal = 2U * (u32)length(((i32)c->v1[0] - c->v0[0]) / 2, ((i32)c->v1[1] - c->v0[1]) / 2) +
                  6U * (u32)length(((i32)c->v1[0] + c->v0[0]) / 2, ((i32)c->v1[1] + c->v0[1]) / 2);
    s->speed_limit = PARAMETER_GET(p, speed_limit_q13);
    s->speed_bits = 13;
    s->acceleration = smaller(PARAMETER_GET(p, acceleration_limit_q10), t->grip_acceleration_q10);
    s->acceleration_bits = 10;
}

static void set_rotation(stretch *s, const trajectory *t, const parameters *p, const curve *c) {
    s->distance = whole_length(distance_q13(t, 2), 0);
    s->fastest = (u16)larger(size_of(c->v0[2]), size_of(c->v1[2]));
    s->reversal = 2U * (u32)size_of(((i32)c->v1[2] - c->v0[2]) / 2) +
                  6U * (u32)size_of(((i32)c->v1[2] + c->v0[2]) / 2);
    s->speed_limit = PARAMETER_GET(p, omega_limit_q11);
    s->speed_bits = 11;
    s->acceleration =
        smaller(PARAMETER_GET(p, angular_acceleration_limit_q8), t->grip_angular_acceleration_q8);
    s->acceleration_bits = 8;
}

static int is_at_rest(const stretch *s) {
    return s->distance <= 1U && s->reversal == 0;
}

/* A T that surely fits; beyond LONGEST_TICKS when none is known. */
static u32 sure_ticks(const trajectory *t, const parameters *p, const curve *c) {
    stretch moving, turning;
    set_translation(&moving, t, p, c);
    set_rotation(&turning, t, p, c);
    if (!is_at_rest(&moving) && !is_at_rest(&turning)) { /* they share the grip */
        moving.acceleration = smaller(moving.acceleration, (i16)(t->grip_acceleration_q10 / 2));
        turning.acceleration =
            smaller(turning.acceleration, (i16)(t->grip_angular_acceleration_q8 / 2));
    }
    return larger(larger(stretch_ticks(&moving), stretch_ticks(&turning)), SHORTEST_TICKS);
}

/* D s / s^2 of the translation, or of the rotation of a robot that stays; 0 when there is none. */
static u32 natural_ticks(const trajectory *t, const curve *c) {
    const i32 x_q13 = ((i32)c->v0[0] + c->v1[0]) / 2;
    const i32 y_q13 = ((i32)c->v0[1] + c->v1[1]) / 2;
    const i32 turn_q11 = ((i32)c->v0[2] + c->v1[2]) / 2;
    const u16 speed_q13 = length(x_q13, y_q13);
    i32 ticks;
    if (speed_q13 > 0) {
        const i16 x_q15 = fixed_saturate_i16(fixed_divide(x_q13, speed_q13, 15));
        const i16 y_q15 = fixed_saturate_i16(fixed_divide(y_q13, speed_q13, 15));
        const i32 along_q13 = fixed_add_i32(fixed_multiply_i32_q15(distance_q13(t, 0), x_q15),
                                            fixed_multiply_i32_q15(distance_q13(t, 1), y_q15));
        ticks = along_q13 / (i32)speed_q13;
    } else {
        /*@ split turn_q11 > 0; */
        ticks = turn_q11 == 0 ? 0 : distance_q13(t, 2) / (4 * turn_q11); /* Q13 / Q13 */
    }
    return ticks < 0 ? 0 : (u32)ticks;
}

/* The share Q13 of an inertia, in the inertia's format. */
static u16 carried(u32 share_q13, i16 inertia) {
    const u32 carried_inertia = share_q13 * (u16)inertia >> 13;
    return carried_inertia > U16_MAX ? (u16)U16_MAX : (u16)carried_inertia;
}

/* a_grip and alpha_grip of the header. */
static void set_grip(trajectory *t, const parameters *p) {
    const i16 *forward_x_q13 = PARAMETER_WHEELS(p, forward_x_1_q13);
    const i16 *forward_y_q13 = PARAMETER_WHEELS(p, forward_y_1_q13);
    const i16 *forward_omega_q13 = PARAMETER_WHEELS(p, forward_omega_1_q13);
    const i32 limit_q8 = PARAMETER_GET(p, traction_limit_q8);
    u32 share_q13 = 0, turning_share_q13 = 0;
    u16 i;
    for (i = 0; i < WHEEL_COUNT; i++) {
        share_q13 = larger(share_q13, fixed_hypot(forward_x_q13[i], forward_y_q13[i]));
        turning_share_q13 = larger(turning_share_q13, size_of(forward_omega_q13[i]));
    }
    /* N Q8 / kg Q8 -> m/s2 Q10 */
    t->grip_acceleration_q10 = fixed_saturate_i16(
        fixed_divide(limit_q8, carried(share_q13, PARAMETER_GET(p, mass_q8)), 10));
    /* N Q8 / kg m Q13 -> rad/s2 Q8 */
    t->grip_angular_acceleration_q8 = fixed_saturate_i16(
        fixed_divide(limit_q8, carried(turning_share_q13, PARAMETER_GET(p, inertia_q13)), 13));
}

/* The plan to begin with; 0 when none is known to fit. */
static u16 first_ticks(const trajectory *t, const parameters *p) {
    curve c;
    u32 sure, natural;
    set_ends(&c, t);
    sure = sure_ticks(t, p, &c);
    natural = natural_ticks(t, &c);
    if (natural >= SHORTEST_TICKS && natural < sure && natural <= LONGEST_TICKS &&
        plan_fits(t, p, (u16)natural))
        return (u16)natural;
    return sure > LONGEST_TICKS ? 0 : (u16)sure;
}

trajectory_status trajectory_plan(trajectory *t, const parameters *p, const odometry_pose *goal,
                                  const kinematics_velocity *arrival) {
    trajectory planned = *t;
    kinematics_velocity limited = *arrival;
    i32 turn_mrad_q13 = goal->theta_mrad_q13 % ODOMETRY_FULL_TURN_MRAD_Q13;
    (void)limit_speed(p, &limited);
    planned.position_q13[2] =
        odometry_wrap_mrad_q13(t->position_q13[2] % ODOMETRY_FULL_TURN_MRAD_Q13);
    turn_mrad_q13 = odometry_wrap_mrad_q13(turn_mrad_q13 - planned.position_q13[2]);
    planned.goal_position_q13[0] = goal->x_mm_q13;
    planned.goal_position_q13[1] = goal->y_mm_q13;
    planned.goal_position_q13[2] = planned.position_q13[2] + turn_mrad_q13;
    set_velocity(&planned.goal_velocity, &limited);
    set_grip(&planned, p);
    planned.ticks_left = first_ticks(&planned, p);
    if (planned.ticks_left == 0)
        return TRAJECTORY_TOO_FAR;
    planned.trial_ticks = (u16)(planned.ticks_left / 2U);
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
    /* Q13 -> Q22 */
    const i32 mean_q22 =
        fixed_clamp_i32(fixed_divide(distance_q13(t, axis), ticks, 9), FASTEST_Q22) -
        t->fraction_q22[axis] / (i32)ticks;
    const i32 v0_q22 = t->velocity.axis_q22[axis];
    const i32 v1_q22 = t->goal_velocity.axis_q22[axis];
    const i32 a_q22 = (6 * mean_q22 - 4 * v0_q22 - 2 * v1_q22) / (i32)ticks;
    const i32 j_q22 = (6 * v0_q22 + 6 * v1_q22 - 12 * mean_q22) / (i32)ticks / (i32)ticks;
    move(t, axis, v0_q22 + a_q22 / 2 + j_q22 / 6);
    t->velocity.axis_q22[axis] = fixed_clamp_i32(v0_q22 + a_q22 + j_q22 / 2, FASTEST_Q22);
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

/* One trial of the bisection of the header. */
static void shorten(trajectory *t, const parameters *p) {
    if (t->trial_ticks <= t->ticks_left / 64U) {
        t->trial_ticks = 0;
        return;
    }
    if (t->ticks_left >= t->trial_ticks + SHORTEST_TICKS &&
        plan_fits(t, p, (u16)(t->ticks_left - t->trial_ticks)))
        t->ticks_left = (u16)(t->ticks_left - t->trial_ticks);
    t->trial_ticks /= 2U;
}

void trajectory_step_to_pose(trajectory *t, const parameters *p) {
    shorten(t, p);
    if (t->ticks_left == 0) {
        coast(t);
        return;
    }
    if (t->ticks_left == 1) {
        arrive(t);
    } else {
        u16 axis;
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

/* 1 when it cuts the change. */
static u16 limit_acceleration(const parameters *p, traction_change *change) {
    const i32 limit_q22 = change_limit_q22(PARAMETER_GET(p, acceleration_limit_q10));
    const i32 turning_limit_q22 =
        change_limit_q22(PARAMETER_GET(p, angular_acceleration_limit_q8)) *
        4; /* Q8 is 2 bits less */
    /* Q12, since a reversal at full speed is twice the range of Q13 */
    const i16 x_q12 = fixed_saturate_i16(fixed_shift_right(change->axis_q22[0], 10));
    const i16 y_q12 = fixed_saturate_i16(fixed_shift_right(change->axis_q22[1], 10));
    const u16 too_much = fixed_is_longer(x_q12, y_q12, (i16)(limit_q22 / 1024)); /* Q22 -> Q12 */
    const i32 turning_q22 = fixed_clamp_i32(change->axis_q22[2], turning_limit_q22);
    const u16 cut = too_much || change->axis_q22[2] != turning_q22;
    if (too_much) {
        const u16 size_q12 = fixed_hypot(x_q12, y_q12);
        change->axis_q22[0] = along_q22(x_q12, size_q12, limit_q22);
        change->axis_q22[1] = along_q22(y_q12, size_q12, limit_q22);
    }
    change->axis_q22[2] = turning_q22;
    return cut;
}

control_limit trajectory_step_velocity(trajectory *t, const parameters *p,
                                       const kinematics_velocity *body, u16 *wheel) {
    const odometry_heading heading = odometry_heading_of(odometry_binary_angle(t->position_q13[2]));
    kinematics_velocity world = *body;
    traction_change change;
    control_limit limit = CONTROL_LIMIT_NONE;
    u16 axis;
    if (limit_speed(p, &world))
        limit = CONTROL_LIMIT_SPEED;
    odometry_body_to_world(heading, &world.x_m_s_q13, &world.y_m_s_q13);
    set_velocity(&t->goal_velocity, &world);
    for (axis = 0; axis < 3; axis++) {
        change.axis_q22[axis] =
            fixed_subtract_i32(t->goal_velocity.axis_q22[axis], t->velocity.axis_q22[axis]);
    }
    if (limit_acceleration(p, &change))
        limit = CONTROL_LIMIT_ACCELERATION;
    *wheel = traction_limit(p, heading, &change);
    if (*wheel != 0)
        limit = CONTROL_LIMIT_TRACTION;
    for (axis = 0; axis < 3; axis++)
        t->velocity.axis_q22[axis] =
            fixed_clamp_i32(t->velocity.axis_q22[axis] + change.axis_q22[axis], FASTEST_Q22);
    coast(t);
    t->ticks_left = 0;
    return limit;
}
