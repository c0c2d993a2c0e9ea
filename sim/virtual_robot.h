/* virtual_robot.h - the whole robot on a PC: the firmware's robot_tick on the plant, a serial line
 * and an EEPROM around it.
 *
 * The line carries 115200 / 10 bytes a second each way: a byte that is given to `advance` waits
 * until the ones before it have passed. Buffers are those of hal/lf2407a/serial.c: a byte that
 * finds 64 unread is lost and counted. What the robot sends is returned when the line has delivered
 * it.
 *
 * Supply and currents have the steps of the board's converter, 32 mV and 64 mA (board/on_board.h),
 * and noise of one step (standard deviation); the same in every run.
 */
#ifndef OMNISLIP_SIM_VIRTUAL_ROBOT_H
#define OMNISLIP_SIM_VIRTUAL_ROBOT_H

#include <array>
#include <cstdint>
#include <deque>
#include <random>
#include <vector>

#include "firmware/robot.h"
#include "hal/host/hal_host.h"
#include "hal/host/hal_host_store.h"
#include "robot_body.h"

namespace omnislip {

/* What the firmware has been told to do, as it holds it (control_loop.h); unused values are 0. */
struct HeldCommand {
    long tick = 0; /* the first that acts on it */
    control_mode mode = CONTROL_MODE_IDLE;
    std::array<std::int32_t, 6> value = {};
    bool same_as(const HeldCommand &other) const {
        return mode == other.mode && value == other.value;
    }
};

class VirtualRobot {
  public:
    /* `values`, `terms`: parameter set and user's effects of RobotPlant. `store`: HAL_STORE_WORDS
     * words of the EEPROM, or empty for a blank one. */
    VirtualRobot(const std::vector<double> &values, const std::vector<UserTerm> &terms,
                 const std::vector<std::uint16_t> &store, double step_s);
    VirtualRobot(const VirtualRobot &) = delete;
    VirtualRobot &operator=(const VirtualRobot &) = delete;

    /* Puts bytes on the line to the robot, lets `ticks` milliseconds pass and returns what the line
     * has delivered from it. */
    std::vector<std::uint8_t> advance(long ticks, const std::vector<std::uint8_t> &sent);

    long ticks() const {
        return tick_;
    }
    /* The changes of the command during the last `advance`. */
    const std::vector<HeldCommand> &commands() const {
        return commands_;
    }
    std::vector<std::uint16_t> store() const;
    long store_writes() const {
        return static_cast<long>(store_.writes);
    }
    const robot &firmware() const {
        return robot_;
    }
    const RobotBody &body() const {
        return body_;
    }

  private:
    static hal_host_plant hal(VirtualRobot &self);
    std::uint16_t read_byte(std::uint16_t *byte);
    void deliver(std::vector<std::uint8_t> &delivered);
    void note_command();
    void measure();

    const std::vector<UserTerm> terms_;
    const BoardSensors sensors_;
    RobotBody body_;
    hal_host_store store_ = {};
    robot robot_ = {};
    std::uint16_t bridges_on_ = 0;
    std::mt19937 random_{1};
    std::normal_distribution<double> noise_;
    std::uint16_t supply_mv_ = 0;
    std::int16_t current_ma_[4] = {};
    long tick_ = 0;
    std::deque<std::uint8_t> to_robot_, received_, waiting_;
    double credit_to_robot_ = 0.0, credit_from_robot_ = 0.0; /* bytes that the line may pass now */
    std::uint16_t lost_ = 0;
    HeldCommand held_;
    std::vector<HeldCommand> commands_;
};

}  // namespace omnislip

#endif
