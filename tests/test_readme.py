"""The README's code runs, and what it links to is there."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_python_of_the_page_runs(page, tmp_path):
    code = "\n".join(blocks(page, "python"))
    if not code:
        pytest.skip(f"no Python in {page.name}")
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    if page.name == "README.md":
        assert (tmp_path / "plant.msh").exists()
        found = re.search(r"\{'0': ([\d.]+), '1': ([\d.]+), '2': ([\d.]+)\}", done.stdout)
        assert found is not None
        assert [round(float(x) / 1e9, 3) for x in found.groups()] == [6, 8, 4]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)", page.read_text("utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_the_two_commands_are_the_readme_s(tmp_path):
    text = "\n".join(blocks(ROOT / "README.md", "sh"))
    assert "./run demo" in text
    assert "./run test" in text
    usage = subprocess.run([ROOT / "run"], capture_output=True, text=True, check=False)
    assert usage.returncode == 2
    assert "demo" in usage.stderr
