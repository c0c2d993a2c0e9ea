/* The 1 kHz control loop of the robot, from a command to four duties; drawn in control_loop.c.
 *
 * The supervisor (supervisor.def) decides whether commands are taken: the first tick ends BOOT,
 * control_loop_arm switches the power stage on. A command lives for the parameter
 * command_timeout; whoever commands repeats it. Repeating a pose command does not plan anew. A new
 * command is taken over in flight, without a jump of the target's speed.
 *
 * The duty is zero in the tick that sees a fault, and in the one after control_loop_stop. The
 * target then rests on the odometry, and the next command starts from the motion that the odometry
 * sees.
 *
 * With parameter slip_compensation = 1 the odometry is that of the slip observer and the rim speeds
 * carry the slip that the demanded force needs; with 0 wheels are taken to roll. Gains and limits
 * are the same in both.
 *
 * All functions of one loop belong to one thread of execution: on the robot, commands are called
 * with the tick interrupt masked or from it.
 */
#ifndef FIRMWARE_CONTROL_LOOP_H
#define FIRMWARE_CONTROL_LOOP_H

#include "firmware/kinematics.h"
#include "firmware/odometry.h"
#include "firmware/outside_pose.h"
#include "firmware/parameters.h"
#include "firmware/slip_observer.h"
#include "firmware/supervisor.h"
#include "firmware/traction.h"
#include "firmware/trajectory.h"
#include "firmware/wheel_monitor.h"
#include "firmware/wheel_pid.h"
#include "firmware/wheel_speed.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum {
    CONTROL_MODE_IDLE = 0,
    CONTROL_MODE_VELOCITY,
    CONTROL_MODE_POSE,
    CONTROL_MODE_DUTY
} control_mode;

typedef struct {
    i16 duty_q15[WHEEL_COUNT];
    u16 encoder_counts[WHEEL_COUNT];
    i16 current_ma[WHEEL_COUNT];
    u16 supply_mv;
    i16 shaft_rad_s_q5[WHEEL_COUNT];
    i16 force_n_q8[WHEEL_COUNT];   /* observer: force of the wheel on the body, drive direction */
    i16 slip_m_s_q13[WHEEL_COUNT]; /* observer: rim speed minus hub speed */
    i16 null_slip_m_s_q13;         /* kinematics.h: needs no friction model */
    kinematics_velocity rolling;   /* body velocity if no wheel slips */
    kinematics_velocity observed;  /* body velocity of the slip observer */
    odometry_pose pose;            /* world frame */
    odometry_pose target;          /* world frame */
    control_mode mode;
    control_limit limit; /* what limits the robot in this tick; the largest that applies */
    u16 limit_wheel;     /* 1..4: the wheel that demands it; 0: none */
    supervisor_state state;
    supervisor_fault fault; /* in FAULT the present one, else why the robot last stopped */
    u16 fault_wheel;        /* 1..4; 0: none or all */
} control_loop_telemetry;

typedef struct {
    const parameters *settings;
    supervisor supervision;
    wheel_monitor monitor[WHEEL_COUNT];
    u16 bridges_on;
    wheel_speed speed[WHEEL_COUNT];
    wheel_pid pid[WHEEL_COUNT];
    i16 wheel_target_rad_s_q5[WHEEL_COUNT];
    u16 wheel_target_rest_q13[WHEEL_COUNT]; /* beyond the target: rounding errors must not add up */
    slip_observer observer;
    outside_pose outside;
    trajectory target;
    traction_change demand; /* velocity demanded of the body, world frame */
    kinematics_velocity command_velocity;
    odometry_pose command_pose;
    kinematics_velocity command_arrival;
    i16 command_duty_q15[WHEEL_COUNT];
    i16 command_age_ms;
    u16 counters_known;
    control_loop_telemetry telemetry;
} control_loop;

/* At rest at the world origin, power stage off, in state BOOT. Keeps the pointer: parameters may
 * change between ticks. */
void control_loop_init(control_loop *loop, const parameters *p);

/* Requests to the supervisor: 1 when the state grants it, else 0 and nothing changes. */
u16 control_loop_arm(control_loop *loop);
u16 control_loop_disarm(control_loop *loop);
u16 control_loop_clear_fault(control_loop *loop);
/* Never refused. */
void control_loop_stop(control_loop *loop);
/* A fault that another part of the firmware sees; once a tick for as long as it lasts. */
void supervisor_report(control_loop *loop, supervisor_fault fault);

/* Commands are granted when armed or driving; else they return 0 and nothing changes. */

/* Body frame, mm/s and mrad/s; limited to the limits of speed along its direction. */
u16 control_loop_command_velocity(control_loop *loop, i16 x_mm_s, i16 y_mm_s, i16 omega_mrad_s);
/* Pose and the velocity on arrival there, both in the world frame. TRAJECTORY_REFUSED when not
 * granted; TRAJECTORY_TOO_FAR leaves the present command in force. */
trajectory_status control_loop_command_pose(control_loop *loop, const odometry_pose *goal,
                                            const kinematics_velocity *arrival);
/* Duties straight to the bridges, for identification; limited to duty_limit. */
u16 control_loop_command_duty(control_loop *loop, const i16 duty_q15[WHEEL_COUNT]);

/* The world pose that a camera saw age_ms ago (outside_pose.h), in any state. Returns 0, and
 * nothing changes, when the age is negative or above OUTSIDE_POSE_LONGEST_AGE_MS. */
u16 control_loop_outside_pose(control_loop *loop, const odometry_pose *pose, i16 age_ms);

/* Every 1 ms. */
void control_loop_tick(control_loop *loop);

#ifdef __cplusplus
}
#endif

#endif
