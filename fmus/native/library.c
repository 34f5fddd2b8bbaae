#if !defined(_WIN32) && !defined(_GNU_SOURCE)
#define _GNU_SOURCE /* dladdr, RTLD_DEEPBIND */
#endif
#include "library.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "resources.h"

#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <sys/file.h>
#include <unistd.h>
#endif

static const char anchor; /* any address inside this library */

bool library_bind(void *library, const char *name, void *place)
{
    void *symbol = library_symbol(library, name);
    memcpy(place, &symbol, sizeof symbol);
    return symbol != NULL;
}

#ifdef _WIN32

static SRWLOCK own_lock = SRWLOCK_INIT;

void library_lock(void) { AcquireSRWLockExclusive(&own_lock); }

void library_unlock(void) { ReleaseSRWLockExclusive(&own_lock); }

enum { PATH_SIZE = 32768 };

static void *open_wide(const wchar_t *path, const char *name, char *why, size_t why_size)
{
    void *library = (void *)LoadLibraryExW(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
    if (!library) snprintf(why, why_size, "%s cannot be loaded: Windows error %lu", name, GetLastError());
    return library;
}

void *library_open(const char *path, char *why, size_t why_size)
{
    wchar_t wide[PATH_SIZE];
    if (!MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, PATH_SIZE)) wide[0] = L'\0';
    return open_wide(wide, path, why, why_size);
}

void *library_open_beside(const char *name, char *why, size_t why_size)
{
    wchar_t path[PATH_SIZE];
    HMODULE self = NULL;
    GetModuleHandleExW(GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_UNCHANGED_REFCOUNT,
                       (LPCWSTR)(const void *)&anchor, &self);
    DWORD length = GetModuleFileNameW(self, path, PATH_SIZE - 64);
    while (length > 0 && path[length - 1] != L'\\') length--;
    for (size_t i = 0; i <= strlen(name); i++) path[length + i] = (wchar_t)name[i];
    return open_wide(path, name, why, why_size);
}

/* Only Python is searched for: python3.dll, or that of a version. */
void *library_of_process(const char *name)
{
    HMODULE found = GetModuleHandleA("python3.dll");
    for (int minor = 8; !found && minor < 40; minor++) {
        char module[32];
        snprintf(module, sizeof module, "python3%d.dll", minor);
        found = GetModuleHandleA(module);
    }
    return found && GetProcAddress(found, name) ? (void *)found : NULL;
}

static HANDLE mutex; /* the kernel gives all who use its name the same one */

void library_lock_process(const void *symbol)
{
    wchar_t name[64];
    swprintf(name, sizeof name / sizeof *name, L"Local\\fmu-python-%lu", GetCurrentProcessId());
    if (!mutex) mutex = CreateMutexW(NULL, FALSE, name);
    WaitForSingleObject(mutex, INFINITE);
}

void library_unlock_process(void) { ReleaseMutex(mutex); }

void *library_symbol(void *library, const char *name)
{
    void *symbol = NULL;
    const FARPROC found = GetProcAddress((HMODULE)library, name);
    memcpy(&symbol, &found, sizeof symbol);
    return symbol;
}

#else

static pthread_mutex_t own_lock = PTHREAD_MUTEX_INITIALIZER;

void library_lock(void) { pthread_mutex_lock(&own_lock); }

void library_unlock(void) { pthread_mutex_unlock(&own_lock); }

static void *open_path(const char *path, int flags, char *why, size_t why_size)
{
    void *library = dlopen(path, RTLD_NOW | flags);
    if (!library) snprintf(why, why_size, "%s", dlerror());
    return library;
}

void *library_open(const char *path, char *why, size_t why_size)
{
    return open_path(path, RTLD_GLOBAL, why, why_size);
}

/* The library prefers its own symbols to those of another copy. Sanitizers forbid this. */
static int private_flags(void)
{
#ifdef RTLD_DEEPBIND
    const bool is_sanitized = dlsym(RTLD_DEFAULT, "__asan_init") || dlsym(RTLD_DEFAULT, "__tsan_init");
    return is_sanitized ? RTLD_LOCAL : RTLD_LOCAL | RTLD_DEEPBIND;
#else
    return RTLD_LOCAL;
#endif
}

void *library_open_beside(const char *name, char *why, size_t why_size)
{
    Dl_info own;
    if (!dladdr(&anchor, &own) || !own.dli_fname) {
        snprintf(why, why_size, "the folder of the FMU's library is not known");
        return NULL;
    }
    char *folder = copy_text(own.dli_fname), *last = folder ? strrchr(folder, '/') : NULL;
    if (last) *last = '\0';
    char *path = folder ? join_path(last ? folder : ".", name) : NULL;
    void *library = path ? open_path(path, private_flags(), why, why_size) : NULL;
    if (!path) snprintf(why, why_size, "out of memory");
    free(path);
    free(folder);
    return library;
}

void *library_of_process(const char *name)
{
    return dlsym(RTLD_DEFAULT, name) ? dlopen(NULL, RTLD_NOW) : NULL;
}

static int locked_file;

void library_lock_process(const void *symbol)
{
    Dl_info library;
    locked_file = dladdr(symbol, &library) ? open(library.dli_fname, O_RDONLY | O_CLOEXEC) : -1;
    while (locked_file >= 0 && flock(locked_file, LOCK_EX) != 0 && errno == EINTR) continue;
}

void library_unlock_process(void)
{
    if (locked_file >= 0) close(locked_file); /* which unlocks it */
}

void *library_symbol(void *library, const char *name) { return dlsym(library, name); }

#endif
