/* $made
 *
 * Start of the replay program on the board that QEMU models; not needed by the controller.
 */
extern char board_stack[];

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
