/* One FMU instance: its data, and what the runtime's files offer each other and the interface (fmi2.c or fmi3.c).
 *
 * No global state, any number of instances. Functions of type int return 0, or 1 after an error that they reported. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <math.h>
#include <string.h>

#include "runtime.h"

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* STEPPING: co-simulation after initialisation; EVENT and CONTINUOUS: model exchange. */
typedef enum { INSTANTIATED, INITIALISING, STEPPING, EVENT, CONTINUOUS, TERMINATED, FAILED } mode;

/* All that changes between creation and release, in one block of doubles, a few scalars and the string variables: the
 * FMU state is a copy of exactly this. */
typedef struct {
    double time, start, stop; /* stop: HUGE_VAL if none was given */
    long long samples; /* sample instants passed */
    mode mode;
    int started;   /* initial states evaluated */
    int warm;      /* lookup results hold a last solution */
} scalars;

typedef struct instance {
    scalars s;
    int model_exchange;
    double *values;       /* p, k, u, y, x, z, time, rates, indicators, then w (lookup results), slopes of u, curves */
    char **strings;
    wind_box **boxes;     /* one per string variable */
    int current;          /* which of FOR_RATES, FOR_OUTPUTS, FOR_SIGNS hold for the present time, states and inputs */
    double *scratch;      /* Runge-Kutta stages, lookup arguments, seeds */
    double *work;
    casadi_int *iwork;
    char *name;
    char *resources;      /* folder of the FMU's own files with its final separator, or "" */
    void *environment;    /* of the importer, for its logger */
    void (*logger)(void); /* the importer's, in the interface's own type */
    void (*update)(void); /* likewise, for values within a step */
    void (*ask)(struct instance *m, double time); /* has it set the inputs of then; NULL: they follow their slopes */
} instance;

#define AT_K (model.n_p)
#define AT_U (AT_K + model.n_k)
#define AT_Y (AT_U + model.n_u)
#define AT_X (AT_Y + model.n_y)
#define AT_Z (AT_X + model.n_x)
#define AT_TIME (AT_Z + model.n_z) /* a place only: the time is in the scalars */
#define AT_RATES (AT_TIME + 1)
#define AT_INDICATORS (AT_RATES + model.n_x)
#define AT_W (AT_INDICATORS + model.n_switches) /* value references are places before this one */
#define AT_SLOPE (AT_W + model.n_w)
#define AT_CURVE (AT_SLOPE + model.n_u)
#define N_VALUES (AT_CURVE + model.n_u)

/* In scratch; the lookups' arguments and their directions lead. */
#define AT_STAGES (2 * (size_t)model.n_arguments)
#define AT_NEXT_Z (AT_STAGES + 6 * (size_t)model.n_x) /* beyond four stages and two states */
#define AT_STEP_U (AT_NEXT_Z + model.n_z)
#define AT_SWITCHES (AT_STEP_U + model.n_u)
#define N_STEPPING (AT_SWITCHES + 4 * (size_t)model.n_switches)
/* Of a directional derivative, beyond what sampling takes: gradients of wind, then seeds of x, u, w, rates, outputs. */
#define AT_DIRECTION AT_STEP_U
#define AT_SEEDS (AT_DIRECTION + 12 * (size_t)model.n_w)
#define N_DIRECTION (AT_SEEDS + 2 * (size_t)model.n_x + model.n_u + model.n_w + model.n_y)

/* The interface's: hands a message to the importer's logger. */
void deliver(const instance *m, const char *text);

/* instance.c */
/* resources: path of a folder, or NULL. Returns NULL after an error. */
instance *create(const char *name, const char *token, const char *resources, int model_exchange, void *environment,
                 void (*logger)(void));
void destroy(instance *m);
int report(instance *m, const char *format, ...); /* logs an error, after which the instance has failed; returns 1 */
int set_text(instance *m, size_t i, const char *text);
int restart(instance *m);

/* evaluation.c */
int look_up(instance *m, const casadi_real **arg, int purpose); /* those it is for; the first time all */
void inputs_at(instance *m, const double *u, double begin, double time); /* u: those at the step's begin */
int sample(instance *m, const double *u, double begin);
void start(instance *m);
int open_boxes(instance *m);
int begun(instance *m); /* states have their initial values */
int refresh(instance *m, int purposes); /* brings rates, outputs, indicators up to date, whichever are asked for */

/* integration.c */
int integrate(instance *m, const double *u, double begin, double end);
void hold(const instance *m, const double *signs); /* the switches, from now on */
int differ(const instance *m, const double *now);  /* whether any switch's sign is not the one held */
int depart(const instance *m, const double *before, const double *after); /* zeros take the sign of after; 1 if any */

/* course.c: function is the name of the caller, for messages */
int set_up(instance *m, const char *function, double begin, int has_stop, double stop);
int begin_initialisation(instance *m, const char *function);
int end_initialisation(instance *m, const char *function);
void terminate(instance *m);
int step(instance *m, const char *function, double now, double length);
/* model exchange */
int exchanged(instance *m, const char *function, mode first, mode last); /* reports any mode beside these */
int enter_event_mode(instance *m, const char *function);
int update_discrete(instance *m, const char *function, int *has_next, double *next);
int enter_continuous_mode(instance *m, const char *function);
int complete_step(instance *m, const char *function, int *event);
int set_time(instance *m, const char *function, double time);
int set_states(instance *m, const char *function, const double *x, size_t n);
int get_states(instance *m, const char *function, double *x, size_t n);
int get_nominals(instance *m, const char *function, double *nominals, size_t n);
int get_rates(instance *m, const char *function, double *rates, size_t n);
int get_indicators(instance *m, const char *function, double *indicators, size_t n);

/* variables.c */
int unknown(instance *m, const char *function, unsigned vr, const void *value); /* reports */
int set_value(instance *m, const char *function, int i, double value);
int set_string(instance *m, const char *function, size_t i, const char *text);
int set_slope(instance *m, const char *function, int i, int order, double value);

/* fmu_state.c */
int get_state(instance *m, void **state);
int set_state(instance *m, const void *state);
void free_state(instance *m, void **state);
size_t state_size(const void *state);
int write_state(instance *m, const void *state, void *bytes, size_t size);
int read_state(instance *m, const char *function, const void *bytes, size_t size, void **state);

/* directional.c: begin, seeds, evaluate (for rates or outputs or both), results */
int directional_begin(instance *m, const char *function);
int directional_seed(instance *m, const char *function, int i, double value);
int directional_evaluate(instance *m, const char *function, int purposes);
int directional_result(instance *m, const char *function, int i, double *value);

static inline int check(instance *m, const char *function, unsigned vr, variable_kind kind, const void *value)
{
    const int fine = value && vr < (unsigned)model.n_variables && model.variables[vr].kind == kind;
    return fine ? 0 : unknown(m, function, vr, value);
}

/* Brings variable i up to date. */
static inline int require(instance *m, int i)
{
    const variable_role role = model.variables[i].role;
    if (role <= INPUT || role == INDEPENDENT) return 0;
    if ((role == CALCULATED || role == STATE) && m->s.mode > INITIALISING) return 0;
    const int purpose = role == RATE ? FOR_RATES : role == INDICATOR ? FOR_SIGNS : FOR_OUTPUTS;
    return m->current & purpose ? 0 : refresh(m, purpose);
}

static inline double value_of(const instance *m, int i) { return i == AT_TIME ? m->s.time : m->values[i]; }

static inline int assign(instance *m, const char *function, int i, double value)
{
    const variable *v = &model.variables[i];
    if (v->role != INPUT || m->s.mode > CONTINUOUS || !isfinite(value) || value < v->min || value > v->max)
        return set_value(m, function, i, value);
    if (m->values[i] != value) m->current = 0;
    m->values[i] = value;
    return 0;
}

static inline void arguments_of(const instance *m, const double *t, const double *x, const casadi_real **arg)
{
    const double *v = m->values;
    arg[T] = t;
    arg[X] = x;
    arg[Z] = v + AT_Z;
    arg[U] = v + AT_U;
    arg[P] = v;
    arg[K] = v + AT_K;
    arg[W] = v + AT_W;
}

static inline void call(instance *m, const equation *e, const casadi_real **arg, double *first, double *second)
{
    const casadi_real *a[MAX_ARGUMENTS]; /* beyond what is set here: room for what CasADi passes inside */
    casadi_real *r[MAX_ARGUMENTS];
    memcpy(a, arg, N_ARGUMENTS * sizeof *arg);
    r[0] = first;
    r[1] = second;
    e->evaluate(a, r, m->iwork, m->work, 0);
}

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
