/* How long each push holds the simulation, against a plain copy of as many bytes made just before it. */
#ifndef HELD_H
#define HELD_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { HELD_MOST = 10000 };
static double held_pushes[HELD_MOST], held_copies[HELD_MOST];
static int held_count;

static double held_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

/* Copies `bytes` from `values` into memory of our own, as a simulation would that hands its outputs on: into one of several
 * buffers in turn, since a destination that still is in the cache from the last copy would take half the time. */
static double held_copy(const void *values, size_t bytes) {
    enum { RING = 8 };
    static void *kept[RING];
    static size_t room;
    static int turn;
    if (room < bytes) {
        for (int i = 0; i < RING; i++) {
            kept[i] = realloc(kept[i], bytes);
            memset(kept[i], 0, bytes);
        }
        room = bytes;
    }
    void *to = kept[turn++ % RING];
    double begun = held_now();
    memcpy(to, values, bytes);
    /* Otherwise the compiler may leave out a copy that nobody reads. */
    __asm__ volatile("" : : "r"(to) : "memory");
    return held_now() - begun;
}

static void held_note(double copy, double push) {
    if (held_count < HELD_MOST) {
        held_copies[held_count] = copy;
        held_pushes[held_count++] = push;
    }
}

static int held_less(const void *a, const void *b) {
    double d = *(const double *)a - *(const double *)b;
    return (d > 0) - (d < 0);
}

static double held_median(double *values, int count) {
    qsort(values, (size_t)count, sizeof *values, held_less);
    return count ? values[count / 2] : 0;
}

/* Medians, the first steps, in which memory is new, left out. */
static void held_report(const char *what) {
    int first = held_count > 8 ? 4 : 0, n = held_count - first;
    double copy = held_median(held_copies + first, n), push = held_median(held_pushes + first, n);
    fprintf(stderr, "%s: held %.3f ms a step, a plain copy %.3f ms, ratio %.3f\n", what, push, copy, copy > 0 ? push / copy : 0);
}

/* Tells results apart to the bit (FNV-1a). */
static uint64_t held_hash(const void *values, size_t bytes) {
    uint64_t hash = 14695981039346656037u;
    for (const unsigned char *at = (const unsigned char *)values; bytes--; at++) hash = (hash ^ *at) * 1099511628211u;
    return hash;
}

#endif
