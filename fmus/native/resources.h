/* The resource location that an importer gives, and files. Paths are UTF-8 on all platforms. */
#ifndef FMU_RESOURCES_H
#define FMU_RESOURCES_H

#include <stdbool.h>
#include <stddef.h>

enum { LONGEST_TOLD = 400 }; /* characters of a path in a message */

/* All return memory that the caller frees; NULL on failure, with the reason in `why` where it is given. */
char *find_resources(const char *location, char *why, size_t why_size); /* folder of a URI or a path */
char *read_file(const char *path, size_t *size, char *why, size_t why_size); /* with '\0' appended */
bool is_file(const char *path);
char *join_path(const char *folder, const char *name);
char *copy_text(const char *text);

#endif
