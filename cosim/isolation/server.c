/* The process of an FMU: does what the stand-ins of proxy.c were asked. */
#include "channel.h"

#include <string.h>

static int answer(Channel *c, int status, int call, size_t bytes)
{
    const Answer head = {0, status, call};
    c->used = sizeof head + bytes;
    if (!reserve(&c->sent, &c->sent_capacity, c->used)) return 0;
    memcpy(c->sent, &head, sizeof head);
    return send_frame(c);
}

/* Answer a Python request; 0 if there is no one to hear. */
EXPORT int channel_answer(Channel *c, const char *text, size_t size)
{
    if (!reserve(&c->sent, &c->sent_capacity, sizeof(Answer) + size)) return 0;
    memcpy(c->sent + sizeof(Answer), text, size);
    return answer(c, fmi2OK, PYTHON, size);
}

#define CALL(type, name) ((type *)functions[name])

static fmi2Status call_fmu(Channel *c, void *const *functions, fmi2Component fmu, Record r, unsigned char *content,
                           void *result)
{
    const size_t n = (size_t)r.n, m = (size_t)r.m;
    const uint32_t *references = (const uint32_t *)content;
    void *second = content + padded(4 * n);
    switch (r.call) {
    case SET_REAL: return CALL(fmi2SetRealTYPE, SET_REAL)(fmu, references, n, second);
    case SET_INTEGER: return CALL(fmi2SetIntegerTYPE, SET_INTEGER)(fmu, references, n, second);
    case SET_BOOLEAN: return CALL(fmi2SetBooleanTYPE, SET_BOOLEAN)(fmu, references, n, second);
    case SET_SLOPES: {
        const double *slopes = (const double *)(content + 2 * padded(4 * n));
        return CALL(fmi2SetRealInputDerivativesTYPE, SET_SLOPES)(fmu, references, n, second, slopes);
    }
    case DO_STEP: return CALL(fmi2DoStepTYPE, DO_STEP)(fmu, r.a, r.b, r.flag);
    case GET_STATE: return CALL(fmi2GetFMUstateTYPE, GET_STATE)(fmu, &c->states[n]);
    case SET_STATE: return CALL(fmi2SetFMUstateTYPE, SET_STATE)(fmu, c->states[n]);
    case FREE_STATE: return CALL(fmi2FreeFMUstateTYPE, FREE_STATE)(fmu, &c->states[n]);
    case GET_REAL: return CALL(fmi2GetRealTYPE, GET_REAL)(fmu, references, n, result);
    case GET_INTEGER: return CALL(fmi2GetIntegerTYPE, GET_INTEGER)(fmu, references, n, result);
    case GET_BOOLEAN: return CALL(fmi2GetBooleanTYPE, GET_BOOLEAN)(fmu, references, n, result);
    case DERIVATIVE: {
        const double *seed = (const double *)(content + padded(4 * n) + padded(4 * m));
        return CALL(fmi2GetDirectionalDerivativeTYPE, DERIVATIVE)(fmu, references, n, second, m, seed, result);
    }
    default: return fmi2OK;
    }
}

static size_t content_size(Record r)
{
    const size_t n = (size_t)r.n, m = (size_t)r.m, references = padded(4 * n);
    switch (r.call) {
    case SET_REAL: return references + 8 * n;
    case SET_INTEGER:
    case SET_BOOLEAN: return 2 * references;
    case SET_SLOPES: return 2 * references + 8 * n;
    case GET_REAL:
    case GET_INTEGER:
    case GET_BOOLEAN: return references;
    case DERIVATIVE: return references + padded(4 * m) + 8 * m;
    case PYTHON: return padded(n);
    default: return 0;
    }
}

static size_t result_size(Record r)
{
    if (r.call == GET_REAL || r.call == DERIVATIVE) return 8 * (size_t)r.n;
    return r.call == GET_INTEGER || r.call == GET_BOOLEAN ? 4 * (size_t)r.n : 0;
}

/* Serve calls until Python is asked (1; the request is `text`) or the pipe ends (0). */
EXPORT int channel_serve(Channel *c, void *const *functions, fmi2Component fmu, volatile Page *page)
{
    while (receive_frame(c)) {
        fmi2Status status = fmi2OK;
        int call = SYNCHRONISE;
        Record r = {SYNCHRONISE, 0, 0, 0, 0.0, 0.0};
        for (size_t at = sizeof(Answer); at < c->received_size && !bad(status); at += content_size(r)) {
            memcpy(&r, c->received + at, sizeof r);
            at += sizeof r;
            if (!reserve(&c->sent, &c->sent_capacity, sizeof(Answer) + result_size(r))) return 0;
            if (r.call < SYNCHRONISE) page->call = r.call;
            if (r.call == DO_STEP) page->time = r.a;
            c->text = c->received + at;
            const fmi2Status s = call_fmu(c, functions, fmu, r, c->received + at, c->sent + sizeof(Answer));
            if (s != fmi2OK) {
                status = s;
                call = r.call;
            }
        }
        if (r.call == PYTHON && !bad(status)) {
            c->text_size = r.n;
            return 1;
        }
        if (!answer(c, status, call, bad(status) ? 0 : result_size(r))) return 0;
    }
    return 0;
}
