/* Newton's method with step halving for small implicit equations, warm-started from the last solution. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "runtime.h"

#define ITERATIONS 60
#define TOLERANCE 1e-12  /* on the residual's norm: residuals are scaled to order one */
#define ACCEPTABLE 1e-8  /* if round-off keeps it from falling further */
#define SMALLEST_STEP 1e-6

typedef struct {
    double r[IMPLICIT_MAX], by_y[IMPLICIT_MAX * IMPLICIT_MAX], by_a[IMPLICIT_MAX * IMPLICIT_MAX];
} linearisation;

static double evaluate(const implicit_data *d, const double *y, const double *a, linearisation *l, casadi_int *iw,
                       casadi_real *work)
{
    const casadi_real *arg[16] = {y, a};
    casadi_real *res[16] = {l->r, l->by_y, l->by_a};
    double sum = 0.0;
    d->system.evaluate(arg, res, iw, work, 0);
    for (int i = 0; i < d->unknowns; i++) sum += l->r[i] * l->r[i];
    return sqrt(sum);
}

/* Solve A x = b by Gaussian elimination with partial pivoting; A column-major, overwritten; b becomes x. */
static int linear_solve(int n, double *A, double *b)
{
    for (int c = 0; c < n; c++) {
        int pivot = c;
        for (int r = c + 1; r < n; r++)
            if (fabs(A[r + c * n]) > fabs(A[pivot + c * n])) pivot = r;
        if (!(fabs(A[pivot + c * n]) > 0.0)) return 1;
        for (int k = 0; k < n; k++) {
            double swap = A[c + k * n];
            A[c + k * n] = A[pivot + k * n];
            A[pivot + k * n] = swap;
        }
        double swap = b[c];
        b[c] = b[pivot];
        b[pivot] = swap;
        for (int r = c + 1; r < n; r++) {
            double factor = A[r + c * n] / A[c + c * n];
            for (int k = c; k < n; k++) A[r + k * n] -= factor * A[c + k * n];
            b[r] -= factor * b[c];
        }
    }
    for (int r = n - 1; r >= 0; r--) {
        for (int k = r + 1; k < n; k++) b[r] -= A[r + k * n] * b[k];
        b[r] /= A[r + r * n];
    }
    return 0;
}

static int newton(const implicit_data *d, const double *a, double *y, casadi_int *iw, casadi_real *work)
{
    linearisation now, next;
    double trial[IMPLICIT_MAX];
    double norm = evaluate(d, y, a, &now, iw, work);
    for (int i = 0; i < ITERATIONS && isfinite(norm); i++) {
        if (norm <= TOLERANCE) return 0;
        if (linear_solve(d->unknowns, now.by_y, now.r)) return 1;
        double scale = 1.0, trial_norm;
        for (;;) {
            for (int k = 0; k < d->unknowns; k++) trial[k] = y[k] - scale * now.r[k];
            trial_norm = evaluate(d, trial, a, &next, iw, work);
            if (trial_norm < norm) break;
            if (scale < SMALLEST_STEP) return norm <= ACCEPTABLE ? 0 : 1;
            scale *= 0.5;
        }
        memcpy(y, trial, d->unknowns * sizeof(double));
        now = next;
        norm = trial_norm;
    }
    return norm <= TOLERANCE ? 0 : 1;
}

int implicit_evaluate(const implicit_data *d, const double *arguments, int warm, double *solution, casadi_int *iw,
                      casadi_real *work, char *message, size_t size)
{
    for (int i = 0; i < d->count; i++) {
        const double *a = arguments + (size_t)i * d->row;
        double *y = solution + (size_t)i * d->unknowns;
        int failed = warm ? newton(d, a, y, iw, work) : 1;
        if (failed) { /* a fresh guess: at the first call, and when the motion outran the last solution */
            const casadi_real *arg[16] = {a};
            casadi_real *res[16] = {y};
            d->guess.evaluate(arg, res, iw, work, 0);
            failed = newton(d, a, y, iw, work);
        }
        if (failed) {
            snprintf(message, size, "implicit equation %s[%d] did not converge", d->name, i + 1);
            return 1;
        }
    }
    return 0;
}

/* dy = -(dr/dy)^-1 (dr/da) da */
int implicit_forward(const implicit_data *d, const double *arguments, const double *solution,
                     const double *darguments, double *dsolution, casadi_int *iw, casadi_real *work)
{
    for (int i = 0; i < d->count; i++) {
        linearisation l;
        const double *da = darguments + (size_t)i * d->row;
        double *dy = dsolution + (size_t)i * d->unknowns;
        evaluate(d, solution + (size_t)i * d->unknowns, arguments + (size_t)i * d->row, &l, iw, work);
        for (int r = 0; r < d->unknowns; r++) {
            dy[r] = 0.0;
            for (int k = 0; k < d->row; k++) dy[r] -= l.by_a[r + k * d->unknowns] * da[k];
        }
        if (linear_solve(d->unknowns, l.by_y, dy)) return 1;
    }
    return 0;
}
