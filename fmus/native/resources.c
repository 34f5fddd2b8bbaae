/* The resource location that an importer gives. */
#include <ctype.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "resources.h"

#include "backend.h"

char *copy_text(const char *text)
{
    const size_t size = strlen(text) + 1;
    char *copy = malloc(size);
    if (copy) memcpy(copy, text, size);
    return copy;
}

char *join_path(const char *folder, const char *name)
{
    const size_t length = strlen(folder), size = length + strlen(name) + 2;
    char *path = malloc(size);
    if (path) snprintf(path, size, "%s%s%s", folder, length && folder[length - 1] == '/' ? "" : "/", name);
    return path;
}

static bool begins_with(const char *text, const char *lower_case)
{
    for (; *lower_case; text++, lower_case++)
        if (tolower((unsigned char)*text) != *lower_case) return false;
    return true;
}

/* The path of a file URI, still encoded: file:/x, file:///x, file://localhost/x, file:///C:/x. */
static const char *path_of_uri(const char *uri)
{
    const char *path = uri + strlen("file:");
    if (begins_with(path, "//localhost/")) path += strlen("//localhost");
    else if (begins_with(path, "///")) path += 2;
#ifdef _WIN32
    else if (path[0] == '/' && path[1] == '/' && path[2] && path[3] == ':') path += 2; /* file://C:/x */
    if (path[0] == '/' && path[1] && path[2] == ':') path++;
#else
    else if (begins_with(path, "//")) return NULL; /* on another machine */
#endif
    return path;
}

static bool has_table(const char *folder)
{
    char *path = join_path(folder, "variables.txt");
    const bool found = path && is_file(path);
    free(path);
    return found;
}

static void strip_separators(char *path)
{
    size_t length = strlen(path);
    while (length > 1 && (path[length - 1] == '/' || path[length - 1] == '\\')) path[--length] = '\0';
}

/* Takes the URI's path, decoded, or unchanged if the importer did not encode it. */
static char *folder_of_uri(const char *uri)
{
    const char *path = path_of_uri(uri);
    char *decoded = path ? copy_text(path) : NULL, *literal = path ? copy_text(path) : NULL;
    if (!decoded || !literal) {
        free(decoded);
        free(literal);
        return NULL;
    }
    strip_separators(literal);
    if (fmu_decode(decoded)) {
        strip_separators(decoded);
        if (has_table(decoded) || !has_table(literal)) {
            free(literal);
            return decoded;
        }
    }
    free(decoded);
    return literal;
}

char *find_resources(const char *location, char *why, size_t why_size)
{
    char *folder = NULL;
    if (!location) {
        snprintf(why, why_size, "no resource location was given");
        return NULL;
    }
    if (begins_with(location, "file:")) {
        folder = folder_of_uri(location);
    } else if (!strstr(location, "://")) { /* a path, as FMI 3.0 has it */
        folder = copy_text(location);
        if (folder) strip_separators(folder);
    }
    if (!folder) snprintf(why, why_size, "the resource location '%.*s' is not a local file URI", LONGEST_TOLD,
                          location);
    return folder;
}

char *fmu_read_resource(fmu *f, const char *name, size_t *size)
{
    char why[1024] = "out of memory", *path = join_path(f->resources, name);
    char *content = path ? read_file(path, size, why, sizeof why) : NULL;
    free(path);
    if (!content) fmu_error(f, "%s", why);
    return content;
}
