/* How a page makes an instance. It has no function pointers to give, and a place for messages of its own. */
#include "fmi3Functions.h"

__attribute__((import_module("page"), import_name("log"))) void page_log(int status, const char *text);

static void hear(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String text)
{
    page_log((int)status, text);
}

FMI3_Export fmi3Instance page_instantiate(const char *name, const char *token, const char *resources)
{
    return fmi3InstantiateCoSimulation(name, token, resources, false, false, false, false, NULL, 0, NULL, hear, NULL);
}
