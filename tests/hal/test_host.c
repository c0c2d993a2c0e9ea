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
    const hal_host_plant host = {plant, read_counts, write_duty, read_supply};
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
    const hal_host_plant host = {NULL, read_counts, NULL, read_supply};
    hal_host_attach(&host);
}

static void mistakes_abort(void) {
    TEST_ASSERT_EQUAL_INT(SIGABRT, signal_of(read_without_plant));
    TEST_ASSERT_EQUAL_INT(SIGABRT, signal_of(attach_half_a_plant));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(calls_reach_the_attached_plant);
    RUN_TEST(threads_have_their_own_plants);
    RUN_TEST(mistakes_abort);
    return UNITY_END();
}
