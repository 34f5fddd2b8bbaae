/* A master in C over libcosim's C library: runs an unpacked SSP and prints values.
 *
 *   libcosim_host LIBRARY FOLDER STEPS SLAVE REFERENCE..
 *
 * After each step, one line with the values of the named slave's Real variables as hexadecimal
 * floats.
 */
#include <dlfcn.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define BIND(type, name, ...)                                     \
    type (*name)(__VA_ARGS__) = (type(*)(__VA_ARGS__))dlsym(library, #name); \
    if (!name) return 3

#define MOST 512

typedef struct {
    char name[1024];
    int index;
} slave_info;

int main(int argc, char **argv)
{
    if (argc < 6 || argc - 5 > MOST) return 2;
    void *library = dlopen(argv[1], RTLD_NOW);
    if (!library) {
        fprintf(stderr, "%s\n", dlerror());
        return 3;
    }
    BIND(void *, cosim_ssp_execution_create, const char *, bool, int64_t);
    BIND(int, cosim_execution_destroy, void *);
    BIND(int, cosim_execution_step, void *, size_t);
    BIND(void *, cosim_last_value_observer_create, void);
    BIND(int, cosim_observer_destroy, void *);
    BIND(int, cosim_execution_add_observer, void *, void *);
    BIND(int, cosim_observer_slave_get_real, void *, int, const uint32_t *, size_t, double *);
    BIND(size_t, cosim_execution_get_num_slaves, void *);
    BIND(int, cosim_execution_get_slave_infos, void *, slave_info *, size_t);
    BIND(const char *, cosim_last_error_message, void);

    uint32_t references[MOST];
    double values[MOST];
    size_t count = (size_t)argc - 5;
    for (size_t i = 0; i < count; i++) references[i] = (uint32_t)strtoul(argv[5 + i], NULL, 10);
    void *execution = cosim_ssp_execution_create(argv[2], false, 0);
    if (!execution) {
        fprintf(stderr, "%s\n", cosim_last_error_message());
        return 4;
    }
    void *observer = cosim_last_value_observer_create();
    cosim_execution_add_observer(execution, observer);
    slave_info infos[8];
    size_t slaves = cosim_execution_get_num_slaves(execution);
    int slave = -1;
    if (slaves > 8 || cosim_execution_get_slave_infos(execution, infos, slaves)) return 6;
    for (size_t i = 0; i < slaves; i++)
        if (!strcmp(infos[i].name, argv[4])) slave = infos[i].index;
    for (int step = atoi(argv[3]); step > 0; step--) {
        if (cosim_execution_step(execution, 1) ||
            cosim_observer_slave_get_real(observer, slave, references, count, values)) {
            fprintf(stderr, "%s\n", cosim_last_error_message());
            return 5;
        }
        for (size_t i = 0; i < count; i++) printf("%a ", values[i]);
        printf("\n");
    }
    cosim_execution_destroy(execution);
    cosim_observer_destroy(observer);
    return 0;
}
