/* A host for other platforms: steps the plant in FMI 3.0 with servo targets that wander, prints qpos.
 *
 *   cross_host LIBRARY TOKEN RESOURCES STEPS      references: ctrl 0 (8 values), qpos 11 (16 values)
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi3FunctionTypes.h"

#ifdef _WIN32
#include <windows.h>
#define OPEN(path) (void *)LoadLibraryA(path)
#define FIND(library, name) (void *)(uintptr_t)GetProcAddress((HMODULE)library, name)
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define FIND(library, name) dlsym(library, name)
#endif

static void *library;

static void *find(const char *name)
{
    void *found = FIND(library, name);
    if (found) return found;
    fprintf(stderr, "no %s\n", name);
    exit(2);
}

static void tell(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)e;
    fprintf(stderr, "%d %s %s\n", (int)status, category, message);
}

static void need(fmi3Status status)
{
    if (status != fmi3OK) exit(3);
}

int main(int count, char **words)
{
    static const double HOME[8] = {0, 0, 0, -1.57079, 0, 1.57079, -0.7853, 255};
    const unsigned ctrl_reference = 0, qpos_reference = 11;
    double ctrl[8], qpos[16], last;
    bool event, terminate, early;
    if (count != 5) return 2;
    library = OPEN(words[1]);
    if (!library) return fprintf(stderr, "%s cannot be loaded\n", words[1]), 2;
    fmi3InstantiateCoSimulationTYPE *instantiate = find("fmi3InstantiateCoSimulation");
    fmi3EnterInitializationModeTYPE *enter = find("fmi3EnterInitializationMode");
    fmi3ExitInitializationModeTYPE *leave = find("fmi3ExitInitializationMode");
    fmi3SetFloat64TYPE *set = find("fmi3SetFloat64");
    fmi3GetFloat64TYPE *get = find("fmi3GetFloat64");
    fmi3DoStepTYPE *step = find("fmi3DoStep");
    fmi3FreeInstanceTYPE *release = find("fmi3FreeInstance");
    fmi3Instance c = instantiate("plant", words[2], words[3], false, true, false, false, NULL, 0, NULL, tell, NULL);
    if (!c) return 3;
    need(enter(c, false, 0.0, 0.0, false, 0.0));
    need(leave(c));
    for (int i = 0; i < atoi(words[4]); i++) {
        const double phase = fabs(fmod(i / 1000.0 + 0.5, 2.0) - 1.0) - 0.5; /* a triangle of 2 s */
        for (int k = 0; k < 7; k++) ctrl[k] = HOME[k] + 0.4 * (phase + (k % 2 ? 0.1 : -0.1));
        ctrl[7] = 127.5 + 200.0 * phase;
        need(set(c, &ctrl_reference, 1, ctrl, 8));
        need(step(c, i * 0.001, 0.001, true, &event, &terminate, &early, &last));
    }
    need(get(c, &qpos_reference, 1, qpos, 16));
    for (int i = 0; i < 16; i++) printf("%.17g\n", qpos[i]);
    release(c);
    return 0;
}
