"""A module imports only from rooms above it, and a heavy package has one home."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = """errors arrays paths lifetime cards hdf5 plant mesh solid solve elastic touch
estimation view datasets doctor demo cli""".split()
HOMES = {
    "gmsh": {"solid/gmsh_model.py"},
    "meshio": {"mesh/files.py"},
    "pyamg": {"solve/multigrid.py"},
    "skfem": {"elastic/stiffness.py"},
    "cvxpy": {"estimation/force_balance.py"},
    "h5py": {"hdf5.py"},
    "pyvista": {"view/scenes.py"},
    "trimesh": {"mesh/surfaces.py"},
    "viser": {"view/app.py"},
    "typer": {"cli"},  # a folder
    "rich": {"cli"},
    "manifold3d": {"solid/booleans.py"},
    "mmgpy": {"solid/remesh.py"},
    "pytetwild": {"solid/wild.py"},
    "vtkmodules": {"view/visibility.py"},
    "dask": {"datasets/cluster.py"},
    "distributed": {"datasets/cluster.py"},
}
FILES = sorted((ROOT / "plantsim").rglob("*.py"))


def imports(path):
    """Yield the full names of the modules that a file imports at run time, at any depth."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    hints = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for inner in ast.walk(node)
    }
    # the only calls that go up: values have .plot(), one lazy door to the room that draws
    doors = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and node.name == "plot"
        for inner in ast.walk(node)
        if isinstance(inner, ast.ImportFrom)
        and str(inner.module).startswith("plantsim.view.")
    }
    for node in ast.walk(tree):
        if id(node) in hints or id(node) in doors:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def room(name):
    """Return the room of a module name such as plantsim.mesh.files, or None."""
    parts = name.split(".")
    return parts[1] if parts[0] == "plantsim" and len(parts) > 1 else None


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT / "plantsim")))
def test_arrows_point_up(path):
    inside = path.relative_to(ROOT / "plantsim")
    if str(inside) in ("__init__.py", "__main__.py"):
        return
    own = inside.parts[0].removesuffix(".py")
    assert own in ROOMS, f"{inside} is in no room of the house"
    for name in imports(path):
        other = room(name)
        if other in ROOMS:
            assert ROOMS.index(other) <= ROOMS.index(own), f"{inside} imports {name}"
        package = name.split(".")[0]
        if package in HOMES:
            homes = HOMES[package]
            assert {str(inside), inside.parts[0]} & homes, f"{inside} imports {package}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT / "plantsim")))
def test_files_stay_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 420


def test_import_is_light():
    code = (
        "import sys, plantsim; heavy = set(sys.modules) & set("
        "'gmsh meshio pyamg skfem cvxpy h5py pyvista vtk viser typer matplotlib '"
        "'trimesh distributed'.split()); "
        "assert not heavy, heavy; assert 'weber_penn' in dir(plantsim)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_every_public_name_resolves():
    code = (
        "import plantsim as ps\n"
        "for name in ps.__all__: getattr(ps, name)\n"
        "assert callable(ps.estimate) and callable(ps.force) and callable(ps.move)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
