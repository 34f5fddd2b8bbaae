/* Sources: which elements of the model and its data the variables read and write. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "mujoco_fields.h"
#include "mujoco_model.h"

/* What follows the first word: a field or a kind of object (f), a number (n), more numbers (*), flags (w); and
 * the causalities that it is valid for. */
static const struct {
    const char *word, *follows;
    bool input, output, parameter;
} KINDS[] = {
    [SOURCE_DATA] = {"data", "fn", true, true, false},
    [SOURCE_HELD] = {"held", "fn", false, true, false},
    [SOURCE_JACOBIAN] = {"jac", "fn*", false, true, false},
    [SOURCE_MASS_MATRIX] = {"mass_matrix", "*", false, true, false},
    [SOURCE_CONTACT_SENSORS] = {"contact_sensors", "*", false, true, false},
    [SOURCE_CONTACT_BODIES] = {"contact_bodies", "n*", false, true, false},
    [SOURCE_UNWANTED_CONTACTS] = {"unwanted_contacts", "n*", false, true, false},
    [SOURCE_SUPPORT_CONTACTS] = {"support_contacts", "n*", false, true, false},
    [SOURCE_WARNINGS] = {"warnings", "", false, true, false},
    [SOURCE_MOTORS] = {"motors", "n", true, false, false},
    [SOURCE_EQ_ACTIVE] = {"eq_active", "n", true, false, false},
    [SOURCE_MODEL] = {"model", "fn", false, true, true},
    [SOURCE_SCENE] = {"scene", "", false, false, true},
    [SOURCE_KEYFRAME] = {"keyframe", "", false, false, true},
    [SOURCE_BODY_MASS] = {"body_mass", "n", false, false, true},
    [SOURCE_QPOS] = {"qpos", "n", false, false, true},
    [SOURCE_QVEL] = {"qvel", "n", false, false, true},
    [SOURCE_FREE_XY] = {"free_xy", "nw", false, false, true},
    [SOURCE_FREE_YAW] = {"free_yaw", "n", false, false, true},
    [SOURCE_ADDED] = {"added", "fn", false, false, true},
    [SOURCE_SCALED_MASS] = {"scaled_mass", "*", false, false, true},
    [SOURCE_SCALED_SERVO] = {"scaled_servo", "*", false, false, true},
    [SOURCE_SCALED_FORCE] = {"scaled_force", "*", false, false, true},
};
enum { KIND_COUNT = sizeof KINDS / sizeof KINDS[0] };

/* Numbers to the end of the text, or to a word. */
static bool read_numbers(source *s, const char **text)
{
    s->numbers = calloc(strlen(*text) + 1, sizeof *s->numbers);
    if (!s->numbers) return false;
    while (fmu_next_int(text, &s->numbers[s->number_count])) s->number_count++;
    return true;
}

/* [clear] [stand [GEOM...]] */
static bool read_flags(source *s, const char **text)
{
    char word[FIELD_SIZE];
    const char *at = *text;
    if (fmu_next_word(&at, word, sizeof word) && !strcmp(word, "clear")) {
        s->clear = true;
        *text = at;
    }
    at = *text;
    if (fmu_next_word(&at, word, sizeof word) && !strcmp(word, "stand")) {
        s->stand = true;
        *text = at;
    }
    return !s->stand || read_numbers(s, text);
}

static bool read_source(source *s)
{
    const fmu_variable *v = s->variable;
    const char *text = v->source;
    char word[FIELD_SIZE];
    int kind = 0;
    if (!fmu_next_word(&text, word, sizeof word)) return false;
    while (kind < KIND_COUNT && strcmp(word, KINDS[kind].word) != 0) kind++;
    if (kind == KIND_COUNT) return false;
    s->kind = (source_kind)kind;
    if (!(v->causality == FMU_INPUT ? KINDS[kind].input
          : v->causality == FMU_PARAMETER ? KINDS[kind].parameter : KINDS[kind].output)) return false;
    if (kind >= SOURCE_ADDED && v->variability == FMU_TUNABLE) return false; /* relative: set only once */
    for (const char *c = KINDS[kind].follows; *c; c++) {
        if (*c == 'f' && !fmu_next_word(&text, s->field, sizeof s->field)) return false;
        if (*c == 'n' && !fmu_next_int(&text, &s->first)) return false;
        if (*c == '*' && !(read_numbers(s, &text) && s->number_count)) return false;
        if (*c == 'w' && !read_flags(s, &text)) return false;
    }
    return text[strspn(text, " ")] == '\0';
}

fmu_status sources_read(fmu *f, mujoco_model *model)
{
    model->sources = calloc(f->table->count, sizeof *model->sources);
    if (!model->sources) return fmu_error(f, "out of memory");
    for (unsigned i = 0; i < f->table->count; i++) {
        const fmu_variable *v = &f->table->variables[i];
        if (v->causality == FMU_INDEPENDENT) continue;
        source *s = &model->sources[model->source_count++];
        s->variable = v;
        if (!read_source(s)) return fmu_error(f, "%s: '%s' is not a source", v->name, v->source);
        if (v->causality != FMU_INPUT) continue;
        s->followed = calloc(v->size, sizeof *s->followed);
        if (!s->followed) return fmu_error(f, "out of memory");
        memcpy(s->followed, v->start, v->size * sizeof *v->start);
    }
    return FMU_OK;
}

void sources_free(mujoco_model *model)
{
    for (int i = 0; i < model->source_count; i++) {
        free(model->sources[i].numbers);
        free(model->sources[i].weights);
        free(model->sources[i].ranks);
        free(model->sources[i].followed);
    }
    free(model->sources);
    free(model->scratch);
}

/* ---- elements in a new model ---- */

static bool is_within(int id, mjtSize count) { return id >= 0 && id < count; }

static bool are_within(const source *s, mjtSize count)
{
    for (int i = 0; i < s->number_count; i++)
        if (!is_within(s->numbers[i], count)) return false;
    return true;
}

static bool bind_field(source *s, mujoco_model *model)
{
    size_t size = 0;
    const bool of_model = s->kind == SOURCE_MODEL || s->kind == SOURCE_ADDED;
    mjtNum *field = of_model ? model_field(model->m, s->field, &size)
                             : data_field(model->m, model->d, s->field, &size);
    if (!field || s->first < 0 || (size_t)s->first + s->variable->size > size) return false;
    s->place = field + s->first;
    return true;
}

static bool bind_jacobian(const source *s, const mjModel *m)
{
    const mjtSize count = !strcmp(s->field, "geom") ? m->ngeom
                          : !strcmp(s->field, "site") ? m->nsite
                          : !strcmp(s->field, "body") || !strcmp(s->field, "bodycom") ? m->nbody : 0;
    return is_within(s->first, count) && are_within(s, m->nv) &&
           s->variable->size == 6 * (unsigned)s->number_count;
}

/* The normal force is the first of the three numbers per contact of a contact sensor. */
static bool bind_contact_sensors(source *s, const mjModel *m)
{
    if (!are_within(s, m->nsensor) || s->variable->size != 1) return false;
    free(s->weights);
    s->weights = calloc((size_t)m->nsensordata + 1, sizeof *s->weights);
    for (int i = 0; s->weights && i < s->number_count; i++) {
        const int sensor = s->numbers[i], begin = m->sensor_adr[sensor];
        if (m->sensor_type[sensor] != mjSENS_CONTACT || m->sensor_dim[sensor] % 3) return false;
        for (int k = begin; k < begin + m->sensor_dim[sensor]; k += 3) s->weights[k] = 1.0;
    }
    return s->weights != NULL;
}

/* Of two bodies that touch, the higher rank decides: see plant/plant.py. */
enum { MOVABLE, FIXED, BLOCK, FINGER, ARM, FINGERS = 2 };

static int rank_of(const source *s, const mjModel *m, int body)
{
    for (int i = 0; i < s->number_count; i++)
        if (body == s->numbers[i]) return i < FINGERS ? FINGER : ARM;
    if (body == s->first) return BLOCK;
    return m->body_weldid[body] == 0 ? FIXED : MOVABLE;
}

static bool bind_ranks(source *s, const mjModel *m)
{
    if (!is_within(s->first, m->nbody) || !are_within(s, m->nbody) || s->variable->size != 1) return false;
    free(s->ranks);
    s->ranks = calloc((size_t)m->ngeom + 1, sizeof *s->ranks);
    for (int geom = 0; s->ranks && geom < m->ngeom; geom++) s->ranks[geom] = rank_of(s, m, m->geom_bodyid[geom]);
    return s->ranks != NULL;
}

static bool is_free_body(const mjModel *m, int body)
{
    return is_within(body, m->nbody) && m->body_jntnum[body] == 1 &&
           m->jnt_type[m->body_jntadr[body]] == mjJNT_FREE;
}

/* Older versions have no `nactuator`: an actuator has one control there. */
static mjtSize actuator_count(mujoco_model *model)
{
    size_t size = 0;
    model_field(model->m, "actuator_biasprm", &size);
    return (mjtSize)(size / mjNBIAS);
}

static bool bind(source *s, mujoco_model *model)
{
    const mjModel *m = model->m;
    const mjtSize size = s->variable->size;
    switch (s->kind) {
    case SOURCE_DATA: case SOURCE_HELD: case SOURCE_MODEL: case SOURCE_ADDED: return bind_field(s, model);
    case SOURCE_SCALED_MASS: return are_within(s, m->nbody) && size == s->number_count;
    case SOURCE_SCALED_SERVO: case SOURCE_SCALED_FORCE:
        return are_within(s, actuator_count(model)) && size == s->number_count;
    case SOURCE_JACOBIAN: return bind_jacobian(s, m);
    case SOURCE_MASS_MATRIX:
        return are_within(s, m->nv) && size == (mjtSize)s->number_count * s->number_count;
    case SOURCE_CONTACT_SENSORS: return bind_contact_sensors(s, m);
    case SOURCE_CONTACT_BODIES:
        return is_within(s->first, m->nbody) && are_within(s, m->nbody) && size == 1;
    case SOURCE_UNWANTED_CONTACTS: case SOURCE_SUPPORT_CONTACTS: return bind_ranks(s, m);
    case SOURCE_WARNINGS: return size == mjWARN_BADQPOS;
    case SOURCE_MOTORS: return s->first >= 0 && s->first + size <= m->nu && actuator_count(model) == m->nu;
    case SOURCE_EQ_ACTIVE: return is_within(s->first, m->neq) && size == 1;
    case SOURCE_SCENE: case SOURCE_KEYFRAME: return size == 1;
    case SOURCE_BODY_MASS: return is_within(s->first, m->nbody) && m->body_mass[s->first] > 0.0 && size == 1;
    case SOURCE_QPOS: return s->first >= 0 && s->first + size <= m->nq;
    case SOURCE_QVEL: return s->first >= 0 && s->first + size <= m->nv;
    case SOURCE_FREE_XY: return is_free_body(m, s->first) && are_within(s, m->ngeom) && size == 2;
    case SOURCE_FREE_YAW: return is_free_body(m, s->first) && size == 1;
    }
    return false;
}

fmu_status sources_bind(fmu *f, mujoco_model *model)
{
    const size_t nv = (size_t)model->m->nv;
    free(model->scratch);
    model->scratch = calloc((nv + 6) * nv + 1, sizeof *model->scratch);
    if (!model->scratch) return fmu_error(f, "out of memory");
    for (int i = 0; i < model->source_count; i++) {
        const fmu_variable *v = model->sources[i].variable;
        if (!bind(&model->sources[i], model))
            return fmu_error(f, "%s: the model has no '%s' of %u elements", v->name, v->source, v->size);
    }
    return FMU_OK;
}

/* ---- values ---- */

/* Writes torques to the actuators that are motors (force equals control); the others keep their controls. */
static void put_torques(const fmu *f, const mujoco_model *model, const source *s)
{
    for (unsigned i = 0; i < s->variable->size; i++) {
        const int actuator = s->first + (int)i;
        if (model->m->actuator_biastype[actuator] == mjBIAS_NONE)
            model->d->ctrl[actuator] = f->values[s->variable->reference + i];
    }
}

/* Whether an input of mjData acts in the first half of a step, as poses do. */
static bool acts_early(const source *s)
{
    return strcmp(s->field, "ctrl") != 0 && strcmp(s->field, "qfrc_applied") != 0 &&
           strcmp(s->field, "xfrc_applied") != 0;
}

bool sources_put_inputs(fmu *f, mujoco_model *model)
{
    bool any = false;
    for (int i = 0; i < model->source_count; i++) {
        const source *s = &model->sources[i];
        const double *from = f->values + s->variable->reference;
        const size_t size = s->variable->size * sizeof *from;
        if (s->variable->causality != FMU_INPUT) continue;
        if (s->kind == SOURCE_EQ_ACTIVE) {
            any |= model->d->eq_active[s->first] != (*from != 0.0);
            model->d->eq_active[s->first] = *from != 0.0;
        } else if (s->kind == SOURCE_MOTORS) {
            put_torques(f, model, s);
        } else {
            any |= acts_early(s) && memcmp(s->place, from, size) != 0;
            memcpy(s->place, from, size);
        }
    }
    return any;
}

/* The table's start values are those of one keyframe. When another is chosen, inputs that still have these,
 * or those of a keyframe that was chosen before, take its values, within their bounds. */
void sources_follow_keyframe(fmu *f, mujoco_model *model)
{
    for (int i = 0; i < model->source_count; i++) {
        const source *s = &model->sources[i];
        const fmu_variable *v = s->variable;
        if (v->causality != FMU_INPUT || s->kind != SOURCE_DATA) continue;
        for (unsigned k = 0; k < v->size; k++) {
            double *value = f->values + v->reference + k;
            if (*value != v->start[k] && *value != s->followed[k]) continue;
            *value = model->key == model->own_key ? v->start[k] : fmin(fmax(s->place[k], v->minimum[k]), v->maximum[k]);
            s->followed[k] = *value;
        }
    }
}

/* Selected columns of a Jacobian, linear rows above angular ones. */
static void get_jacobian(const source *s, mujoco_model *model, double *to)
{
    const int nv = (int)model->m->nv;
    double *linear = model->scratch, *angular = linear + 3 * nv;
    if (!strcmp(s->field, "body")) mj.mj_jacBody(model->m, model->d, linear, angular, s->first);
    else if (!strcmp(s->field, "bodycom")) mj.mj_jacBodyCom(model->m, model->d, linear, angular, s->first);
    else if (!strcmp(s->field, "geom")) mj.mj_jacGeom(model->m, model->d, linear, angular, s->first);
    else mj.mj_jacSite(model->m, model->d, linear, angular, s->first);
    for (int row = 0; row < 6; row++)
        for (int i = 0; i < s->number_count; i++) *to++ = linear[row * nv + s->numbers[i]];
}

static void get_mass_matrix(const source *s, mujoco_model *model, double *to)
{
    const int nv = (int)model->m->nv;
    mj.mj_fullM(model->m, model->d, model->scratch);
    for (int row = 0; row < s->number_count; row++)
        for (int i = 0; i < s->number_count; i++)
            *to++ = model->scratch[s->numbers[row] * nv + s->numbers[i]];
}

void sources_get_outputs(fmu *f, mujoco_model *model)
{
    const bool has_stepped = f->steps > 0;
    for (int i = 0; i < model->source_count; i++) {
        const source *s = &model->sources[i];
        double *to = f->values + s->variable->reference;
        if (s->variable->causality != FMU_OUTPUT && s->variable->causality != FMU_LOCAL) continue;
        if (!s->variable->was_read) continue; /* matrices take time */
        if (s->kind == SOURCE_DATA || s->kind == SOURCE_MODEL || (s->kind == SOURCE_HELD && has_stepped))
            memcpy(to, s->place, s->variable->size * sizeof(double));
        else if (s->kind == SOURCE_JACOBIAN)
            get_jacobian(s, model, to);
        else if (s->kind == SOURCE_MASS_MATRIX)
            get_mass_matrix(s, model, to);
        else if (s->kind == SOURCE_CONTACT_SENSORS && has_stepped)
            *to = mj.mju_dot(s->weights, model->d->sensordata, (int)model->m->nsensordata);
    }
}

/* Whether the contact is between the first body and one of the others. */
static bool is_between_bodies(const mjModel *m, const source *s, const mjContact *contact)
{
    const int a = m->geom_bodyid[contact->geom[0]], b = m->geom_bodyid[contact->geom[1]];
    const int other = a == s->first ? b : a;
    if (a != s->first && b != s->first) return false;
    for (int i = 0; i < s->number_count; i++)
        if (s->numbers[i] == other) return true;
    return false;
}

/* Whether the contact is one that nobody wants, or one that supports the block. */
static bool is_of_its_kind(const source *s, const mjContact *contact)
{
    static const double UPRIGHT = 0.7071067811865476; /* vertical part of a normal 45 deg from vertical */
    const int a = s->ranks[contact->geom[0]], b = s->ranks[contact->geom[1]];
    const int high = a > b ? a : b, low = a > b ? b : a;
    const bool unwanted = s->kind == SOURCE_UNWANTED_CONTACTS;
    if (high == BLOCK) return (fabs(contact->frame[2]) < UPRIGHT) == unwanted;
    return unwanted && (high == ARM || (high == FINGER && low == FIXED));
}

static bool is_of_contacts(const source *s)
{
    return s->kind == SOURCE_CONTACT_BODIES || s->ranks != NULL;
}

static bool counts(const mjModel *m, const source *s, const mjContact *contact)
{
    if (contact->geom[0] < 0 || contact->geom[1] < 0) return false; /* of a flex */
    return s->ranks ? is_of_its_kind(s, contact) : is_between_bodies(m, s, contact);
}

void sources_get_contacts(fmu *f, mujoco_model *model)
{
    for (int i = 0; i < model->source_count; i++) {
        const source *s = &model->sources[i];
        if (!is_of_contacts(s)) continue;
        double force[6], sum = 0.0;
        for (int k = 0; k < model->d->ncon; k++) {
            if (!counts(model->m, s, &model->d->contact[k])) continue;
            mj.mj_contactForce(model->m, model->d, k, force);
            sum += force[0];
        }
        f->values[s->variable->reference] = sum;
    }
}

/* The kinds before mjWARN_BADQPOS; what follows these ends the simulation. */
void sources_count_warnings(fmu *f, mujoco_model *model)
{
    for (int i = 0; i < model->source_count; i++) {
        const source *s = &model->sources[i];
        for (int k = 0; s->kind == SOURCE_WARNINGS && k < mjWARN_BADQPOS; k++)
            f->values[s->variable->reference + (unsigned)k] += model->d->warning[k].number - model->warned[k];
    }
    for (int k = 0; k < mjNWARNING; k++) model->warned[k] = model->d->warning[k].number;
}

void sources_clear_held(fmu *f, mujoco_model *model)
{
    for (int i = 0; i < model->source_count; i++) {
        const source *s = &model->sources[i];
        if (s->kind == SOURCE_HELD || s->kind == SOURCE_CONTACT_SENSORS || s->kind == SOURCE_WARNINGS || is_of_contacts(s))
            memset(f->values + s->variable->reference, 0, s->variable->size * sizeof(double));
    }
}
