/* A plan inside the program: in read-only memory, at a multiple of 64 bytes. */
    .section .rodata
    .balign 64
    .globl plan, plan_end
plan:
    .incbin "cart.plan"
plan_end:
#ifdef __ELF__
    .section .note.GNU-stack, "", %progbits
#endif
