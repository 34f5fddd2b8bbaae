/* Messages to the importer's logger. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

static const struct {
    const char *name;
    unsigned categories;
} CATEGORIES[] = {
    {"logStatusWarning", LOG_WARNINGS},
    {"logStatusDiscard", 0},
    {"logStatusError", LOG_ERRORS},
    {"logStatusFatal", LOG_ERRORS},
    {"logAll", LOG_WARNINGS | LOG_ERRORS | LOG_REST},
};

bool log_categories(instance *c, bool on, size_t count, const char *const *names)
{
    unsigned chosen = 0;
    for (size_t i = 0; on && i < count; i++) {
        size_t k = 0;
        while (k < 5 && (!names || !names[i] || strcmp(names[i], CATEGORIES[k].name) != 0)) k++;
        if (k == 5) {
            fmu_error(&c->f, "'%s' is not a log category of this FMU",
                      names && names[i] ? names[i] : "(null)");
            return false;
        }
        chosen |= CATEGORIES[k].categories;
    }
    if (!on) chosen = LOG_ERRORS; /* the reason of a failed call is always logged */
    c->categories = on && count == 0 ? LOG_WARNINGS | LOG_ERRORS | LOG_REST : chosen;
    return true;
}

/* FMI 2.0 takes a printf format. Doubling '%' suits importers that format it and those that do not. */
static char *as_format(const char *text)
{
    char *format = malloc(2 * strlen(text) + 1), *to = format;
    if (!format) return NULL;
    for (; *text; text++) {
        if (*text == '%') *to++ = '%';
        *to++ = *text;
    }
    *to = '\0';
    return format;
}

void log_message(instance *c, fmu_status status, const char *text)
{
    const char *category = status == FMU_OK        ? "logAll"
                           : status == FMU_WARNING ? "logStatusWarning"
                           : status == FMU_DISCARD ? "logStatusDiscard"
                                                   : "logStatusError";
    if (!(c->categories & (status == FMU_OK ? LOG_REST : status == FMU_WARNING ? LOG_WARNINGS : LOG_ERRORS))) return;
    if (c->version == 3 && c->log3) {
        c->log3(c->environment, (fmi3Status)status, category, text);
    } else if (c->version == 2 && c->log2) {
        char *format = as_format(text);
        c->log2(c->environment, c->name, (fmi2Status)status, category, format ? format : "out of memory");
        free(format);
    } else {
        fprintf(stderr, "%s: %s\n", c->name, text);
    }
}

void log_refusal(const instance_request *request, const char *text)
{
    const char *name = request->name ? request->name : "";
    if (request->log3) request->log3(request->environment, fmi3Error, "logStatusError", text);
    else if (request->log2) request->log2(request->environment, name, fmi2Error, "logStatusError", text);
    else fprintf(stderr, "%s: %s\n", name, text);
}

/* "function: message", to be freed; NULL without memory. */
static char *compose(const instance *c, const char *format, va_list values)
{
    va_list again;
    va_copy(again, values);
    const int length = vsnprintf(NULL, 0, format, again);
    va_end(again);
    const size_t begin = strlen(c->function) + 2;
    char *text = length < 0 ? NULL : malloc(begin + (size_t)length + 1);
    if (!text) return NULL;
    snprintf(text, begin + 1, "%s: ", c->function);
    vsnprintf(text + begin, (size_t)length + 1, format, values);
    return text;
}

fmu_status fmu_error(fmu *f, const char *format, ...)
{
    instance *c = (instance *)f;
    va_list values;
    va_start(values, format);
    char *text = compose(c, format, values);
    va_end(values);
    log_message(c, FMU_ERROR, text ? text : "out of memory");
    free(text);
    return FMU_ERROR;
}

static bool told_before(instance *c, const char *text)
{
    const uint64_t hash = fmu_hash(text, strlen(text));
    for (unsigned i = 0; i < c->told_count; i++)
        if (c->told[i] == hash) return true;
    if (c->told_count == MOST_TOLD) return true; /* no flood */
    c->told[c->told_count++] = hash;
    return false;
}

void fmu_warn(fmu *f, const char *format, ...)
{
    instance *c = (instance *)f;
    va_list values;
    va_start(values, format);
    char *text = compose(c, format, values);
    va_end(values);
    if (text && !told_before(c, text)) log_message(c, FMU_WARNING, text);
    free(text);
}

void fmu_log(fmu *f, fmu_status status, const char *text) { log_message((instance *)f, status, text); }
