/* Host HAL: calls reach the plant of their own thread, and a mistake in the attachment aborts. */
#include <pthread.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>
#include <unity.h>

#include "hal/hal.h"
#include "hal/host/hal_host.h"

typedef struct {
    uint16_t first_count;
    int16_t duty_q15[4];
} echo;

static void read_counts(void *context, uint16_t counts[4]) {
    for (int i = 0; i < 4; i++)
        counts[i] = (uint16_t)(((echo *)context)->first_count + i);
}

static void write_duty(void *context, const int16_t duty_q15[4]) {
    for (int i = 0; i < 4; i++)
        ((echo *)context)->duty_q15[i] = duty_q15[i];
}

static uint16_t read_supply(void *context) {
    return (uint16_t)(((echo *)context)->first_count * 2u);
}

static void attach(echo *plant) {
    const hal_host_plant host = {.context = plant,
                                 .read_encoder_counts = read_counts,
                                 .write_duty = write_duty,
                                 .read_supply_mv = read_supply};
    hal_host_attach(&host);
}

void setUp(void) {}

void tearDown(void) {
    hal_host_attach(NULL);
}

static void calls_reach_the_attached_plant(void) {
    echo plant = {65533, {0, 0, 0, 0}};
    const i16 duty_q15[4] = {1, -2, 32767, -32767};
    u16 counts[4];
    attach(&plant);
    hal_read_encoder_counts(counts);
    hal_write_duty(duty_q15);
    TEST_ASSERT_EQUAL_UINT16(65533, counts[0]);
    TEST_ASSERT_EQUAL_UINT16(0, counts[3]);
    TEST_ASSERT_EQUAL_UINT16(65530, hal_read_supply_mv());
    TEST_ASSERT_EQUAL_INT16_ARRAY(duty_q15, plant.duty_q15, 4);
}

static void parts_that_a_plant_lacks_are_harmless(void) {
    echo plant = {0, {0, 0, 0, 0}};
    i16 current_ma[4] = {1, 2, 3, 4};
    const i16 none[4] = {0, 0, 0, 0};
    u16 byte = 7;
    attach(&plant);
    hal_read_currents_ma(current_ma);
    TEST_ASSERT_EQUAL_INT16_ARRAY(none, current_ma, 4);
    TEST_ASSERT_EQUAL_UINT16(0, hal_read_encoder_errors());
    hal_enable_bridges(1);
    TEST_ASSERT_EQUAL_UINT16(0, hal_read_bridge_faults());
    TEST_ASSERT_EQUAL_UINT16(0, hal_serial_read(&byte));
    TEST_ASSERT_EQUAL_UINT16(7, byte);
    TEST_ASSERT_EQUAL_UINT16(0, hal_serial_space());
    hal_serial_write(7);
    TEST_ASSERT_EQUAL_UINT16(0, hal_serial_lost());
    hal_store_write(0, 7);
    TEST_ASSERT_EQUAL_UINT16(0, hal_store_busy());
    TEST_ASSERT_EQUAL_UINT16(0xFFFF, hal_store_read(0));
    hal_service_watchdog();
    TEST_ASSERT_EQUAL_INT(HAL_RESET_POWER_ON, hal_read_reset_cause());
    TEST_ASSERT_EQUAL_UINT16(0, hal_read_tick_overruns());
}

/* A plant with every part: writes leave their trace, reads return what was written. */
typedef struct {
    uint16_t bridges_on, sent, stored, services;
} full_plant;

static void full_currents(void *context, int16_t current_ma[4]) {
    for (int i = 0; i < 4; i++)
        current_ma[i] = (int16_t)(-1000 * i);
    (void)context;
}
static void full_enable(void *context, uint16_t on) {
    ((full_plant *)context)->bridges_on = on;
}
static uint16_t full_receive(void *context, uint16_t *byte) {
    *byte = ((full_plant *)context)->sent;
    return 1;
}
static void full_send(void *context, uint16_t byte) {
    ((full_plant *)context)->sent = byte;
}
static void full_store_write(void *context, uint16_t address, uint16_t word) {
    ((full_plant *)context)->stored = (uint16_t)(address + word);
}
static uint16_t full_store_read(void *context, uint16_t address) {
    return (uint16_t)(((full_plant *)context)->stored - address);
}
static void full_service(void *context) {
    ((full_plant *)context)->services++;
}
static uint16_t one(void *context) {
    (void)context;
    return 1;
}
static uint16_t two(void *context) {
    (void)context;
    return 2;
}
static uint16_t three(void *context) {
    (void)context;
    return 3;
}
static uint16_t four(void *context) {
    (void)context;
    return 4;
}
static uint16_t five(void *context) {
    (void)context;
    return 5;
}

static void every_part_is_passed_on(void) {
    full_plant plant = {0, 0, 0, 0};
    const hal_host_plant host = {.context = &plant,
                                 .read_encoder_counts = read_counts,
                                 .write_duty = write_duty,
                                 .read_supply_mv = read_supply,
                                 .read_encoder_errors = two,
                                 .read_currents_ma = full_currents,
                                 .enable_bridges = full_enable,
                                 .read_bridge_faults = three,
                                 .serial_read = full_receive,
                                 .serial_space = four,
                                 .serial_write = full_send,
                                 .serial_lost = five,
                                 .store_busy = one,
                                 .store_read = full_store_read,
                                 .store_write = full_store_write,
                                 .read_reset_cause = one,
                                 .service_watchdog = full_service,
                                 .read_tick_overruns = two};
    i16 current_ma[4];
    u16 byte = 0;
    hal_host_attach(&host);
    hal_read_currents_ma(current_ma);
    TEST_ASSERT_EQUAL_INT16(-3000, current_ma[3]);
    TEST_ASSERT_EQUAL_UINT16(2, hal_read_encoder_errors());
    hal_enable_bridges(1);
    TEST_ASSERT_EQUAL_UINT16(1, plant.bridges_on);
    TEST_ASSERT_EQUAL_UINT16(3, hal_read_bridge_faults());
    hal_serial_write(200);
    TEST_ASSERT_EQUAL_UINT16(1, hal_serial_read(&byte));
    TEST_ASSERT_EQUAL_UINT16(200, byte);
    TEST_ASSERT_EQUAL_UINT16(4, hal_serial_space());
    TEST_ASSERT_EQUAL_UINT16(5, hal_serial_lost());
    hal_store_write(10, 99);
    TEST_ASSERT_EQUAL_UINT16(1, hal_store_busy());
    TEST_ASSERT_EQUAL_UINT16(99, hal_store_read(10));
    TEST_ASSERT_EQUAL_INT(HAL_RESET_WATCHDOG, hal_read_reset_cause());
    hal_service_watchdog();
    TEST_ASSERT_EQUAL_UINT16(1, plant.services);
    TEST_ASSERT_EQUAL_UINT16(2, hal_read_tick_overruns());
}

static void *other_thread(void *context) {
    attach(context);
    for (int n = 0; n < 10000; n++) {
        u16 counts[4];
        hal_read_encoder_counts(counts);
        if (counts[0] != ((echo *)context)->first_count)
            return context;
    }
    return NULL;
}

static void threads_have_their_own_plants(void) {
    echo here = {100, {0, 0, 0, 0}}, there = {200, {0, 0, 0, 0}};
    pthread_t thread;
    void *mixed_up;
    attach(&here);
    pthread_create(&thread, NULL, other_thread, &there);
    for (int n = 0; n < 10000; n++)
        TEST_ASSERT_EQUAL_UINT16(200, hal_read_supply_mv());
    pthread_join(thread, &mixed_up);
    TEST_ASSERT_NULL(mixed_up);
}

/* The signal that ends a child process which does this; 0 when none does. */
static int signal_of(void (*mistake)(void)) {
    int status = 0;
    const pid_t child = fork();
    if (child == 0) {
        close(STDERR_FILENO);
        mistake();
        _exit(0);
    }
    waitpid(child, &status, 0);
    return WIFSIGNALED(status) ? WTERMSIG(status) : 0;
}

static void read_without_plant(void) {
    hal_host_attach(NULL);
    hal_read_supply_mv();
}

static void attach_half_a_plant(void) {
    const hal_host_plant host = {.read_encoder_counts = read_counts, .read_supply_mv = read_supply};
    hal_host_attach(&host);
}

static void mistakes_abort(void) {
    TEST_ASSERT_EQUAL_INT(SIGABRT, signal_of(read_without_plant));
    TEST_ASSERT_EQUAL_INT(SIGABRT, signal_of(attach_half_a_plant));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(calls_reach_the_attached_plant);
    RUN_TEST(parts_that_a_plant_lacks_are_harmless);
    RUN_TEST(every_part_is_passed_on);
    RUN_TEST(threads_have_their_own_plants);
    RUN_TEST(mistakes_abort);
    return UNITY_END();
}
