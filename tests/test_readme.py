"""The code and the commands of README and docs run; what they link to is there."""

import os
import re
import shlex
import signal
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

import plantsim as ps

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
DRAWN_BY = {"./run test", "./run docs"}  # this very run; tests/test_docs.py
CLUSTER = "tcp://HOST"  # needs other machines; tests/test_dataset_faults.py has a cluster
FENCE = re.compile(r"^```[^\n]*\n.*?^```[^\n]*$", re.M | re.S)


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)


def commands(page):
    """Return the lines of a page's shell blocks, fenced or indented, without comments."""
    text = page.read_text("utf-8")
    shell = "\n".join(blocks(page, "sh"))
    indented = re.findall(r"(?:(?<=\n\n)|^)((?:    \S.*\n)+)", FENCE.sub("", text))
    lines = [
        line.split(" #")[0].strip()
        for line in (shell + "\n" + "".join(indented)).splitlines()
    ]
    return [line for line in lines if line and not line.startswith("Skeleton ->")]


def run(command, folder):
    """Run a command of a page as a reader would type it; return what it printed."""
    words = shlex.split(command)
    assert words[0] in ("plantsim", "./run"), command
    begin = [sys.executable, "-m", "plantsim"]
    if words[1] == "view" and "--help" not in words:
        return seen(begin, words[1:], folder)
    done = subprocess.run(
        begin + words[1:],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, f"{command}: {done.stderr}"
    return done.stdout


def seen(begin, words, folder):
    """Run the viewer until it says where it is, then stop it."""
    child = subprocess.Popen(
        [*begin, *words, "--port", "0"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1", "BROWSER": "true"},
    )
    try:
        line = ""
        while "Ctrl-C" not in line:
            line = child.stdout.readline()
            assert line, child.stderr.read()
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=60)
        assert child.returncode == 0, err
    finally:
        child.kill()
    return out


CODED = [page for page in PAGES if blocks(page, "python")]


@pytest.mark.parametrize("page", CODED, ids=lambda page: page.name)
def test_python_of_the_page_runs(page, tmp_path):
    code = "\n".join(blocks(page, "python"))
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


TYPED = [page for page in PAGES if commands(page) and page.name != "datasets.md"]


@pytest.mark.parametrize("page", TYPED, ids=lambda page: page.name)
def test_commands_of_the_page_run(page, tmp_path):
    lines = [line for line in commands(page) if line not in DRAWN_BY]
    fork = ps.tetrahedralize(ps.sweep(ps.fork(0.4, 0.02)), order=1)
    ps.write_mesh(fork, tmp_path / "plant.msh")  # the reader's own
    for script in re.findall(
        r'Path\("(\S+\.geo)"\)\.write_text\("""(.*?)"""', page.read_text(), re.S
    ):
        (tmp_path / script[0]).write_text(script[1])  # made by the page's Python
    for line in lines:
        if "COMMAND" in line:
            for name in re.findall(r"^\| `(\w+)` \|", page.read_text("utf-8"), re.M):
                assert f"plantsim {name}" in run(line.replace("COMMAND", name), tmp_path)
        else:
            run(line, tmp_path)


def test_commands_of_data_sets_run(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="pip install plantsim[scale]")
    page = ROOT / "docs" / "datasets.md"
    lines = [line for line in commands(page) if line.startswith("plantsim")]
    assert len(lines) == 5
    for line in lines:
        if CLUSTER in line:
            continue
        run(line, tmp_path)
        if "--example" in line:  # one strawberry, not two hundred plants of all kinds
            recipe = tmp_path / "recipe.toml"
            head, kinds = recipe.read_text().split("[[species]]", 1)
            own = next(k for k in kinds.split("[[species]]") if '"strawberry"' in k)
            head = re.sub(r"^plants = \d+", "plants = 2", head, flags=re.M)
            recipe.write_text(f"{head}[[species]]{own}")
    assert (tmp_path / "plants" / "summary.html").exists()
    # torch's part in the adapter is a name to inherit from and one conversion
    torch = types.SimpleNamespace(
        utils=types.SimpleNamespace(data=types.SimpleNamespace(Dataset=object)),
        as_tensor=np.asarray,
    )
    monkeypatch.setitem(sys.modules, "torch", torch)
    (adapter,) = blocks(page, "py")
    room = {}
    exec(adapter, room)
    count = 0
    for split in ("train", "validation", "test"):
        touches = room["Touches"](tmp_path / "plants", split)
        count += len(touches)
        for i in range(len(touches)):
            one = touches[i]
            assert one["touches/force"].shape[-1] == 3
    assert count > 0


def test_no_block_is_left_out():
    """Every fenced block is Python, a shell's, the torch adapter, or a gallery's script."""
    for page in PAGES:
        for kind in re.findall(r"^```(\S[^\n]*)\n", page.read_text("utf-8"), re.M):
            where = f"{page.name}: {kind}"
            if kind == "py":
                assert page.name == "datasets.md", where
            elif "noexec" in kind:
                assert page.name == "gallery.md", where  # tests/test_docs.py runs them
            else:
                assert kind in ("python", "sh"), where
        for line in commands(page):
            cluster = page.name == "datasets.md" and line.startswith("dask ")
            assert cluster or line.startswith(("plantsim ", "./run ")), (page.name, line)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
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
