#include "python_library.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <wchar.h>

#include "library.h"

enum { PYTHON_MEGABYTES = 256 }; /* of address space; with less, Python, numpy or MuJoCo end the process */

python_functions py;

/* Returns NULL, or the name of a function that is missing. */
static const char *bind_all(void *library)
{
#define X(result, name, arguments) \
    if (!library_bind(library, #name, &py.name)) return #name;
    PYTHON_FUNCTIONS(X)
#undef X
    py.none = library_symbol(library, "_Py_NoneStruct");
    return NULL;
}

/* The absolute path of an option; relative paths are in the resources. */
static bool resource_path(const fmu *f, const char *path, char *buffer, size_t size)
{
    const bool is_absolute = path[0] == '/' || path[0] == '\\' || (path[0] && path[1] == ':');
    const int length = is_absolute ? snprintf(buffer, size, "%s", path)
                                   : snprintf(buffer, size, "%s/%s", f->resources, path);
    return length >= 0 && (size_t)length < size;
}

static void *open_recorded(const fmu *f, char *why, size_t why_size)
{
    char path[4096];
    const char *recorded = fmu_get_option(f->table, "python", 0);
    if (!recorded) {
        snprintf(why, why_size, "this process has no Python, and none was recorded when the FMU was built");
        return NULL;
    }
    if (!resource_path(f, recorded, path, sizeof path)) return NULL;
    char reason[512] = "";
    void *library = library_open(path, reason, sizeof reason);
    if (!library)
        snprintf(why, why_size, "this process has no Python, and the one that the FMU was built with cannot be "
                 "loaded: %s", reason);
    return library;
}

/* Of CPython's initialization since 3.14 (PEP 741), and before it. */
typedef struct {
    void *(*create)(void);
    int (*set_string)(void *config, const char *name, const char *value);
    int (*set_number)(void *config, const char *name, int64_t value);
    int (*start)(void *config);
    void (*free)(void *config);
} config_functions;

/* Starts Python with its own folders only: without PYTHONHOME, PYTHONPATH and the user's packages. */
static bool start_by_config(void *library, const char *home)
{
    config_functions config;
    if (!library_bind(library, "PyInitConfig_Create", &config.create) ||
        !library_bind(library, "PyInitConfig_SetStr", &config.set_string) ||
        !library_bind(library, "PyInitConfig_SetInt", &config.set_number) ||
        !library_bind(library, "Py_InitializeFromInitConfig", &config.start) ||
        !library_bind(library, "PyInitConfig_Free", &config.free)) return false;
    void *isolated = config.create(); /* isolated by default */
    if (!isolated) return false;
    config.set_number(isolated, "utf8_mode", 1);
    if (*home) config.set_string(isolated, "home", home);
    const bool success = config.start(isolated) == 0;
    config.free(isolated);
    return success;
}

static void start_by_flags(void *library, const char *home)
{
    static const char *const FLAGS[] = {"Py_IsolatedFlag", "Py_IgnoreEnvironmentFlag", "Py_NoUserSiteDirectory",
                                        "Py_UTF8Mode"}; /* paths are UTF-8 in any locale */
    wchar_t *(*decode)(const char *, size_t *);
    void (*set_home)(const wchar_t *);
    for (int i = 0; i < 4; i++) {
        int *flag = library_symbol(library, FLAGS[i]);
        if (flag) *flag = 1;
    }
    if (*home && library_bind(library, "Py_DecodeLocale", &decode) && library_bind(library, "Py_SetPythonHome", &set_home))
        set_home(decode(home, NULL)); /* Python keeps the pointer */
    py.Py_InitializeEx(0); /* leave signal handlers to the host */
}

static bool memory_suffices(void)
{
    void *volatile probe = malloc((size_t)PYTHON_MEGABYTES << 20); /* reserved, but never touched */
    free(probe);
    return probe != NULL;
}

static bool start(const fmu *f, void *library)
{
    char home[4096] = "";
    const char *recorded = fmu_get_option(f->table, "home", 0);
    if (recorded && !resource_path(f, recorded, home, sizeof home)) return false;
    if (!start_by_config(library, home)) start_by_flags(library, home);
    if (!py.Py_IsInitialized()) return false;
    py.PySys_SetObject("_started_by_fmu", py.none); /* python_host.py looks for it, in any FMU */
    py.PyEval_SaveThread();                         /* calls may come from any thread */
    return true;
}

/* Starts Python unless it runs; several FMUs may do so at one moment. A thread with a state in Python has been
 * there before, and does not wait: it may hold the interpreter's lock. */
static bool start_once(const fmu *f, void *library, char *why, size_t why_size)
{
    if (py.PyGILState_GetThisThreadState()) return true;
    library_lock_process(py.none);
    bool success = py.Py_IsInitialized();
    if (!success && !memory_suffices())
        snprintf(why, why_size, "Python cannot be started: it needs %d MB of memory", PYTHON_MEGABYTES);
    else if (!success && !(success = start(f, library)))
        snprintf(why, why_size, "Python cannot be started");
    library_unlock_process();
    return success;
}

static bool open(const fmu *f, char *why, size_t why_size)
{
    void *library = library_of_process("Py_IsInitialized");
    if (!library) library = open_recorded(f, why, why_size);
    if (!library) return false;
    const char *missing = bind_all(library);
    if (!missing) return start_once(f, library, why, why_size);
    snprintf(why, why_size, "the Python of this process lacks %s: it is too old", missing);
    return false;
}

/* Checked here, since an older Python may not even parse python_host.py. */
static fmu_status check_version(fmu *f)
{
    const char *minimum = fmu_get_option(f->table, "minimum", 0), *version = py.Py_GetVersion();
    int lowest[2] = {3, 10}, found[2] = {0, 0};
    if (minimum) sscanf(minimum, "%d.%d", &lowest[0], &lowest[1]);
    sscanf(version, "%d.%d", &found[0], &found[1]);
    if (found[0] > lowest[0] || (found[0] == lowest[0] && found[1] >= lowest[1])) return FMU_OK;
    return fmu_error(f, "Python %d.%d or newer is needed; the one in this process is %.*s", lowest[0], lowest[1],
                     (int)strcspn(version, " "), version);
}

fmu_status python_open(fmu *f)
{
    static bool is_open;
    char why[1024] = "";
    library_lock();
    is_open = is_open || open(f, why, sizeof why);
    const bool success = is_open;
    library_unlock();
    return success ? check_version(f) : fmu_error(f, "%s", why);
}
