/* How the drivers reach the chip. They use nothing else, so that the same sources run on the
 * LF2407A and on the virtual board of sim/board, which sees every access in order.
 *
 * REGISTER_READ, REGISTER_WRITE   data space, 16 bits
 * IO_WRITE_WSGR                   the wait-state register, in I/O space
 * INTERRUPTS_OFF, INTERRUPTS_ON   INTM; not nestable
 * INTERRUPT                       qualifies an interrupt service routine
 * DRIVER_DATA                     storage of a driver's state
 * CPU_WAIT                        the body of a loop that waits for an interrupt
 */
#ifndef HAL_LF2407A_TARGET_H
#define HAL_LF2407A_TARGET_H

#include "firmware/integers.h"

#ifdef OMNISLIP_VIRTUAL_BOARD

#ifdef __cplusplus
extern "C" {
#endif
/* Defined by sim/board/board.cpp; each board belongs to the thread that runs it. */
u16 virtual_board_read(u16 address);
void virtual_board_write(u16 address, u16 value);
void virtual_board_write_wsgr(u16 value);
void virtual_board_mask_interrupts(int masked);
void virtual_board_wait(void);
#ifdef __cplusplus
}
#endif

#define REGISTER_READ(address) virtual_board_read((u16)(address))
#define REGISTER_WRITE(address, value) virtual_board_write((u16)(address), (u16)(value))
#define IO_WRITE_WSGR(value) virtual_board_write_wsgr((u16)(value))
#define INTERRUPTS_OFF virtual_board_mask_interrupts(1)
#define INTERRUPTS_ON virtual_board_mask_interrupts(0)
#define INTERRUPT
#define DRIVER_DATA static __thread
#define CPU_WAIT virtual_board_wait()

#else

#define REGISTER_READ(address) (*(volatile u16 *)(address))
#define REGISTER_WRITE(address, value) (*(volatile u16 *)(address) = (u16)(value))
ioport unsigned portffff; /* the name is the compiler's way to say the I/O address FFFFh */
#define IO_WRITE_WSGR(value) (portffff = (value))
#define INTERRUPTS_OFF asm(" setc INTM")
#define INTERRUPTS_ON asm(" clrc INTM")
#define INTERRUPT interrupt
#define DRIVER_DATA static
                          /* Not IDLE: an interrupt between the test of the loop and IDLE would be slept through. */
#define CPU_WAIT ((void)0)

#endif

#endif
