/* SPDX-License-Identifier: Apache-2.0 */
#include "python/bench_python.h"

#include <string.h>

#include "line.h"
#include "micro.h"
#include "protocol.h"
#include "rates.h"
#include "scale.h"
#include "verify.h"

#if defined(__clang__)
#define COMPILER __VERSION__
#else
#define COMPILER "gcc " __VERSION__
#endif

static PyObject *nothing(PyObject *module, PyObject *const *args, Py_ssize_t n) {
    (void)module;
    if (n != 2 || !PyUnicode_AsUTF8AndSize(args[0], NULL) || !PyUnicode_AsUTF8AndSize(args[1], NULL))
        return PyErr_Format(PyExc_TypeError, "nothing(str, str)");
    return Py_NewRef(Py_None);
}

static PyObject *micro(PyObject *module, PyObject *args) {
    micro_options o;
    micro_result result;
    shmtf_error e;
    shmtf_status st;
    char message[512];
    long long round_ns;
    (void)module;
    memset(&o, 0, sizeof o);
    if (!PyArg_ParseTuple(args, "IIIiLiz:micro", &o.n_frames, &o.history, &o.depth, &o.rounds, &round_ns, &o.cpu, &o.peer)) return NULL;
    o.round_ns = round_ns;
    if (!o.depth || o.depth > MICRO_MAX_DEPTH || o.n_frames <= o.depth || o.n_frames <= MICRO_WRITE_LEN)
        return PyErr_Format(PyExc_ValueError, "depth 1 to %d, more frames than it and than %d", MICRO_MAX_DEPTH, MICRO_WRITE_LEN);
    if (!o.history || o.rounds < 1 || o.rounds > MICRO_MAX_ROUNDS || round_ns < 1)
        return PyErr_Format(PyExc_ValueError, "at least 1 record, 1 to %d rounds, and 1 ns for each", MICRO_MAX_ROUNDS);
    Py_BEGIN_ALLOW_THREADS
    st = micro_run(&o, &result, &e);
    bench_unpin();
    Py_END_ALLOW_THREADS
    if (st == SHMTF_FULL) return Py_NewRef(Py_None);
    if (st != SHMTF_OK) return PyErr_Format(PyExc_RuntimeError, "%s", shmtf_error_message(&e, message, sizeof message));
    PyObject *list = PyList_New(0);
    for (size_t i = 0; list && i < result.n; i++) {
        const micro_row *r = &result.rows[i];
        PyObject *row = Py_BuildValue("(sszddddzz)", r->name, r->what, r->floor, r->ns.median, r->ns.min, r->ns.max, r->ratio,
                                      r->peer, r->beside);
        if (!row || PyList_Append(list, row) < 0) Py_CLEAR(list);
        Py_XDECREF(row);
    }
    return list ? Py_BuildValue("(Ns)", list, result.without_peer) : NULL;
}

static PyObject *scale(PyObject *module, PyObject *args) {
    scale_options o;
    scale_row rows[SCALE_N_ROWS];
    shmtf_error e;
    shmtf_status st;
    char message[512];
    long long round_ns;
    (void)module;
    memset(&o, 0, sizeof o);
    if (!PyArg_ParseTuple(args, "IIIiLi:scale", &o.n_frames, &o.history, &o.depth, &o.rounds, &round_ns, &o.cpu)) return NULL;
    o.round_ns = round_ns;
    if (!o.depth || o.depth >= o.n_frames || o.history < SCALE_MIN_HISTORY || o.rounds < 1 || o.rounds > SCALE_MAX_ROUNDS || round_ns < 1)
        return PyErr_Format(PyExc_ValueError, "at least 1 edge and more frames than edges, %d records, 1 to %d rounds", SCALE_MIN_HISTORY,
                            SCALE_MAX_ROUNDS);
    Py_BEGIN_ALLOW_THREADS
    st = scale_run(&o, rows, &e);
    bench_unpin();
    Py_END_ALLOW_THREADS
    if (st == SHMTF_FULL) return Py_NewRef(Py_None);
    if (st != SHMTF_OK) return PyErr_Format(PyExc_RuntimeError, "%s", shmtf_error_message(&e, message, sizeof message));
    PyObject *list = PyList_New(0);
    for (size_t i = 0; list && i < SCALE_N_ROWS; i++) {
        const scale_row *r = &rows[i];
        PyObject *row = Py_BuildValue("(ssddd)", r->name, r->what, r->ns.median, r->ns.min, r->ns.max);
        if (!row || PyList_Append(list, row) < 0) Py_CLEAR(list);
        Py_XDECREF(row);
    }
    return list;
}

static PyObject *protocols(PyObject *module, PyObject *unused) {
    (void)module;
    (void)unused;
    PyObject *dict = PyDict_New();
    const bench_protocol *p;
    for (size_t i = 0; dict && (p = bench_protocol_at(i)); i++) {
        PyObject *traits = Py_BuildValue("(sOO)", p->what, p->threads ? Py_True : Py_False, p->common_time ? Py_True : Py_False);
        if (!traits || PyDict_SetItemString(dict, p->name, traits) < 0) Py_CLEAR(dict);
        Py_XDECREF(traits);
    }
    return dict;
}

static PyObject *load(PyObject *module, PyObject *text) {
    char error[BENCH_ERROR_SIZE];
    const char *path = PyUnicode_AsUTF8AndSize(text, NULL);
    (void)module;
    if (!path) return NULL;
    const bench_protocol *p = bench_protocol_load(path, error);
    return p ? PyUnicode_FromString(p->name) : PyErr_Format(PyExc_OSError, "%s", error);
}

static const bench_protocol *protocol_named(const char *name) {
    const bench_protocol *p = bench_protocol_find(name);
    if (!p) PyErr_Format(PyExc_ValueError, "no such protocol: %s", name);
    return p;
}

static PyObject *create(PyObject *module, PyObject *args) {
    const char *name, *wish;
    char place[BENCH_PLACE_SIZE], error[BENCH_ERROR_SIZE] = "";
    bench_shape shape = {.by_name = true};
    bool ok;
    (void)module;
    if (!PyArg_ParseTuple(args, "ssIIII:create", &name, &wish, &shape.n_frames, &shape.history, &shape.read_len, &shape.write_len))
        return NULL;
    const bench_protocol *p = protocol_named(name);
    if (!p) return NULL;
    snprintf(place, sizeof place, "%s", wish);
    Py_BEGIN_ALLOW_THREADS
    ok = p->create(place, &shape, error);
    if (ok && !bench_verify(p, place, &shape, error)) {
        p->remove(place);
        ok = false;
    }
    Py_END_ALLOW_THREADS
    return ok ? PyUnicode_FromString(place) : PyErr_Format(PyExc_RuntimeError, "%s: %s", name, error);
}

static PyObject *remove_place(PyObject *module, PyObject *args) {
    const char *name, *place;
    (void)module;
    if (!PyArg_ParseTuple(args, "ss:remove", &name, &place)) return NULL;
    const bench_protocol *p = protocol_named(name);
    if (!p) return NULL;
    p->remove(place);
    return Py_NewRef(Py_None);
}

static PyObject *mixed_rate(PyObject *module, PyObject *frames) {
    bench_shape shape = {.n_frames = (uint32_t)PyLong_AsUnsignedLong(frames)};
    double sum = 0;
    (void)module;
    if (PyErr_Occurred()) return NULL;
    for (uint32_t child = 1; child < shape.n_frames; child++) sum += rates_of(&shape, child);
    return PyFloat_FromDouble(sum);
}

static PyObject *round_trip(PyObject *module, PyObject *args) {
    int a, b;
    double ns;
    (void)module;
    if (!PyArg_ParseTuple(args, "ii:round_trip", &a, &b)) return NULL;
    Py_BEGIN_ALLOW_THREADS
    ns = bench_line_round_trip(a, b);
    Py_END_ALLOW_THREADS
    return ns < 0 ? Py_NewRef(Py_None) : PyFloat_FromDouble(ns);
}

static PyObject *cpus(PyObject *module, PyObject *unused) {
    (void)module;
    (void)unused;
    PyObject *list = PyList_New(0);
    for (int i = 0, cpu; list && (cpu = bench_cpu_allowed(i)) >= 0; i++) {
        PyObject *number = PyLong_FromLong(cpu);
        if (!number || PyList_Append(list, number) < 0) Py_CLEAR(list);
        Py_XDECREF(number);
    }
    return list;
}

static PyObject *pin(PyObject *module, PyObject *number) {
    long cpu = PyLong_AsLong(number);
    (void)module;
    if (cpu == -1 && PyErr_Occurred()) return NULL;
    if (cpu < 0) bench_unpin();
    return PyBool_FromLong(cpu >= 0 && bench_pin((int)cpu) >= 0);
}

static PyMethodDef functions[] = {
    {"nothing", (PyCFunction)(void (*)(void))nothing, METH_FASTCALL,
     PyDoc_STR("nothing(a, b)\n--\n\nTakes two names and does nothing: the floor of every call from Python.")},
    {"micro", micro, METH_VARARGS,
     PyDoc_STR("micro(frames, history, depth, rounds, round_ns, cpu, peer)\n--\n\n"
               "([(name, what, floor, median_ns, min_ns, max_ns, ratio, peer, beside)], why the peer's rows are missing or \"\");\n"
               "None: shared memory is too small for it.")},
    {"scale", scale, METH_VARARGS,
     PyDoc_STR("scale(frames, history, depth, rounds, round_ns, cpu)\n--\n\n"
               "[(name, what, median_ns, min_ns, max_ns)]; None: shared memory is too small for it.")},
    {"protocols", protocols, METH_NOARGS, PyDoc_STR("protocols()\n--\n\n{name: (what it is, its workers are threads, lookups are at a common time)}")},
    {"load", load, METH_O, PyDoc_STR("load(path)\n--\n\nAdd the peer in a shared library; returns its name.")},
    {"create", create, METH_VARARGS,
     PyDoc_STR("create(protocol, name, frames, history, read_len, write_len)\n--\n\n"
               "Make a protocol's shared memory, and look whether its answers are right; returns what workers attach to.")},
    {"remove", remove_place, METH_VARARGS, PyDoc_STR("remove(protocol, place)\n--\n\nRemove its name; who is attached stays attached.")},
    {"mixed_rate", mixed_rate, METH_O, PyDoc_STR("mixed_rate(frames)\n--\n\nUpdates per second that `mixed-rate` asks for, of all edges.")},
    {"round_trip", round_trip, METH_VARARGS,
     PyDoc_STR("round_trip(cpu_a, cpu_b)\n--\n\nns for a cache line from one CPU to another and back, or None.")},
    {"cpus", cpus, METH_NOARGS, PyDoc_STR("cpus()\n--\n\nThe CPUs that this process was given.")},
    {"pin", pin, METH_O, PyDoc_STR("pin(cpu)\n--\n\nBind the calling thread to a CPU; negative: to all it was given.")},
    {NULL, NULL, 0, NULL},
};

static int execute(PyObject *module) {
    PyObject *control = bench_control_type_new(module);
    if (!control) return -1;
    int failed = PyModule_AddObjectRef(module, "Control", control);
    Py_DECREF(control);
    if (failed || PyModule_AddStringConstant(module, "COMPILER", COMPILER) < 0) return -1;
    return PyModule_AddStringConstant(module, "LIBRARY", shmtf_version());
}

static PyModuleDef_Slot slots[] = {
    {Py_mod_exec, execute},
    {0, NULL},
};

static struct PyModuleDef definition = {
    .m_base = PyModuleDef_HEAD_INIT,
    .m_name = "shmtf._bench",
    .m_doc = "The benchmarks' C loops.  Private: use shmtf-bench.",
    .m_size = 0,
    .m_methods = functions,
    .m_slots = slots,
};

PyMODINIT_FUNC PyInit__bench(void);
PyMODINIT_FUNC PyInit__bench(void) { return PyModuleDef_Init(&definition); }
