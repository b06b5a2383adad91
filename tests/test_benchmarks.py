"""The benchmark scripts run, and their answers hold."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import plantsim as ps
from plantsim.elastic.analytic import cantilever_tip

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"


def load(name):
    spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    import sys

    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "shape", ["straight", "tapered", "quarter circle", "thick, nu = 0"]
)
def test_order_two_cantilevers_are_within_one_percent_at_the_default_size(shape):
    for row in load("cantilever").deflections(shape, 2, None):
        assert abs(row.error) < 0.01, row


def test_what_a_thick_cantilever_lacks_is_the_clamp():
    bench = load("cantilever")
    fine, own = (bench.deflections("thick", 2, size) for size in (0.32, None))
    free = bench.deflections("thick, nu = 0", 2, 0.32)
    for a, b, without in zip(fine, own, free, strict=True):
        assert abs(without.error) < 1e-3  # no Poisson's effect: the theory's answer
        assert -0.012 < a.error < -0.007  # with it, however fine the mesh
        assert abs(b.ours / a.ours - 1) < 0.01  # and the default size is as near to that


def test_cantilevers_converge(capsys):
    bench = load("cantilever")
    for order, sizes, least in (
        (1, (0.9, 0.63, 0.45), 1.0),
        (2, (1.26, 0.9, 0.63, 0.45), 2.5),
    ):
        rows = [r for s in sizes for r in bench.deflections("straight", order, s)]
        assert bench.rate([r for r in rows if r.load == "end load"]) > least
    bench.main({2: (0.9,)})
    assert "| straight | end load | 2 | 0.9 |" in capsys.readouterr().out


def test_analytic_tapered_cantilever_has_its_closed_form():
    # end load without shear: 4 P L^3 / (3 pi E a^3 b), Gere and Goodno, problem 9.7
    E, a, b, L = 1e9, 0.02, 0.01, 2.0
    shear_free = cantilever_tip(L, a, b, E, 0.0, end_load=1.0) - 2 * L / (
        E * (6 / 7) * np.pi * a * b
    )
    assert shear_free == pytest.approx(4 * L**3 / (3 * np.pi * E * a**3 * b), rel=1e-9)
    # self-weight of a cone-free bar: w L^4 / (8 E I) and w L^2 / (2 kappa G A)
    A, inertia = np.pi * a**2, np.pi * a**4 / 4
    known = 5 * A * L**4 / (8 * E * inertia) + 5 * L**2 / (2 * (6 / 7) * E / 2)
    assert cantilever_tip(L, a, a, E, 0.0, weight=5.0) == pytest.approx(known, rel=1e-9)


def test_table_one_in_short(tmp_path, capsys):
    bench = load("table1")
    fork = bench.own_plants(["fork"])
    asked = fork, ["limb"], ["1mm"], ["map", "contact"], [1, 3], 1, tmp_path / "table1.md"
    rows = bench.main(*asked, queries=4, log=tmp_path / "rows.jsonl")
    assert "the paper's print" in capsys.readouterr().out
    assert "| limb | 1mm | reference | map | 3 |" in (tmp_path / "table1.md").read_text(
        "utf-8"
    )
    last = next(r for r in rows if (r.method, r.shots) == ("map", 3))
    assert last.prior_visual > 5 * last.visual
    assert last.prior_tactile > 20 * last.tactile
    paper = next(r for r in rows if (r.method, r.shots) == ("contact", 3))
    assert paper.visual > last.visual
    assert paper.tactile > last.tactile
    # a run that was cut goes on where it was
    again = bench.main(*asked, queries=4, log=tmp_path / "rows.jsonl")
    assert again == rows
    assert "gone" not in capsys.readouterr().out


def test_table_one_says_which_estimates_failed(monkeypatch, tmp_path, capsys):
    bench = load("table1")
    found_by = bench.found_by

    def fails_by_contact(method, *rest):
        if method == "contact":
            raise ps.EstimateError("the solver gave up.")
        return found_by(method, *rest)

    monkeypatch.setattr(bench, "found_by", fails_by_contact)
    asked = bench.own_plants(["fork"]), ["limb"], ["1mm"], ["map", "contact"], [1], 1
    rows = bench.main(*asked, tmp_path / "table1.md", queries=2)
    assert [np.isnan(r.visual) for r in rows] == [False, True]
    assert "contact, 1 shots: the solver gave up." in capsys.readouterr().out
    text = (tmp_path / "table1.md").read_text("utf-8")
    assert "| limb | 1mm | reference | contact | 1 | failed |" in text


def test_table_one_takes_meshes_as_equal():
    bench = load("table1")
    errors = {"a": (1.0, 2.0, 9.0), "b": (4.0, 4.0, 4.0), "c": (100.0,)}
    some = [
        bench.Row(mesh, "rough", "1mm", "reference", "map", 1, i, x, 1.0, 8.0, 1.0, 0.0)
        for mesh, xs in errors.items()
        for i, x in enumerate(xs)
    ]
    assert bench.typical(some, lambda r: r.visual) == 4.0
    assert bench.better(some[1], "visual") == 4.0


def test_what_every_touch_brings_in_short(capsys):
    bench = load("every_touch")
    bench.main(["fork"], 2, 2)
    out = capsys.readouterr().out
    assert "fork, 2 seeds" in out
    assert [line.split("|")[1].strip() for line in out.splitlines()[-2:]] == ["1", "2"]


def test_the_clock_of_estimates_in_short(capsys):
    fork = ps.tetrahedralize(ps.sweep(ps.fork()), 1.5, order=1)
    load("estimation_speed").main(fork, ["element", "limbs"], 2, 1)
    rows = [r for r in capsys.readouterr().out.splitlines() if r.startswith("| ")][1:]
    assert [r.split("|")[1].strip() for r in rows] == [
        "every tet",
        "50 limbs, lame",
        "50 limbs, young",
    ]
    assert all(float(r.split("|")[4]) > 0 for r in rows)


def test_next_touch_in_short(capsys):
    errors = load("next_touch").main(1, 2, 3)
    assert errors["next"][0, 0] == errors["random"][0, 0]
    assert "touches that `next_touch` needs" in capsys.readouterr().out


def test_the_viewer_is_measured(capsys):
    pytest.importorskip("viser")
    load("viewer").main(quick=True)
    row = capsys.readouterr().out.splitlines()[-1]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[0] == "fork, order 1"
    assert all(float(cell.replace(",", "")) >= 0 for cell in cells[1:])


def test_elastica_tips_are_within_one_percent_and_greenhill_within_two():
    bench = load("large_rotation")
    rows = list(bench.elasticas())
    assert len(rows) == 10
    for name, known, ours in rows:
        assert abs(ours - known) < 0.01, name
    ((_, ours, known),) = bench.greenhill()
    assert ours == pytest.approx(known, rel=0.02)
    # the line that is drawn begins at the clamp and ends at the tip of the integrals
    line = bench.elastica_line(5.0)
    assert np.abs(line[0]).max() < 1e-6
    assert line[-1] == pytest.approx(bench.elastica(5.0), abs=1e-9)


def test_a_drag_is_measured(capsys):
    bench = load("drag")
    fork = ps.tetrahedralize(ps.sweep(ps.fork()), 1.5, order=1)
    bench.main({"fork": fork}, frames=4)
    rows = [r for r in capsys.readouterr().out.splitlines() if r.startswith("| fork")]
    assert len(rows) == 6
    for row in rows[:3]:
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert float(cells[9]) <= 1e-4  # residual
        assert float(cells[11]) < 1e-3  # force


def test_touches_far_off_bias_the_linear_model_and_not_the_other(capsys):
    bench = load("large_rotation_estimates")
    fits = bench.show_maps(1, (0.15,))
    linear, far = fits[0.15, "linear"], fits[0.15, "corotational"]
    assert np.median(np.abs(linear.error)) > 1.0
    assert linear.held == 0  # not one limb's interval, though errors may cancel in one
    assert (np.abs(far.error) < 4 * far.std).all()
    assert np.abs(far.error).max() < 0.03
    assert far.misfit == pytest.approx(1, abs=0.1)
    assert "| 150 mm | corotational |" in capsys.readouterr().out
