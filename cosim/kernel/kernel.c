/* The stepping loop of the co-simulation master: flat arrays in, FMI 2.0 calls out, no Python in between.
 *
 * One double per value read from a component (y), whatever its FMI type. `Member`s are in stepping order. For a step
 * from t_n to t_n+1, `now` holds y_n, `before` y_n-1 and `next` y_n+1 (of the members already advanced).
 */
#if !defined(_WIN32)
#define _POSIX_C_SOURCE 200809L
#endif
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#include <windows.h>
#define EXPORT __declspec(dllexport)
#else
#include <time.h>
#define EXPORT __attribute__((visibility("default")))
#endif
#include "fmi2FunctionTypes.h"

enum { REALS, INTEGERS, BOOLEANS, TYPES };
enum { HELD, HELD_NEXT, EXTRAPOLATED, INTERPOLATED };
enum { OK, SET_FAILED, SLOPE_FAILED, STEP_FAILED, GET_FAILED, NOT_FINITE };
enum { LOG_LINES = 8, LOG_LENGTH = 400, TIMED_EVERY = 5 };

typedef struct {
    int32_t count;
    int32_t status[LOG_LINES];
    char text[LOG_LINES][LOG_LENGTH];
} Log;

typedef struct {
    fmi2Component instance;
    fmi2SetRealTYPE *set_real;
    fmi2SetIntegerTYPE *set_integer;
    fmi2SetBooleanTYPE *set_boolean;
    fmi2GetRealTYPE *get_real;
    fmi2GetIntegerTYPE *get_integer;
    fmi2GetBooleanTYPE *get_boolean;
    fmi2SetRealInputDerivativesTYPE *set_slopes; /* NULL: the FMU holds its inputs over a step */
    fmi2DoStepTYPE *do_step;
    int32_t first_read, first_input;
    int32_t reads[TYPES], inputs[TYPES]; /* counts; stored in this order of types */
    double seconds;                      /* measured in every TIMED_EVERY-th step */
} Member;

typedef struct {
    Member *members;
    int32_t n_members, n_values;
    double *before, *now, *next;
    const uint32_t *read_reference;
    const double *limit; /* |y| beyond this counts as an explosion */
    const uint32_t *input_reference;
    const int32_t *source, *mode;
    const double *factor, *offset; /* input = factor * y[source] + offset */
    double *value, *slope;         /* work: one per input */
    int32_t *integers, *orders;    /* work: as long as the longest list; orders are all one */
    const int32_t *channel;
    const double *channel_factor, *channel_offset;
    double *rows; /* (rows_used, 1 + n_channels): time, channels */
    int32_t n_channels, rows_used;
    double start, step;
    int64_t steps_done, decimation;
    int32_t cause, failed_member, failed_value, status;
    double failed_number;
} Plan;

static double seconds_now(void)
{
#if defined(_WIN32)
    LARGE_INTEGER ticks, frequency;
    QueryPerformanceCounter(&ticks);
    QueryPerformanceFrequency(&frequency);
    return (double)ticks.QuadPart / (double)frequency.QuadPart;
#else
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
#endif
}

static int fail(Plan *p, int32_t member, int32_t cause, int32_t value, fmi2Status status)
{
    p->cause = cause;
    p->failed_member = member;
    p->failed_value = value;
    p->status = (int32_t)status;
    return 0;
}

static int bad(fmi2Status status) { return status != fmi2OK && status != fmi2Warning; }

static int set_reals(Plan *p, int32_t member, const double *values)
{
    Member *m = &p->members[member];
    const size_t n = (size_t)m->inputs[REALS];
    if (n == 0) return 1;
    fmi2Status s = m->set_real(m->instance, p->input_reference + m->first_input, n, values + m->first_input);
    return bad(s) ? fail(p, member, SET_FAILED, -1, s) : 1;
}

static int set_integers(Plan *p, int32_t member)
{
    Member *m = &p->members[member];
    int32_t first = m->first_input + m->inputs[REALS];
    for (int type = INTEGERS; type <= BOOLEANS; ++type) {
        const int32_t n = m->inputs[type];
        if (n == 0) continue;
        for (int32_t i = 0; i < n; ++i) {
            const double v = p->value[first + i];
            p->integers[i] = type == BOOLEANS ? v != 0.0 : (int32_t)lround(v);
        }
        const uint32_t *references = p->input_reference + first;
        fmi2Status s = type == INTEGERS ? m->set_integer(m->instance, references, (size_t)n, p->integers)
                                       : m->set_boolean(m->instance, references, (size_t)n, p->integers);
        if (bad(s)) return fail(p, member, SET_FAILED, -1, s);
        first += n;
    }
    return 1;
}

/* Values at the step's start (or held over it) and slopes of a member's inputs. */
static void find_inputs(Plan *p, const Member *m)
{
    const int32_t end = m->first_input + m->inputs[REALS] + m->inputs[INTEGERS] + m->inputs[BOOLEANS];
    for (int32_t i = m->first_input; i < end; ++i) {
        const int32_t s = p->source[i];
        double y = p->now[s], change = 0.0;
        if (p->mode[i] == HELD_NEXT) y = p->next[s];
        if (p->mode[i] == EXTRAPOLATED) change = p->now[s] - p->before[s];
        if (p->mode[i] == INTERPOLATED) change = p->next[s] - p->now[s];
        p->value[i] = p->factor[i] * y + p->offset[i];
        p->slope[i] = p->factor[i] * change / p->step;
    }
}

/* Move the real inputs along their slopes. */
static void advance_inputs(Plan *p, const Member *m, double time)
{
    for (int32_t i = m->first_input; i < m->first_input + m->inputs[REALS]; ++i) p->value[i] += time * p->slope[i];
}

static int read_member(Plan *p, int32_t member, double *y)
{
    Member *m = &p->members[member];
    int32_t first = m->first_read;
    for (int type = REALS; type < TYPES; ++type) {
        const int32_t n = m->reads[type];
        if (n == 0) continue;
        const uint32_t *references = p->read_reference + first;
        fmi2Status s = type == REALS      ? m->get_real(m->instance, references, (size_t)n, y + first)
                       : type == INTEGERS ? m->get_integer(m->instance, references, (size_t)n, p->integers)
                                         : m->get_boolean(m->instance, references, (size_t)n, p->integers);
        if (bad(s)) return fail(p, member, GET_FAILED, -1, s);
        for (int32_t i = 0; type != REALS && i < n; ++i) y[first + i] = (double)p->integers[i];
        first += n;
    }
    return 1;
}

static int check_member(Plan *p, int32_t member, const double *y)
{
    const Member *m = &p->members[member];
    for (int32_t i = m->first_read; i < m->first_read + m->reads[REALS]; ++i)
        if (!(fabs(y[i]) <= p->limit[i])) {
            p->failed_number = y[i];
            return fail(p, member, NOT_FINITE, i, fmi2OK);
        }
    return 1;
}

static int step_member(Plan *p, int32_t member)
{
    Member *m = &p->members[member];
    const size_t n = (size_t)m->inputs[REALS];
    find_inputs(p, m);
    /* An FMU that holds its inputs gets their value at mid-step: the same impulse as the slope would give. */
    if (!m->set_slopes) advance_inputs(p, m, 0.5 * p->step);
    if (!set_reals(p, member, p->value) || !set_integers(p, member)) return 0;
    if (m->set_slopes && n > 0) {
        fmi2Status s = m->set_slopes(m->instance, p->input_reference + m->first_input, n, p->orders,
                                     p->slope + m->first_input);
        if (bad(s)) return fail(p, member, SLOPE_FAILED, -1, s);
    }
    fmi2Status s = m->do_step(m->instance, p->start + (double)p->steps_done * p->step, p->step, fmi2True);
    if (s != fmi2OK && s != fmi2Warning) return fail(p, member, STEP_FAILED, -1, s);
    if (!m->set_slopes) { /* outputs with direct feed-through are to see the inputs of the step's end */
        advance_inputs(p, m, 0.5 * p->step);
        if (!set_reals(p, member, p->value)) return 0;
    }
    return read_member(p, member, p->next) && check_member(p, member, p->next);
}

/* Append the present values as a row of channels. */
EXPORT void record(Plan *p)
{
    double *row = p->rows + (size_t)p->rows_used * (size_t)(1 + p->n_channels);
    row[0] = p->start + (double)p->steps_done * p->step;
    for (int32_t i = 0; i < p->n_channels; ++i)
        row[1 + i] = p->channel_factor[i] * p->now[p->channel[i]] + p->channel_offset[i];
    p->rows_used += 1;
}

/* Read every member; with `check`, refuse values that are not finite. Returns 0 on failure. */
EXPORT int read_all(Plan *p, int check)
{
    for (int32_t k = 0; k < p->n_members; ++k)
        if (!read_member(p, k, p->now) || (check && !check_member(p, k, p->now))) return 0;
    return 1;
}

/* One sweep of an initial fixed-point iteration: give every member its connected values, read what follows. */
EXPORT int propagate(Plan *p)
{
    for (int32_t k = 0; k < p->n_members; ++k) {
        const Member *m = &p->members[k];
        const int32_t end = m->first_input + m->inputs[REALS] + m->inputs[INTEGERS] + m->inputs[BOOLEANS];
        for (int32_t i = m->first_input; i < end; ++i)
            p->value[i] = p->factor[i] * p->now[p->source[i]] + p->offset[i];
        if (!set_reals(p, k, p->value) || !set_integers(p, k) || !read_member(p, k, p->now)) return 0;
    }
    return 1;
}

/* Take up to `count` steps. Returns 0 on failure (cause, failed_member, failed_value and status tell which). */
EXPORT int run_steps(Plan *p, int64_t count)
{
    for (int64_t i = 0; i < count; ++i) {
        const int timed = p->steps_done % TIMED_EVERY == 0;
        double last = timed ? seconds_now() : 0.0;
        for (int32_t k = 0; k < p->n_members; ++k) {
            if (!step_member(p, k)) return 0;
            if (timed) {
                const double t = seconds_now();
                p->members[k].seconds += t - last;
                last = t;
            }
        }
        double *oldest = p->before;
        p->before = p->now;
        p->now = p->next;
        p->next = oldest;
        p->steps_done += 1;
        if (p->steps_done % p->decimation == 0) record(p);
    }
    return 1;
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...)
{
    Log *log = environment;
    (void)instance;
    (void)category;
    if (!log || !message || status == fmi2OK) return;
    const int slot = log->count % LOG_LINES;
    va_list arguments;
    va_start(arguments, message);
    vsnprintf(log->text[slot], LOG_LENGTH, message, arguments);
    va_end(arguments);
    log->status[slot] = (int32_t)status;
    log->count += 1;
}

static void *allocate(size_t count, size_t size) { return calloc(count, size); }

/* Callbacks that keep an instance's warnings and errors in `log`. */
EXPORT void fill_callbacks(fmi2CallbackFunctions *callbacks, Log *log)
{
    /* the members are const: the structure is filled as a whole */
    fmi2CallbackFunctions filled = {logger, allocate, free, NULL, log};
    memcpy(callbacks, &filled, sizeof filled);
}
