/* Line, store, watchdog and reset of a robot of integers; see integer_hal.h. */
#include "tests/firmware/integer_hal.h"

#include "firmware/link.h"

#define SEND_BUFFER_BYTES 128U
#define LINE_BYTES_PER_TICK 11U /* 115200 baud */

u32 checksum = 0;
i16 applied_duty_q15[4];
u16 bridges_on = 0;
frame_writer request;

static u32 seed = 1;
static u16 received_bytes; /* of the request */
static u16 sequence = 0;
static u16 waiting_bytes; /* in the send buffer */
static u16 stored[HAL_STORE_WORDS];

u16 next_random(void) {
    seed = seed * (u32)1664525 + (u32)1013904223;
    return (u16)(seed >> 16);
}

void mix(u32 value) {
    checksum = (checksum << 5) + (checksum >> 27) + value;
}

void integer_hal_start(void) {
    u16 address;
    for (address = 0; address < HAL_STORE_WORDS; address++)
        stored[address] = 0xFFFFU;
    request.length = 0;
}

void integer_hal_tick(void) {
    waiting_bytes =
        (u16)(waiting_bytes < LINE_BYTES_PER_TICK ? 0 : waiting_bytes - LINE_BYTES_PER_TICK);
}

void begin_request(u16 code) {
    frame_begin(&request);
    frame_add_u8(&request, LINK_VERSION);
    frame_add_u8(&request, code);
    frame_add_u8(&request, sequence++);
    received_bytes = 0;
}

u16 request_is_received(void) {
    return received_bytes >= request.length;
}

/* ---- HAL ---- */

void hal_write_duty(const i16 duty_q15[4]) {
    u16 i;
    for (i = 0; i < 4; i++) {
        applied_duty_q15[i] = duty_q15[i];
        mix((u16)duty_q15[i]);
    }
}

void hal_enable_bridges(u16 on) {
    bridges_on = on;
    mix(on);
}

u16 hal_serial_read(u16 *byte) {
    if (request_is_received())
        return 0;
    *byte = request.byte[received_bytes++];
    return 1;
}

u16 hal_serial_space(void) {
    return (u16)(SEND_BUFFER_BYTES - waiting_bytes);
}

void hal_serial_write(u16 byte) {
    waiting_bytes++;
    mix(byte);
}

u16 hal_store_busy(void) {
    return 0;
}

u16 hal_store_read(u16 address) {
    return stored[address];
}

void hal_store_write(u16 address, u16 word) {
    stored[address] = word;
    mix((u32)address << 16 | word);
}

hal_reset_cause hal_read_reset_cause(void) {
    return HAL_RESET_POWER_ON;
}

void hal_service_watchdog(void) {
    mix(1);
}

u16 hal_read_tick_overruns(void) {
    return 0;
}
