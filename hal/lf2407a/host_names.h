/* On a PC the drivers stand behind hal/host like any other plant, so their hal functions need names
 * of their own there. Included before hal.h, by the compiler's command line. */
#ifndef HAL_LF2407A_HOST_NAMES_H
#define HAL_LF2407A_HOST_NAMES_H

#define hal_read_encoder_counts lf2407a_read_encoder_counts
#define hal_read_encoder_errors lf2407a_read_encoder_errors
#define hal_read_supply_mv lf2407a_read_supply_mv
#define hal_read_currents_ma lf2407a_read_currents_ma
#define hal_write_duty lf2407a_write_duty
#define hal_enable_bridges lf2407a_enable_bridges
#define hal_read_bridge_faults lf2407a_read_bridge_faults
#define hal_serial_read lf2407a_serial_read
#define hal_serial_space lf2407a_serial_space
#define hal_serial_write lf2407a_serial_write
#define hal_serial_lost lf2407a_serial_lost
#define hal_store_busy lf2407a_store_busy
#define hal_store_read lf2407a_store_read
#define hal_store_write lf2407a_store_write
#define hal_read_reset_cause lf2407a_read_reset_cause
#define hal_service_watchdog lf2407a_service_watchdog
#define hal_read_tick_overruns lf2407a_read_tick_overruns

#endif
