"""The site builds without a warning; the gallery's scripts and the notebooks run."""

import json
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


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built strictly; it runs the notebooks."""
    for package in ("mkdocstrings", "material", "nbclient", "ipykernel", "latex2mathml"):
        pytest.importorskip(package, reason="pip install plantsim[docs]")
    if probe.why_not_drawn():
        pytest.skip(probe.why_not_drawn())
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)],
        cwd=ROOT,
        env=PATH | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


def test_the_site_has_every_page_and_name(site):
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix("")
        home = site if page.stem == "index" else site / name
        assert (home / "index.html").stat().st_size > 0
    api = (site / "api" / "index.html").read_text(encoding="utf-8")
    for name in {*ps.__all__, "Viewer"} - {"__version__"}:
        assert re.search(rf'id="plantsim[\w.]*\.{name}"', api), (
            f"{name} is not on the API page"
        )


def test_formulas_are_maths_and_nothing_comes_from_elsewhere(site):
    count = 0
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert "arithmatex" not in text, page
        assert not re.search(r'<(script|img|link)[^>]*(src|href)="https?://', text), page
        count += text.count("<math")
    assert count > 30
    for link in ("skeleton", "tetmesh", "elasticmodel", "equilibrium", "estimate"):
        assert "<math" in (site / "chain" / link / "index.html").read_text("utf-8")


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


def test_there_are_three_notebooks():
    assert len(NOTEBOOKS) == 3


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_the_notebook_ran_and_is_a_page(path, site):
    book = json.loads(path.read_text(encoding="utf-8"))
    assert all(not cell.get("outputs") for cell in book["cells"]), "clear its outputs"
    page = (site / "notebooks" / path.stem / "index.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64") >= 1  # pictures show
    assert 'class="output"' in page
    assert "Traceback" not in page
    assert str(ROOT) not in page
    for cell in book["cells"]:  # every cell is there
        first = "".join(cell["source"]).strip().splitlines()[0].lstrip("# ")
        words = re.findall(r"[a-z_]{4,}", first)
        assert all(word in page for word in words), first
    index = (site / "notebooks" / "index.html").read_text(encoding="utf-8")
    assert f'href="{path.stem}/"' in index
