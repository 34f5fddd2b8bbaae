/* Files, on all platforms but in a page. Paths are UTF-8. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "resources.h"
#ifdef _WIN32
#include <windows.h>
#endif

/* Paths are UTF-8; Windows wants another encoding. */
static FILE *open_file(const char *path)
{
#ifdef _WIN32
    wchar_t wide[32768];
    if (!MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, 32768)) return NULL;
    return _wfopen(wide, L"rb");
#else
    return fopen(path, "rb");
#endif
}

char *read_file(const char *path, size_t *size, char *why, size_t why_size)
{
    char *content = NULL;
    size_t capacity = 0, got = 1;
    FILE *file = open_file(path);
    *size = 0;
    errno = file ? 0 : errno;
    while (file && got && !ferror(file)) {
        if (*size + 1 >= capacity) {
            capacity = capacity ? 2 * capacity : 65536;
            char *larger = realloc(content, capacity);
            if (!larger) break;
            content = larger;
        }
        got = fread(content + *size, 1, capacity - *size - 1, file);
        *size += got;
    }
    const bool whole = file && !got && !ferror(file);
    if (!whole) snprintf(why, why_size, "%.*s cannot be read: %s", LONGEST_TOLD, path, strerror(errno ? errno : ENOMEM));
    if (file) fclose(file);
    if (whole) content[*size] = '\0';
    else free(content);
    return whole ? content : NULL;
}

bool is_file(const char *path)
{
    FILE *file = open_file(path);
    if (file) fclose(file);
    return file != NULL;
}
