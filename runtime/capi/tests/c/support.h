/* What the tests of the C interface share. */
#ifndef SUPPORT_H
#define SUPPORT_H

#include "sortie.h"

/* A plan in memory of exactly its size, where plans must start. */
typedef struct Plan {
    unsigned char *bytes;
    size_t length;
} Plan;

/* Ends the test where something is not so. */
#define CHECK(what) check((what) != 0, __FILE__, __LINE__, #what)
/* Ends the test where a call answers something else. */
#define EXPECT(error, call) expect((error), (call), __FILE__, __LINE__, #call)

void check(int is_so, const char *file, int line, const char *what);
void expect(SortieError wanted, SortieError got, const char *file, int line, const char *what);

/* Memory that is exactly so large and starts at a multiple of 64. */
void *room(size_t bytes);
/* A file below the folder of the repository, the program's first argument. */
Plan read_plan(const char *file);
Plan copy_of(Plan plan);
/* The plan with its choice turned into a draw, and right checksums. */
Plan drawing(Plan plan);
/* The plan with guards that bring outputs back to their limits, and the right checksum. */
Plan clamping(Plan plan);
/* A policy in memory of its own. */
SortiePolicy *load(Plan plan);
const char *path_of(const char *file);

/* The numbers of recorded observations, see tests/golden/plans/README.md. */
uint32_t next_number(uint64_t *state);
float next_feature(uint64_t *state);
uint32_t bits_of(float number);

extern const char *repository;

void recorded(void);
void bad_plans(void);
void bad_calls(void);
void guards(void);

#endif
