/* The table of variables and options; ../README.md describes the file. */
#include "table.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LARGEST = 10000000, FIELDS = 12 };

static const char *const CAUSALITIES[] = {"input", "output", "parameter", "local", "independent"};
static const char *const VARIABILITIES[] = {"constant", "fixed", "tunable", "discrete", "continuous"};
static const char *const TYPES[] = {"Real", "Integer", "Boolean", "Enumeration", "String"};

uint64_t fmu_hash(const void *bytes, size_t size)
{
    const unsigned char *at = bytes;
    uint64_t hash = 14695981039346656037u, word;
    for (; size >= sizeof word; size -= sizeof word, at += sizeof word) {
        memcpy(&word, at, sizeof word);
        hash = (hash ^ word) * 1099511628211u;
        hash ^= hash >> 32; /* since multiplication only carries upwards */
    }
    for (; size; size--) hash = (hash ^ *at++) * 1099511628211u;
    return hash;
}

static int hex_digit(char c)
{
    if (c >= '0' && c <= '9') return c - '0';
    c = (char)(c | 0x20);
    return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

bool fmu_decode(char *text)
{
    char *to = text;
    for (; *text; text++, to++) {
        *to = *text;
        if (*text != '%') continue;
        const int high = hex_digit(text[1]), low = high < 0 ? -1 : hex_digit(text[2]);
        if (low < 0 || high + low == 0) return false;
        *to = (char)(high * 16 + low);
        text += 2;
    }
    *to = '\0';
    return true;
}

bool fmu_next_word(const char **text, char *word, size_t size)
{
    const char *from = *text + strspn(*text, " ");
    const size_t length = strcspn(from, " ");
    if (length == 0 || length >= size) return false;
    memcpy(word, from, length);
    word[length] = '\0';
    *text = from + length;
    return true;
}

bool fmu_next_int(const char **text, int *number)
{
    char word[12], *end;
    const char *from = *text;
    if (!fmu_next_word(&from, word, sizeof word)) return false;
    const long value = strtol(word, &end, 10);
    if (*end || value < -LARGEST || value > LARGEST) return false;
    *number = (int)value;
    *text = from;
    return true;
}

/* The bits of a double in 16 hexadecimal digits; sets `end` after them. */
static bool read_number(const char *text, double *number, const char **end)
{
    uint64_t bits = 0;
    for (int i = 0; i < 16; i++) {
        const int digit = hex_digit(text[i]);
        if (digit < 0) return false;
        bits = bits << 4 | (uint64_t)digit;
    }
    memcpy(number, &bits, sizeof bits);
    *end = text + 16;
    return true;
}

/* `-`, a number for all elements, or one for each. */
static bool read_numbers(const char *text, unsigned size, double missing, double *numbers)
{
    unsigned found = 0;
    numbers[0] = missing;
    if (!strcmp(text, "-")) text = "", found = 1;
    for (; *text && found < size; found++) {
        if (!read_number(text, &numbers[found], &text)) return false;
        text += *text == ' ';
    }
    if (*text || (found != 1 && found != size)) return false;
    for (; found < size; found++) numbers[found] = numbers[0];
    return true;
}

static bool choose(const char *word, const char *const *words, int count, int *chosen)
{
    for (*chosen = 0; *chosen < count; ++*chosen)
        if (!strcmp(word, words[*chosen])) return true;
    return false;
}

/* `-`, `7` or `6x7`. */
static bool read_shape(const char *text, fmu_variable *v)
{
    char *end;
    v->size = 1;
    v->scalar = !strcmp(text, "-");
    if (v->scalar) return true;
    const long rows = strtol(text, &end, 10);
    const long columns = *end == 'x' ? strtol(end + 1, &end, 10) : 1;
    if (*end || rows < 1 || rows > LARGEST || columns < 1 || columns > LARGEST / rows) return false;
    v->size = (unsigned)(rows * columns);
    v->columns = strchr(text, 'x') ? (unsigned)columns : 0;
    return true;
}

/* Returns NULL, or the reason of a failure. */
static const char *read_variable(fmu_table *t, char **fields, int count)
{
    fmu_variable *v = &t->variables[t->count];
    char *end;
    int causality, variability, type;
    if (count != FIELDS) return "a variable has 11 fields";
    const unsigned long reference = strtoul(fields[1], &end, 10);
    if (*end || reference != t->size) return "value references have no gaps";
    if (!read_shape(fields[2], v) || t->size + v->size > LARGEST) return "the shape";
    if (!choose(fields[3], CAUSALITIES, 5, &causality)) return "the causality";
    if (!choose(fields[4], VARIABILITIES, 5, &variability)) return "the variability";
    if (!choose(fields[5], TYPES, 5, &type)) return "the type";
    v->reference = t->size;
    v->causality = (fmu_causality)causality;
    v->variability = (fmu_variability)variability;
    v->type = (fmu_type)type;
    v->name = fields[6];
    v->source = strcmp(fields[10], "-") ? fields[10] : "";
    v->arrays = strcmp(fields[11], "-") ? fields[11] : "";
    v->start_text = type == FMU_STRING ? (strcmp(fields[7], "-") ? fields[7] : "") : NULL;
    if (!fmu_decode(fields[6]) || !fmu_decode(fields[10])) return "a text";
    if (type == FMU_STRING && !fmu_decode(fields[7])) return "the start value";
    v->start = calloc(3 * (size_t)v->size, sizeof *v->start);
    if (!v->start) return "out of memory";
    v->minimum = v->start + v->size;
    v->maximum = v->minimum + v->size;
    t->count++;
    t->size += v->size;
    if (type != FMU_STRING && !read_numbers(fields[7], v->size, 0.0, v->start)) return "the start value";
    if (!read_numbers(fields[8], v->size, -HUGE_VAL, v->minimum)) return "the minimum";
    if (!read_numbers(fields[9], v->size, HUGE_VAL, v->maximum)) return "the maximum";
    return NULL;
}

static const char *read_record(fmu_table *t, char *line)
{
    char *fields[FIELDS + 1] = {line};
    const char *end;
    int count = 1;
    for (char *c = line; *c && count <= FIELDS; c++)
        if (*c == '\t') {
            *c = '\0';
            fields[count++] = c + 1;
        }
    if (!strcmp(line, "variable")) return read_variable(t, fields, count);
    if (!strcmp(line, "fmu")) return count == 2 && !strcmp(fields[1], "2") ? NULL : "another format";
    if (!strcmp(line, "token")) return count == 2 ? t->token = fields[1], NULL : "the token";
    if (!strcmp(line, "step"))
        return count == 2 && read_number(fields[1], &t->step, &end) && t->step >= 0.0 &&
                       t->step < 1e9 ? NULL : "the step";
    if (strcmp(line, "option") != 0) return "no such record";
    if (count != 3 || !fmu_decode(fields[1]) || !fmu_decode(fields[2])) return "the option";
    t->options[t->option_count++] = (fmu_option){fields[1], fields[2]};
    return NULL;
}

/* Notes the sizes of a variable's arrays in FMI 3.0 where they begin; false if they do not fill it. */
static bool find_arrays(fmu_table *t, const fmu_variable *v)
{
    const char *text = v->arrays;
    unsigned at = 0;
    int size;
    if (!*text) return t->array_at[v->reference] = v->size, true;
    for (; fmu_next_int(&text, &size); at += (unsigned)size) {
        if (size < 1 || (unsigned)size > v->size - at) return false;
        t->array_at[v->reference + at] = (unsigned)size;
    }
    return at == v->size;
}

static bool find_elements(fmu_table *t)
{
    t->variable_at = calloc((size_t)t->size + 1, sizeof *t->variable_at);
    t->array_at = calloc((size_t)t->size + 1, sizeof *t->array_at);
    if (!t->variable_at || !t->array_at) return false;
    for (unsigned i = 0; i < t->count; i++) {
        for (unsigned k = 0; k < t->variables[i].size; k++)
            t->variable_at[t->variables[i].reference + k] = i;
        if (!find_arrays(t, &t->variables[i])) return false;
    }
    return true;
}

bool fmu_table_read(fmu_table *t, char *text, size_t size, char *why, size_t why_size)
{
    size_t lines = 1;
    *t = (fmu_table){.hash = fmu_hash(text, size), .text = text, .step = -1.0};
    for (const char *c = text; *c; c++) lines += *c == '\n';
    t->variables = calloc(lines, sizeof *t->variables);
    t->options = calloc(lines, sizeof *t->options);
    const char *wrong = t->variables && t->options ? NULL : "out of memory";
    unsigned number = 0;
    for (char *line = text, *next; line && !wrong; line = next) {
        next = strchr(line, '\n');
        if (next) *next++ = '\0';
        number++;
        line[strcspn(line, "\r")] = '\0';
        if (*line && *line != '#') wrong = read_record(t, line);
    }
    if (wrong) {
        snprintf(why, why_size, "line %u: %s", number, wrong);
        return false;
    }
    if (!t->token || !(t->step >= 0.0) || !t->size || !find_elements(t)) {
        snprintf(why, why_size, "it has no token, no step, no variables, or arrays that do not fill one");
        return false;
    }
    return true;
}

void fmu_table_free(fmu_table *t)
{
    for (unsigned i = 0; i < t->count; i++) free(t->variables[i].start);
    free(t->variables);
    free(t->variable_at);
    free(t->array_at);
    free(t->options);
    free(t->text);
    *t = (fmu_table){0};
}

const fmu_variable *fmu_find(const fmu_table *t, const char *name)
{
    for (unsigned i = 0; i < t->count; i++)
        if (!strcmp(t->variables[i].name, name)) return &t->variables[i];
    return NULL;
}

const char *fmu_get_option(const fmu_table *t, const char *key, unsigned index)
{
    for (unsigned i = 0; i < t->option_count; i++)
        if (!strcmp(t->options[i].key, key) && index-- == 0) return t->options[i].value;
    return NULL;
}

char *fmu_name(const fmu_table *t, unsigned reference, char *buffer, size_t size)
{
    const fmu_variable *v = &t->variables[t->variable_at[reference]];
    const unsigned at = reference - v->reference;
    if (v->scalar)
        snprintf(buffer, size, "%s", v->name);
    else if (v->columns)
        snprintf(buffer, size, "%s[%u,%u]", v->name, at / v->columns + 1, at % v->columns + 1);
    else
        snprintf(buffer, size, "%s[%u]", v->name, at + 1);
    return buffer;
}
