/* SPDX-License-Identifier: Apache-2.0
 *
 * Type Reader: the reads, at the moment of the call (a Store) or at one commit (a Snapshot).
 *
 * A lookup first asks the core without waiting and with the GIL held, since that takes less time than giving the GIL
 * up and taking it back.  Only an answer that time may change, asked with a timeout, is waited for without the GIL.
 */
#include "python/binding.h"

#include <string.h>

/* ---- lookups ---- */

#define PATH_ROOM 48 /* edges on the stack; longer paths are asked for again */

typedef struct query {
    py_handle *handle;
    const shmtf_snapshot *snapshot;
    PyObject *target_name, *source_name;
    shmtf_ref target, source;
    bool latest;
    const int64_t *time; /* NULL: the newest common time */
    int64_t time_ns, timeout_ns;
    shmtf_result *result; /* NULL: only whether it is possible */
    shmtf_error *details; /* NULL: not wanted, which spares the core clearing them */
    shmtf_error error;
} query;

#define WORTH_WAITING                                                                                      \
    (PY_STATUS_BIT(SHMTF_LOOKUP) | PY_STATUS_BIT(SHMTF_CONNECTIVITY) | PY_STATUS_BIT(SHMTF_BACKWARD) |     \
     PY_STATUS_BIT(SHMTF_FORWARD) | PY_STATUS_BIT(SHMTF_NO_DATA))

static shmtf_status ask(void *argument, int64_t timeout_ns) {
    query *q = argument;
    if (q->latest)
        return shmtf_lookup_latest_transform(q->handle->store, q->snapshot, q->target, q->source, timeout_ns, q->result,
                                             q->details);
    return shmtf_lookup_transform(q->handle->store, q->snapshot, q->target, q->source, q->time, timeout_ns, q->result,
                                  q->details);
}

static void ask_by_name(query *q) { q->target.frame = q->source.frame = (shmtf_frame){0, 0}; }

/* False: an exception is set.  A snapshot does not change, so waiting for it would be in vain. */
static bool answer(query *q, shmtf_status *status, py_wait *wait) {
    *wait = (py_wait){.call = ask, .argument = q, .again = WORTH_WAITING};
    q->details = NULL;
    *status = ask(q, 0);
    if (*status == SHMTF_OK) return true;
    if (*status == SHMTF_LOOKUP) ask_by_name(q); /* a known name may be another frame's by now */
    q->details = &q->error;
    *status = ask(q, 0);
    if (!(PY_STATUS_BIT(*status) & WORTH_WAITING) || q->timeout_ns == 0 || q->snapshot) return true;
    ask_by_name(q); /* a frame that is made anew while this waits counts */
    return py_handle_wait(q->handle, wait, q->timeout_ns, status);
}

/* time: NULL or None for the newest common time. */
static bool prepare(query *q, PyObject *self, PyObject *target, PyObject *source, PyObject *time, PyObject *timeout) {
    py_handle *h = py_reader_open(self);
    if (!h) return false;
    q->handle = h;
    q->snapshot = py_reader_snapshot(self);
    q->target_name = target;
    q->source_name = source;
    q->time = NULL;
    q->timeout_ns = 0;
    if (!py_handle_frame(h, target, "target", &q->target) || !py_handle_frame(h, source, "source", &q->source)) return false;
    if (time && time != Py_None) {
        if (!py_stamp(h->module, time, "time", &q->time_ns)) return false;
        q->time = &q->time_ns;
    }
    /* an argument's own code may have closed the store */
    return py_timeout(h->module, timeout, &q->timeout_ns) && py_reader_open(self);
}

static PyObject *raise_answer(PyObject *self, query *q, const py_wait *wait) {
    py_context context = {.store = self,
                          .target = q->target_name,
                          .source = q->source_name,
                          .timed_out = wait->timed_out,
                          .waited_s = wait->waited_s};
    return py_raise_error(q->handle->module, &q->error, &context);
}

static PyObject *transform_of(PyObject *self, query *q) {
    shmtf_edge room[PATH_ROOM], *edges = room;
    shmtf_result result = {.edges = edges, .max_edges = PATH_ROOM};
    py_wait wait;
    shmtf_status status;
    PyObject *transform = NULL;
    q->result = &result;
    for (;;) {
        if (!answer(q, &status, &wait)) break;
        if (status != SHMTF_OK) {
            raise_answer(self, q, &wait);
            break;
        }
        if (result.n_edges <= result.max_edges) {
            transform = py_transform_from_result(q->handle, q->target_name, q->source_name, &result);
            break;
        }
        if (edges != room) PyMem_Free(edges);
        result.max_edges = result.n_edges + PATH_ROOM;
        edges = result.edges = PyMem_Calloc(result.max_edges, sizeof *edges);
        if (!edges) {
            edges = room;
            PyErr_NoMemory();
            break;
        }
        if (!py_reader_open(self)) break; /* closed while this waited */
    }
    if (edges != room) PyMem_Free(edges);
    return transform;
}

PyDoc_STRVAR(lookup_doc,
             "lookup_transform($self, target, source, time=None, timeout=0.0)\n--\n\n"
             "T_target_source at `time`: p_target = T.apply(p_source).\n\n"
             "target, source: frame names.  time: int nanoseconds (or an rclpy, rospy or numpy time), interpolated; None\n"
             "is the newest time common to every edge of the path.  timeout: seconds to wait for the data, None for\n"
             "ever.  All edges are read at one commit.\n\n"
             "Raises LookupException (no such frame), ConnectivityException (no path), ExtrapolationException (the time\n"
             "is outside an edge's history), each as a TimeoutException too once a timeout has passed, and\n"
             "InvalidArgumentException.");

static PyObject *lookup_transform(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"target", "source", "time", "timeout"};
    static const py_signature signature = {"lookup_transform", 2, 4, 4, names};
    PyObject *given[4];
    query q;
    if (!py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    if (!prepare(&q, self, given[0], given[1], given[2], given[3])) return NULL;
    q.latest = false;
    return transform_of(self, &q);
}

PyDoc_STRVAR(latest_doc,
             "lookup_latest_transform($self, target, source, timeout=0.0)\n--\n\n"
             "T_target_source from the newest record (greatest stamp) of every edge, all read at one commit.\n\n"
             "The result's stamp is the oldest one used.  Never extrapolates: raises LookupException,\n"
             "ConnectivityException, or either as a TimeoutException after `timeout` seconds (None: wait for ever).");

static PyObject *lookup_latest(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"target", "source", "timeout"};
    static const py_signature signature = {"lookup_latest_transform", 2, 3, 3, names};
    PyObject *given[3];
    query q;
    if (!py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    if (!prepare(&q, self, given[0], given[1], NULL, given[2])) return NULL;
    q.latest = true;
    return transform_of(self, &q);
}

PyDoc_STRVAR(can_doc, "can_transform($self, target, source, time=None, timeout=0.0)\n--\n\n"
                      "Whether lookup_transform with these arguments would answer (bool).  Wrong arguments still raise.\n"
                      "explain() says why not.");

static PyObject *can_transform(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"target", "source", "time", "timeout"};
    static const py_signature signature = {"can_transform", 2, 4, 4, names};
    PyObject *given[4];
    query q;
    py_wait wait;
    shmtf_status status;
    if (!py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    if (!prepare(&q, self, given[0], given[1], given[2], given[3])) return NULL;
    q.latest = false;
    q.result = NULL;
    if (!answer(&q, &status, &wait)) return NULL;
    if (status == SHMTF_OK || PY_STATUS_BIT(status) & (WORTH_WAITING | PY_STATUS_BIT(SHMTF_CYCLE)))
        return PyBool_FromLong(status == SHMTF_OK);
    return raise_answer(self, &q, &wait);
}

PyDoc_STRVAR(common_doc, "_latest_common_time($self, target, source)\n--\n\n"
                         "The newest time at which every edge between the two has data; None: any time, all are static.");

static PyObject *latest_common_time(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"target", "source"};
    static const py_signature signature = {"latest_common_time", 2, 2, 2, names};
    PyObject *given[2];
    query q;
    py_wait wait = {.timed_out = false};
    int64_t time_ns = 0;
    int has_time = 0;
    if (!py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    if (!prepare(&q, self, given[0], given[1], NULL, NULL)) return NULL;
    ask_by_name(&q);
    shmtf_status status =
        shmtf_latest_common_time(q.handle->store, q.snapshot, q.target, q.source, &time_ns, &has_time, &q.error);
    if (status != SHMTF_OK) return raise_answer(self, &q, &wait);
    return has_time ? PyLong_FromLongLong(time_ns) : Py_NewRef(Py_None);
}

/* ---- frames ---- */

static PyObject *raise_about_frames(PyObject *self, const shmtf_error *error) {
    py_context context = {.store = self};
    return py_raise_error(((py_reader *)self)->handle->module, error, &context);
}

/* New array of the existing frames, to be freed with PyMem_Free. */
static shmtf_frame *all_frames(PyObject *self, py_handle *h, size_t *n) {
    const shmtf_snapshot *snapshot = py_reader_snapshot(self);
    shmtf_frame *frames = NULL;
    shmtf_error error;
    size_t room = 0;
    for (*n = 0;;) {
        if (shmtf_frames(h->store, snapshot, frames, room, n, &error) != SHMTF_OK) {
            raise_about_frames(self, &error);
            break;
        }
        if (frames && *n <= room) return frames;
        PyMem_Free(frames);
        room = *n + 8; /* others may be adding frames */
        if (!(frames = PyMem_Calloc(room, sizeof *frames))) {
            PyErr_NoMemory();
            break;
        }
    }
    PyMem_Free(frames);
    return NULL;
}

PyDoc_STRVAR(frames_doc, "frames($self)\n--\n\nNames of all existing frames (list of str), in the order of their ids.");

static PyObject *list_frames(PyObject *self, PyObject *unused) {
    (void)unused;
    py_handle *h = py_reader_open(self);
    size_t n;
    shmtf_frame *frames = h ? all_frames(self, h, &n) : NULL;
    PyObject *list = frames ? PyList_New(0) : NULL;
    for (size_t i = 0; list && i < n; i++) {
        PyObject *name = py_handle_name(h, frames[i]);
        /* None: removed since it was listed */
        if (!name || (name != Py_None && PyList_Append(list, name) < 0)) Py_CLEAR(list);
        Py_XDECREF(name);
    }
    PyMem_Free(frames);
    return list;
}

PyDoc_STRVAR(exists_doc, "frame_exists($self, name, /)\n--\n\nWhether a frame of that name exists (bool).");

static PyObject *frame_exists(PyObject *self, PyObject *name) {
    py_handle *h = py_reader_open(self);
    const char *text = h ? py_frame_name(h->module, name, "name") : NULL;
    shmtf_frame frame;
    shmtf_error error;
    if (!text) return NULL;
    shmtf_status status = shmtf_resolve(h->store, py_reader_snapshot(self), text, &frame, &error);
    if (status == SHMTF_OK || status == SHMTF_LOOKUP) return PyBool_FromLong(status == SHMTF_OK);
    return raise_about_frames(self, &error);
}

PyDoc_STRVAR(parent_doc, "parent($self, name, time=None)\n--\n\n"
                         "The frame's parent at `time` (None: newest) as str; None for a root.\n"
                         "Raises LookupException, ExtrapolationException.");

static PyObject *parent_of(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames) {
    static const char *const names[] = {"name", "time"};
    static const py_signature signature = {"parent", 1, 2, 2, names};
    PyObject *given[2];
    py_handle *h = py_reader_open(self);
    if (!h || !py_arguments(&signature, args, n_args, kwnames, given)) return NULL;
    int64_t time_ns;
    bool has_time = given[1] && given[1] != Py_None;
    shmtf_ref ref = {.frame = {0, 0}};
    shmtf_frame parent;
    shmtf_error error;
    if (!(ref.name = py_frame_name(h->module, given[0], "name"))) return NULL;
    if (has_time && (!py_stamp(h->module, given[1], "time", &time_ns) || !py_reader_open(self))) return NULL;
    if (shmtf_parent(h->store, py_reader_snapshot(self), ref, has_time ? &time_ns : NULL, &parent, &error) != SHMTF_OK)
        return raise_about_frames(self, &error);
    return parent.gen ? py_handle_name(h, parent) : Py_NewRef(Py_None);
}

/* ---- type ---- */

static PyObject *get_version(PyObject *self, void *unused) {
    (void)unused;
    py_handle *h = py_reader_open(self);
    if (!h) return NULL;
    const shmtf_snapshot *snapshot = py_reader_snapshot(self);
    if (snapshot) return PyLong_FromUnsignedLongLong(shmtf_snapshot_version(*snapshot));
    uint64_t version = shmtf_commit_version(h->store);
    shmtf_error error;
    shmtf_info info;
    if (version == 0 && shmtf_get_info(h->store, &info, &error) != SHMTF_OK) return py_raise_error(h->module, &error, NULL);
    return PyLong_FromUnsignedLongLong(version);
}

static PyObject *get_readonly(PyObject *self, void *unused) {
    (void)unused;
    return PyBool_FromLong(((py_reader *)self)->handle->readonly);
}

static PyObject *get_closed(PyObject *self, void *unused) {
    (void)unused;
    py_reader *r = (py_reader *)self;
    return PyBool_FromLong(r->is_closed || r->handle->closing);
}

void py_reader_dealloc(PyObject *self) {
    py_reader *r = (py_reader *)self;
    PyTypeObject *type = Py_TYPE(self);
    if (r->handle) py_handle_unref(r->handle);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

static PyMethodDef methods[] = {
    PY_METHOD("lookup_transform", lookup_transform, lookup_doc),
    PY_METHOD("lookup_latest_transform", lookup_latest, latest_doc),
    PY_METHOD("can_transform", can_transform, can_doc),
    PY_METHOD("_latest_common_time", latest_common_time, common_doc),
    {"frames", list_frames, METH_NOARGS, frames_doc},
    {"frame_exists", frame_exists, METH_O, exists_doc},
    PY_METHOD("parent", parent_of, parent_doc),
    {"_frame_info", py_reader_frame_info, METH_O, PyDoc_STR("_frame_info($self, name, /)\n--\n\nThe core's record of a frame (dict).")},
    PY_METHOD("_records", py_reader_records,
              PyDoc_STR("_records($self, frame, limit=65536)\n--\n\nReadable records, newest stamp first (list of dict).")),
    {"_info", py_reader_info, METH_NOARGS, PyDoc_STR("_info($self)\n--\n\nCapacities and identity of the segment (dict).")},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef getters[] = {
    {"version", get_version, NULL, PyDoc_STR("The commit that reads see now: of a store the last one, of a snapshot its own."), NULL},
    {"readonly", get_readonly, NULL, PyDoc_STR("Whether the segment is mapped for reading only (bool)."), NULL},
    {"closed", get_closed, NULL, PyDoc_STR("Whether it was closed (bool)."), NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_doc, (void *)"What a Store and a Snapshot have in common: the reads."},
    {Py_tp_dealloc, py_reader_dealloc},
    {Py_tp_methods, methods},
    {Py_tp_getset, getters},
    {0, NULL},
};

static PyType_Spec spec = {
    .name = "shmtf._core.Reader",
    .basicsize = sizeof(py_reader),
    .flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_DISALLOW_INSTANTIATION | Py_TPFLAGS_IMMUTABLETYPE,
    .slots = slots,
};

PyTypeObject *py_reader_type_new(PyObject *module) { return (PyTypeObject *)PyType_FromModuleAndSpec(module, &spec, NULL); }
