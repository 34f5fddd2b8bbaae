/* Rows that end early: what is measured, and what follows. */
#include "player_guard.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The last output that moves forward with the rows, the hand's position being the first; NULL: there is none. */
static const fmu_variable *last_moving(const fmu *f)
{
    const char *name = fmu_get_option(f->table, "moving", 0);
    return name ? fmu_find(f->table, name) : NULL;
}

fmu_status guarded_create(fmu *f, guarded *g)
{
    const char *guards = fmu_get_option(f->table, "guards", 0), *left = fmu_get_option(f->table, "left", 0);
    size_t size, left_size;
    if (!guards || !left) return FMU_OK;
    g->guards = (player_guard *)(void *)fmu_read_resource(f, guards, &size);
    g->left = (double *)(void *)fmu_read_resource(f, left, &left_size);
    if (!g->guards || !g->left) return FMU_ERROR;
    g->count = size / sizeof *g->guards;
    if (size % sizeof *g->guards || left_size != 2 * g->row_count * sizeof(double))
        return fmu_error(f, "%s and %s do not fit the table", guards, left);
    for (size_t i = 0; i < g->count; i++)
        if (!(g->guards[i].first >= 0.0 && g->guards[i].last < (double)g->row_count))
            return fmu_error(f, "%s: row %zu is not in the table", guards, i);
    if (fmu_find(f->table, "pos_cmd[1]") && fmu_find(f->table, "vel_cmd[1]") && last_moving(f)) return FMU_OK;
    return fmu_error(f, "rows end early, but nothing commands the hand");
}

void guarded_free(guarded *g)
{
    free(g->guards);
    free(g->left);
}

/* Values of an input; NULL: there is none. */
static const double *input(const fmu *f, const char *name)
{
    const fmu_variable *v = fmu_find(f->table, name);
    return v ? f->values + v->reference : NULL;
}

/* Force along the way that explains the servos' torques best [N]. */
static double force_along(const fmu *f, const double way[3])
{
    const double *jac = input(f, "jac"), *torque = input(f, "actuator_force"), *bias = input(f, "qfrc_bias");
    double work = 0.0, square = 0.0;
    for (int joint = 0; joint < 7 && jac && torque && bias; joint++) {
        const double lever = jac[joint] * way[0] + jac[7 + joint] * way[1] + jac[14 + joint] * way[2];
        work += lever * (torque[joint] - bias[joint]);
        square += lever * lever;
    }
    return square > 0.0 ? work / square : 0.0;
}

static double contact(const fmu *f, const player_guard *guard, guard_state *s, int64_t since)
{
    const double force = force_along(f, guard->way);
    double sum = 0.0;
    if (since == 0) s->base = 0.0;
    if (since >= BASE_FROM && since < BASE_TO) s->base += force;
    s->felt[since % AVERAGED] = force;
    if (since < BASE_TO) return 0.0;
    for (int i = 0; i < AVERAGED; i++) sum += s->felt[i];
    return sum / (double)AVERAGED - s->base / (double)(BASE_TO - BASE_FROM);
}

static double measured(const fmu *f, const player_guard *guard, guard_state *s, int64_t place)
{
    const int element = (int)guard->element;
    const double *force = input(f, "external_force");
    if (element == 0) return contact(f, guard, s, place - (int64_t)guard->first - 1);
    if (!force) return 0.0;
    if (element < 7) return fabs(force[element - 1]);
    return sqrt(force[0] * force[0] + force[1] * force[1] + force[2] * force[2]);
}

/* Command of the hand at a tick, along an axis. */
static void command(const fmu *f, const guarded *g, int64_t tick, size_t axis, double *position, double *speed)
{
    const guard_state *s = &g->state;
    const size_t place = (size_t)fmin((double)(tick + s->ahead), (double)(g->row_count - 1));
    const double *row = g->rows + place * g->width + axis, *left = g->left + 2 * place;
    const double u = fmin(STEP * (double)(tick - s->ended) / BRAKING, 1.0), cube = u * u * u;
    const double way = u - cube + 0.5 * cube * u - 0.5, rate = 1.0 - 3.0 * u * u + 2.0 * cube;
    *position = row[fmu_find(f->table, "pos_cmd[1]")->reference - g->first] + left[0] * s->offset[axis];
    *position += way * (BRAKING * s->speed[axis]);
    *speed = row[fmu_find(f->table, "vel_cmd[1]")->reference - g->first] + left[1] * s->offset[axis];
    *speed += rate * s->speed[axis];
}

void guarded_look(const fmu *f, guarded *g, int64_t tick)
{
    const size_t hand = fmu_find(f->table, "pos_cmd[1]")->reference - g->first;
    guard_state *s = &g->state;
    for (size_t i = 0; i < g->count; i++) {
        const player_guard *guard = &g->guards[i];
        const int64_t place = tick + s->ahead, last = (int64_t)guard->last;
        if (place == last) memset(s->offset, 0, sizeof s->offset); /* it has not ended early */
        if (place <= (int64_t)guard->first || place >= last) continue;
        if (!(measured(f, guard, s, place) > guard->bound)) return;
        for (size_t axis = 0; axis < 3; axis++) {
            double now, speed;
            command(f, g, tick, axis, &now, &speed);
            s->offset[axis] = now + 0.5 * (BRAKING * speed) - g->rows[(size_t)last * g->width + hand + axis];
            s->speed[axis] = speed;
        }
        s->ended = tick;
        s->ahead = last - tick;
        return;
    }
}

void guarded_show(const fmu *f, const guarded *g, int64_t tick)
{
    const unsigned hand = fmu_find(f->table, "pos_cmd[1]")->reference;
    const size_t size = last_moving(f)->reference - hand + 1;
    double *position = f->values + hand, *velocity = f->values + fmu_find(f->table, "vel_cmd[1]")->reference;
    const size_t place = (size_t)fmin((double)(tick + g->state.ahead), (double)(g->row_count - 1));
    memcpy(position, g->rows + place * g->width + hand - g->first, size * sizeof(double));
    for (size_t axis = 0; axis < 3; axis++) command(f, g, tick, axis, position + axis, velocity + axis);
}
