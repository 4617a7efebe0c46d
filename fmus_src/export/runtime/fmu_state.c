/* Saving, restoring and serialising the FMU's state. */
#include <stdlib.h>
#include <string.h>

#include "instance.h"

typedef struct {
    size_t size;     /* of all, in bytes */
    long long model_exchange;
    scalars s;
    double values[]; /* then texts, each with its final zero: the guid and the string variables */
} saved_state;

#define AT_TEXTS (sizeof(saved_state) + (size_t)N_VALUES * sizeof(double)) /* in the bytes of a saved state */

/* A state of this size: the one given if it fits, else a new one in its place. */
static saved_state *room_for_state(instance *m, void **state, size_t size)
{
    saved_state *saved = *state;
    if (saved && saved->size == size) return saved;
    free(saved);
    *state = saved = calloc(1, size);
    if (saved) saved->size = size;
    return saved;
}

int get_state(instance *m, void **state)
{
    size_t size = AT_TEXTS + strlen(model.guid) + 1;
    for (int i = 0; i < model.n_strings; i++) size += strlen(m->strings[i]) + 1;
    saved_state *saved = room_for_state(m, state, size);
    if (!saved) return report(m, "out of memory");
    saved->s = m->s;
    saved->model_exchange = m->model_exchange;
    memcpy(saved->values, m->values, N_VALUES * sizeof(double));
    char *text = (char *)saved + AT_TEXTS;
    strcpy(text, model.guid);
    for (int i = 0; i < model.n_strings; i++) {
        text += strlen(text) + 1;
        strcpy(text, m->strings[i]);
    }
    return 0;
}

int set_state(instance *m, const void *state)
{
    const saved_state *saved = state;
    const char *text = (const char *)saved + AT_TEXTS;
    if (saved->model_exchange != m->model_exchange)
        return report(m, "the saved state is one of %s, this instance is not",
                      saved->model_exchange ? "model exchange" : "co-simulation");
    for (int i = 0; i < model.n_strings; i++) {
        text += strlen(text) + 1;
        if (strcmp(text, m->strings[i]) && set_text(m, (size_t)i, text)) return report(m, "out of memory");
    }
    m->s = saved->s;
    memcpy(m->values, saved->values, N_VALUES * sizeof(double));
    m->current = 0;
    /* A state from another instance or process: its wind files are not open here yet. */
    return m->s.started ? open_boxes(m) : 0;
}

void free_state(instance *m, void **state)
{
    free(*state);
    *state = NULL;
}

size_t state_size(const void *state) { return ((const saved_state *)state)->size; }

int write_state(instance *m, const void *state, void *bytes, size_t size)
{
    const size_t needed = state_size(state);
    if (size < needed) return report(m, "a serialised state needs %u bytes", (unsigned)needed);
    memcpy(bytes, state, needed);
    return 0;
}

static int is_state(const char *bytes, size_t size)
{
    size_t own, guid = strlen(model.guid) + 1;
    int texts = 0;
    if (size < AT_TEXTS + guid || memcmp(bytes + AT_TEXTS, model.guid, guid)) return 0;
    memcpy(&own, bytes, sizeof own);
    for (size_t i = AT_TEXTS; i < size; i++) texts += bytes[i] == 0;
    return own == size && texts == 1 + model.n_strings && bytes[size - 1] == 0;
}

int read_state(instance *m, const char *function, const void *bytes, size_t size, void **state)
{
    if (!is_state(bytes, size)) return report(m, "%s: %u bytes are no state of this FMU", function, (unsigned)size);
    if (!room_for_state(m, state, size)) return report(m, "out of memory");
    memcpy(*state, bytes, size);
    return 0;
}
