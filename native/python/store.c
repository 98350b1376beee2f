/* SPDX-License-Identifier: Apache-2.0
 *
 * Types Store (Reader, the writes of write.c, and the wait) and Snapshot (Reader at one commit).
 */
#include "python/binding.h"

/* ---- life ---- */

/* The topmost base with our constructor is the module's own type, and only that one knows the module. */
static module_state *state_of(PyTypeObject *type, newfunc constructor) {
    PyTypeObject *own = NULL;
    for (; type; type = PyType_GetSlot(type, Py_tp_base))
        if (PyType_GetSlot(type, Py_tp_new) == (void *)constructor) own = type;
    return own ? PyType_GetModuleState(own) : NULL;
}

static py_reader *reader_new(PyTypeObject *type, py_handle *h) {
    py_reader *r = (py_reader *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0);
    if (r)
        r->handle = h;
    else
        py_handle_unref(h);
    return r;
}

static PyObject *store_new(PyTypeObject *type, PyObject *args, PyObject *kwargs) {
    static const char *const names[] = {"fd", "readonly", "writer", NULL};
    int fd, readonly = 0;
    PyObject *writer = NULL;
    const char *writer_text;
    shmtf_store *store = NULL;
    shmtf_error error;
    shmtf_status status;
    module_state *m = state_of(type, store_new);
    if (!m || !PyArg_ParseTupleAndKeywords(args, kwargs, "i|pO:Store", (char **)names, &fd, &readonly, &writer)) return NULL;
    if (!py_text(m, writer, "authority", &writer_text)) return NULL;
    Py_BEGIN_ALLOW_THREADS
    status = shmtf_guard_truncation(&error);
    if (status == SHMTF_OK) status = shmtf_attach_fd(fd, readonly ? SHMTF_READONLY : 0, writer_text, &store, &error);
    Py_END_ALLOW_THREADS
    if (status != SHMTF_OK) return py_raise_error(m, &error, NULL);
    py_handle *h = py_handle_new(m, store);
    return h ? (PyObject *)reader_new(type, h) : NULL;
}

static PyObject *snapshot_new(PyTypeObject *type, PyObject *args, PyObject *kwargs) {
    static const char *const names[] = {"store", NULL};
    PyObject *store;
    module_state *m = state_of(type, snapshot_new);
    if (!m || !PyArg_ParseTupleAndKeywords(args, kwargs, "O!:Snapshot", (char **)names, m->store_type, &store)) return NULL;
    py_handle *h = py_reader_open(store);
    py_reader *r = h ? reader_new(type, py_handle_ref(h)) : NULL;
    if (!r) return NULL;
    r->snapshot = shmtf_take_snapshot(h->store);
    r->has_snapshot = true;
    return (PyObject *)r;
}

static PyObject *store_close(PyObject *self, PyObject *unused) {
    (void)unused;
    py_handle_close(((py_reader *)self)->handle);
    return Py_NewRef(Py_None);
}

static PyObject *snapshot_close(PyObject *self, PyObject *unused) {
    (void)unused;
    ((py_reader *)self)->is_closed = true;
    return Py_NewRef(Py_None);
}

/* ---- waiting ---- */

typedef struct change_call {
    py_handle *handle;
    shmtf_ref *frames;
    size_t n;
    uint64_t since, version;
    shmtf_error error;
} change_call;

static shmtf_status wait_once(void *argument, int64_t timeout_ns) {
    change_call *c = argument;
    return shmtf_wait_for_change(c->handle->store, c->frames, c->n, c->since, timeout_ns, &c->version, &c->error);
}

static PyObject *wait_for(PyObject *self, change_call *c, int64_t timeout_ns) {
    module_state *m = c->handle->module;
    py_wait wait = {.call = wait_once, .argument = c, .again = PY_STATUS_BIT(SHMTF_TIMEOUT)};
    shmtf_status status = wait_once(c, 0);
    if (status == SHMTF_TIMEOUT && timeout_ns != 0 && !py_handle_wait(c->handle, &wait, timeout_ns, &status)) return NULL;
    if (status == SHMTF_OK) return PyLong_FromUnsignedLongLong(c->version);
    if (status == SHMTF_TIMEOUT) /* its version is the next `since` */
        return py_raise(m, "TIMEOUT", Py_BuildValue("{s:K,s:d}", "version", (unsigned long long)c->version, "waited", wait.waited_s));
    py_context context = {.store = self};
    return py_raise_error(m, &c->error, &context);
}

static PyObject *wait_for_change(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"frames", "since", "timeout"};
    static const py_signature signature = {"wait_for_change", 3, 3, 3, names};
    PyObject *given[3], *version = NULL;
    change_call c;
    int64_t timeout_ns = -1;
    py_handle *h = c.handle = py_reader_open(self);
    if (!h || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    if (!PyTuple_Check(given[0])) return PyErr_Format(PyExc_TypeError, "frames must be a tuple");
    if (!py_timeout(h->module, given[2], &timeout_ns) || !py_reader_open(self)) return NULL;
    c.since = given[1] == Py_None ? shmtf_commit_version(h->store) : PyLong_AsUnsignedLongLong(given[1]);
    if (c.since == (uint64_t)-1 && PyErr_Occurred()) return NULL;
    c.n = (size_t)PyTuple_Size(given[0]);
    c.frames = PyMem_Calloc(c.n ? c.n : 1, sizeof *c.frames);
    bool ok = c.frames || PyErr_NoMemory();
    for (size_t i = 0; ok && i < c.n; i++) { /* by name: a frame may be removed and made anew while this waits */
        c.frames[i] = shmtf_by_name(py_frame_name(h->module, PyTuple_GetItem(given[0], (Py_ssize_t)i), "frames"));
        ok = c.frames[i].name != NULL;
    }
    if (ok) version = wait_for(self, &c, timeout_ns);
    PyMem_Free(c.frames);
    return version;
}

/* ---- types ---- */

PyDoc_STRVAR(set_transform_doc,
             "set_transform($self, transform, *, static=False, authority=None, timeout=1.0, priority=False)\n--\n\n"
             "Write one shmtf.Transform; a stamp of None becomes now.  Returns the commit's version (int).\n\n"
             "static: valid at every time, replaces what the frame held.  authority: who says so, for people.\n"
             "timeout: seconds to contend for a frame that another writer holds, None for ever.  priority: contending\n"
             "writers give way.\n\n"
             "Raises InvalidArgumentException, CycleError, OldDataError, StoreFullError, BusyError,\n"
             "ReadOnlyStoreError; then nothing was written.");

PyDoc_STRVAR(set_transforms_doc,
             "set_transforms($self, transforms, *, static=False, authority=None, timeout=1.0, priority=False)\n--\n\n"
             "Write an iterable of shmtf.Transform: all or none, visible at one instant.  Stamps of None become one\n"
             "common now.  Returns the commit's version (int).  Arguments and errors as for set_transform; the error's\n"
             "`item` is the index of the transform concerned.");

PyDoc_STRVAR(remove_doc, "remove_frame($self, name, *, authority=None, timeout=1.0, priority=False)\n--\n\n"
                         "End a frame; its name may be used anew.  Children stay, without a parent.\n"
                         "Raises LookupException, BusyError, ReadOnlyStoreError.");

PyDoc_STRVAR(clear_doc, "clear($self, keep_static=True, *, authority=None, timeout=1.0, priority=False)\n--\n\n"
                        "End all records, for every process at one instant; static ones too unless kept.  Names stay.\n"
                        "Raises BusyError, ReadOnlyStoreError.");

static PyMethodDef store_methods[] = {
    PY_METHOD("set_transform", py_store_set_transform, set_transform_doc),
    PY_METHOD("set_transforms", py_store_set_transforms, set_transforms_doc),
    PY_METHOD("remove_frame", py_store_remove_frame, remove_doc),
    PY_METHOD("clear", py_store_clear, clear_doc),
    PY_METHOD("_declare_frame", py_store_declare_frame,
              PyDoc_STR("_declare_frame($self, name, history, *, authority=None, timeout=1.0, priority=False)\n--\n\nhistory: records to keep at least.")),
    PY_METHOD("_wait_for_change", wait_for_change,
              PyDoc_STR("_wait_for_change($self, frames, since, timeout)\n--\n\nframes: tuple of str; since: int or None.")),
    {"counters", py_reader_counters, METH_NOARGS,
     PyDoc_STR("counters($self)\n--\n\nWhat this store object did so far (dict of int): commits, aborts, helps, recoveries, rereads,\n"
               "restarts, waits, late_dropped (accepted, but older than all that a full ring keeps), repeats (identical\n"
               "records, written once).")},
    {"_writers", py_reader_writers, METH_NOARGS, PyDoc_STR("_writers($self)\n--\n\nWriter slots in use (list of dict).")},
    {"_frame_words", py_reader_frame_words, METH_O, PyDoc_STR("_frame_words($self, frame, /)\n--\n\nThe frame's raw words (dict).")},
    PY_METHOD("_check", py_store_check, PyDoc_STR("_check($self, repair=False)\n--\n\nLook at every word (dict).")),
    {"close", store_close, METH_NOARGS,
     PyDoc_STR("close($self)\n--\n\nUnmap the segment; every later use raises ClosedError, also in threads that wait.")},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot store_slots[] = {
    {Py_tp_doc, (void *)"Store(fd, readonly=False, writer=None)\n--\n\nAn attached segment."},
    {Py_tp_new, store_new},
    {Py_tp_dealloc, py_reader_dealloc},
    {Py_tp_methods, store_methods},
    {0, NULL},
};

static PyMethodDef snapshot_methods[] = {
    {"close", snapshot_close, METH_NOARGS, PyDoc_STR("close($self)\n--\n\nEnd its use; it held nothing.")},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot snapshot_slots[] = {
    {Py_tp_doc, (void *)"Snapshot(store)\n--\n\nThe store at its last commit."},
    {Py_tp_new, snapshot_new},
    {Py_tp_dealloc, py_reader_dealloc},
    {Py_tp_methods, snapshot_methods},
    {0, NULL},
};

#define FLAGS (Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_IMMUTABLETYPE)

static PyType_Spec store_spec = {
    .name = "shmtf._core.Store", .basicsize = sizeof(py_reader), .flags = FLAGS, .slots = store_slots};
static PyType_Spec snapshot_spec = {
    .name = "shmtf._core.Snapshot", .basicsize = sizeof(py_reader), .flags = FLAGS, .slots = snapshot_slots};

PyTypeObject *py_store_type_new(PyObject *module, PyTypeObject *reader_type) {
    return (PyTypeObject *)PyType_FromModuleAndSpec(module, &store_spec, (PyObject *)reader_type);
}

PyTypeObject *py_snapshot_type_new(PyObject *module, PyTypeObject *reader_type) {
    return (PyTypeObject *)PyType_FromModuleAndSpec(module, &snapshot_spec, (PyObject *)reader_type);
}
