/* motion_hal.h - the motion part of hal/hal.h from a plant in C++, for a control loop without a
 * board. */
#ifndef OMNISLIP_SIM_MOTION_HAL_H
#define OMNISLIP_SIM_MOTION_HAL_H

#include <cstdint>

#include "hal/host/hal_host.h"

namespace omnislip {

/* Attached to this thread as long as it lives. Plant: counts, set_duty, supply_mv, currents_ma. */
template <class Plant>
class MotionHal {
  public:
    explicit MotionHal(Plant &plant) {
        hal_host_plant hal = {};
        hal.context = &plant;
        hal.read_encoder_counts = [](void *context, std::uint16_t counts[4]) {
            static_cast<Plant *>(context)->counts(counts);
        };
        hal.write_duty = [](void *context, const std::int16_t duty_q15[4]) {
            static_cast<Plant *>(context)->set_duty(duty_q15);
        };
        hal.read_supply_mv = [](void *context) {
            return static_cast<Plant *>(context)->supply_mv();
        };
        hal.read_currents_ma = [](void *context, std::int16_t current_ma[4]) {
            static_cast<Plant *>(context)->currents_ma(current_ma);
        };
        hal_host_attach(&hal);
    }
    ~MotionHal() {
        hal_host_attach(nullptr);
    }
    MotionHal(const MotionHal &) = delete;
    MotionHal &operator=(const MotionHal &) = delete;
};

}  // namespace omnislip

#endif
