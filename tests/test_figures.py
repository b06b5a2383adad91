"""Pictures hold what they should: counted by colour, in one style, the same every time."""

import sys

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


def pixels(path, wanted, along=0.97):
    """Return how many pixels point from black in nearly the direction of a colour."""
    picture = matplotlib.image.imread(path)[:, :, :3]
    colour = np.array([int(wanted[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    size = np.linalg.norm(picture, axis=2)
    cosine = picture @ colour / np.maximum(size * np.linalg.norm(colour), 1e-9)
    return int(((cosine > along) & (size > 0.3)).sum())


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
    assert ps.figure_gallery((m for m in [mesh]), tmp_path / "c.png").exists()


@pytest.mark.parametrize(("kind", "element"), [("gif", "<img"), ("mp4", "<video")])
def test_an_animation_moves_and_comes_back(state, tmp_path, kind, element):
    imageio = pytest.importorskip("imageio.v3")
    pytest.importorskip("imageio_ffmpeg")
    contact = state.model.contact(state.moved)
    states = [contact.solve((0.015 * k, 0, -0.01 * k)) for k in range(1, 4)]
    path = ps.animate_touch(states, tmp_path / f"a.{kind}", size=(240, 200))
    frames = imageio.imread(path)
    assert frames.shape == (4, 200, 240, 3)  # 1 2 3 2, and again
    assert np.abs(frames[0].astype(int) - frames[2]).max() > 100
    away = np.abs(frames[1].astype(int) - frames[3])
    assert away.mean() < 1  # but for the palette of the one, the losses of the other
    assert away.mean() < 0.2 * np.abs(frames[1].astype(int) - frames[2]).mean()
    assert (frames[0][:3] > 250).all()  # white above: nothing is cut off
    html = path._repr_mimebundle_()["text/html"]
    assert html.startswith(element)
    if kind == "mp4":
        told = imageio.immeta(path)
        assert (told["codec"], told["fps"], told["duration"]) == ("h264", 20, 0.2)
    with pytest.raises(ps.ModelError, match="even"):
        ps.animate_touch(states, tmp_path / f"b.{kind}", size=(240, 201))
    with pytest.raises(ps.FileError, match=".gif, .mp4"):
        ps.animate_touch(states, tmp_path / "b.avi")


def test_without_ffmpeg_a_film_says_what_to_do(state, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ps.DependencyError, match=r"plantsim\[view\].*write a .gif"):
        ps.animate_touch([state], tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())


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


@pytest.fixture(scope="module")
def found(state):
    """What two noisy touches of one branch tell of the three limbs."""
    prior = state.model.with_material(ps.Material(6e9, 0.3, 900.0))
    seen = ps.observe(
        state.model,
        ps.move(state.moved, (0.01, 0.0, -0.01)),
        seen=np.arange(0, len(state.displacement), 50),
        displacement_noise=1e-2,
        force_noise=5.0,
        feels="total",
        rng=1,
    )
    return ps.estimate(prior, seen, parameters=ps.per_limb(moduli="young"))


def test_every_value_of_the_chain_has_a_picture(state, found, tmp_path):
    skeleton, mesh = ps.fork(0.3, 0.02), state.model.mesh
    (touch,) = found.observations
    drawn = {
        "skeleton": skeleton.plot(tmp_path / "skeleton.png"),
        "solid": ps.sweep(skeleton).plot(tmp_path / "solid.png"),
        "mesh": mesh.plot(tmp_path / "mesh.png"),
        "model": state.model.plot(tmp_path / "model.png"),
        "state": state.plot(tmp_path / "state.png"),
        "touch": touch.plot(mesh, tmp_path / "touch.png"),
        "found": found.plot(tmp_path / "found.png", next_touch=state.moved[:1]),
    }
    bytes_of = {path.read_bytes() for path in drawn.values()}
    assert len(bytes_of) == len(drawn)  # each shows something of its own
    for limb in style.LIMBS[:3]:  # three limbs, three colours
        assert pixels(drawn["solid"], limb, 0.95) > 500  # paler: it is seen through
        assert pixels(drawn["mesh"], limb) > 500
    assert pixels(drawn["solid"], "#e69f00", 0.99) == 0  # and no fourth
    assert pixels(drawn["touch"], style.MOVED) > 50
    assert pixels(drawn["touch"], style.CONTACT) > 50
    assert pixels(drawn["touch"], style.BLUE) > 50
    for path in drawn.values():
        assert "<img" in path._repr_mimebundle_()["text/html"]
    picture = matplotlib.image.imread(drawn["found"])
    assert picture.shape[1] == 3 * picture.shape[0]  # estimate, uncertainty, identified
    assert pixels(drawn["found"], style.MOVED) > 30
    with pytest.raises(ps.ModelError, match="mesh that was touched"):
        touch.plot(ps.tetrahedralize(ps.sweep(skeleton), 2.0, order=1), tmp_path / "a.png")
    with pytest.raises(ps.ModelError, match="touch.plot\\(mesh"):
        touch.plot(tmp_path / "a.png")


def test_what_a_picture_of_an_estimate_shows(found):
    prior, now = found.posterior.tets
    assert np.array_equal(now, found.tet_std)
    region = np.asarray(found.model.mesh.region)
    share = 1 - (now / prior) ** 2
    for limb, known in enumerate(found.identified.values()):
        assert share[region == limb] == pytest.approx(known, abs=1e-6)
    assert np.ptp(share) > 0.05  # the branch that nobody touched is less known


def test_plots_of_one_value_are_vectors_too(fork, tmp_path):
    skeleton = ps.fork(0.3, 0.02)
    for make in (skeleton.plot, lambda out: ps.figure_quality(fork, out)):
        one, two = make(tmp_path / "a.svg"), make(tmp_path / "b.svg")
        assert one.read_bytes() == two.read_bytes()
        assert one.read_text().lstrip().startswith("<?xml")
        assert make(tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
        with pytest.raises(ps.FileError, match=".svg"):
            make(tmp_path / "a.jpg")


def test_notebooks_show_values_as_cards(state, fork, found):
    skeleton = ps.fork(0.3, 0.02)
    values = (
        skeleton,
        ps.sweep(skeleton),
        fork,
        state.model.material,
        state.model,
        state,
        *found.observations,
        found,
    )
    for value in values:
        html = value._repr_html_()
        assert type(value).__name__ in html
        assert "<b>" in html
    chips = fork._repr_html_()
    assert f"{len(fork.tets):,} tets</span>" in chips
    assert state.model._repr_html_().count("Material(") == 1  # whole, in one chip
