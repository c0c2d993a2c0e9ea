/* dispatch.cpp - picks at run time, of what is compiled once per instruction set, the widest that
 * this processor can run. */
#include "replay.h"
#include "robot_motion.h"

namespace omnislip {

#if defined(__x86_64__)
Kernel *make_kernel_sse2(int kind, const UserTermList &terms);
Kernel *make_kernel_avx2(int kind, const UserTermList &terms);
Kernel *make_kernel_avx512f(int kind, const UserTermList &terms);
RobotMotion *make_robot_motion_sse2(const double *values, int size, const UserTermList &terms);
RobotMotion *make_robot_motion_avx2(const double *values, int size, const UserTermList &terms);

static bool has_avx2() {
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
}

std::unique_ptr<Kernel> make_kernel(int kind, int widest_lanes, const UserTermList &terms) {
    if (widest_lanes >= 8 && __builtin_cpu_supports("avx512f") &&
        __builtin_cpu_supports("avx512dq")) {
        return std::unique_ptr<Kernel>(make_kernel_avx512f(kind, terms));
    }
    if (widest_lanes >= 4 && has_avx2())
        return std::unique_ptr<Kernel>(make_kernel_avx2(kind, terms));
    return std::unique_ptr<Kernel>(make_kernel_sse2(kind, terms));
}

std::unique_ptr<RobotMotion> make_robot_motion(const double *values, int size,
                                               const UserTermList &terms, int widest_lanes) {
    if (widest_lanes >= 4 && has_avx2())
        return std::unique_ptr<RobotMotion>(make_robot_motion_avx2(values, size, terms));
    return std::unique_ptr<RobotMotion>(make_robot_motion_sse2(values, size, terms));
}
#else
Kernel *make_kernel_neon64(int kind, const UserTermList &terms);
RobotMotion *make_robot_motion_neon64(const double *values, int size, const UserTermList &terms);

std::unique_ptr<Kernel> make_kernel(int kind, int, const UserTermList &terms) {
    return std::unique_ptr<Kernel>(make_kernel_neon64(kind, terms));
}

std::unique_ptr<RobotMotion> make_robot_motion(const double *values, int size,
                                               const UserTermList &terms, int) {
    return std::unique_ptr<RobotMotion>(make_robot_motion_neon64(values, size, terms));
}
#endif

}  // namespace omnislip
