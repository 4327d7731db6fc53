/* The compiled tick for CPython, `ces_observer._tick`: functions of ces_core.h with the buffers of their arrays.
 *
 * bind(name, *arrays) returns a function of the numbers that remain. Its arrays stay where they are as long as it is
 * there: an array.array that is bound cannot change its length. tick_calls.h is printed by c_printer.py; it holds
 * a wrapper for each entry point and the table ENTRIES.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "ces_core.h"

enum { MAX_ARRAYS = 16 };

typedef struct {
    PyObject_HEAD
    int count;
    Py_buffer arrays[MAX_ARRAYS];
} Bound;

typedef struct {
    const char *kinds; /* of its arrays: d and q are read only, D and Q are stored into */
    PyMethodDef method;
} Entry;

static void bound_dealloc(PyObject *self) {
    Bound *bound = (Bound *)self;
    for (int i = 0; i < bound->count; i++) {
        PyBuffer_Release(&bound->arrays[i]);
    }
    PyObject_Free(self);
}

static PyTypeObject BoundType = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "ces_observer._tick.Bound",
    .tp_basicsize = sizeof(Bound),
    .tp_dealloc = bound_dealloc,
    .tp_flags = Py_TPFLAGS_DEFAULT,
};

static PyObject *refuse_count(const char *name, int expected, Py_ssize_t given) {
    return PyErr_Format(PyExc_TypeError, "%s takes %d numbers; %zd given", name, expected, given);
}

/* Return a whole number; one beyond 64 bits becomes the nearest end of their range. */
static int64_t as_int(PyObject *number) {
    int beyond;
    const long long value = PyLong_AsLongLongAndOverflow(number, &beyond);
    return beyond > 0 ? INT64_MAX : beyond < 0 ? INT64_MIN : value;
}

#include "tick_calls.h"

/* Hold an array's buffer; return false, with an exception, if its items are of another kind. */
static bool hold_array(Bound *bound, const Entry *entry, PyObject *array) {
    const char kind = entry->kinds[bound->count];
    const bool floats = kind == 'd' || kind == 'D';
    const int flags = PyBUF_FORMAT | PyBUF_C_CONTIGUOUS | (kind == 'D' || kind == 'Q' ? PyBUF_WRITABLE : 0);
    Py_buffer *view = &bound->arrays[bound->count];
    if (PyObject_GetBuffer(array, view, flags) < 0) {
        return false;
    }
    bound->count++;
    const char *format = view->format ? view->format : "B";
    if (view->itemsize == 8 && format[0] != '\0' && format[1] == '\0' && strchr(floats ? "d" : "ql", format[0])) {
        return true;
    }
    PyErr_Format(PyExc_TypeError, "%s: argument %d is an array of '%s'; expected '%s'", entry->method.ml_name,
        bound->count, format, floats ? "d" : "q");
    return false;
}

static PyObject *bind(PyObject *Py_UNUSED(module), PyObject *const *given, Py_ssize_t count) {
    const char *name = count ? PyUnicode_AsUTF8(given[0]) : "";
    Entry *entry = ENTRIES;
    while (name && entry->kinds && strcmp(entry->method.ml_name, name)) {
        entry++;
    }
    if (!name || !entry->kinds) {
        return name ? PyErr_Format(PyExc_LookupError, "'%s' is not in the compiled core", name) : NULL;
    }
    const Py_ssize_t expected = (Py_ssize_t)strlen(entry->kinds);
    if (count - 1 != expected) {
        return PyErr_Format(PyExc_TypeError, "%s takes %zd arrays; %zd given", name, expected, count - 1);
    }
    Bound *bound = PyObject_New(Bound, &BoundType);
    if (!bound) {
        return NULL;
    }
    bound->count = 0;
    bool held = true;
    while (held && bound->count < expected) {
        held = hold_array(bound, entry, given[1 + bound->count]);
    }
    PyObject *function = held ? PyCFunction_New(&entry->method, (PyObject *)bound) : NULL;
    Py_DECREF(bound);
    return function;
}

static PyMethodDef METHODS[] = {
    {"bind", (PyCFunction)(void (*)(void))bind, METH_FASTCALL, "bind(name, *arrays): a function of the tick"},
    {NULL, NULL, 0, NULL},
};

static PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, .m_name = "_tick", .m_doc = "The compiled tick.", .m_size = -1, .m_methods = METHODS};

PyMODINIT_FUNC PyInit__tick(void) {
    if (PyType_Ready(&BoundType) < 0) {
        return NULL;
    }
    PyObject *module = PyModule_Create(&MODULE);
    PyObject *names = PyFrozenSet_New(NULL);
    for (const Entry *entry = ENTRIES; names && entry->kinds; entry++) {
        PyObject *name = PyUnicode_FromString(entry->method.ml_name);
        if (!name || PySet_Add(names, name) < 0) {
            Py_CLEAR(names);
        }
        Py_XDECREF(name);
    }
    if (!module || !names || PyModule_AddObjectRef(module, "FUNCTIONS", names) < 0 ||
        PyModule_AddStringConstant(module, "DIGEST", TICK_DIGEST) < 0) {
        Py_CLEAR(module);
    }
    Py_XDECREF(names);
    return module;
}
