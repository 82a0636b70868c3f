/* An instrumented simulation: a time loop that hands its grid to Catalyst in the way that SCENARIO says, and prints the status
 * of every call.
 *
 * usage: solver LIBCATALYST global|local SCENARIO [SCRIPT [ARG]]
 *
 * LIBCATALYST is a stand-in or the real library; `local` loads it without showing its names to other libraries, as Python does.
 * The value at vertex (i, j, k) in step n is 1/(1 + x² + y² + z²), x = (i − 6 − n)/4, y = (j − 5)/4, z = (k − 4)/4: only
 * operations that IEEE 754 rounds the same everywhere. */
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

typedef struct node node;

static void *library;

static void *function(const char *name) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "solver: %s\n", dlerror());
        exit(9);
    }
    return found;
}

static node *create(void) { return ((node * (*)(void)) function("catalyst_conduit_node_create"))(); }
static void destroy(node *n) { ((void (*)(node *))function("catalyst_conduit_node_destroy"))(n); }
static node *fetch(node *n, const char *path) { return ((node * (*)(node *, const char *)) function("catalyst_conduit_node_fetch"))(n, path); }
static node *append(node *n) { return ((node * (*)(node *)) function("catalyst_conduit_node_append"))(n); }
static int has(node *n, const char *path) { return ((int (*)(node *, const char *))function("catalyst_conduit_node_has_path"))(n, path); }
static int64_t as_int64(node *n, const char *path) {
    return ((int64_t(*)(node *, const char *))function("catalyst_conduit_node_fetch_path_as_int64"))(n, path);
}
static const char *as_text(node *n) { return ((char *(*)(node *))function("catalyst_conduit_node_as_char8_str"))(n); }
static void item(node *n, const char *text) { ((void (*)(node *, const char *))function("catalyst_conduit_node_set_char8_str"))(n, text); }
static void text(node *n, const char *path, const char *value) {
    ((void (*)(node *, const char *, const char *))function("catalyst_conduit_node_set_path_char8_str"))(n, path, value);
}
static void integer(node *n, const char *path, int64_t value) {
    ((void (*)(node *, const char *, int64_t))function("catalyst_conduit_node_set_path_int64"))(n, path, value);
}
static void small_integer(node *n, const char *path, int32_t value) {
    ((void (*)(node *, const char *, int32_t))function("catalyst_conduit_node_set_path_int32"))(n, path, value);
}
static void number(node *n, const char *path, double value) {
    ((void (*)(node *, const char *, double))function("catalyst_conduit_node_set_path_float64"))(n, path, value);
}
static void lend(node *n, const char *path, const char *type, void *data, int64_t count, int64_t offset, int64_t stride, int64_t bytes) {
    char name[99];
    snprintf(name, sizeof name, "catalyst_conduit_node_set_path_external_%s_ptr_detailed", type);
    ((void (*)(node *, const char *, void *, int64_t, int64_t, int64_t, int64_t, int64_t))function(name))(n, path, data, count, offset,
                                                                                                         stride, bytes, 0);
}
static int call(const char *name, node *n) {
    int status = ((int (*)(node *))function(name))(n);
    printf("%s %d\n", name, status);
    return status;
}

enum { NX = 12, NY = 10, NZ = 8, COUNT = NX * NY * NZ, STEPS = 3 };

static double value(int i, int j, int k, int n) {
    double x = (i - 6 - n) / 4.0, y = (j - 5) / 4.0, z = (k - 4) / 4.0;
    return 1.0 / (1.0 + x * x + y * y + z * z);
}

/* Room for values of any type and stride, wiped after every step. They end where the memory ends: reading on ends the process. */
enum { ROOM = 1 << 16 };
static char *memory, *end_of_memory;

static void make_room(void) {
    char *room = mmap(NULL, 2 * ROOM, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (room == MAP_FAILED || mprotect(room + ROOM, ROOM, PROT_NONE)) exit(9);
    end_of_memory = room + ROOM;
}

static unsigned char ghosts[COUNT];

static void put(const char *type, char *at, double v) {
    if (!strcmp(type, "float64")) memcpy(at, &v, 8);
    else if (!strcmp(type, "float32")) memcpy(at, &(float){v}, 4);
    else if (!strcmp(type, "int16")) memcpy(at, &(int16_t){v * 1000}, 2);
    else memcpy(at, &(uint8_t){v * 255}, 1);
}

static int scenario(const char *wanted, const char *name) { return !strcmp(wanted, name); }

/* One channel with a uniform mesh and one field. */
static void channel(node *root, const char *name, const char *wanted, int n) {
    char path[256];
    node *here, *data;
    snprintf(path, sizeof path, "catalyst/channels/%s", name);
    here = fetch(root, path);
    text(here, "type", scenario(wanted, "multimesh") ? "multimesh" : scenario(wanted, "amr") ? "amrmesh" : "mesh");
    data = fetch(here, "data");
    int element = scenario(wanted, "element");
    text(data, "coordsets/coords/type", scenario(wanted, "rectilinear") ? "rectilinear" : "uniform");
    small_integer(data, "coordsets/coords/dims/i", NX + element);
    if (scenario(wanted, "text_dims")) text(data, "coordsets/coords/dims/j", "ten");
    else if (!scenario(wanted, "no_dims")) integer(data, "coordsets/coords/dims/j", NY + element);
    if (scenario(wanted, "negative_dims")) integer(data, "coordsets/coords/dims/k", -NZ);
    else number(data, "coordsets/coords/dims/k", NZ + element);
    if (element) {
        number(data, "coordsets/coords/origin/x", -3.0);
        number(data, "coordsets/coords/origin/y", 0.5);
        integer(data, "coordsets/coords/origin/z", 2);
        number(data, "coordsets/coords/spacing/dx", 0.5);
        number(data, "coordsets/coords/spacing/dy", 0.25);
    }
    text(data, "topologies/mesh/type", "uniform");
    text(data, "topologies/mesh/coordset", "coords");
    if (scenario(wanted, "no_field")) return;
    const char *type = scenario(wanted, "int16") ? "int16" : scenario(wanted, "uint8") ? "uint8" : element ? "float32" : "float64";
    int64_t bytes = *type == 'f' ? atoi(type + 5) / 8 : scenario(type, "int16") ? 2 : 1;
    /* Interleaved with others, as a particle-like struct has it; packed, so that nothing is aligned. */
    int64_t offset = scenario(wanted, "strided") ? 8 : scenario(wanted, "packed") ? 5 : 0;
    int64_t stride = scenario(wanted, "strided") ? 24 : scenario(wanted, "packed") ? 13 : bytes;
    int frame = scenario(wanted, "ghosts"), count = COUNT - scenario(wanted, "short");
    memory = end_of_memory - (offset + (count - 1) * stride + bytes);
    for (int k = 0, at = 0; k < NZ; k++)
        for (int j = 0; j < NY; j++)
            for (int i = 0; i < NX; i++, at++) {
                /* A ghost layer round the block, with values that would show; one ghost inside is a hole. */
                int outside = i < 2 || i >= NX - 1 || j < 1 || k >= NZ - 2;
                int inside = i == 6 && j == 5 && k == 4;
                ghosts[at] = frame && (outside || inside);
                if (at < count) put(type, memory + offset + at * stride, ghosts[at] ? 99.0 : value(i, j, k, n));
            }
    text(data, "fields/density/association", element ? "element" : "vertex");
    text(data, "fields/density/topology", scenario(wanted, "no_topology") ? "elsewhere" : "mesh");
    if (scenario(wanted, "text_values")) text(data, "fields/density/values", "none");
    else if (!scenario(wanted, "no_values"))
        lend(data, "fields/density/values", type, memory, count, offset, stride, bytes);
    if (frame && n % 2) {
        text(data, "fields/ascent_ghosts/association", "vertex");
        text(data, "fields/ascent_ghosts/topology", "mesh");
        lend(data, "fields/ascent_ghosts/values", "uint8", ghosts, COUNT, 0, 1, 1);
    } else if (frame) {
        text(data, "fields/vtkGhostType/association", "vertex");
        text(data, "fields/vtkGhostType/topology", "mesh");
        lend(data, "fields/vtkGhostType/values", "uint8", ghosts, COUNT, 0, 1, 1);
        text(data, "state/metadata/vtk_fields/vtkGhostType/attribute_type", "Ghosts");
    }
    if (scenario(wanted, "two_fields")) {
        text(data, "fields/pressure/association", "vertex");
        text(data, "fields/pressure/topology", "mesh");
        lend(data, "fields/pressure/values", type, memory, COUNT, offset, stride, bytes);
    }
}

static void step(const char *wanted, int number_of_step) {
    node *root = create();
    if (!scenario(wanted, "no_state")) {
        integer(root, scenario(wanted, "cycle") ? "catalyst/state/cycle" : "catalyst/state/timestep", 10 * number_of_step);
        number(root, "catalyst/state/time", 0.5 * number_of_step);
    }
    if (scenario(wanted, "listed")) item(append(fetch(root, "catalyst/channels")), "mesh");
    else if (!scenario(wanted, "no_channels")) channel(root, "grid", wanted, number_of_step);
    if (scenario(wanted, "two_channels")) channel(root, "other", wanted, number_of_step);
    /* Where it would write a restart file. */
    if (scenario(wanted, "checkpoint") && number_of_step == 1) text(root, "catalyst/gloaming/save_light", getenv("LIGHT"));
    if (scenario(wanted, "checkpoint") && number_of_step == 2) integer(root, "catalyst/gloaming/save_light", 7);
    call("catalyst_execute", scenario(wanted, "null") ? NULL : root);
    destroy(root);
    memset(end_of_memory - ROOM, 0xff, ROOM);
}

int main(int argc, char **argv) {
    static const char *faults[] = {"no_channels", "listed",      "multimesh",   "amr",   "rectilinear", "no_dims",  "text_dims",  "negative_dims",
                                   "no_field",    "no_topology", "text_values", "short", "no_values",   "two_fields", "two_channels", "null"};
    if (argc < 4) return 9;
    setvbuf(stdout, NULL, _IOLBF, 0);
    library = dlopen(argv[1], RTLD_NOW | (scenario(argv[2], "global") ? RTLD_GLOBAL : RTLD_LOCAL));
    if (!library) {
        fprintf(stderr, "solver: %s\n", dlerror());
        return 9;
    }
    make_room();
    const char *wanted = argv[3];
    node *root = create();
    integer(root, "catalyst/mpi_comm", 0);
    if (argc > 5) {
        text(root, "catalyst/scripts/movie/filename", argv[4]);
        item(append(fetch(root, "catalyst/scripts/movie/args")), argv[5]);
    } else if (argc > 4) {
        text(root, "catalyst/scripts/movie", argv[4]);
    }
    call("catalyst_initialize", root);
    if (scenario(wanted, "twice")) call("catalyst_initialize", root);
    destroy(root);

    int steps = STEPS;
    if (scenario(wanted, "faults"))
        for (steps = 0; steps < (int)(sizeof faults / sizeof *faults); steps++) {
            printf("%s: ", faults[steps]);
            step(faults[steps], 100 + steps);
            step("vertex", steps);
        }
    else
        for (int n = 0; n < steps; n++) step(wanted, n);

    root = create();
    call("catalyst_results", root);
    if (has(root, "catalyst/gloaming/steps")) {
        int64_t lit = as_int64(root, "catalyst/gloaming/steps");
        printf("pushed %s\n", lit > 0 ? "some" : "none");
    }
    if (has(root, "catalyst/gloaming/error")) printf("error %s\n", as_text(fetch(root, "catalyst/gloaming/error")));
    destroy(root);
    root = create();
    call("catalyst_about", root);
    if (has(root, "catalyst/implementation")) printf("implementation %s\n", as_text(fetch(root, "catalyst/implementation")));
    destroy(root);
    root = create();
    call("catalyst_finalize", root);
    if (scenario(wanted, "twice")) call("catalyst_finalize", root);
    destroy(root);
    printf("simulated %d steps\n", steps);
    return 0;
}
