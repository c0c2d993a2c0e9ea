/* robot_carrier.h - what carries the firmware of a virtual robot: between the plant's body and
 * hal.h, and at the other end of the serial line.
 *
 * The line has 115200 baud: bytes that are sent to it wait until the ones before them have passed,
 * and what the robot sends is received when the line has delivered it. Supply and currents have the
 * steps of the board's converter, 32 mV and 64 mA (board/on_board.h), and noise of one step
 * (standard deviation); the same in every run.
 */
#ifndef OMNISLIP_SIM_ROBOT_CARRIER_H
#define OMNISLIP_SIM_ROBOT_CARRIER_H

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "robot_body.h"

namespace omnislip {

class RobotCarrier {
  public:
    virtual ~RobotCarrier() = default;
    /* Has `work` done where the functions of the HAL and the two below reach this carrier. */
    virtual void with_hal(const std::function<void()> &work) = 0;
    /* After robot_init: starts the tick; tick 0 is due at 0 s. */
    virtual void start_tick() = 0;
    /* After the tick before it: until tick number `next` is due. */
    virtual void run_to_tick(long next) = 0;
    virtual void send(const std::vector<std::uint8_t> &bytes) = 0;
    /* What came from the robot since the last call. */
    virtual std::vector<std::uint8_t> take_received() = 0;
    /* The words of the EEPROM, and how often one was written. */
    virtual std::vector<std::uint16_t> store() const = 0;
    virtual long store_writes() const = 0;
};

/* `store`: HAL_STORE_WORDS words. The stub gives the body to the HAL directly; its serial buffers
 * are those of hal/lf2407a/serial.c. */
std::unique_ptr<RobotCarrier> carry_on_stub(RobotBody &body,
                                            const std::vector<std::uint16_t> &store);
/* The drivers of hal/lf2407a on the virtual LF2407A. */
std::unique_ptr<RobotCarrier> carry_on_board(RobotBody &body,
                                             const std::vector<std::uint16_t> &store);

}  // namespace omnislip

#endif
