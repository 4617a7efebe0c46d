/* Frames over a pair of pipes. */
#include "channel.h"

#include <stdlib.h>
#include <string.h>
#if defined(_WIN32)
#include <windows.h>
#else
#include <errno.h>
#include <unistd.h>
#endif

enum { FIRST_CAPACITY = 1 << 14 };
static const uint64_t LONGEST = (uint64_t)1 << 30; /* a longer frame comes from a process that overwrote its memory */

int reserve(unsigned char **buffer, size_t *capacity, size_t needed)
{
    if (needed <= *capacity) return 1;
    size_t larger = *capacity ? *capacity : FIRST_CAPACITY;
    while (larger < needed) larger *= 2;
    unsigned char *moved = realloc(*buffer, larger);
    if (!moved) return 0;
    *buffer = moved;
    *capacity = larger;
    return 1;
}

/* Bytes moved, 0 at the end of the pipe or on an error. */
static size_t move(intptr_t pipe, void *bytes, size_t count, int writing)
{
#if defined(_WIN32)
    DWORD done = 0, wanted = count > 0x10000000 ? 0x10000000 : (DWORD)count;
    const BOOL fine = writing ? WriteFile((HANDLE)pipe, bytes, wanted, &done, NULL)
                              : ReadFile((HANDLE)pipe, bytes, wanted, &done, NULL);
    return fine ? done : 0;
#else
    for (;;) {
        const ssize_t done = writing ? write((int)pipe, bytes, count) : read((int)pipe, bytes, count);
        if (done >= 0) return (size_t)done;
        if (errno != EINTR) return 0;
    }
#endif
}

int send_frame(Channel *c)
{
    const uint64_t size = c->used;
    memcpy(c->sent, &size, sizeof size);
    for (size_t done = 0, moved; done < c->used; done += moved) {
        moved = move(c->to, c->sent + done, c->used - done, 1);
        if (moved == 0) return 0;
    }
    c->used = 0;
    return 1;
}

int receive_frame(Channel *c)
{
    uint64_t size = sizeof size;
    c->received_size = 0;
    while (c->received_size < size) {
        if (!reserve(&c->received, &c->received_capacity, size)) return 0;
        const size_t room = c->received_capacity - c->received_size;
        const size_t moved = move(c->from, c->received + c->received_size, room, 0);
        if (moved == 0) return 0;
        const int had_size = c->received_size >= sizeof size;
        c->received_size += moved;
        if (!had_size && c->received_size >= sizeof size) {
            memcpy(&size, c->received, sizeof size);
            if (size < sizeof(Answer) || size > LONGEST) return 0;
        }
    }
    return 1;
}

EXPORT Channel *channel_open(intptr_t from, intptr_t to)
{
    Channel *c = calloc(1, sizeof *c);
    if (!c) return NULL;
    c->from = from;
    c->to = to;
    return c;
}

EXPORT void channel_close(Channel *c)
{
    free(c->sent);
    free(c->received);
    free(c);
}
