/* Python: that of the process, or else the recorded one; opened at run time, not linked. */
#ifndef FMU_PYTHON_LIBRARY_H
#define FMU_PYTHON_LIBRARY_H

#include "backend.h"

/* Of Python's stable ABI (PEP 384), declared here so that it works with any Python and platform. */
typedef struct python_object python_object;
typedef ptrdiff_t python_size;
enum { PYTHON_FILE_INPUT = 257, PYTHON_WRITABLE = 0x200 }; /* Py_file_input, PyBUF_WRITE */

#define PYTHON_FUNCTIONS(X)                                                                          \
    X(int, Py_IsInitialized, (void))                                                                 \
    X(const char *, Py_GetVersion, (void))                                                           \
    X(void, Py_InitializeEx, (int with_signals))                                                     \
    X(void *, PyEval_SaveThread, (void))                                                             \
    X(void *, PyGILState_GetThisThreadState, (void))                                                 \
    X(int, PyGILState_Ensure, (void))                                                                \
    X(void, PyGILState_Release, (int state))                                                         \
    X(void, Py_IncRef, (python_object *))                                                            \
    X(void, Py_DecRef, (python_object *))                                                            \
    X(void, PyErr_Clear, (void))                                                                     \
    X(python_object *, Py_CompileString, (const char *text, const char *file, int kind))             \
    X(python_object *, PyEval_EvalCode, (python_object *, python_object *, python_object *))         \
    X(python_object *, PyImport_ImportModule, (const char *name))                                    \
    X(python_object *, PyDict_New, (void))                                                           \
    X(int, PyDict_SetItemString, (python_object *, const char *, python_object *))                   \
    X(python_object *, PyDict_GetItemString, (python_object *, const char *))                        \
    X(python_object *, PyObject_GetAttrString, (python_object *, const char *))                      \
    X(python_object *, PyObject_CallFunctionObjArgs, (python_object *, ...))                         \
    X(python_object *, PyMemoryView_FromMemory, (char *, python_size, int))                          \
    X(python_object *, PyUnicode_FromString, (const char *))                                         \
    X(const char *, PyUnicode_AsUTF8AndSize, (python_object *, python_size *))                       \
    X(python_object *, PyLong_FromLongLong, (long long))                                             \
    X(int, PySys_SetObject, (const char *name, python_object *))                                     \
    X(long, PyLong_AsLong, (python_object *))                                                        \
    X(python_object *, PyFloat_FromDouble, (double))                                                 \
    X(python_object *, PyBytes_FromStringAndSize, (const char *, python_size))                       \
    X(char *, PyBytes_AsString, (python_object *))                                                   \
    X(python_size, PyBytes_Size, (python_object *))                                                  \
    X(python_object *, PyList_New, (python_size))                                                    \
    X(int, PyList_Append, (python_object *, python_object *))                                        \
    X(python_size, PyList_Size, (python_object *))                                                   \
    X(python_object *, PyList_GetItem, (python_object *, python_size))                               \
    X(python_size, PyTuple_Size, (python_object *))                                                  \
    X(python_object *, PyTuple_GetItem, (python_object *, python_size))

typedef struct {
#define X(result, name, arguments) result(*name) arguments;
    PYTHON_FUNCTIONS(X)
#undef X
    python_object *none;
} python_functions;

extern python_functions py;

/* Finds or starts Python, once per process. It is never finalized, since other code may use it. */
fmu_status python_open(fmu *f);

#endif
