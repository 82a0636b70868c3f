/* A stand-in for Catalyst's library, so that the tests need none: the functions on Conduit nodes that a simulation and an
 * implementation use, over a tree of its own, and the loader of implementations.
 *
 * Where the real library throws a C++ exception (a missing path, a value of another type, a child past the last), this one
 * ends the process: a test notices either way. */
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { EMPTY, OBJECT, LIST, INT8, INT16, INT32, INT64, UINT8, UINT16, UINT32, UINT64, FLOAT32, FLOAT64, STRING };

typedef struct type {
    int64_t id, count, offset, stride, bytes;
} type;

typedef struct node {
    char *name;
    type dtype;
    void *data;
    int owned;
    struct node **children;
    int64_t child_count;
} node;

static void thrown(const char *what, const char *about) {
    fprintf(stderr, "libcatalyst: an exception would leave here: %s: %s\n", what, about ? about : "");
    abort();
}

node *catalyst_conduit_node_create(void) { return calloc(1, sizeof(node)); }

static void clear(node *n) {
    for (int64_t i = 0; i < n->child_count; i++) {
        clear(n->children[i]);
        free(n->children[i]->name);
        free(n->children[i]);
    }
    free(n->children);
    if (n->owned) {
        /* What an implementation keeps of it must not pass for values. */
        memset(n->data, 0xff, n->dtype.count * n->dtype.bytes);
        free(n->data);
    }
    char *name = n->name;
    memset(n, 0, sizeof *n);
    n->name = name;
}

void catalyst_conduit_node_destroy(node *n) {
    clear(n);
    free(n->name);
    free(n);
}

static node *child_named(const node *n, const char *name, size_t length) {
    for (int64_t i = 0; n->dtype.id == OBJECT && i < n->child_count; i++)
        if (strlen(n->children[i]->name) == length && !memcmp(n->children[i]->name, name, length)) return n->children[i];
    return NULL;
}

static node *find(const node *n, const char *path) {
    while (n) {
        size_t length = strcspn(path, "/");
        n = child_named(n, path, length);
        if (!path[length]) return (node *)n;
        path += length + 1;
    }
    return NULL;
}

static node *append(node *n, char *name, int64_t id) {
    if (n->dtype.id != id) clear(n);
    n->dtype.id = id;
    n->children = realloc(n->children, (n->child_count + 1) * sizeof *n->children);
    node *child = catalyst_conduit_node_create();
    child->name = name;
    n->children[n->child_count++] = child;
    return child;
}

node *catalyst_conduit_node_fetch(node *n, const char *path) {
    for (;;) {
        size_t length = strcspn(path, "/");
        node *child = child_named(n, path, length);
        n = child ? child : append(n, strndup(path, length), OBJECT);
        if (!path[length]) return n;
        path += length + 1;
    }
}

node *catalyst_conduit_node_append(node *n) { return append(n, strdup(""), LIST); }

int catalyst_conduit_node_has_path(const node *n, const char *path) { return find(n, path) != NULL; }

node *catalyst_conduit_node_fetch_existing(node *n, const char *path) {
    node *found = find(n, path);
    if (!found) thrown("no such path", path);
    return found;
}

int64_t catalyst_conduit_node_number_of_children(node *n) { return n->child_count; }

node *catalyst_conduit_node_child(node *n, int64_t index) {
    if (index < 0 || index >= n->child_count) thrown("no such child", n->name);
    return n->children[index];
}

char *catalyst_conduit_node_name(const node *n) { return strdup(n->name ? n->name : ""); }

const type *catalyst_conduit_node_dtype(const node *n) { return &n->dtype; }

void *catalyst_conduit_node_element_ptr(node *n, int64_t index) {
    if (n->dtype.id < INT8) thrown("no elements", n->name);
    if (index < 0 || index >= n->dtype.count) thrown("no such element", n->name);
    return (char *)n->data + n->dtype.offset + index * n->dtype.stride;
}

char *catalyst_conduit_node_as_char8_str(node *n) {
    if (n->dtype.id != STRING) thrown("not a string", n->name);
    return n->data;
}

int64_t catalyst_conduit_datatype_id(const type *t) { return t->id; }
int64_t catalyst_conduit_datatype_number_of_elements(const type *t) { return t->count; }
int64_t catalyst_conduit_datatype_offset(const type *t) { return t->offset; }
int64_t catalyst_conduit_datatype_stride(const type *t) { return t->stride; }
int64_t catalyst_conduit_datatype_element_bytes(const type *t) { return t->bytes; }

static void own(node *n, int64_t id, const void *data, int64_t count, int64_t bytes) {
    clear(n);
    n->dtype = (type){id, count, 0, bytes, bytes};
    n->data = memcpy(malloc(count * bytes), data, count * bytes);
    n->owned = 1;
}

static void lend(node *n, int64_t id, void *data, int64_t count, int64_t offset, int64_t stride, int64_t bytes) {
    clear(n);
    n->dtype = (type){id, count, offset, stride, bytes};
    n->data = data;
}

void catalyst_conduit_node_set_char8_str(node *n, const char *text) { own(n, STRING, text, strlen(text) + 1, 1); }
void catalyst_conduit_node_set_path_char8_str(node *n, const char *path, const char *text) {
    catalyst_conduit_node_set_char8_str(catalyst_conduit_node_fetch(n, path), text);
}

#define NUMBERS(NAME, TYPE, ID)                                                                                                \
    void catalyst_conduit_node_set_path_##NAME(node *n, const char *path, TYPE value) {                                        \
        own(catalyst_conduit_node_fetch(n, path), ID, &value, 1, sizeof value);                                                \
    }                                                                                                                          \
    void catalyst_conduit_node_set_path_external_##NAME##_ptr_detailed(node *n, const char *path, TYPE *data, int64_t count,   \
                                                                       int64_t offset, int64_t stride, int64_t bytes,          \
                                                                       int64_t endianness) {                                   \
        (void)endianness;                                                                                                      \
        lend(catalyst_conduit_node_fetch(n, path), ID, data, count, offset, stride, bytes);                                    \
    }

NUMBERS(int16, int16_t, INT16)
NUMBERS(int32, int32_t, INT32)
NUMBERS(int64, int64_t, INT64)
NUMBERS(uint8, uint8_t, UINT8)
NUMBERS(float32, float, FLOAT32)
NUMBERS(float64, double, FLOAT64)

int64_t catalyst_conduit_node_fetch_path_as_int64(node *n, const char *path) {
    node *found = catalyst_conduit_node_fetch_existing(n, path);
    if (found->dtype.id != INT64) thrown("not an int64", path);
    return *(int64_t *)catalyst_conduit_node_element_ptr(found, 0);
}

/* The loader. */

struct implementation {
    int version;
    int (*initialize)(const node *);
    int (*execute)(const node *);
    int (*finalize)(const node *);
    int (*about)(node *);
    int (*results)(node *);
};

static struct implementation *loaded;

int catalyst_initialize(const node *params) {
    const char *name = getenv("CATALYST_IMPLEMENTATION_NAME"), *folder = getenv("CATALYST_IMPLEMENTATION_PATHS");
    char path[4096];
    if (!name || !folder) return 1;
    if (!loaded) {
        snprintf(path, sizeof path, "%s/libcatalyst-%s.so", folder, name);
        void *library = dlopen(path, RTLD_LAZY | RTLD_GLOBAL);
        if (!library) {
            fprintf(stderr, "libcatalyst: %s\n", dlerror());
            return 3;
        }
        loaded = dlsym(library, "catalyst_api_impl");
        if (!loaded) return 4;
        if (!loaded->initialize || !loaded->execute || !loaded->finalize || !loaded->about || !loaded->results) return 5;
        if (loaded->version != 1) return 6;
    }
    return loaded->initialize(params);
}

int catalyst_execute(const node *params) { return loaded ? loaded->execute(params) : 1; }
int catalyst_finalize(const node *params) { return loaded ? loaded->finalize(params) : 1; }
int catalyst_about(node *params) { return loaded ? loaded->about(params) : 1; }
int catalyst_results(node *params) { return loaded ? loaded->results(params) : 1; }
