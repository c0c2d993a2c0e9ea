/* Lets a test for the PC run on an AVR, a machine whose int has 16 bits, in the simulator simavr.
 *
 * stdout is the serial port, which simavr prints; sleeping with interrupts off ends the simulator.
 * Programs are compiled with -Dmain=program; what they return is printed last.
 */
#include <stdio.h>

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

#undef main

int program(void);

static int put(char character, FILE *stream) {
    (void)stream;
    UDR0 = (uint8_t)character;
    while (!(UCSR0A & (1 << UDRE0)))
        continue;
    return 0;
}

int main(void) {
    static FILE console = FDEV_SETUP_STREAM(put, NULL, _FDEV_SETUP_WRITE);
    UCSR0B = 1 << TXEN0;
    stdout = &console;
    printf("\nreturned %d\n", program());
    cli();
    sleep_mode();
    return 0;
}
