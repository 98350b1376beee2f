# SPDX-License-Identifier: Apache-2.0
"""The package: its names, its import, its types."""

from __future__ import annotations

import ast
import contextlib
import importlib.metadata
import inspect
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import shmtf
from shmtf import _core

PACKAGE = Path(shmtf.__file__).parent
PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"


def test_names() -> None:
    assert shmtf.__all__ == sorted(set(shmtf.__all__))
    for name in shmtf.__all__:
        assert getattr(shmtf, name) is not None
    assert set(shmtf.__all__) <= set(dir(shmtf))
    with pytest.raises(AttributeError, match="nonsense"):
        shmtf.nonsense  # noqa: B018


def test_type_checkers_see_the_same_names() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    imported = {alias.name for node in block.body for alias in node.names}
    assert imported | {"__version__"} == set(shmtf.__all__)
    assert (PACKAGE / "py.typed").exists()


@pytest.mark.skipif(not PROJECT.exists(), reason="tests away from the source tree")
def test_versions_agree() -> None:
    assert shmtf.__version__ == shmtf._core.__version__
    declared = re.search(r'^version = "(.*?)"', PROJECT.read_text(), re.M)
    assert declared is not None
    assert declared.group(1) == shmtf.__version__
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        assert importlib.metadata.version("shmtf") == shmtf.__version__


def test_import_is_cheap_and_quiet(run_python: Callable) -> None:
    done = run_python(
        """
        import os, sys, threading
        before = dict(os.environ)
        import shmtf
        assert "numpy" not in sys.modules
        shmtf.Store, shmtf.Transform, shmtf.LookupException, shmtf.list_stores
        assert "numpy" in sys.modules
        for name in ("asyncio", "rich", "scipy", "zenoh", "yaml", "psutil", "multiprocessing", "argparse"):
            assert name not in sys.modules, name
        assert threading.active_count() == 1
        assert dict(os.environ) == before
        """
    )
    assert done.stdout == done.stderr == ""


def test_star_import(run_python: Callable) -> None:
    run_python("from shmtf import *; assert Store and Transform and BusyError and now()")


def import_from(folder: Path) -> str:
    """A program that imports the package from this folder, even where an editable install has a finder of its own."""
    return f"""
        import sys
        sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__]
        sys.path.insert(0, {str(folder)!r})
        import shmtf
    """


def test_a_source_tree_that_hides_the_package(tmp_path: Path, run_python: Callable) -> None:
    copy = tmp_path / "shmtf"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("*.so", "__pycache__", "cli", "compat"))
    done = run_python(import_from(tmp_path), check=False)
    assert done.returncode != 0
    for part in ("ImportError", str(copy), "pip install -e ."):
        assert part in done.stderr


def test_a_core_of_another_version(tmp_path: Path, run_python: Callable) -> None:
    copy = tmp_path / "shmtf"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__", "cli", "compat"))
    text = (copy / "__init__.py").read_text()
    (copy / "__init__.py").write_text(text.replace(f'__version__ = "{shmtf.__version__}"', '__version__ = "99.0.0"'))
    shutil.copy(_core.__file__, copy)
    done = run_python(import_from(tmp_path), check=False)
    for part in ("ImportError", "99.0.0", shmtf.__version__, "install"):
        assert part in done.stderr


# ---- the stub ----


def stub_members(cls: ast.ClassDef) -> dict[str, ast.FunctionDef]:
    return {node.name: node for node in cls.body if isinstance(node, ast.FunctionDef)}


STUB = ast.parse((PACKAGE / "_core.pyi").read_text())
CLASSES = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}


def test_the_stub_has_what_the_core_has() -> None:
    functions = {node.name for node in STUB.body if isinstance(node, ast.FunctionDef)}
    real = {name for name in dir(shmtf._core) if not name.startswith("__")}
    assert functions | set(CLASSES) == real


@pytest.mark.parametrize("name", CLASSES)
def test_the_stub_has_every_member(name: str) -> None:
    cls = getattr(shmtf._core, name)
    ignored = {"__doc__", "__module__", "__new__", "__buffer__", "__getattribute__"}
    assert set(vars(cls)) - ignored == set(stub_members(CLASSES[name])) - ignored


@pytest.mark.parametrize("name", CLASSES)
def test_the_stub_has_the_same_arguments(name: str) -> None:
    """Names, kinds and defaults, against the signatures that the C docstrings give."""
    cls = getattr(shmtf._core, name)
    for method, node in stub_members(CLASSES[name]).items():
        member = vars(cls).get(method)
        if method.startswith("__") or member is None or inspect.isgetsetdescriptor(member) or not node.args.args[1:]:
            continue
        real = inspect.signature(getattr(cls, method))
        names = [
            a.arg for a in node.args.args + node.args.posonlyargs + node.args.kwonlyargs if a.arg not in ("self", "cls")
        ]
        assert [p for p in real.parameters if p not in ("self", "cls")] == names, method
        written = [ast.literal_eval(d) for d in [*node.args.defaults, *filter(None, node.args.kw_defaults)]]
        defaults = [p.default for p in real.parameters.values() if p.default is not inspect.Parameter.empty]
        assert defaults == written, method


def test_public_methods_have_docstrings() -> None:
    for cls in (shmtf.Store, shmtf.Snapshot, shmtf.Transform):
        for name in dir(cls):
            if not name.startswith("_"):
                assert inspect.getdoc(getattr(cls, name)), f"{cls.__name__}.{name}"


def test_public_signatures() -> None:
    """The argument orders that programs rely on."""
    expected = {
        "set_transform": "(transform, *, static=False, authority=None, timeout=1.0, priority=False)",
        "set_transforms": "(transforms, *, static=False, authority=None, timeout=1.0, priority=False)",
        "lookup_transform": "(target, source, time=None, timeout=0.0)",
        "lookup_latest_transform": "(target, source, timeout=0.0)",
        "can_transform": "(target, source, time=None, timeout=0.0)",
        "clear": "(keep_static=True, *, authority=None, timeout=1.0, priority=False)",
        "parent": "(name, time=None)",
    }
    for name, text in expected.items():
        signature = inspect.signature(getattr(shmtf.Store, name))
        assert str(signature.replace(parameters=list(signature.parameters.values())[1:])) == text
    attach = inspect.signature(shmtf.Store.attach)
    assert list(attach.parameters) == ["name", "readonly", "timeout", "authority"]
    assert list(inspect.signature(shmtf.Store.create).parameters)[:8] == [
        "name", "max_frames", "history", "cache_time", "stream_bytes", "mode", "exist_ok", "authority",
    ]  # fmt: skip


def test_no_environment_is_read() -> None:
    for file in PACKAGE.glob("*.py"):
        assert "environ" not in file.read_text(), file
    assert os.path.isdir(PACKAGE)
