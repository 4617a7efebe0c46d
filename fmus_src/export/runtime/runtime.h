/* What the generated part of an FMU (model.c, equations.c) tells the runtime. */
#ifndef RUNTIME_H
#define RUNTIME_H

#include <stddef.h>

/* Not for other libraries, however this one is compiled: the C library has a `step` of its own, for one. */
#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility push(hidden)
#endif

/* As CasADi's generated code declares them. */
#ifndef casadi_real
#define casadi_real double
#endif
#ifndef casadi_int
#define casadi_int long long int
#endif

typedef int (*equation_function)(const casadi_real **arg, casadi_real **res, casadi_int *iw, casadi_real *w, int mem);
typedef int (*work_function)(casadi_int *arg, casadi_int *res, casadi_int *iw, casadi_int *w);

typedef struct {
    equation_function evaluate;
    work_function work;
} equation;

#define MAX_ARGUMENTS 256 /* arguments, and results, of an equation with what CasADi passes inside */
enum { T, X, Z, U, P, K, W, DX, DU, DW, N_ARGUMENTS }; /* argument order of the equations */

typedef enum { REAL, INTEGER, BOOLEAN } variable_kind;
typedef enum {
    FIXED_PARAMETER, TUNABLE_PARAMETER, INPUT, CALCULATED, OUTPUT, STATE, INDEPENDENT, RATE, INDICATOR
} variable_role;

typedef struct {
    const char *name;
    variable_kind kind;
    variable_role role;
    int size; /* elements of the declared variable if this is its first one, else 0 */
    double start, min, max, nominal;
} variable;

/* Lookups: operations on arguments -> results that are not plain expressions; STORED keeps the arguments as they are,
 * SWITCH whether they are above 0. */
typedef enum { TABLE, FIELD, IMPLICIT, STORED, SWITCH } lookup_kind;

typedef struct {
    const double *data; /* [tables][points][columns] */
    const int *which;   /* table of each argument */
    int arguments, points, columns;
    double first, spacing;
} table_data;

typedef struct {
    int points, string; /* number of points; index of the string variable that names the file */
} field_data;

typedef struct {
    const char *name;
    equation system; /* (y, a) -> r, dr/dy, dr/da (column-major) */
    equation guess;  /* a -> y */
    int unknowns, row, count;
} implicit_data;

/* What lookups are evaluated for; WITH_SWITCHES: the switches too, which stay as they are held without it. */
enum { FOR_RATES = 1, FOR_OUTPUTS = 2, FOR_UPDATE = 4, FOR_SIGNS = 8, WITH_SWITCHES = 16 };

typedef struct {
    lookup_kind kind;
    int uses; /* what needs it, of the above */
    int arguments, results;
    equation argument;         /* (t, x, z, u, p, k, w) -> arguments */
    equation argument_forward; /* the same, along a direction */
    const void *data;
} lookup;

typedef struct {
    const char *identifier, *guid;
    int n_variables, n_strings, n_lookups;
    int n_x, n_z, n_u, n_p, n_k, n_w, n_y, n_arguments; /* n_arguments: longest lookup argument */
    double internal_step, sample_time;                  /* sample_time 0: no sampled states */
    int sample_at_start, n_switches;
    const int *switches_at;                             /* their places in w */
    const variable *variables;                          /* order: p, k, u, y, x, z, time, rates, indicators */
    const char *const *string_names, *const *string_starts;
    const lookup *lookups;
    equation calculate, initial, derivatives, outputs, update, switches, forward;
} model_description;

extern const model_description model;

/* Turbulent wind boxes (TurbSim .bts). */
typedef struct wind_box wind_box;
/* A relative path is looked for in the folder (which ends with a separator, or is ""), then as it is. */
wind_box *wind_box_open(const char *folder, const char *path, char *message, size_t size);
void wind_box_close(wind_box *box);
/* Velocities (and, if not NULL, their derivatives by t, x, y, z: 12 per point) at points; 0 if all are inside. */
int wind_box_sample(const wind_box *box, double t, const double *points, int n, double *velocity, double *gradient,
                    char *message, size_t size);

void table_evaluate(const table_data *table, const double *x, double *result);
void table_forward(const table_data *table, const double *x, const double *dx, double *dresult);

#define IMPLICIT_MAX 8 /* unknowns and arguments of one implicit equation */
int implicit_evaluate(const implicit_data *data, const double *arguments, int warm, double *solution, casadi_int *iw,
                      casadi_real *work, char *message, size_t size);
int implicit_forward(const implicit_data *data, const double *arguments, const double *solution,
                     const double *darguments, double *dsolution, casadi_int *iw, casadi_real *work);

#if defined(__GNUC__) && !defined(_WIN32)
#pragma GCC visibility pop
#endif

#endif
