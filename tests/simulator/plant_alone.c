/* A cut of the plant without a controller of ours: `plant_alone MACHINE TICKS` prints a digest of what it shows and is in
 * each millisecond, and how deep it is.
 *
 * MACHINE is a file with the parts of struct machine in their order, each behind its size in bytes (8 bytes, as the
 * processor has them). Random numbers are used again where they end. */
#include "plant.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PARTS (sizeof(struct machine) / sizeof(void *))
#define ROOM 200 /* more numbers than a millisecond takes */

static uint64_t digest = 0xCBF29CE484222325u; /* FNV-1a */

static void add(const void *part, size_t size) {
    for (const unsigned char *byte = part; size > 0; size--) {
        digest = (digest ^ *byte++) * 0x100000001B3u;
    }
}

/* Down until the gap voltage falls, then both ways by small steps. */
static void command(const struct readings *r, struct drive *d) {
    d->pulses_on = 1;
    d->pulse_starts = 1;
    double lowest_v = 100.0;
    for (int64_t k = 0; k < r->pulses; k++) {
        lowest_v = lesser(lowest_v, r->plateau_v[k]);
    }
    double step_v = lowest_v < 30.0 && r->gap_v < 9.6 ? -0.005 : 0.0025;
    d->actuator_v = greater(0.0, d->actuator_v + step_v);
}

int main(int argc, char **argv) {
    FILE *file = argc == 3 ? fopen(argv[1], "rb") : NULL;
    void *parts[PARTS];
    int64_t numbers = 0; /* of the block for pulses */
    for (size_t k = 0; k < PARTS; k++) {
        int64_t size;
        if (file == NULL || fread(&size, sizeof size, 1, file) != 1 || (parts[k] = malloc((size_t)size)) == NULL ||
            fread(parts[k], (size_t)size, 1, file) != 1) {
            fprintf(stderr, "no machine\n");
            return 2;
        }
        numbers = k == 5 ? size / (int64_t)sizeof(double) : numbers;
    }
    struct machine m;
    memcpy(&m, parts, sizeof m);
    for (long ticks = strtol(argv[2], NULL, 10); ticks > 0; ticks--) {
        if (m.plant->random_at > numbers - ROOM || m.plant->noise_at > numbers - ROOM) {
            m.plant->random_at = m.plant->noise_at = 0;
        }
        command(m.readings, m.drive);
        edm_plant_run(&m);
        add(m.readings, sizeof *m.readings);
        add(m.plant, sizeof *m.plant);
    }
    printf("%016llx %.3f um\n", (unsigned long long)digest, m.plant->depth_um);
    return 0;
}
