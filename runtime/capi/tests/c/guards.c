/* Guards around a response: each trip, what is given out instead, and an error for everything that is wrong. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "support.h"

/* The plan's guards: input within 1.5, at most 10 s old; output within 1, changing by at most 0.5; zeros where one trips
 * and for two further decisions. */
enum { SECOND = 1000000000 };

static float states[16];

static SortieGuards *guards_of(const SortiePolicy *policy)
{
    SortieGuards *guards;
    const size_t bytes = SORTIE_GUARDS_MEMORY(1);
    EXPECT(SORTIE_ERROR_NONE, sortie_guard(policy, room(bytes), bytes, &guards));
    return guards;
}

/* One decision as a control loop makes it; the force is safe whatever it answers. */
static SortieTrip decide(SortiePolicy *policy, SortieGuards *guards, float position, uint64_t age_ns, float *force)
{
    const SortieInput input = {&position, 1};
    const SortieOutput output = {force, 1};
    SortieTrip trip;
    EXPECT(SORTIE_ERROR_NONE, sortie_check_inputs(guards, &position, 1, age_ns, &trip));
    if (trip.guard == SORTIE_GUARD_NONE) {
        EXPECT(SORTIE_ERROR_NONE, sortie_respond(policy, &input, 1, states, 16, &output, 1));
        EXPECT(SORTIE_ERROR_NONE, sortie_check_outputs(guards, force, 1, &trip));
    }
    if (trip.guard != SORTIE_GUARD_NONE && !trip.clamped)
        EXPECT(SORTIE_ERROR_NONE, sortie_fall_back(guards, trip.guard, force, 1));
    return trip;
}

static void trips(SortiePolicy *policy)
{
    SortieGuards *guards = guards_of(policy);
    SortieTrip trip;
    float force = 9, first;
    int held;
    CHECK(decide(policy, guards, 0.5f, SORTIE_AGE_UNKNOWN, &force).guard == SORTIE_GUARD_NONE);
    first = force;
    CHECK(fabsf(force) <= 1 && force != 0);
    CHECK(decide(policy, guards, 0.5f, (uint64_t)10 * SECOND, &force).guard == SORTIE_GUARD_NONE);
    trip = decide(policy, guards, 0.5f, (uint64_t)10 * SECOND + 1, &force);
    CHECK(trip.guard == SORTIE_GUARD_AGE && trip.index == 0 && !trip.clamped && force == 0);
    for (held = 0; held < 2; held++)
        CHECK(decide(policy, guards, 0.5f, 0, &force).guard == SORTIE_GUARD_HELD && force == 0);
    CHECK(decide(policy, guards, NAN, 0, &force).guard == SORTIE_GUARD_INPUT_RANGE && force == 0);
    CHECK(decide(policy, guards, 1.5001f, 0, &force).guard == SORTIE_GUARD_INPUT_RANGE && force == 0);
    /* As if nothing had been given out. */
    memset(states, 0, sizeof states);
    EXPECT(SORTIE_ERROR_NONE, sortie_guard_begin(guards));
    CHECK(decide(policy, guards, 0.5f, 0, &force).guard == SORTIE_GUARD_NONE && force == first);

    /* What outputs trip, whoever made them; the first goes towards 0, so that the range is kept. */
    force = first > 0 ? first - 0.6f : first + 0.6f;
    EXPECT(SORTIE_ERROR_NONE, sortie_check_outputs(guards, &force, 1, &trip));
    CHECK(trip.guard == SORTIE_GUARD_OUTPUT_RATE && !trip.clamped);
    force = 1.01f;
    EXPECT(SORTIE_ERROR_NONE, sortie_check_outputs(guards, &force, 1, &trip));
    CHECK(trip.guard == SORTIE_GUARD_OUTPUT_RANGE);
    force = INFINITY;
    EXPECT(SORTIE_ERROR_NONE, sortie_check_outputs(guards, &force, 1, &trip));
    CHECK(trip.guard == SORTIE_GUARD_OUTPUT_NOT_FINITE);
    /* A policy that has refused its observation. */
    EXPECT(SORTIE_ERROR_NONE, sortie_fall_back(guards, SORTIE_GUARD_UNDECIDED, &force, 1));
    CHECK(force == 0);
    CHECK(decide(policy, guards, 0.5f, 0, &force).guard == SORTIE_GUARD_HELD);
}

static void clamps(SortiePolicy *policy)
{
    SortieGuards *guards = guards_of(policy);
    SortieTrip trip;
    float force = 3;
    EXPECT(SORTIE_ERROR_NONE, sortie_check_outputs(guards, &force, 1, &trip));
    CHECK(trip.guard == SORTIE_GUARD_OUTPUT_RANGE && trip.clamped && force == 1);
    force = -1;
    EXPECT(SORTIE_ERROR_NONE, sortie_check_outputs(guards, &force, 1, &trip));
    CHECK(trip.guard == SORTIE_GUARD_OUTPUT_RATE && trip.clamped && force == 0.5f);
    force = 0.25f;
    EXPECT(SORTIE_ERROR_NONE, sortie_check_outputs(guards, &force, 1, &trip));
    CHECK(trip.guard == SORTIE_GUARD_NONE && !trip.clamped && force == 0.25f);
    force = NAN;
    EXPECT(SORTIE_ERROR_NONE, sortie_check_outputs(guards, &force, 1, &trip));
    CHECK(trip.guard == SORTIE_GUARD_OUTPUT_NOT_FINITE && !trip.clamped);
}

static void memory(SortiePolicy *policy, Plan plan)
{
    unsigned char *bytes = room(SORTIE_GUARDS_MEMORY(1) + 16);
    SortieGuards *guards = NULL;
    size_t length, least = SIZE_MAX;
    /* Anywhere, and never beyond what is given. */
    for (length = 0; length <= SORTIE_GUARDS_MEMORY(1); length++) {
        SortieError error;
        memset(bytes, 0xa5, SORTIE_GUARDS_MEMORY(1) + 16);
        error = sortie_guard(policy, bytes + 3, length, &guards);
        CHECK(error == SORTIE_ERROR_NONE || error == SORTIE_ERROR_MEMORY_TOO_SMALL);
        CHECK((error == SORTIE_ERROR_NONE) == (guards != NULL));
        CHECK(bytes[2] == 0xa5 && bytes[3 + length] == 0xa5);
        if (error == SORTIE_ERROR_NONE && least == SIZE_MAX)
            least = length;
        CHECK((error == SORTIE_ERROR_NONE) == (length >= least));
    }
    CHECK(least <= SORTIE_GUARDS_MEMORY(1));
    EXPECT(SORTIE_ERROR_NULL, sortie_guard(policy, NULL, 300, &guards));
    EXPECT(SORTIE_ERROR_NULL, sortie_guard(policy, bytes, 300, NULL));
    EXPECT(SORTIE_ERROR_NULL, sortie_guard(NULL, bytes, 256, &guards));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_guard(policy, policy, 300, &guards));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_guard(policy, plan.bytes, 300, &guards));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_guard(policy, &guards, sizeof guards, &guards));
    free(bytes);
}

static void wrong_calls(SortiePolicy *policy, Plan plan)
{
    SortieGuards *guards = guards_of(policy), *wrong[4];
    const size_t bytes = SORTIE_GUARDS_MEMORY(1);
    unsigned char *other = room(2 * bytes + 64);
    float numbers[2] = {0, 0};
    SortieTrip trip = {SORTIE_GUARD_NONE, 0, false};
    size_t index;
    memset(other, 0, 2 * bytes + 64);
    memcpy(other + bytes, guards, bytes);
    wrong[0] = NULL;
    wrong[1] = (SortieGuards *)(void *)other;
    /* Those that were moved. */
    wrong[2] = (SortieGuards *)(void *)(other + bytes);
    wrong[3] = (SortieGuards *)(void *)((char *)guards + 1);
    for (index = 0; index < 4; index++) {
        const SortieError error = index == 0 ? SORTIE_ERROR_NULL : SORTIE_ERROR_NO_GUARDS;
        EXPECT(error, sortie_guard_begin(wrong[index]));
        EXPECT(error, sortie_check_inputs(wrong[index], numbers, 1, 0, &trip));
        EXPECT(error, sortie_check_outputs(wrong[index], numbers, 1, &trip));
        EXPECT(error, sortie_fall_back(wrong[index], SORTIE_GUARD_AGE, numbers, 1));
    }
    free(other);
    EXPECT(SORTIE_ERROR_WRONG_LENGTH, sortie_check_inputs(guards, numbers, 2, 0, &trip));
    EXPECT(SORTIE_ERROR_WRONG_LENGTH, sortie_check_outputs(guards, numbers, 0, &trip));
    EXPECT(SORTIE_ERROR_WRONG_LENGTH, sortie_fall_back(guards, SORTIE_GUARD_AGE, numbers, 2));
    EXPECT(SORTIE_ERROR_NULL, sortie_check_inputs(guards, NULL, 1, 0, &trip));
    EXPECT(SORTIE_ERROR_NULL, sortie_check_inputs(guards, numbers, 1, 0, NULL));
    EXPECT(SORTIE_ERROR_NULL, sortie_check_outputs(guards, numbers, 1, NULL));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_check_outputs(guards, (float *)(void *)&trip, 1, &trip));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_check_outputs(guards, (float *)(void *)guards, 1, &trip));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_fall_back(guards, SORTIE_GUARD_AGE, (float *)(void *)guards, 1));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_check_outputs(guards, (float *)(void *)plan.bytes, 1, &trip));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_fall_back(guards, SORTIE_GUARD_AGE, (float *)(void *)plan.bytes, 1));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_check_inputs(guards, numbers, 1, 0, (SortieTrip *)(void *)plan.bytes));
    EXPECT(SORTIE_ERROR_NO_TRIP, sortie_fall_back(guards, SORTIE_GUARD_NONE, numbers, 1));
    EXPECT(SORTIE_ERROR_NO_TRIP, sortie_fall_back(guards, 6, numbers, 1));
    EXPECT(SORTIE_ERROR_NO_TRIP, sortie_fall_back(guards, 9, numbers, 1));
    EXPECT(SORTIE_ERROR_NO_TRIP, sortie_fall_back(guards, -1, numbers, 1));
    EXPECT(SORTIE_ERROR_NO_TRIP, sortie_fall_back(guards, 0x101, numbers, 1));
}

void guards(void)
{
    const Plan plan = read_plan("tests/golden/plans/guarded-2.3.plan");
    const Plan unguarded = read_plan("examples/embed_c/cart.plan"), damaged = copy_of(plan);
    SortiePolicy *policy = load(plan);
    SortieGuards *none;
    unsigned char bytes[SORTIE_GUARDS_MEMORY(1)];
    trips(policy);
    clamps(load(clamping(plan)));
    memory(policy, plan);
    wrong_calls(policy, plan);
    EXPECT(SORTIE_ERROR_NO_GUARDS, sortie_guard(load(unguarded), bytes, sizeof bytes, &none));
    CHECK(none == NULL);
    damaged.bytes[damaged.length - 1] ^= 1;
    EXPECT(SORTIE_ERROR_DAMAGED, sortie_guard(load(damaged), bytes, sizeof bytes, &none));
    CHECK(none == NULL);
}
