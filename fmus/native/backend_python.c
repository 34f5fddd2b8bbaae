/* A slave class in Python, called through python_host.py in the resources.
 *
 * The host object works on the memory of `values`, so getting and setting values does not enter Python. Its
 * functions return None, or a list of messages (status, text); the worst status is that of the call. A
 * step that is discarded ends the simulation.
 */
#include <stdlib.h>
#include <string.h>

#include "python_library.h"

static const char HOST[] = "python_host.py";

typedef struct {
    python_object *start, *initialized, *tune, *step, *outputs, *take_texts, *give_texts, *get_state, *set_state, *terminate, *release;
    python_object *saved; /* bytes of the state, kept from state_size for get_state */
    bool has_texts;
} slave;

static void drop(python_object *object)
{
    if (object) py.Py_DecRef(object);
}

/* ---- messages ---- */

static fmu_status unexplained(fmu *f)
{
    py.PyErr_Clear();
    return fmu_error(f, "Python failed without giving a reason");
}

/* Logs (status, text); returns the status. */
static fmu_status tell(fmu *f, python_object *message)
{
    python_object *status = py.PyTuple_GetItem(message, 0), *text = py.PyTuple_GetItem(message, 1);
    const char *words = text ? py.PyUnicode_AsUTF8AndSize(text, NULL) : NULL;
    const long level = status ? py.PyLong_AsLong(status) : -1;
    if (!words || level < FMU_OK || level > FMU_FATAL) return unexplained(f);
    if (level > FMU_DISCARD) return fmu_error(f, "%s", words);
    if (level == FMU_WARNING) fmu_warn(f, "%s", words);
    else fmu_log(f, (fmu_status)level, words);
    return level == FMU_DISCARD ? FMU_DISCARD : FMU_OK;
}

/* Logs the messages that a call returned, and releases its result. */
static fmu_status conclude(fmu *f, python_object *result)
{
    if (!result) return unexplained(f);
    const python_size count = result == py.none ? 0 : py.PyList_Size(result);
    fmu_status status = FMU_OK;
    for (python_size i = 0; i < count; i++) {
        const fmu_status told = tell(f, py.PyList_GetItem(result, i));
        if (told > status) status = told;
    }
    drop(result);
    return status;
}

/* ---- the host object ---- */

static bool put(python_object *globals, const char *name, python_object *value)
{
    const bool success = value && py.PyDict_SetItemString(globals, name, value) == 0;
    drop(value);
    return success;
}

static bool take(python_object *globals, const char *name, python_object **place)
{
    *place = py.PyDict_GetItemString(globals, name);
    if (*place) py.Py_IncRef(*place);
    return *place != NULL;
}

/* Runs python_host.py, which defines the functions, and `messages` on failure. */
static fmu_status run_host(fmu *f, slave *s, const char *text)
{
    python_object *globals = py.PyDict_New();
    const python_size bytes = (python_size)(f->table->size * sizeof(double));
    const bool prepared =
        globals && put(globals, "__builtins__", py.PyImport_ImportModule("builtins")) &&
        put(globals, "__name__", py.PyUnicode_FromString("fmu_python_host")) &&
        put(globals, "VALUES", py.PyMemoryView_FromMemory((char *)f->values, bytes, PYTHON_WRITABLE)) &&
        put(globals, "RESOURCES", py.PyUnicode_FromString(f->resources));
    python_object *code = prepared ? py.Py_CompileString(text, HOST, PYTHON_FILE_INPUT) : NULL;
    python_object *done = code ? py.PyEval_EvalCode(code, globals, globals) : NULL, *messages = NULL;
    fmu_status status = done ? FMU_OK : unexplained(f);
    if (done && take(globals, "messages", &messages)) status = conclude(f, messages);
    if (status == FMU_OK &&
        !(take(globals, "start", &s->start) && take(globals, "initialized", &s->initialized) &&
          take(globals, "tune", &s->tune) &&
          take(globals, "step", &s->step) && take(globals, "outputs", &s->outputs) &&
          take(globals, "take_texts", &s->take_texts) && take(globals, "give_texts", &s->give_texts) &&
          take(globals, "get_state", &s->get_state) && take(globals, "set_state", &s->set_state) &&
          take(globals, "terminate", &s->terminate) && take(globals, "release", &s->release))) status = unexplained(f);
    drop(done);
    drop(code);
    drop(globals);
    return status;
}

static fmu_status create(fmu *f)
{
    size_t size;
    slave *s = f->model = calloc(1, sizeof *s);
    if (!s) return fmu_error(f, "out of memory");
    for (unsigned i = 0; i < f->table->count; i++) s->has_texts |= f->table->variables[i].type == FMU_STRING;
    char *text = fmu_read_resource(f, HOST, &size);
    if (!text || python_open(f) != FMU_OK) {
        free(text);
        return FMU_ERROR;
    }
    const int lock = py.PyGILState_Ensure();
    const fmu_status status = run_host(f, s, text);
    py.PyGILState_Release(lock);
    free(text);
    return status;
}

static void destroy(fmu *f)
{
    slave *s = f->model;
    if (!s) return;
    if (py.Py_IsInitialized && py.Py_IsInitialized()) { /* unless the host has finalized Python */
        const int lock = py.PyGILState_Ensure();
        if (s->release) conclude(f, py.PyObject_CallFunctionObjArgs(s->release, NULL));
        python_object *all[] = {s->start, s->initialized, s->tune, s->step, s->outputs, s->take_texts,
                                s->give_texts, s->get_state, s->set_state, s->terminate, s->release, s->saved};
        for (size_t i = 0; i < sizeof all / sizeof all[0]; i++) drop(all[i]);
        py.PyGILState_Release(lock);
    }
    free(s);
}

/* ---- calls ---- */

static fmu_status call(fmu *f, python_object *function)
{
    return conclude(f, py.PyObject_CallFunctionObjArgs(function, NULL));
}

/* Gives all texts to Python, in the order of references. */
static fmu_status hand_over_texts(fmu *f, const slave *s)
{
    if (!s->has_texts) return FMU_OK;
    python_object *texts = py.PyList_New(0);
    for (unsigned i = 0; texts && i < f->table->size; i++) {
        if (!f->texts[i]) continue;
        python_object *text = py.PyUnicode_FromString(f->texts[i]);
        if (!text) {
            py.PyErr_Clear();
            drop(texts);
            return fmu_error(f, "the text of value reference %u is not UTF-8", i);
        }
        py.PyList_Append(texts, text);
        drop(text);
    }
    const fmu_status status = conclude(f, py.PyObject_CallFunctionObjArgs(s->take_texts, texts, NULL));
    drop(texts);
    return status;
}

/* Takes all texts from Python. */
static fmu_status fetch_texts(fmu *f, const slave *s)
{
    if (!s->has_texts) return FMU_OK;
    python_object *texts = py.PyObject_CallFunctionObjArgs(s->give_texts, NULL);
    fmu_status status = texts ? FMU_OK : unexplained(f);
    python_size at = 0;
    for (unsigned i = 0; status == FMU_OK && i < f->table->size; i++) {
        if (!f->texts[i]) continue;
        python_object *text = py.PyList_GetItem(texts, at++);
        const char *words = text ? py.PyUnicode_AsUTF8AndSize(text, NULL) : NULL;
        status = words ? fmu_set_text(f, i, words) : unexplained(f);
    }
    drop(texts);
    return status;
}

static fmu_status start(fmu *f)
{
    slave *s = f->model;
    const int lock = py.PyGILState_Ensure();
    fmu_status status = hand_over_texts(f, s);
    python_object *time = py.PyFloat_FromDouble(f->start_time);
    if (status == FMU_OK) status = conclude(f, py.PyObject_CallFunctionObjArgs(s->start, time, NULL));
    drop(time);
    py.PyGILState_Release(lock);
    return status;
}

static fmu_status initialized(fmu *f)
{
    slave *s = f->model;
    const int lock = py.PyGILState_Ensure();
    const fmu_status status = call(f, s->initialized);
    py.PyGILState_Release(lock);
    return status;
}

static fmu_status tune(fmu *f)
{
    slave *s = f->model;
    const int lock = py.PyGILState_Ensure();
    fmu_status status = hand_over_texts(f, s);
    if (status == FMU_OK) status = call(f, s->tune);
    py.PyGILState_Release(lock);
    return status;
}

static fmu_status step(fmu *f, int64_t count)
{
    slave *s = f->model;
    const int lock = py.PyGILState_Ensure();
    fmu_status status = hand_over_texts(f, s);
    const double begin = f->table->step > 0.0 ? f->start_time + (double)f->steps * f->table->step : f->time;
    const double size = f->table->step > 0.0 ? (double)count * f->table->step : f->size;
    python_object *arguments[] = {py.PyLong_FromLongLong(count), py.PyFloat_FromDouble(begin),
                                  py.PyFloat_FromDouble(size)};
    if (status == FMU_OK)
        status = conclude(f, py.PyObject_CallFunctionObjArgs(s->step, arguments[0], arguments[1], arguments[2],
                                                             NULL));
    for (int i = 0; i < 3; i++) drop(arguments[i]);
    py.PyGILState_Release(lock);
    return status;
}

static fmu_status outputs(fmu *f)
{
    slave *s = f->model;
    if (s->outputs == py.none && !s->has_texts) return FMU_OK; /* a step has written them */
    const int lock = py.PyGILState_Ensure();
    fmu_status status = s->outputs == py.none ? FMU_OK : call(f, s->outputs);
    if (status == FMU_OK) status = fetch_texts(f, s);
    py.PyGILState_Release(lock);
    return status;
}

static fmu_status terminate(fmu *f)
{
    slave *s = f->model;
    const int lock = py.PyGILState_Ensure();
    const fmu_status status = call(f, s->terminate);
    py.PyGILState_Release(lock);
    return status;
}

/* ---- state: bytes, or the messages of a failure ---- */

static size_t state_size(fmu *f)
{
    slave *s = f->model;
    const int lock = py.PyGILState_Ensure();
    drop(s->saved);
    s->saved = py.PyObject_CallFunctionObjArgs(s->get_state, NULL);
    python_size size = s->saved ? py.PyBytes_Size(s->saved) : -1;
    if (size < 0) {
        py.PyErr_Clear();
        conclude(f, s->saved);
        s->saved = NULL;
    }
    py.PyGILState_Release(lock);
    return size < 0 ? SIZE_MAX : (size_t)size;
}

static fmu_status get_state(fmu *f, void *bytes)
{
    slave *s = f->model;
    const int lock = py.PyGILState_Ensure();
    memcpy(bytes, py.PyBytes_AsString(s->saved), (size_t)py.PyBytes_Size(s->saved));
    drop(s->saved);
    s->saved = NULL;
    py.PyGILState_Release(lock);
    return FMU_OK;
}

static fmu_status set_state(fmu *f, const void *bytes, size_t size)
{
    slave *s = f->model;
    const int lock = py.PyGILState_Ensure();
    fmu_status status = hand_over_texts(f, s);
    python_object *state = py.PyBytes_FromStringAndSize(bytes, (python_size)size);
    if (status == FMU_OK) status = conclude(f, py.PyObject_CallFunctionObjArgs(s->set_state, state, NULL));
    drop(state);
    py.PyGILState_Release(lock);
    return status;
}

const fmu_backend_functions fmu_backend = {
    .create = create, .destroy = destroy, .start = start, .initialized = initialized, .tune = tune, .step = step, .outputs = outputs,
    .state_size = state_size, .get_state = get_state, .set_state = set_state, .terminate = terminate};
