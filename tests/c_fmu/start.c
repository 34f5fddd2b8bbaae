/* A small FMU in FMI 2.0 and 3.0 whose start depends on its input.
 *
 * y = g u + c, computed whenever it is read; x0 is the u that it had as it left initialization, and
 * tolerance what it was told, -1 if nothing. Its own g is 1, whatever its description says.
 */
#include <stdlib.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

enum { U, Y, X0, G, C, TOLERANCE, COUNT };

static double *create(void)
{
    double *v = calloc(COUNT, sizeof *v);
    v[G] = 1, v[TOLERANCE] = -1;
    return v;
}
static void read_values(double *v, const unsigned *r, size_t n, double *to)
{
    v[Y] = v[G] * v[U] + v[C];
    for (size_t i = 0; i < n; i++) to[i] = v[r[i]];
}
static void write_values(double *v, const unsigned *r, size_t n, const double *from)
{
    for (size_t i = 0; i < n; i++) v[r[i]] = from[i];
}
static void leave(double *v) { v[X0] = v[U]; }

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String folder,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                              fmi2Boolean logging)
{
    (void)name, (void)type, (void)guid, (void)folder, (void)callbacks, (void)visible, (void)logging;
    return create();
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean is_told, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean d, fmi2Real e)
{
    (void)start, (void)d, (void)e;
    if (is_told) ((double *)c)[TOLERANCE] = tolerance;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return leave(c), fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[])
{
    return read_values(c, r, n, v), fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[])
{
    return write_values(c, r, n, v), fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean keep)
{
    return (void)c, (void)time, (void)size, (void)keep, fmi2OK;
}

const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String folder,
    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
    const fmi3ValueReference r[], size_t n, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)token, (void)folder, (void)visible, (void)logging, (void)events, (void)early;
    (void)r, (void)n, (void)environment, (void)log, (void)update;
    return create();
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean is_told, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean d, fmi3Float64 e)
{
    return fmi2SetupExperiment(c, is_told, tolerance, start, d, e) ? fmi3Error : fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return leave(c), fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[],
                          size_t nv)
{
    return (void)nv, read_values(c, r, n, v), fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n,
                          const fmi3Float64 v[], size_t nv)
{
    return (void)nv, write_values(c, r, n, v), fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean keep,
                      fmi3Boolean *event, fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last)
{
    (void)c, (void)keep;
    *event = *end = *early = fmi3False, *last = time + size;
    return fmi3OK;
}
