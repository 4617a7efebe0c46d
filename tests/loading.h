/* What these tests' drivers share: loading an FMU's library on any system, its functions by name, printing loggers. */
#include <stdio.h>
#include <stdlib.h>

#include "fmi2FunctionTypes.h"
#include "fmi3FunctionTypes.h"

#ifdef _WIN32
#include <windows.h>
static void *library;
static void *symbol(const char *name) { return (void *)GetProcAddress(library, name); }
static int load(const char *path) { return (library = (void *)LoadLibraryA(path)) != NULL; }
#else
#include <dlfcn.h>
static void *library;
static void *symbol(const char *name) { return dlsym(library, name); }
static int load(const char *path) { return (library = dlopen(path, RTLD_NOW | RTLD_LOCAL)) != NULL; }
#endif

#define F2(name) ((fmi2##name##TYPE *)symbol("fmi2" #name))
#define F3(name) ((fmi3##name##TYPE *)symbol("fmi3" #name))

static void logger2(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String c, fmi2String m, ...)
{
    (void)e, (void)name, (void)s, (void)c;
    printf("%s\n", m);
}
