// Firmware and host HAL from C++: headers compile, symbols have C linkage, callbacks are
// captureless lambdas.
#include <cstdint>
#include <cstdio>

#include "firmware/control_loop.h"
#include "firmware/fixed_point.h"
#include "hal/host/hal_host.h"

int main() {
    int writes = 0;
    hal_host_plant plant = {};
    plant.context = &writes;
    plant.read_encoder_counts = [](void *, std::uint16_t counts[4]) {
        counts[0] = counts[1] = counts[2] = counts[3] = 0;
    };
    plant.write_duty = [](void *context, const std::int16_t *) { ++*static_cast<int *>(context); };
    plant.read_supply_mv = [](void *) -> std::uint16_t { return 24000; };
    parameters p;
    control_loop loop;
    parameters_set_defaults(&p);
    hal_host_attach(&plant);
    control_loop_init(&loop, &p);
    control_loop_tick(&loop);
    control_loop_tick(&loop);
    std::printf("%d duties written in 2 ticks\n", writes);
    return writes == 2 && fixed_sine_q15(0) == 0 ? 0 : 1;
}
