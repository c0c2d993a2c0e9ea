#include "hal/lf2407a/host_names.h"
/* Names first: hal.h must declare the drivers' functions here. */
#include "board/board_hal.h"
#include "hal/hal.h"
#include "hal/lf2407a/drivers.h"

namespace omnislip {

const hal_host_plant &board_hal() {
    static const hal_host_plant plant = {
        nullptr,
        [](void *, std::uint16_t counts[4]) { hal_read_encoder_counts(counts); },
        [](void *, const std::int16_t duty_q15[4]) { hal_write_duty(duty_q15); },
        [](void *) -> std::uint16_t { return hal_read_supply_mv(); },
        [](void *) -> std::uint16_t { return hal_read_encoder_errors(); },
        [](void *, std::int16_t current_ma[4]) { hal_read_currents_ma(current_ma); },
        [](void *, std::uint16_t on) { hal_enable_bridges(on); },
        [](void *) -> std::uint16_t { return hal_read_bridge_faults(); },
        [](void *, std::uint16_t *byte) -> std::uint16_t { return hal_serial_read(byte); },
        [](void *) -> std::uint16_t { return hal_serial_space(); },
        [](void *, std::uint16_t byte) { hal_serial_write(byte); },
        [](void *) -> std::uint16_t { return hal_serial_lost(); },
        [](void *) -> std::uint16_t { return hal_store_busy(); },
        [](void *, std::uint16_t address) -> std::uint16_t { return hal_store_read(address); },
        [](void *, std::uint16_t address, std::uint16_t word) { hal_store_write(address, word); },
        [](void *) -> std::uint16_t { return hal_read_reset_cause(); },
        [](void *) { hal_service_watchdog(); },
        [](void *) -> std::uint16_t { return hal_read_tick_overruns(); },
    };
    return plant;
}

BoardVectors board_vectors() {
    return {nullptr, nullptr, board_int3, nullptr, board_int5, nullptr};
}

}  // namespace omnislip
