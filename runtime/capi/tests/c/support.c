#define _POSIX_C_SOURCE 200112L

#include "support.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *repository;

void check(int is_so, const char *file, int line, const char *what)
{
    if (!is_so) {
        fprintf(stderr, "%s:%d: not so: %s\n", file, line, what);
        exit(1);
    }
}

void expect(SortieError wanted, SortieError got, const char *file, int line, const char *what)
{
    if (wanted != got) {
        fprintf(stderr, "%s:%d: %s\n  wanted: %s\n  got:    %s\n", file, line, what,
                sortie_error_text(wanted), sortie_error_text(got));
        exit(1);
    }
}

void *room(size_t bytes)
{
    void *start = NULL;
    CHECK(posix_memalign(&start, 64, bytes) == 0);
    return start;
}

const char *path_of(const char *file)
{
    static char path[4096];
    CHECK(snprintf(path, sizeof path, "%s/%s", repository, file) < (int)sizeof path);
    return path;
}

Plan read_plan(const char *file)
{
    FILE *stream = fopen(path_of(file), "rb");
    Plan plan;
    long length;
    CHECK(stream != NULL);
    CHECK(fseek(stream, 0, SEEK_END) == 0);
    length = ftell(stream);
    CHECK(length > 0 && fseek(stream, 0, SEEK_SET) == 0);
    plan.length = (size_t)length;
    plan.bytes = room(plan.length);
    CHECK(fread(plan.bytes, 1, plan.length, stream) == plan.length);
    fclose(stream);
    return plan;
}

Plan copy_of(Plan plan)
{
    Plan copy = {room(plan.length), plan.length};
    memcpy(copy.bytes, plan.bytes, plan.length);
    return copy;
}

static uint32_t word(const unsigned char *bytes)
{
    return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

static uint32_t crc32c(uint32_t crc, const unsigned char *bytes, size_t length)
{
    int bit;
    for (; length > 0; length--, bytes++) {
        crc ^= *bytes;
        for (bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? 0x82f63b78u : 0);
    }
    return crc;
}

static void store(unsigned char *bytes, uint32_t number)
{
    int byte;
    for (byte = 0; byte < 4; byte++)
        bytes[byte] = (unsigned char)(number >> 8 * byte);
}

Plan drawing(Plan plan)
{
    const Plan drawn = copy_of(plan);
    const uint32_t start = word(drawn.bytes + 44), length = word(drawn.bytes + 48);
    /* The last operator: its number, the words of its fields, a place. */
    unsigned char *choice = drawn.bytes + start + length - 12;
    uint32_t crc;
    CHECK(choice[0] == 3);
    choice[0] = 5;
    memset(drawn.bytes + 60, 0, 4);
    crc = ~crc32c(crc32c(~(uint32_t)0, drawn.bytes, 128), drawn.bytes + start, length);
    store(drawn.bytes + 60, crc);
    return drawn;
}

Plan clamping(Plan plan)
{
    const Plan clamped = copy_of(plan);
    unsigned char *guards = clamped.bytes + clamped.length - 16;
    uint32_t crc;
    /* Name, length, checksum, and what is guarded, whose third byte says whether outputs are clamped. */
    while (memcmp(guards, "SORTIEGU", 8) != 0)
        CHECK(--guards >= clamped.bytes);
    CHECK(guards[18] == 0);
    guards[18] = 1;
    crc = ~crc32c(crc32c(~(uint32_t)0, guards, 12), guards + 16, word(guards + 8));
    store(guards + 12, crc);
    return clamped;
}

SortiePolicy *load(Plan plan)
{
    size_t bytes;
    SortiePolicy *policy;
    EXPECT(SORTIE_ERROR_NONE, sortie_memory_bytes(plan.bytes, plan.length, &bytes));
    EXPECT(SORTIE_ERROR_NONE, sortie_load(plan.bytes, plan.length, room(bytes), bytes, &policy));
    return policy;
}

uint32_t next_number(uint64_t *state)
{
    *state = *state * 6364136223846793005u + 1;
    return (uint32_t)(*state >> 40);
}

float next_feature(uint64_t *state)
{
    const uint32_t number = next_number(state);
    return number % 3 == 0 ? 0.0f : (float)number / 8388608.0f - 1.0f;
}

uint32_t bits_of(float number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    return bits;
}
