/* Shared libraries opened by path, independent of search paths and of other copies in the process. */
#ifndef FMU_LIBRARY_H
#define FMU_LIBRARY_H

#include <stdbool.h>
#include <stddef.h>

/* Opens a library from the folder of this library; NULL with the reason. Its symbols are local, since a
 * host may have loaded another version. It is never closed. */
void *library_open_beside(const char *name, char *why, size_t why_size);
void *library_open(const char *path, char *why, size_t why_size); /* with globally visible symbols */

void *library_of_process(const char *name); /* the library in the process that has the symbol; NULL: none */
void *library_symbol(void *library, const char *name); /* NULL: no such symbol */
bool library_bind(void *library, const char *name, void *place); /* stores it in a function pointer */

/* For initialization once, whichever thread comes first. */
void library_lock(void);
void library_unlock(void);

/* The same for all FMUs of the process together: each has its own copy of this code and of its lock. They find
 * each other by a symbol of a library that all of them use. */
void library_lock_process(const void *symbol);
void library_unlock_process(void);

#endif
