/* An example of @NAME@ on Linux: a line of @INPUTS@ numbers in, a line of @OUTPUTS@ numbers out.
 *
 *     gcc -std=c99 -O2 -ffp-contract=off @NAME@.c @NAME@_linux.c -o @NAME@ -lm
 *     ./@NAME@ < readings.txt > commands.txt
 */

#include <stdio.h>

#include "@NAME@.h"

int main(void)
{
    static @NAME@_state unit;
    double given[@INPUTS@];
    @REAL@ in[@INPUTS@], out[@OUTPUTS@];
    int status = 0;
    for (long line = 0; status == 0; line++) {
        for (int i = 0; i < @INPUTS@; i++) {
            if (scanf("%lf", &given[i]) != 1) {
                return 0;
            }
            in[i] = (@REAL@)given[i];
        }
        if (line == 0) {
            @BEGIN@
        }
        @STEP@
        for (int i = 0; i < @OUTPUTS@; i++) {
            printf("%.17g%c", (double)out[i], i + 1 < @OUTPUTS@ ? ' ' : '\n');
        }
        fflush(stdout);
    }
    fprintf(stderr, "@NAME@ has stopped: status %d\n", status);
    return 1;
}
