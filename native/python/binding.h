/* SPDX-License-Identifier: Apache-2.0
 *
 * What the files of the Python binding share.  The binding is a table of methods and conversions over shmtf.h.
 *
 *   errors.c     shmtf_error -> Python exception
 *   convert.c    Python arguments -> C values
 *   handle.c     a store that several Python objects use: closing, names, waiting without the GIL
 *   transform.c  type Transform: what is written, and what a lookup returns
 *   inspect.c    frame_info, records, writers, counters: C structs -> dicts
 *   read.c       type Reader: the reads, of a store or of a snapshot
 *   write.c      the writes of a store
 *   store.c      types Store (Reader and the writes, and the wait) and Snapshot
 *   module.c     the module: its state, functions and types
 *
 * Every function here needs the GIL unless it says otherwise.  The GIL also guards the caches in a handle, so a
 * build for free-threaded Python does not declare Py_MOD_GIL_NOT_USED.
 */
#ifndef SHMTF_PYTHON_BINDING_H
#define SHMTF_PYTHON_BINDING_H

#ifndef Py_LIMITED_API
#include <pyconfig.h>
#ifndef Py_GIL_DISABLED /* has no stable ABI yet */
#define Py_LIMITED_API 0x030B0000
#endif
#endif
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdbool.h>
#include <stdint.h>

#include "shmtf.h"

typedef struct module_state {
    PyTypeObject *transform_base, *reader_type, *store_type, *snapshot_type;
    PyTypeObject *transform_type; /* the class that lookups return; transform_base until it is set */
    PyObject *error_factory;      /* (status, fields) -> exception instance */
    PyObject *stamp_converter;    /* time object -> int nanoseconds */
} module_state;

/* ---- errors.c ---- */

/* Sets the exception for `status` with `fields`, a new dict that it takes over (NULL: an exception is set already).
 * Returns NULL. */
PyObject *py_raise(module_state *m, const char *status, PyObject *fields);
/* The same for an error of the core.  Adds what was asked: target and source (NULL: not a lookup). */
typedef struct py_context {
    PyObject *store, *target, *source;
    bool timed_out;  /* the caller's timeout passed before the answer changed */
    bool is_batch;   /* error->item counts */
    double waited_s; /* how long the call waited */
} py_context;
PyObject *py_raise_error(module_state *m, const shmtf_error *error, const py_context *context);
/* InvalidArgumentException: `what` is wrong, `value` (may be NULL) was given, `hint` would help. */
PyObject *py_raise_invalid(module_state *m, const char *what, PyObject *value, const char *hint);
PyObject *py_raise_closed(module_state *m);

/* ---- convert.c ---- */

typedef struct py_signature {
    const char *function;
    int n_required, n_positional, n_total;
    const char *const *names;
} py_signature;
/* Sorts the arguments of a vectorcall into out[n_total], NULL where not given.  False: TypeError is set. */
bool py_arguments(const py_signature *signature, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames,
                  PyObject **out);
/* A frame name: its UTF-8, which lives as long as the object; NULL with an exception.  `what` names the argument. */
const char *py_frame_name(module_state *m, PyObject *object, const char *what);
/* int nanoseconds, or one of the foreign time classes; a float is a TypeError. */
bool py_stamp(module_state *m, PyObject *object, const char *what, int64_t *ns);
/* Seconds, None for ever (-1).  `object` NULL leaves *ns alone. */
bool py_timeout(module_state *m, PyObject *object, int64_t *ns);
/* A str or None, as UTF-8 without NUL bytes; NULL in *text for None or an absent object. */
bool py_text(module_state *m, PyObject *object, const char *what, const char **text);
/* `n` numbers from a tuple, list, array of float64 or any sequence. */
bool py_numbers(module_state *m, PyObject *object, const char *what, double *out, Py_ssize_t n);
/* Brings a pose into the stored form, |q| = 1 and qw >= 0, or raises InvalidArgumentException. */
bool py_normalise(module_state *m, shmtf_pose *pose);
shmtf_pose py_compose(const shmtf_pose *T_a_b, const shmtf_pose *T_b_c);
shmtf_pose py_inverse(const shmtf_pose *T_a_b);

/* ---- handle.c ---- */

typedef struct py_known_name {
    PyObject *object; /* strong: so that the address stays this string's */
    const char *text;
    shmtf_frame frame;
} py_known_name;

typedef struct py_handle {
    shmtf_store *store; /* NULL when it is unmapped */
    module_state *module;
    Py_ssize_t n_refs;
    Py_ssize_t n_inside; /* calls that run without the GIL */
    bool closing;        /* no call may start; the last one inside unmaps */
    bool readonly;
    size_t n_known;       /* a power of two */
    py_known_name *known; /* by the address of the string: names in literals cost no hashing */
    size_t n_names;
    struct py_frame_label {
        uint32_t gen;
        PyObject *name;
    } *names; /* by frame id */
} py_handle;

py_handle *py_handle_new(module_state *m, shmtf_store *store); /* takes the store over, also when it fails */
py_handle *py_handle_ref(py_handle *h);
void py_handle_unref(py_handle *h);
/* Unmaps now, or when the last call inside is over. */
void py_handle_close(py_handle *h);
/* Frame of a name: by handle where it is known.  The name stays borrowed from `object`. */
bool py_handle_frame(py_handle *h, PyObject *object, const char *what, shmtf_ref *ref);
/* Remember what the core resolved. */
void py_handle_learn(py_handle *h, PyObject *object, const shmtf_ref *ref);
/* New reference to the frame's name; None if the frame was removed; NULL with an exception. */
PyObject *py_handle_name(py_handle *h, shmtf_frame frame);

/* A call of the core that may wait; runs without the GIL, so it touches no Python object. */
typedef shmtf_status (*py_core_call)(void *argument, int64_t timeout_ns);
typedef struct py_wait {
    py_core_call call;
    void *argument;
    uint32_t again;  /* bit per status that the call is repeated for, until the timeout */
    bool timed_out;  /* out: the status is of that kind and the timeout has passed */
    double waited_s; /* out */
} py_wait;
#define PY_STATUS_BIT(status) (1u << (status))
/* Repeats the call until its status is final, the timeout passes (negative: never), the store is closed or a
 * signal handler raises.  False: an exception is set. */
bool py_handle_wait(py_handle *h, py_wait *wait, int64_t timeout_ns, shmtf_status *status);

/* ---- transform.c ---- */

typedef struct py_transform {
    PyObject_VAR_HEAD
    PyObject *parent, *child;
    PyObject *edges;   /* tuple of (parent, child, stamp); NULL: not named yet */
    py_handle *handle; /* of the store that was read, for the names of raw_edges; NULL: made by hand */
    int64_t stamp_ns, oldest_ns, newest_ns;
    uint64_t version; /* the commit that was read, 0: none */
    shmtf_pose pose;
    bool has_stamp, has_range;
    uint32_t n_edges;
    shmtf_edge raw_edges[];
} py_transform;

PyTypeObject *py_transform_type_new(PyObject *module);
/* The class that lookups return: a subclass of Transform without fields of its own. */
PyObject *py_set_transform_type(PyObject *module, PyObject *type);
/* Transform of a lookup. */
PyObject *py_transform_from_result(py_handle *h, PyObject *target, PyObject *source, const shmtf_result *result);
static inline bool py_is_transform(const module_state *m, PyObject *object) {
    return Py_IS_TYPE(object, m->transform_type) || PyObject_TypeCheck(object, m->transform_base);
}

/* ---- read.c and inspect.c ---- */

typedef struct py_reader {
    PyObject_HEAD
    py_handle *handle;
    bool has_snapshot, is_closed; /* closed: this object, which may be a snapshot of an open store */
    shmtf_snapshot snapshot;
} py_reader;

PyTypeObject *py_reader_type_new(PyObject *module);
void py_reader_dealloc(PyObject *self);
/* NULL, with ClosedError set, if the store or the snapshot is closed. */
static inline py_handle *py_reader_open(PyObject *self) {
    py_reader *r = (py_reader *)self;
    if (r->handle->closing || r->is_closed) {
        py_raise_closed(r->handle->module);
        return NULL;
    }
    return r->handle;
}
static inline const shmtf_snapshot *py_reader_snapshot(PyObject *self) {
    py_reader *r = (py_reader *)self;
    return r->has_snapshot ? &r->snapshot : NULL;
}

PyObject *py_reader_frame_info(PyObject *self, PyObject *name);
PyObject *py_reader_records(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames);
PyObject *py_reader_info(PyObject *self, PyObject *unused);
PyObject *py_reader_counters(PyObject *self, PyObject *unused);
PyObject *py_reader_writers(PyObject *self, PyObject *unused);
PyObject *py_reader_frame_words(PyObject *self, PyObject *name);
PyObject *py_store_check(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames);

/* ---- write.c and store.c ---- */

PyObject *py_store_set_transform(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames);
PyObject *py_store_set_transforms(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames);
PyObject *py_store_declare_frame(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames);
PyObject *py_store_remove_frame(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames);
PyObject *py_store_clear(PyObject *self, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames);

PyTypeObject *py_store_type_new(PyObject *module, PyTypeObject *reader_type);
PyTypeObject *py_snapshot_type_new(PyObject *module, PyTypeObject *reader_type);

/* A method of the vectorcall kind, for the tables. */
#define PY_METHOD(name, function, doc) \
    { name, (PyCFunction)(void (*)(void))(function), METH_FASTCALL | METH_KEYWORDS, doc }

#endif
