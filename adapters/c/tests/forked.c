/* A child of fork() has no threads but its own: every call there returns, with a code, and the parent goes on. Prints "fork survived"
 * and ends with 0. */
#include <stdio.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <unistd.h>

#include "gloaming.h"

#define N 8

static int child(gloaming_session *lit, const float *a, const char *config) {
    const size_t dims[3] = {N, N, N};
    gloaming_error error;
    gloaming_stats stats;
    alarm(20); /* ends what hangs */
    if (gloaming_push(lit, 1, 0.0, dims, NULL, GLOAMING_F32, a, &error) != GLOAMING_CLOSED) return 1;
    fprintf(stderr, "%s\n", error.message);
    if (gloaming_flush(lit, &error) != GLOAMING_CLOSED) return 2;
    if (gloaming_get_stats(lit, &stats, &error) != GLOAMING_CLOSED) return 3;
    if (gloaming_save_light(lit, "light.h5", &error) != GLOAMING_CLOSED) return 4;
    if (gloaming_open_file(config, &error) || error.code != GLOAMING_CLOSED) return 5;
    if (gloaming_close(lit, &stats, &error) != GLOAMING_CLOSED) return 6;
    return 7;
}

int main(int argc, char **argv) {
    const size_t dims[3] = {N, N, N};
    gloaming_error error;
    if (argc < 3) return 2;
    float *a = calloc(N * N * N, sizeof *a);
    gloaming_session *lit = gloaming_open_file(argv[1], &error);
    if (!lit) return 1;
    /* Also while a step is being lit, when locks may be held. */
    for (int step = 0; step < 4; step++) {
        if (gloaming_push(lit, step, 0.0, dims, NULL, GLOAMING_F32, a, &error) != GLOAMING_OK) return 1;
        pid_t forked = fork();
        if (!forked) _exit(child(lit, a, argv[1]));
        int status;
        if (waitpid(forked, &status, 0) != forked || !WIFEXITED(status) || WEXITSTATUS(status) != 7) {
            fprintf(stderr, "step %d: the child ended with %x\n", step, status);
            return 1;
        }
    }
    if (gloaming_save_light(lit, argv[2], &error) != GLOAMING_OK) {
        fprintf(stderr, "%s\n", error.message);
        return 1;
    }
    if (gloaming_save_light(lit, NULL, &error) != GLOAMING_ARGUMENT) return 1;
    free(a);
    gloaming_stats stats;
    if (gloaming_close(lit, &stats, &error) != GLOAMING_OK || stats.lit != 4) return 1;
    puts("fork survived");
    return 0;
}
