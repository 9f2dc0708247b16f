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
#define PARAMETERS @PARAMETERS@
#define HAS_START @HAS_START@ /* whether states can be set before the first step */
#define PERIOD @PERIOD@ /* 0: any length of a step */

typedef struct {
    @NAME@_state unit;
    double inputs[@INPUTS_SIZE@];
    double outputs[@OUTPUTS@];
    double time;
    double chosen[@CHOSEN_SIZE@]; /* start values of states, then parameters, that were set */
    unsigned char is_chosen[@CHOSEN_SIZE@];
    unsigned char is_initialized;
} instance_t;

/* Place of a state or, behind the states, of a parameter. */
static double *place(instance_t *i, unsigned int k)
{
    static const int places[] = {@PLACES@};
    return k + 1 <= STATES ? &i->unit.@MEMORY@[k] : &i->unit.p[places[k - STATES]];
}

static void choose(instance_t *i)
{
    for (unsigned int k = 0; k + 1 <= STATES + PARAMETERS; k++) {
        if (i->is_chosen[k]) {
            *place(i, k) = i->chosen[k];
        }
    }
}

static void begin(instance_t *i)
{
    @BEGIN@
}

/* Set a variable; return what is wrong, if anything. */
static const char *set(instance_t *i, unsigned int reference, double value)
{
    const unsigned int k = reference - 1 - INPUTS - OUTPUTS;
    if (reference >= 1 && reference <= INPUTS) {
        i->inputs[reference - 1] = value;
        return NULL;
    }
    if (reference <= INPUTS + OUTPUTS || k + 1 > STATES + PARAMETERS || (k + 1 <= STATES && !HAS_START)) {
        return "only inputs, parameters and start values of states can be set";
    }
    if (k + 1 <= STATES && i->is_initialized) {
        return "the start value of a state can be set until initialization ends";
    }
    i->chosen[k] = value;
    i->is_chosen[k] = 1;
    if (i->is_initialized) {
        choose(i);
    } else {
        begin(i);
    }
    return NULL;
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

/* Value references: 0 the time, then inputs, outputs, states, parameters. */
static const double *variable(instance_t *i, unsigned int reference)
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
    reference -= 1 + INPUTS + OUTPUTS;
    return reference + 1 <= STATES + PARAMETERS ? place(i, reference) : NULL;
}

#endif
