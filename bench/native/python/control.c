/* SPDX-License-Identifier: Apache-2.0
 *
 * Type Control: the shared memory of control.h, for the coordinator and for workers.
 */
#include "python/bench_python.h"

#include <errno.h>
#include <string.h>
#include <unistd.h>

#include "worker.h"

typedef struct {
    PyObject_HEAD
    bench_control *c;
    int fd; /* of the one that made it, else -1 */
    char path[64];
} Control;

static bench_control *control_of(PyObject *self) { return ((Control *)self)->c; }

static PyObject *control_new(PyTypeObject *type, PyObject *args, PyObject *keywords) {
    PyObject *given;
    int fd = -1;
    char path[64];
    if (keywords && PyDict_Size(keywords)) return PyErr_Format(PyExc_TypeError, "Control takes no keyword arguments");
    if (!PyArg_ParseTuple(args, "O:Control", &given)) return NULL;
    if (PyLong_Check(given)) {
        unsigned long n = PyLong_AsUnsignedLong(given);
        if (PyErr_Occurred()) return NULL;
        if (n < 1 || n > 65536) return PyErr_Format(PyExc_ValueError, "between 1 and 65536 workers");
        fd = bench_control_make((uint32_t)n);
        if (fd < 0) return PyErr_SetFromErrno(PyExc_OSError);
        snprintf(path, sizeof path, "/proc/%ld/fd/%d", (long)getpid(), fd);
    } else {
        const char *text = PyUnicode_AsUTF8AndSize(given, NULL);
        if (!text) return NULL;
        snprintf(path, sizeof path, "%s", text);
    }
    bench_control *c = bench_control_map(path);
    Control *self = c ? (Control *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0) : NULL;
    if (!self) {
        if (!c) PyErr_SetFromErrnoWithFilename(PyExc_OSError, path);
        else bench_control_unmap(c);
        if (fd >= 0) close(fd);
        return NULL;
    }
    self->c = c;
    self->fd = fd;
    memcpy(self->path, path, sizeof path);
    return (PyObject *)self;
}

static void control_dealloc(PyObject *object) {
    Control *self = (Control *)object;
    PyTypeObject *type = Py_TYPE(object);
    bench_control_unmap(self->c);
    if (self->fd >= 0) close(self->fd);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(object);
    Py_DECREF(type);
}

/* The worker with this index, or NULL with an exception. */
static bench_worker *worker_at(PyObject *self, unsigned index) {
    bench_control *c = control_of(self);
    if (index < c->n_workers) return &c->worker[index];
    PyErr_Format(PyExc_IndexError, "no such worker");
    return NULL;
}

/* ---- the coordinator ---- */

static PyObject *control_path(PyObject *self, void *unused) {
    (void)unused;
    return PyUnicode_FromString(((Control *)self)->path);
}

static PyObject *start(PyObject *self, PyObject *args) {
    bench_phase p;
    long long start_ns, measure_ns, end_ns;
    unsigned long long seed;
    int coin, pinned;
    memset(&p, 0, sizeof p);
    if (!PyArg_ParseTuple(args, "IIIppdLLLK:start", &p.protocol, &p.n_active, &p.n_readers, &coin, &pinned, &p.read_ratio, &start_ns,
                          &measure_ns, &end_ns, &seed))
        return NULL;
    p.coin = (uint32_t)coin;
    p.pinned = (uint32_t)pinned;
    p.start_ns = start_ns;
    p.measure_ns = measure_ns;
    p.end_ns = end_ns;
    p.seed = seed;
    bench_control_start(control_of(self), &p);
    return PyLong_FromUnsignedLong(load32_acquire(&control_of(self)->phase_number));
}

static PyObject *stop(PyObject *self, PyObject *unused) {
    (void)unused;
    bench_control_stop(control_of(self));
    return Py_NewRef(Py_None);
}

static PyObject *state(PyObject *self, PyObject *args) {
    unsigned index;
    if (!PyArg_ParseTuple(args, "I:state", &index)) return NULL;
    bench_worker *w = worker_at(self, index);
    if (!w) return NULL;
    return Py_BuildValue("(IIs)", (unsigned)load32_acquire(&w->state), (unsigned)load32_acquire(&w->done), w->error);
}

static PyObject *summary(const bench_histogram *h) {
    if (!h->count) return Py_NewRef(Py_None);
    return Py_BuildValue("{s:K,s:d,s:d,s:d,s:d,s:K}", "count", (unsigned long long)h->count, "mean", (double)h->sum / (double)h->count,
                         "p50", bench_histogram_quantile(h, 0.5), "p99", bench_histogram_quantile(h, 0.99), "p99_9",
                         bench_histogram_quantile(h, 0.999), "max", (unsigned long long)h->max);
}

static void add_worker(bench_worker *sum, const bench_worker *w) {
    sum->reads += w->reads;
    sum->writes += w->writes;
    sum->read_retries += w->read_retries;
    sum->write_retries += w->write_retries;
    sum->failures += w->failures;
    sum->checked += w->checked;
    sum->mixed += w->mixed;
    sum->cpu_ns += w->cpu_ns;
    if (!sum->error[0]) memcpy(sum->error, w->error, sizeof sum->error);
    bench_histogram_add(&sum->read_ns, &w->read_ns);
    bench_histogram_add(&sum->write_ns, &w->write_ns);
    bench_histogram_add(&sum->age_oldest_ns, &w->age_oldest_ns);
    bench_histogram_add(&sum->age_mean_ns, &w->age_mean_ns);
    bench_histogram_add(&sum->span_ns, &w->span_ns);
    bench_histogram_add(&sum->deviation_ns, &w->deviation_ns);
}

static PyObject *result(PyObject *self, PyObject *args) {
    unsigned n;
    if (!PyArg_ParseTuple(args, "I:result", &n)) return NULL;
    if (!n || !worker_at(self, n - 1)) return NULL;
    bench_worker *sum = PyMem_Calloc(1, sizeof *sum);
    PyObject *each = PyList_New(0);
    for (unsigned i = 0; sum && each && i < n; i++) {
        const bench_worker *w = &control_of(self)->worker[i];
        PyObject *pair = Py_BuildValue("(KK)", (unsigned long long)w->reads, (unsigned long long)w->writes);
        add_worker(sum, w);
        if (!pair || PyList_Append(each, pair) < 0) Py_CLEAR(each);
        Py_XDECREF(pair);
    }
    PyObject *dict = !sum || !each ? NULL
        : Py_BuildValue("{s:K,s:K,s:K,s:K,s:K,s:K,s:K,s:K,s:s,s:O,s:N,s:N,s:N,s:N,s:N,s:N}", "reads", (unsigned long long)sum->reads, "writes",
                        (unsigned long long)sum->writes, "read_retries", (unsigned long long)sum->read_retries, "write_retries",
                        (unsigned long long)sum->write_retries, "failures",
                        (unsigned long long)sum->failures, "checked", (unsigned long long)sum->checked, "mixed",
                        (unsigned long long)sum->mixed, "cpu_ns", (unsigned long long)sum->cpu_ns, "error", sum->error, "workers", each,
                        "read_ns", summary(&sum->read_ns), "write_ns", summary(&sum->write_ns), "age_oldest_ns",
                        summary(&sum->age_oldest_ns), "age_mean_ns", summary(&sum->age_mean_ns), "span_ns", summary(&sum->span_ns), "deviation_ns",
                        summary(&sum->deviation_ns));
    if (!sum && !PyErr_Occurred()) PyErr_NoMemory();
    PyMem_Free(sum);
    Py_XDECREF(each);
    return dict;
}

/* ---- a worker in C ---- */

static bool parse_protocols(PyObject *pairs, bench_job *job) {
    Py_ssize_t n = PyList_Size(pairs);
    if (n < 1 || n > BENCH_MAX_PROTOCOLS) return PyErr_Format(PyExc_ValueError, "between 1 and %d protocols", BENCH_MAX_PROTOCOLS), false;
    for (Py_ssize_t i = 0; i < n; i++) {
        const char *name;
        PyObject *pair = PyList_GetItem(pairs, i);
        if (!PyTuple_Check(pair)) return PyErr_Format(PyExc_TypeError, "protocols: [(name, place)]"), false;
        if (!PyArg_ParseTuple(pair, "ss:protocols", &name, &job->places[i])) return false;
        if (!(job->protocols[i] = bench_protocol_find(name))) return PyErr_Format(PyExc_ValueError, "no such protocol: %s", name), false;
    }
    job->n_protocols = (uint32_t)n;
    return true;
}

static double number(PyObject *told, const char *key) {
    PyObject *value = PyDict_GetItemString(told, key);
    if (value) return PyFloat_AsDouble(value);
    PyErr_Format(PyExc_KeyError, "%s", key);
    return 0;
}

/* The numbers of _team.Job.  Places live as long as `told`. */
static bool parse_job(PyObject *told, bench_job *job) {
    PyObject *pairs = PyDict_GetItemString(told, "protocols");
    memset(job, 0, sizeof *job);
    if (!pairs || !PyList_Check(pairs)) return PyErr_Format(PyExc_TypeError, "protocols: [(name, place)]"), false;
    if (!parse_protocols(pairs, job)) return false;
    job->shape.n_frames = (uint32_t)number(told, "frames");
    job->shape.history = (uint32_t)number(told, "history");
    job->shape.read_len = (uint32_t)number(told, "read_len");
    job->shape.write_len = (uint32_t)number(told, "write_len");
    job->shape.by_name = number(told, "by_name") != 0;
    job->frequency = number(told, "frequency");
    job->opposite = number(told, "opposite") != 0;
    job->mixed_rate = number(told, "mixed_rate") != 0;
    job->check_every = (uint32_t)number(told, "check_every");
    return !PyErr_Occurred();
}

static PyObject *work(PyObject *self, PyObject *args) {
    bench_job job;
    PyObject *told;
    unsigned index;
    int parent;
    bool ok;
    if (!PyArg_ParseTuple(args, "IiO!:work", &index, &parent, &PyDict_Type, &told)) return NULL;
    if (!worker_at(self, index) || !parse_job(told, &job)) return NULL;
    bench_die_with(parent);
    Py_BEGIN_ALLOW_THREADS
    ok = bench_work(control_of(self), index, &job);
    Py_END_ALLOW_THREADS
    return PyBool_FromLong(ok);
}

static PyObject *host(PyObject *self, PyObject *args) {
    bench_job job;
    PyObject *told;
    int parent;
    bool ok;
    if (!PyArg_ParseTuple(args, "iO!:host", &parent, &PyDict_Type, &told) || !parse_job(told, &job)) return NULL;
    bench_die_with(parent);
    Py_BEGIN_ALLOW_THREADS
    ok = bench_host(control_of(self), &job);
    Py_END_ALLOW_THREADS
    return PyBool_FromLong(ok);
}

/* ---- a worker in Python ---- */

static PyObject *enter(PyObject *self, PyObject *args) {
    unsigned index, ready;
    int parent;
    const char *error;
    if (!PyArg_ParseTuple(args, "IiIs:enter", &index, &parent, &ready, &error)) return NULL;
    bench_worker *w = worker_at(self, index);
    if (!w) return NULL;
    bench_die_with(parent);
    snprintf(w->error, sizeof w->error, "%s", error);
    bench_worker_enter(w, ready);
    return Py_NewRef(Py_None);
}

static PyObject *next_phase(PyObject *self, PyObject *args) {
    unsigned last;
    int64_t number;
    bench_control *c = control_of(self);
    if (!PyArg_ParseTuple(args, "I:next_phase", &last)) return NULL;
    Py_BEGIN_ALLOW_THREADS
    number = bench_control_next(c, last);
    Py_END_ALLOW_THREADS
    if (number < 0) return Py_NewRef(Py_None);
    const bench_phase *p = &c->phase;
    return Py_BuildValue("{s:L,s:I,s:I,s:I,s:O,s:O,s:d,s:L,s:L,s:L,s:K}", "number", (long long)number, "protocol", p->protocol, "n_active", p->n_active, "n_readers",
                         p->n_readers, "coin", p->coin ? Py_True : Py_False, "pinned", p->pinned ? Py_True : Py_False, "read_ratio",
                         p->read_ratio, "start_ns", (long long)p->start_ns, "measure_ns", (long long)p->measure_ns, "end_ns",
                         (long long)p->end_ns, "seed", (unsigned long long)p->seed);
}

static PyObject *begin(PyObject *self, PyObject *args) {
    unsigned index;
    if (!PyArg_ParseTuple(args, "I:begin", &index) || !worker_at(self, index)) return NULL;
    bench_worker_begin(control_of(self), index);
    return Py_NewRef(Py_None);
}

static PyObject *operation(PyObject *self, PyObject *args) {
    unsigned index;
    int reads;
    long long ns;
    if (!PyArg_ParseTuple(args, "IpL:operation", &index, &reads, &ns)) return NULL;
    bench_worker *w = worker_at(self, index);
    if (!w) return NULL;
    reads ? w->reads++ : w->writes++;
    bench_histogram_record(reads ? &w->read_ns : &w->write_ns, ns);
    return PyBool_FromLong(load32_relaxed(&control_of(self)->stop) != 0);
}

static PyObject *check(PyObject *self, PyObject *args) {
    bench_shape s;
    PyObject *list;
    unsigned index, first;
    long long now_ns, start_ns;
    memset(&s, 0, sizeof s);
    if (!PyArg_ParseTuple(args, "IIIO!LL:check", &index, &s.write_len, &first, &PyList_Type, &list, &now_ns, &start_ns)) return NULL;
    bench_worker *w = worker_at(self, index);
    s.read_len = (uint32_t)PyList_Size(list);
    int64_t *stamps = w ? PyMem_Calloc(s.read_len + 1, sizeof *stamps) : NULL;
    if (!stamps) return w ? PyErr_NoMemory() : NULL;
    for (uint32_t i = 0; i < s.read_len; i++) stamps[i] = PyLong_AsLongLong(PyList_GetItem(list, i));
    if (!PyErr_Occurred()) bench_worker_check(w, &s, first, stamps, now_ns, start_ns);
    PyMem_Free(stamps);
    return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
}

static PyObject *fail(PyObject *self, PyObject *args) {
    unsigned index;
    const char *why;
    if (!PyArg_ParseTuple(args, "Is:fail", &index, &why)) return NULL;
    bench_worker *w = worker_at(self, index);
    if (!w) return NULL;
    bench_worker_fail(w, why);
    return Py_NewRef(Py_None);
}

static PyObject *end(PyObject *self, PyObject *args) {
    unsigned index;
    unsigned long long reads, writes, cpu_ns;
    if (!PyArg_ParseTuple(args, "IKKK:end", &index, &reads, &writes, &cpu_ns) || !worker_at(self, index)) return NULL;
    bench_worker_end(control_of(self), index, reads, writes, cpu_ns);
    return Py_NewRef(Py_None);
}

static PyObject *update_stamp(PyObject *type, PyObject *args) {
    bench_shape s;
    unsigned first;
    long long now_ns;
    (void)type;
    memset(&s, 0, sizeof s);
    if (!PyArg_ParseTuple(args, "IIL:update_stamp", &s.write_len, &first, &now_ns)) return NULL;
    if (!s.write_len) return PyErr_Format(PyExc_ValueError, "write_len: at least 1");
    return PyLong_FromLongLong(bench_update_stamp(&s, first, now_ns));
}

static PyMethodDef methods[] = {
    {"start", start, METH_VARARGS,
     PyDoc_STR("start(protocol, n_active, n_readers, coin, pinned, read_ratio, start_ns, measure_ns, end_ns, seed)\n--\n\n"
               "Begin a phase; returns its number.")},
    {"stop", stop, METH_NOARGS, PyDoc_STR("stop()\n--\n\nAll workers leave.")},
    {"state", state, METH_VARARGS, PyDoc_STR("state(index)\n--\n\n(0 starting, 1 ready, 2 failed; last phase done; error)")},
    {"result", result, METH_VARARGS, PyDoc_STR("result(n)\n--\n\nWhat workers 0 to n - 1 counted in the last phase, together (dict).")},
    {"work", work, METH_VARARGS,
     PyDoc_STR("work(index, parent, told)\n--\n\nBe a worker, in C, until told to stop.  told: _team.Job as a dict, and "
               "protocols: [(name, place)].  False: it could not attach.")},
    {"host", host, METH_VARARGS,
     PyDoc_STR("host(parent, told)\n--\n\nBe the process whose threads are all workers, of one protocol.  False: it could not.")},
    {"enter", enter, METH_VARARGS, PyDoc_STR("enter(index, parent, ready, error)\n--\n\nBe a worker in Python.")},
    {"next_phase", next_phase, METH_VARARGS,
     PyDoc_STR("next_phase(last)\n--\n\nWaits up to 0.1 s for a phase above `last` (dict; number 0: none yet); None: leave.")},
    {"begin", begin, METH_VARARGS, PyDoc_STR("begin(index)\n--\n\nForget what was counted.")},
    {"operation", operation, METH_VARARGS, PyDoc_STR("operation(index, reads, ns)\n--\n\nCount one.  True: leave.")},
    {"check", check, METH_VARARGS, PyDoc_STR("check(index, write_len, first, stamps, now_ns, start_ns)\n--\n\nLook at a lookup's stamps.")},
    {"fail", fail, METH_VARARGS, PyDoc_STR("fail(index, why)\n--\n\nCount a failure.")},
    {"end", end, METH_VARARGS, PyDoc_STR("end(index, read_retries, write_retries, cpu_ns)\n--\n\nThe phase is done.")},
    {"update_stamp", update_stamp, METH_VARARGS | METH_STATIC,
     PyDoc_STR("update_stamp(write_len, first, now_ns)\n--\n\nThe stamp of an update of the frames after `first`.")},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef properties[] = {
    {"path", control_path, NULL, PyDoc_STR("What other processes open, as long as the maker lives."), NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_doc, (void *)"Control(n_workers)\n--\n\nNew memory for that many workers; given a path instead, that of another process."},
    {Py_tp_new, control_new},
    {Py_tp_dealloc, control_dealloc},
    {Py_tp_methods, methods},
    {Py_tp_getset, properties},
    {0, NULL},
};

static PyType_Spec spec = {"shmtf._bench.Control", sizeof(Control), 0, Py_TPFLAGS_DEFAULT, slots};

PyObject *bench_control_type_new(PyObject *module) { return PyType_FromModuleAndSpec(module, &spec, NULL); }
