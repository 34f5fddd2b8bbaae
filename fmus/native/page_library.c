/* MuJoCo in a page: a module whose functions an FMU imports by name. */
#include <string.h>

#include "library.h"
#include "mujoco_library.h"

#define X(name) extern __typeof__(name) name __attribute__((import_module("mujoco"), import_name(#name)));
MUJOCO_FUNCTIONS(X)
#undef X

/* A log handler would be a function of the FMU's module, which MuJoCo's cannot call: it tells the page. */
static mjfLogHandler no_handler(mjfLogHandler handler) { return NULL; }

typedef void (*any_function)(void);

static const struct {
    const char *name;
    any_function function;
} FUNCTIONS[] = {
#define X(name) {#name, (any_function)name},
    MUJOCO_FUNCTIONS(X)
#undef X
    {"_mjPRIVATE_setTlsLogHandler", (any_function)no_handler},
};

bool library_bind(void *library, const char *name, void *place)
{
    size_t i = sizeof FUNCTIONS / sizeof *FUNCTIONS;
    while (i-- > 0 && strcmp(FUNCTIONS[i].name, name) != 0) continue;
    if (i < sizeof FUNCTIONS / sizeof *FUNCTIONS) memcpy(place, &FUNCTIONS[i].function, sizeof(any_function));
    return i < sizeof FUNCTIONS / sizeof *FUNCTIONS;
}

void *library_open_beside(const char *name, char *why, size_t why_size) { return (void *)FUNCTIONS; }

void library_lock(void) {}

void library_unlock(void) {}
