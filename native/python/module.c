/* SPDX-License-Identifier: Apache-2.0
 *
 * Module shmtf._core: its state, its functions, its types.
 */
#include "python/binding.h"

#include <time.h>

/* ---- functions ---- */

static PyObject *replace(PyObject **place, PyObject *value) {
    if (!PyCallable_Check(value)) return PyErr_Format(PyExc_TypeError, "not callable: %R", value);
    PyObject *old = *place;
    *place = Py_NewRef(value);
    Py_XDECREF(old);
    return Py_NewRef(Py_None);
}

static PyObject *set_error_factory(PyObject *module, PyObject *factory) {
    return replace(&((module_state *)PyModule_GetState(module))->error_factory, factory);
}

static PyObject *set_stamp_converter(PyObject *module, PyObject *converter) {
    return replace(&((module_state *)PyModule_GetState(module))->stamp_converter, converter);
}

static PyObject *now(PyObject *module, PyObject *unused) {
    (void)module;
    (void)unused;
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    return PyLong_FromLongLong((long long)t.tv_sec * 1000000000 + t.tv_nsec);
}

static PyObject *stamp_ns(PyObject *module, PyObject *time) {
    int64_t ns;
    return py_stamp(PyModule_GetState(module), time, "time", &ns) ? PyLong_FromLongLong(ns) : NULL;
}

static PyObject *format_fd(PyObject *module, PyObject *args) {
    int fd;
    long long cache_time_ns;
    shmtf_config config;
    shmtf_error error;
    shmtf_status status;
    unsigned long long stream_bytes;
    module_state *m = PyModule_GetState(module);
    if (!PyArg_ParseTuple(args, "iIILKI:format_fd", &fd, &config.max_frames, &config.history, &cache_time_ns, &stream_bytes,
                          &config.max_writers))
        return NULL;
    config.cache_time_ns = cache_time_ns;
    config.stream_bytes = stream_bytes;
    Py_BEGIN_ALLOW_THREADS
    status = shmtf_format_fd(fd, &config, &error);
    Py_END_ALLOW_THREADS
    return status == SHMTF_OK ? Py_NewRef(Py_None) : py_raise_error(m, &error, NULL);
}

static PyObject *unlink_bell_fd(PyObject *module, PyObject *fd) {
    shmtf_error error;
    int number = PyObject_AsFileDescriptor(fd);
    if (number < 0) return NULL;
    if (shmtf_unlink_bell_fd(number, &error) != SHMTF_OK) return py_raise_error(PyModule_GetState(module), &error, NULL);
    return Py_NewRef(Py_None);
}

static PyMethodDef functions[] = {
    {"now", now, METH_NOARGS, PyDoc_STR("now($module)\n--\n\nThe time (CLOCK_REALTIME) in int nanoseconds.")},
    {"stamp_ns", stamp_ns, METH_O, PyDoc_STR("stamp_ns($module, time, /)\n--\n\nAny accepted time as int nanoseconds.")},
    {"format_fd", format_fd, METH_VARARGS,
     PyDoc_STR("format_fd($module, fd, max_frames, history, cache_time_ns, stream_bytes, max_writers, /)\n--\n\n"
               "Lay an empty store into an empty file on tmpfs.  cache_time_ns < 0: records never expire.")},
    {"unlink_bell_fd", unlink_bell_fd, METH_O, PyDoc_STR("unlink_bell_fd($module, fd, /)\n--\n\nRemove the bell of the store open in fd.")},
    {"set_transform_type", py_set_transform_type, METH_O, PyDoc_STR("set_transform_type($module, type, /)\n--\n\nThe class that lookups return.")},
    {"set_error_factory", set_error_factory, METH_O,
     PyDoc_STR("set_error_factory($module, factory, /)\n--\n\nfactory(status: str, fields: dict) makes the exceptions.")},
    {"set_stamp_converter", set_stamp_converter, METH_O,
     PyDoc_STR("set_stamp_converter($module, converter, /)\n--\n\nconverter(time, argument_name) gives int nanoseconds of other types.")},
    {NULL, NULL, 0, NULL},
};

/* ---- module ---- */

static bool add_types(PyObject *module, module_state *m) {
    if (!(m->transform_base = py_transform_type_new(module))) return false;
    m->transform_type = (PyTypeObject *)Py_NewRef((PyObject *)m->transform_base);
    if (!(m->reader_type = py_reader_type_new(module))) return false;
    if (!(m->store_type = py_store_type_new(module, m->reader_type))) return false;
    if (!(m->snapshot_type = py_snapshot_type_new(module, m->reader_type))) return false;
    return PyModule_AddType(module, m->transform_base) == 0 && PyModule_AddType(module, m->reader_type) == 0 &&
           PyModule_AddType(module, m->store_type) == 0 && PyModule_AddType(module, m->snapshot_type) == 0;
}

static int execute(PyObject *module) {
    if (!add_types(module, PyModule_GetState(module))) return -1;
    return PyModule_AddStringConstant(module, "__version__", shmtf_version());
}

static int traverse(PyObject *module, visitproc visit, void *arg) {
    module_state *m = PyModule_GetState(module);
    Py_VISIT(m->transform_base);
    Py_VISIT(m->transform_type);
    Py_VISIT(m->reader_type);
    Py_VISIT(m->store_type);
    Py_VISIT(m->snapshot_type);
    Py_VISIT(m->error_factory);
    Py_VISIT(m->stamp_converter);
    return 0;
}

static int clear(PyObject *module) {
    module_state *m = PyModule_GetState(module);
    Py_CLEAR(m->transform_base);
    Py_CLEAR(m->transform_type);
    Py_CLEAR(m->reader_type);
    Py_CLEAR(m->store_type);
    Py_CLEAR(m->snapshot_type);
    Py_CLEAR(m->error_factory);
    Py_CLEAR(m->stamp_converter);
    return 0;
}

static void release(void *module) { (void)clear(module); }

static PyModuleDef_Slot slots[] = {
    {Py_mod_exec, execute},
    {0, NULL},
};

static struct PyModuleDef definition = {
    .m_base = PyModuleDef_HEAD_INIT,
    .m_name = "shmtf._core",
    .m_doc = "The C core of shmtf.  Private: use the package's names.",
    .m_size = sizeof(module_state),
    .m_methods = functions,
    .m_slots = slots,
    .m_traverse = traverse,
    .m_clear = clear,
    .m_free = release,
};

PyMODINIT_FUNC PyInit__core(void);
PyMODINIT_FUNC PyInit__core(void) { return PyModuleDef_Init(&definition); }
