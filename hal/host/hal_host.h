/* Host side of the seam: the firmware's hal.h calls are passed on to an attached plant.
 *
 * The attachment belongs to the calling thread, so many robots can run on many threads; a thread
 * that runs several robots attaches the plant of a robot before each of its ticks.
 *
 * Errors: a HAL call on a thread without a plant, or a plant without all three functions, aborts
 * with one line: both are mistakes of the program.
 */
#ifndef HAL_HOST_HAL_HOST_H
#define HAL_HOST_HAL_HOST_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    void *context; /* handed to each function */
    void (*read_encoder_counts)(void *context, uint16_t counts[4]);
    void (*write_duty)(void *context, const int16_t duty_q15[4]);
    uint16_t (*read_supply_mv)(void *context);
} hal_host_plant;

/* Copies the plant; NULL detaches. */
void hal_host_attach(const hal_host_plant *plant);

#ifdef __cplusplus
}
#endif

#endif
