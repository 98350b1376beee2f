/* SPDX-License-Identifier: Apache-2.0
 *
 * A store in use by several Python objects and threads.
 *
 * Closing.  shmtf_close must not meet another call on the same store.  A call that keeps the GIL cannot meet it,
 * since close() runs under the GIL too.  A call that gives the GIL up counts itself in `n_inside`; close() then only
 * forbids further calls, and the last one out unmaps.
 *
 * Names.  Programs ask for the same few names, mostly literals, so the handle keeps what a string object resolved
 * to, found by its address.  A frame that was removed makes the entry stale, never wrong: the core answers LOOKUP
 * and the caller asks again by name.
 */
#include "python/binding.h"

#include <string.h>
#include <time.h>

/* Longest sleep in the core.  Between two sleeps the thread sees close(), and signals that came between the check
 * and the sleep. */
#define SLICE_NS 500000000

py_handle *py_handle_new(module_state *m, shmtf_store *store) {
    py_handle *h = PyMem_Calloc(1, sizeof *h);
    shmtf_info info;
    if (h && shmtf_get_info(store, &info, NULL) == SHMTF_OK) {
        h->n_known = 256;
        while (h->n_known < 8192 && h->n_known < 4 * (size_t)info.config.max_frames) h->n_known *= 2;
        h->known = PyMem_Calloc(h->n_known, sizeof *h->known);
        h->readonly = info.readonly != 0;
    }
    if (!h || !h->known) {
        PyMem_Free(h);
        shmtf_close(store);
        PyErr_NoMemory();
        return NULL;
    }
    h->store = store;
    h->module = m;
    h->n_refs = 1;
    return h;
}

py_handle *py_handle_ref(py_handle *h) {
    h->n_refs++;
    return h;
}

static void forget_known(py_handle *h) {
    for (size_t i = 0; h->known && i < h->n_known; i++) Py_CLEAR(h->known[i].object);
    PyMem_Free(h->known);
    h->known = NULL;
}

void py_handle_unref(py_handle *h) {
    if (--h->n_refs > 0) return;
    if (h->store) shmtf_close(h->store);
    forget_known(h);
    for (size_t i = 0; i < h->n_names; i++) Py_XDECREF(h->names[i].name);
    PyMem_Free(h->names);
    PyMem_Free(h);
}

/* Transforms that were looked up name their edges when asked, which may be after the store was closed. */
static void learn_all_names(py_handle *h) {
    PyObject *type, *value, *traceback; /* the last call out may be on its way to raise */
    size_t n = 0;
    if (shmtf_frames(h->store, NULL, NULL, 0, &n, NULL) != SHMTF_OK || n == 0) return;
    PyErr_Fetch(&type, &value, &traceback);
    shmtf_frame *frames = PyMem_Calloc(n, sizeof *frames);
    size_t found = 0;
    if (frames && shmtf_frames(h->store, NULL, frames, n, &found, NULL) == SHMTF_OK)
        for (size_t i = 0; i < n && i < found; i++) Py_XDECREF(py_handle_name(h, frames[i]));
    PyMem_Free(frames);
    PyErr_Restore(type, value, traceback); /* without one of ours: out of memory, those names are not known then */
}

static void unmap(py_handle *h) {
    if (h->n_refs > 1) learn_all_names(h);
    shmtf_close(h->store);
    h->store = NULL;
    forget_known(h);
}

void py_handle_close(py_handle *h) {
    if (h->closing) return;
    h->closing = true;
    if (h->n_inside == 0) unmap(h);
}

/* ---- names ---- */

static py_known_name *known_entry(py_handle *h, PyObject *object) {
    uintptr_t address = (uintptr_t)object;
    return &h->known[(address >> 4 ^ address >> 15) & (h->n_known - 1)];
}

bool py_handle_frame(py_handle *h, PyObject *object, const char *what, shmtf_ref *ref) {
    py_known_name *entry = known_entry(h, object);
    if (entry->object == object) {
        ref->name = entry->text;
        ref->frame = entry->frame;
        return true;
    }
    ref->name = py_frame_name(h->module, object, what);
    ref->frame = (shmtf_frame){0, 0};
    if (!ref->name) return false;
    if (shmtf_resolve(h->store, NULL, ref->name, &ref->frame, NULL) == SHMTF_OK)
        py_handle_learn(h, object, ref);
    else
        ref->frame = (shmtf_frame){0, 0};
    return true;
}

void py_handle_learn(py_handle *h, PyObject *object, const shmtf_ref *ref) {
    if (ref->frame.gen == 0 || !h->known || !PyUnicode_CheckExact(object)) return; /* a subclass' end may run anything */
    py_known_name *entry = known_entry(h, object);
    PyObject *old = entry->object;
    *entry = (py_known_name){Py_NewRef(object), ref->name, ref->frame};
    Py_XDECREF(old);
}

static bool reserve_names(py_handle *h, size_t n) {
    if (n <= h->n_names) return true;
    size_t size = h->n_names ? h->n_names : 64;
    while (size < n) size *= 2;
    void *names = PyMem_Realloc(h->names, size * sizeof *h->names);
    if (!names) return PyErr_NoMemory() != NULL;
    h->names = names;
    memset(h->names + h->n_names, 0, (size - h->n_names) * sizeof *h->names);
    h->n_names = size;
    return true;
}

PyObject *py_handle_name(py_handle *h, shmtf_frame frame) {
    if (frame.id < h->n_names && h->names[frame.id].name && h->names[frame.id].gen == frame.gen)
        return Py_NewRef(h->names[frame.id].name);
    char text[SHMTF_NAME_SIZE];
    if (!h->store || shmtf_frame_name(h->store, frame, text, NULL) != SHMTF_OK) return Py_NewRef(Py_None);
    if (!reserve_names(h, (size_t)frame.id + 1)) return NULL;
    PyObject *name = PyUnicode_DecodeUTF8(text, (Py_ssize_t)strlen(text), "backslashreplace");
    if (!name) return NULL;
    PyObject *old = h->names[frame.id].name;
    h->names[frame.id].name = Py_NewRef(name);
    h->names[frame.id].gen = frame.gen;
    Py_XDECREF(old);
    return name;
}

/* ---- waiting ---- */

static int64_t monotonic_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static shmtf_status call_inside(py_handle *h, py_wait *wait, int64_t timeout_ns) {
    shmtf_status status;
    h->n_inside++;
    Py_BEGIN_ALLOW_THREADS
    status = wait->call(wait->argument, timeout_ns);
    Py_END_ALLOW_THREADS
    h->n_inside--;
    return status;
}

bool py_handle_wait(py_handle *h, py_wait *wait, int64_t timeout_ns, shmtf_status *status) {
    int64_t start = monotonic_ns(), left = timeout_ns;
    bool ok = true;
    wait->timed_out = false;
    py_handle_ref(h); /* the object may die while its thread sleeps */
    for (;;) {
        *status = call_inside(h, wait, left < 0 || left > SLICE_NS ? SLICE_NS : left);
        bool again = PY_STATUS_BIT(*status) & (wait->again | PY_STATUS_BIT(SHMTF_INTERRUPTED));
        int64_t waited = monotonic_ns() - start;
        wait->waited_s = (double)waited * 1e-9;
        if (h->closing && again) {
            py_raise_closed(h->module);
            ok = false;
        } else if (again && PyErr_CheckSignals() < 0) { /* never after a commit */
            ok = false;
        }
        if (!ok || !again) break;
        if (timeout_ns >= 0 && waited >= timeout_ns && *status != SHMTF_INTERRUPTED) {
            wait->timed_out = true;
            break;
        }
        left = timeout_ns < 0 ? -1 : timeout_ns > waited ? timeout_ns - waited : 0;
    }
    if (h->closing && h->n_inside == 0 && h->store) unmap(h);
    py_handle_unref(h);
    return ok;
}
