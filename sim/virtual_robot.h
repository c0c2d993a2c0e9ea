/* virtual_robot.h - the whole robot on a PC: the firmware's robot_tick on the plant, a serial line
 * and an EEPROM around it, on the stub HAL or on the virtual LF2407A (robot_carrier.h). */
#ifndef OMNISLIP_SIM_VIRTUAL_ROBOT_H
#define OMNISLIP_SIM_VIRTUAL_ROBOT_H

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "firmware/robot.h"
#include "robot_body.h"
#include "robot_carrier.h"

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
                 const std::vector<std::uint16_t> &store, double step_s, Carrier carrier);
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
    std::vector<std::uint16_t> store() const {
        return carrier_->store();
    }
    long store_writes() const {
        return carrier_->store_writes();
    }
    const robot &firmware() const {
        return robot_;
    }
    const RobotBody &body() const {
        return body_;
    }

  private:
    void note_command();

    const std::vector<UserTerm> terms_;
    const BoardSensors sensors_;
    RobotBody body_;
    std::unique_ptr<RobotCarrier> carrier_;
    robot robot_ = {};
    long tick_ = 0;
    HeldCommand held_;
    std::vector<HeldCommand> commands_;
};

}  // namespace omnislip

#endif
