"""What of the environment is there, what is missing, and how to mend it."""

import importlib.metadata
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from plantsim.view.probe import loads, why_not_drawn

# shared library -> Debian package; gmsh's wheel brings none of these
GMSH_LIBRARIES = {
    "libGLU.so.1": "libglu1-mesa",
    "libXcursor.so.1": "libxcursor1",
    "libXft.so.2": "libxft2",
    "libXinerama.so.1": "libxinerama1",
    "libXfixes.so.3": "libxfixes3",
    "libGL.so.1": "libgl1",
    "libgomp.so.1": "libgomp1",
}
DRAWING_LIBRARIES = {"libEGL.so.1": "libegl1"}
DRIVERS = ("*/dri/swrast_dri.so", "*/libgallium*.so")  # what Mesa draws with, by version
DRIVER_PACKAGE = "libgl1-mesa-dri"
CORE = ("numpy", "scipy", "scikit-fem", "gmsh", "meshio", "pyamg", "cvxpy", "typer")
EXTRAS = {
    "view": ("pyvista", "matplotlib", "viser", "imageio", "imageio-ffmpeg"),
    "io": ("h5py", "trimesh"),
    "fast": ("pypardiso", "manifold3d", "mmgpy", "pytetwild"),
    "docs": ("mkdocs-material", "mkdocstrings", "latex2mathml", "nbclient", "ipykernel"),
    "scale": ("distributed", "h5py"),
}


@dataclass(frozen=True)
class Check:
    """One line of the doctor's report."""

    name: str
    found: str
    mend: str = ""  # empty where all is well
    needed: bool = True  # whether plantsim cannot do its main job without


def missing_packages() -> list[str]:
    """Return the Debian packages that gmsh and drawing need and that are missing."""
    missing = [
        package
        for library, package in (GMSH_LIBRARIES | DRAWING_LIBRARIES).items()
        if not loads(library)
    ]
    if not any(
        any(Path(lib).glob(form)) for lib in ("/usr/lib", "/lib") for form in DRIVERS
    ):
        missing.append(DRIVER_PACKAGE)
    return missing


def examine() -> Iterator[Check]:
    """Yield the checks one by one; the last, a trial picture, takes a second or two."""
    version = sys.version.split()[0]
    old = sys.version_info < (3, 11)
    yield Check("python", version, "install Python 3.11 or newer" if old else "")
    for name in CORE:
        found = _version(name)
        yield Check(name, found or "missing", "" if found else f"pip install {name}")
    missing = missing_packages()
    for library, package in GMSH_LIBRARIES.items():
        gone = package in missing
        mend = f"apt-get install {package}" if gone else ""
        yield Check(library, "missing" if gone else "there", mend)
    broken = _gmsh_broken()
    yield Check("gmsh starts", broken or "yes", "see the lines above" if broken else "")
    for extra, names in EXTRAS.items():
        lacking = [name for name in names if _version(name) is None]
        mend = f"pip install 'plantsim[{extra}]'" if lacking else ""
        found = f"without {', '.join(lacking)}" if lacking else "there"
        yield Check(f"extra {extra}", found, mend, needed=False)
    yield Check("CPU threads", str(len(os.sched_getaffinity(0))), needed=False)
    reason = why_not_drawn()
    text, _, mend = (reason or "").partition(". Run: ")
    yield Check("off-screen pictures", text or "drawn", mend or text, needed=False)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _gmsh_broken() -> str | None:
    """Return why gmsh does not start, found out in a child process, or None."""
    child = subprocess.run(
        [sys.executable, "-c", "import gmsh; gmsh.initialize(interruptible=False)"],
        capture_output=True,
        timeout=60,
        check=False,
    )
    if child.returncode == 0:
        return None
    lines = child.stderr.decode(errors="replace").strip().splitlines()
    return lines[-1][:120] if lines else f"exit {child.returncode}"
