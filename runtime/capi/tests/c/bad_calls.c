/* Calls with arrays that are missing, misaligned, of other lengths or shared: an error, and states stay as they are. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "support.h"

/* An address that floats cannot have. */
#define ODD(pointer) ((void *)((char *)(pointer) + 1))

static float states[16], position, force[2];
static const SortieInput good_input = {&position, 1};
static const SortieOutput good_output = {force, 1};

/* The same calls answer the same after every error. */
static void respond_fails(SortieError error, SortiePolicy *policy, const SortieInput *inputs,
                          size_t input_count, float *kept, size_t numbers,
                          const SortieOutput *outputs, size_t output_count)
{
    float before[16];
    uint32_t want;
    position = 0.25f;
    memset(states, 0, sizeof states);
    EXPECT(SORTIE_ERROR_NONE, sortie_respond(policy, &good_input, 1, states, 16, &good_output, 1));
    want = bits_of(force[0]);
    memcpy(before, states, sizeof states);
    EXPECT(error, sortie_respond(policy, inputs, input_count, kept, numbers, outputs, output_count));
    CHECK(memcmp(before, states, sizeof states) == 0);
    memset(states, 0, sizeof states);
    EXPECT(SORTIE_ERROR_NONE, sortie_respond(policy, &good_input, 1, states, 16, &good_output, 1));
    CHECK(bits_of(force[0]) == want && memcmp(before, states, sizeof states) == 0);
}

static void bad_input(SortieError error, SortiePolicy *policy, const float *values, size_t length)
{
    const SortieInput input = {values, length};
    respond_fails(error, policy, &input, 1, states, 16, &good_output, 1);
}

static void bad_output(SortieError error, SortiePolicy *policy, float *values, size_t length)
{
    const SortieOutput output = {values, length};
    respond_fails(error, policy, &good_input, 1, states, 16, &output, 1);
}

static void bad_states(SortieError error, SortiePolicy *policy, float *kept, size_t numbers)
{
    respond_fails(error, policy, &good_input, 1, kept, numbers, &good_output, 1);
}

static void policy_calls(Plan plan)
{
    SortiePolicy *policy = load(plan);
    static const float not_numbers[] = {NAN, INFINITY, -INFINITY};
    float other[16];
    SortieInput inputs[3] = {{&position, 1}, {&position, 1}, {&position, 1}};
    SortieOutput outputs[3] = {{force, 1}, {force, 1}, {force, 1}};
    SortieDecision decision;
    size_t index;
    bad_input(SORTIE_ERROR_NULL, policy, NULL, 1);
    bad_input(SORTIE_ERROR_WRONG_LENGTH, policy, NULL, 0);
    bad_input(SORTIE_ERROR_WRONG_LENGTH, policy, &position, 0);
    bad_input(SORTIE_ERROR_WRONG_LENGTH, policy, states, 2);
    bad_input(SORTIE_ERROR_WRONG_LENGTH, policy, &position, SIZE_MAX);
    bad_input(SORTIE_ERROR_MISALIGNED, policy, ODD(&position), 1);
    bad_input(SORTIE_ERROR_OVERLAP, policy, states + 15, 1);
    bad_input(SORTIE_ERROR_OVERLAP, policy, (const float *)(const void *)policy, 1);
    for (index = 0; index < 3; index++)
        bad_input(SORTIE_ERROR_NOT_FINITE, policy, &not_numbers[index], 1);

    bad_output(SORTIE_ERROR_NULL, policy, NULL, 1);
    bad_output(SORTIE_ERROR_WRONG_LENGTH, policy, force, 0);
    bad_output(SORTIE_ERROR_WRONG_LENGTH, policy, force, 2);
    bad_output(SORTIE_ERROR_WRONG_LENGTH, policy, force, SIZE_MAX / 4);
    bad_output(SORTIE_ERROR_MISALIGNED, policy, ODD(force), 1);
    bad_output(SORTIE_ERROR_OVERLAP, policy, &position, 1);
    bad_output(SORTIE_ERROR_OVERLAP, policy, states + 3, 1);
    bad_output(SORTIE_ERROR_OVERLAP, policy, (float *)(void *)policy, 1);
    bad_output(SORTIE_ERROR_OVERLAP, policy, (float *)(void *)plan.bytes, 1);

    bad_states(SORTIE_ERROR_WRONG_LENGTH, policy, NULL, 0);
    bad_states(SORTIE_ERROR_WRONG_LENGTH, policy, states, 15);
    bad_states(SORTIE_ERROR_WRONG_LENGTH, policy, states, SIZE_MAX);
    bad_states(SORTIE_ERROR_NULL, policy, NULL, 16);
    bad_states(SORTIE_ERROR_MISALIGNED, policy, ODD(other), 16);
    bad_states(SORTIE_ERROR_OVERLAP, policy, (float *)(void *)plan.bytes, 16);
    memset(other, 0, sizeof other);
    other[7] = NAN;
    bad_states(SORTIE_ERROR_NOT_FINITE, policy, other, 16);
    CHECK(isnan(other[7]) && other[6] == 0);

    for (index = 0; index < 4; index++) {
        if (index == 1)
            continue;
        respond_fails(SORTIE_ERROR_WRONG_COUNT, policy, inputs, index, states, 16, outputs, 1);
        respond_fails(SORTIE_ERROR_WRONG_COUNT, policy, inputs, 1, states, 16, outputs, index);
    }
    respond_fails(SORTIE_ERROR_WRONG_COUNT, policy, inputs, SIZE_MAX, states, 16, outputs, 1);
    respond_fails(SORTIE_ERROR_NULL, policy, NULL, 1, states, 16, outputs, 1);
    respond_fails(SORTIE_ERROR_NULL, policy, inputs, 1, states, 16, NULL, 1);
    respond_fails(SORTIE_ERROR_MISALIGNED, policy, ODD(inputs), 1, states, 16, outputs, 1);
    respond_fails(SORTIE_ERROR_MISALIGNED, policy, inputs, 1, states, 16, ODD(outputs), 1);

    EXPECT(SORTIE_ERROR_NULL, sortie_respond(NULL, inputs, 1, states, 16, outputs, 1));
    EXPECT(SORTIE_ERROR_WRONG_KIND,
           sortie_choose(policy, inputs, 1, NULL, 0, states, 16, &decision));
    EXPECT(SORTIE_ERROR_WRONG_KIND,
           sortie_draw(policy, inputs, 1, NULL, 0, states, 16, 0, &decision));
}

/* Pointers that lead to no policy. */
static void no_policies(Plan plan)
{
    SortiePolicy *policy = load(plan);
    unsigned char *other = room(4096);
    SortiePolicy *wrong[4];
    size_t index;
    SortieDecision decision;
    SortieObservation seen = {0};
    memset(other, 0, 4096);
    memcpy(other + 1024, policy, SORTIE_POLICY_BYTES - 128);
    wrong[0] = NULL;
    wrong[1] = (SortiePolicy *)(void *)other;
    /* One that was moved. */
    wrong[2] = (SortiePolicy *)(void *)(other + 1024);
    wrong[3] = ODD(policy);
    for (index = 0; index < 4; index++) {
        SortiePolicy *none = wrong[index];
        const SortieError error = index == 0 ? SORTIE_ERROR_NULL : SORTIE_ERROR_NO_POLICY;
        CHECK(sortie_kind(none) == SORTIE_KIND_NONE && !sortie_draws(none));
        CHECK(sortie_input_count(none) == 0 && sortie_input_length(none, 0) == 0);
        CHECK(sortie_output_count(none) == 0 && sortie_output_length(none, 0) == 0);
        CHECK(sortie_state_count(none) == 0 && sortie_state_length(none, 0) == 0);
        CHECK(sortie_state_numbers(none) == 0 && sortie_actions(none) == 0);
        CHECK(sortie_features(none) == 0 && sortie_most_entities(none) == 0);
        CHECK(sortie_fact_count(none, 0) == 0 && sortie_fact_name(none, 0, 0) == NULL);
        CHECK(isnan(sortie_fact_number(none, 1, 0)));
        CHECK(sortie_normaliser(none) == SORTIE_NORMALISER_UNKNOWN);
        EXPECT(error, sortie_respond(none, &good_input, 1, states, 16, &good_output, 1));
        EXPECT(error, sortie_choose(none, &good_input, 1, NULL, 0, states, 16, &decision));
        EXPECT(error, sortie_draw(none, &good_input, 1, NULL, 0, states, 16, 0, &decision));
        EXPECT(error, sortie_decide(none, &seen, NULL, 0, &decision));
        EXPECT(error, sortie_sample(none, &seen, NULL, 0, 0, &decision));
    }
    free(other);
}

static void choices(Plan plan)
{
    SortiePolicy *policy = load(plan), *drawn = load(drawing(plan));
    static float features[70], mask[8];
    SortieInput inputs[2] = {{features, 70}, {mask, 7}};
    uint8_t available[6] = {0};
    SortieDecision decisions[2], *decision = decisions;
    SortieObservation seen = {0};
    const SortieError none = SORTIE_ERROR_NO_AVAILABLE_ACTION, length = SORTIE_ERROR_WRONG_LENGTH;
    EXPECT(none, sortie_choose(policy, inputs, 2, available, 6, NULL, 0, decision));
    EXPECT(none, sortie_draw(drawn, inputs, 2, available, 6, NULL, 0, 1, decision));
    EXPECT(length, sortie_choose(policy, inputs, 2, available, 5, NULL, 0, decision));
    EXPECT(length, sortie_choose(policy, inputs, 2, available, 7, NULL, 0, decision));
    EXPECT(length, sortie_choose(policy, inputs, 2, available, 0, NULL, 0, decision));
    EXPECT(SORTIE_ERROR_NULL, sortie_choose(policy, inputs, 2, NULL, 6, NULL, 0, decision));
    EXPECT(length, sortie_choose(policy, inputs, 2, NULL, SIZE_MAX, NULL, 0, decision));
    EXPECT(length, sortie_choose(policy, inputs, 2, NULL, 0, states, 1, decision));
    EXPECT(SORTIE_ERROR_NONE, sortie_choose(policy, inputs, 2, NULL, 0, states, 0, decision));
    EXPECT(SORTIE_ERROR_NULL, sortie_choose(policy, inputs, 2, NULL, 0, NULL, 0, NULL));
    EXPECT(SORTIE_ERROR_NULL, sortie_draw(drawn, inputs, 2, NULL, 0, NULL, 0, 1, NULL));
    EXPECT(SORTIE_ERROR_MISALIGNED,
           sortie_choose(policy, inputs, 2, NULL, 0, NULL, 0, ODD(decisions)));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_choose(policy, inputs, 2, NULL, 0, NULL, 0,
                                               (SortieDecision *)(void *)(features + 68)));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_choose(policy, inputs, 2, NULL, 0, NULL, 0,
                                               (SortieDecision *)(void *)policy));
    EXPECT(SORTIE_ERROR_GREEDY, sortie_draw(policy, inputs, 2, NULL, 0, NULL, 0, 1, decision));
    EXPECT(SORTIE_ERROR_WRONG_COUNT, sortie_choose(policy, inputs, 1, NULL, 0, NULL, 0, decision));
    EXPECT(SORTIE_ERROR_NULL, sortie_choose(policy, NULL, 2, NULL, 0, NULL, 0, decision));
    EXPECT(SORTIE_ERROR_WRONG_KIND, sortie_decide(policy, &seen, NULL, 0, decision));
    EXPECT(SORTIE_ERROR_WRONG_KIND, sortie_sample(policy, &seen, NULL, 0, 0, decision));
    inputs[1].length = 8;
    EXPECT(length, sortie_choose(policy, inputs, 2, NULL, 0, NULL, 0, decision));
    EXPECT(length, sortie_draw(drawn, inputs, 2, NULL, 0, NULL, 0, 1, decision));
    inputs[1].length = 7;
    inputs[1].values = NULL;
    EXPECT(SORTIE_ERROR_NULL, sortie_choose(policy, inputs, 2, NULL, 0, NULL, 0, decision));
    inputs[1].values = ODD(mask);
    EXPECT(SORTIE_ERROR_MISALIGNED, sortie_draw(drawn, inputs, 2, NULL, 0, NULL, 0, 1, decision));
    /* Inputs are only read: they may be the same. */
    inputs[1].values = features;
    EXPECT(SORTIE_ERROR_NONE, sortie_choose(policy, inputs, 2, NULL, 0, NULL, 0, decision));
}

static void observations(Plan plan)
{
    SortiePolicy *agent = load(plan);
    static float rows[30];
    static const uint16_t last_actions[3] = {1, SORTIE_NO_ACTION, 999};
    static const uint8_t visible[200] = {1, 1, 1, 1, 1, 1}, available[5] = {1, 1, 1, 1, 1};
    const SortieObservation good = {rows, 5, 6, last_actions, 2, visible, 0, available, 4};
    SortieObservation seen;
    SortieDecision decisions[2], *decision = decisions;
    const SortieError length = SORTIE_ERROR_WRONG_LENGTH;
#define SEEN(error, field, value)                                                                  \
    (seen = good, seen.field = (value), expect((error), sortie_decide(agent, &seen, NULL, 0, decision), \
                                               __FILE__, __LINE__, #field " = " #value))
    EXPECT(SORTIE_ERROR_NONE, sortie_decide(agent, &good, NULL, 0, decision));
    SEEN(SORTIE_ERROR_NULL, rows, NULL);
    SEEN(SORTIE_ERROR_MISALIGNED, rows, ODD(rows));
    SEEN(SORTIE_ERROR_OVERLAP, rows, (const float *)(const void *)agent);
    SEEN(SORTIE_ERROR_TOO_MANY_ENTITIES, entities, 129);
    SEEN(SORTIE_ERROR_TOO_MANY_ENTITIES, entities, SIZE_MAX);
    SEEN(length, entities, 0);
    SEEN(SORTIE_ERROR_NONE, entities, 1);
    SEEN(length, stride, 5);
    SEEN(length, stride, 0);
    SEEN(length, stride, SIZE_MAX);
    SEEN(length, stride, SIZE_MAX / 5);
    SEEN(SORTIE_ERROR_NULL, last_actions, NULL);
    SEEN(SORTIE_ERROR_MISALIGNED, last_actions, ODD(last_actions));
    SEEN(length, agents, SIZE_MAX);
    SEEN(SORTIE_ERROR_NONE, agents, 0);
    /* The third is no action. */
    SEEN(length, agents, 3);
    SEEN(SORTIE_ERROR_NONE, visible, NULL);
    SEEN(length, own, 5);
    SEEN(length, own, SIZE_MAX);
    SEEN(SORTIE_ERROR_NULL, available, NULL);
    SEEN(length, actions, 3);
    SEEN(length, actions, 5);
    SEEN(length, actions, 0);
    SEEN(SORTIE_ERROR_NO_AVAILABLE_ACTION, available, visible + 100);
    rows[7] = NAN;
    EXPECT(SORTIE_ERROR_NOT_FINITE, sortie_decide(agent, &good, NULL, 0, decision));
    rows[7] = 0;
    EXPECT(SORTIE_ERROR_NULL, sortie_decide(agent, NULL, NULL, 0, decision));
    EXPECT(SORTIE_ERROR_MISALIGNED, sortie_decide(agent, ODD(&good), NULL, 0, decision));
    EXPECT(SORTIE_ERROR_NULL, sortie_decide(agent, &good, NULL, 0, NULL));
    EXPECT(SORTIE_ERROR_MISALIGNED, sortie_decide(agent, &good, NULL, 0, ODD(decisions)));
    EXPECT(SORTIE_ERROR_OVERLAP,
           sortie_decide(agent, &good, NULL, 0, (SortieDecision *)(void *)(rows + 2)));
    EXPECT(length, sortie_decide(agent, &good, states, 1, decision));
    EXPECT(SORTIE_ERROR_GREEDY, sortie_sample(agent, &good, NULL, 0, 5, decision));
    EXPECT(SORTIE_ERROR_NULL, sortie_sample(agent, NULL, NULL, 0, 5, decision));
    EXPECT(SORTIE_ERROR_WRONG_KIND,
           sortie_respond(agent, &good_input, 1, NULL, 0, &good_output, 1));
    EXPECT(SORTIE_ERROR_WRONG_KIND, sortie_choose(agent, NULL, 0, NULL, 0, NULL, 0, decision));
    EXPECT(SORTIE_ERROR_WRONG_KIND, sortie_draw(agent, NULL, 0, NULL, 0, NULL, 0, 0, decision));
}

void bad_calls(void)
{
    const Plan cart = read_plan("examples/embed_c/cart.plan");
    policy_calls(cart);
    no_policies(cart);
    choices(read_plan("tests/golden/plans/policy-2.0.plan"));
    observations(read_plan("tests/golden/plans/agent-2.0.plan"));
}
