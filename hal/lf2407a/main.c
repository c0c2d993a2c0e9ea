/* The robot on its board. */
#include "firmware/robot.h"
#include "hal/lf2407a/drivers.h"
#include "hal/lf2407a/target.h"

static robot the_robot;

int main(void) {
    board_start();
    robot_init(&the_robot);
    board_run();
    for (;;) {
        if (board_tick_due())
            robot_tick(&the_robot);
        else
            CPU_WAIT;
    }
}
