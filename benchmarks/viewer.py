"""What a frame of the live viewer costs on the side that computes.

    python benchmarks/viewer.py [--quick] [--browser] [--size 900x600]
        [--ratio 0.5] [--no-draw]

For plants of some sizes: processor time to take hold of six vertices, and for a frame of a
drag (surface, force, and all messages made for the page, no page open), as a median; the
frames a second that this would allow a core; and the same as a ratio to one fresh sparse
solve, which is the frame of the paper's programme. Of corotational kinematics a frame is
the tangent's answer; `balance` is the processor time of an equilibrium, solved for beside
the frames.

`--browser`: what a page shows. A headless Chromium opens the page, takes the hand's arrow
with the mouse and shakes it for five seconds, one motion of the pointer a picture, as a
browser gives them; of the page's pictures those are counted for which new vertices of the
plant went to the graphics card, by hooks on WebGL. Without a graphics card SwiftShader
draws, by the processor that computes too. Beside it the processor time of the drawing
process for a picture, and of the page's JavaScript and of Python for one with the plant
moved. `--no-draw`: calls that draw do nothing, which leaves what a graphics card could not
take away; `--ratio`: pixels drawn for a page's. Every plant has a process of its own; one
that ends without a word is told of.
"""

import argparse
import collections
import faulthandler
import multiprocessing
import shutil
import sys
import time
from dataclasses import replace

import numpy as np
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

import plantsim as ps
from plantsim.view.app import Viewer
from plantsim.view.touching import Touching

FRAMES = 60
SECONDS = 5.0  # of a drag in the browser
LONGEST = 300.0  # [s] for one plant in the browser
NAMES = ("fork, order 1", "pepper, 6 limbs, order 2", "apple, 12 limbs, order 2")
FLAGS = "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
COUNT = """
window.shown = {pictures: 0, updates: 0, least: 1e9, fresh: false};
for (const name of ["bufferData", "bufferSubData"]) {
  const old = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    const data = given.find((x) => x && x.byteLength);
    if (given[0] === this.ARRAY_BUFFER && data && data.byteLength >= shown.least)
      shown.fresh = true;
    return old.apply(this, given);
  };
}
const tick = () => {
  shown.pictures += 1;
  shown.updates += shown.fresh;
  shown.fresh = false;
  requestAnimationFrame(tick);
};
requestAnimationFrame(tick);
"""
NO_DRAW = """
for (const name of ["drawElements", "drawArrays", "drawElementsInstanced",
                    "drawArraysInstanced"])
  WebGL2RenderingContext.prototype[name] = () => {};
"""
SHAKE = """([x, y, dx, dy, seconds]) => {
  const canvas = document.elementFromPoint(x, y), began = performance.now();
  const go = () => {
    const t = (performance.now() - began) / 1000, s = 0.5 - 0.5 * Math.cos(2 * Math.PI * t);
    if (t > seconds) return;
    canvas.dispatchEvent(new PointerEvent("pointermove", {
      bubbles: true, cancelable: true, pointerId: 1, pointerType: "mouse",
      isPrimary: true, buttons: 1, clientX: x + s * dx, clientY: y + s * dy}));
    requestAnimationFrame(go);
  };
  go();
}"""


def plants(quick: bool) -> list[tuple[str, ps.TetMesh]]:
    return [(name, plant(name)) for name in (NAMES[:1] if quick else NAMES)]


def plant(name: str) -> ps.TetMesh:
    if name == NAMES[0]:
        return ps.tetrahedralize(ps.sweep(ps.fork(0.5, 0.02)), order=1)
    species, limbs = name.split(maxsplit=1)[0].rstrip(","), int(name.split()[1])
    skeleton = ps.weber_penn(species, rng=7).pruned(max_limbs=limbs)
    return ps.tetrahedralize(ps.sweep(skeleton))


def far(mesh: ps.TetMesh) -> dict[str, float]:
    """Measure a hand that leads a corotational plant."""
    linear = ps.ElasticModel(mesh, ps.Material(6e9, 0.35, 900.0))
    touching = Touching(replace(linear, kinematics="corotational"))
    tip = mesh.points[mesh.points[:, 2].argmax()]
    ids = touching.patch(tip, mesh.points[mesh.surface_vertices], 6)
    began = time.process_time()
    touching.hold(ids)
    hold = time.process_time() - began
    seconds = []
    for i in range(FRAMES):
        began = time.process_time()
        touching.drag((1e-4 * i, 0, 0))
        seconds.append(time.process_time() - began)
    balances = []
    for depth in (0.01, 0.02, 0.03):
        touching.drag((depth, 0, 0))
        solve = touching.correction()
        began = time.process_time()
        if solve is not None:
            touching.correct(solve())
        balances.append(time.process_time() - began)
    frame, balance = float(np.median(seconds)), float(np.median(balances))
    return {"hold": hold, "frame": frame, "balance": balance}


def measure(mesh: ps.TetMesh) -> dict[str, float]:
    with Viewer(mesh, port=0) as viewer:
        ids = viewer.touching.patch(
            mesh.points[mesh.points[:, 2].argmax()], mesh.points[mesh.surface_vertices], 6
        )
        began = time.process_time()
        viewer.hold(ids)
        viewer.settle()
        hold = time.process_time() - began
        seconds = []
        for i in range(FRAMES):
            began = time.process_time()
            viewer.drag((1e-4 * i, 0, 0))
            viewer.settle()
            seconds.append(time.process_time() - began)
        model = viewer.touching.model
        held = np.union1d(model.fixed_ids, ids)
        free = np.setdiff1d(np.arange(len(mesh.points)), held)
        K = model.pattern.condense(model.stiffness, free, free)
        began = time.process_time()
        spsolve(K.tocsc(), np.ones(K.shape[0]))
        fresh = time.process_time() - began
    return {"hold": hold, "frame": float(np.median(seconds)), "fresh": fresh}


def pixel(page, viewer: Viewer, point: np.ndarray) -> np.ndarray:
    """Return where a point in space is on the page, by the camera that it tells of."""
    camera = max(viewer.server.get_clients().items())[1].camera
    view = Rotation.from_quat(np.asarray(camera.wxyz)[[1, 2, 3, 0]])  # x right, z ahead
    x, y, z = view.inv().apply(np.asarray(point) - camera.position)
    box = page.locator("canvas").first.bounding_box()
    scale = box["height"] / (2 * np.tan(camera.fov / 2))
    middle = np.array((box["x"] + box["width"] / 2, box["y"] + box["height"] / 2))
    return middle + scale * np.array((x, y)) / z


def shaken(page, viewer: Viewer, mesh: ps.TetMesh, spent) -> dict[str, float]:
    """Drag the hand up and down by its upright arrow; return what came a second.

    And the processor seconds of each kind of process, as `spent` counts them.
    """
    viewer.hold(ps.nearest_vertices(mesh, mesh.points[mesh.points[:, 2].argmax()], count=6))
    viewer.settle()
    page.wait_for_timeout(3000)
    arrow = viewer.frame.centre + np.array((0, 0, 0.7 * 0.14 * viewer.span))
    start = pixel(page, viewer, arrow)
    way = pixel(page, viewer, arrow - np.array((0, 0, 0.05 * viewer.span))) - start
    page.mouse.move(*(start + 1))
    page.mouse.move(*start)
    page.wait_for_timeout(2000)  # until a picture shows that the arrow is met
    page.mouse.down()
    page.mouse.move(*(start + 0.02 * way))
    page.wait_for_timeout(1000)  # programs of what appears are compiled
    least = 11 * viewer.skin.count  # bytes; three floats a vertex are 12
    page.evaluate(f"Object.assign(shown, {{pictures: 0, updates: 0, least: {least}}})")
    before, count, began = spent(), viewer.frames, time.perf_counter()
    page.evaluate(SHAKE, [*map(float, (*start, *way)), SECONDS])
    page.wait_for_timeout(1e3 * SECONDS)
    shown = page.evaluate("({...shown})")
    after, seconds = spent(), time.perf_counter() - began
    page.mouse.up()
    if not shown["updates"]:
        raise RuntimeError("the plant did not follow the mouse: the arrow was missed")
    return {
        "computed": (viewer.frames - count) / seconds,
        "pictures": shown["pictures"] / seconds,
        "updates": shown["updates"] / seconds,
        "draw": 1e3 * (after["GPU"] - before["GPU"]) / shown["pictures"],
        "page": 1e3 * (after["renderer"] - before["renderer"]) / shown["updates"],
        "python": 1e3 * (after["python"] - before["python"]) / shown["updates"],
    }


def browser(name: str, size: tuple[int, int], ratio: float, draw: bool) -> None:
    """Print what a headless Chromium shows of a drag of one plant."""
    from playwright.sync_api import sync_playwright

    faulthandler.enable()
    mesh = plant(name)
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as p, Viewer(mesh, port=0) as viewer:
        chromium = p.chromium.launch(executable_path=found, args=FLAGS.split())
        session = chromium.new_browser_cdp_session()

        def spent() -> collections.Counter:
            out = collections.Counter(python=time.process_time())
            for process in session.send("SystemInfo.getProcessInfo")["processInfo"]:
                out[process["type"]] += process["cpuTime"]
            return out

        page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(120_000)
        page.on("crash", lambda _: print(f"{name}: the page crashed", flush=True))
        page.on("pageerror", lambda why: print(f"{name}: {why}", flush=True))
        page.add_init_script(COUNT if draw else COUNT + NO_DRAW)
        page.goto(f"{viewer.url}/?fixedDpr={ratio}" if ratio else viewer.url)
        page.get_by_text("Let go").wait_for()
        hide = ".mantine-Notifications-root { display: none }"  # lies on the plant
        page.add_style_tag(content=hide)
        page.wait_for_timeout(3000)
        m = shaken(page, viewer, mesh, spent)
        chromium.close()
    print(
        f"| {name} | {m['computed']:.1f} | {m['pictures']:.1f} | {m['updates']:.1f} | "
        f"{m['draw']:.0f} | {m['page']:.0f} | {m['python']:.0f} |",
        flush=True,
    )


def browsers(size: tuple[int, ...], ratio: float, draw: bool, quick: bool) -> int:
    """Look at each plant in a process of its own; return how many failed."""
    print(
        "\n| plant, on the page | computed/s | pictures/s | with the plant moved/s | "
        "drawing, ms | page, ms | Python, ms |\n|---|---|---|---|---|---|---|",
        flush=True,
    )
    failed = 0
    for name in [NAMES[0]] if quick else NAMES:
        asked = (name, size, ratio, draw)
        one = multiprocessing.get_context("spawn").Process(target=browser, args=asked)
        one.start()
        one.join(LONGEST)
        if one.is_alive():
            one.kill()
            one.join()
        if one.exitcode:
            failed += 1
            how = f"signal {-one.exitcode}" if one.exitcode < 0 else f"{one.exitcode}"
            print(
                f"| {name} | no figures: its process ended by {how} | | | | | |", flush=True
            )
    return failed


def main(quick: bool) -> None:
    meshes = plants(quick)
    print("| plant | unknowns | hold, s | frame, ms | frames/s | fresh solve / frame |")
    print("|---|---|---|---|---|---|")
    for name, mesh in meshes:
        m = measure(mesh)
        print(
            f"| {name} | {3 * len(mesh.points):,} | {m['hold']:.2f} | "
            f"{1e3 * m['frame']:.2f} | {1 / m['frame']:.0f} | "
            f"{m['fresh'] / m['frame']:.0f} |"
        )
    print("\n| plant, corotational | hold, s | frame, ms | frames/s | balance, s |")
    print("|---|---|---|---|---|")
    for name, mesh in meshes:
        m = far(mesh)
        print(
            f"| {name} | {m['hold']:.2f} | {1e3 * m['frame']:.2f} | "
            f"{1 / m['frame']:.0f} | {m['balance']:.2f} |"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--browser", action="store_true", help="what a page shows")
    parser.add_argument("--size", default="900x600", help="of the page [pixels]")
    parser.add_argument("--ratio", type=float, default=0.0, help="0: as the page likes")
    parser.add_argument("--no-draw", action="store_true", help="as if drawing were free")
    options = parser.parse_args()
    faulthandler.enable()
    if options.browser:
        size = tuple(map(int, options.size.split("x")))
        sys.exit(browsers(size, options.ratio, not options.no_draw, options.quick))
    main(options.quick)
