/* motion_hal.h - plants in C++ behind hal/hal.h: attached, and the motion part of one for a control
 * loop without a board. */
#ifndef OMNISLIP_SIM_MOTION_HAL_H
#define OMNISLIP_SIM_MOTION_HAL_H

#include <cstdint>

#include "hal/host/hal_host.h"

namespace omnislip {

/* A plant that is attached to this thread as long as this lives. */
class AttachedHal {
  public:
    explicit AttachedHal(const hal_host_plant &plant) {
        hal_host_attach(&plant);
    }
    ~AttachedHal() {
        hal_host_attach(nullptr);
    }
    AttachedHal(const AttachedHal &) = delete;
    AttachedHal &operator=(const AttachedHal &) = delete;
};

/* Plant: counts, set_duty, supply_mv, currents_ma. */
template <class Plant>
class MotionHal {
  public:
    explicit MotionHal(Plant &plant) : attached_(calls_of(plant)) {}

  private:
    static hal_host_plant calls_of(Plant &plant) {
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
        return hal;
    }

    AttachedHal attached_;
};

}  // namespace omnislip

#endif
