"""The site builds without a warning; the gallery's scripts and the notebooks run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import plantsim as ps
from plantsim.view import probe

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = sorted((ROOT / "docs" / "gallery").glob("*.py"))
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
PATH = os.environ | {"PYTHONPATH": str(ROOT)}


def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocstrings", reason="pip install plantsim[docs]")
    pytest.importorskip("material", reason="pip install plantsim[docs]")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path)],
        cwd=ROOT,
        env=PATH,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for page in (ROOT / "docs").glob("*.md"):
        home = tmp_path if page.stem == "index" else tmp_path / page.stem
        assert (home / "index.html").stat().st_size > 0
    api = (tmp_path / "api" / "index.html").read_text(encoding="utf-8")
    for name in {*ps.__all__, "Viewer"} - {"__version__"}:
        assert re.search(rf'id="plantsim[\w.]*\.{name}"', api), (
            f"{name} is not on the API page"
        )


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_the_gallery_runs(script, tmp_path):
    if probe.why_not_drawn():
        pytest.skip(probe.why_not_drawn())
    subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=PATH, check=True, timeout=300
    )
    made = {p.name for p in tmp_path.iterdir() if p.stat().st_size > 0}
    shown = {p.name for p in (ROOT / "docs" / "pictures" / "gallery").iterdir()}
    assert made
    assert made <= shown, "make the gallery anew: python docs/make_gallery.py"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_the_notebook_runs(path, tmp_path):
    nbclient = pytest.importorskip("nbclient", reason="pip install plantsim[dev]")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    if probe.why_not_drawn():
        pytest.skip(probe.why_not_drawn())
    book = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") for cell in book.cells), "clear its outputs"
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = str(ROOT)
    try:
        nbclient.NotebookClient(
            book, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
        ).execute()
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before
    outputs = [out for cell in book.cells for out in cell.get("outputs", ())]
    assert any("image/png;base64" in str(out) for out in outputs)  # pictures show
