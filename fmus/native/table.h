/* The table of variables and options, resources/variables.txt. ../README.md describes the file. */
#ifndef FMU_TABLE_H
#define FMU_TABLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum { FMU_INPUT, FMU_OUTPUT, FMU_PARAMETER, FMU_LOCAL, FMU_INDEPENDENT } fmu_causality;
typedef enum { FMU_CONSTANT, FMU_FIXED, FMU_TUNABLE, FMU_DISCRETE, FMU_CONTINUOUS } fmu_variability;
typedef enum { FMU_REAL, FMU_INTEGER, FMU_BOOLEAN, FMU_ENUMERATION, FMU_STRING } fmu_type;

/* A variable: a scalar, a vector or a matrix (row-major). */
typedef struct {
    unsigned reference;  /* of its first element */
    unsigned size;       /* number of elements */
    unsigned columns;    /* of a matrix; 0: a vector or a scalar */
    bool scalar;
    unsigned char was_read; /* 1: an importer has asked for it; 2: a state is being saved */
    fmu_causality causality;
    fmu_variability variability;
    fmu_type type;
    const char *name;        /* without indices */
    double *start, *minimum, *maximum;  /* of each element; +-HUGE_VAL: unbounded */
    const char *start_text;             /* of a String */
    const char *source;      /* read by the backend, "" if none */
    const char *arrays;      /* sizes of the arrays that FMI 3.0 has instead; "": one of all elements */
} fmu_variable;

typedef struct {
    const char *key, *value;
} fmu_option;

typedef struct {
    const char *token;      /* GUID or instantiationToken */
    double step;            /* internal step [s]; 0: none, communication steps are taken as they are */
    unsigned size;          /* number of values */
    unsigned count;         /* number of variables */
    fmu_variable *variables;
    unsigned *variable_at;  /* index of the variable that has an element at a reference */
    unsigned *array_at;     /* size of the array of FMI 3.0 that begins at a reference; 0: none does */
    unsigned option_count;
    fmu_option *options;
    uint64_t hash;          /* of the file */
    char *text;             /* of the parsed file */
} fmu_table;

/* Parses a table's text and takes ownership of it. On failure returns false with the reason;
 * fmu_table_free must be called in any case. */
bool fmu_table_read(fmu_table *t, char *text, size_t size, char *why, size_t why_size);
void fmu_table_free(fmu_table *t);

const fmu_variable *fmu_find(const fmu_table *t, const char *name); /* NULL: none */

/* Value of the `index`-th option `key`; NULL: none. */
const char *fmu_get_option(const fmu_table *t, const char *key, unsigned index);

/* Structured name of the element at a reference, as jac[1,2]; returns the buffer. */
char *fmu_name(const fmu_table *t, unsigned reference, char *buffer, size_t size);

/* Reads the next word of a source or an option, and advances the text; false at its end, or if the
 * word is too long or not a number. */
bool fmu_next_word(const char **text, char *word, size_t size);
bool fmu_next_int(const char **text, int *number);

/* Decodes %XX in place; false if two hexadecimal digits are missing or are 00. */
bool fmu_decode(char *text);

/* FNV-1a by words of 8 bytes: inputs that differ in one word have different hashes. */
uint64_t fmu_hash(const void *bytes, size_t size);

#endif
