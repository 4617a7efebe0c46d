/* Saving, restoring and serialising the FMU's state. */
#include <string.h>

#include "instance.h"

typedef struct {
    size_t size;     /* of all, in bytes */
    scalars s;
    double values[]; /* then texts, each with its final zero: the guid and the string variables */
} saved_state;

#define AT_TEXTS (sizeof(saved_state) + (size_t)N_VALUES * sizeof(double)) /* in the bytes of a saved state */

/* A state of this size: the one given if it fits, else a new one in its place. */
static saved_state *room_for_state(instance *m, fmi2FMUstate *state, size_t size)
{
    saved_state *saved = *state;
    if (saved && saved->size == size) return saved;
    release(&m->callbacks, saved);
    *state = saved = allocate(&m->callbacks, 1, size);
    if (saved) saved->size = size;
    return saved;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    instance *m = c;
    if (!m || !state) return fmi2Error;
    size_t size = AT_TEXTS + strlen(model.guid) + 1;
    for (int i = 0; i < model.n_strings; i++) size += strlen(m->strings[i]) + 1;
    saved_state *saved = room_for_state(m, state, size);
    if (!saved) return report(m, fmi2Error, "out of memory");
    saved->s = m->s;
    memcpy(saved->values, m->values, N_VALUES * sizeof(double));
    char *text = (char *)saved + AT_TEXTS;
    strcpy(text, model.guid);
    for (int i = 0; i < model.n_strings; i++) {
        text += strlen(text) + 1;
        strcpy(text, m->strings[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    instance *m = c;
    const saved_state *saved = state;
    if (!m || !saved) return fmi2Error;
    const char *text = (const char *)saved + AT_TEXTS;
    for (int i = 0; i < model.n_strings; i++) {
        text += strlen(text) + 1;
        if (strcmp(text, m->strings[i]) && set_text(m, (size_t)i, text)) return report(m, fmi2Error, "out of memory");
    }
    m->s = saved->s;
    memcpy(m->values, saved->values, N_VALUES * sizeof(double));
    m->outputs_current = 0;
    /* A state from another instance or process: its wind files are not open here yet. */
    return m->s.started ? open_boxes(m) : fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    instance *m = c;
    if (!m || !state) return fmi2Error;
    release(&m->callbacks, *state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    if (!c || !state || !size) return fmi2Error;
    *size = ((saved_state *)state)->size;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (!c || !state || !bytes) return fmi2Error;
    size_t needed = ((saved_state *)state)->size;
    if (size < needed) return report(c, fmi2Error, "fmi2SerializeFMUstate: needs %u bytes", (unsigned)needed);
    memcpy(bytes, state, needed);
    return fmi2OK;
}

static int is_state(const fmi2Byte *bytes, size_t size)
{
    size_t own, guid = strlen(model.guid) + 1;
    int texts = 0;
    if (size < AT_TEXTS + guid || memcmp(bytes + AT_TEXTS, model.guid, guid)) return 0;
    memcpy(&own, bytes, sizeof own);
    for (size_t i = AT_TEXTS; i < size; i++) texts += bytes[i] == 0;
    return own == size && texts == 1 + model.n_strings && bytes[size - 1] == 0;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    instance *m = c;
    if (!m || !bytes || !state) return fmi2Error;
    if (!is_state(bytes, size)) return report(m, fmi2Error, "fmi2DeSerializeFMUstate: %u bytes are no state of this FMU", (unsigned)size);
    if (!room_for_state(m, state, size)) return report(m, fmi2Error, "out of memory");
    memcpy(*state, bytes, size);
    return fmi2OK;
}
