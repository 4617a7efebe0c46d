/* The stepping loop: see kernel.h. */
#if !defined(_WIN32)
#define _POSIX_C_SOURCE 200809L
#endif
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#include <windows.h>
#else
#include <time.h>
#endif

#include "kernel.h"

double seconds_now(void)
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

/* --- one step --------------------------------------------------------------------------------------------------- */

/* One component over the step, or over a part or a multiple of it. */
static int step_member(Plan *p, int32_t member, double h)
{
    Member *m = &p->members[member];
    if (m->every > 1 && m->phase == 0) {
        present_inputs(p, m);
        const int32_t first = m->first_input;
        memcpy(p->begun + first, p->value + first, (size_t)m->inputs[REALS] * sizeof(double));
    }
    if (m->phase + 1 < m->every) return 1;
    inputs_over_step(p, m, h);
    const double span = h * m->every / m->substeps, begin = p->time - h * m->phase;
    for (int32_t i = 0; i < m->substeps; ++i)
        if (!advance(p, member, begin + i * span, span)) return 0;
    return read_member(p, member, p->next) && check_member(p, member, p->next);
}

static int single_pass(Plan *p, double h)
{
    double last = p->timed ? seconds_now() : 0.0;
    for (int32_t k = 0; k < p->n_members; ++k) {
        if (!step_member(p, k, h)) return 0;
        if (p->timed) {
            const double t = seconds_now();
            p->members[k].seconds += t - last;
            last = t;
        }
    }
    return 1;
}

static void accept(Plan *p, double h)
{
    measure_ports(p, h);
    for (int32_t k = 0; k < p->n_members; ++k) {
        Member *m = &p->members[k];
        m->phase = m->phase + 1 < m->every ? m->phase + 1 : 0;
        m->age = h * m->phase;
    }
    accept_values(p, h);
}

static int attempt(Plan *p, double h)
{
    p->attempts += 1;
    return p->scheme == SINGLE_PASS ? single_pass(p, h) : iterate(p, h);
}

/* Length of the present part of a communication step. */
static double part(const Plan *p) { return p->step / (double)((int64_t)1 << p->depth); }

static int save(Plan *p)
{
    const int all = p->energy_tolerance > 0.0;
    for (int32_t k = 0; k < p->n_members; ++k)
        if ((all || (p->scheme != SINGLE_PASS && p->members[k].iterated)) && !save_member(p, k)) return 0;
    return 1;
}

static int halve(Plan *p)
{
    p->rejected += 1;
    p->depth += 1;
    for (int32_t k = 0; k < p->n_members; ++k)
        if (!restore_member(p, k)) return 0;
    return 1;
}

/* The first step has none before it to extrapolate from: it is taken twice, once to find the slopes. */
static int rehearse(Plan *p)
{
    if (p->history > 0 || p->order == 0 || !p->reversible) return 1;
    const double h = part(p);
    p->time = p->start;
    for (int32_t k = 0; k < p->n_members; ++k)
        if (!save_member(p, k)) return 0;
    if (!attempt(p, h)) return 0;
    for (int32_t k = 0; k < p->n_members; ++k) {
        const Member *m = &p->members[k];
        for (int32_t v = m->first_read; v < m->first_read + m->derived; ++v) p->slope[v] = (p->next[v] - p->now[v]) / h;
        if (!restore_member(p, k)) return 0;
    }
    return 1;
}

/* One communication step: in one piece or, where the energy at the ports demands it, in halves of halves. */
static int whole_step(Plan *p)
{
    p->timed = p->steps_done % TIMED_EVERY == 0;
    const double begin = p->start + (double)p->steps_done * p->step;
    const int64_t whole = (int64_t)1 << DEEPEST;
    if (!rehearse(p)) return 0;
    for (int64_t done = 0; done < whole;) {
        double error = 0.0;
        p->time = begin + p->step * ((double)done / (double)whole);
        if (!save(p)) return 0;
        for (;;) {
            if (!attempt(p, part(p))) return 0;
            if (p->energy_tolerance > 0.0) error = step_error(p, part(p));
            if (error <= p->energy_tolerance || p->depth == DEEPEST) break;
            if (!halve(p)) return 0;
        }
        if (!exchange_left(p, part(p))) return 0;
        accept(p, part(p));
        done += whole >> p->depth;
        p->time = begin + p->step * ((double)done / (double)whole);
        if (!exchange(p)) return 0;
        if (p->depth > 0 && error < 0.1 * p->energy_tolerance && done % (whole >> (p->depth - 1)) == 0) p->depth -= 1;
    }
    return 1;
}

/* --- what Python calls ------------------------------------------------------------------------------------------ */

/* Append the present values as a row of channels. */
EXPORT void record(Plan *p)
{
    double *row = p->rows + (size_t)p->rows_used * (size_t)(1 + p->n_channels);
    row[0] = p->start + (double)p->steps_done * p->step;
    for (int32_t i = 0; i < p->n_channels; ++i)
        row[1 + i] = p->channel_factor[i] * value_now(p, p->channel[i]) + p->channel_offset[i];
    p->rows_used += 1;
}

/* Read every member; with `check`, refuse values that are not finite. Returns 0 on failure. */
EXPORT int read_all(Plan *p, int check)
{
    for (int32_t k = 0; k < p->n_members; ++k)
        if (!read_member(p, k, p->now) || (check && !check_member(p, k, p->now))) return 0;
    return 1;
}

/* Make all outputs of the members marked as stale consistent with the present inputs; solves algebraic loops. */
EXPORT int settle(Plan *p) { return exchange(p); }

/* Find the Jacobian of the algebraic loops, as the settled members have it now. */
EXPORT int linearise(Plan *p) { return p->n_tear == 0 || find_jacobian(p, p->end_used); }

/* Take up to `count` steps. Returns 0 on failure (cause, failed_member, failed_value and status tell which). */
EXPORT int run_steps(Plan *p, int64_t count)
{
    for (int64_t i = 0; i < count; ++i) {
        if (!whole_step(p)) return 0;
        p->steps_done += 1;
        if (p->steps_done % p->decimation == 0) record(p);
    }
    return 1;
}

/* Give the saved states of the members back to their FMUs. */
EXPORT void release_states(Plan *p)
{
    for (int32_t k = 0; k < p->n_members; ++k) {
        Member *m = &p->members[k];
        if (m->saved && m->free_state) m->free_state(m->instance, &m->saved);
        m->saved = NULL;
    }
}

/* Keep a message among the last ones of `log`. */
void keep_message(Log *log, int32_t status, const char *text)
{
    const int slot = log->count % LOG_LINES;
    snprintf(log->text[slot], LOG_LENGTH, "%s", text);
    log->status[slot] = status;
    log->count += 1;
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...)
{
    char text[LOG_LENGTH];
    (void)instance;
    (void)category;
    if (!environment || !message || status == fmi2OK) return;
    va_list arguments;
    va_start(arguments, message);
    vsnprintf(text, sizeof text, message, arguments);
    va_end(arguments);
    keep_message(environment, (int32_t)status, text);
}

static void *allocate(size_t count, size_t size) { return calloc(count, size); }

/* Callbacks that keep an instance's warnings and errors in `log`. */
EXPORT void fill_callbacks(fmi2CallbackFunctions *callbacks, Log *log)
{
    /* the members are const: the structure is filled as a whole */
    fmi2CallbackFunctions filled = {logger, allocate, free, NULL, log};
    memcpy(callbacks, &filled, sizeof filled);
}
