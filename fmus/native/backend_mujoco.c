/* Any MuJoCo model. ../README.md describes the table. */
#include <stdlib.h>
#include <string.h>

#include "mujoco_fields.h"
#include "mujoco_model.h"

static const unsigned STATE = mjSTATE_INTEGRATION;

/* ---- models ---- */

static fmu_status load_scene(fmu *f, mujoco_model *model, const char *name)
{
    mjModel *m = mujoco_load(f, name);
    if (!m) return FMU_ERROR;
    model->scenes[model->scene_count++] = m;
    if (m->opt.timestep != f->table->step)
        return fmu_error(f, "%s has a timestep of %g s, the table a step of %g s", name, m->opt.timestep,
                         f->table->step);
    return model->own_key < m->nkey ? FMU_OK : fmu_error(f, "%s has no keyframe %d", name, model->own_key);
}

static fmu_status create(fmu *f)
{
    mujoco_model *model = f->model = calloc(1, sizeof *model);
    if (!model) return fmu_error(f, "out of memory");
    model->own_key = -1;
    if (mujoco_open(f) != FMU_OK || sources_read(f, model) != FMU_OK) return FMU_ERROR;
    const char *key = fmu_get_option(f->table, "key", 0), *name;
    if (key && !fmu_next_int(&key, &model->own_key)) return fmu_error(f, "the option 'key' is not a number");
    model->scenes = calloc(f->table->option_count + 1, sizeof *model->scenes);
    if (!model->scenes) return fmu_error(f, "out of memory");
    for (unsigned i = 0; (name = fmu_get_option(f->table, "model", i)) != NULL; i++)
        if (load_scene(f, model, name) != FMU_OK) return FMU_ERROR;
    return model->scene_count > 0 ? FMU_OK : fmu_error(f, "no model is named");
}

static fmu_status drop_copy(fmu *f, void *unused)
{
    mujoco_model *model = f->model;
    mjData *d = model->d;
    mjModel *m = model->m;
    model->d = NULL;
    model->m = NULL;
    if (d) mj.mj_deleteData(d);
    if (m) mj.mj_deleteModel(m);
    return FMU_OK;
}

static void destroy(fmu *f)
{
    mujoco_model *model = f->model;
    if (!model) return;
    if (model->m) mujoco_guarded(f, drop_copy, NULL);
    for (int i = 0; i < model->scene_count; i++) mj.mj_deleteModel(model->scenes[i]);
    free(model->scenes);
    sources_free(model);
    free(model);
}

/* ---- start ---- */

/* Index, from 0, of what an enumeration parameter of this kind chooses. */
static int chosen(const fmu *f, const mujoco_model *model, source_kind kind, int otherwise)
{
    for (int i = 0; i < model->source_count; i++)
        if (model->sources[i].kind == kind)
            return (int)f->values[model->sources[i].variable->reference] - 1;
    return otherwise;
}

/* Index, from 0, of the model that all parameters of the kind `scene` choose; the first varies fastest. */
static int chosen_scene(const fmu *f, const mujoco_model *model)
{
    int scene = 0, count = 1;
    for (int i = 0; i < model->source_count; i++) {
        const fmu_variable *v = model->sources[i].variable;
        if (model->sources[i].kind != SOURCE_SCENE) continue;
        scene += count * ((int)f->values[v->reference] - 1);
        count *= (int)*v->maximum;
    }
    return scene;
}

static fmu_status make(fmu *f, void *unused)
{
    mujoco_model *model = f->model;
    const int scene = chosen_scene(f, model);
    if (scene < 0 || scene >= model->scene_count)
        return fmu_error(f, "there are %d models, but model %d is chosen", model->scene_count, scene + 1);
    model->key = chosen(f, model, SOURCE_KEYFRAME, model->own_key + 1) - 1; /* the first choice is qpos0 */
    if (model->key >= model->scenes[scene]->nkey) return fmu_error(f, "there is no keyframe %d", model->key + 1);
    drop_copy(f, NULL);
    model->m = mj.mj_copyModel(NULL, model->scenes[scene]);
    model->d = model->m ? mj.mj_makeData(model->m) : NULL;
    if (!model->d) return fmu_error(f, "out of memory");
    if (sources_bind(f, model) != FMU_OK || start_from_parameters(f, model) != FMU_OK) return FMU_ERROR;
    sources_follow_keyframe(f, model);
    memset(model->d->warning, 0, sizeof model->d->warning); /* each instant counts once */
    mj.mj_step1(model->m, model->d); /* outputs follow from qpos and qvel, and the next step begins */
    sources_clear_held(f, model);
    memset(model->warned, 0, sizeof model->warned);
    sources_count_warnings(f, model);
    return FMU_OK;
}

static fmu_status start(fmu *f) { return mujoco_guarded(f, make, NULL); }

static fmu_status tune(fmu *f)
{
    start_put_tunable(f, f->model);
    return FMU_OK;
}

/* ---- steps ---- */

static fmu_status refuse_divergence(fmu *f, const mujoco_model *model, int64_t steps)
{
    static const struct {
        int warning;
        const char *name;
    } DIVERGED[] = {{mjWARN_BADQPOS, "qpos"}, {mjWARN_BADQVEL, "qvel"}, {mjWARN_BADQACC, "qacc"},
                    {mjWARN_BADCTRL, "ctrl"}};
    for (int i = 0; i < 4; i++) {
        const mjWarningStat *warning = &model->d->warning[DIVERGED[i].warning];
        if (warning->number)
            return fmu_error(f, "the physics diverged at t = %.3f s: %s[%d] is not finite or above 1e10",
                             f->start_time + (double)steps * f->table->step, DIVERGED[i].name,
                             warning->lastinfo);
    }
    return FMU_OK;
}

/* mj_step2 completes the step that mj_step1 started; Runge-Kutta takes a whole one. The next mj_step1 then
 * computes everything from the new positions, so both together cost one mj_step; it does not change results
 * of the completed step. */
static void step_once(fmu *f, mujoco_model *model, bool is_last)
{
    if (model->m->opt.integrator == mjINT_RK4) mj.mj_step(model->m, model->d);
    else mj.mj_step2(model->m, model->d);
    if (is_last) sources_get_contacts(f, model);
    mj.mj_step1(model->m, model->d);
}

static fmu_status advance(fmu *f, void *count)
{
    mujoco_model *model = f->model;
    const int64_t steps = *(const int64_t *)count;
    if (sources_put_inputs(f, model)) mj.mj_step1(model->m, model->d);
    for (int64_t i = 1; i <= steps; i++) {
        step_once(f, model, i == steps);
        if (refuse_divergence(f, model, f->steps + i) != FMU_OK) return FMU_ERROR;
    }
    sources_count_warnings(f, model);
    return FMU_OK;
}

static fmu_status step(fmu *f, int64_t count) { return mujoco_guarded(f, advance, &count); }

static fmu_status gather(fmu *f, void *unused)
{
    sources_get_outputs(f, f->model);
    return FMU_OK;
}

static fmu_status outputs(fmu *f) { return mujoco_guarded(f, gather, NULL); }

/* ---- state: MuJoCo's integration state; if bodies may sleep, all data, as what sleeps is not derived again ---- */

static bool may_sleep(const mujoco_model *model) { return model->m->opt.enableflags & mjENBL_SLEEP; }

static size_t state_size(fmu *f)
{
    const mujoco_model *model = f->model;
    if (may_sleep(model)) return data_size(model->d);
    return (size_t)mj.mj_stateSize(model->m, (int)STATE) * sizeof(double);
}

static fmu_status get_state(fmu *f, void *bytes)
{
    const mujoco_model *model = f->model;
    if (may_sleep(model)) return data_write(model->d, bytes), FMU_OK;
    double *physics = malloc(state_size(f) + 1); /* aligned */
    if (!physics) return fmu_error(f, "out of memory");
    mj.mj_getState(model->m, model->d, physics, (int)STATE);
    memcpy(bytes, physics, state_size(f));
    free(physics);
    return FMU_OK;
}

typedef struct {
    void *bytes; /* aligned */
    size_t size;
} saved_state;

static fmu_status put_state(fmu *f, void *argument)
{
    mujoco_model *model = f->model;
    const saved_state *saved = argument;
    if (may_sleep(model)) {
        const mjData *written = data_read(saved->bytes, saved->size, model->d);
        if (!written) return fmu_error(f, "the state is one of another model");
        mj.mj_copyData(model->d, model->m, written);
    } else {
        if (saved->size != state_size(f)) return fmu_error(f, "the state is one of another model");
        mj.mj_setState(model->m, model->d, saved->bytes, (int)STATE);
        mj.mj_step1(model->m, model->d);
    }
    memset(model->d->warning, 0, sizeof model->d->warning);
    memset(model->warned, 0, sizeof model->warned);
    return FMU_OK;
}

static fmu_status set_state(fmu *f, const void *bytes, size_t size)
{
    saved_state saved = {malloc(size + 1), size};
    if (!saved.bytes) return fmu_error(f, "out of memory");
    memcpy(saved.bytes, bytes, size);
    const fmu_status status = mujoco_guarded(f, put_state, &saved);
    free(saved.bytes);
    return status;
}

const fmu_backend_functions fmu_backend = {
    .create = create, .destroy = destroy, .start = start, .tune = tune, .step = step, .outputs = outputs,
    .state_size = state_size, .get_state = get_state, .set_state = set_state};
