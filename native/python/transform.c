/* SPDX-License-Identifier: Apache-2.0
 *
 * Type Transform: one immutable T_parent_child.  The same type is what a program writes and what a lookup returns.
 * Its seven doubles are a read-only buffer, so that numpy sees them without a copy.  A lookup makes exactly one
 * object; the names of the edges it used are looked up when somebody asks for them.
 */
#include "python/binding.h"

#include <string.h>

/* ---- life ---- */

/* The module's own type among the bases of `type`: only that one knows the module. */
static module_state *state_of(PyTypeObject *type);

static py_transform *allocate(module_state *m, PyTypeObject *type, uint32_t n_edges) {
    py_transform *t;
    if (type == m->transform_type && type != m->transform_base) {
        /* Not zeroed whole, and not tracked by the garbage collector: it refers to nothing that could refer to it. */
        t = PyObject_GC_NewVar(py_transform, type, (Py_ssize_t)n_edges);
        if (t) memset(&t->parent, 0, offsetof(py_transform, raw_edges) - offsetof(py_transform, parent));
    } else {
        t = (py_transform *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, (Py_ssize_t)n_edges);
    }
    return t;
}

static void transform_dealloc(PyObject *self) {
    py_transform *t = (py_transform *)self;
    PyTypeObject *type = Py_TYPE(self);
    Py_XDECREF(t->parent);
    Py_XDECREF(t->child);
    Py_XDECREF(t->edges);
    if (t->handle) py_handle_unref(t->handle);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

PyObject *py_transform_from_result(py_handle *h, PyObject *target, PyObject *source, const shmtf_result *r) {
    py_transform *t = allocate(h->module, h->module->transform_type, r->n_edges);
    if (!t) return NULL;
    t->parent = Py_NewRef(target);
    t->child = Py_NewRef(source);
    t->handle = py_handle_ref(h);
    t->stamp_ns = r->stamp_ns;
    t->oldest_ns = r->oldest_ns;
    t->newest_ns = r->newest_ns;
    t->version = r->version;
    t->pose = r->pose;
    t->has_stamp = t->has_range = !r->all_static;
    t->n_edges = r->n_edges;
    if (r->n_edges) memcpy(t->raw_edges, r->edges, r->n_edges * sizeof *r->edges);
    return (PyObject *)t;
}

/* ---- constructor ---- */

static bool set_times(module_state *m, py_transform *t, PyObject *stamp) {
    if (stamp == Py_None) return true;
    if (!py_stamp(m, stamp, "stamp", &t->stamp_ns)) return false;
    t->oldest_ns = t->newest_ns = t->stamp_ns;
    t->has_stamp = t->has_range = true;
    return true;
}

static bool set_pose(module_state *m, py_transform *t, PyObject *translation, PyObject *rotation) {
    double v[7] = {0, 0, 0, 0, 0, 0, 1};
    if (translation && !py_numbers(m, translation, "translation", v, 3)) return false;
    if (rotation && !py_numbers(m, rotation, "rotation", v + 3, 4)) return false;
    t->pose = (shmtf_pose){v[0], v[1], v[2], v[3], v[4], v[5], v[6]};
    return py_normalise(m, &t->pose);
}

static PyObject *transform_new(PyTypeObject *type, PyObject *args, PyObject *kwargs) {
    static const char *const names[] = {"parent", "child", "stamp", "translation", "rotation", NULL};
    PyObject *parent, *child, *stamp = Py_None, *translation = NULL, *rotation = NULL;
    module_state *m = state_of(type);
    if (!m || !PyArg_ParseTupleAndKeywords(args, kwargs, "OO|OOO:Transform", (char **)names, &parent, &child, &stamp, &translation,
                                           &rotation))
        return NULL;
    const char *parent_text = py_frame_name(m, parent, "parent");
    const char *child_text = parent_text ? py_frame_name(m, child, "child") : NULL;
    if (!child_text) return NULL;
    if (strcmp(parent_text, child_text) == 0)
        return py_raise_invalid(m, "child", child, "a frame cannot be its own parent");
    py_transform *t = allocate(m, type, 0);
    if (!t) return NULL;
    t->parent = Py_NewRef(parent);
    t->child = Py_NewRef(child);
    if (set_times(m, t, stamp) && set_pose(m, t, translation, rotation)) return (PyObject *)t;
    Py_DECREF(t);
    return NULL;
}

static module_state *state_of(PyTypeObject *type) {
    PyTypeObject *own = NULL;
    for (; type; type = PyType_GetSlot(type, Py_tp_base))
        if (PyType_GetSlot(type, Py_tp_new) == (void *)transform_new) own = type;
    return own ? PyType_GetModuleState(own) : NULL;
}

/* A transform with every field given, which skips the checks: for products, inverses and unpickling. */
static py_transform *derived(const py_transform *from, PyObject *parent, PyObject *child, shmtf_pose pose) {
    PyTypeObject *type = Py_TYPE((PyObject *)from);
    module_state *m = state_of(type);
    if (!m || !py_normalise(m, &pose)) return NULL;
    py_transform *t = allocate(m, type, 0);
    if (!t) return NULL;
    t->parent = Py_NewRef(parent);
    t->child = Py_NewRef(child);
    t->pose = pose;
    t->stamp_ns = from->stamp_ns;
    t->oldest_ns = from->oldest_ns;
    t->newest_ns = from->newest_ns;
    t->version = from->version;
    t->has_stamp = from->has_stamp;
    t->has_range = from->has_range;
    return t;
}

/* ---- methods ---- */

PyDoc_STRVAR(compose_doc, "_compose($self, other, /)\n--\n\nT_a_c of self = T_a_b and other = T_b_c.  The frames are the caller's to check.");

static PyObject *transform_compose(PyObject *self, PyObject *other) {
    py_transform *a = (py_transform *)self, *b = (py_transform *)other;
    module_state *m = state_of(Py_TYPE(self));
    if (!m) return NULL;
    if (!py_is_transform(m, other)) return PyErr_Format(PyExc_TypeError, "not a Transform: %R", other);
    py_transform *t = derived(a, a->parent, b->child, py_compose(&a->pose, &b->pose));
    if (!t || !b->has_stamp) return (PyObject *)t;
    bool first = !t->has_stamp;
    if (first || b->stamp_ns < t->stamp_ns) t->stamp_ns = b->stamp_ns;
    if (first || b->oldest_ns < t->oldest_ns) t->oldest_ns = b->oldest_ns;
    if (first || b->newest_ns > t->newest_ns) t->newest_ns = b->newest_ns;
    if (b->version != t->version) t->version = 0;
    t->has_stamp = t->has_range = true;
    return (PyObject *)t;
}

static PyObject *transform_inverse(PyObject *self, PyObject *unused) {
    (void)unused;
    py_transform *t = (py_transform *)self;
    return (PyObject *)derived(t, t->child, t->parent, py_inverse(&t->pose));
}

static PyObject *transform_values(PyObject *self, PyObject *unused) {
    (void)unused;
    const shmtf_pose *p = &((py_transform *)self)->pose;
    return Py_BuildValue("(ddddddd)", p->x, p->y, p->z, p->qx, p->qy, p->qz, p->qw);
}

static PyObject *transform_matrix_bytes(PyObject *self, PyObject *unused) {
    (void)unused;
    const shmtf_pose *p = &((py_transform *)self)->pose;
    double x = p->qx, y = p->qy, z = p->qz, w = p->qw;
    const double matrix[16] = {
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), p->x, /* */
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), p->y, /* */
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), p->z, /* */
        0, 0, 0, 1};
    return PyBytes_FromStringAndSize((const char *)matrix, sizeof matrix);
}

PyDoc_STRVAR(restore_doc, "_restore($cls, parent, child, stamp, values, stamp_range, version, edges, /)\n--\n\nWhat __reduce__ calls.");

static PyObject *transform_restore(PyObject *cls, PyObject *args) {
    PyObject *parent, *child, *stamp, *range, *edges;
    double v[7];
    unsigned long long version;
    module_state *m = state_of((PyTypeObject *)cls);
    if (!m || !PyArg_ParseTuple(args, "UUO(ddddddd)OKO!", &parent, &child, &stamp, v, v + 1, v + 2, v + 3, v + 4, v + 5,
                                v + 6, &range, &version, &PyTuple_Type, &edges))
        return NULL;
    py_transform *t = allocate(m, (PyTypeObject *)cls, 0);
    if (!t) return NULL;
    t->parent = Py_NewRef(parent);
    t->child = Py_NewRef(child);
    t->edges = Py_NewRef(edges);
    t->version = version;
    t->pose = (shmtf_pose){v[0], v[1], v[2], v[3], v[4], v[5], v[6]};
    long long oldest = 0, newest = 0;
    bool ok = py_normalise(m, &t->pose) && set_times(m, t, stamp);
    if (ok && range != Py_None) {
        ok = PyTuple_Check(range) ? PyArg_ParseTuple(range, "LL", &oldest, &newest)
                                  : PyErr_Format(PyExc_TypeError, "stamp_range must be a tuple or None, not %R", range) != NULL;
        t->oldest_ns = oldest;
        t->newest_ns = newest;
        t->has_range = true;
    }
    if (ok) return (PyObject *)t;
    Py_DECREF(t);
    return NULL;
}

/* ---- getters ---- */

static PyObject *get_parent(PyObject *self, void *unused) {
    (void)unused;
    return Py_NewRef(((py_transform *)self)->parent);
}

static PyObject *get_child(PyObject *self, void *unused) {
    (void)unused;
    return Py_NewRef(((py_transform *)self)->child);
}

static PyObject *get_stamp(PyObject *self, void *unused) {
    (void)unused;
    py_transform *t = (py_transform *)self;
    return t->has_stamp ? PyLong_FromLongLong(t->stamp_ns) : Py_NewRef(Py_None);
}

static PyObject *get_stamp_range(PyObject *self, void *unused) {
    (void)unused;
    py_transform *t = (py_transform *)self;
    if (!t->has_range) return Py_NewRef(Py_None);
    return Py_BuildValue("(LL)", (long long)t->oldest_ns, (long long)t->newest_ns);
}

static PyObject *get_version(PyObject *self, void *unused) {
    (void)unused;
    py_transform *t = (py_transform *)self;
    return t->version ? PyLong_FromUnsignedLongLong(t->version) : Py_NewRef(Py_None);
}

static PyObject *name_edge(py_handle *h, const shmtf_edge *edge) {
    PyObject *parent = py_handle_name(h, edge->parent);
    PyObject *child = parent ? py_handle_name(h, edge->child) : NULL;
    if (!child) {
        Py_XDECREF(parent);
        return NULL;
    }
    if (edge->is_static) return Py_BuildValue("(NNO)", parent, child, Py_None);
    return Py_BuildValue("(NNL)", parent, child, (long long)edge->stamp_ns);
}

static PyObject *get_edges(PyObject *self, void *unused) {
    (void)unused;
    py_transform *t = (py_transform *)self;
    if (t->edges) return Py_NewRef(t->edges);
    PyObject *edges = PyTuple_New((Py_ssize_t)t->n_edges);
    for (uint32_t i = 0; edges && i < t->n_edges; i++) {
        PyObject *edge = name_edge(t->handle, &t->raw_edges[i]);
        if (!edge || PyTuple_SetItem(edges, (Py_ssize_t)i, edge) < 0) Py_CLEAR(edges);
    }
    if (!edges) return NULL;
    if (!t->edges) t->edges = Py_NewRef(edges);
    return edges;
}

static int transform_buffer(PyObject *self, Py_buffer *view, int flags) {
    static Py_ssize_t shape[1] = {7}, strides[1] = {sizeof(double)};
    if (PyBuffer_FillInfo(view, self, &((py_transform *)self)->pose, 7 * sizeof(double), 1, flags) < 0) return -1;
    view->itemsize = sizeof(double);
    if (flags & PyBUF_FORMAT) view->format = (char *)"d";
    if (flags & PyBUF_ND) view->shape = shape;
    if ((flags & PyBUF_STRIDES) == PyBUF_STRIDES) view->strides = strides;
    return 0;
}

/* ---- type ---- */

static PyMethodDef methods[] = {
    {"_compose", transform_compose, METH_O, compose_doc},
    {"_inverse", transform_inverse, METH_NOARGS, PyDoc_STR("_inverse($self)\n--\n\nT_child_parent.")},
    {"_values", transform_values, METH_NOARGS, PyDoc_STR("_values($self)\n--\n\n(x, y, z, qx, qy, qz, qw).")},
    {"_matrix_bytes", transform_matrix_bytes, METH_NOARGS, PyDoc_STR("_matrix_bytes($self)\n--\n\n16 doubles, row by row.")},
    {"_restore", transform_restore, METH_VARARGS | METH_CLASS, restore_doc},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef getters[] = {
    {"parent", get_parent, NULL, PyDoc_STR("Name of the frame that the pose is given in (str)."), NULL},
    {"child", get_child, NULL, PyDoc_STR("Name of the frame whose pose it is (str)."), NULL},
    {"stamp", get_stamp, NULL,
     PyDoc_STR("Time in int nanoseconds.  Of a lookup: the asked or common time, for latest the oldest stamp used.\n"
               "None: to be stamped when written, or the whole path is static."),
     NULL},
    {"stamp_range", get_stamp_range, NULL,
     PyDoc_STR("(oldest, newest) stamp used, int nanoseconds; None without a stamp."), NULL},
    {"version", get_version, NULL, PyDoc_STR("The commit that a lookup read (int); None for a transform made by hand."),
     NULL},
    {"edges", get_edges, NULL,
     PyDoc_STR("The records a lookup used: ((parent, child, stamp), ...), from the source up to the common ancestor and\n"
               "then the target's side.  stamp is None for a static edge, a name is None if that frame was removed before\n"
               "this was first read.  () for a transform made by hand."),
     NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

PyDoc_STRVAR(transform_doc,
             "Transform(parent, child, stamp=None, translation=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0, 1.0))\n--\n\n"
             "The data of shmtf.Transform.");

static PyType_Slot slots[] = {
    {Py_tp_doc, (void *)transform_doc}, {Py_tp_new, transform_new}, {Py_tp_dealloc, transform_dealloc},
    {Py_tp_methods, methods},           {Py_tp_getset, getters},    {Py_bf_getbuffer, transform_buffer},
    {0, NULL},
};

static PyType_Spec spec = {
    .name = "shmtf._core.Transform",
    .basicsize = sizeof(py_transform),
    .itemsize = sizeof(shmtf_edge),
    .flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_IMMUTABLETYPE,
    .slots = slots,
};

PyTypeObject *py_transform_type_new(PyObject *module) { return (PyTypeObject *)PyType_FromModuleAndSpec(module, &spec, NULL); }

PyObject *py_set_transform_type(PyObject *module, PyObject *type) {
    module_state *m = PyModule_GetState(module);
    PyObject *basicsize = PyObject_GetAttrString(type, "__basicsize__");
    bool fits = basicsize && PyType_Check(type) && PyType_IsSubtype((PyTypeObject *)type, m->transform_base) &&
                PyType_HasFeature((PyTypeObject *)type, Py_TPFLAGS_HAVE_GC) && /* as every class of Python's has */
                PyLong_AsLong(basicsize) == (long)sizeof(py_transform);
    Py_XDECREF(basicsize);
    if (!fits) return PyErr_Format(PyExc_TypeError, "not a Python subclass of Transform with empty __slots__: %R", type);
    PyTypeObject *old = m->transform_type;
    m->transform_type = (PyTypeObject *)Py_NewRef(type);
    Py_DECREF(old);
    return Py_NewRef(Py_None);
}
