#include "mujoco_library.h"

#ifdef __wasm__ /* a fatal error ends the module there, and the page tells of it */
typedef char jmp_buf;
#define setjmp(place) ((place) = 0)
#define longjmp(place, value) __builtin_trap()
#else
#include <setjmp.h>
#endif
#include <stdio.h>
#include <stdlib.h>

#include "library.h"

#if defined(_WIN32)
static const char LIBRARY[] = "mujoco.dll";
#elif defined(__APPLE__)
static const char LIBRARY[] = "libmujoco.dylib";
#else
static const char LIBRARY[] = "libmujoco.so";
#endif

mujoco_functions mj;

typedef struct {
    fmu *f;
    jmp_buf back;
    char message[1200];
} guard;

static _Thread_local guard *innermost; /* of the thread; MuJoCo's log handler has no argument for it */

/* Returns NULL, or the name of a function that is missing. */
static const char *bind_all(void *library)
{
#define X(name) \
    if (!library_bind(library, #name, &mj.name)) return #name;
    MUJOCO_FUNCTIONS(X)
#undef X
    static const char OF_THREAD[] = "_mjPRIVATE_setTlsLogHandler"; /* MuJoCo's Python bindings use it, too */
    return library_bind(library, OF_THREAD, &mj.set_log_handler) ? NULL : OF_THREAD;
}

fmu_status mujoco_open(fmu *f)
{
    static bool is_open;
    char why[1024] = "";
    library_lock();
    void *library = is_open ? NULL : library_open_beside(LIBRARY, why, sizeof why);
    const char *missing = library ? bind_all(library) : NULL;
    if (missing)
        snprintf(why, sizeof why, "%s lacks the function %s", LIBRARY, missing);
    else if (library && mj.mj_version() != mjVERSION_HEADER)
        snprintf(why, sizeof why, "%s has version %d, the FMU was made for %d", LIBRARY, mj.mj_version(),
                 mjVERSION_HEADER);
    else if (library)
        is_open = true;
    const bool success = is_open;
    library_unlock();
    return success ? FMU_OK : fmu_error(f, "MuJoCo cannot be used: %s", why);
}

static void hear(const mjLogMessage *message)
{
    guard *g = innermost;
    if (message->level == mjLOG_WARNING) fmu_warn(g->f, "MuJoCo warns: %s (logged once)", message->subject);
    if (message->level != mjLOG_ERROR) return;
    snprintf(g->message, sizeof g->message, "%s%s%s", message->func ? message->func : "",
             message->func ? ": " : "", message->subject);
    longjmp(g->back, 1);
}

fmu_status mujoco_guarded(fmu *f, fmu_status (*function)(fmu *f, void *argument), void *argument)
{
    guard g, *const outer = innermost;
    const mjfLogHandler before = mj.set_log_handler(hear);
    volatile fmu_status status = FMU_ERROR;
    g.f = f;
    g.message[0] = '\0'; /* the rest is not cleared, which would take longer than a call */
    innermost = &g;
    if (setjmp(g.back) == 0) status = function(f, argument);
    innermost = outer;
    mj.set_log_handler(before);
    if (g.message[0]) fmu_error(f, "MuJoCo: %s", g.message);
    return status;
}

typedef struct {
    const char *bytes;
    size_t size;
    mjModel *m;
} model_file;

static fmu_status load(fmu *f, void *file)
{
    model_file *from = file;
    from->m = mj.mj_loadModelBuffer(from->bytes, (int)from->size);
    return FMU_OK;
}

mjModel *mujoco_load(fmu *f, const char *name)
{
    model_file file = {0};
    char *bytes = fmu_read_resource(f, name, &file.size);
    if (!bytes) return NULL;
    file.bytes = bytes;
    if (file.size > 0) mujoco_guarded(f, load, &file);
    free(bytes);
    if (!file.m) fmu_error(f, "%s is not a model of this MuJoCo", name);
    return file.m;
}
