/* Recorded answers, bit for bit. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "support.h"

enum { SEEDS = 16 };

static FILE *open_text(const char *file)
{
    FILE *stream = fopen(path_of(file), "r");
    CHECK(stream != NULL);
    return stream;
}

/* The index of the largest number, the first of several. */
static uint32_t largest(const float *numbers, uint32_t count)
{
    uint32_t best = 0, index;
    for (index = 1; index < count; index++)
        if (numbers[index] > numbers[best])
            best = index;
    return best;
}

static void a_robots_facts_stand_in_the_plan(void)
{
    SortiePolicy *robot = load(read_plan("tests/golden/onnx-written/mjlab_velocity.plan"));
    SortiePolicy *other = load(read_plan("tests/golden/plans/policy-2.0.plan"));
    CHECK(sortie_fact_count(robot, SORTIE_FACT_JOINT_NAMES) == 6);
    CHECK(strcmp(sortie_fact_name(robot, SORTIE_FACT_JOINT_NAMES, 3), "knee") == 0);
    CHECK(sortie_fact_name(robot, SORTIE_FACT_JOINT_NAMES, 6) == NULL);
    CHECK(strcmp(sortie_fact_name(robot, SORTIE_FACT_OBSERVATION_NAMES, 5), "command") == 0);
    CHECK(sortie_fact_number(robot, SORTIE_FACT_DEFAULT_JOINT_POS, 2) == -0.312f);
    CHECK(sortie_fact_number(robot, SORTIE_FACT_ACTION_SCALE, 5) == 0.25f);
    CHECK(sortie_fact_number(robot, SORTIE_FACT_STIFFNESS, 2) == 60.0f);
    CHECK(sortie_fact_count(robot, SORTIE_FACT_DAMPING) == 6);
    CHECK(sortie_normaliser(robot) == SORTIE_NORMALISER_IN_FILE);
    /* Neither a list nor a place in it that there is not. */
    CHECK(isnan(sortie_fact_number(robot, SORTIE_FACT_DAMPING, 6)));
    CHECK(isnan(sortie_fact_number(robot, SORTIE_FACT_DAMPING, SIZE_MAX)));
    CHECK(isnan(sortie_fact_number(robot, SORTIE_FACT_JOINT_NAMES, 0)));
    CHECK(sortie_fact_name(robot, SORTIE_FACT_DAMPING, 0) == NULL);
    CHECK(sortie_fact_count(robot, 6) == 0 && sortie_fact_count(robot, -1) == 0);
    CHECK(sortie_fact_count(other, SORTIE_FACT_JOINT_NAMES) == 0);
    CHECK(sortie_normaliser(other) == SORTIE_NORMALISER_UNKNOWN);
}

static void policy_responds_chooses_and_draws(void)
{
    const Plan plan = read_plan("tests/golden/plans/policy-2.0.plan");
    SortiePolicy *policy = load(plan), *drawn = load(drawing(plan));
    FILE *stream = open_text("tests/golden/plans/policy-2.0.txt");
    float features[70], mask[7], answer[6];
    const SortieInput inputs[] = {{features, 70}, {mask, 7}};
    const SortieOutput output = {answer, 6};
    uint32_t seed, want, index, drawn_as[6] = {0};
    CHECK(sortie_kind(policy) == SORTIE_KIND_POLICY && sortie_actions(policy) == 6);
    CHECK(sortie_input_count(policy) == 2 && sortie_input_length(policy, 0) == 70);
    CHECK(sortie_input_length(policy, 1) == 7 && sortie_input_length(policy, 2) == 0);
    CHECK(sortie_output_count(policy) == 1 && sortie_output_length(policy, 0) == 6);
    CHECK(sortie_output_length(policy, 1) == 0 && sortie_state_count(policy) == 0);
    CHECK(sortie_state_length(policy, 0) == 0 && sortie_state_numbers(policy) == 0);
    CHECK(!sortie_draws(policy) && sortie_draws(drawn));
    CHECK(sortie_features(policy) == 0 && sortie_most_entities(policy) == 0);
    for (seed = 0; seed < SEEDS; seed++) {
        uint64_t state = seed;
        uint8_t available[6] = {1, 1, 1, 1, 1, 1};
        SortieDecision decision;
        for (index = 0; index < 70; index++)
            features[index] = next_feature(&state);
        for (index = 0; index < 7; index++)
            mask[index] = index > 0 && next_number(&state) % 2 == 0 ? 1.0f : 0.0f;
        CHECK(fscanf(stream, "%" SCNu32 ":", &want) == 1 && want == seed);
        EXPECT(SORTIE_ERROR_NONE, sortie_respond(policy, inputs, 2, NULL, 0, &output, 1));
        for (index = 0; index < 6; index++)
            CHECK(fscanf(stream, "%" SCNx32, &want) == 1 && bits_of(answer[index]) == want);

        EXPECT(SORTIE_ERROR_NONE, sortie_choose(policy, inputs, 2, NULL, 0, NULL, 0, &decision));
        CHECK(decision.action == largest(answer, 6) && decision.utility == answer[decision.action]);
        available[decision.action] = 0;
        answer[decision.action] = -1e30f;
        EXPECT(SORTIE_ERROR_NONE, sortie_choose(policy, inputs, 2, available, 6, NULL, 0, &decision));
        CHECK(decision.action == largest(answer, 6) && decision.utility == answer[decision.action]);

        for (index = 0; index < 64; index++) {
            const uint32_t random = index << 26;
            EXPECT(SORTIE_ERROR_NONE,
                   sortie_draw(drawn, inputs, 2, available, 6, NULL, 0, random, &decision));
            CHECK(decision.action < 6 && available[decision.action]);
            EXPECT(SORTIE_ERROR_NONE,
                   sortie_draw(drawn, inputs, 2, NULL, 0, NULL, 0, random, &decision));
            CHECK(decision.action < 6);
            drawn_as[decision.action]++;
        }
    }
    /* Logits around 0: every action is drawn about as often. */
    for (index = 0; index < 6; index++)
        CHECK(drawn_as[index] > SEEDS * 64 / 12 && drawn_as[index] < SEEDS * 64 / 3);
    fclose(stream);
}

static void agent_decides_and_samples(void)
{
    const Plan plan = read_plan("tests/golden/plans/agent-2.0.plan");
    SortiePolicy *agent = load(plan), *drawn = load(drawing(plan));
    FILE *stream = open_text("tests/golden/plans/agent-2.0.txt");
    uint32_t seed, want[4], visible_bits, own, index;
    CHECK(sortie_kind(agent) == SORTIE_KIND_AGENT && sortie_actions(agent) == 4);
    CHECK(sortie_features(agent) == 6 && sortie_most_entities(agent) == 5);
    CHECK(sortie_input_count(agent) == 0 && sortie_output_count(agent) == 0);
    CHECK(sortie_state_count(agent) == 0 && sortie_state_numbers(agent) == 0);
    CHECK(!sortie_draws(agent) && sortie_draws(drawn));
    for (seed = 0; seed < SEEDS; seed++) {
        uint64_t state = seed;
        float rows[30], utilities[4];
        uint16_t last_actions[2] = {0, SORTIE_NO_ACTION};
        uint8_t visible[5], available[4] = {0, 0, 0, 0};
        SortieObservation seen = {rows, 5, 6, last_actions, 2, visible, 0, NULL, 0};
        SortieDecision decision;
        CHECK(fscanf(stream, "%" SCNu32 " visible %" SCNx32 " self %" SCNu32 ":", &want[0],
                     &visible_bits, &own) == 3 && want[0] == seed);
        CHECK(fscanf(stream, "%" SCNx32 " %" SCNx32 " %" SCNx32 " %" SCNx32, &want[0], &want[1],
                     &want[2], &want[3]) == 4);
        for (index = 0; index < 30; index++)
            rows[index] = next_feature(&state);
        last_actions[0] = (uint16_t)(next_number(&state) % 4);
        CHECK(next_number(&state) % 32 == visible_bits && next_number(&state) % 5 == own);
        for (index = 0; index < 5; index++)
            visible[index] = (uint8_t)(visible_bits >> index & 1);
        seen.own = own;
        memcpy(utilities, want, sizeof want);
        EXPECT(SORTIE_ERROR_NONE, sortie_decide(agent, &seen, NULL, 0, &decision));
        CHECK(decision.action == largest(utilities, 4));
        CHECK(bits_of(decision.utility) == want[decision.action]);
        seen.available = available;
        seen.actions = 4;
        for (index = 0; index < 4; index++) {
            memset(available, 0, sizeof available);
            available[index] = 128;
            EXPECT(SORTIE_ERROR_NONE, sortie_decide(agent, &seen, NULL, 0, &decision));
            CHECK(decision.action == index && bits_of(decision.utility) == want[index]);
            EXPECT(SORTIE_ERROR_NONE, sortie_sample(drawn, &seen, NULL, 0, seed << 28, &decision));
            CHECK(decision.action == index && bits_of(decision.utility) == want[index]);
        }
        seen.visible = NULL;
        EXPECT(SORTIE_ERROR_NONE, sortie_decide(agent, &seen, NULL, 0, &decision));
        memset(visible, 128, sizeof visible);
        seen.visible = visible;
        want[0] = bits_of(decision.utility);
        EXPECT(SORTIE_ERROR_NONE, sortie_decide(agent, &seen, NULL, 0, &decision));
        CHECK(bits_of(decision.utility) == want[0]);
    }
    fclose(stream);
}

/* What onnxruntime answered for examples/embed_c/cart.onnx, state fed back. */
static void policy_remembers(void)
{
    static const float answered[6] = {-0.999574959f, 0.751382709f, 0.98711139f, 0.997874498f, 0.998454809f, 0.99739933f};
    SortiePolicy *policy = load(read_plan("examples/embed_c/cart.plan"));
    float states[16] = {0}, position, force;
    const SortieInput input = {&position, 1};
    const SortieOutput output = {&force, 1};
    int step;
    CHECK(sortie_state_count(policy) == 1 && sortie_state_length(policy, 0) == 16);
    CHECK(sortie_state_length(policy, 1) == 0 && sortie_state_numbers(policy) == 16);
    CHECK(sortie_actions(policy) == 0);
    for (step = 0; step < 6; step++) {
        float apart;
        position = 0.5f - 0.25f * (float)step;
        EXPECT(SORTIE_ERROR_NONE, sortie_respond(policy, &input, 1, states, 16, &output, 1));
        apart = force - answered[step];
        CHECK(apart < 1e-6f && apart > -1e-6f);
    }
}

void recorded(void)
{
    a_robots_facts_stand_in_the_plan();
    policy_responds_chooses_and_draws();
    agent_decides_and_samples();
    policy_remembers();
}
