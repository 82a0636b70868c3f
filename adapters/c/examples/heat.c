/* heat N STEPS [CONFIG]: heat spreads through a box with cold walls and a source that goes round; every step is pushed to
 * gloaming when a scene file is given. du/dt = Laplacian(u) + source, explicit, 7 points, one layer of ghosts (the walls).
 * Prints a hash of the last step, which is the same with and without gloaming.
 *
 *   cc -O2 heat.c $(pkg-config --cflags --libs gloaming) -lm -o heat && ./heat 64 100 heat.toml
 */
#include <math.h>
#include <stdlib.h>

#include "gloaming.h"
#include "held.h"

static size_t n, m;
static float *now, *next;

static size_t at(size_t i, size_t j, size_t k) { return (k * m + j) * m + i; }

static void advance(int step) {
    const float rate = 0.15f, angle = 0.15f * (float)step;
    const float cx = 0.5f + 0.25f * cosf(angle), cy = 0.5f + 0.25f * sinf(angle);
    for (size_t k = 1; k <= n; k++)
        for (size_t j = 1; j <= n; j++)
            for (size_t i = 1; i <= n; i++) {
                size_t c = at(i, j, k);
                float sum = now[c - 1] + now[c + 1] + now[c - m] + now[c + m] + now[c - m * m] + now[c + m * m];
                float x = (float)i / (float)n - cx, y = (float)j / (float)n - cy, z = (float)k / (float)n - 0.4f;
                float source = x * x + y * y + z * z < 0.01f ? 0.2f : 0.0f;
                next[c] = now[c] + rate * (sum - 6.0f * now[c]) + source;
            }
    float *last = now;
    now = next;
    next = last;
}

int main(int argc, char **argv) {
    n = argc > 1 ? (size_t)atoi(argv[1]) : 48;
    int steps = argc > 2 ? atoi(argv[2]) : 48;
    m = n + 2;
    now = calloc(m * m * m, sizeof *now);
    next = calloc(m * m * m, sizeof *next);

    gloaming_error error = {0};
    gloaming_session *lit = argc > 3 ? gloaming_open_file(argv[3], &error) : NULL;
    if (argc > 3 && !lit) fprintf(stderr, "without pictures: %s\n", error.message);
    double h = 1.0 / (double)n;
    gloaming_block block = {.dims = {m, m, m}, .start = {1, 1, 1}, .size = {n, n, n}, .spacing = {h, h, h},
                            .origin = {-0.5 * h, -0.5 * h, -0.5 * h}, .type = GLOAMING_F32};

    for (int step = 0; step < steps; step++) {
        advance(step);
        if (!lit) continue;
        double copy = held_copy(now, n * n * n * sizeof *now), begun = held_now();
        int code = gloaming_push_block(lit, (uint64_t)step, 0.1 * step, &block, now, &error);
        if (code == GLOAMING_OK) held_note(copy, held_now() - begun);
        if (code > 0) fprintf(stderr, "step %d: %s\n", step, error.message);
    }
    if (lit) {
        gloaming_stats stats;
        if (gloaming_close(lit, &stats, &error) != GLOAMING_OK) fprintf(stderr, "%s\n", error.message);
        fprintf(stderr, "%llu of %llu steps lit, %llu lost, %llu dropped\n", (unsigned long long)stats.lit,
                (unsigned long long)stats.pushed, (unsigned long long)stats.lost, (unsigned long long)stats.dropped);
        held_report("push of a block with ghosts");
    }
    printf("%016llx\n", (unsigned long long)held_hash(now, m * m * m * sizeof *now));
    free(now);
    free(next);
    return 0;
}
