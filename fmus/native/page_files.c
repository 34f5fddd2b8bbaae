/* What a page gives instead of an operating system: memory and resources.
 *
 * An FMU is a module that shares the memory of MuJoCo's module, from whose heap it takes its own. Where its
 * data and its stack lie is known when it is linked.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "resources.h"

#define FROM(module, function) __attribute__((import_module(module), import_name(function)))
FROM("mujoco", "malloc") void *mujoco_malloc(size_t size);
FROM("mujoco", "free") void mujoco_free(void *block);
FROM("page", "size") int page_size(const char *path); /* of a resource; -1: there is none */
FROM("page", "read") void page_read(const char *path, char *to);

void *malloc(size_t size) { return mujoco_malloc(size); }
void free(void *block) { mujoco_free(block); }

void *calloc(size_t count, size_t size)
{
    void *block = malloc(count * size);
    return block ? memset(block, 0, count * size) : NULL;
}

bool is_file(const char *path) { return page_size(path) >= 0; }

char *read_file(const char *path, size_t *size, char *why, size_t why_size)
{
    const int found = page_size(path);
    char *content = found < 0 ? NULL : malloc((size_t)found + 1);
    *size = content ? (size_t)found : 0;
    if (!content) snprintf(why, why_size, "%.*s cannot be read: %s", LONGEST_TOLD, path,
                           found < 0 ? "no such resource" : "out of memory");
    if (content) page_read(path, content);
    if (content) content[found] = '\0';
    return content;
}
