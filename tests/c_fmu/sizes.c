/* A small FMU in FMI 3.0 whose arrays have the size n, a structural parameter: y[i] = i * u[i] + t. */
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

enum { N, U, Y, MOST = 8 };

typedef struct {
    fmi3UInt64 n;
    int configuring;
    double u[MOST], time;
} sizes;

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String folder,
    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
    const fmi3ValueReference r[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)token, (void)folder, (void)visible, (void)logging, (void)events, (void)early;
    (void)r, (void)n, (void)environment, (void)log, (void)update;
    sizes *c = calloc(1, sizeof *c);
    c->n = 3;
    return c;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return ((sizes *)c)->configuring = 1, fmi3OK; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return ((sizes *)c)->configuring = 0, fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 start,
                                       fmi3Boolean d, fmi3Float64 e)
{
    (void)a, (void)b, (void)d, (void)e;
    return ((sizes *)c)->time = start, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3SetUInt64(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3UInt64 v[], size_t nv)
{
    sizes *c = i;
    if (!c->configuring || n != 1 || nv != 1 || r[0] != N || v[0] > MOST) return fmi3Error;
    return c->n = v[0], fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[], size_t nv)
{
    sizes *c = i;
    if (n != 1 || r[0] != U || nv != c->n) return fmi3Error;
    return memcpy(c->u, v, nv * sizeof *v), fmi3OK;
}
fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t nv)
{
    sizes *c = i;
    if (n != 1 || nv != c->n) return fmi3Error;
    for (size_t k = 0; k < nv; k++) v[k] = r[0] == U ? c->u[k] : (double)(k + 1) * c->u[k] + c->time;
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean keep, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last)
{
    (void)keep;
    *event = *end = *early = fmi3False, *last = time + size;
    return ((sizes *)c)->time = time + size, fmi3OK;
}
