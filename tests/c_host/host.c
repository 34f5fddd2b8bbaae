/* A host that is not Python: loads FMI 2.0 co-simulation FMUs and does what it is told.
 *
 * One command a line on standard input, one answer a line on standard output that begins with
 * '=' and the fmi2Status. Log messages come before it, in lines that begin with '!'. Numbers
 * are hexadecimal floats, so that not a bit is lost. S is an instance's slot, K a state's.
 *
 *   lib L PATH                    new S L GUID URI        free S
 *   setup S START STOP            enter S | exit S | term S | reset S
 *   setr S N VR.. VALUE..         getr S N VR..           (also b: Boolean, i: Integer)
 *   sets S VR TEXT                gets S VR
 *   step S TIME SIZE              copy FROM TO N VR.. VR..
 *   save S K | load S K | drop S K | write S K FILE | read S K FILE
 */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} callbacks;

typedef void *instance;
typedef struct {
    instance (*instantiate)(const char *, int, const char *, const char *, const callbacks *, int, int);
    void (*release)(instance);
    int (*setup)(instance, int, double, double, int, double);
    int (*enter)(instance), (*leave)(instance), (*terminate)(instance), (*reset)(instance);
    int (*set_real)(instance, const unsigned *, size_t, const double *);
    int (*get_real)(instance, const unsigned *, size_t, double *);
    int (*set_boolean)(instance, const unsigned *, size_t, const int *);
    int (*get_boolean)(instance, const unsigned *, size_t, int *);
    int (*set_integer)(instance, const unsigned *, size_t, const int *);
    int (*get_integer)(instance, const unsigned *, size_t, int *);
    int (*set_string)(instance, const unsigned *, size_t, const char *const *);
    int (*get_string)(instance, const unsigned *, size_t, const char **);
    int (*step)(instance, double, double, int);
    int (*get_state)(instance, void **), (*set_state)(instance, void *), (*free_state)(instance, void **);
    int (*state_size)(instance, void *, size_t *);
    int (*serialize)(instance, void *, char *, size_t);
    int (*deserialize)(instance, const char *, size_t, void **);
} functions;

#define SLOTS 64
#define MOST 512
static functions libraries[SLOTS];
static functions *of[SLOTS];
static instance instances[SLOTS];
static void *states[SLOTS];
static unsigned references[2][MOST];
static double reals[MOST];
static int integers[MOST];

static void log_message(void *env, const char *name, int status, const char *category,
                        const char *message, ...)
{
    char text[16384];
    va_list more;
    (void)env;
    va_start(more, message);
    vsnprintf(text, sizeof text, message, more); /* a printf format, as importers take it */
    va_end(more);
    for (char *c = text; *c; c++)
        if (*c == '\n' || *c == '\r') *c = '\t';
    printf("! %d %s %s %s\n", status, category ? category : "(null)", name, text);
}

static const callbacks callback_functions = {log_message, calloc, free, NULL, NULL};

static int load_library(functions *f, const char *path)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        printf("! 3 dlopen - %s\n", dlerror());
        return 3;
    }
#define BIND(member, name) \
    if (!(*(void **)&f->member = dlsym(library, name))) return 3
    BIND(instantiate, "fmi2Instantiate");
    BIND(release, "fmi2FreeInstance");
    BIND(setup, "fmi2SetupExperiment");
    BIND(enter, "fmi2EnterInitializationMode");
    BIND(leave, "fmi2ExitInitializationMode");
    BIND(terminate, "fmi2Terminate");
    BIND(reset, "fmi2Reset");
    BIND(set_real, "fmi2SetReal");
    BIND(get_real, "fmi2GetReal");
    BIND(set_boolean, "fmi2SetBoolean");
    BIND(get_boolean, "fmi2GetBoolean");
    BIND(set_integer, "fmi2SetInteger");
    BIND(get_integer, "fmi2GetInteger");
    BIND(set_string, "fmi2SetString");
    BIND(get_string, "fmi2GetString");
    BIND(step, "fmi2DoStep");
    BIND(get_state, "fmi2GetFMUstate");
    BIND(set_state, "fmi2SetFMUstate");
    BIND(free_state, "fmi2FreeFMUstate");
    BIND(state_size, "fmi2SerializedFMUstateSize");
    BIND(serialize, "fmi2SerializeFMUstate");
    BIND(deserialize, "fmi2DeSerializeFMUstate");
    return 0;
}

static char *word(void)
{
    char *found = strtok(NULL, " \n");
    if (!found) {
        fprintf(stderr, "host: a command is too short\n");
        exit(2);
    }
    return found;
}

static int number(void) { return (int)strtoul(word(), NULL, 10); }
static double real(void) { return strtod(word(), NULL); }

static void read_references(unsigned *target, int n)
{
    for (int i = 0; i < n; i++) target[i] = (unsigned)strtoul(word(), NULL, 10);
}

static int set_values(char kind, functions *f, instance c)
{
    int n = number();
    read_references(references[0], n);
    if (kind == 'r') {
        for (int i = 0; i < n; i++) reals[i] = real();
        return f->set_real(c, references[0], n, reals);
    }
    for (int i = 0; i < n; i++) integers[i] = number();
    return (kind == 'b' ? f->set_boolean : f->set_integer)(c, references[0], n, integers);
}

static int get_values(char kind, functions *f, instance c, int *count)
{
    int n = *count = number();
    read_references(references[0], n);
    if (kind == 'r') return f->get_real(c, references[0], n, reals);
    int status = (kind == 'b' ? f->get_boolean : f->get_integer)(c, references[0], n, integers);
    for (int i = 0; i < n; i++) reals[i] = integers[i];
    return status;
}

static int write_state(functions *f, instance c, int k, const char *path)
{
    size_t size = 0;
    int status = f->state_size(c, states[k], &size);
    char *bytes = malloc(size);
    FILE *file = fopen(path, "wb");
    if (status < 2) status = f->serialize(c, states[k], bytes, size);
    fwrite(bytes, 1, size, file);
    fclose(file);
    free(bytes);
    return status;
}

static int read_state(functions *f, instance c, int k, const char *path)
{
    static char bytes[1 << 20];
    FILE *file = fopen(path, "rb");
    size_t size = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    return f->deserialize(c, bytes, size, &states[k]);
}

static int copy_values(void)
{
    int from = number(), to = number(), n = number();
    read_references(references[0], n);
    read_references(references[1], n);
    int status = of[from]->get_real(instances[from], references[0], n, reals);
    return status < 2 ? of[to]->set_real(instances[to], references[1], n, reals) : status;
}

int main(void)
{
    static char line[1 << 16];
    while (fgets(line, sizeof line, stdin)) {
        char *command = strtok(line, " \n"), *text = NULL;
        int status = 0, count = 0;
        if (!command) continue;
        if (!strcmp(command, "lib")) {
            int l = number();
            status = load_library(&libraries[l], strtok(NULL, "\n")); /* may hold spaces */
        } else if (!strcmp(command, "copy")) {
            status = copy_values();
        } else {
            int s = number();
            functions *f = of[s];
            instance c = instances[s];
            if (!strcmp(command, "new")) {
                f = of[s] = &libraries[number()];
                char *guid = word(), name[16];
                snprintf(name, sizeof name, "slot%d", s);
                instances[s] = f->instantiate(name, 1, guid, word(), &callback_functions, 0, 1);
                status = instances[s] ? 0 : 3;
            } else if (!strcmp(command, "free")) {
                f->release(c);
                instances[s] = NULL;
            } else if (!strcmp(command, "setup")) {
                double start = real();
                status = f->setup(c, 0, 0.0, start, 1, real());
            } else if (!strcmp(command, "enter")) status = f->enter(c);
            else if (!strcmp(command, "exit")) status = f->leave(c);
            else if (!strcmp(command, "term")) status = f->terminate(c);
            else if (!strcmp(command, "reset")) status = f->reset(c);
            else if (!strcmp(command, "step")) {
                double time = real();
                status = f->step(c, time, real(), 1);
            } else if (!strcmp(command, "save")) status = f->get_state(c, &states[number()]);
            else if (!strcmp(command, "load")) status = f->set_state(c, states[number()]);
            else if (!strcmp(command, "drop")) status = f->free_state(c, &states[number()]);
            else if (!strcmp(command, "write")) {
                int k = number();
                status = write_state(f, c, k, word());
            } else if (!strcmp(command, "read")) {
                int k = number();
                status = read_state(f, c, k, word());
            } else if (!strcmp(command, "sets")) {
                unsigned reference = (unsigned)number();
                const char *value = strtok(NULL, "\n");
                value = value ? value : "";
                status = f->set_string(c, &reference, 1, &value);
            } else if (!strcmp(command, "gets")) {
                unsigned reference = (unsigned)number();
                status = f->get_string(c, &reference, 1, (const char **)&text);
            } else if (!strncmp(command, "set", 3)) status = set_values(command[3], f, c);
            else if (!strncmp(command, "get", 3)) status = get_values(command[3], f, c, &count);
            else return 2;
        }
        printf("= %d", status);
        for (int i = 0; i < count; i++) printf(" %a", reals[i]);
        printf("%s%s\n", text ? " " : "", text ? text : "");
        fflush(stdout);
    }
    return 0;
}
