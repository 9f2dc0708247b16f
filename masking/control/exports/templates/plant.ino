/* A sketch for Arduino or Teensy: a board that is a plant behind its serial port, here the twin @NAME@.
 *
 *     masking rig check serial:///dev/ttyACM0 --rate @RATE@
 *     masking rig run EXPERIMENT --plant serial:///dev/ttyACM0
 *
 * Put this file, frames.h, @NAME@.h and @NAME@.c into a folder @NAME@_arduino. On a rig, replace what stands in `begin`,
 * `sense` and `act` by its own inputs and outputs; `act` with zeros switches them off.
 *
 * Tested in QEMU with a stub of Arduino's library; not tested on a board.
 */

#include <Arduino.h>
#include <stdlib.h>

#include "frames.h"

extern "C" {
#include "@NAME@.h"
}

#define CHANNELS @CHANNELS@
#define REFUSED "this plant has @RATE@ samples per second: give that rate"
#define TAKEN "a controller has this plant; stop that one first"
#define SILENT "no valid command in the time of the watchdog"
#define STOPPED "the controller stopped"
#define TRIPPED(cause) "it has tripped: " cause "; look at the rig, then start once with --acknowledge"

static @NAME@_state unit;
static frames_reader reader;
static uint8_t line[FRAMES_STREAM];
static uint64_t session, now, answered;
static uint32_t before, silent, patience;
static double commands[@ACTUATORS@];
static int lockstep, has_answer, is_fresh;
static const char *tripped; /* why the last session was stopped, until a controller acknowledges it */
static enum { CLOSED, OPENED, RUNNING } state = CLOSED;

static void begin(void)
{
    @NAME@_init(&unit);
}

static void sense(double *readings)
{
    static const @REAL@ noise[@SENSORS@] = {0};
    @REAL@ found[@SENSORS@];
    @NAME@_read(&unit, noise, found);
    for (int i = 0; i < @SENSORS@; i++) {
        readings[i] = (double)found[i];
    }
}

static void act(const double *values)
{
    @REAL@ given[@ACTUATORS@];
    for (int i = 0; i < @ACTUATORS@; i++) {
        given[i] = (@REAL@)values[i];
    }
    @NAME@_step(&unit, given);
}

static void tell(int kind, uint64_t to, uint64_t index, const void *payload, uint32_t count)
{
    Serial.write(line, frames_write(line, kind, to, index, payload, count));
}

static void show(void)
{
    double readings[@SENSORS@];
    sense(readings);
    tell(FRAMES_SENSORS, session, now, readings, @SENSORS@);
}

static void close_session(void)
{
    memset(commands, 0, sizeof(commands));
    act(commands);
    state = CLOSED;
}

static double setting(const char *name)
{
    const char *at = strstr((const char *)reader.bytes + FRAMES_HEAD, name);
    return at == 0 ? 0.0 : strtod(at + strlen(name) + 2u, 0); /* behind ": */
}

static void open_session(void)
{
    reader.bytes[FRAMES_HEAD + reader.count] = 0; /* in the place of the check sum */
    const double rate = setting("rate"), limit = setting("watchdog") * rate;
    if (state == RUNNING && reader.session != session) {
        tell(FRAMES_REFUSE, reader.session, 0, TAKEN, sizeof(TAKEN) - 1u);
    } else if (!(rate * @PERIOD@ > 1.0 - 1e-6 && rate * @PERIOD@ < 1.0 + 1e-6)) {
        tell(FRAMES_REFUSE, reader.session, 0, REFUSED, sizeof(REFUSED) - 1u);
    } else if (tripped != 0 && strstr((const char *)reader.bytes + FRAMES_HEAD, "\"acknowledge\": true") == 0) {
        tell(FRAMES_REFUSE, reader.session, 0, tripped, (uint32_t)strlen(tripped));
    } else {
        if (state != RUNNING) {
            session = reader.session;
            lockstep = strstr((const char *)reader.bytes + FRAMES_HEAD, "\"lockstep\": true") != 0;
            patience = limit < 1.0 ? 1u : limit < 4e9 ? (uint32_t)(limit + 0.5) : 4000000000u;
            state = OPENED;
        }
        tell(FRAMES_ACCEPT, session, 0, CHANNELS, sizeof(CHANNELS) - 1u);
    }
}

static void start(void)
{
    memset(commands, 0, sizeof(commands));
    now = answered = 0;
    has_answer = is_fresh = 0;
    tripped = 0;
    silent = 0;
    begin();
    state = RUNNING;
    show();
    before = micros();
}

static void advance(void)
{
    silent = is_fresh ? 0 : silent + 1u;
    is_fresh = 0;
    if (has_answer && silent >= patience) {
        close_session();
        tripped = TRIPPED(SILENT);
        tell(FRAMES_STOP, session, 0, SILENT, sizeof(SILENT) - 1u);
        return;
    }
    act(commands);
    now++;
    show();
}

static void take(void)
{
    if (reader.count != @ACTUATORS@ || reader.index > now || (has_answer && reader.index <= answered) ||
        now - reader.index >= patience) {
        return;
    }
    for (int i = 0; i < @ACTUATORS@; i++) {
        const double value = frames_value(&reader, (uint32_t)i);
        if (!(value - value == 0.0)) { /* not finite */
            return;
        }
    }
    memcpy(commands, reader.bytes + FRAMES_HEAD, sizeof(commands));
    answered = reader.index;
    has_answer = is_fresh = 1;
    if (lockstep && answered == now) {
        advance();
    }
}

void setup()
{
    Serial.begin(115200);
    begin();
}

void loop()
{
    while (Serial.available() > 0) {
        if (!frames_feed(&reader, (uint8_t)Serial.read())) {
            continue;
        }
        if (reader.kind == FRAMES_HELLO) {
            open_session();
        } else if (state == CLOSED || reader.session != session) {
            continue;
        } else if (reader.kind == FRAMES_BYE) {
            close_session();
        } else if (reader.kind == FRAMES_STOP) {
            close_session();
            tripped = TRIPPED(STOPPED);
        } else if (reader.kind == FRAMES_START && state == OPENED) {
            start();
        } else if (reader.kind == FRAMES_COMMAND && state == RUNNING) {
            take();
        }
    }
    if (state == RUNNING && !lockstep && micros() - before >= (uint32_t)(1e6 * @PERIOD@)) {
        before += (uint32_t)(1e6 * @PERIOD@);
        advance();
    }
}
