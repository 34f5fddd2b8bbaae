/* Threads that instantiate FMUs of FMI 2.0 at one moment, in a process that has done nothing before.
 *
 *   first LIBRARY TOKEN RESOURCES [LIBRARY TOKEN RESOURCES ...]
 */
#include <dlfcn.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2FunctionTypes.h"

enum { MOST = 16 };

static char **words;
static int count;
static atomic_int waiting, failed;

static void say(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                fmi2String message, ...)
{
    va_list more;
    (void)e, (void)name, (void)status, (void)category;
    va_start(more, message);
    vfprintf(stderr, message, more);
    va_end(more);
}

static const fmi2CallbackFunctions callbacks = {say, calloc, free, NULL, NULL};

static void *make(void *number)
{
    char **mine = words + 3 * (long)number;
    fmi2InstantiateTYPE *instantiate;
    fmi2FreeInstanceTYPE *release;
    void *library = dlopen(mine[0], RTLD_NOW | RTLD_LOCAL);
    *(void **)&instantiate = library ? dlsym(library, "fmi2Instantiate") : NULL;
    *(void **)&release = library ? dlsym(library, "fmi2FreeInstance") : NULL;
    atomic_fetch_add(&waiting, 1);
    while (atomic_load(&waiting) < count) continue;
    void *c = instantiate ? instantiate("it", fmi2CoSimulation, mine[1], mine[2], &callbacks, 0, 1) : NULL;
    if (c) release(c);
    else atomic_fetch_add(&failed, 1);
    return NULL;
}

int main(int given, char **all)
{
    pthread_t threads[MOST];
    words = all + 1;
    count = (given - 1) / 3;
    for (long i = 0; i < count; i++) pthread_create(&threads[i], NULL, make, (void *)i);
    for (int i = 0; i < count; i++) pthread_join(threads[i], NULL);
    return failed;
}
