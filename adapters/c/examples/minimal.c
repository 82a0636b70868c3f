#include <math.h>
#include <stdlib.h>

#include "gloaming.h"

#define N 64

int main(void) {
    gloaming_session *lit = gloaming_open("field.range = [0.0, 1.0]\n"
                                          "[insitu]\n"
                                          "outputs = ['movie.mp4']\n"
                                          "ledger = 'ledger.csv'\n", NULL);
    float *a = malloc(N * N * N * sizeof *a);
    for (int step = 0; step < 48; step++) {
        for (int i = 0; i < N * N * N; i++) {       /* a ball that swings; the simulation's work */
            float x = i % N - 32 - 12 * sinf(0.2f * step), y = i / N % N - 32, z = i / (N * N) - 32;
            a[i] = expf(-(x * x + y * y + z * z) / 128);
        }
        gloaming_push(lit, step, 0.1 * step, (size_t[]){N, N, N}, NULL, GLOAMING_F32, a, NULL);
    }
    free(a);
    return gloaming_close(lit, NULL, NULL);
}
