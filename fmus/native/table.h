/* The table of variables and options, resources/variables.txt. README.md describes the file. */
#ifndef FMU_TABLE_H
#define FMU_TABLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum { FMU_INPUT, FMU_OUTPUT, FMU_PARAMETER, FMU_LOCAL, FMU_INDEPENDENT } fmu_causality;
typedef enum { FMU_CONSTANT, FMU_FIXED, FMU_TUNABLE, FMU_DISCRETE, FMU_CONTINUOUS } fmu_variability;
typedef enum { FMU_REAL, FMU_INTEGER, FMU_BOOLEAN, FMU_ENUMERATION, FMU_STRING } fmu_type;

/* A variable: a scalar, a vector or a matrix, row by row. */
typedef struct {
    unsigned reference;  /* of its first element */
    unsigned size;       /* number of elements */
    unsigned columns;    /* of a matrix; 0: a vector or a scalar */
    bool scalar;
    fmu_causality causality;
    fmu_variability variability;
    fmu_type type;
    const char *name;        /* without indices */
    const double *start;     /* of each element */
    const char *start_text;  /* of a String */
    const double *minimum, *maximum;  /* of each element; -HUGE_VAL, HUGE_VAL: unbounded */
    const char *source;      /* the backend's words, "" if none */
} fmu_variable;

typedef struct {
    const char *key, *value;
} fmu_option;

typedef struct {
    const char *token;   /* GUID or instantiationToken */
    double step;         /* internal step [s] */
    unsigned size;       /* number of values */
    unsigned count;      /* number of variables */
    const fmu_variable *variables;
    const unsigned *variable_at;  /* index of the variable that has an element at a reference */
    unsigned option_count;
    const fmu_option *options;
    uint64_t hash;       /* of the file */
    void *memory[6];     /* what fmu_table_free frees */
} fmu_table;

/* Reads a table. On failure returns false with the reason, and nothing has to be freed. */
bool fmu_table_read(fmu_table *t, char *text, size_t size, char *why, size_t why_size);
void fmu_table_free(fmu_table *t);

const fmu_variable *fmu_find(const fmu_table *t, const char *name); /* NULL: there is none */

/* Value of the option `key` that is the `index`-th of that key; NULL: there is none. */
const char *fmu_get_option(const fmu_table *t, const char *key, unsigned index);

/* Structured name of the element at a reference, as jac[1,2]. */
const char *fmu_name(const fmu_table *t, unsigned reference, char *buffer, size_t size);

/* Numbers of a source or an option: the next word as a number, and the text behind it. */
bool fmu_next_int(const char **text, int *number);
bool fmu_next_word(const char **text, char *word, size_t size);

uint64_t fmu_hash(const void *bytes, size_t size); /* FNV-1a */

#endif
