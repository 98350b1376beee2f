/* SPDX-License-Identifier: Apache-2.0
 *
 * C structs -> dicts, for the tools and the Python face.  None of this is fast or needs to be.
 */
#include "python/binding.h"

#include <stdio.h>
#include <string.h>

/* A name from the segment, whatever its bytes. */
static PyObject *text(const char *bytes) { return PyUnicode_DecodeUTF8(bytes, (Py_ssize_t)strlen(bytes), "backslashreplace"); }

static PyObject *text_or_none(const char *bytes) { return *bytes ? text(bytes) : Py_NewRef(Py_None); }

static PyObject *fail(PyObject *self, py_handle *h, const shmtf_error *error) {
    py_context context = {.store = self};
    return py_raise_error(h->module, error, &context);
}

static PyObject *authority(py_handle *h, uint16_t writer) {
    char name[SHMTF_HOLDER_SIZE];
    if (shmtf_authority_name(h->store, writer, name) != SHMTF_OK) name[0] = 0;
    return text(name);
}

PyObject *py_reader_frame_info(PyObject *self, PyObject *name) {
    py_handle *h = py_reader_open(self);
    shmtf_ref ref;
    shmtf_frame_info f;
    shmtf_error e;
    if (!h || !(ref.name = py_frame_name(h->module, name, "frame"))) return NULL;
    ref.frame = (shmtf_frame){0, 0};
    if (shmtf_get_frame_info(h->store, py_reader_snapshot(self), ref, &f, &e) != SHMTF_OK) return fail(self, h, &e);
    return Py_BuildValue("{s:N,s:N,s:N,s:N,s:I,s:I,s:L,s:L,s:L,s:K,s:N,s:K,s:K}", "name", text(f.name), "parent",
                         f.is_root ? Py_NewRef(Py_None) : text_or_none(f.parent_name), "is_static",
                         PyBool_FromLong(f.is_static), "is_root", PyBool_FromLong(f.is_root), "n_records", f.n_records,
                         "capacity", f.capacity, "oldest", (long long)f.oldest_ns, "newest", (long long)f.newest_ns,
                         "arrival", (long long)f.arrival_ns, "version", (unsigned long long)f.version, "authority",
                         authority(h, f.writer), "n_written", (unsigned long long)f.n_written, "generation",
                         (unsigned long long)f.generation);
}

static PyObject *record(py_handle *h, const shmtf_record *r) {
    const shmtf_pose *p = &r->pose;
    return Py_BuildValue("{s:L,s:L,s:K,s:N,s:(ddd),s:(dddd),s:N,s:I,s:N}", "stamp", (long long)r->stamp_ns, "arrival",
                         (long long)r->arrival_ns, "version", (unsigned long long)r->version, "parent",
                         r->parent.gen ? py_handle_name(h, r->parent) : Py_NewRef(Py_None), "translation", p->x, p->y, p->z,
                         "rotation", p->qx, p->qy, p->qz, p->qw, "authority", authority(h, r->writer), "epoch",
                         (unsigned)r->epoch, "is_static", PyBool_FromLong(r->is_static));
}

PyObject *py_reader_records(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"frame", "limit"};
    static const py_signature signature = {"_records", 1, 2, 2, names};
    PyObject *given[2];
    py_handle *h = py_reader_open(self);
    if (!h || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    shmtf_ref ref = {.frame = {0, 0}};
    size_t limit = given[1] ? PyLong_AsSize_t(given[1]) : 65536, n = 0;
    if ((limit == (size_t)-1 && PyErr_Occurred()) || !(ref.name = py_frame_name(h->module, given[0], "frame"))) return NULL;
    if (limit > 1u << 24) limit = 1u << 24;
    shmtf_record *records = PyMem_Calloc(limit ? limit : 1, sizeof *records);
    shmtf_error e;
    if (!records) return PyErr_NoMemory();
    PyObject *list = NULL;
    if (shmtf_records(h->store, py_reader_snapshot(self), ref, records, limit, &n, &e) != SHMTF_OK)
        fail(self, h, &e);
    else
        list = PyList_New((Py_ssize_t)n);
    for (size_t i = 0; list && i < n; i++) {
        PyObject *item = record(h, &records[i]);
        if (!item || PyList_SetItem(list, (Py_ssize_t)i, item) < 0) Py_CLEAR(list);
    }
    PyMem_Free(records);
    return list;
}

PyObject *py_reader_info(PyObject *self, PyObject *unused) {
    (void)unused;
    py_handle *h = py_reader_open(self);
    shmtf_info i;
    shmtf_error e;
    if (!h) return NULL;
    if (shmtf_get_info(h->store, &i, &e) != SHMTF_OK) return fail(self, h, &e);
    char uuid[33];
    snprintf(uuid, sizeof uuid, "%016llx%016llx", (unsigned long long)i.uuid[0], (unsigned long long)i.uuid[1]);
    return Py_BuildValue("{s:I,s:I,s:N,s:K,s:I,s:K,s:K,s:K,s:N,s:L,s:K,s:I,s:K,s:K,s:K,s:N}", "max_frames",
                         i.config.max_frames, "history", i.config.history, "cache_time_ns",
                         i.config.cache_time_ns < 0 ? Py_NewRef(Py_None) : PyLong_FromLongLong(i.config.cache_time_ns),
                         "stream_bytes", (unsigned long long)i.config.stream_bytes, "max_writers", i.config.max_writers,
                         "format", (unsigned long long)i.format, "size_bytes", (unsigned long long)i.size_bytes,
                         "fingerprint", (unsigned long long)i.fingerprint, "uuid",
                         text(uuid),
                         "created", (long long)i.created_ns, "version", (unsigned long long)i.version, "n_frames_bound",
                         i.n_frames_bound, "chunk_bytes", (unsigned long long)i.chunk_bytes, "n_chunks",
                         (unsigned long long)i.n_chunks, "n_chunks_free", (unsigned long long)i.n_chunks_free, "readonly",
                         PyBool_FromLong(i.readonly));
}

PyObject *py_reader_counters(PyObject *self, PyObject *unused) {
    (void)unused;
    py_handle *h = py_reader_open(self);
    shmtf_counters c;
    if (!h) return NULL;
    shmtf_get_counters(h->store, &c);
    return Py_BuildValue("{s:K,s:K,s:K,s:K,s:K,s:K,s:K,s:K,s:K}", "commits", (unsigned long long)c.commits, "aborts",
                         (unsigned long long)c.aborts, "helps", (unsigned long long)c.helps, "recoveries",
                         (unsigned long long)c.recoveries, "rereads", (unsigned long long)c.rereads, "restarts",
                         (unsigned long long)c.restarts, "waits", (unsigned long long)c.waits, "late_dropped",
                         (unsigned long long)c.late_dropped, "repeats", (unsigned long long)c.repeats);
}

static PyObject *writer(const shmtf_writer_info *w) {
    static const char *const states[] = {"active", "prepared", "committed"};
    return Py_BuildValue("{s:i,s:N,s:L,s:L,s:N,s:K,s:s,s:K}", "slot", w->slot, "alive", PyBool_FromLong(w->alive), "pid",
                         (long long)w->pid, "started", (long long)w->start_ns, "name", text(w->name), "transaction",
                         (unsigned long long)w->transaction, "state", w->state >= 0 && w->state < 3 ? states[w->state] : "?",
                         "version", (unsigned long long)w->version);
}

PyObject *py_reader_writers(PyObject *self, PyObject *unused) {
    (void)unused;
    py_handle *h = py_reader_open(self);
    shmtf_error e;
    size_t n = 0, max = 1024; /* there are at most 1023 slots */
    if (!h) return NULL;
    shmtf_writer_info *writers = PyMem_Calloc(max, sizeof *writers);
    if (!writers) return PyErr_NoMemory();
    PyObject *list = NULL;
    if (shmtf_writers(h->store, writers, max, &n, &e) != SHMTF_OK)
        fail(self, h, &e);
    else
        list = PyList_New((Py_ssize_t)(n < max ? n : max));
    for (size_t i = 0; list && i < n && i < max; i++) {
        PyObject *item = writer(&writers[i]);
        if (!item || PyList_SetItem(list, (Py_ssize_t)i, item) < 0) Py_CLEAR(list);
    }
    PyMem_Free(writers);
    return list;
}

PyObject *py_reader_frame_words(PyObject *self, PyObject *name) {
    py_handle *h = py_reader_open(self);
    shmtf_ref ref;
    shmtf_frame_words w;
    shmtf_error e;
    if (!h || !(ref.name = py_frame_name(h->module, name, "frame"))) return NULL;
    ref.frame = (shmtf_frame){0, 0};
    if (shmtf_get_frame_words(h->store, ref, &w, &e) != SHMTF_OK) return fail(self, h, &e);
    return Py_BuildValue("{s:K,s:K,s:K,s:K,s:K,s:N,s:i,s:N,s:K}", "lock", (unsigned long long)w.lock, "head",
                         (unsigned long long)w.head, "pending", (unsigned long long)w.pending, "newest_tag",
                         (unsigned long long)w.newest_tag, "commit", (unsigned long long)w.commit, "locked",
                         PyBool_FromLong(w.locked), "owner_slot", w.owner_slot, "owner_alive",
                         PyBool_FromLong(w.owner_alive), "owner_transaction", (unsigned long long)w.owner_transaction);
}

PyObject *py_store_check(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"repair"};
    static const py_signature signature = {"_check", 0, 1, 1, names};
    PyObject *given[1];
    py_handle *h = py_reader_open(self);
    if (!h || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    int repair = given[0] ? PyObject_IsTrue(given[0]) : 0;
    if (repair < 0 || !py_reader_open(self)) return NULL; /* the argument's own code may have closed the store */
    shmtf_check_report r = {0};
    shmtf_error e;
    shmtf_status status = shmtf_check(h->store, repair, &r, &e);
    if (status != SHMTF_OK && status != SHMTF_CORRUPT) return fail(self, h, &e);
    return Py_BuildValue("{s:N,s:K,s:K,s:K,s:K,s:K,s:K,s:N}", "corrupt", PyBool_FromLong(status == SHMTF_CORRUPT), "frames",
                         (unsigned long long)r.frames, "locks_held", (unsigned long long)r.locks_held, "locks_dead",
                         (unsigned long long)r.locks_dead, "locks_repaired", (unsigned long long)r.locks_repaired, "records",
                         (unsigned long long)r.records, "bad_words", (unsigned long long)r.bad_words, "first_problem",
                         text(r.first_problem));
}
