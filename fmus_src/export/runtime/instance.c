/* Creation and release of instances, and their messages. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

static const char *const CATEGORY_ERROR = "logStatusError";

fmi2Status report(instance *m, fmi2Status status, const char *format, ...)
{
    char text[1024];
    va_list list;
    va_start(list, format);
    vsnprintf(text, sizeof text, format, list);
    va_end(list);
    if (status >= fmi2Error) m->s.mode = FAILED;
    if (!m->callbacks.logger) return status;
    /* The text itself is the format, since many importers do not expand arguments; so percent signs are doubled. */
    char escaped[2 * sizeof text], *to = escaped;
    for (const char *from = text; *from; from++) {
        if (*from == '%') *to++ = '%';
        *to++ = *from;
    }
    *to = 0;
    m->callbacks.logger(m->callbacks.componentEnvironment, m->name, status, CATEGORY_ERROR, escaped);
    return status;
}

void *allocate(const fmi2CallbackFunctions *c, size_t count, size_t size)
{
    if (count == 0) count = 1;
    return c && c->allocateMemory && c->freeMemory ? c->allocateMemory(count, size) : calloc(count, size);
}

void release(const fmi2CallbackFunctions *c, void *memory)
{
    if (!memory) return;
    if (c && c->allocateMemory && c->freeMemory) c->freeMemory(memory);
    else free(memory);
}

static char *copy_text(const fmi2CallbackFunctions *c, const char *text)
{
    char *copy = allocate(c, strlen(text) + 1, 1);
    if (copy) strcpy(copy, text);
    return copy;
}

static void largest(casadi_int *iw, casadi_int *w, const equation *e)
{
    casadi_int sizes[4] = {0};
    if (!e->work) return;
    e->work(&sizes[0], &sizes[1], &sizes[2], &sizes[3]);
    if (sizes[2] > *iw) *iw = sizes[2];
    if (sizes[3] > *w) *w = sizes[3];
}

static int allocate_work(instance *m)
{
    casadi_int iw = 1, w = 1;
    const equation *all[] = {&model.calculate, &model.initial, &model.derivatives, &model.outputs, &model.update, &model.switches,
                             &model.forward};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) largest(&iw, &w, all[i]);
    for (int i = 0; i < model.n_lookups; i++) {
        largest(&iw, &w, &model.lookups[i].argument);
        largest(&iw, &w, &model.lookups[i].argument_forward);
        if (model.lookups[i].kind != IMPLICIT) continue;
        const implicit_data *d = model.lookups[i].data;
        largest(&iw, &w, &d->system);
        largest(&iw, &w, &d->guess);
    }
    size_t scratch = N_STEPPING > N_DIRECTION ? N_STEPPING : N_DIRECTION;
    m->iwork = allocate(&m->callbacks, (size_t)iw, sizeof(casadi_int));
    m->work = allocate(&m->callbacks, (size_t)w, sizeof(double));
    m->scratch = allocate(&m->callbacks, scratch, sizeof(double));
    return !(m->iwork && m->work && m->scratch);
}

/* Give a string variable a value, whose wind box is opened at the next need; 1 if out of memory. */
int set_text(instance *m, size_t i, const char *text)
{
    char *copy = copy_text(&m->callbacks, text);
    if (!copy) return 1;
    release(&m->callbacks, m->strings[i]);
    m->strings[i] = copy;
    wind_box_close(m->boxes[i]);
    m->boxes[i] = NULL;
    return 0;
}

int restart(instance *m)
{
    memset(&m->s, 0, sizeof m->s);
    m->s.stop = HUGE_VAL;
    memset(m->values, 0, N_VALUES * sizeof(double));
    m->outputs_current = 0;
    for (int i = 0; i < model.n_variables; i++) m->values[i] = model.variables[i].start;
    for (int i = 0; i < model.n_strings; i++)
        if (set_text(m, (size_t)i, model.string_starts[i])) return 1;
    return 0;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources;
    (void)visible;
    instance *m = allocate(callbacks, 1, sizeof *m);
    if (!m) return NULL;
    if (callbacks) m->callbacks = *callbacks;
    m->logging = logging;
    m->name = copy_text(callbacks, name && name[0] ? name : model.identifier);
    m->values = allocate(callbacks, N_VALUES, sizeof(double));
    m->strings = allocate(callbacks, model.n_strings, sizeof(char *));
    m->boxes = allocate(callbacks, model.n_strings, sizeof(wind_box *));
    if (m->name && m->values && m->strings && m->boxes && !allocate_work(m) && !restart(m)) {
        if (type != fmi2CoSimulation) report(m, fmi2Error, "only co-simulation is provided");
        else if (!guid || strcmp(guid, model.guid)) report(m, fmi2Error, "the guid is not this FMU's (%s)", model.guid);
        else return m;
    }
    fmi2FreeInstance(m);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    instance *m = c;
    if (!m) return;
    const fmi2CallbackFunctions copy = m->callbacks, *callbacks = &copy;
    for (int i = 0; i < model.n_strings; i++) {
        if (m->boxes) wind_box_close(m->boxes[i]);
        if (m->strings) release(callbacks, m->strings[i]);
    }
    release(callbacks, m->boxes);
    release(callbacks, m->strings);
    release(callbacks, m->values);
    release(callbacks, m->scratch);
    release(callbacks, m->work);
    release(callbacks, m->iwork);
    release(callbacks, m->name);
    release(callbacks, m);
}
