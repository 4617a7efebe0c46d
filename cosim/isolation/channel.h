/* An FMU in its own process: stand-ins with FMI 2.0 signatures in proxy.c, a pair of pipes, the FMU behind server.c.
 *
 * Calls that return nothing but a status are put off until the next reading (or for MOST_STEPS steps), so that a step
 * costs one exchange; the reading then returns the first failing status, and `failed_call` names its function. A frame
 * is a 64-bit length followed by records (request), or by status, call and values (answer).
 */
#ifndef CHANNEL_H
#define CHANNEL_H

#include <stddef.h>
#include <stdint.h>

#include "fmi2FunctionTypes.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* as CALLS in native.py; those after FREE_STATE are answered */
enum { SET_REAL, SET_INTEGER, SET_BOOLEAN, SET_SLOPES, DO_STEP, GET_STATE, SET_STATE, FREE_STATE,
       GET_REAL, GET_INTEGER, GET_BOOLEAN, DERIVATIVE, SYNCHRONISE, PYTHON };
enum { STATES = 64, MOST_STEPS = 16 };

typedef struct {
    uint64_t size;
    int32_t status, call;
} Answer;

typedef struct {
    int32_t call, n, m, flag;
    double a, b;
} Record;

/* In memory that both processes see: what the FMU was or is at. */
typedef struct {
    int32_t call, reserved;
    double time; /* of the last fmi2DoStep, s */
} Page;

typedef struct {
    const unsigned char *text; /* of the last Python request or answer */
    int64_t text_size;
    volatile int64_t waits; /* odd while waiting for the other process */
    int32_t failed_call, lost;
    /* what follows is not seen from Python */
    intptr_t from, to; /* file descriptors; handles on Windows */
    unsigned char *sent, *received;
    size_t used, sent_capacity, received_size, received_capacity;
    int32_t open_steps; /* put off */
    fmi2FMUstate states[STATES]; /* at the FMU its states, at the stand-ins marks of those in use */
} Channel;

static inline size_t padded(size_t bytes) { return (bytes + 7) & ~(size_t)7; }
static inline int bad(fmi2Status status) { return status != fmi2OK && status != fmi2Warning; }

int reserve(unsigned char **buffer, size_t *capacity, size_t needed);
/* Both return 0 when the other process is gone. */
int send_frame(Channel *c);
int receive_frame(Channel *c);

#endif
