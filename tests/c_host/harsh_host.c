/* A host that makes it hard: floating-point exceptions trap, threads have small stacks, the library is closed
 * and opened again while nothing else of it is in use.
 *
 *   harsh_host LIBRARY TOKEN RESOURCES ROUNDS
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fenv.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi3FunctionTypes.h"

enum { STACK = 256 * 1024, THREADS = 8 };

static char **words;

static void tell(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)e;
    fprintf(stderr, "%d %s %s\n", (int)status, category, message);
}

static void run(void *library)
{
    fmi3InstantiateCoSimulationTYPE *instantiate;
    fmi3EnterInitializationModeTYPE *enter;
    fmi3ExitInitializationModeTYPE *leave;
    fmi3DoStepTYPE *step;
    fmi3FreeInstanceTYPE *release;
    bool event, terminate, early;
    double last;
    *(void **)&instantiate = dlsym(library, "fmi3InstantiateCoSimulation");
    *(void **)&enter = dlsym(library, "fmi3EnterInitializationMode");
    *(void **)&leave = dlsym(library, "fmi3ExitInitializationMode");
    *(void **)&step = dlsym(library, "fmi3DoStep");
    *(void **)&release = dlsym(library, "fmi3FreeInstance");
    fmi3Instance c = instantiate("it", words[2], words[3], false, true, false, false, NULL, 0, NULL, tell, NULL);
    if (!c || enter(c, false, 0.0, 0.0, false, 0.0) != fmi3OK || leave(c) != fmi3OK) exit(3);
    for (int i = 0; i < 50; i++)
        if (step(c, i * 0.001, 0.001, true, &event, &terminate, &early, &last) != fmi3OK) exit(4);
    release(c);
}

static void *round_of_a_thread(void *unused)
{
    feenableexcept(FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW);
    void *library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) exit(2);
    run(library);
    dlclose(library);
    if (fegetexcept() != (FE_DIVBYZERO | FE_INVALID | FE_OVERFLOW)) exit(5); /* the host's, as before */
    return unused;
}

int main(int count, char **given)
{
    pthread_attr_t small;
    pthread_t threads[THREADS];
    if (count != 5) return 2;
    words = given;
    pthread_attr_init(&small);
    pthread_attr_setstacksize(&small, STACK);
    for (int i = 0; i < atoi(words[4]); i++) {
        round_of_a_thread(NULL);
        for (int k = 0; k < THREADS; k++) pthread_create(&threads[k], &small, round_of_a_thread, NULL);
        for (int k = 0; k < THREADS; k++) pthread_join(threads[k], NULL);
    }
    puts("whole");
    return 0;
}
