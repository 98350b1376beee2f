/* SPDX-License-Identifier: Apache-2.0
 *
 * The writes of a Store.
 *
 * A write is tried once without waiting and with the GIL held; only a busy frame, or a batch that takes long anyway,
 * is worth giving the GIL up.  Everything is parsed before, so that no Python runs between the core's locks.
 */
#include "python/binding.h"

#include <string.h>
#include <time.h>

#define LARGE_BATCH 256 /* transforms; above, the GIL is released around the whole call */

/* ---- any write ---- */

typedef struct write_call {
    enum { SET, DECLARE, REMOVE, CLEAR } kind;
    py_handle *handle;
    shmtf_transform *items;
    size_t n;
    const char *name;
    uint32_t history;
    int keep_static;
    shmtf_write_options options;
    uint64_t version;
    shmtf_error error;
} write_call;

static shmtf_status perform(void *argument, int64_t timeout_ns) {
    write_call *w = argument;
    shmtf_store *store = w->handle->store;
    w->options.timeout_ns = timeout_ns;
    switch (w->kind) {
    case SET:
        return shmtf_set_transforms(store, w->items, w->n, &w->options, &w->version, &w->error);
    case DECLARE:
        return shmtf_declare_frame(store, w->name, w->history, &w->options, &w->error);
    case REMOVE:
        return shmtf_remove_frame(store, shmtf_by_name(w->name), &w->options, &w->error);
    default:
        return shmtf_clear(store, w->keep_static, &w->options, &w->error);
    }
}

/* True: done.  False: an exception is set and nothing was written. */
static bool commit(PyObject *self, write_call *w, int64_t timeout_ns) {
    py_wait wait = {.call = perform, .argument = w, .again = PY_STATUS_BIT(SHMTF_BUSY) | PY_STATUS_BIT(SHMTF_CONFLICT)};
    bool large = w->n > LARGE_BATCH;
    shmtf_status status = large ? SHMTF_BUSY : perform(w, 0);
    bool again = PY_STATUS_BIT(status) & wait.again;
    if ((large || (again && timeout_ns != 0)) && !py_handle_wait(w->handle, &wait, timeout_ns, &status)) return false;
    if (status == SHMTF_OK) return true;
    py_context context = {.store = self, .is_batch = w->n > 1, .waited_s = wait.waited_s};
    py_raise_error(w->handle->module, &w->error, &context);
    return false;
}

/* The keyword-only arguments that every write has, from given[0..3]; absent ones are NULL.  The last of the arguments to be
 * read: after it no code of theirs can close the store. */
static bool write_options(PyObject *self, write_call *w, PyObject *const *given, int64_t *timeout_ns) {
    py_handle *h = ((py_reader *)self)->handle;
    int priority = given[2] ? PyObject_IsTrue(given[2]) : 0;
    w->handle = h;
    w->options = (shmtf_write_options){.priority = priority};
    *timeout_ns = 1000000000;
    return priority >= 0 && py_text(h->module, given[0], "authority", &w->options.authority) &&
           py_timeout(h->module, given[1], timeout_ns) && py_reader_open(self);
}

/* ---- transforms ---- */

static bool item_from(py_handle *h, PyObject *object, Py_ssize_t index, bool is_static, int64_t *now, shmtf_transform *item) {
    if (!py_is_transform(h->module, object)) {
        if (index < 0)
            PyErr_Format(PyExc_TypeError, "not a shmtf.Transform: %R", object);
        else
            PyErr_Format(PyExc_TypeError, "item %zd is not a shmtf.Transform: %R", index, object);
        return false;
    }
    py_transform *t = (py_transform *)object;
    if (!py_handle_frame(h, t->parent, "parent", &item->parent) || !py_handle_frame(h, t->child, "child", &item->child))
        return false;
    if (!t->has_stamp && *now == 0) { /* one time for the whole batch */
        struct timespec time;
        clock_gettime(CLOCK_REALTIME, &time);
        *now = (int64_t)time.tv_sec * 1000000000 + time.tv_nsec;
    }
    item->stamp_ns = t->has_stamp ? t->stamp_ns : *now;
    item->pose = t->pose;
    item->flags = is_static ? SHMTF_STATIC : 0;
    return true;
}

/* Writes items made from `objects`, and remembers what their names resolved to. */
static PyObject *set_items(PyObject *self, write_call *w, PyObject *const *objects, int64_t timeout_ns) {
    py_handle *h = w->handle;
    w->kind = SET;
    if (!commit(self, w, timeout_ns)) return NULL;
    for (size_t i = 0; i < w->n; i++) {
        py_transform *t = (py_transform *)objects[i];
        py_handle_learn(h, t->parent, &w->items[i].parent);
        py_handle_learn(h, t->child, &w->items[i].child);
    }
    return PyLong_FromUnsignedLongLong(w->version);
}

PyObject *py_store_set_transform(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"transform", "static", "authority", "timeout", "priority"};
    static const py_signature signature = {"set_transform", 1, 1, 5, names};
    PyObject *given[5];
    py_handle *h = py_reader_open(self);
    shmtf_transform item;
    write_call w;
    int64_t timeout_ns, now = 0;
    if (!h || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    int is_static = given[1] ? PyObject_IsTrue(given[1]) : 0;
    if (is_static < 0 || !write_options(self, &w, given + 2, &timeout_ns)) return NULL;
    if (!item_from(h, given[0], -1, is_static, &now, &item)) return NULL;
    w.items = &item;
    w.n = 1;
    return set_items(self, &w, given, timeout_ns);
}

PyObject *py_store_set_transforms(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"transforms", "static", "authority", "timeout", "priority"};
    static const py_signature signature = {"set_transforms", 1, 1, 5, names};
    PyObject *given[5], *version = NULL;
    write_call w;
    int64_t timeout_ns, now = 0;
    if (!py_reader_open(self) || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    PyObject *batch = PySequence_Tuple(given[0]); /* keeps the items, whatever happens to the list meanwhile */
    py_handle *h = batch ? py_reader_open(self) : NULL; /* a generator may have closed the store */
    int is_static = h && given[1] ? PyObject_IsTrue(given[1]) : 0; /* no code of theirs runs beside an exception */
    if (!h || is_static < 0 || !write_options(self, &w, given + 2, &timeout_ns)) {
        Py_XDECREF(batch);
        return NULL;
    }
    w.n = (size_t)PyTuple_Size(batch);
    w.items = PyMem_Calloc(w.n ? w.n : 1, sizeof *w.items);
    PyObject **objects = PyMem_Calloc(w.n ? w.n : 1, sizeof *objects);
    bool ok = w.items && objects;
    if (!ok) PyErr_NoMemory();
    for (size_t i = 0; ok && i < w.n; i++) {
        objects[i] = PyTuple_GetItem(batch, (Py_ssize_t)i);
        ok = item_from(h, objects[i], (Py_ssize_t)i, is_static, &now, &w.items[i]);
    }
    if (ok) version = set_items(self, &w, objects, timeout_ns);
    PyMem_Free(objects);
    PyMem_Free(w.items);
    Py_DECREF(batch);
    return version;
}

/* ---- other writes ---- */

PyObject *py_store_remove_frame(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"name", "authority", "timeout", "priority"};
    static const py_signature signature = {"remove_frame", 1, 1, 4, names};
    PyObject *given[4];
    write_call w = {.kind = REMOVE};
    int64_t timeout_ns;
    py_handle *h = py_reader_open(self);
    if (!h || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    if (!(w.name = py_frame_name(h->module, given[0], "name")) || !write_options(self, &w, given + 1, &timeout_ns)) return NULL;
    return commit(self, &w, timeout_ns) ? Py_NewRef(Py_None) : NULL;
}

PyObject *py_store_clear(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"keep_static", "authority", "timeout", "priority"};
    static const py_signature signature = {"clear", 0, 1, 4, names};
    PyObject *given[4];
    write_call w = {.kind = CLEAR};
    int64_t timeout_ns;
    py_handle *h = py_reader_open(self);
    if (!h || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    w.keep_static = given[0] ? PyObject_IsTrue(given[0]) : 1;
    if (w.keep_static < 0 || !write_options(self, &w, given + 1, &timeout_ns)) return NULL;
    return commit(self, &w, timeout_ns) ? Py_NewRef(Py_None) : NULL;
}

PyObject *py_store_declare_frame(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"name", "history", "authority", "timeout", "priority"};
    static const py_signature signature = {"declare_frame", 2, 2, 5, names};
    PyObject *given[5];
    write_call w = {.kind = DECLARE};
    int64_t timeout_ns;
    py_handle *h = py_reader_open(self);
    if (!h || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    unsigned long history = PyLong_AsUnsignedLong(given[1]);
    if (history == (unsigned long)-1 && PyErr_Occurred()) return NULL;
    if (history > UINT32_MAX) return py_raise_invalid(h->module, "history", given[1], "less than 2**32 records");
    w.history = (uint32_t)history;
    if (!(w.name = py_frame_name(h->module, given[0], "child")) || !write_options(self, &w, given + 2, &timeout_ns)) return NULL;
    return commit(self, &w, timeout_ns) ? Py_NewRef(Py_None) : NULL;
}
