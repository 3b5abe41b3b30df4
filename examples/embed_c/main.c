/* A policy in a control loop: a cart that measures where it is, not how fast it goes, comes to rest at 0. */
#include <stdio.h>
#include <stdlib.h>

#include "sortie.h"

/* The bytes of cart.plan, by plan.S. `sortie compile cart.onnx` says that it needs 1,792 bytes of arena. */
extern const unsigned char plan[], plan_end[];
static unsigned char memory[SORTIE_MEMORY_BYTES(1792, 1, 1)];

/* What the policy remembers: 0 where an episode begins. */
static float states[16];

static void check(SortieError error)
{
    if (error != SORTIE_ERROR_NONE) {
        fprintf(stderr, "%s\n", sortie_error_text(error));
        exit(1);
    }
}

int main(void)
{
    const float seconds = 0.2f, push = 3.0f;
    float position = 1.0f, velocity = 0.0f, force = 0.0f;
    const SortieInput input = {&position, 1};
    const SortieOutput output = {&force, 1};
    SortiePolicy *policy;
    int step;

    check(sortie_load(plan, (size_t)(plan_end - plan), memory, sizeof memory, &policy));
    for (step = 0; step < 20; step++) {
        check(sortie_respond(policy, &input, 1, states, sizeof states / sizeof *states, &output, 1));
        printf("step %2d  position %7.4f  force %7.4f\n", step, position, force);
        velocity += push * force * seconds;
        position += velocity * seconds;
    }
    return 0;
}
