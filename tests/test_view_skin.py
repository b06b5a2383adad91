"""What of a plant is drawn on the viewer's page: enough at rest, less while it moves."""

import time

import numpy as np
import pytest

import plantsim as ps

pytest.importorskip("viser", reason="viser is not installed: pip install plantsim[view]")

from plantsim.view import app


@pytest.fixture
def viewer():
    mesh = ps.tetrahedralize(ps.sweep(ps.fork(0.5, 0.03)), 1.4, order=1)
    with app.Viewer(mesh, name="a fork", port=0) as viewer:
        yield viewer


def wait(happens, seconds=90):
    end = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.1)


def test_a_page_is_spared_what_it_would_draw_slowly(viewer):
    skeleton = ps.weber_penn("apple", rng=7).pruned(max_limbs=12)
    large = ps.tetrahedralize(ps.sweep(skeleton), order=1)
    viewer.do(lambda: viewer.show(large, name="large"))
    viewer.settle()
    skin, touching = viewer.skin, viewer.touching
    assert len(touching.triangles) > 15_000
    assert len(skin.full.faces) < 10_500  # of 24,000: the rest is where the surface is flat
    assert skin.count < 0.6 * len(large.surface_vertices)
    shown = large.points[large.surface_vertices][skin.full.faces]
    a, b, c = np.moveaxis(shown, 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6  # closed, outward, of that size
    assert volume == pytest.approx(large.volume, rel=0.1)
    tip = ps.nearest_vertices(large, large.points[large.points[:, 2].argmax()], count=6)
    assert not skin.ghost.visible  # the plant stands in it
    viewer.hold(tip)
    viewer.drag((0.05, 0, 0))
    viewer.settle()
    assert skin.ghost.visible
    skin.ghostly(False)
    viewer.drag((0.06, 0, 0))
    viewer.settle()
    assert not skin.ghost.visible
    for handle, rows in skin.pieces:
        assert handle.vertices == pytest.approx(viewer.frame.surface[rows], abs=1e-6)


def test_it_is_drawn_lightly_while_it_moves_and_in_full_at_rest(viewer, monkeypatch):
    large = ps.tetrahedralize(ps.sweep(ps.fork(0.5, 0.02)), 0.3, order=1)
    viewer.do(lambda: viewer.show(large, name="large"))
    viewer.settle()
    skin = viewer.skin
    wait(lambda: skin.worn is skin.full)
    monkeypatch.setattr(app, "REST", 30.0)  # no rest between two drags
    assert len(skin.light.faces) < 5_500 < len(skin.full.faces)
    viewer.panel._colour.value = "stress"
    tip = ps.nearest_vertices(large, large.points[large.points[:, 2].argmax()], count=6)
    viewer.hold(tip)
    for k in range(5):
        viewer.drag((0.01 * k, 0, 0))
        viewer.settle()
        assert skin.worn is skin.light
        for handle, rows in skin.pieces:
            assert handle.visible
            assert handle.vertices == pytest.approx(viewer.frame.surface[rows], abs=1e-6)
        assert not any(handle.visible for handle, _ in skin.full.pieces)
    monkeypatch.setattr(app, "REST", 0.1)
    viewer.settle()
    wait(lambda: skin.worn is skin.full)
    wait(lambda: len(skin.pieces) > 3)  # in colours
    assert all(handle.visible for handle, _ in skin.pieces)
    assert not any(handle.visible for handle, _ in skin.light.pieces)
    for handle, rows in skin.pieces:
        assert handle.vertices == pytest.approx(viewer.frame.surface[rows], abs=1e-6)


def test_a_complaint_that_cannot_be_told_does_not_end_the_viewer(viewer, monkeypatch):
    def broken():
        raise RuntimeError("dictionary changed size during iteration")

    with monkeypatch.context() as patched:
        patched.setattr(viewer.server, "get_clients", broken)
        viewer.do(lambda: 1 / 0)
        viewer.settle()
    viewer.hold([10**9])
    viewer.settle()
    assert "out of range" in viewer.panel._words.content
