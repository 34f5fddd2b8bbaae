/* The start: makes a model and its initial state from the parameters. */
#include <math.h>
#include <string.h>

#include "mujoco_fields.h"
#include "mujoco_model.h"

static const double LARGEST_OVERLAP = 1e-4; /* [m]; bodies at rest overlap less */
static const double SKY = 1000.0;           /* [m] height from which rays are cast downwards */
static const double PER_METRE = 1e9;        /* heights are rounded to nanometres: ray casting rounds, too */

/* ---- model fields ---- */

/* The shape stays the same, so the inertia is proportional to the mass. */
static void put_mass(mjModel *m, int body, double mass)
{
    const double ratio = mass / m->body_mass[body];
    for (int i = 0; i < 3; i++) m->body_inertia[3 * body + i] *= ratio;
    m->body_mass[body] = mass;
}

/* Fields scaled by a factor, and their numbers per body or actuator. */
static const struct {
    source_kind kind;
    const char *field;
    int width;
} SCALED[] = {{SOURCE_SCALED_MASS, "body_mass", 1},
              {SOURCE_SCALED_MASS, "body_inertia", 3},
              {SOURCE_SCALED_SERVO, "actuator_gainprm", mjNGAIN},
              {SOURCE_SCALED_SERVO, "actuator_biasprm", mjNBIAS},
              {SOURCE_SCALED_FORCE, "actuator_forcerange", 2}};
enum { SCALED_COUNT = sizeof SCALED / sizeof SCALED[0] };

static void put_scaled(mjModel *m, const source *s, const double *factors)
{
    for (int row = 0; row < SCALED_COUNT; row++) {
        if (SCALED[row].kind != s->kind) continue;
        const int width = SCALED[row].width;
        size_t size;
        double *field = model_field(m, SCALED[row].field, &size);
        for (int i = 0; i < s->number_count; i++)
            for (int k = 0; k < width; k++) field[width * s->numbers[i] + k] *= factors[i];
    }
}

static void put_added(const source *s, const double *more)
{
    for (unsigned i = 0; i < s->variable->size; i++) s->place[i] += more[i];
}

/* Returns whether a parameter belongs to the model. */
static bool put_in_model(const fmu *f, mujoco_model *model, const source *s)
{
    const double *from = f->values + s->variable->reference;
    if (s->variable->causality != FMU_PARAMETER) return false;
    if (s->kind == SOURCE_MODEL) memcpy(s->place, from, s->variable->size * sizeof *from);
    else if (s->kind == SOURCE_BODY_MASS) put_mass(model->m, s->first, *from);
    else if (s->kind == SOURCE_ADDED) put_added(s, from);
    else if (s->kind >= SOURCE_SCALED_MASS) put_scaled(model->m, s, from);
    else return false;
    return true;
}

void start_put_tunable(fmu *f, mujoco_model *model)
{
    for (int i = 0; i < model->source_count; i++)
        if (model->sources[i].variable->variability == FMU_TUNABLE)
            put_in_model(f, model, &model->sources[i]);
}

static void put_all_in_model(fmu *f, mujoco_model *model)
{
    bool any = false;
    for (int i = 0; i < model->source_count; i++) any |= put_in_model(f, model, &model->sources[i]);
    if (any) mj.mj_setConst(model->m, model->d); /* constants that MuJoCo derives at qpos0 */
}

/* ---- free bodies ---- */

/* Whether a geom is rigidly attached to the body. */
static bool is_part(const mjModel *m, int geom, int body)
{
    return geom >= 0 && m->body_weldid[m->geom_bodyid[geom]] == body;
}

static bool can_touch(const mjModel *m, int a, int b)
{
    return (m->geom_contype[a] & m->geom_conaffinity[b]) || (m->geom_contype[b] & m->geom_conaffinity[a]);
}

/* How far a geom reaches down from its centre, along the unit vector `up` given in its own axes. */
static double reach_down(const mjModel *m, int geom, const double up[3])
{
    const double *size = m->geom_size + 3 * geom, *box = m->geom_aabb + 6 * geom;
    switch (m->geom_type[geom]) {
    case mjGEOM_SPHERE: return size[0];
    case mjGEOM_CAPSULE: return size[0] + fabs(up[2]) * size[1];
    case mjGEOM_CYLINDER: return size[0] * sqrt(fmax(0.0, 1.0 - up[2] * up[2])) + fabs(up[2]) * size[1];
    case mjGEOM_ELLIPSOID:
        return sqrt(up[0] * up[0] * size[0] * size[0] + up[1] * up[1] * size[1] * size[1] +
                    up[2] * up[2] * size[2] * size[2]);
    default: { /* its bounding box */
        double reach = 0.0;
        for (int i = 0; i < 3; i++) reach += fabs(up[i]) * box[3 + i] - up[i] * box[i];
        return reach;
    }
    }
}

/* Height of the body's origin above its lowest point, in the body's own axes. */
static double height_above_ground(const mjModel *m, const mjData *d, int body)
{
    double lowest = 0.0;
    const double *xmat = d->xmat + 9 * body;
    bool any = false;
    for (int geom = 0; geom < m->ngeom; geom++) {
        if (!is_part(m, geom, body) || !(m->geom_contype[geom] | m->geom_conaffinity[geom])) continue;
        double up[3] = {0}, centre = 0.0; /* the body's z axis in the geom's axes; the geom's height */
        for (int i = 0; i < 3; i++) {
            const double z = xmat[3 * i + 2];
            centre += z * (d->geom_xpos[3 * geom + i] - d->xpos[3 * body + i]);
            for (int k = 0; k < 3; k++) up[k] += z * d->geom_xmat[9 * geom + 3 * i + k];
        }
        const double bottom = centre - reach_down(m, geom, up);
        lowest = any ? fmin(lowest, bottom) : bottom;
        any = true;
    }
    return -lowest;
}

/* Height of a static geom's surface at (x, y); false if there is none. */
static bool surface_at(const mjModel *m, const mjData *d, int geom, double x, double y, double *height)
{
    const double from[3] = {x, y, SKY}, down[3] = {0.0, 0.0, -1.0};
    const double *pos = d->geom_xpos + 3 * geom, *mat = d->geom_xmat + 9 * geom;
    double distance;
    if (m->geom_type[geom] == mjGEOM_PLANE) { /* infinite; its size is only for rendering */
        if (!(mat[8] > 0.0)) return false;
        *height = pos[2] - (mat[2] * (x - pos[0]) + mat[5] * (y - pos[1])) / mat[8];
        return true;
    }
    if (m->geom_type[geom] == mjGEOM_MESH) distance = mj.mj_rayMesh(m, d, geom, from, down, NULL);
    else if (m->geom_type[geom] == mjGEOM_HFIELD) distance = mj.mj_rayHfield(m, d, geom, from, down, NULL);
    else distance = mj.mju_rayGeom(pos, mat, m->geom_size + 3 * geom, from, down, m->geom_type[geom], NULL);
    *height = SKY - distance;
    return distance >= 0.0;
}

/* Whether a body can stand on a geom: a named one, or any static one that it can touch. */
static bool can_stand_on(const mjModel *m, const source *s, int geom)
{
    for (int i = 0; i < s->number_count; i++)
        if (s->numbers[i] == geom) return true;
    if (s->number_count > 0 || m->body_weldid[m->geom_bodyid[geom]] != 0) return false;
    for (int part = 0; part < m->ngeom; part++)
        if (is_part(m, part, s->first) && can_touch(m, geom, part)) return true;
    return false;
}

/* Height at which the body stands on the highest geom there; false if there is none. */
static bool standing_height(const mjModel *m, const mjData *d, const source *s, const double xy[2], double *height)
{
    double top = -SKY, surface;
    for (int geom = 0; geom < m->ngeom; geom++)
        if (can_stand_on(m, s, geom) && surface_at(m, d, geom, xy[0], xy[1], &surface)) top = fmax(top, surface);
    *height = round((top + height_above_ground(m, d, s->first)) * PER_METRE) / PER_METRE;
    return top > -SKY;
}

static double *free_joint(mujoco_model *model, int body)
{
    return model->d->qpos + model->m->jnt_qposadr[model->m->body_jntadr[body]];
}

static void place_free_body(const fmu *f, mujoco_model *model, const source *s)
{
    double *qpos = free_joint(model, s->first), height;
    const double *from = f->values + s->variable->reference;
    if (s->kind == SOURCE_FREE_YAW) {
        qpos[3] = cos(*from / 2);
        qpos[4] = qpos[5] = 0.0;
        qpos[6] = sin(*from / 2);
        return;
    }
    qpos[0] = from[0];
    qpos[1] = from[1];
    if (s->stand && standing_height(model->m, model->d, s, from, &height)) qpos[2] = height;
}

static const char *geom_name(const mjModel *m, int geom)
{
    if (geom < 0) return "a flex";
    const char *name = m->names + m->name_geomadr[geom];
    return *name ? name : m->names + m->name_bodyadr[m->geom_bodyid[geom]];
}

static fmu_status refuse_overlap(fmu *f, const mujoco_model *model, const source *s)
{
    const mjModel *m = model->m;
    const double *xy = f->values + s->variable->reference;
    for (int i = 0; i < model->d->ncon; i++) {
        const mjContact *contact = &model->d->contact[i];
        const bool first = is_part(m, contact->geom[0], s->first), second = is_part(m, contact->geom[1], s->first);
        if (first == second || contact->dist >= -LARGEST_OVERLAP) continue;
        return fmu_error(f, "%s: the body '%s' at (%g, %g) m would start %.1f mm inside '%s'; choose a free place",
                         s->variable->name, m->names + m->name_bodyadr[s->first], xy[0], xy[1],
                         -1000.0 * contact->dist, geom_name(m, contact->geom[first ? 1 : 0]));
    }
    return FMU_OK;
}

/* ---- the start ---- */

static void put_start_state(const fmu *f, mujoco_model *model)
{
    mjData *d = model->d;
    if (model->key >= 0) mj.mj_resetDataKeyframe(model->m, d, model->key);
    else mj.mj_resetData(model->m, d);
    d->time = f->start_time;
    mj.mj_kinematics(model->m, d);
    for (int i = 0; i < model->source_count; i++) {
        const source *s = &model->sources[i];
        const double *from = f->values + s->variable->reference;
        const size_t size = s->variable->size * sizeof *from;
        if (s->kind == SOURCE_QPOS) memcpy(d->qpos + s->first, from, size);
        if (s->kind == SOURCE_QVEL) memcpy(d->qvel + s->first, from, size);
        if (s->kind == SOURCE_FREE_XY || s->kind == SOURCE_FREE_YAW) place_free_body(f, model, s);
    }
}

fmu_status start_from_parameters(fmu *f, mujoco_model *model)
{
    put_all_in_model(f, model);
    put_start_state(f, model);
    mj.mj_forward(model->m, model->d);
    for (int i = 0; i < model->source_count; i++)
        if (model->sources[i].clear && refuse_overlap(f, model, &model->sources[i]) != FMU_OK) return FMU_ERROR;
    memset(model->d->qacc_warmstart, 0, (size_t)model->m->nv * sizeof(double));
    return FMU_OK;
}
