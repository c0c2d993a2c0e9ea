/* board_hal.h - the drivers of hal/lf2407a as a plant of hal/host, so that one build of the
 * firmware runs on a simulated plant or on the virtual board, whichever the thread attaches. */
#ifndef OMNISLIP_SIM_BOARD_BOARD_HAL_H
#define OMNISLIP_SIM_BOARD_BOARD_HAL_H

#include "board/board.h"
#include "hal/host/hal_host.h"

namespace omnislip {

/* For hal_host_attach; the board must be attached too. */
const hal_host_plant &board_hal();
/* The routines that vectors.asm enters. */
BoardVectors board_vectors();

}  // namespace omnislip

#endif
