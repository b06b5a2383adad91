"""How long a newcomer waits: from `git clone` to a plant that is dragged.

    python benchmarks/newcomer.py [--out DIR] [--port 8123]

Clones HEAD into a folder of its own, runs `./run demo` until its picture is there, then
`./run view`; a headless Chromium opens the page, clicks a green pixel of a limb, pulls
the arrow that appears there, and waits until the page tells of a force. Prints the seconds
since the clone began, and keeps the demo's picture and three screenshots in DIR. Needs
playwright and chromium, which its time does not count.
"""

import argparse
import contextlib
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.image import imread

ROOT = Path(__file__).resolve().parent.parent
WANTED = 300.0  # [s] to a plant that is dragged
LONGEST = 900.0  # [s] to wait for any one thing
FLAGS = "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
RED, GREEN, BLUE = 0, 1, 2


def until(happens, what: str):
    """Return what `happens()` gives once it is true."""
    end = time.monotonic() + LONGEST
    while not (found := happens()):
        if time.monotonic() > end:
            raise TimeoutError(f"{what}: not within {LONGEST:.0f} s")
        time.sleep(0.1)
    return found


def picture(page) -> np.ndarray:
    """Return a screenshot (h, w, 3), 0 to 1."""
    return imread(io.BytesIO(page.screenshot()))[:, :, :3]


def coloured(image: np.ndarray, strong: int, by: float) -> np.ndarray:
    """Return pixels (k, 2), x and y, in which one channel is above both others."""
    others = np.delete(image, strong, axis=2).max(axis=2)
    y, x = np.nonzero(image[:, :, strong] > others + by)
    return np.column_stack([x, y])


def twig(image: np.ndarray) -> np.ndarray:
    """Return a pixel of the plant, far from its trunk and in the midst of its green."""
    green = coloured(image, GREEN, 0.06)
    green = green[green[:, 0] < 0.6 * image.shape[1]]  # what is right of it are controls
    if len(green) < 50:
        raise RuntimeError("no plant on the page")
    aside = np.abs(green[:, 0] - np.median(green[:, 0]))
    far = green[aside > 0.5 * aside.max()]
    around = [(np.abs(far - p).max(axis=1) <= 4).sum() for p in far]
    return far[int(np.argmax(around))]


def newtons(page) -> float:
    """Return the force that the page tells, 0 where it tells none."""
    found = re.search(r"([\d.,e+-]+) N for", page.inner_text("body"))
    return float(found[1].replace(",", "")) if found else 0.0


def pulled(page, at: np.ndarray) -> None:
    """Pull the arrow that points up from a pixel, as a hand would: look, grip, pull."""
    for _ in range(5):
        blue = coloured(picture(page), BLUE, 0.3)  # the upright arrow is blue
        blue = blue[np.abs(blue - at).max(axis=1) < 150]
        if len(blue):
            grip = np.median(blue, axis=0)
            page.mouse.move(*map(float, grip + 1))
            page.mouse.move(*map(float, grip))
            page.wait_for_timeout(500)  # until it lights up
            page.mouse.down()
            for k in range(10):
                page.mouse.move(float(grip[0]), float(grip[1] + 4 * k))
            page.wait_for_timeout(300)
            if newtons(page) > 0:
                return
            page.mouse.up()
        page.wait_for_timeout(300)
    raise RuntimeError("the arrow could not be pulled")


@contextlib.contextmanager
def viewing(folder: Path, port: int) -> Iterator[None]:
    """Keep `./run view` going, and end it."""
    command = ["./run", "view", "--port", str(port)]
    with (folder / "view.log").open("w") as log:
        child = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)
        try:
            ready = f":{port} ("
            until(
                lambda: (
                    ready in (folder / "view.log").read_text() or child.poll() is not None
                ),
                "the viewer's address",
            )
            if child.poll() is not None:
                raise RuntimeError((folder / "view.log").read_text())
            yield
        finally:
            child.send_signal(signal.SIGINT)
            child.wait(timeout=60)


def main(out: Path, port: int) -> None:
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    out.mkdir(parents=True, exist_ok=True)
    rows: list[tuple[str, float]] = []
    with tempfile.TemporaryDirectory() as home, sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=FLAGS.split())
        folder = Path(home) / "plantsim"
        began = time.monotonic()

        def done(what: str) -> None:
            rows.append((what, time.monotonic() - began))
            print(f"{rows[-1][1]:6.1f} s: {what}", file=sys.stderr, flush=True)

        environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
        os.environ.clear()
        os.environ.update(environment)
        subprocess.run(["git", "clone", "-q", str(ROOT), str(folder)], check=True)
        done("cloned")
        demo = subprocess.Popen(["./run", "demo"], cwd=folder, stdout=subprocess.DEVNULL)
        drawn = until(
            lambda: next(folder.glob("demo/[!.]*.png"), None) or demo.poll(), "the picture"
        )
        done("the demo's picture")
        if demo.wait() or not isinstance(drawn, Path):
            raise RuntimeError(f"./run demo ended by {demo.returncode}")
        done("the demo has ended")
        shutil.copy(drawn, out / "demo.png")
        with viewing(folder, port):
            done("`./run view` tells its address")
            page = browser.new_page(viewport={"width": 900, "height": 600})
            page.set_default_timeout(1e3 * LONGEST)
            page.goto(f"http://127.0.0.1:{port}")
            page.get_by_text("Let go").wait_for()
            page.add_style_tag(content=".mantine-Notifications-root { display: none }")
            until(lambda: len(coloured(picture(page), GREEN, 0.06)) > 200, "a plant")
            done("a plant on the page")
            page.screenshot(path=out / "page.png")
            at = twig(picture(page))
            page.mouse.click(*map(float, at))
            page.get_by_text("6 vertices").wait_for()
            done("taken hold of")
            page.screenshot(path=out / "held.png")
            pulled(page, at)
            done(f"dragged: {newtons(page):.3g} N")
            page.screenshot(path=out / "dragged.png")
            page.mouse.up()
        browser.close()
    print("| since `git clone` | s |\n|---|---|")
    for what, seconds in rows:
        print(f"| {what} | {seconds:.0f} |")
    print(f"\nwithin {WANTED:.0f} s: {'yes' if rows[-1][1] < WANTED else 'no'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, default=Path("newcomer"))
    parser.add_argument("--port", type=int, default=8123)
    options = parser.parse_args()
    main(options.out, options.port)
