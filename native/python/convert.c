/* SPDX-License-Identifier: Apache-2.0
 *
 * Python arguments -> C values.  What a user can get wrong is said here, before the core is called.
 */
#include "python/binding.h"

#include <math.h>
#include <string.h>

/* ---- arguments ---- */

static int keyword_index(const py_signature *s, PyObject *keyword) {
    for (int i = 0; i < s->n_total; i++)
        if (PyUnicode_CompareWithASCIIString(keyword, s->names[i]) == 0) return i;
    return -1;
}

static bool take_keywords(const py_signature *s, PyObject *const *values, PyObject *kwnames, PyObject **out) {
    for (Py_ssize_t i = 0; i < PyTuple_Size(kwnames); i++) {
        PyObject *keyword = PyTuple_GetItem(kwnames, i);
        int index = keyword_index(s, keyword);
        if (index < 0) {
            PyErr_Format(PyExc_TypeError, "%s() got an unexpected keyword argument %R", s->function, keyword);
            return false;
        }
        if (out[index]) {
            PyErr_Format(PyExc_TypeError, "%s() got multiple values for argument '%s'", s->function, s->names[index]);
            return false;
        }
        out[index] = values[i];
    }
    return true;
}

bool py_arguments(const py_signature *s, PyObject *const *args, Py_ssize_t n_args, PyObject *kwnames, PyObject **out) {
    if (n_args > s->n_positional) {
        PyErr_Format(PyExc_TypeError, "%s() takes %d positional arguments but %zd were given", s->function,
                     s->n_positional, n_args);
        return false;
    }
    for (Py_ssize_t i = 0; i < s->n_total; i++) out[i] = i < n_args ? args[i] : NULL;
    if (kwnames && !take_keywords(s, args + n_args, kwnames, out)) return false;
    for (int i = 0; i < s->n_required; i++) {
        if (out[i]) continue;
        PyErr_Format(PyExc_TypeError, "%s() missing required argument '%s' (position %d)", s->function, s->names[i], i + 1);
        return false;
    }
    return true;
}

/* ---- text ---- */

static const char *utf8(module_state *m, PyObject *object, const char *what, Py_ssize_t *size) {
    const char *text = PyUnicode_AsUTF8AndSize(object, size);
    if (!text && PyErr_ExceptionMatches(PyExc_UnicodeEncodeError)) {
        PyErr_Clear();
        py_raise_invalid(m, what, object, "it has a lone surrogate, which is not valid UTF-8");
    }
    return text;
}

const char *py_frame_name(module_state *m, PyObject *object, const char *what) {
    if (!PyUnicode_Check(object)) {
        PyErr_Format(PyExc_TypeError, "%s must be a str, not %R", what, (PyObject *)Py_TYPE(object));
        return NULL;
    }
    Py_ssize_t size;
    const char *text = utf8(m, object, what, &size), *hint = NULL;
    if (!text) return NULL;
    if (size == 0)
        hint = "a frame name has at least one character";
    else if (size >= SHMTF_NAME_SIZE)
        hint = "a frame name has at most 127 bytes of UTF-8";
    else if (text[0] == '/')
        hint = "a frame name has no leading '/'";
    else if (memchr(text, 0, (size_t)size))
        hint = "a frame name has no NUL character";
    if (!hint) return text;
    py_raise_invalid(m, what, object, hint);
    return NULL;
}

bool py_text(module_state *m, PyObject *object, const char *what, const char **text) {
    *text = NULL;
    if (!object || object == Py_None) return true;
    if (!PyUnicode_Check(object)) {
        PyErr_Format(PyExc_TypeError, "%s must be a str or None, not %R", what, (PyObject *)Py_TYPE(object));
        return false;
    }
    Py_ssize_t size;
    *text = utf8(m, object, what, &size);
    if (!*text) return false;
    if (memchr(*text, 0, (size_t)size)) return py_raise_invalid(m, what, object, "it has a NUL character") != NULL;
    return true;
}

/* ---- time ---- */

static bool stamp_from_int(module_state *m, PyObject *object, const char *what, int64_t *ns) {
    int overflow;
    long long value = PyLong_AsLongLongAndOverflow(object, &overflow);
    if (overflow) {
        py_raise_invalid(m, what, object, "a time is int64 nanoseconds");
        return false;
    }
    if (value == -1 && PyErr_Occurred()) return false;
    *ns = value;
    return true;
}

bool py_stamp(module_state *m, PyObject *object, const char *what, int64_t *ns) {
    if (PyLong_CheckExact(object)) return stamp_from_int(m, object, what, ns);
    if (PyBool_Check(object) || PyFloat_Check(object)) {
        PyErr_Format(PyExc_TypeError, "%s must be int nanoseconds, not %R: use shmtf.from_seconds(s) for seconds", what,
                     object);
        return false;
    }
    PyObject *number;
    if (PyIndex_Check(object))
        number = PyNumber_Index(object);
    else if (m->stamp_converter)
        number = PyObject_CallFunction(m->stamp_converter, "Os", object, what);
    else
        number = PyErr_Format(PyExc_TypeError, "%s must be int nanoseconds", what);
    if (!number) return false;
    bool ok = PyLong_Check(number) && stamp_from_int(m, number, what, ns);
    if (!ok && !PyErr_Occurred()) PyErr_Format(PyExc_TypeError, "%s must be int nanoseconds", what);
    Py_DECREF(number);
    return ok;
}

bool py_timeout(module_state *m, PyObject *object, int64_t *ns) {
    if (!object) return true;
    *ns = -1;
    if (object == Py_None) return true;
    double seconds = PyFloat_AsDouble(object);
    if (seconds == -1 && PyErr_Occurred()) return false;
    if (!(seconds >= 0)) {
        py_raise_invalid(m, "timeout", object, "seconds, 0 or more; None waits for ever");
        return false;
    }
    if (seconds < 4e9) *ns = (int64_t)ceil(seconds * 1e9); /* else for ever */
    return true;
}

/* ---- numbers ---- */

/* 1: done, 0: not a buffer of doubles, -1: an exception is set. */
static int numbers_from_buffer(PyObject *object, const char *what, double *out, Py_ssize_t n) {
    Py_buffer view;
    if (!PyObject_CheckBuffer(object)) return 0;
    if (PyObject_GetBuffer(object, &view, PyBUF_STRIDED_RO | PyBUF_FORMAT) < 0) {
        PyErr_Clear();
        return 0;
    }
    int done = 0;
    if (view.format && strcmp(view.format, "d") == 0) {
        if (view.ndim != 1 || view.shape[0] != n) {
            PyErr_Format(PyExc_ValueError, "%s must have shape (%zd,)", what, n);
            done = -1;
        } else {
            for (Py_ssize_t i = 0; i < n; i++) memcpy(out + i, (const char *)view.buf + i * view.strides[0], sizeof *out);
            done = 1;
        }
    }
    PyBuffer_Release(&view);
    return done;
}

bool py_numbers(module_state *m, PyObject *object, const char *what, double *out, Py_ssize_t n) {
    PyObject *items;
    if (PyTuple_CheckExact(object)) {
        items = Py_NewRef(object);
    } else {
        int done = numbers_from_buffer(object, what, out, n);
        if (done) return done > 0;
        if (PyUnicode_Check(object) || PyBytes_Check(object) || !(items = PySequence_Tuple(object))) {
            if (PyErr_Occurred() && !PyErr_ExceptionMatches(PyExc_TypeError)) return false;
            PyErr_Format(PyExc_TypeError, "%s must be %zd numbers, not %R", what, n, object);
            return false;
        }
    }
    bool ok = PyTuple_Size(items) == n;
    if (!ok) py_raise_invalid(m, what, object, n == 3 ? "three numbers x y z" : "four numbers x y z w");
    for (Py_ssize_t i = 0; ok && i < n; i++) {
        out[i] = PyFloat_AsDouble(PyTuple_GetItem(items, i));
        ok = !(out[i] == -1 && PyErr_Occurred());
    }
    Py_DECREF(items);
    return ok;
}

/* ---- poses ---- */

static bool raise_number(module_state *m, const char *what, double value, const char *hint) {
    PyObject *number = PyFloat_FromDouble(value);
    if (number) py_raise_invalid(m, what, number, hint);
    Py_XDECREF(number);
    return false;
}

bool py_normalise(module_state *m, shmtf_pose *p) {
    static const char *const name[7] = {"translation x", "translation y", "translation z", "rotation x",
                                        "rotation y",    "rotation z",    "rotation w"};
    const double v[7] = {p->x, p->y, p->z, p->qx, p->qy, p->qz, p->qw};
    for (int i = 0; i < 7; i++)
        if (!isfinite(v[i])) return raise_number(m, name[i], v[i], "every number must be finite");
    double n2 = p->qx * p->qx + p->qy * p->qy + p->qz * p->qz + p->qw * p->qw;
    if (n2 == 0) return raise_number(m, "norm of the rotation", 0, "a rotation is a unit quaternion x y z w; none is (0, 0, 0, 1)");
    if (!(fabs(n2 - 1) <= 1e-2))
        return raise_number(m, "norm of the rotation", hypot(hypot(p->qx, p->qy), hypot(p->qz, p->qw)),
                            "a rotation is a unit quaternion x y z w: divide it by its norm");
    /* a quaternion that has been through here before stays as it is, to the last bit */
    double s = fabs(n2 - 1) <= 1e-15 ? 1 : 1 / sqrt(n2);
    if (p->qw < 0) s = -s;
    if (s == 1) return true;
    p->qx = p->qx * s + 0.0; /* + 0.0: no negative zeros */
    p->qy = p->qy * s + 0.0;
    p->qz = p->qz * s + 0.0;
    p->qw = p->qw * s + 0.0;
    return true;
}

static void rotate(const shmtf_pose *q, double x, double y, double z, double out[3]) {
    double tx = 2 * (q->qy * z - q->qz * y), ty = 2 * (q->qz * x - q->qx * z), tz = 2 * (q->qx * y - q->qy * x);
    out[0] = x + q->qw * tx + (q->qy * tz - q->qz * ty);
    out[1] = y + q->qw * ty + (q->qz * tx - q->qx * tz);
    out[2] = z + q->qw * tz + (q->qx * ty - q->qy * tx);
}

shmtf_pose py_compose(const shmtf_pose *a, const shmtf_pose *b) {
    double t[3];
    rotate(a, b->x, b->y, b->z, t);
    return (shmtf_pose){a->x + t[0], a->y + t[1], a->z + t[2],
                        a->qw * b->qx + a->qx * b->qw + a->qy * b->qz - a->qz * b->qy,
                        a->qw * b->qy - a->qx * b->qz + a->qy * b->qw + a->qz * b->qx,
                        a->qw * b->qz + a->qx * b->qy - a->qy * b->qx + a->qz * b->qw,
                        a->qw * b->qw - a->qx * b->qx - a->qy * b->qy - a->qz * b->qz};
}

shmtf_pose py_inverse(const shmtf_pose *a) {
    shmtf_pose r = {0, 0, 0, -a->qx, -a->qy, -a->qz, a->qw};
    double t[3];
    rotate(&r, a->x, a->y, a->z, t);
    return (shmtf_pose){-t[0] + 0.0, -t[1] + 0.0, -t[2] + 0.0, r.qx + 0.0, r.qy + 0.0, r.qz + 0.0, r.qw};
}
