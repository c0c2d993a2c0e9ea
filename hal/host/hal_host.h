/* Host side of the seam: the firmware's hal.h calls are passed on to an attached plant.
 *
 * The attachment belongs to the calling thread, so many robots can run on many threads; a thread
 * that runs several robots attaches the plant of a robot before each of its ticks.
 *
 * A plant must have counts, duty and supply. Every other function may be NULL, and then the plant
 * has no such part: no fault is ever seen, currents read 0, no byte arrives and sent bytes are
 * lost, the store is blank (all words 0xFFFF) and keeps nothing, every reset is a power-on.
 *
 * Errors: a HAL call on a thread without a plant, or a plant without its three functions, aborts
 * with one line: both are mistakes of the program.
 */
#ifndef HAL_HOST_HAL_HOST_H
#define HAL_HOST_HAL_HOST_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Units and meanings are those of hal.h. */
typedef struct {
    void *context; /* handed to each function */
    void (*read_encoder_counts)(void *context, uint16_t counts[4]);
    void (*write_duty)(void *context, const int16_t duty_q15[4]);
    uint16_t (*read_supply_mv)(void *context);
    uint16_t (*read_encoder_errors)(void *context);
    void (*read_currents_ma)(void *context, int16_t current_ma[4]);
    void (*enable_bridges)(void *context, uint16_t on);
    uint16_t (*read_bridge_faults)(void *context);
    uint16_t (*serial_read)(void *context, uint16_t *byte);
    uint16_t (*serial_space)(void *context);
    void (*serial_write)(void *context, uint16_t byte);
    uint16_t (*serial_lost)(void *context);
    uint16_t (*store_busy)(void *context);
    uint16_t (*store_read)(void *context, uint16_t address);
    void (*store_write)(void *context, uint16_t address, uint16_t word);
    uint16_t (*read_reset_cause)(void *context); /* a hal_reset_cause */
    void (*service_watchdog)(void *context);
    uint16_t (*read_tick_overruns)(void *context);
} hal_host_plant;

/* Copies the plant; NULL detaches. */
void hal_host_attach(const hal_host_plant *plant);

#ifdef __cplusplus
}
#endif

#endif
