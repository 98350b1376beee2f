/* SPDX-License-Identifier: Apache-2.0
 *
 * Failure detail is data: the fields of a shmtf_error go into a dict, from which shmtf/errors.py makes the
 * exception, and the exception its message when somebody reads it.
 */
#include "python/binding.h"

#include <string.h>

/* dict[key] = value, taking the value over.  A NULL dict or value stands for an exception that is set already. */
static PyObject *put(PyObject *dict, const char *key, PyObject *value) {
    if (!dict || !value || PyDict_SetItemString(dict, key, value) < 0) {
        Py_XDECREF(dict);
        dict = NULL;
    }
    Py_XDECREF(value);
    return dict;
}

static PyObject *put_text(PyObject *dict, const char *key, const char *text) {
    if (!dict || !text || !*text) return dict;
    /* the segment may hold anything: bytes that are no UTF-8 must not hide the error */
    return put(dict, key, PyUnicode_DecodeUTF8(text, (Py_ssize_t)strlen(text), "backslashreplace"));
}

static PyObject *put_object(PyObject *dict, const char *key, PyObject *object) {
    return object ? put(dict, key, Py_NewRef(object)) : dict;
}

PyObject *py_raise(module_state *m, const char *status, PyObject *fields) {
    if (!fields) return NULL;
    if (!m->error_factory) {
        PyErr_Format(PyExc_RuntimeError, "shmtf: %s %R", status, fields);
        Py_DECREF(fields);
        return NULL;
    }
    PyObject *exception = PyObject_CallFunction(m->error_factory, "sN", status, fields);
    if (!exception) return NULL;
    PyErr_SetObject((PyObject *)Py_TYPE(exception), exception);
    Py_DECREF(exception);
    return NULL;
}

PyObject *py_raise_invalid(module_state *m, const char *what, PyObject *value, const char *hint) {
    PyObject *fields = put_text(PyDict_New(), "what", what);
    fields = put_text(fields, "hint", hint);
    return py_raise(m, "INVALID_ARGUMENT", put_object(fields, "value", value));
}

PyObject *py_raise_closed(module_state *m) { return py_raise(m, "CLOSED", PyDict_New()); }

static PyObject *put_context(PyObject *fields, const py_context *context) {
    if (!context) return fields;
    fields = put_object(fields, "store", context->store);
    fields = put_object(fields, "target", context->target);
    fields = put_object(fields, "source", context->source);
    if (context->timed_out) fields = put_object(fields, "timed_out", Py_True);
    if (context->waited_s > 0) fields = put(fields, "waited", PyFloat_FromDouble(context->waited_s));
    return fields;
}

static PyObject *put_place(PyObject *fields, const shmtf_error *e) {
    if (e->parent[0] && e->child[0]) {
        PyObject *parent = PyUnicode_DecodeUTF8(e->parent, (Py_ssize_t)strlen(e->parent), "backslashreplace");
        PyObject *child = PyUnicode_DecodeUTF8(e->child, (Py_ssize_t)strlen(e->child), "backslashreplace");
        PyObject *edge = parent && child ? PyTuple_Pack(2, parent, child) : NULL;
        Py_XDECREF(parent);
        Py_XDECREF(child);
        return put(fields, "edge", edge);
    }
    return put_text(fields, "frame", e->child[0] ? e->child : e->parent);
}

PyObject *py_raise_error(module_state *m, const shmtf_error *e, const py_context *context) {
    PyObject *fields = put_place(put_context(PyDict_New(), context), e);
    fields = put_text(fields, "what", e->what);
    fields = put_text(fields, "hint", e->hint);
    if (e->has_times & 1) fields = put(fields, "requested", PyLong_FromLongLong(e->requested_ns));
    if (e->has_times & 2) fields = put(fields, "oldest", PyLong_FromLongLong(e->oldest_ns));
    if (e->has_times & 4) fields = put(fields, "newest", PyLong_FromLongLong(e->newest_ns));
    if (e->status == SHMTF_INVALID_ARGUMENT && e->value != 0) fields = put(fields, "value", PyFloat_FromDouble(e->value));
    if (e->limit || e->needed) {
        fields = put(fields, "limit", PyLong_FromUnsignedLongLong(e->limit));
        fields = put(fields, "needed", PyLong_FromUnsignedLongLong(e->needed));
    }
    if (context && context->is_batch) fields = put(fields, "item", PyLong_FromSize_t(e->item));
    if (e->status == SHMTF_BUSY) {
        fields = put_text(fields, "holder", e->holder);
        fields = put(fields, "holder_slot", PyLong_FromLong(e->holder_slot));
        fields = put(fields, "holder_pid", PyLong_FromLongLong(e->holder_pid));
    }
    if (e->sys_errno) fields = put(fields, "sys_errno", PyLong_FromLong(e->sys_errno));
    return py_raise(m, shmtf_status_name(e->status), fields);
}
