"""A C extension for Python, compiled by the SDK of a board."""

from __future__ import annotations

import subprocess
import tarfile
from pathlib import Path

import pytest

from evbotos.hosttools import find_tool
from evbotos.model import Platform
from evbotos.sdk_command import sdk
from evbotos.targets import TARGETS

MODULE = """\
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>

static PyObject *distance(PyObject *self, PyObject *arguments)
{
    double x, y;
    if (!PyArg_ParseTuple(arguments, "dd", &x, &y))
        return NULL;
    return PyFloat_FromDouble(hypot(x, y));
}

static PyMethodDef methods[] = {{"distance", distance, METH_VARARGS, "of a point"}, {NULL}};
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "odometer", NULL, -1, methods};

PyMODINIT_FUNC PyInit_odometer(void)
{
    return PyModule_Create(&module);
}
"""


def built_module(platform: Platform, folder: Path) -> Path:
    """Make the SDK of a board in a folder, compile the module with it, and return the module's file."""
    target = TARGETS[platform.architecture]
    if find_tool(f"{target.compiler}gcc") is None:
        pytest.skip(f"{target.package} is not installed")
    sdk(platform.name, output=folder)
    with tarfile.open(folder / f"evbotos-sdk-{platform.name}.tar.xz") as archive:
        archive.extractall(folder, filter="tar")
    (folder / "odometer.c").write_text(MODULE)
    compile_ = "$CC $CFLAGS -shared -fPIC $PYTHON_CFLAGS odometer.c -o odometer$PYTHON_EXT_SUFFIX $LDFLAGS -lm"
    script = f"export EVBOTOS_SDK=$PWD/evbotos-sdk-{platform.name}; . $EVBOTOS_SDK/environment && {compile_}"
    subprocess.run(["sh", "-c", script], cwd=folder, check=True)
    (module,) = folder.glob(f"odometer.cpython-3*-{target.multiarch}.so")
    return module
