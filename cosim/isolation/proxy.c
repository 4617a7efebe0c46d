/* The stand-ins for the functions of an FMU in another process; `c` is its Channel. */
#include "channel.h"

#include <string.h>

/* Add a record; returns where its `bytes` of content go, NULL if the other process is lost. */
static unsigned char *append(Channel *c, Record r, size_t bytes)
{
    if (c->lost) return NULL;
    if (c->used == 0) c->used = sizeof(uint64_t) * 2; /* as an answer's head, so that contents are aligned alike */
    if (!reserve(&c->sent, &c->sent_capacity, c->used + sizeof r + padded(bytes))) {
        c->lost = 1;
        return NULL;
    }
    memcpy(c->sent + c->used, &r, sizeof r);
    unsigned char *content = c->sent + c->used + sizeof r;
    c->used += sizeof r + padded(bytes);
    return content;
}

/* Wait for an answer with `bytes` of values; any number if negative. */
static fmi2Status hear(Channel *c, void *values, int64_t bytes)
{
    Answer answer;
    if (!receive_frame(c)) {
        c->lost = 1;
        return fmi2Fatal;
    }
    memcpy(&answer, c->received, sizeof answer);
    c->open_steps = 0;
    c->text = c->received + sizeof answer;
    c->text_size = (int64_t)(answer.size - sizeof answer);
    if (bad((fmi2Status)answer.status)) {
        c->failed_call = answer.call;
        return (fmi2Status)answer.status;
    }
    if (bytes >= 0 && c->text_size != bytes) {
        c->lost = 1;
        return fmi2Fatal;
    }
    if (bytes > 0) memcpy(values, c->text, (size_t)bytes);
    return (fmi2Status)answer.status;
}

static fmi2Status exchange(Channel *c, void *values, int64_t bytes)
{
    c->waits += 1;
    const int sent = send_frame(c);
    if (!sent) c->lost = 1;
    const fmi2Status status = sent ? hear(c, values, bytes) : fmi2Fatal;
    c->waits += 1;
    return status;
}

static fmi2Status set_values(Channel *c, int call, const uint32_t *references, size_t n, const void *values, size_t size)
{
    const Record r = {call, (int32_t)n, 0, 0, 0.0, 0.0};
    unsigned char *content = append(c, r, padded(4 * n) + size * n);
    if (!content) return fmi2Fatal;
    memcpy(content, references, 4 * n);
    memcpy(content + padded(4 * n), values, size * n);
    return fmi2OK;
}

static fmi2Status get_values(Channel *c, int call, const uint32_t *references, size_t n, void *values, size_t size)
{
    const Record r = {call, (int32_t)n, 0, 0, 0.0, 0.0};
    unsigned char *content = append(c, r, 4 * n);
    if (!content) return fmi2Fatal;
    memcpy(content, references, 4 * n);
    return exchange(c, values, (int64_t)(size * n));
}

EXPORT fmi2Status proxy_fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{
    return set_values(c, SET_REAL, r, n, v, sizeof *v);
}

EXPORT fmi2Status proxy_fmi2SetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer v[])
{
    return set_values(c, SET_INTEGER, r, n, v, sizeof *v);
}

EXPORT fmi2Status proxy_fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[])
{
    return set_values(c, SET_BOOLEAN, r, n, v, sizeof *v);
}

EXPORT fmi2Status proxy_fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    return get_values(c, GET_REAL, r, n, v, sizeof *v);
}

EXPORT fmi2Status proxy_fmi2GetInteger(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Integer v[])
{
    return get_values(c, GET_INTEGER, r, n, v, sizeof *v);
}

EXPORT fmi2Status proxy_fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[])
{
    return get_values(c, GET_BOOLEAN, r, n, v, sizeof *v);
}

EXPORT fmi2Status proxy_fmi2SetRealInputDerivatives(fmi2Component component, const fmi2ValueReference references[],
                                                    size_t n, const fmi2Integer orders[], const fmi2Real values[])
{
    const Record r = {SET_SLOPES, (int32_t)n, 0, 0, 0.0, 0.0};
    unsigned char *content = append(component, r, 2 * padded(4 * n) + 8 * n);
    if (!content) return fmi2Fatal;
    memcpy(content, references, 4 * n);
    memcpy(content + padded(4 * n), orders, 4 * n);
    memcpy(content + 2 * padded(4 * n), values, 8 * n);
    return fmi2OK;
}

/* Have all calls put off done, and return their status. */
EXPORT fmi2Status channel_synchronise(Channel *c)
{
    const Record r = {SYNCHRONISE, 0, 0, 0, 0.0, 0.0};
    return append(c, r, 0) ? exchange(c, NULL, 0) : fmi2Fatal;
}

EXPORT fmi2Status proxy_fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step, fmi2Boolean keep)
{
    Channel *c = component;
    const Record r = {DO_STEP, 0, 0, keep, time, step};
    if (!append(c, r, 0)) return fmi2Fatal;
    c->open_steps += 1;
    return c->open_steps < MOST_STEPS ? fmi2OK : channel_synchronise(c);
}

/* States stay in the FMU's process; a pointer into `states` stands for each. */
static fmi2Status tell_state(Channel *c, int call, fmi2FMUstate state)
{
    const Record r = {call, (int32_t)((fmi2FMUstate *)state - c->states), 0, 0, 0.0, 0.0};
    return append(c, r, 0) ? fmi2OK : fmi2Fatal;
}

EXPORT fmi2Status proxy_fmi2GetFMUstate(fmi2Component component, fmi2FMUstate *state)
{
    Channel *c = component;
    for (int i = 0; i < STATES && !*state; ++i)
        if (!c->states[i]) *state = c->states[i] = &c->states[i];
    if (*state) return tell_state(c, GET_STATE, *state);
    c->failed_call = GET_STATE; /* too many */
    return fmi2Error;
}

EXPORT fmi2Status proxy_fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return tell_state(c, SET_STATE, state); }

EXPORT fmi2Status proxy_fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!*state) return fmi2OK;
    const fmi2Status status = tell_state(c, FREE_STATE, *state);
    *(fmi2FMUstate *)*state = NULL;
    *state = NULL;
    return status;
}

EXPORT fmi2Status proxy_fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t n,
                                                     const fmi2ValueReference knowns[], size_t m,
                                                     const fmi2Real seed[], fmi2Real derivative[])
{
    const Record r = {DERIVATIVE, (int32_t)n, (int32_t)m, 0, 0.0, 0.0};
    unsigned char *content = append(c, r, padded(4 * n) + padded(4 * m) + 8 * m);
    if (!content) return fmi2Fatal;
    memcpy(content, unknowns, 4 * n);
    memcpy(content + padded(4 * n), knowns, 4 * m);
    memcpy(content + padded(4 * n) + padded(4 * m), seed, 8 * m);
    return exchange(c, derivative, (int64_t)(8 * n));
}

/* Wait for what the process says of its own accord once it has its FMU; then `text` is its answer. */
EXPORT int channel_hear(Channel *c)
{
    c->waits += 1;
    const fmi2Status status = hear(c, NULL, -1);
    c->waits += 1;
    return (int)status;
}

/* Have Python answer in the FMU's process, after all calls put off; then `text` is its answer. */
EXPORT int channel_ask(Channel *c, const char *text, size_t size)
{
    const Record r = {PYTHON, (int32_t)size, 0, 0, 0.0, 0.0};
    unsigned char *content = append(c, r, size);
    if (!content) return fmi2Fatal;
    memcpy(content, text, size);
    return (int)exchange(c, NULL, -1);
}
