/* A small FMU of FMI 3.0 with event mode, which holds the importer to its rules.
 *
 * x grows by `rate`, which doubles at an event every 0.25 s. `n` is a discrete input, which may only be set in event
 * mode once steps are taken; `seen` counts the events at which it was another one, `updates` all updates of discrete
 * states. `rough` is NaN before 0.2 s. `act` asks for something else: 1 ends within a step, at 0.35 s; 2 ends at the
 * event of 0.5 s; 3 wants an event without event mode; 4 never settles; 5 ends with the step to 0.3 s.
 */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

enum { X, N, SEEN, UPDATES, ROUGH, ACT };
enum mode { INITIALIZATION, EVENT, STEP };
static const double PERIOD = 0.25, ENOUGH = 1e-9; /* s */

typedef struct {
    double x, rate, time, next;
    int n, last, seen, updates, act, rounds;
    bool has_events, early, due;
    enum mode mode;
} model;

const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String folder, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference r[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    (void)name, (void)token, (void)folder, (void)visible, (void)logging, (void)r, (void)n;
    (void)environment, (void)log, (void)update;
    model *m = calloc(1, sizeof *m);
    m->rate = 1.0, m->next = PERIOD, m->has_events = events, m->early = early;
    return m;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 start,
                                       fmi3Boolean d, fmi3Float64 e)
{
    return (void)c, (void)a, (void)b, (void)start, (void)d, (void)e, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    model *m = c;
    m->mode = m->has_events ? EVENT : STEP;
    return m->last = m->n, fmi3OK;
}
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance c)
{
    model *m = c;
    if (!m->has_events || m->mode != STEP) return fmi3Error;
    return m->mode = EVENT, fmi3OK;
}
fmi3Status fmi3EnterStepMode(fmi3Instance c)
{
    model *m = c;
    if (m->mode != EVENT || m->due || m->rounds) return fmi3Error; /* not settled */
    return m->mode = STEP, fmi3OK;
}
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next)
{
    model *m = c;
    if (m->mode != EVENT) return fmi3Error;
    m->updates++;
    *nominals = *values = *end = false, *defined = true, *next = m->next;
    if (m->n != m->last) m->seen++, m->last = m->n;
    if (m->due) {
        m->due = false, m->rounds = 2, m->rate *= 2.0;
        *end = m->act == 2 && m->time > 0.4;
    }
    if (m->rounds && m->act != 4) m->rounds--;
    *again = m->rounds > 0;
    return fmi3OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean keep, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last)
{
    model *m = c;
    double to = time + size;
    (void)keep;
    if (m->mode != STEP || m->due || m->has_events != m->early || fabs(time - m->time) > ENOUGH) return fmi3Error;
    *event = *end = *early = false;
    if (m->act == 1 && to > 0.35 + ENOUGH) to = 0.35, *end = true;
    if (m->act == 5 && to > 0.3 - ENOUGH) *end = true;
    if (m->act == 3 && to > 0.3 + ENOUGH) *event = true;
    while (m->next < to - ENOUGH || (m->has_events && m->next < to + ENOUGH)) {
        m->x += m->rate * (m->next - m->time);
        m->time = m->next, m->next += PERIOD;
        if (m->has_events) {
            *event = m->due = true, *early = m->time < to - ENOUGH, *last = m->time;
            return fmi3OK;
        }
        m->rate *= 2.0;
    }
    m->x += m->rate * (to - m->time);
    m->time = to, *last = to;
    return fmi3OK;
}
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t k)
{
    const model *m = c;
    (void)k;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == X ? m->x : m->time < 0.2 - ENOUGH ? NAN : 1.0;
    return fmi3OK;
}
fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Int32 v[], size_t k)
{
    const model *m = c;
    (void)k;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == SEEN ? m->seen : r[i] == UPDATES ? m->updates : m->n;
    return fmi3OK;
}
fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Int32 v[], size_t k)
{
    model *m = c;
    (void)k;
    for (size_t i = 0; i < n; i++) {
        if (m->has_events && m->mode == STEP && v[i] != m->n) return fmi3Error;
        if (r[i] == N) m->n = v[i];
        else m->act = v[i];
    }
    return fmi3OK;
}
