/* Plans and memory that are not what they should be: an error, and nothing is lost. */
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "support.h"

/* The same error from both functions that read plans; they write 0 and NULL. */
static void refused(SortieError error, const void *plan, size_t length)
{
    static unsigned char memory[1 << 16];
    SortiePolicy *policy = (SortiePolicy *)(void *)memory;
    size_t bytes = 7;
    EXPECT(error, sortie_memory_bytes(plan, length, &bytes));
    CHECK(bytes == 0);
    EXPECT(error, sortie_load(plan, length, memory, sizeof memory, &policy));
    CHECK(policy == NULL);
}

static void damaged(Plan plan)
{
    const uint32_t program = plan.bytes[48] + 256u * plan.bytes[49];
    unsigned char *moved = room(plan.length + 64);
    size_t at;
    refused(SORTIE_ERROR_NULL, NULL, plan.length);
    refused(SORTIE_ERROR_NULL, NULL, 0);
    refused(SORTIE_ERROR_WRONG_LENGTH, plan.bytes, SIZE_MAX);
    refused(SORTIE_ERROR_WRONG_LENGTH, plan.bytes, SIZE_MAX / 2 + 1);
    for (at = 0; at < plan.length; at += at < 256 ? 1 : 37) {
        const Plan cut = {room(at + 1), at};
        memcpy(cut.bytes, plan.bytes, at);
        refused(SORTIE_ERROR_TRUNCATED, cut.bytes, cut.length);
        free(cut.bytes);
    }
    for (at = 0; at < 128 + program; at++) {
        const Plan changed = copy_of(plan);
        size_t bytes;
        changed.bytes[at] ^= 1;
        CHECK(sortie_memory_bytes(changed.bytes, changed.length, &bytes) != SORTIE_ERROR_NONE);
        free(changed.bytes);
    }
    for (at = 1; at < 64; at++) {
        memcpy(moved + at, plan.bytes, plan.length);
        refused(SORTIE_ERROR_MISALIGNED, moved + at, plan.length);
    }
    free(moved);
}

static void changed(Plan plan, size_t at, unsigned char byte, SortieError error)
{
    const Plan copy = copy_of(plan);
    copy.bytes[at] = byte;
    refused(error, copy.bytes, copy.length);
    free(copy.bytes);
}

static void other_plans(Plan plan)
{
    const Plan old = read_plan("tests/golden/plans/agent-1.0.plan");
    const Plan team = read_plan("tests/golden/plans/team-value-2.0.plan");
    const Plan proposals = read_plan("tests/golden/plans/proposals-2.0.plan");
    const Plan text = read_plan("README.md");
    refused(SORTIE_ERROR_VERSION, old.bytes, old.length);
    refused(SORTIE_ERROR_WRONG_NETWORK, team.bytes, team.length);
    refused(SORTIE_ERROR_WRONG_NETWORK, proposals.bytes, proposals.length);
    refused(SORTIE_ERROR_NO_PLAN, text.bytes, text.length);
    changed(plan, 0, 's', SORTIE_ERROR_NO_PLAN);
    changed(plan, 10, 99, SORTIE_ERROR_VERSION);
    changed(plan, 12, 1, SORTIE_ERROR_ENDIAN);
    changed(plan, 40, 1, SORTIE_ERROR_DAMAGED);
    changed(plan, plan.length - 1, 0x55, SORTIE_ERROR_DAMAGED);
    changed(plan, 116, 200, SORTIE_ERROR_OTHER_MACHINE);
    changed(plan, 117, 200, SORTIE_ERROR_UNKNOWN_OPERATOR);
}

/* Memory may start anywhere; what is too small by a byte is refused. */
static void memory_of_every_size(Plan plan)
{
    size_t bytes, at, size;
    unsigned char *memory;
    SortiePolicy *policy;
    EXPECT(SORTIE_ERROR_NONE, sortie_memory_bytes(plan.bytes, plan.length, &bytes));
    memory = room(bytes + 64);
    for (at = 0; at < 64; at++) {
        /* How far the next multiple of 64 is. */
        const size_t before = (64 - at) % 64, needed = bytes - 63 + before;
        memset(memory, 0xA5, bytes + 64);
        EXPECT(SORTIE_ERROR_MEMORY_TOO_SMALL,
               sortie_load(plan.bytes, plan.length, memory + at, needed - 1, &policy));
        CHECK(policy == NULL && memory[at] == 0xA5);
        EXPECT(SORTIE_ERROR_NONE, sortie_load(plan.bytes, plan.length, memory + at, needed, &policy));
        CHECK((unsigned char *)policy == memory + at + before);
        CHECK(sortie_kind(policy) != SORTIE_KIND_NONE);
        CHECK(at == 0 || memory[at - 1] == 0xA5);
        CHECK(memory[at + needed] == 0xA5);
    }
    for (size = 0; size < bytes - 63; size += 13)
        EXPECT(SORTIE_ERROR_MEMORY_TOO_SMALL,
               sortie_load(plan.bytes, plan.length, memory, size, &policy));
    EXPECT(SORTIE_ERROR_WRONG_LENGTH,
           sortie_load(plan.bytes, plan.length, memory, SIZE_MAX, &policy));
    free(memory);
}

static void memory_that_is_not_there(Plan plan)
{
    SortiePolicy *places[3], *policy;
    size_t sizes[3], bytes;
    unsigned char *memory;
    EXPECT(SORTIE_ERROR_NULL, sortie_memory_bytes(plan.bytes, plan.length, NULL));
    EXPECT(SORTIE_ERROR_MISALIGNED,
           sortie_memory_bytes(plan.bytes, plan.length, (size_t *)(void *)((char *)sizes + 1)));
    EXPECT(SORTIE_ERROR_OVERLAP,
           sortie_memory_bytes(plan.bytes, plan.length, (size_t *)(void *)(plan.bytes + 64)));
    EXPECT(SORTIE_ERROR_NONE, sortie_memory_bytes(plan.bytes, plan.length, &bytes));
    memory = room(bytes);
    EXPECT(SORTIE_ERROR_NULL, sortie_load(plan.bytes, plan.length, memory, bytes, NULL));
    EXPECT(SORTIE_ERROR_MISALIGNED, sortie_load(plan.bytes, plan.length, memory, bytes,
                                                (SortiePolicy **)(void *)((char *)places + 1)));
    EXPECT(SORTIE_ERROR_NULL, sortie_load(plan.bytes, plan.length, NULL, bytes, &policy));
    EXPECT(SORTIE_ERROR_MEMORY_TOO_SMALL, sortie_load(plan.bytes, plan.length, NULL, 0, &policy));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_load(plan.bytes, plan.length, memory, bytes,
                                             (SortiePolicy **)(void *)(memory + 64)));
    EXPECT(SORTIE_ERROR_OVERLAP, sortie_load(plan.bytes, plan.length, memory, bytes,
                                             (SortiePolicy **)(void *)(plan.bytes + 64)));
    EXPECT(SORTIE_ERROR_OVERLAP,
           sortie_load(plan.bytes, plan.length, plan.bytes, plan.length, &policy));

    /* What fails leaves the policy that was there. */
    EXPECT(SORTIE_ERROR_NONE, sortie_load(plan.bytes, plan.length, memory, bytes, &policy));
    places[0] = policy;
    EXPECT(SORTIE_ERROR_TRUNCATED, sortie_load(plan.bytes, 100, memory, bytes, &policy));
    EXPECT(SORTIE_ERROR_MEMORY_TOO_SMALL, sortie_load(plan.bytes, plan.length, memory, 99, &policy));
    CHECK(policy == NULL && sortie_kind(places[0]) != SORTIE_KIND_NONE);
    free(memory);
}

/* The macro's memory is enough, and not much more than that. */
static void memory_before_it_runs(void)
{
    const struct {
        const char *file;
        size_t arena, inputs, outputs;
    } plans[] = {{"tests/golden/plans/policy-2.0.plan", 12232, 2, 1},
                 {"tests/golden/plans/agent-2.0.plan", 904, 0, 0},
                 {"examples/embed_c/cart.plan", 1792, 1, 1}};
    size_t index, bytes;
    for (index = 0; index < sizeof plans / sizeof *plans; index++) {
        const Plan plan = read_plan(plans[index].file);
        const size_t said =
            SORTIE_MEMORY_BYTES(plans[index].arena, plans[index].inputs, plans[index].outputs);
        EXPECT(SORTIE_ERROR_NONE, sortie_memory_bytes(plan.bytes, plan.length, &bytes));
        CHECK(bytes <= said && said <= bytes + SORTIE_POLICY_BYTES);
        free(plan.bytes);
    }
}

static void texts(void)
{
    int code, other;
    for (code = -3; code <= SORTIE_ERROR_OTHER + 3; code++) {
        const int known = code >= SORTIE_ERROR_NONE && code <= SORTIE_ERROR_OTHER;
        CHECK(strlen(sortie_error_text(code)) > 5);
        for (other = -3; other < code && known; other++)
            CHECK(strcmp(sortie_error_text(code), sortie_error_text(other)) != 0);
    }
    CHECK(strcmp(sortie_error_text(INT_MIN), sortie_error_text(INT_MAX)) == 0);
    CHECK(sortie_version() == SORTIE_VERSION);
    CHECK(sortie_plan_format() == (SORTIE_PLAN_FORMAT_MAJOR << 16 | SORTIE_PLAN_FORMAT_MINOR));
}

void bad_plans(void)
{
    const Plan policy = read_plan("tests/golden/plans/policy-2.0.plan");
    const Plan agent = read_plan("tests/golden/plans/agent-2.0.plan");
    texts();
    damaged(policy);
    damaged(agent);
    other_plans(policy);
    memory_of_every_size(policy);
    memory_of_every_size(agent);
    memory_that_is_not_there(policy);
    memory_before_it_runs();
}
