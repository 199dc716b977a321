/* $made
 *
 * Start of the replay program on the board that QEMU models; not needed by the controller.
 */
#include <stdint.h>
#include <time.h>

extern char board_stack[];

/* Of newlib's: by the processor's own counter, of 25 MHz. QEMU lets a counted instruction take one nanosecond. */
clock_t clock(void)
{
    static uint32_t last;
    static uint64_t ticks;
    volatile uint32_t *const counter = (volatile uint32_t *)0xE000E010u; /* control, reload, value */
    if (!(counter[0] & 1u)) {
        counter[1] = 0xFFFFFFu;
        counter[2] = 0u;
        counter[0] = 5u;
    }
    const uint32_t now = 0xFFFFFFu - counter[2];
    ticks += (now - last) & 0xFFFFFFu;
    last = now;
    return (clock_t)(ticks * CLOCKS_PER_SEC / 25000000u);
}

/* The floating point unit on, then newlib's own start. */
__attribute__((naked, noreturn)) void board_reset(void)
{
    __asm volatile("ldr r0, =0xE000ED88\n"
                   "ldr r1, [r0]\n"
                   "orr r1, r1, #0xF00000\n"
                   "str r1, [r0]\n"
                   "dsb\n"
                   "isb\n"
                   "b _start\n");
}

__attribute__((noreturn)) static void fault(void)
{
    for (;;)
        ;
}

typedef union {
    void (*handler)(void);
    char *stack;
} vector;

__attribute__((section(".vectors"), used)) static const vector vectors[] = {
    {.stack = board_stack}, {board_reset}, {fault}, {fault}, {fault}, {fault}, {fault}};
