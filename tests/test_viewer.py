"""The live viewer in a headless Chromium, as a person uses it; skipped without one."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import plantsim as ps

pytest.importorskip("viser", reason="viser is not installed: pip install plantsim[view]")

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
LATER = 120_000  # [ms] software rendering on a busy machine takes its time
# no GPU here: WebGL in software
FLAGS = "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"


@pytest.fixture(scope="module")
def mesh():
    return ps.tetrahedralize(ps.sweep(ps.fork(0.5, 0.03)), 1.4, order=1)


@pytest.fixture
def viewer(mesh):
    from plantsim.view.app import Viewer

    with Viewer(mesh, name="a fork", port=0) as viewer:
        yield viewer


@pytest.fixture
def browser():
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=FLAGS.split())
        yield browser
        browser.close()


def opened(browser, viewer):
    page = browser.new_page(viewport={"width": 900, "height": 600})
    page.set_default_timeout(LATER)
    page.goto(viewer.url)
    page.get_by_text("a fork").wait_for()
    page.get_by_text("Let go").wait_for()
    # that there is no GPU is told on top of the plant, where the mouse has to go
    page.add_style_tag(content=".mantine-Notifications-root { display: none }")
    wait(lambda: len(viewer.server.get_clients()) > 0)
    return page


def words(viewer):
    from plantsim.view.style import plain

    return f"{plain(np.linalg.norm(viewer.frame.force))} N"


def wait(happens, seconds=90):
    end = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.1)


def on_screen(page, viewer, point):
    """Return the pixel of a point in space, by the camera that the page tells of."""
    client = max(viewer.server.get_clients().items())[1]
    wait(lambda: client.camera.update_timestamp > 0)
    camera = client.camera
    view = Rotation.from_quat(np.asarray(camera.wxyz)[[1, 2, 3, 0]])  # x right, z ahead
    x, y, z = view.inv().apply(np.asarray(point) - camera.position)
    box = page.locator("canvas").first.bounding_box()
    scale = box["height"] / (2 * np.tan(camera.fov / 2))
    return (
        box["x"] + box["width"] / 2 + scale * x / z,
        box["y"] + box["height"] / 2 + scale * y / z,
    )


def test_a_click_takes_hold_and_a_drag_bends_the_plant(browser, viewer, mesh, tmp_path):
    page = opened(browser, viewer)
    page.wait_for_timeout(3000)  # until all is drawn
    before = page.screenshot(timeout=LATER)
    limb = mesh.points[np.asarray(mesh.tets)[np.asarray(mesh.region) == 1]].reshape(-1, 3)
    page.mouse.click(*on_screen(page, viewer, limb.mean(axis=0)))
    wait(lambda: len(viewer.touching.ids) > 0)
    viewer.settle()
    assert len(viewer.touching.ids) == 6
    assert not viewer.frame.force.any()
    page.wait_for_timeout(2000)
    way = pulled(page, viewer, -0.05)
    assert way[2] == pytest.approx(-0.05, rel=0.3)  # as far as the mouse went
    assert abs(way[:2]).max() < 1e-6  # along the arrow that was taken
    assert viewer.frame.force[2] < 0
    newtons = words(viewer)
    page.get_by_text(newtons).first.wait_for()
    page.wait_for_timeout(2000)
    after = page.screenshot(path=tmp_path / "after.png", timeout=LATER)
    assert picture_differs(before, after)
    # the force is the model's for that motion
    seen = viewer.touching.record()
    assert seen.move.mean(axis=0) == pytest.approx(way, abs=1e-6)
    state = viewer.touching.model.solve(ps.move(seen.moved, seen.move))
    total = state.force[seen.moved].sum(axis=0)
    assert viewer.frame.force == pytest.approx(total, rel=1e-3)


def picture_differs(a, b):
    import io

    import matplotlib.image

    one, two = (matplotlib.image.imread(io.BytesIO(x))[:, :560, :3] for x in (a, b))
    return (np.abs(one - two).max(axis=2) > 0.2).sum() > 300


def pulled(page, viewer, by):
    """Pull the gizmo's upright arrow by a height [m]; return how far the hand went."""
    centre, arrow = viewer.frame.centre, 0.14 * viewer.span
    for patience in (500, 2000, 5000):  # [ms] until a frame shows that the arrow is met
        start = np.array(on_screen(page, viewer, centre + [0, 0, 0.7 * arrow]))
        end = np.array(on_screen(page, viewer, centre + [0, 0, 0.7 * arrow + by]))
        page.mouse.move(*(start + 1))
        page.mouse.move(*start)
        page.wait_for_timeout(patience)
        page.mouse.down()
        for share in np.linspace(0.1, 1, 10):
            page.mouse.move(*(start + share * (end - start)))
            page.wait_for_timeout(50)
        page.mouse.up()
        page.wait_for_timeout(1000 + 2 * patience)
        if viewer.frame.travel > 0.4 * abs(by):
            break
    viewer.settle()
    return viewer.frame.centre - centre


def chosen(page, label, option):
    """Choose an option of a drop-down list of the page."""
    page.get_by_label(label, exact=True).first.click()
    page.get_by_role("option", name=option, exact=True).click()


def test_the_page_switches_kinematics(browser, viewer, mesh):
    page = opened(browser, viewer)
    chosen(page, "kinematics", "corotational")
    wait(lambda: not viewer.touching.linear)
    tip = ps.nearest_vertices(mesh, mesh.points[mesh.points[:, 2].argmax()], count=6)
    viewer.hold(tip)
    viewer.settle()
    page.wait_for_timeout(2000)
    way = pulled(page, viewer, -0.15)
    assert way[2] == pytest.approx(-0.15, rel=0.3)
    wait(lambda: viewer.frame.exact)  # balance is solved for beside the frames
    viewer.settle()
    page.get_by_text(words(viewer)).first.wait_for()
    page.get_by_text("turned").first.wait_for()
    hand = viewer.touching._following
    state = viewer.touching.model.solve(ps.move(tip, hand.state.displacement[tip]))
    total = state.force[tip].sum(axis=0)
    size = np.linalg.norm(total)
    assert viewer.frame.force == pytest.approx(total, rel=1e-2, abs=1e-2 * size)
    linear = ps.ElasticModel(mesh, viewer.touching.model.material)
    other = linear.solve(ps.move(tip, hand.state.displacement[tip]))
    assert np.linalg.norm(other.force[tip].sum(axis=0) - total) > 0.1 * size


def test_a_click_beside_a_twig_takes_hold_of_it(browser, viewer, mesh):
    page = opened(browser, viewer)
    page.wait_for_timeout(2000)
    tip = mesh.points[mesh.points[:, 2].argmax()]
    x, y = on_screen(page, viewer, tip)
    page.mouse.click(x, y - 5)  # above all that there is
    wait(lambda: len(viewer.touching.ids) > 0)
    viewer.settle()
    assert np.linalg.norm(viewer.frame.centre - tip) < 0.05
    held = viewer.touching.ids
    page.mouse.click(30, 560)  # far from the plant
    page.wait_for_timeout(1000)
    viewer.settle()
    assert np.array_equal(viewer.touching.ids, held)


@pytest.mark.slow
def test_a_person_learns_the_stiffness_on_the_page(browser, viewer, mesh, tmp_path):
    viewer.touches_file = tmp_path / "touches.h5"
    page = opened(browser, viewer)
    page.get_by_label("hidden stiffness").click()
    wait(lambda: np.ptp(viewer.touching.model.material.young) > 0)
    viewer.panel._blur.value, viewer.panel._shake.value = 0.5, 0.1
    for limb in (1, 2):
        points = mesh.points[np.unique(mesh.tets[np.asarray(mesh.region) == limb])]
        viewer.hold(ps.nearest_vertices(mesh, points.mean(axis=0), count=6))
        viewer.settle()
        page.wait_for_timeout(1500)
        pulled(page, viewer, -0.05)
        page.get_by_role("button", name="Record this touch").click()
        wait(lambda limb=limb: len(viewer.recorded) == limb)
    page.get_by_text("2 touches recorded").wait_for()
    assert len(ps.read_observations(viewer.touches_file)) == 2
    said = []
    tell = viewer.panel._result
    page.get_by_role("button", name="Estimate").click()
    wait(lambda: said.append(tell.content) or viewer.found is not None)
    assert any("step" in words or "fitting" in words for words in said)  # progress
    viewer.settle()
    page.get_by_text("found, GPa").wait_for()
    true = np.broadcast_to(viewer.touching.model.material.young, (len(mesh.tets),))
    assert viewer.found.material.young == pytest.approx(true, rel=0.2)
    chosen(page, "colour", "uncertainty")
    page.get_by_text("one standard deviation").wait_for()
    low, high = viewer.found.interval(0.999)["0"]
    assert low < true[np.asarray(mesh.region) == 0][0] < high


@pytest.mark.slow
def test_another_plant_is_loaded_and_grown(browser, viewer, mesh, tmp_path):
    page = opened(browser, viewer)
    page.get_by_label("hidden stiffness").click()
    page.get_by_text("Another plant").click()
    other = ps.tetrahedralize(ps.sweep(ps.straight(0.3, 0.02)), order=1)
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Load a mesh").click()
    chooser.value.set_files(ps.write_mesh(other, tmp_path / "mine.msh"))
    page.get_by_text("mine.msh").first.wait_for()
    assert len(viewer.touching.mesh.tets) == len(other.tets)
    assert not viewer.panel._hidden.value  # the new plant's is not
    broken = tmp_path / "broken.msh"
    broken.write_text("not a mesh")
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Load a mesh").click()
    chooser.value.set_files(broken)
    wait(lambda: "**" in viewer.panel._words.content)
    assert viewer.name == "mine.msh"
    chosen(page, "species", "pepper")
    page.get_by_role("button", name="Grow").click()
    wait(lambda: viewer.name == "pepper 7", seconds=240)
    page.get_by_text("pepper 7").first.wait_for()


@pytest.mark.slow
def test_tabs_come_and_go(browser, viewer, mesh):
    first, second = opened(browser, viewer), opened(browser, viewer)
    wait(lambda: len(viewer.server.get_clients()) == 2)
    viewer.hold(np.setdiff1d(mesh.surface_vertices, mesh.sets["base"])[-6:])
    viewer.drag((0.0, 0.01, 0.0))
    viewer.settle()
    newtons = words(viewer)
    for page in (first, second):
        page.get_by_text(newtons).first.wait_for()
    first.close()
    wait(lambda: len(viewer.server.get_clients()) == 1)
    viewer.drag((0.0, 0.02, 0.0))
    viewer.settle()
    twice = words(viewer)
    second.get_by_text(twice).first.wait_for()
    second.close()
    wait(lambda: not viewer.server.get_clients())
    late = opened(browser, viewer)  # comes to the plant as it is
    late.get_by_text(twice).first.wait_for()


def test_learns_from_recorded_touches(viewer, mesh, tmp_path):
    viewer.touches_file = tmp_path / "touches.npz"
    viewer.panel._hidden.value = True
    viewer.do(viewer.panel._hide)
    for top in (-1, -200):
        ids = np.setdiff1d(mesh.surface_vertices, mesh.sets["base"])
        ids = ids[np.argsort(mesh.points[ids, 2])]
        viewer.hold(ids[top - 6 : top])
        viewer.drag((0.003, 0.002, -0.001))
        viewer.do(viewer.panel._keep)
    viewer.settle()
    assert len(viewer.recorded) == len(ps.read_observations(viewer.touches_file)) == 2
    viewer.do(viewer.panel._estimate)
    wait(lambda: viewer.found is not None)
    viewer.settle()
    true = np.broadcast_to(viewer.touching.model.material.young, (len(mesh.tets),))
    assert np.ptp(true) > 0
    assert viewer.found.material.young == pytest.approx(true, rel=0.02)
    assert "GPa" in viewer.skin.legend
    assert viewer.panel.colour == "estimate"


def test_frames_are_faster_than_a_screen(viewer, mesh):
    viewer.hold(ps.nearest_vertices(mesh, mesh.points[mesh.points[:, 2].argmax()], count=6))
    viewer.settle()
    used = time.process_time()
    count = viewer.frames
    for i in range(60):
        viewer.drag((1e-4 * i, 0, 0))
        viewer.settle()
    assert viewer.frames - count == 60  # none was lost, since each was waited for
    assert (time.process_time() - used) / 60 < 1 / 30


def test_mistakes_are_told_and_survived(viewer, mesh):
    viewer.hold(mesh.sets["base"][:3])
    viewer.settle()
    assert "fixed" in viewer.panel._words.content
    viewer.hold([10**9])
    viewer.settle()
    viewer.let_go()
    viewer.drag((1, 0, 0))  # nothing is held
    viewer.settle()
    viewer.do(lambda: viewer.show(mesh.with_order(2), name="another"))
    viewer.settle()
    assert viewer.name == "another"
    assert viewer.touching.mesh.order == 2


def test_the_command_serves_loopback_and_ends_on_ctrl_c(mesh, tmp_path):
    path = ps.write_mesh(mesh, tmp_path / "fork.msh")
    child = subprocess.Popen(
        [sys.executable, "-m", "plantsim", "view", str(path), "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        line = ""
        while "Ctrl-C" not in line:
            line = child.stdout.readline()
            assert line, child.stderr.read()
        found = re.search(r"http://(127\.0\.0\.1):(\d+)", line)
        assert found, line
        with urllib.request.urlopen(found[0], timeout=30) as answer:
            assert answer.status == 200
        port = int(found[2])
        with socket.socket() as other:  # another address of this very machine
            other.settimeout(5)
            assert other.connect_ex(("127.0.0.2", port)) != 0
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=60)
        assert child.returncode == 0, err
        assert "closed" in out
        assert "Traceback" not in err
    finally:
        child.kill()


def test_a_hand_glides_between_two_messages_of_a_page():
    from plantsim.view.hand import Goal, steps

    assert steps(0.05, 0.002) == (3, 1 / 60)
    assert steps(0.05, 0.2) == (1, 0.2)  # frames are slower than messages
    assert steps(0.1, 0.002) == (4, 1 / 40)  # messages come late: the page is behind
    assert steps(0.5, 0.002)[0] == 1  # the hand had rested
    at, goal = Goal(np.zeros(3)), Goal(np.array([3.0, 0, -6.0]), np.array([0, 0, 0.3]), 3)
    way = []
    while goal is not None:
        at, goal = goal.first(at), goal.rest()
        way.append(at.shift)
    assert np.array(way) == pytest.approx(np.array([[1, 0, -2], [2, 0, -4], [3, 0, -6]]))
    assert at.turn == pytest.approx([0, 0, 0.3])


def test_a_drag_shows_more_pictures_than_the_page_sends_messages(viewer, mesh):
    from plantsim.view.hand import Goal

    viewer.hold(ps.nearest_vertices(mesh, mesh.points[mesh.points[:, 2].argmax()], count=6))
    viewer.settle()
    count = viewer.frames
    viewer._lead(Goal(np.array([0.03, 0, 0]), None, 3))
    wait(lambda: viewer.frames - count == 3)
    assert viewer.frame.travel == pytest.approx(0.03)
    viewer._lead(Goal(np.array([0.06, 0, 0]), None, 3))
    viewer.drag((0.01, 0, 0))  # the latest takes over
    wait(lambda: viewer.frame.travel == pytest.approx(0.01))
    viewer.settle()
    assert viewer.frame.travel == pytest.approx(0.01)
