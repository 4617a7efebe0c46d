/* The stepping loop of the co-simulation master: flat arrays in, FMI 2.0 calls out (adapter.h for 3.0), no Python and no allocation in between.
 *
 * A *value* is a double read from a component, whatever its FMI type; an *input* is one set in a component, and equals
 * factor * value + offset of its source. Over a step from t_n, inputs are polynomials of the time tau since t_n:
 * value + slope tau + bend tau^2. `Member`s are in stepping order; values and inputs of a member are contiguous.
 */
#ifndef KERNEL_H
#define KERNEL_H

#include <stdint.h>

#include "fmi2FunctionTypes.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { REALS, INTEGERS, BOOLEANS, TYPES };
/* What a component sees of a source over a step. HELD: its value at the start (sampled values, integers, booleans). */
enum { HELD, EXTRAPOLATED, INTERPOLATED };
enum { SINGLE_PASS, FIXED_POINT, NEWTON }; /* schemes */
enum {
    OK, SET_FAILED, SLOPE_FAILED, STEP_FAILED, GET_FAILED, NOT_FINITE, SAVE_FAILED, RESTORE_FAILED, DERIVATIVE_FAILED,
    NOT_CONVERGED, LOOP_OPEN
}; /* causes of failure */
enum { LOG_LINES = 8, LOG_LENGTH = 400, TIMED_EVERY = 5, DEEPEST = 16 };

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
    fmi2DoStepTYPE *do_step;
    /* of integers NULL where they pass as reals (FMI 3.0); the following NULL where the FMU does not offer them */
    fmi2SetRealInputDerivativesTYPE *set_slopes; /* without: it holds its inputs over a step */
    fmi2GetFMUstateTYPE *get_state;
    fmi2SetFMUstateTYPE *set_state;
    fmi2FreeFMUstateTYPE *free_state;
    fmi2GetDirectionalDerivativeTYPE *directional;
    fmi2FMUstate saved;
    int32_t first_read, first_input;
    int32_t reads[TYPES], inputs[TYPES]; /* counts; stored in this order of types */
    int32_t derived;  /* of the real values, those that are continuous outputs: they come first */
    int32_t varying;  /* of the real inputs, those that are not HELD: they come first */
    int32_t iterated; /* others follow its continuous outputs: it takes part in the iteration */
    int32_t stale;    /* outputs follow inputs that are known at the end of a step only: to be read again then */
    int32_t every;    /* steps once in so many steps */
    int32_t substeps; /* or so often within each */
    int32_t phase;    /* steps since its own last one */
    double age;       /* the same as time, s */
    double seconds;   /* measured in every TIMED_EVERY-th step */
} Member;

/* A pair of effort and flow of a mechanical port: their product is a power. */
typedef struct {
    int32_t port;
    int32_t effort;    /* input: force or moment */
    int32_t flow;      /* value: velocity or angular velocity, an output of the same component */
    int32_t flow_used; /* input that this flow, or the position of which it is the rate, feeds at the other end; -1: none */
    int32_t by_rate;   /* it is the position */
} Pair;

typedef struct {
    double crossed;  /* energy that passed, in either direction, J */
    double residual; /* energy that one end got and the other did not give, J */
} Port;

typedef struct {
    Member *members;
    int32_t n_members, n_values, n_inputs;
    /* values: at the step's start, its end and its middle; first divided difference over the last step; extrapolation */
    double *now, *next, *mid, *rate, *slope, *bend;
    const uint32_t *read_reference;
    const int32_t *owner; /* member of each value */
    const double *limit;  /* |value| beyond this counts as an explosion */
    const double *scale;  /* magnitude that tolerances refer to */
    /* inputs */
    const uint32_t *input_reference;
    const int32_t *source, *target, *mode; /* value; member; what is seen of the source over a step */
    const double *factor, *offset;
    double *value, *input_slope, *input_bend; /* polynomials over the present step */
    double *begun;           /* of components that step at multiples: inputs at the start of their own step */
    double *mid_used, *end_used; /* iteration: what was used for inputs from members that come later */
    double *mid_before, *end_before; /* and their residuals in the iteration before */
    int32_t *integers, *first_order, *second_order;
    double *derivatives; /* work */
    /* inputs whose source comes later in the order, for the exchange and for the iteration; those on algebraic loops */
    const int32_t *backward, *late, *tear;
    const int32_t *backward_tear, *late_tear; /* of each, its place among the tears, or -1 */
    int32_t n_backward, n_late, n_tear;
    double *jacobian, *matrix; /* (tears, tears) */
    double *correction;        /* twice tears: what `correct` gives and takes */
    double *seed, *response;   /* work: inputs, values */
    int32_t jacobian_known;
    int64_t jacobian_attempts; /* attempts when it was found */
    double gain; /* of the loops: largest row sum of the Jacobian */
    /* ports */
    const Pair *pairs;
    Port *ports;
    int32_t n_pairs, n_ports;
    double *last_bend; /* of each pair's effort */
    /* recording */
    const int32_t *channel;
    const double *channel_factor, *channel_offset;
    double *rows; /* (rows_used, 1 + n_channels): time, channels */
    int32_t n_channels, rows_used;
    /* settings */
    double start, step;
    int64_t steps_done, decimation;
    int32_t order;  /* of inputs over a step: 0, 1, 2 */
    int32_t scheme;
    double tolerance;        /* of loops and iterations, relative */
    double energy_tolerance; /* share of a port's power above which a step is halved; 0: steps are never halved */
    /* state of the stepping */
    double time, last; /* reached; length of the step before */
    int32_t history;   /* steps before, up to 2 */
    int32_t reversible; /* every member can go back */
    int32_t slow;      /* some component steps at multiples only */
    int32_t timed;     /* the time spent in each member is measured in this step */
    int32_t depth;     /* the present step is step / 2^depth */
    int64_t attempts, rejected, iterations, sweeps;
    /* failure */
    int32_t cause, failed_member, failed_value, status;
    double failed_number;
} Plan;

int fail(Plan *p, int32_t member, int32_t cause, int32_t value, fmi2Status status);
int bad(fmi2Status status);
double seconds_now(void);
void keep_message(Log *log, int32_t status, const char *text);

/* member.c (these names are not exported: libc has an `advance` of its own) */
int set_member(Plan *p, int32_t member);
int read_member(Plan *p, int32_t member, double *y);
int check_member(Plan *p, int32_t member, const double *y);
int advance(Plan *p, int32_t member, double time, double span);
int save_member(Plan *p, int32_t member);
int restore_member(Plan *p, int32_t member);

/* signals.c */
/* A value now: extrapolated, if its component steps at multiples only. */
static inline double value_now(const Plan *p, int32_t value)
{
    if (!p->slow) return p->now[value];
    const double age = p->members[p->owner[value]].age;
    return p->now[value] + age * (p->slope[value] + age * p->bend[value]);
}

/* An input now, from the present value of its source. */
static inline double present(const Plan *p, int32_t input)
{
    return p->factor[input] * value_now(p, p->source[input]) + p->offset[input];
}

void present_inputs(Plan *p, const Member *m);
void inputs_over_step(Plan *p, const Member *m, double h);
void accept_values(Plan *p, double h);

/* exchange.c */
int exchange(Plan *p);
int exchange_left(Plan *p, double h);
void correct(Plan *p, const int32_t *place, int32_t n, double *used, const double *residual);
double scale_of(const Plan *p, int32_t input, double value);
int find_jacobian(Plan *p, const double *base);

/* iterate.c */
int iterate(Plan *p, double h);

/* energy.c */
double step_error(const Plan *p, double h);
void measure_ports(Plan *p, double h);

#endif
