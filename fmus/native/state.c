/* FMU states: one block of bytes, the same in memory and serialised.
 *
 * A header, the values, the texts of String variables each with a '\0', the backend's bytes. A checksum
 * over all of it detects truncated or damaged states, not those that somebody has made up; the table's
 * hash detects those of another FMU or another build of this one.
 */
#include <stdlib.h>
#include <string.h>

#include "instance.h"

static const char MAGIC[8] = {'F', 'M', 'U', 's', 't', 'a', 't', '1'};

typedef struct {
    char magic[8];
    uint64_t checksum; /* of all that follows */
    uint64_t size;     /* in all */
    uint64_t table;    /* hash */
    uint64_t text_size, model_size;
    int64_t steps;
    double start_time, time, stop_time, carry;
    uint32_t state, flags;
} header;

enum { STALE = 1, HAS_STOP_TIME = 2 };
enum { HASHED_FROM = offsetof(header, size) };

static size_t values_size(const instance *c) { return c->table.size * sizeof(double); }

static size_t texts_size(const instance *c)
{
    size_t size = 0;
    for (unsigned i = 0; i < c->table.size; i++)
        if (c->f.texts[i]) size += strlen(c->f.texts[i]) + 1;
    return size;
}

static size_t model_size(instance *c)
{
    size_t size;
    WITH_DEFAULT_FENV(size = fmu_backend.state_size(&c->f));
    return size;
}

static uint64_t checksum(const unsigned char *bytes, size_t size)
{
    return fmu_hash(bytes + HASHED_FROM, size - HASHED_FROM);
}

static unsigned char *put_texts(const instance *c, unsigned char *to)
{
    for (unsigned i = 0; i < c->table.size; i++)
        if (c->f.texts[i]) {
            const size_t size = strlen(c->f.texts[i]) + 1;
            memcpy(to, c->f.texts[i], size);
            to += size;
        }
    return to;
}

static fmu_status fill(instance *c, unsigned char *bytes, header h)
{
    unsigned char *at = bytes + sizeof h;
    memcpy(at, c->f.values, values_size(c));
    at = put_texts(c, at + values_size(c));
    if (h.model_size && fmu_backend.get_state(&c->f, at) != FMU_OK) return FMU_ERROR; /* copies, no arithmetic */
    memcpy(bytes, &h, sizeof h);
    h.checksum = checksum(bytes, (size_t)h.size);
    memcpy(bytes, &h, sizeof h);
    return FMU_OK;
}

fmu_status state_get(instance *c, void **state)
{
    if (!state) return fmu_error(&c->f, "no place for the state was given");
    if (!c->stale && (instance_tune(c) != FMU_OK || instance_all_outputs(c) != FMU_OK)) return FMU_ERROR;
    const bool has_model = !c->stale && fmu_backend.state_size != NULL;
    header h = {.table = c->table.hash, .text_size = texts_size(c), .steps = c->f.steps,
                .model_size = has_model ? model_size(c) : 0,
                .start_time = c->f.start_time, .time = c->f.time, .stop_time = c->stop_time,
                .carry = c->carry, .state = (uint32_t)c->state,
                .flags = (c->stale ? STALE : 0u) | (c->has_stop_time ? HAS_STOP_TIME : 0u)};
    memcpy(h.magic, MAGIC, sizeof MAGIC);
    if (has_model && h.model_size == SIZE_MAX) return FMU_ERROR; /* the backend has logged the reason */
    h.size = sizeof h + values_size(c) + h.text_size + h.model_size;
    unsigned char *bytes = malloc((size_t)h.size);
    if (!bytes) return fmu_error(&c->f, "out of memory");
    if (fill(c, bytes, h) != FMU_OK) {
        free(bytes);
        return FMU_ERROR;
    }
    free(*state);
    *state = bytes;
    return FMU_OK;
}

/* Returns NULL, or why the bytes are not a state of this FMU. */
static const char *examine(const instance *c, const unsigned char *bytes, size_t size, header *h)
{
    if (!bytes || size < sizeof *h) return "it is too short";
    memcpy(h, bytes, sizeof *h);
    if (memcmp(h->magic, MAGIC, sizeof MAGIC) != 0) return "it is not an FMU state";
    if (h->size != size) return "its size is wrong";
    if (checksum(bytes, size) != h->checksum) return "it is damaged";
    if (h->table != c->table.hash) return "it is that of another FMU, or of another build of this one";
    return NULL;
}

static bool same_parameters(const instance *c, const double *values, fmu_variability variability)
{
    for (unsigned i = 0; i < c->table.count; i++) {
        const fmu_variable *v = &c->table.variables[i];
        if (v->causality == FMU_PARAMETER && v->variability == variability &&
            memcmp(c->f.values + v->reference, values + v->reference, v->size * sizeof *values) != 0)
            return false;
    }
    return true;
}

/* Restores texts; sets `same` to whether they were unchanged. */
static fmu_status take_texts(instance *c, const char *text, bool *same)
{
    *same = true;
    for (unsigned i = 0; i < c->table.size; i++) {
        if (!c->f.texts[i]) continue;
        *same = *same && !strcmp(c->f.texts[i], text);
        if (fmu_set_text(&c->f, i, text) != FMU_OK) return FMU_ERROR;
        text += strlen(text) + 1;
    }
    return FMU_OK;
}

/* Has the backend rebuild its model, if the current one was made from other parameters. */
static fmu_status prepare(instance *c, const header *h, const double *values, bool same_texts)
{
    const bool remake = c->stale || c->state == FAILED || !same_texts || c->f.start_time != h->start_time ||
                        !same_parameters(c, values, FMU_FIXED);
    const bool retune = c->untuned || !same_parameters(c, values, FMU_TUNABLE);
    memcpy(c->f.values, values, values_size(c));
    c->f.start_time = h->start_time;
    c->stale = remake;
    c->untuned = retune;
    if (instance_start(c) != FMU_OK || instance_tune(c) != FMU_OK) return FMU_ERROR;
    memcpy(c->f.values, values, values_size(c)); /* `start` has written outputs */
    return FMU_OK;
}

static fmu_status restore(instance *c, const header *h, const unsigned char *bytes)
{
    double *values = malloc(values_size(c)); /* aligned */
    bool same_texts;
    if (!values) return fmu_error(&c->f, "out of memory");
    memcpy(values, bytes + sizeof *h, values_size(c));
    const unsigned char *texts = bytes + sizeof *h + values_size(c), *model = texts + h->text_size;
    fmu_status status = take_texts(c, (const char *)texts, &same_texts);
    if (status == FMU_OK && h->flags & STALE) memcpy(c->f.values, values, values_size(c));
    else if (status == FMU_OK) status = prepare(c, h, values, same_texts);
    if (status == FMU_OK && !(h->flags & STALE) && fmu_backend.set_state)
        WITH_DEFAULT_FENV(status = fmu_backend.set_state(&c->f, model, (size_t)h->model_size));
    free(values);
    return status;
}

fmu_status state_set(instance *c, const void *state)
{
    header h;
    if (!state) return fmu_error(&c->f, "no state was given");
    memcpy(&h, state, sizeof h);
    const char *wrong = examine(c, state, (size_t)h.size, &h);
    if (wrong) return fmu_error(&c->f, "the state cannot be used: %s", wrong);
    if (restore(c, &h, state) != FMU_OK) {
        c->state = FAILED;
        return FMU_ERROR;
    }
    c->f.start_time = h.start_time;
    c->f.steps = h.steps;
    c->f.time = h.time;
    c->stop_time = h.stop_time;
    c->has_stop_time = h.flags & HAS_STOP_TIME;
    c->carry = h.carry;
    c->state = (instance_state)h.state;
    c->stale = h.flags & STALE;
    c->untuned = c->outdated = false;
    c->complete = !c->stale;
    c->unchecked = true;
    return FMU_OK;
}

fmu_status state_size(instance *c, const void *state, size_t *size)
{
    header h;
    if (!state || !size) return fmu_error(&c->f, "no state was given");
    memcpy(&h, state, sizeof h);
    if (memcmp(h.magic, MAGIC, sizeof MAGIC) != 0) return fmu_error(&c->f, "this is not a state of this FMU");
    *size = (size_t)h.size;
    return FMU_OK;
}

fmu_status state_serialize(instance *c, const void *state, unsigned char *bytes, size_t size)
{
    size_t needed;
    if (state_size(c, state, &needed) != FMU_OK) return FMU_ERROR;
    if (!bytes || size < needed)
        return fmu_error(&c->f, "%zu bytes are too few for a state of %zu", bytes ? size : 0, needed);
    memcpy(bytes, state, needed);
    return FMU_OK;
}

fmu_status state_deserialize(instance *c, const unsigned char *bytes, size_t size, void **state)
{
    header h;
    const char *wrong = examine(c, bytes, size, &h);
    if (wrong) return fmu_error(&c->f, "the state cannot be used: %s", wrong);
    if (!state) return fmu_error(&c->f, "no place for the state was given");
    unsigned char *copy = malloc(size);
    if (!copy) return fmu_error(&c->f, "out of memory");
    memcpy(copy, bytes, size);
    *state = copy; /* the old value is ignored: the standards do not say that it is set */
    return FMU_OK;
}

void state_free(void **state)
{
    if (!state) return;
    free(*state);
    *state = NULL;
}
