/* Everything a program can do wrong at this interface, each refused with its code; and pushes from several threads. Under
 * valgrind too. Prints "faults survived" and ends with 0. */
#include <fenv.h>
#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gloaming.h"

#define N 8

static int failed;
#define EXPECT(got, want)                                                                              \
    do {                                                                                               \
        int got_ = (got), want_ = (want);                                                              \
        if (got_ != want_) {                                                                           \
            fprintf(stderr, "%s:%d: %s is %d, not %d: %s\n", __FILE__, __LINE__, #got, got_, want_, error.message); \
            failed = 1;                                                                                \
        }                                                                                              \
    } while (0)

static gloaming_error error;
static int released;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

static void release(void *memory) {
    pthread_mutex_lock(&lock);
    released++;
    pthread_mutex_unlock(&lock);
    free(memory);
}

static float *values(void) {
    float *a = malloc(N * N * N * sizeof *a);
    for (int i = 0; i < N * N * N; i++) a[i] = (float)(i % 10) / 10.0f;
    return a;
}

static void *pusher(void *lit) {
    float *a = values();
    static uint64_t next;
    for (int i = 0; i < 5; i++) {
        uint64_t step = 100 + __atomic_fetch_add(&next, 1, __ATOMIC_SEQ_CST);
        gloaming_push(lit, step, NAN, (size_t[]){N, N, N}, NULL, GLOAMING_F32, a, NULL);
    }
    free(a);
    return NULL;
}

int main(int argc, char **argv) {
    if (argc < 2) return 2;
    const size_t dims[3] = {N, N, N};
    float *a = values();

    /* Sessions that do not open. */
    if (gloaming_open(NULL, &error)) failed = 1;
    EXPECT(error.code, GLOAMING_ARGUMENT);
    if (gloaming_open("[insitu]\npolicy = 'wait'\n", &error)) failed = 1;
    EXPECT(error.code, GLOAMING_SCENE);
    if (!strstr(error.message, "drop-oldest") || !strstr(error.message, "line 2")) failed = 1;
    if (gloaming_open("[insitu]\noutputs = ['/proc/no/such/movie.mp4']\n", &error)) failed = 1;
    EXPECT(error.code, GLOAMING_IO);
    if (gloaming_open("[insitu]\noutputs = ['movie.avi']\n", &error)) failed = 1;
    EXPECT(error.code, GLOAMING_FORMAT);
    if (gloaming_open_file("no/such/scene.toml", &error)) failed = 1;
    EXPECT(error.code, GLOAMING_IO);
    EXPECT(gloaming_push(NULL, 0, 0.0, dims, NULL, GLOAMING_F32, a, &error), GLOAMING_CLOSED);
    EXPECT(gloaming_close(NULL, NULL, &error), GLOAMING_CLOSED);

    gloaming_session *lit = gloaming_open_file(argv[1], &error);
    if (!lit) {
        fprintf(stderr, "%s\n", error.message);
        return 1;
    }
    /* The solver's own floating-point environment: rounding upwards, a flag raised. */
    fesetround(FE_UPWARD);
    feraiseexcept(FE_OVERFLOW);
    const int raised = fetestexcept(FE_OVERFLOW); /* nothing under valgrind, which has no flags */
    EXPECT(gloaming_push(lit, 0, 0.0, dims, NULL, GLOAMING_F32, a, &error), GLOAMING_OK);
    EXPECT(fegetround(), FE_UPWARD);
    EXPECT(fetestexcept(FE_OVERFLOW), raised);
    fesetround(FE_TONEAREST);

    /* Blocks that cannot be read. */
    EXPECT(gloaming_push(lit, 1, 0.0, NULL, NULL, GLOAMING_F32, a, &error), GLOAMING_ARGUMENT);
    EXPECT(gloaming_push(lit, 1, 0.0, dims, NULL, 77, a, &error), GLOAMING_UNSUPPORTED);
    EXPECT(gloaming_push(lit, 2, 0.0, dims, NULL, GLOAMING_F32, NULL, &error), GLOAMING_UNSUPPORTED);
    EXPECT(gloaming_push(lit, 3, 0.0, (size_t[]){N, 0, N}, NULL, GLOAMING_F32, a, &error), GLOAMING_UNSUPPORTED);
    EXPECT(gloaming_push(lit, 4, 0.0, (size_t[]){(size_t)1 << 62, 8, 8}, NULL, GLOAMING_F64, a, &error), GLOAMING_UNSUPPORTED);
    gloaming_block block = {.dims = {N, N, N}, .start = {1, 1, 1}, .size = {N, N, N}, .type = GLOAMING_F32};
    EXPECT(gloaming_push_block(lit, 5, 0.0, &block, a, &error), GLOAMING_UNSUPPORTED);

    /* NaN everywhere is no error: there is just nothing to see. */
    for (int i = 0; i < N * N * N; i++) a[i] = NAN;
    EXPECT(gloaming_push(lit, 6, 0.0, dims, NULL, GLOAMING_F32, a, &error), GLOAMING_OK);

    /* Backwards along z: the pointer is at the value with the highest address but one slice. */
    float *b = values();
    EXPECT(gloaming_push(lit, 7, 0.0, dims, (ptrdiff_t[]){1, N, -N * N}, GLOAMING_F32, b + (N - 1) * N * N, &error), GLOAMING_OK);
    free(b);

    /* Memory given away is released once, whether it is taken or not. */
    gloaming_block whole = {.dims = {N, N, N}, .type = GLOAMING_F32}, nothing = {.dims = {N, N, 0}, .type = GLOAMING_F32};
    b = values();
    EXPECT(gloaming_push_owned(lit, 8, 0.0, &whole, b, release, b, &error), GLOAMING_OK);
    b = values();
    EXPECT(gloaming_push_owned(lit, 9, 0.0, &nothing, b, release, b, &error), GLOAMING_UNSUPPORTED);
    b = values();
    EXPECT(gloaming_push_owned(lit, 10, 0.0, NULL, b, release, b, &error), GLOAMING_ARGUMENT);
    EXPECT(gloaming_flush(lit, &error), GLOAMING_OK);
    EXPECT(released, 3);

    /* Another grid from here on. */
    EXPECT(gloaming_push(lit, 11, 0.0, (size_t[]){N, N, N / 2}, NULL, GLOAMING_F32, a, &error), GLOAMING_OK);
    EXPECT(gloaming_flush(lit, &error), GLOAMING_OK);

    pthread_t threads[4];
    for (int t = 0; t < 4; t++) pthread_create(&threads[t], NULL, pusher, lit);
    for (int t = 0; t < 4; t++) pthread_join(threads[t], NULL);

    gloaming_stats stats;
    EXPECT(gloaming_get_stats(lit, NULL, &error), GLOAMING_ARGUMENT);
    EXPECT(gloaming_close(lit, &stats, &error), GLOAMING_OK);
    EXPECT((int)stats.lit, 4 + 1 + 20);
    EXPECT((int)stats.lost, 6);
    EXPECT((int)(stats.pushed - stats.lit - stats.lost - stats.dropped - stats.skipped), 0);

    /* A closed handle is refused, not followed. */
    EXPECT(gloaming_push(lit, 12, 0.0, dims, NULL, GLOAMING_F32, a, &error), GLOAMING_CLOSED);
    b = values();
    EXPECT(gloaming_push_owned(lit, 13, 0.0, &whole, b, release, b, &error), GLOAMING_CLOSED);
    EXPECT(released, 4);
    EXPECT(gloaming_flush(lit, NULL), GLOAMING_CLOSED);
    EXPECT(gloaming_close(lit, NULL, NULL), GLOAMING_CLOSED);
    free(a);
    if (!failed) puts("faults survived");
    return failed;
}
