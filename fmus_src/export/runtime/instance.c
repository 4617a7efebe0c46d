/* Creation and release of instances, and their messages. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

int report(instance *m, const char *format, ...)
{
    char text[1024];
    va_list list;
    va_start(list, format);
    vsnprintf(text, sizeof text, format, list);
    va_end(list);
    m->s.mode = FAILED;
    deliver(m, text);
    return 1;
}

/* Zeros; never NULL for want of elements. */
static void *allocate(size_t count, size_t size) { return calloc(count ? count : 1, size); }

static char *copy_text(const char *text)
{
    char *copy = malloc(strlen(text) + 1);
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
    const equation *all[] = {&model.calculate, &model.initial,  &model.derivatives, &model.outputs,
                             &model.update,    &model.switches, &model.forward};
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
    m->iwork = allocate((size_t)iw, sizeof(casadi_int));
    m->work = allocate((size_t)w, sizeof(double));
    m->scratch = allocate(scratch, sizeof(double));
    return !(m->iwork && m->work && m->scratch);
}

/* Give a string variable a value, whose wind box is opened at the next need; 1 if out of memory. */
int set_text(instance *m, size_t i, const char *text)
{
    char *copy = copy_text(text);
    if (!copy) return 1;
    free(m->strings[i]);
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
    m->current = 0;
    for (int i = 0; i < model.n_variables; i++) m->values[i] = model.variables[i].start;
    for (int i = 0; i < model.n_strings; i++)
        if (set_text(m, (size_t)i, model.string_starts[i])) return 1;
    return 0;
}

/* A copy of this FMU that brings files of its own has a longer guid: '+' and a digest of them follow. */
static int is_own(const char *token)
{
    const size_t n = strlen(model.guid);
    return token && !strncmp(token, model.guid, n) && (!token[n] || token[n] == '+');
}

static char *copy_folder(const char *path)
{
    const size_t n = path ? strlen(path) : 0;
    char *copy = allocate(n + 2, 1);
    if (!copy || !n) return copy;
    strcpy(copy, path);
    if (path[n - 1] != '/' && path[n - 1] != '\\') strcpy(copy + n, "/");
    return copy;
}

instance *create(const char *name, const char *token, const char *resources, int model_exchange, void *environment,
                 void (*logger)(void))
{
    instance *m = allocate(1, sizeof *m);
    if (!m) return NULL;
    m->model_exchange = model_exchange;
    m->environment = environment;
    m->logger = logger;
    m->name = copy_text(name && name[0] ? name : model.identifier);
    m->resources = copy_folder(resources);
    m->values = allocate(N_VALUES, sizeof(double));
    m->strings = allocate(model.n_strings, sizeof(char *));
    m->boxes = allocate(model.n_strings, sizeof(wind_box *));
    if (m->name && m->resources && m->values && m->strings && m->boxes && !allocate_work(m) && !restart(m)) {
        if (is_own(token)) return m;
        report(m, "the guid is not this FMU's (%s)", model.guid);
    }
    destroy(m);
    return NULL;
}

void destroy(instance *m)
{
    if (!m) return;
    for (int i = 0; i < model.n_strings; i++) {
        if (m->boxes) wind_box_close(m->boxes[i]);
        if (m->strings) free(m->strings[i]);
    }
    free(m->boxes);
    free(m->strings);
    free(m->values);
    free(m->scratch);
    free(m->work);
    free(m->iwork);
    free(m->resources);
    free(m->name);
    free(m);
}
