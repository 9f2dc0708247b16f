/* An example of @NAME@ on a Cortex-M4F without an operating system: the board MPS2 with image AN386, which QEMU has.
 *
 *     arm-none-eabi-gcc -std=c99 -O2 -mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16 -ffp-contract=off \
 *         -nostartfiles --specs=nosys.specs -T cortex_m4.ld @NAME@.c @NAME@_cortex_m4.c -lm -o @NAME@.elf
 *     qemu-system-arm -M mps2-an386 -kernel @NAME@.elf -display none -monitor none -serial stdio -icount shift=6
 *
 * On serial port 0, bytes as they are in memory: 'i' and readings begin; 's' and readings are answered by commands and
 * a status (int32); 'r' is answered by what was measured (4 times uint32): clock ticks of the last step, of the longest
 * one, bytes of stack that steps needed, bytes of the state. Ticks are those of SysTick, the processor's clock.
 */

#include <stdint.h>

#include "@NAME@.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CONTROL REGISTER(0x40004008u)
#define UART_DIVIDER REGISTER(0x40004010u)
#define SYSTICK_CONTROL REGISTER(0xE000E010u)
#define SYSTICK_RELOAD REGISTER(0xE000E014u)
#define SYSTICK_VALUE REGISTER(0xE000E018u)
#define COPROCESSORS REGISTER(0xE000ED88u)
#define TICKS 0x00FFFFFFu
#define PAINT 0xA5A5A5A5u

extern uint32_t data_source[], data_start[], data_end[], bss_start[], bss_end[], stack_limit[], stack_top[];
int main(void);
void reset(void);
void halt(void);

void halt(void)
{
    for (;;) {
    }
}

void reset(void)
{
    COPROCESSORS |= 0xFu << 20; /* the floating-point unit */
    __asm volatile("dsb\n\tisb");
    for (uint32_t *to = data_start, *from = data_source; to < data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = bss_start; to < bss_end;) {
        *to++ = 0;
    }
    main();
    halt();
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))(uintptr_t)stack_top, reset, halt, halt, halt, halt, halt, 0, 0, 0, 0, halt, halt, 0, halt, halt};

static void receive(void *into, uint32_t size)
{
    for (uint8_t *byte = into; size > 0; size--) {
        while (!(UART_STATE & 2u)) {
        }
        *byte++ = (uint8_t)UART_DATA;
    }
}

static void send(const void *from, uint32_t size)
{
    for (const uint8_t *byte = from; size > 0; size--) {
        while (UART_STATE & 1u) {
        }
        UART_DATA = *byte++;
    }
}

static uint32_t *stack_pointer(void)
{
    uint32_t *here;
    __asm volatile("mov %0, sp" : "=r"(here));
    return here;
}

static void paint(void)
{
    uint32_t *here = stack_pointer();
    for (volatile uint32_t *at = stack_limit; at < here; at++) { /* volatile: memset would paint over its own stack */
        *at = PAINT;
    }
}

static uint32_t painted_over(const uint32_t *top)
{
    const uint32_t *at = stack_limit;
    while (at < top && *at == PAINT) {
        at++;
    }
    return (uint32_t)((const char *)top - (const char *)at);
}

static uint32_t elapsed(uint32_t since)
{
    return (since - SYSTICK_VALUE) & TICKS;
}

int main(void)
{
    static @NAME@_state unit;
    static @REAL@ in[@INPUTS@], out[@OUTPUTS@];
    uint32_t measured[4] = {0, 0, 0, sizeof(unit)};
    UART_DIVIDER = 16;
    UART_CONTROL = 3;
    SYSTICK_RELOAD = TICKS;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 5;
    const uint32_t *top = stack_pointer();
    paint();
    uint32_t since = SYSTICK_VALUE;
    const uint32_t nothing = elapsed(since);
    for (;;) {
        char order;
        int32_t status = 0;
        receive(&order, 1);
        if (order == 'r') {
            measured[2] = painted_over(top);
            send(measured, sizeof(measured));
            continue;
        }
        receive(in, sizeof(in));
        if (order == 'i') {
            @BEGIN@
            continue;
        }
        since = SYSTICK_VALUE;
        @STEP@
        measured[0] = elapsed(since) - nothing;
        if (measured[0] > measured[1]) {
            measured[1] = measured[0];
        }
        send(out, sizeof(out));
        send(&status, sizeof(status));
    }
}
