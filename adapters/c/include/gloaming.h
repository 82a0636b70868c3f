/* gloaming: physically lit movies of a running simulation.
 *
 *   gloaming_session *lit = gloaming_open(config, NULL);      // the text of a scene file with an [insitu] table
 *   for (...)
 *       gloaming_push(lit, step, time, dims, NULL, GLOAMING_F32, values, NULL);
 *   gloaming_close(lit, NULL, NULL);
 *
 * Rules that hold for every function:
 * - Any thread may call it, several at once too. Steps are lit in the order in which their pushes end.
 * - It returns; it never ends the program, throws, or changes signal handlers or the floating-point environment.
 * - It returns GLOAMING_OK (0), a negative number when a step was left out on purpose (GLOAMING_SKIPPED,
 *   GLOAMING_DROPPED), or a positive code when something failed. `error` may be NULL; else it is filled in.
 * - A session that was not opened (NULL) or has been closed is refused with GLOAMING_CLOSED, so that a simulation may
 *   ignore every failure and run on.
 * - Sessions live in the process that opened the first one. After fork() every function returns GLOAMING_CLOSED to the child
 *   (gloaming_open: NULL) and waits for nothing; the parent goes on. A program that the child executes may open its own.
 *
 * Made by cbindgen from adapters/c/src: do not edit. */

#ifndef GLOAMING_H
#define GLOAMING_H

#include <stddef.h>
#include <stdint.h>

/**
 * uint8_t
 */
#define GLOAMING_U8 1

/**
 * int8_t
 */
#define GLOAMING_I8 2

/**
 * uint16_t
 */
#define GLOAMING_U16 3

/**
 * int16_t
 */
#define GLOAMING_I16 4

/**
 * uint32_t
 */
#define GLOAMING_U32 5

/**
 * int32_t
 */
#define GLOAMING_I32 6

/**
 * uint64_t
 */
#define GLOAMING_U64 7

/**
 * int64_t
 */
#define GLOAMING_I64 8

/**
 * IEEE 754 binary16
 */
#define GLOAMING_F16 9

/**
 * float
 */
#define GLOAMING_F32 10

/**
 * double
 */
#define GLOAMING_F64 11

/**
 * Done.
 */
#define GLOAMING_OK 0

/**
 * No trigger asked for the step: not an error.
 */
#define GLOAMING_SKIPPED -1

/**
 * The queue was full, and the policy dropped the step: counted, and in the ledger.
 */
#define GLOAMING_DROPPED -2

/**
 * The operating system refused: a path, a permission, a full disk.
 */
#define GLOAMING_IO 1

/**
 * A file is not what it should be, or needs a setting.
 */
#define GLOAMING_FORMAT 2

/**
 * The configuration says something impossible: key, line and allowed values are in the message.
 */
#define GLOAMING_SCENE 3

/**
 * Not supported, or a block that cannot be read.
 */
#define GLOAMING_UNSUPPORTED 4

/**
 * Too little memory.
 */
#define GLOAMING_OUT_OF_MEMORY 5

/**
 * The compute device failed or does not exist.
 */
#define GLOAMING_DEVICE 6

/**
 * The session is closed, or was never opened.
 */
#define GLOAMING_CLOSED 7

/**
 * A fault of gloaming's own.
 */
#define GLOAMING_BUG 8

/**
 * A pointer that must not be NULL is, or text is not UTF-8.
 */
#define GLOAMING_ARGUMENT 9

/**
 * An error of a kind that this version has no code for.
 */
#define GLOAMING_OTHER 99

/**
 * An open session.
 */
typedef struct gloaming_session {
    uint8_t _private[0];
} gloaming_session;

/**
 * What went wrong, in the caller's memory.
 */
typedef struct gloaming_error {
    /**
     * As the function returned it.
     */
    int32_t code;
    /**
     * What happened and what to try, UTF-8, ends in 0, cut off where it is longer; empty where nothing went wrong.
     */
    char message[1020];
} gloaming_error;

/**
 * How values lie in memory and in space. Set what is not needed to 0: `gloaming_block b = {.dims = {nx, ny, nz}, .type =
 * GLOAMING_F32};`
 */
typedef struct gloaming_block {
    /**
     * Values along x, y, z, ghost layers included.
     */
    size_t dims[3];
    /**
     * Values (not bytes) between neighbours along x, y, z, from value (0, 0, 0) at the pointer; may be negative. All 0: dense,
     * x fastest.
     */
    ptrdiff_t strides[3];
    /**
     * First value that is shown, after the ghost layers.
     */
    size_t start[3];
    /**
     * Values that are shown along x, y, z. All 0: from `start` to the end.
     */
    size_t size[3];
    /**
     * World length between neighbours. All 0: 1.
     */
    double spacing[3];
    /**
     * World position of value (0, 0, 0), ghost layers included.
     */
    double origin[3];
    /**
     * GLOAMING_F32 and so on.
     */
    int32_t type;
} gloaming_block;

/**
 * What has become of the steps so far: pushed = lit + lost + dropped + skipped + waiting.
 */
typedef struct gloaming_stats {
    /**
     * Steps offered.
     */
    uint64_t pushed;
    /**
     * Steps lit and written, to every output.
     */
    uint64_t lit;
    /**
     * Steps that could not be taken in, lit, or written to some output.
     */
    uint64_t lost;
    /**
     * Steps dropped because the queue was full.
     */
    uint64_t dropped;
    /**
     * Steps that no trigger asked for.
     */
    uint64_t skipped;
    /**
     * Steps waiting, being lit or being written.
     */
    uint64_t waiting;
    /**
     * Bytes copied out of the simulation's memory.
     */
    uint64_t bytes;
    /**
     * Time the simulation was held by pushes, in milliseconds.
     */
    double held_ms;
    /**
     * The longest that one push held it, in milliseconds.
     */
    double longest_held_ms;
} gloaming_stats;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * The version of the library, such as "0.1.0". Lives as long as the program.
 */
const char *gloaming_version(void);

/**
 * Opens a session from `config`, the text of a scene file with an `[insitu]` table (see the README), as UTF-8 that ends in
 * 0. The text is read before this returns. NULL when it fails: `error` tells why, and so does stderr.
 *
 * The caller promises:
 * `config` is NULL or ends in 0; `error` is NULL or points to a gloaming_error.
 */
struct gloaming_session *gloaming_open(const char *config,
                                       struct gloaming_error *error);

/**
 * Opens a session from the scene file at `path`. As gloaming_open.
 *
 * The caller promises:
 * `path` is NULL or ends in 0; `error` is NULL or points to a gloaming_error.
 */
struct gloaming_session *gloaming_open_file(const char *path, struct gloaming_error *error);

/**
 * Hands over a step: `dims` values along x, y, z in memory at `values`, of type `type` (GLOAMING_F32 …), `strides` values
 * apart along x, y, z (NULL: dense, x fastest, as Fortran arrays `a(x, y, z)` and C arrays `a[z][y][x]` are). `time` is the
 * simulation's; NaN where it has none. The values are copied before this returns, as 32-bit floats. It waits only when the
 * queue is full and the policy is "block".
 *
 * The caller promises:
 * `dims` points to 3 numbers; `strides` to 3, or is NULL; all `dims` values can be read at `values`; `error` is NULL or points
 * to a gloaming_error. Nothing is kept.
 */
int32_t gloaming_push(struct gloaming_session *session,
                      uint64_t step,
                      double time,
                      const size_t *dims,
                      const ptrdiff_t *strides,
                      int32_t type,
                      const void *values,
                      struct gloaming_error *error);

/**
 * Hands over a step as gloaming_push does, with ghost layers left out and a place in space: see gloaming_block.
 *
 * The caller promises:
 * `block` points to a gloaming_block; all its `dims` values can be read at `values`; `error` is NULL or points to a
 * gloaming_error. Nothing is kept.
 */
int32_t gloaming_push_block(struct gloaming_session *session,
                            uint64_t step,
                            double time,
                            const struct gloaming_block *block,
                            const void *values,
                            struct gloaming_error *error);

/**
 * Gives a step away: nothing is copied. `values` must stay as they are until `release(user)` is called, exactly once, whatever
 * becomes of the step: from a thread of gloaming's, or from this one before this returns. `release` must not call gloaming,
 * throw or jump; NULL when the memory outlives the session.
 *
 * The caller promises:
 * `block` points to a gloaming_block; all its `dims` values can be read at `values`, from any thread, until the release;
 * `error` is NULL or points to a gloaming_error.
 */
int32_t gloaming_push_owned(struct gloaming_session *session,
                            uint64_t step,
                            double time,
                            const struct gloaming_block *block,
                            void *values,
                            void (*release)(void*),
                            void *user,
                            struct gloaming_error *error);

/**
 * Waits until every step pushed so far is lit and written. Steps that were lost are no failure here: see gloaming_stats.
 *
 * The caller promises:
 * `error` is NULL or points to a gloaming_error.
 */
int32_t gloaming_flush(struct gloaming_session *session,
                       struct gloaming_error *error);

/**
 * Waits until every step pushed so far is lit and written, and keeps their light in the file at `path`: call it where a restart
 * file is written. A run that is restarted from there goes on warm when that is its `insitu.light_state`. The file appears under
 * its name only when it is whole, in the place of an earlier one.
 *
 * The caller promises:
 * `path` is NULL or ends in 0; `error` is NULL or points to a gloaming_error.
 */
int32_t gloaming_save_light(struct gloaming_session *session,
                            const char *path,
                            struct gloaming_error *error);

/**
 * Tells what has become of the steps so far.
 *
 * The caller promises:
 * `stats` points to a gloaming_stats; `error` is NULL or points to a gloaming_error.
 */
int32_t gloaming_get_stats(struct gloaming_session *session,
                           struct gloaming_stats *stats,
                           struct gloaming_error *error);

/**
 * Lights what is still waiting, closes every file and ends the threads. `stats`, unless it is NULL, receives the final
 * figures, also when this fails because a file could not be closed. The session is gone afterwards, whatever this returns.
 *
 * The caller promises:
 * `stats` is NULL or points to a gloaming_stats; `error` is NULL or points to a gloaming_error.
 */
int32_t gloaming_close(struct gloaming_session *session,
                       struct gloaming_stats *stats,
                       struct gloaming_error *error);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* GLOAMING_H */
