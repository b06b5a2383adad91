"""Whether pictures can be drawn, tried in a child: VTK crashes where they cannot."""

import ctypes
import importlib.util
import os
import subprocess
import sys
from functools import cache

_DRAW = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
plotter.add_mesh(pyvista.Sphere(), color="red")
image = plotter.screenshot(None, return_img=True)
raise SystemExit(0 if image.std() > 1 else 3)
"""


def loads(library: str) -> bool:
    """Return whether the dynamic loader finds a shared library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def choose_window() -> None:
    """Without a display, tell VTK which window to open, so that it is silent on X."""
    if not os.environ.get("DISPLAY"):
        kind = "vtkEGLRenderWindow" if loads("libEGL.so.1") else "vtkOSOpenGLRenderWindow"
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", kind)


@cache
def why_not_drawn() -> str | None:
    """Return None if off-screen pictures can be drawn, else the reason and what to do."""
    if importlib.util.find_spec("pyvista") is None:
        return "pyvista is not installed. Run: pip install 'plantsim[view]'"
    if not any(map(loads, ("libEGL.so.1", "libOSMesa.so.8"))) and not os.environ.get(
        "DISPLAY"
    ):
        return (
            "neither libEGL nor libOSMesa is on this machine. Run: apt-get install libegl1 "
            "libgl1-mesa-dri"
        )
    choose_window()
    try:
        child = subprocess.run(
            [sys.executable, "-c", _DRAW], capture_output=True, timeout=120, check=False
        )
    except subprocess.TimeoutExpired:
        return (
            "a trial picture took over 120 s. Run: apt-get install libegl1 libgl1-mesa-dri"
        )
    if child.returncode:
        last = child.stderr.decode(errors="replace").strip().splitlines()[-1:]
        return (
            f"a trial picture failed (exit {child.returncode}: {' '.join(last)[:200]}). "
            "Run: apt-get install libegl1 libgl1-mesa-dri"
        )
    return None
