"""Who may import whom (DESIGN: one direction, heavy libraries in one module each)."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import page_runtime

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "page_runtime": ROOT / "runtime" / "page_runtime",
    "page_training": ROOT / "export" / "page_training",
    "page_export": ROOT / "export" / "page_export",
    "page_calibration": ROOT / "calibration" / "page_calibration",
}
MAY_IMPORT = {
    "page_runtime": set(),
    "page_training": {"page_runtime"},
    "page_export": {"page_training", "page_runtime"},
    "page_calibration": {"page_runtime"},
}
HEAVY = {
    "torch", "onnx", "onnxscript", "open3d", "depthai", "rosbags", "mcap", "mcap_protobuf", "rerun", "distributed",
    "dask",
}  # fmt: skip
ONLY_IMPORTER = {
    "onnxruntime": "sessions.py",
    "depthai": "capture/oak.py",
    "rerun": "sinks/rerun_log.py",
    "distributed": "validation/cluster.py",
}
ONLY_IMPORTER_OF_TRAINING = {
    "open3d": "scenes/render.py",
    "trimesh": "own/surfaces.py",
    "yourdfpy": "own/surfaces.py",
    "fast_simplification": "own/surfaces.py",
}
FOLDERS = {"runtime", "export", "calibration"}


def modules(package: str) -> list[Path]:
    return sorted(PACKAGES[package].rglob("*.py"))


def imported(tree: ast.AST, *, at_import_time: bool) -> Iterator[str]:
    """Top-level names of imported packages; at_import_time leaves out what only a call or a type checker would load."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]
        elif at_import_time and is_loaded_later(node):
            continue
        yield from imported(node, at_import_time=at_import_time)


def is_loaded_later(node: ast.AST) -> bool:
    is_for_checkers = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
    return is_for_checkers or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)


def names_imported(path: Path, *, at_import_time: bool = False) -> set[str]:
    return set(imported(ast.parse(path.read_text(encoding="utf-8")), at_import_time=at_import_time))


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_packages_import_each_other_in_one_direction_only(package: str) -> None:
    forbidden = set(PACKAGES) - MAY_IMPORT[package] - {package}
    for path in modules(package):
        assert not names_imported(path) & forbidden, path


def test_the_runtime_loads_no_heavy_library_when_it_is_imported() -> None:
    for path in modules("page_runtime"):
        assert not names_imported(path, at_import_time=True) & HEAVY, path


@pytest.mark.parametrize("library", sorted(ONLY_IMPORTER))
def test_a_library_of_the_runtime_has_one_importer(library: str) -> None:
    importers = {
        path.relative_to(PACKAGES["page_runtime"]).as_posix()
        for path in modules("page_runtime")
        if library in names_imported(path)
    }
    assert importers <= {ONLY_IMPORTER[library]}


@pytest.mark.parametrize("library", sorted(ONLY_IMPORTER_OF_TRAINING))
def test_a_library_of_the_scenes_has_one_importer(library: str) -> None:
    importers = {
        path.relative_to(PACKAGES["page_training"]).as_posix()
        for path in modules("page_training")
        if library in names_imported(path)
    }
    assert importers == {ONLY_IMPORTER_OF_TRAINING[library]}


def test_no_module_is_imported_by_its_folder() -> None:
    for package in PACKAGES:
        for path in modules(package):
            assert not names_imported(path) & FOLDERS, path


def run_python(code: str) -> str:
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return result.stdout.strip()


def test_importing_all_of_the_runtime_loads_neither_a_heavy_library_nor_the_workshop() -> None:
    names = [
        module.name
        for module in pkgutil.walk_packages(page_runtime.__path__, "page_runtime.")
        if not module.name.endswith("__main__")
    ]
    assert len(names) > 20
    code = (
        f"import importlib, sys\nfor name in {['page_runtime', *names]!r}: importlib.import_module(name)\n"
        f"print(*sorted({(HEAVY | set(PACKAGES)) - {'page_runtime'}!r} & set(sys.modules)))"
    )
    assert run_python(code) == ""


def test_the_command_line_parses_before_anything_large_is_loaded() -> None:
    code = "import sys, page_runtime.cli\nprint(*sorted({'numpy', 'cv2', 'onnxruntime'} & set(sys.modules)))"
    assert run_python(code) == ""


def test_every_public_name_is_where_the_package_says() -> None:
    for name in page_runtime.__all__:
        assert getattr(page_runtime, name) is not None
    assert set(dir(page_runtime)) == set(page_runtime.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        page_runtime.nonsense  # noqa: B018
    assert importlib.import_module("page_runtime.pose").NotSeen is page_runtime.NotSeen
