"""Large rotations against exact and published answers.

    python benchmarks/large_rotation.py [--quick] [--plot elastica.png] [mesh.npz ...]

Cantilevers of length / radius 50, order 2 at the default size, corotational kinematics:
Euler's elastica with an end load (elliptic integrals, computed here), rolled up by an end
moment, the 45-degree bend of Bathe and Bolourchi (1979), Greenhill's column (1881) by the
lowest eigenvalue of the tangent; rigid rotation and frame indifference. An apple tree with
fruit: its unloaded shape, settled, against the shape it was given. Meshes, such as the
reference trees: ten vertices pushed 0.15 m down, the lowest 10 % held, three touches each.
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import skfem
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

import plantsim as ps

L, R, E, NU = 1.0, 0.02, 6e9, 0.3
EI = E * np.pi * R**4 / 4


def elastica(load: float) -> tuple[float, float]:
    """Return the tip of a clamped elastica of length 1 under an end load P L^2 / E I.

    (across, along) the undeformed axis; the load stays across it. With the tip's slope
    angle theta and p^2 = (1 + sin theta) / 2, sin phi1 = 1 / (p sqrt 2):
    sqrt(load) = K(p) - F(p, phi1), across = 1 - 2 (E(p) - E(p, phi1)) / sqrt(load),
    along = sqrt(2 sin theta / load). Source: Bisshopp and Drucker 1945, Q. Appl. Math. 3.
    """

    def modulus(theta: float) -> tuple[float, float]:
        m = (1 + np.sin(theta)) / 2
        return m, np.arcsin(1 / np.sqrt(2 * m))

    def lack(theta: float) -> float:
        m, phi = modulus(theta)
        return float(ellipk(m) - ellipkinc(phi, m) - np.sqrt(load))

    theta = brentq(lack, 1e-9, np.pi / 2 - 1e-12, xtol=1e-14)
    m, phi = modulus(theta)
    across = 1 - 2 * (ellipe(m) - ellipeinc(phi, m)) / np.sqrt(load)
    return float(across), float(np.sqrt(2 * np.sin(theta) / load))


def rod(order: int = 2, size: float | None = None) -> tuple[ps.ElasticModel, np.ndarray]:
    """Return a clamped cantilever along z, and the vertices of its flat tip."""
    solid = ps.sweep(ps.straight(L, R), tips="flat")
    mesh = ps.tetrahedralize(solid, size, order=order)
    model = ps.ElasticModel(mesh, ps.Material(E, NU), kinematics="corotational")
    return model, np.flatnonzero(mesh.points[:, 2] > L - 1e-9)


def tip_position(state: ps.Equilibrium, tip: np.ndarray) -> np.ndarray:
    return (state.model.mesh.points + state.displacement)[tip].mean(axis=0)


Row = tuple[str, float, float]


def elasticas(order: int = 2, size: float | None = None) -> Iterator[Row]:
    model, tip = rod(order, size)
    state = None
    for load in (0.5, 1.0, 2.0, 5.0, 10.0):
        state = model.solve(ps.force(tip, (load * EI / L**2, 0, 0)), start=state)
        across, along = elastica(load)
        at = tip_position(state, tip)
        yield f"elastica, P L^2/E I = {load:g}: across / L", across, at[0] / L
        yield f"elastica, P L^2/E I = {load:g}: along / L", along, at[2] / L


def roll_up() -> Iterator[Row]:
    """Bend by an end moment: axial forces that follow, linear over the tip's section."""
    model, tip = rod()
    x = model.mesh.points[tip]
    arm = x[:, 0] - x[:, 0].mean()
    share = arm / (arm @ arm)
    state = None
    for name, angle in (("quarter", np.pi / 2), ("half", np.pi)):
        moment = EI * angle / L
        # about y: the side of positive x is pressed
        f = np.zeros((len(tip), 3))
        f[:, 2] = -moment * share
        state = model.solve(ps.force(tip, f, follows=True), start=state)
        at = tip_position(state, tip)
        yield f"{name} circle by end moment: across / L", (1 - np.cos(angle)) / angle, at[0]
        yield f"{name} circle by end moment: along / L", np.sin(angle) / angle, at[2]


def bent_bar(along: int = 16, across: int = 2) -> tuple[ps.TetMesh, np.ndarray]:
    """Return an eighth of a circle of radius 100, of a unit square section, in x-y."""
    t = np.linspace(0, 1, along + 1)
    s = np.linspace(-0.5, 0.5, across + 1)
    m = skfem.MeshTet.init_tensor(t, s, s)
    tets = m.t.T.copy()

    def curve(p: np.ndarray) -> np.ndarray:
        angle, r = p[:, 0] * np.pi / 4, 100 - p[:, 1]
        return np.stack([r * np.sin(angle), 100 - r * np.cos(angle), p[:, 2]], axis=1)

    flat = ps.TetMesh(m.p.T, _upright(m.p.T, tets)).with_order(2)
    mesh = ps.TetMesh(curve(flat.points), flat.tets)
    return mesh, flat.points[:, 0]


def _upright(p: np.ndarray, tets: np.ndarray) -> np.ndarray:
    edges = p[tets[:, 1:]] - p[tets[:, :1]]
    left = np.linalg.det(edges) < 0
    tets[left] = tets[left][:, [0, 2, 1, 3]]
    return tets


def bend() -> Iterator[Row]:
    """Bend an eighth of a circle out of its plane; tip at (29.3, 70.7, 0) at rest.

    Sources: Bathe and Bolourchi 1979, Int. J. Numer. Meth. Engng 14, 961-986; Simo and
    Vu-Quoc 1986, Comput. Methods Appl. Mech. Engrg. 58, 79-116.
    """
    mesh, s = bent_bar()
    base, tip = np.flatnonzero(s < 1e-9), np.flatnonzero(s > 1 - 1e-9)
    model = ps.ElasticModel(mesh, ps.Material(1e7, 0.0), base, kinematics="corotational")
    published = {
        (300, "Bathe, Bolourchi"): (22.5, 59.2, 39.5),
        (300, "Simo, Vu-Quoc"): (22.33, 58.84, 40.08),
        (600, "Bathe, Bolourchi"): (15.9, 47.2, 53.4),
        (600, "Simo, Vu-Quoc"): (15.79, 47.23, 53.37),
    }
    state = None
    for (load, who), known in published.items():
        state = model.solve(ps.force(tip, (0, 0, float(load))), start=state)
        at = tip_position(state, tip)
        # theirs: x towards the centre, y along the bar, z along the load
        for axis, ours, theirs in zip("xyz", (at[1], at[0], at[2]), known, strict=True):
            yield f"45-degree bend, {load} lb, {who}: tip {axis} [in]", theirs, ours


def greenhill() -> Iterator[Row]:
    """Height at which a column under its own weight has a tangent with eigenvalue 0.

    L = (7.8373 E I / w)^(1/3) with w its weight a length. Source: Greenhill 1881, Proc.
    Camb. Phil. Soc. 4. Found for one column by the weight w at which it buckles.
    """
    model, _ = rod()
    model = model.with_material(ps.Material(E, NU, 800.0))
    critical = 7.8373 * EI / L**3  # weight a length
    usual = 800.0 * np.pi * R**2

    def lowest(w: float) -> float:
        state = model.solve(ps.gravity((0, 0, -w / usual)))
        frequency = float(ps.modes(state, 1).frequency[0])
        return frequency * abs(frequency)  # the eigenvalue, but for a factor

    # approached from below, where the straight column stands: two secants to zero
    one, other = 0.8 * critical, 0.9 * critical
    at_one, at_other = lowest(one), lowest(other)
    for _ in range(2):
        new = other - at_other * (one - other) / (at_one - at_other)
        one, at_one = other, at_other
        other, at_other = 0.99 * new, lowest(0.99 * new)
    w = other - at_other * (one - other) / (at_one - at_other)
    yield (
        "Greenhill: greatest height for the load at which it buckles / L",
        (critical / w) ** (1 / 3),
        1.0,
    )


def invariance() -> Iterator[Row]:
    model, tip = rod()
    x = model.mesh.points
    turn = Rotation.from_rotvec((1.0, 2.0, -0.5)).as_matrix()
    bent = model.solve(ps.force(tip, (EI / L**2, 0, 0)))
    spun = model.deformed(x @ turn.T - x)
    yield "rigid rotation: energy / that of the bent rod", 0.0, spun.energy / bent.energy
    size = np.abs(bent.force).max()
    yield (
        "rigid rotation: largest force / that of the bent rod",
        0.0,
        float(np.abs(spun.forces).max() / size),
    )
    both = model.deformed((x + bent.displacement) @ turn.T - x)
    off = np.abs(both.forces - model.deformed(bent.displacement).forces @ turn.T).max()
    yield (
        "frame indifference: energy of the bent rod, turned / not",
        1.0,
        (both.energy / bent.energy),
    )
    yield "frame indifference: forces, largest change / largest force", 0.0, off / size


def unloaded() -> Iterator[Row]:
    """Find the apple tree that sags to the shape grown, under its wood and 40 apples."""
    for order, thinnest in ((1, 0.01), (2, 0.01), (1, 0.0018)):
        tree = ps.weber_penn("apple", rng=7, levels=2).pruned(min_radius=thinnest)
        tree = tree.with_fruit(count=40, mass=0.2, rng=1)
        mesh = ps.tetrahedralize(ps.sweep(tree), order=order)
        green = ps.wood("apple")
        model = ps.ElasticModel(
            mesh, green.with_young(0.5 * green.young), kinematics="corotational"
        )
        loads = ps.gravity(masses=tree.masses).parts(mesh)
        twice = model.settled(*loads).displacement
        began = time.process_time()
        free = model.unloaded(*loads)
        seconds = time.process_time() - began
        again = free.mesh.points + free.settled(*loads).displacement
        name = f"apple, {len(mesh.tets):,} tets of order {order}, 8 kg of fruit"
        off = np.linalg.norm(again - mesh.points, axis=1).max()
        sag = np.linalg.norm(twice, axis=1).max()
        yield f"{name}: bent twice, off the shape [mm]", 0.0, 1000 * sag
        yield f"{name}: unloaded, then settled, off the shape [mm]", 0.0, 1000 * off
        yield f"{name}: CPU seconds that took", 0.0, seconds


def deep(path: Path, order: int) -> None:
    """Push ten vertices of a mesh down by 0.15 m, three times."""
    mesh = ps.read_mesh(path)
    fixed = ps.lowest(mesh)
    if order == 2:
        below = mesh.points[fixed, 2].max()
        mesh = mesh.with_order(2)
        fixed = np.flatnonzero(mesh.points[:, 2] <= below)
    material = ps.Material.lame(8e6, 7e6)
    model = ps.ElasticModel(mesh, material, fixed, kinematics="corotational")
    for touch in ps.sample_touches(model, 3, rng=0):
        began = time.process_time()
        state = model.solve(touch.last)
        seconds = time.process_time() - began
        s = state.stats
        print(
            f"| {path.stem}, order {order} | {getattr(s, 'fraction', 1.0):g} | "
            f"{s.iterations} | {getattr(s, 'factors', 0)} | "
            f"{getattr(s, 'residual', 0.0):.0e} | {np.degrees(state.max_rotation):.0f} deg "
            f"| {'yes' if state.stable else 'no'} | {seconds:.2f} |",
            flush=True,
        )


def plot(path: Path) -> None:
    """Draw the elastica: centre lines bent by the model over those of the integrals."""
    import matplotlib.pyplot as plt

    model, tip = rod()
    x = model.mesh.points
    on = np.flatnonzero(np.hypot(x[:, 0], x[:, 1]) < 0.25 * R)
    on = on[np.argsort(x[on, 2])]
    fig, axes = plt.subplots(figsize=(5, 5))
    state = None
    for load in (0.5, 1.0, 2.0, 5.0, 10.0):
        state = model.solve(ps.force(tip, (load * EI / L**2, 0, 0)), start=state)
        at = (x + state.displacement)[on]
        (line,) = axes.plot(at[:, 0], at[:, 2], ".", ms=3, label=f"P L² / E I = {load:g}")
        arc = elastica_line(load)
        axes.plot(arc[:, 0], arc[:, 1], color=line.get_color(), lw=1)
    axes.set(xlabel="across / L", ylabel="along / L", aspect="equal")
    axes.set_title("Dots: order 2 at the default size. Lines: Euler's elastica")
    axes.legend(frameon=False)
    fig.savefig(path, dpi=150, bbox_inches="tight")


def elastica_line(load: float) -> np.ndarray:
    """Return points (across, along) of the elastica, by its differential equation.

    theta'' = -load cos theta, theta(0) = 0, theta'(1) = 0; from the tip's own angle.
    """
    across, along = elastica(load)
    end = np.arcsin(along**2 * load / 2)  # along = sqrt(2 sin theta / load)

    def slope(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -load * np.cos(y[0]), np.sin(y[0]), np.cos(y[0])]

    s = np.linspace(1, 0, 201)
    y = solve_ivp(slope, (1, 0), [end, 0, across, along], t_eval=s, rtol=1e-10).y
    return y[2:].T[::-1]


def show(rows: Iterator[Row]) -> None:
    for name, known, ours in rows:
        print(f"| {name} | {known:.5g} | {ours:.5g} | {ours - known:+.1e} |", flush=True)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--quick", action="store_true", help="one elastica mesh only")
    parser.add_argument("--plot", type=Path, help="draw the elastica to this PNG")
    parser.add_argument("--order", type=int, choices=(1, 2), default=1, help="of meshes")
    options = parser.parse_args(argv)
    if options.plot is not None:
        plot(options.plot)
        return
    if options.meshes:
        print(
            "| mesh | carried | Newton | factors | residual | turned | stable | CPU s |\n"
            "|" + "---|" * 8
        )
        for path in options.meshes:
            deep(path, options.order)
        return
    print("| case | reference | ours | difference |\n|---|---|---|---|")
    show(elasticas())
    if options.quick:
        return
    for rows in (roll_up(), bend(), greenhill(), invariance(), unloaded()):
        show(rows)
    print("\nElastica by order and size; coarser and finer than the default 0.9\n")
    print("| case | reference | ours | difference |\n|---|---|---|---|")
    for order, size in ((1, 0.9), (1, 0.5), (2, 1.26), (2, 0.6)):
        worst = max(
            (abs(ours - known), name) for name, known, ours in elasticas(order, size)
        )
        print(
            f"| order {order}, size {size}: worst of ten | 0 | {worst[0]:.2g} L | "
            f"{worst[1]} |"
        )


if __name__ == "__main__":
    main()
