/* A sketch for Arduino or Teensy: @NAME@ on the board drives the plant that a computer serves at the other end of USB.
 *
 *     masking rig serve PLANT --address serial:///dev/ttyACM0
 *
 * Put this file, frames.h, @NAME@.h and @NAME@.c into a folder @NAME@_arduino. On the rig itself, replace the frames by its
 * sensors and actuators: @NAME@_init with the first readings, then @NAME@_step with new ones once a period.
 *
 * Tested in QEMU with a stub of Arduino's library; not tested on a board.
 */

#include <Arduino.h>

#include "frames.h"

extern "C" {
#include "@NAME@.h"
}

#ifndef LOCKSTEP
#define LOCKSTEP "false" /* "true" with: masking rig serve --lockstep */
#endif
#ifndef ACKNOWLEDGE
#define ACKNOWLEDGE "false" /* "true" once it is known why the plant has tripped, which refuses to start without */
#endif
#define SETTINGS "{\"rate\": @RATE@, \"watchdog\": 0.02, \"lockstep\": " LOCKSTEP ", \"acknowledge\": " ACKNOWLEDGE "}"
#define FAILED "a command was not finite, or a matrix singular"
#define AGAIN 250u /* ms until a request is sent again */

static @NAME@_state unit;
static frames_reader reader;
static uint8_t line[FRAMES_STREAM];
static uint64_t session, last;
static enum { CLOSED, OPENED, RUNNING } state = CLOSED;
static uint32_t asked;

static void tell(int kind, uint64_t index, const void *payload, uint32_t count)
{
    Serial.write(line, frames_write(line, kind, session, index, payload, count));
}

static void ask(void)
{
    if (state == RUNNING || millis() - asked < AGAIN) {
        return;
    }
    asked = millis();
    if (state == CLOSED) {
        session = session * 6364136223846793005u + micros() + 1u;
        tell(FRAMES_HELLO, 0, SETTINGS, sizeof(SETTINGS) - 1u);
    } else {
        tell(FRAMES_START, 0, 0, 0);
    }
}

static void answer(void)
{
    @REAL@ readings[@INPUTS@], commands[@OUTPUTS@];
    double sent[@OUTPUTS@];
    for (int i = 0; i < @INPUTS@; i++) {
        readings[i] = (@REAL@)frames_value(&reader, (uint32_t)i);
    }
    if (state != RUNNING) {
        @NAME@_init(&unit, readings);
        state = RUNNING;
    } else {
        for (uint64_t missed = last + 1u; missed < reader.index; missed++) {
            @NAME@_miss(&unit, readings);
        }
    }
    last = reader.index;
    const int status = @NAME@_step(&unit, readings, commands);
    for (int i = 0; i < @OUTPUTS@; i++) {
        sent[i] = (double)commands[i];
    }
    tell(FRAMES_COMMAND, reader.index, sent, @OUTPUTS@);
    if (status != 0) {
        tell(FRAMES_STOP, 0, FAILED, sizeof(FAILED) - 1u);
        state = CLOSED;
    }
}

void setup()
{
    Serial.begin(115200);
    asked = millis() - AGAIN;
}

void loop()
{
    ask();
    while (Serial.available() > 0) {
        if (!frames_feed(&reader, (uint8_t)Serial.read()) || reader.session != session) {
            continue;
        }
        if (reader.kind == FRAMES_ACCEPT && state == CLOSED) {
            state = OPENED;
            asked = millis() - AGAIN;
            ask();
        } else if (reader.kind == FRAMES_SENSORS && state != CLOSED && reader.count == @INPUTS@) {
            if (state == OPENED || reader.index > last) {
                answer();
            }
        } else if (reader.kind == FRAMES_STOP) {
            state = CLOSED;
        }
    }
}
