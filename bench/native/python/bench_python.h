/* SPDX-License-Identifier: Apache-2.0
 *
 * The extension shmtf._bench: a table and conversions over the benchmarks in C.
 */
#ifndef SHMTF_BENCH_PYTHON_H
#define SHMTF_BENCH_PYTHON_H

#ifndef Py_LIMITED_API
#include <pyconfig.h>
#ifndef Py_GIL_DISABLED /* has no stable ABI yet */
#define Py_LIMITED_API 0x030B0000
#endif
#endif
#define PY_SSIZE_T_CLEAN
#include <Python.h>

/* The type Control, a new reference. */
PyObject *bench_control_type_new(PyObject *module);

#endif
