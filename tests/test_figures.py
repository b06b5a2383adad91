"""Pictures hold what they should: counted by colour, in one style, the same every time."""

import matplotlib.image
import numpy as np
import pytest

import plantsim as ps
from plantsim.view import probe, style


@pytest.fixture(scope="module")
def state(fork):
    if probe.why_not_drawn():
        pytest.skip(probe.why_not_drawn())
    young = np.array([6e9, 8e9, 4e9])[fork.region]
    model = ps.ElasticModel(fork, ps.Material(young, 0.3, 900.0))
    tip = ps.nearest_vertices(fork, fork.points[fork.points[:, 2].argmax()], count=4)
    return model.solve(ps.move(tip, (0.03, 0.0, -0.02)))


def pixels(path, wanted):
    """Return how many pixels point from black in nearly the direction of a colour."""
    picture = matplotlib.image.imread(path)[:, :, :3]
    colour = np.array([int(wanted[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    size = np.linalg.norm(picture, axis=2)
    along = picture @ colour / np.maximum(size * np.linalg.norm(colour), 1e-9)
    return int(((along > 0.97) & (size > 0.3)).sum())


def test_deformation_with_contact_forces(state, tmp_path):
    plain = ps.figure_deformation(state, tmp_path / "a.png")
    forces = ps.figure_deformation(state, tmp_path / "b.png", forces=True)
    assert pixels(plain, style.MOVED) > 50
    assert pixels(plain, style.CONTACT) == 0
    assert pixels(forces, style.CONTACT) > 50


def test_posterior_shows_each_field_on_its_own_scale(state, tmp_path):
    mesh = state.model.mesh
    young = state.model.material.young / 1e9
    spread = np.linspace(0.1, 2, len(mesh.tets))
    path = ps.figure_posterior(
        mesh, young, spread, tmp_path / "a.png", prior_std=2.0, next_touch=state.moved[:1]
    )
    picture = matplotlib.image.imread(path)
    assert picture.shape[1] == 3 * picture.shape[0]
    assert pixels(path, style.MOVED) > 30
    with pytest.raises(ps.ModelError, match="one value a tet"):
        ps.figure_posterior(mesh, young, spread[1:], tmp_path / "b.png")


def test_gallery_has_a_place_for_each(state, tmp_path):
    mesh = state.model.mesh
    path = ps.figure_gallery(
        {"a": mesh, "b": state, "c": mesh}, tmp_path / "a.png", columns=2
    )
    picture = matplotlib.image.imread(path)[:, :, :3]
    h, w = picture.shape[0] // 2, picture.shape[1] // 2
    filled = [
        (picture[i * h : (i + 1) * h, j * w : (j + 1) * w] < 0.9).any(axis=2).mean()
        for i in (0, 1)
        for j in (0, 1)
    ]
    assert all(share > 0.01 for share in filled[:3])
    assert filled[3] == 0
    with pytest.raises(ps.ModelError, match="empty gallery"):
        ps.figure_gallery([], tmp_path / "b.png")


def test_an_animation_moves_and_comes_back(state, tmp_path):
    imageio = pytest.importorskip("imageio.v3")
    contact = state.model.contact(state.moved)
    states = [contact.solve((0.015 * k, 0, -0.01 * k)) for k in range(1, 4)]
    path = ps.animate_touch(states, tmp_path / "a.gif", size=(240, 240))
    frames = imageio.imread(path)
    assert len(frames) == 4  # 1 2 3 2, and again
    assert np.abs(frames[0].astype(int) - frames[2]).max() > 100
    near = np.abs(frames[1].astype(int) - frames[3]).max()
    assert near < 60  # but for the palette of the format
    html = path._repr_mimebundle_()["text/html"]
    assert html.startswith("<img")


def test_plots_are_the_same_every_time_and_as_asked_for(tmp_path):
    errors = {"ours": ([1.5, 0.8, 0.1, 0.05], [13, 5, 1, 0.5])}
    one = ps.figure_table_one((0, 1, 5, 10), errors, tmp_path / "a.svg")
    two = ps.figure_table_one((0, 1, 5, 10), errors, tmp_path / "b.svg")
    assert one.read_bytes() == two.read_bytes()
    text = one.read_text()
    for word in ("paper, Table I", "ours", "tactile error, N"):
        assert word in text
    figure = ps.figure_table_one((0, 1, 5, 10), errors)
    paper = figure.axes[1].lines[0]
    assert paper.get_ydata().tolist() == [13.411, 13.394, 9.330, 6.733]
    h = np.array([0.4, 0.2, 0.1])
    figure = ps.figure_convergence(h, {"order 2": 3 * h**2})
    assert figure.axes[0].get_legend_handles_labels()[1] == ["order 2: rate 2.00"]
    path = ps.figure_ratios({"a frame": 190.0, "slow": 0.4}, tmp_path / "c.png")
    assert path.stat().st_size > 0
    with pytest.raises(ps.ModelError, match="above 0"):
        ps.figure_ratios({"none": 0.0})
    with pytest.raises(ps.ModelError, match="Give one each"):
        ps.figure_table_one((0, 1), errors)


def luminance(code):
    linear = (np.array(style.rgb(code)) / 255) ** 2.2
    return linear @ [0.2126, 0.7152, 0.0722]


def simulated(code, kind):
    """Return a colour as a dichromat sees it.

    Source: Vienot, Brettel, Mollon, Digital video colourmaps, 1999.
    """
    matrices = {
        "protan": [[0.11238, 0.88762, 0], [0.11238, 0.88762, 0], [0.00401, -0.00401, 1]],
        "deutan": [[0.29275, 0.70725, 0], [0.29275, 0.70725, 0], [-0.02234, 0.02234, 1]],
    }
    linear = (np.array(style.rgb(code)) / 255) ** 2.2
    return np.clip(np.array(matrices[kind]) @ linear, 0, 1) ** (1 / 2.2)


@pytest.mark.parametrize("kind", ["protan", "deutan"])
def test_colours_are_told_apart_by_colour_blind_eyes(kind):
    seen = [simulated(code, kind) for code in style.CYCLE[:4]]
    apart = [np.linalg.norm(a - b) for i, a in enumerate(seen) for b in seen[:i]]
    assert min(apart) > 0.12
    # and the maps go from dark to light all the way, so that a grey print still orders them
    for cmap in (style.STIFFNESS, style.UNCERTAINTY, style.STRESS):
        ramp = style.colours(np.linspace(0, 1, 32), cmap)
        light = [luminance("#" + bytes(c).hex()) for c in ramp.tolist()]
        assert (np.diff(light) > 0).all()


def test_notebooks_show_values_as_cards(state, fork):
    skeleton = ps.fork(0.3, 0.02)
    values = (skeleton, fork, state.model.material, state.model, state)
    for value in values:
        html = value._repr_html_()
        assert type(value).__name__ in html
        assert "<b>" in html
    chips = fork._repr_html_()
    assert f"{len(fork.tets):,} tets</span>" in chips
    assert state.model._repr_html_().count("Material(") == 1  # whole, in one chip
