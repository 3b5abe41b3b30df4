/* Sortie: policies in C programs, from the plans that `sortie compile` makes. docs/guide/c.md shows how.
 *
 * Nothing is allocated, nothing blocks, nothing panics. Every function answers whatever it is given: functions that can
 * fail with a SortieError, sizes with 0. What C cannot see stays the caller's word: a pointer is NULL or leads to as many
 * values as the length beside it says, a SortiePolicy comes from sortie_load and its memory and its plan are still
 * there, and nobody else uses any of it while a function runs. */

#ifndef SORTIE_H
#define SORTIE_H

/* Made by cbindgen from runtime/capi/src; `cargo test -p sortie-capi` says how to make it again. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Before an array that holds a plan: `SORTIE_ALIGNED static const unsigned char PLAN[] = {...};`. */
#if defined(__cplusplus)
#define SORTIE_ALIGNED alignas(64)
#elif defined(__STDC_VERSION__) && __STDC_VERSION__ >= 201112L
#define SORTIE_ALIGNED _Alignas(64)
#elif defined(_MSC_VER)
#define SORTIE_ALIGNED __declspec(align(64))
#else
#define SORTIE_ALIGNED __attribute__((aligned(64)))
#endif

/* Bytes of memory that are enough for a policy, for arrays whose size is known before the program runs: `sortie compile`
 * says how many bytes of arena a plan needs, and `sortie inspect` its inputs and outputs. */
#define SORTIE_MEMORY_BYTES(arena_bytes, inputs, outputs) \
    (SORTIE_POLICY_BYTES + (size_t)(arena_bytes) + 16 * ((size_t)(inputs) + (size_t)(outputs)))

/* Bytes of memory that are enough for the guards of a plan with so many numbers in all outputs. */
#define SORTIE_GUARDS_MEMORY(outputs) (SORTIE_GUARDS_BYTES + 4 * (size_t)(outputs))

/* What sortie_version answers where header and library belong together. */
#define SORTIE_VERSION (SORTIE_VERSION_MAJOR << 16 | SORTIE_VERSION_MINOR << 8 | SORTIE_VERSION_PATCH)

// Major version of the library that this header belongs to.
#define SORTIE_VERSION_MAJOR 0

// Minor version of the library that this header belongs to.
#define SORTIE_VERSION_MINOR 1

// Patch version of the library that this header belongs to.
#define SORTIE_VERSION_PATCH 0

// Major version of the plans that the library reads.
#define SORTIE_PLAN_FORMAT_MAJOR 2

// Newest minor version of the plans that the library reads.
#define SORTIE_PLAN_FORMAT_MINOR 3

// Bytes that a policy takes beside its arena and the places of its inputs and outputs. See `SORTIE_MEMORY_BYTES`.
#define SORTIE_POLICY_BYTES 640

// Stands for the last action of an agent that has not acted yet.
#define SORTIE_NO_ACTION 65535

// Bytes that guards take, wherever they start, beside a float for every number of all outputs: `SORTIE_GUARDS_MEMORY`.
#define SORTIE_GUARDS_BYTES 256

// The age of an observation that nobody knows.
#define SORTIE_AGE_UNKNOWN UINT64_MAX

// Why a function did nothing. `sortie_error_text` says what to do about it.
enum SortieError
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // All is well.
    SORTIE_ERROR_NONE = 0,
    // A pointer is null.
    SORTIE_ERROR_NULL = 1,
    // An address is not aligned.
    SORTIE_ERROR_MISALIGNED = 2,
    // Memory that is written is given twice.
    SORTIE_ERROR_OVERLAP = 3,
    // The pointer leads to no loaded policy.
    SORTIE_ERROR_NO_POLICY = 4,
    // The bytes are no plan.
    SORTIE_ERROR_NO_PLAN = 5,
    // The plan has a format that this library does not read.
    SORTIE_ERROR_VERSION = 6,
    // The plan was written for the other byte order.
    SORTIE_ERROR_ENDIAN = 7,
    // Bytes of the plan are missing.
    SORTIE_ERROR_TRUNCATED = 8,
    // A checksum of the plan does not match.
    SORTIE_ERROR_DAMAGED = 9,
    // The plan was made for another machine: its weights are laid out otherwise, or its arithmetic is not available.
    SORTIE_ERROR_OTHER_MACHINE = 10,
    // The plan has an operator that this library does not have.
    SORTIE_ERROR_UNKNOWN_OPERATOR = 11,
    // The plan contradicts itself.
    SORTIE_ERROR_INCONSISTENT = 12,
    // The plan is neither a policy's nor an agent's.
    SORTIE_ERROR_WRONG_NETWORK = 13,
    // The memory for the policy is too small.
    SORTIE_ERROR_MEMORY_TOO_SMALL = 14,
    // The function is for another kind of plan.
    SORTIE_ERROR_WRONG_KIND = 15,
    // There are more or fewer inputs or outputs than the plan has.
    SORTIE_ERROR_WRONG_COUNT = 16,
    // An array is longer or shorter than the plan needs it.
    SORTIE_ERROR_WRONG_LENGTH = 17,
    // More entities are visible, or given, than the plan takes.
    SORTIE_ERROR_TOO_MANY_ENTITIES = 18,
    // No action is available.
    SORTIE_ERROR_NO_AVAILABLE_ACTION = 19,
    // A number that was given, or one that came out, is not finite.
    SORTIE_ERROR_NOT_FINITE = 20,
    // The policy chooses greedily: there is nothing to draw from.
    SORTIE_ERROR_GREEDY = 21,
    // Something that this version of the header has no name for.
    SORTIE_ERROR_OTHER = 22,
    // The plan has no guards, or the pointer leads to none.
    SORTIE_ERROR_NO_GUARDS = 23,
    // No guard has tripped: there is nothing to fall back from.
    SORTIE_ERROR_NO_TRIP = 24,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum SortieError SortieError;
#else
typedef int32_t SortieError;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// What a plan is.
enum SortieKind
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // There is no policy.
    SORTIE_KIND_NONE = 0,
    // A policy over inputs of fixed sizes: `sortie_respond`, `sortie_choose`, `sortie_draw`.
    SORTIE_KIND_POLICY = 1,
    // One agent of a team, which sees entities: `sortie_decide`, `sortie_sample`.
    SORTIE_KIND_AGENT = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum SortieKind SortieKind;
#else
typedef int32_t SortieKind;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Whether the network itself normalises what it observes by the means and deviations of its training.
enum SortieNormaliser
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // The plan does not say.
    SORTIE_NORMALISER_UNKNOWN = 0,
    // It does not: whoever calls it normalises, if it was trained so.
    SORTIE_NORMALISER_NONE = 1,
    // It does.
    SORTIE_NORMALISER_IN_FILE = 2,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum SortieNormaliser SortieNormaliser;
#else
typedef int32_t SortieNormaliser;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// A list that a plan has of its robot, from the metadata of the file that it was made from.
enum SortieFact
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // Joints in the order of actions: names.
    SORTIE_FACT_JOINT_NAMES = 0,
    // Angles or lengths in which the robot stands, radians or metres: numbers.
    SORTIE_FACT_DEFAULT_JOINT_POS = 1,
    // What an action is multiplied by; one number, or one for each joint.
    SORTIE_FACT_ACTION_SCALE = 2,
    // Gains of the joints' position control, Nm/rad or N/m: numbers.
    SORTIE_FACT_STIFFNESS = 3,
    // Gains of their velocity, Nms/rad or Ns/m: numbers.
    SORTIE_FACT_DAMPING = 4,
    // What the observation consists of: names.
    SORTIE_FACT_OBSERVATION_NAMES = 5,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum SortieFact SortieFact;
#else
typedef int32_t SortieFact;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// The guard that tripped. Numbers are those of Sortie's messages.
enum SortieGuard
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // None did.
    SORTIE_GUARD_NONE = 0,
    // An input is outside of its range, or NaN.
    SORTIE_GUARD_INPUT_RANGE = 1,
    // The observation is older than it may be.
    SORTIE_GUARD_AGE = 2,
    // An output is NaN or infinite.
    SORTIE_GUARD_OUTPUT_NOT_FINITE = 3,
    // An output is outside of its range.
    SORTIE_GUARD_OUTPUT_RANGE = 4,
    // An output is further from the last one given out than it may change by.
    SORTIE_GUARD_OUTPUT_RATE = 5,
    // The policy has not answered: for programs to say, to `sortie_fall_back`.
    SORTIE_GUARD_UNDECIDED = 7,
    // None now: one that tripped before is held.
    SORTIE_GUARD_HELD = 8,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum SortieGuard SortieGuard;
#else
typedef int32_t SortieGuard;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// The guards of a plan, and what they remember of one robot. They live in the memory that was given to `sortie_guard`, and
// end with it. One thread at a time uses them.
typedef struct SortieGuards SortieGuards;

// A loaded policy. It lives in the memory that was given to `sortie_load`, and ends with it: there is nothing to be freed.
// One thread at a time uses it; several policies may share one plan.
typedef struct SortiePolicy SortiePolicy;

// Numbers that a policy reads.
typedef struct {
    // The numbers, all of them finite.
    const float *values;
    // How many there are.
    size_t length;
} SortieInput;

// Room for numbers that a policy writes.
typedef struct {
    // Where the numbers go.
    float *values;
    // How many there are.
    size_t length;
} SortieOutput;

// The chosen action and what the network said of it.
typedef struct {
    // Index of the action.
    uint32_t action;
    // Its utility, score or logit.
    float utility;
} SortieDecision;

// What one agent of a team sees in one step.
typedef struct {
    // A row of features for every entity, agents first.
    const float *rows;
    // Number of entities.
    size_t entities;
    // Numbers from one row to the next, at least `sortie_features`.
    size_t stride;
    // The last action of every agent, `SORTIE_NO_ACTION` where there was none.
    const uint16_t *last_actions;
    // Number of last actions.
    size_t agents;
    // For every entity, 0 where the agent does not see it. NULL: it sees all.
    const uint8_t *visible;
    // The agent's own row.
    size_t own;
    // For every action, 0 where it is not available. NULL with a length of 0: all are available.
    const uint8_t *available;
    // Number of actions.
    size_t actions;
} SortieObservation;

// What a guard found.
typedef struct {
    // Which guard, a `SortieGuard`; `SORTIE_GUARD_NONE` where all is well.
    int32_t guard;
    // At which number of all inputs, or of all outputs, one behind the other.
    uint32_t index;
    // Whether outputs were brought back to their limits, and can be given out.
    bool clamped;
} SortieTrip;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The version of the library that runs: major << 16 | minor << 8 | patch. Compare it with `SORTIE_VERSION` of the header.
uint32_t sortie_version(void);

// The plan format that the library reads, and all older minor versions of it: major << 16 | minor.
uint32_t sortie_plan_format(void);

// What is wrong and what to do, in one line that is never freed. For numbers that are no error too.
const char *sortie_error_text(int32_t error);

// Checks a plan and writes how many bytes of memory its policy needs, wherever they start; 0 where that fails.
// A program that knows its plan can say so before it runs: `SORTIE_MEMORY_BYTES`.
SortieError sortie_memory_bytes(const void *plan,
                                size_t plan_bytes,
                                size_t *bytes);

// Loads a plan: checks all of it once, and lays the policy into the memory that is given. Nothing is copied or
// allocated: the plan's bytes, which start at a multiple of 64 (`SORTIE_ALIGNED`), and the memory, which may start
// anywhere, stay as long as the policy is used, and nobody writes them. `*policy` is NULL where that fails; a policy
// that was in the memory before is then still there.
SortieError sortie_load(const void *plan,
                        size_t plan_bytes,
                        void *memory,
                        size_t memory_bytes,
                        SortiePolicy **policy);

// What the plan of a policy is.
SortieKind sortie_kind(const SortiePolicy *policy);

// Number of inputs of a policy, in the order in which `sortie inspect` shows them.
size_t sortie_input_count(const SortiePolicy *policy);

// Numbers of the input at `index`.
size_t sortie_input_length(const SortiePolicy *policy, size_t index);

// Number of outputs of a policy, 0 where it only chooses.
size_t sortie_output_count(const SortiePolicy *policy);

// Numbers of the output at `index`.
size_t sortie_output_length(const SortiePolicy *policy, size_t index);

// Number of recurrent states: of a policy as many as the network has, of an agent one or none.
size_t sortie_state_count(const SortiePolicy *policy);

// Numbers of the recurrent state at `index`.
size_t sortie_state_length(const SortiePolicy *policy, size_t index);

// Numbers of all recurrent states, which the caller keeps one behind the other and sets to 0 where an episode begins.
size_t sortie_state_numbers(const SortiePolicy *policy);

// Number of actions that a policy or an agent chooses among, 0 where it makes no choice.
size_t sortie_actions(const SortiePolicy *policy);

// Whether actions can be drawn: `sortie_draw`, `sortie_sample`.
bool sortie_draws(const SortiePolicy *policy);

// Features of an entity that an agent sees, its last action not counted.
size_t sortie_features(const SortiePolicy *policy);

// Most entities that an agent sees at a time.
size_t sortie_most_entities(const SortiePolicy *policy);

// Number of names or numbers of a list, a `SortieFact`.
size_t sortie_fact_count(const SortiePolicy *policy, int32_t fact);

// The name at `index` of a list of names, which stands in the plan; NULL where there is none.
const char *sortie_fact_name(const SortiePolicy *policy, int32_t fact, size_t index);

// The number at `index` of a list of numbers; NaN where there is none.
float sortie_fact_number(const SortiePolicy *policy, int32_t fact, size_t index);

// Whether the network normalises what it observes.
SortieNormaliser sortie_normaliser(const SortiePolicy *policy);

// Writes the outputs of a policy and replaces its recurrent states, which the caller keeps, `sortie_state_numbers` in
// all. Where that fails no state has changed, and outputs hold nothing to be used.
SortieError sortie_respond(SortiePolicy *policy,
                           const SortieInput *inputs,
                           size_t input_count,
                           float *states,
                           size_t state_numbers,
                           const SortieOutput *outputs,
                           size_t output_count);

// Chooses an action greedily among the available ones, the first of several, and replaces the recurrent states.
// `available` has a byte for every action, 0 where it is not available; NULL with 0 actions: all are available.
SortieError sortie_choose(SortiePolicy *policy,
                          const SortieInput *inputs,
                          size_t input_count,
                          const uint8_t *available,
                          size_t actions,
                          float *states,
                          size_t state_numbers,
                          SortieDecision *decision);

// Draws an action by 32 random bits, with the probabilities that the policy gives to the available ones, and replaces
// the recurrent states. The same bits draw the same action everywhere.
SortieError sortie_draw(SortiePolicy *policy,
                        const SortieInput *inputs,
                        size_t input_count,
                        const uint8_t *available,
                        size_t actions,
                        float *states,
                        size_t state_numbers,
                        uint32_t random,
                        SortieDecision *decision);

// Decides greedily for one agent of a team, and replaces its recurrent state.
SortieError sortie_decide(SortiePolicy *policy,
                          const SortieObservation *observation,
                          float *states,
                          size_t state_numbers,
                          SortieDecision *decision);

// Draws the action of one agent of a team by 32 random bits, and replaces its recurrent state.
SortieError sortie_sample(SortiePolicy *policy,
                          const SortieObservation *observation,
                          float *states,
                          size_t state_numbers,
                          uint32_t random,
                          SortieDecision *decision);

// Lays the guards that stand in a policy's plan (`sortie compile --guards`) into memory, which may start anywhere and stays
// as long as they are used: `SORTIE_GUARDS_MEMORY` says how much. One for each robot. `*guards` is NULL where that fails.
SortieError sortie_guard(const SortiePolicy *policy,
                         void *memory,
                         size_t memory_bytes,
                         SortieGuards **guards);

// Forgets what was given out, and what is held: where an episode begins, or a robot has stood still.
SortieError sortie_guard_begin(SortieGuards *guards);

// Before the policy: whether it may be asked. `inputs` are the numbers of all inputs, one behind the other; `age_ns` is
// the time since they were measured, or `SORTIE_AGE_UNKNOWN`. Where `trip->guard` says that a guard tripped, the policy is
// not asked, and `sortie_fall_back` says what is given out.
SortieError sortie_check_inputs(SortieGuards *guards,
                                const float *inputs,
                                size_t length,
                                uint64_t age_ns,
                                SortieTrip *trip);

// Behind the policy: whether its outputs may be given out, the numbers of all of them, one behind the other. Where
// `trip->guard` says that a guard tripped, and `trip->clamped` not that they were brought back to their limits,
// `sortie_fall_back` says what is given out instead. What passes is remembered as given out.
SortieError sortie_check_outputs(SortieGuards *guards,
                                 float *outputs,
                                 size_t length,
                                 SortieTrip *trip);

// Writes what is given out where `guard` tripped, a `SortieGuard`, or where `sortie_respond` failed
// (`SORTIE_GUARD_UNDECIDED`): the plan's fallback, or the last outputs where it has none. Remembers it as given out, and
// holds it as long as the plan says.
SortieError sortie_fall_back(SortieGuards *guards,
                             int32_t guard,
                             float *outputs,
                             size_t length);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SORTIE_H */
