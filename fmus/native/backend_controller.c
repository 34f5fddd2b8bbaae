/* PandaController: the control law in C. ../README.md describes the table. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "controller_law.h"
#include "mujoco_library.h"

/* Quaternions of length SHORTEST to LONGEST are used unchanged; below ZERO_LENGTH they count as zero. */
static const double SHORTEST = 1.0 - 5e-7, LONGEST = 1.0 + 5e-7, ZERO_LENGTH = 1e-3;
static const double PERIOD_TOLERANCE = 1e-9; /* [s] */

/* ---- variables and their offsets in the law's struct ---- */

typedef struct {
    const char *name;
    size_t place;
    unsigned size;
} field;

#define FIELD(part, name) \
    {#name, offsetof(controller, part name), sizeof(((controller *)0)->part name) / sizeof(double)}
static const field FIELDS[] = {
    FIELD(inputs., pos_cmd), FIELD(inputs., quat_cmd), FIELD(inputs., vel_cmd), FIELD(inputs., omega_cmd),
    FIELD(inputs., grip_cmd), FIELD(inputs., posture_cmd), FIELD(inputs., posture_vel_cmd),
    FIELD(inputs., hand_xpos), FIELD(inputs., hand_xquat), FIELD(inputs., jac),
    FIELD(inputs., qpos), FIELD(inputs., qvel), FIELD(inputs., qfrc_bias), FIELD(inputs., actuator_force), FIELD(inputs., force_cmd),
    FIELD(outputs., ctrl), FIELD(outputs., dq), FIELD(outputs., qpos_ref), FIELD(outputs., qvel_ref),
    FIELD(outputs., manipulability), FIELD(outputs., singular), FIELD(outputs., limit),
    FIELD(outputs., external_torque), FIELD(outputs., external_force), FIELD(outputs., joint_contact), FIELD(outputs., motor_torque),
    FIELD(gains., use_reference), FIELD(gains., kp), FIELD(gains., ki), FIELD(gains., kd),
    FIELD(gains., derivative_filter), FIELD(gains., integral_limit), FIELD(gains., base_ctrl),
    FIELD(gains., ik_gain), FIELD(gains., error_filter), FIELD(gains., ik_damping),
    FIELD(gains., singular_damping), FIELD(gains., singular_value),
    FIELD(gains., linear_correction), FIELD(gains., linear_braking),
    FIELD(gains., angular_correction), FIELD(gains., angular_braking), FIELD(gains., posture),
    FIELD(gains., posture_gain), FIELD(gains., servo_lag), FIELD(gains., servo_stiffness),
    FIELD(gains., gravity_feedforward), FIELD(gains., inertia_feedforward), FIELD(gains., limit_share),
    FIELD(gains., reference_lead), FIELD(gains., finger_speed),
    FIELD(gains., grip_force), FIELD(gains., grip_width), FIELD(gains., grip_stiffness),
    FIELD(gains., reading_delay), FIELD(gains., follow_posture), FIELD(gains., posture_follow_gain),
    FIELD(gains., observer), FIELD(gains., observer_gain), FIELD(gains., lower_torque_threshold),
    FIELD(gains., upper_torque_threshold), FIELD(gains., reaction), FIELD(gains., robot), FIELD(gains., impedance),
    FIELD(gains., stiffness), FIELD(gains., spring_force), FIELD(gains., spring_torque), FIELD(gains., damping_ratio),
    FIELD(gains., offset_rate), FIELD(gains., offset_limit), FIELD(gains., posture_stiffness),
    FIELD(gains., posture_damping),
    FIELD(, period)};
enum { INPUTS = 0, OUTPUTS = 15, GAINS = 26, PERIOD = 72, FIELD_COUNT = sizeof FIELDS / sizeof *FIELDS };
_Static_assert(PERIOD + 1 == FIELD_COUNT, "the period is the last field");

/* ---- an instance ---- */

typedef struct {
    double last[4]; /* last valid one; zero: none yet */
    bool has_warned;
} orientation;

typedef struct {
    controller c;
    controller_mujoco mujoco; /* arm and data are the chosen robot's */
    mjModel *arms[ROBOTS];
    mjData *data[ROBOTS];
    int64_t period_steps; /* internal steps between two updates */
    orientation command, hand;
    unsigned references[FIELD_COUNT]; /* of the fields' variables */
} law;

typedef struct {
    controller_state state;
    double last_command[4], last_hand[4];
} saved;

static fmu_status find_fields(fmu *f, law *l)
{
    for (int i = 0; i < FIELD_COUNT; i++) {
        const fmu_variable *v = fmu_find(f->table, FIELDS[i].name);
        if (!v || v->size != FIELDS[i].size)
            return fmu_error(f, "the table lacks the variable %s of size %u", FIELDS[i].name, FIELDS[i].size);
        l->references[i] = v->reference;
    }
    return FMU_OK;
}

static void read_fields(const fmu *f, law *l, int first, int end)
{
    for (int i = first; i < end; i++)
        memcpy((char *)&l->c + FIELDS[i].place, f->values + l->references[i], FIELDS[i].size * sizeof(double));
}

static void write_outputs(const fmu *f, const law *l)
{
    for (int i = OUTPUTS; i < GAINS; i++)
        memcpy(f->values + l->references[i], (const char *)&l->c + FIELDS[i].place,
               FIELDS[i].size * sizeof(double));
}

/* ---- the arm ---- */

static const char *const ARM_FILES[ROBOTS] = {"panda.mjb", "fr3.mjb"};

static fmu_status make_data(fmu *f, void *unused)
{
    law *l = f->model;
    for (int i = 0; i < ROBOTS; i++) {
        const mjModel *arm = l->arms[i];
        if (arm->nv != ARM_DOFS || arm->nq != ARM_DOFS) return fmu_error(f, "%s is not the arm", ARM_FILES[i]);
        l->data[i] = mj.mj_makeData(arm);
        if (!l->data[i]) return fmu_error(f, "out of memory");
    }
    return FMU_OK;
}

static fmu_status create(fmu *f)
{
    law *l = f->model = calloc(1, sizeof *l);
    if (!l) return fmu_error(f, "out of memory");
    if (find_fields(f, l) != FMU_OK || mujoco_open(f) != FMU_OK) return FMU_ERROR;
#define X(name) .name = mj.name,
    l->mujoco.call = (controller_functions){CONTROLLER_FUNCTIONS(X)};
#undef X
    for (int i = 0; i < ROBOTS; i++)
        if (!(l->arms[i] = mujoco_load(f, ARM_FILES[i]))) return FMU_ERROR;
    return mujoco_guarded(f, make_data, NULL);
}

static void destroy(fmu *f)
{
    law *l = f->model;
    if (!l) return;
    for (int i = 0; i < ROBOTS; i++) {
        if (l->data[i]) mj.mj_deleteData(l->data[i]);
        if (l->arms[i]) mj.mj_deleteModel(l->arms[i]);
    }
    free(l);
}

/* ---- start and gains ---- */

static fmu_status tune(fmu *f)
{
    law *l = f->model;
    read_fields(f, l, GAINS, PERIOD);
    l->mujoco.arm = l->arms[(int)l->c.gains.robot - 1];
    l->mujoco.data = l->data[(int)l->c.gains.robot - 1];
    return FMU_OK;
}

static fmu_status start(fmu *f)
{
    law *l = f->model;
    const double step = f->table->step;
    read_fields(f, l, PERIOD, FIELD_COUNT);
    l->period_steps = llround(l->c.period / step);
    if (l->period_steps < 1 || fabs(l->c.period - (double)l->period_steps * step) > PERIOD_TOLERANCE)
        return fmu_error(f, "period: %g s must be a whole multiple of %g s", l->c.period, step);
    tune(f);
    controller_reset(&l->c);
    memset(l->hand.last, 0, sizeof l->hand.last); /* no measurement yet */
    memcpy(l->command.last, fmu_find(f->table, "quat_cmd")->start, sizeof l->command.last);
    write_outputs(f, l);
    return FMU_OK;
}

/* ---- steps ---- */

static void warn_once(fmu *f, orientation *o, const char *name, double length)
{
    if (o->has_warned) return;
    o->has_warned = true;
    if (length < ZERO_LENGTH)
        fmu_warn(f, "input %s is zero; the last valid one is used (logged once)", name);
    else
        fmu_warn(f, "input %s has length %g and is scaled to length 1 (logged once)", name, length);
}

/* Normalises a quaternion; replaces one of length 0 by the last valid one. */
static void normalize(fmu *f, orientation *o, const char *name, double quat[4])
{
    const double length = mj.mju_norm(quat, 4);
    if (!(SHORTEST < length && length < LONGEST)) warn_once(f, o, name, length);
    if (length < ZERO_LENGTH) {
        memcpy(quat, o->last, sizeof o->last);
        return;
    }
    if (!(SHORTEST < length && length < LONGEST))
        for (int i = 0; i < 4; i++) quat[i] /= length;
    memcpy(o->last, quat, sizeof o->last);
}

static bool is_zero(const double quat[4])
{
    return quat[0] == 0.0 && quat[1] == 0.0 && quat[2] == 0.0 && quat[3] == 0.0;
}

static fmu_status advance(fmu *f, void *count)
{
    law *l = f->model;
    const int64_t steps = *(const int64_t *)count;
    read_fields(f, l, INPUTS, OUTPUTS);
    normalize(f, &l->command, "quat_cmd", l->c.inputs.quat_cmd);
    normalize(f, &l->hand, "hand_xquat", l->c.inputs.hand_xquat);
    if (is_zero(l->hand.last)) return FMU_OK; /* some importers send zeros first; the law starts later */
    for (int64_t i = 0; i < steps; i++)
        if ((f->steps + i) % l->period_steps == 0) controller_update(&l->c, &l->mujoco);
    write_outputs(f, l);
    return FMU_OK;
}

static fmu_status step(fmu *f, int64_t count) { return mujoco_guarded(f, advance, &count); }

/* ---- state ---- */

static size_t state_size(fmu *f)
{
    return sizeof(saved);
}

static fmu_status get_state(fmu *f, void *bytes)
{
    const law *l = f->model;
    saved s = {.state = l->c.state};
    memcpy(s.last_command, l->command.last, sizeof s.last_command);
    memcpy(s.last_hand, l->hand.last, sizeof s.last_hand);
    memcpy(bytes, &s, sizeof s);
    return FMU_OK;
}

static fmu_status set_state(fmu *f, const void *bytes, size_t size)
{
    law *l = f->model;
    saved s;
    if (size != sizeof s) return fmu_error(f, "the state is one of another law");
    memcpy(&s, bytes, sizeof s);
    l->c.state = s.state;
    memcpy(l->command.last, s.last_command, sizeof s.last_command);
    memcpy(l->hand.last, s.last_hand, sizeof s.last_hand);
    read_fields(f, l, OUTPUTS, GAINS); /* a law does not write all of them */
    return tune(f);
}

const fmu_backend_functions fmu_backend = {
    .create = create, .destroy = destroy, .start = start, .tune = tune, .step = step,
    .state_size = state_size, .get_state = get_state, .set_state = set_state};
