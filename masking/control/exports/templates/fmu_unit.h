/* The unit of this FMU: its variables, how it begins, and its step. */

#ifndef FMU_UNIT_H
#define FMU_UNIT_H

#include <math.h>
#include <string.h>

#include "@NAME@.h"

#define TOKEN "@TOKEN@"
#define INPUTS @INPUTS@
#define OUTPUTS @OUTPUTS@
#define STATES @STATES@
#define PERIOD @PERIOD@ /* 0: any length of a step */

typedef struct {
    @NAME@_state unit;
    double inputs[@INPUTS_SIZE@];
    double outputs[@OUTPUTS@];
    double time;
} instance_t;

static void begin(instance_t *i)
{
    @BEGIN@
}

/* Step to the end of a communication step, with inputs that are held; return what is wrong, if anything. */
static const char *advance(instance_t *i, double time, double length)
{
    const double count = PERIOD > 0.0 ? floor(length / PERIOD + 0.5) : 1.0;
    int status = 0;
    if (PERIOD > 0.0 && (count < 1.0 || fabs(length - count * PERIOD) > 1e-6 * PERIOD)) {
        return "the length of a communication step must be a multiple of the period, " "@PERIOD@";
    }
    i->time = time;
    for (double k = 0.0; k < count; k++) {
        @ADVANCE@
    }
    i->time = time + length;
    return status == 0 ? NULL : "the unit has stopped: a matrix became singular, or a number is not finite";
}

/* Value references: 0 the time, then inputs, outputs, states. */
static const double *variable(const instance_t *i, unsigned int reference)
{
    if (reference == 0) {
        return &i->time;
    }
    if (reference <= INPUTS) {
        return &i->inputs[reference - 1];
    }
    if (reference <= INPUTS + OUTPUTS) {
        return &i->outputs[reference - 1 - INPUTS];
    }
    return reference <= INPUTS + OUTPUTS + STATES ? &i->unit.@MEMORY@[reference - 1 - INPUTS - OUTPUTS] : NULL;
}

#endif
