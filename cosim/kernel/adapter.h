/* An instance of FMI 3.0 and what stands for it towards the kernel; arrays and work space are Python's. */
#ifndef ADAPTER_H
#define ADAPTER_H

#include "fmi3FunctionTypes.h"
#include "kernel.h"

enum { N_NUMERIC = 11 }; /* types, as NUMERIC_TYPES in adapter.c */

typedef struct {
    uint32_t reference;
    int32_t type, first, size; /* elements first, first + 1, ... of the FMU's */
} Array;

typedef struct {
    fmi3Instance fmu;
    Log *log;
    void *get[N_NUMERIC], *set[N_NUMERIC]; /* the FMU's functions, by type; NULL where it has none of it */
    fmi3DoStepTYPE *do_step;
    fmi3GetFMUStateTYPE *get_state;
    fmi3SetFMUStateTYPE *set_state;
    fmi3FreeFMUStateTYPE *free_state;
    fmi3GetDirectionalDerivativeTYPE *directional;
    const Array *arrays;
    const int32_t *array_of;              /* array of each element */
    double *values, *base, *slope, *bend; /* of each element: now; over a step, base + slope tau + bend tau^2 */
    uint32_t *moving;                     /* elements that have slopes in the next step, n_moving */
    double *seeds;
    void *typed;          /* room for every element in any type */
    uint32_t *references; /* work, as the rest: of arrays */
    uint32_t *known;
    int32_t *listed, *chosen;
    uint64_t *place;
    int64_t *seen; /* the round in which it was last listed */
    int64_t round;
    size_t n_moving;
    double begin; /* of the present step, s */
    fmi2Status failed; /* of an update */
} Adapter;

#endif
