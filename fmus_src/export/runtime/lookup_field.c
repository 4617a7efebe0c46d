/* Turbulent wind from a TurbSim full-field file (.bts), frozen turbulence carried downwind at the mean speed.
 *
 * The rules are those of the Python twin (fmus_src/aero/turbsim_file.py), which states how they follow InflowWind;
 * tower points are not read: below the grid the lowest row holds.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "runtime.h"

/* File positions: the long of fseek has 32 bits on Windows, too few for a file above 2 GB. */
#ifdef _WIN32
#include <wchar.h>
#define SEEK _fseeki64
#define TELL _ftelli64
typedef int64_t file_position;
#else
#define SEEK fseek
#define TELL ftell
typedef long file_position;
#endif

#define GRID_TOLERANCE 1e-3
#define HEADER_BYTES 70
#define MAX_TEXT 4096
#define MAX_GRID_POINTS 1000000

struct wind_box {
    int32_t nz, ny, nt, tower;
    int periodic;
    float dz, dy, dt, mean_speed, hub_height, z_bottom;
    float scale[3], offset[3];
    int16_t *data; /* [nt][nz][ny][3] */
};

static int fail(char *message, size_t size, const char *path, const char *what)
{
    snprintf(message, size, "wind file '%s': %s", path, what);
    return 1;
}

static int read_header(wind_box *b, FILE *f, const char *path, char *message, size_t size)
{
    unsigned char h[HEADER_BYTES];
    int16_t id;
    int32_t text;
    if (fread(h, 1, HEADER_BYTES, f) != HEADER_BYTES) return fail(message, size, path, "is shorter than a .bts header");
    memcpy(&id, h, 2);
    memcpy(&b->nz, h + 2, 4);
    memcpy(&b->ny, h + 6, 4);
    memcpy(&b->tower, h + 10, 4);
    memcpy(&b->nt, h + 14, 4);
    memcpy(&b->dz, h + 18, 24);
    for (int c = 0; c < 3; c++) {
        memcpy(&b->scale[c], h + 42 + 8 * c, 4);
        memcpy(&b->offset[c], h + 46 + 8 * c, 4);
    }
    memcpy(&text, h + 66, 4);
    if (id != 7 && id != 8) return fail(message, size, path, "is not a TurbSim full-field file (identifier 7 or 8)");
    b->periodic = id == 8;
    int sane = b->nz > 1 && b->ny > 1 && b->nt > 1 && b->nz <= MAX_GRID_POINTS && b->ny <= MAX_GRID_POINTS
               && (int64_t)b->nz * b->ny <= MAX_GRID_POINTS && b->tower >= 0 && b->tower <= MAX_GRID_POINTS
               && text >= 0 && text <= MAX_TEXT
               && b->dt > 0 && b->dy > 0 && b->dz > 0 && b->mean_speed > 0 && b->z_bottom >= 0 && isfinite(b->dt)
               && isfinite(b->dy) && isfinite(b->dz) && isfinite(b->mean_speed) && isfinite(b->z_bottom);
    for (int c = 0; c < 3; c++) sane = sane && isfinite(b->offset[c]) && isfinite(b->scale[c]) && b->scale[c] != 0.0f;
    if (!sane) return fail(message, size, path, "has a corrupt header; make it again");
    if (SEEK(f, text, SEEK_CUR)) return fail(message, size, path, "ends within its header");
    return 0;
}

static int read_data(wind_box *b, FILE *f, const char *path, char *message, size_t size)
{
    size_t grid = (size_t)b->nz * b->ny * 3, tower = (size_t)b->tower * 3;
    file_position begin = TELL(f);
    if (begin < 0 || SEEK(f, 0, SEEK_END)) return fail(message, size, path, "cannot be read");
    file_position end = TELL(f);
    /* Checked before allocating, so that a corrupt header cannot ask for all memory. */
    if ((double)(end - begin) < (double)b->nt * (double)(grid + tower) * 2.0)
        return fail(message, size, path, "is truncated: it holds less data than its header says");
    if (SEEK(f, begin, SEEK_SET)) return fail(message, size, path, "cannot be read");
    b->data = malloc((size_t)b->nt * grid * sizeof(int16_t));
    if (!b->data) return fail(message, size, path, "does not fit into memory");
    for (int32_t i = 0; i < b->nt; i++) {
        if (fread(b->data + (size_t)i * grid, sizeof(int16_t), grid, f) != grid
            || SEEK(f, (file_position)(2 * tower), SEEK_CUR))
            return fail(message, size, path, "is truncated");
    }
    return 0;
}

/* FMI's texts are UTF-8; fopen of Windows wants the code page of the machine. */
#ifdef _WIN32
__declspec(dllimport) int __stdcall MultiByteToWideChar(unsigned, unsigned long, const char *, int, wchar_t *, int);

static FILE *open_file(const char *path)
{
    wchar_t wide[MAX_TEXT];
    const unsigned utf8 = 65001;
    return MultiByteToWideChar(utf8, 8, path, -1, wide, MAX_TEXT) ? _wfopen(wide, L"rb") : fopen(path, "rb");
}
#else
static FILE *open_file(const char *path) { return fopen(path, "rb"); }
#endif

static FILE *open_within(const char *folder, const char *path)
{
    const int relative = path[0] != '/' && path[0] != '\\' && path[1] != ':';
    char *full = folder[0] && relative ? malloc(strlen(folder) + strlen(path) + 1) : NULL;
    if (!full) return NULL;
    strcpy(full, folder);
    strcat(full, path);
    FILE *f = open_file(full);
    free(full);
    return f;
}

wind_box *wind_box_open(const char *folder, const char *path, char *message, size_t size)
{
    FILE *f = open_within(folder, path);
    if (!f) f = open_file(path);
    if (!f) {
        fail(message, size, path, "cannot be opened; check the path");
        return NULL;
    }
    wind_box *b = calloc(1, sizeof *b);
    if (!b) fail(message, size, path, "does not fit into memory");
    else if (read_header(b, f, path, message, size) || read_data(b, f, path, message, size)) {
        wind_box_close(b);
        b = NULL;
    }
    fclose(f);
    return b;
}

void wind_box_close(wind_box *b)
{
    if (!b) return;
    free(b->data);
    free(b);
}

/* The cell and the weight of a grid position; 1 if it lies outside. */
static int locate_in_box(double s, int n, int *cell, double *weight)
{
    if (!(s >= -GRID_TOLERANCE && s <= n - 1 + GRID_TOLERANCE)) return 1;
    if (s < 0.0) s = 0.0;
    if (s > n - 1) s = n - 1;
    *cell = (int)s;
    if (*cell > n - 2) *cell = n - 2;
    *weight = s - *cell;
    return 0;
}

static int locate_time(const wind_box *b, double time, int *first, int *second, double *weight)
{
    double s = time / b->dt;
    if (!b->periodic) {
        if (locate_in_box(s, b->nt, first, weight)) return 1;
        *second = *first + 1;
        return 0;
    }
    if (!isfinite(s)) return 1;
    s = fmod(s, b->nt); /* exact, whatever dt a corrupt header gives */
    if (s < 0.0) s += b->nt;
    *first = (int)s < b->nt ? (int)s : b->nt - 1;
    *second = (*first + 1) % b->nt;
    *weight = s - *first;
    return 0;
}

int wind_box_sample(const wind_box *b, double t, const double *points, int n, double *velocity, double *gradient,
                    char *message, size_t size)
{
    const double half = 0.5 * (b->ny - 1), offset = b->periodic ? 0.0 : half * b->dy / b->mean_speed;
    const size_t row = (size_t)b->ny * 3, plane = row * b->nz;
    const double inverse_speed = 1.0 / b->mean_speed, inverse_dy = 1.0 / b->dy, inverse_dz = 1.0 / b->dz;
    for (int i = 0; i < n; i++, points += 3, velocity += 3) {
        double fy, fz, ft, height = points[2] > b->z_bottom ? points[2] : b->z_bottom;
        int j, k, first, second;
        if (gradient) memset(gradient + 12 * i, 0, 12 * sizeof(double));
        if (points[2] <= 0.0) {
            memset(velocity, 0, 3 * sizeof(double));
            continue;
        }
        if (locate_time(b, t - points[0] * inverse_speed + offset, &first, &second, &ft)) {
            snprintf(message, size,
                     "the wind file covers %g s and does not repeat; make a longer one or end the run earlier",
                     (b->nt - 1) * (double)b->dt);
            return 1;
        }
        if (locate_in_box(points[1] * inverse_dy + half, b->ny, &j, &fy)
            || locate_in_box((height - b->z_bottom) * inverse_dz, b->nz, &k, &fz)) {
            snprintf(message, size, "point y = %g m, z = %g m lies outside the wind file's grid; make it wider",
                     points[1], points[2]);
            return 1;
        }
        const int16_t *a = b->data + first * plane + k * row + 3 * j, *c = b->data + second * plane + k * row + 3 * j;
        for (int d = 0; d < 3; d++, a++, c++) {
            double inverse = 1.0 / b->scale[d];
            double a0 = a[0] + fy * (a[3] - a[0]), a1 = a[row] + fy * (a[row + 3] - a[row]);
            double c0 = c[0] + fy * (c[3] - c[0]), c1 = c[row] + fy * (c[row + 3] - c[row]);
            double early = a0 + fz * (a1 - a0), late = c0 + fz * (c1 - c0);
            velocity[d] = (early + ft * (late - early) - b->offset[d]) * inverse;
            if (gradient) {
                double *g = gradient + 12 * i + 4 * d, ey = a[3] - a[0], fyy = c[3] - c[0];
                ey += fz * (a[row + 3] - a[row] - ey);
                fyy += fz * (c[row + 3] - c[row] - fyy);
                g[0] = (late - early) / b->dt * inverse;
                g[1] = -g[0] * inverse_speed;
                g[2] = (ey + ft * (fyy - ey)) * inverse_dy * inverse;
                const double difference = (a1 - a0) + ft * ((c1 - c0) - (a1 - a0));
                g[3] = points[2] > b->z_bottom ? difference * inverse_dz * inverse : 0.0;
            }
        }
    }
    return 0;
}
