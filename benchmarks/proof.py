"""Beams, frames, blocks, vibrations and manufactured solutions against theory.

    python benchmarks/proof.py [--quick]

Each line: what, the analytic answer, ours, the relative error and the seconds (mesh and
solve; CPU). Order 2 at the default size. Then why some errors are not smaller: the same
cases on ever more slender tubes, and without Poisson's effect; and the errors in L2 of a
manufactured solution on finer and finer cubes, with their fitted rates.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import skfem

import plantsim as ps
from plantsim.elastic import analytic
from plantsim.elastic.stiffness import scalar_basis

L, R, E, NU, RHO, G = 1.0, 0.02, 6e9, 0.3, 800.0, 9.81


@dataclass(frozen=True)
class Row:
    """One quantity of one case."""

    case: str
    analytic: float
    ours: float
    seconds: float

    @property
    def error(self) -> float:
        """Relative error."""
        return self.ours / self.analytic - 1


def rod(skeleton: ps.Skeleton, size: float = 0.8) -> tuple[ps.TetMesh, np.ndarray]:
    """Return the mesh of a limb with a flat tip, and the vertices of that tip."""
    mesh = ps.tetrahedralize(ps.sweep(skeleton, tips="flat"), size)
    return mesh, np.flatnonzero(mesh.points[:, 2] > mesh.points[:, 2].max() - 1e-9)


def box(cells: int, size: tuple[float, float, float], order: int) -> ps.TetMesh:
    """Return a block, centred on the z axis, on z = 0."""
    x, y, z = (np.linspace(0, s, cells + 1) for s in size)
    m = skfem.MeshTet.init_tensor(x - size[0] / 2, y - size[1] / 2, z)
    tets = m.t.T.copy()
    edges = np.moveaxis(m.p[:, tets[:, 1:]] - m.p[:, tets[:, :1]], 0, 2)
    left = np.linalg.det(edges) < 0
    tets[left] = tets[left][:, [0, 2, 1, 3]]
    return ps.TetMesh(m.p.T, tets).with_order(order)


def torsion_and_moment() -> Iterator[tuple[str, float, float]]:
    for name, thin in (("cantilever", R), ("tapered cantilever", R / 2)):
        skeleton = ps.straight(L, R) if thin == R else ps.tapered(L, R, thin)
        mesh, tip = rod(skeleton)
        flexible = np.linalg.inv(
            ps.grasp(tip).stiffness(ps.ElasticModel(mesh, ps.Material(E, NU)))
        )
        twist, (turn, motion) = (
            analytic.twist(L, R, thin, E, NU),
            analytic.end_moment(L, R, thin, E),
        )
        yield f"{name}, torsion: twist [rad]", twist, flexible[5, 5]
        yield f"{name}, end moment: turn [rad]", turn, flexible[4, 4]
        yield f"{name}, end moment: deflection [m]", motion, flexible[0, 4]


def code_aster() -> Iterator[tuple[str, float, float]]:
    mesh, tip = rod(
        ps.tapered(1.0, 0.1, 0.05), 0.63
    )  # a stocky bar, finer than the default
    model = ps.ElasticModel(mesh, ps.Material(2e11, 0.3))
    flexible = 100 * np.linalg.inv(ps.grasp(tip).stiffness(model))
    push = model.solve(ps.force(tip, (100.0, 0, 0))).displacement[tip, 0].mean()
    known = analytic.cantilever_tip(1.0, 0.1, 0.05, 2e11, 0.3, end_load=100.0)
    yield (
        "code_aster V3.01.400, formula of deflection [m]",
        4.2441e-6,
        100 * (analytic.bending_tip(1.0, 0.1, 0.05, 2e11)),
    )
    yield (
        "code_aster V3.01.400, formula of twist [rad]",
        3.8621e-5,
        100 * (analytic.twist(1.0, 0.1, 0.05, 2e11, 0.3)),
    )
    yield "code_aster V3.01.400, twist [rad]", 3.8621e-5, flexible[5, 5]
    yield "code_aster V3.01.400, deflection with shear [m]", known, push


def middle(end: str, radius: float = R, poisson: float = NU) -> tuple[float, float]:
    """Return the middle's deflection [m] of a beam clamped at its foot: theory's, ours."""
    mesh, tip = rod(ps.straight(L, radius))
    material = ps.Material(E, poisson, RHO)
    held = np.append(mesh.sets["base"], tip) if end == "clamped" else mesh.sets["base"]
    prop = [ps.hold(tip, free=[[0, 1, 0], [0, 0, 1]])] if end == "propped" else []
    model = ps.ElasticModel(mesh, material, fixed=held)
    state = model.solve(ps.gravity((G, 0, 0)), *prop)
    z = mesh.points[:, 2] - L / 2
    near = np.abs(z) < 0.1 * L
    fit = np.polyfit(z[near], state.displacement[near, 0], 4)
    known = analytic.beam_middle(L, radius, E, poisson, RHO * G, far_end=end)
    return known, float(fit[-1])


def two_supports() -> Iterator[tuple[str, float, float]]:
    for end in ("propped", "clamped"):
        yield f"clamped and {end}, self-weight: middle [m]", *middle(end)
        yield f"the same, nu = 0: {end} [m]", *middle(end, poisson=0.0)


def elbow(scale: float) -> tuple[float, float, float]:
    """Return how far a right-angled fork's end goes [m]: lines, stiff joint, ours."""
    trunk, thin, arm = R * scale, 0.012 * scale, 0.6
    skeleton = ps.fork(
        L, trunk, angle=90.0, branches=1, branch_length=arm, branch_radius=thin
    )
    mesh = ps.tetrahedralize(ps.sweep(skeleton, tips="flat"))
    tip = np.flatnonzero(mesh.points[:, 0] > arm - 1e-9)
    state = ps.ElasticModel(mesh, ps.Material(E, NU)).solve(ps.force(tip, (0, 0, -1.0)))
    soft, stiff = (
        analytic.right_angle_tip(L, trunk, arm, thin, E, NU, joint=joint)
        for joint in (0.0, trunk)
    )
    return soft, stiff, -float(state.displacement[tip, 2].mean())


def right_angle() -> Iterator[tuple[str, float, float]]:
    soft, stiff, ours = elbow(1.0)
    yield "right-angled fork, lines that meet [m]", soft, ours
    yield "right-angled fork, arm rigid up to the trunk's face [m]", stiff, ours


def blocks() -> Iterator[tuple[str, float, float]]:
    mesh = box(3, (0.1, 0.1, 1.0), 2)
    x, y, z = mesh.points.T
    foot, top = (np.flatnonzero(z == s) for s in (0.0, 1.0))
    model = ps.ElasticModel(mesh, ps.Material(E, 0.0), fixed=foot)
    state = model.solve(ps.traction(top, (0, 0, 1e5)))
    yield "bar in tension, nu = 0 [m]", 1e5 / E, state.displacement[top, 2].mean()
    # a thick block standing under its own weight, Poisson's ratio and all: the answer is
    # quadratic, so order 2 is exact
    mesh = box(3, (0.8, 0.8, 1.0), 2)
    x, y, z = mesh.points.T
    s = RHO * G / E
    known = s * np.stack(
        [
            NU * x * (1 - z),
            NU * y * (1 - z),
            (z * z - 2 * z) / 2 + NU * (x * x + y * y) / 2,
        ],
        axis=1,
    )
    # the four upper corners lie still; the foot goes where the answer is
    corners = np.flatnonzero((z == 1) & (np.abs(x) == 0.4) & (np.abs(y) == 0.4))
    still = known - known[corners][0] * [0, 0, 1]
    foot = np.flatnonzero(z == 0)
    model = ps.ElasticModel(mesh, ps.Material(E, NU, RHO), fixed=corners)
    state = model.solve(ps.gravity((0, 0, -G)), ps.move(foot, still[foot]))
    off = np.abs(state.displacement - still).max() / np.abs(still).max()
    yield "thick block under its own weight: 1 + largest error", 1.0, 1.0 + off


def vibrations() -> Iterator[tuple[str, float, float]]:
    mesh, _ = rod(ps.straight(L, R))
    found = ps.modes(ps.ElasticModel(mesh, ps.Material(E, NU, RHO)), 6).frequency
    both = {
        "Timoshenko": analytic.timoshenko_frequencies(L, R, E, NU, RHO),
        "Euler and Bernoulli": analytic.cantilever_frequencies(L, R, E, RHO),
    }
    for theory, known in both.items():
        for i in range(3):
            yield f"cantilever, vibration {i + 1}, {theory} [Hz]", known[i], found[2 * i]


def slenderness() -> Iterator[tuple[str, float, dict[str, float]]]:
    """Yield what, length / radius, and the relative error against each theory."""
    for scale in (1.0, 0.5, 0.25):
        soft, stiff, ours = elbow(scale)
        errors = {"lines that meet": ours / soft - 1, "rigid joint": ours / stiff - 1}
        yield "right-angled fork", L / (R * scale), errors
    for scale in (1.0, 0.5, 0.25):
        pairs = {nu: middle("clamped", R * scale, nu) for nu in (NU, 0.0)}
        errors = {f"nu = {nu:.1f}": u / known - 1 for nu, (known, u) in pairs.items()}
        yield "clamped and clamped", L / (R * scale), errors


CASES: tuple[Callable[[], Iterator[tuple[str, float, float]]], ...] = (
    torsion_and_moment,
    code_aster,
    two_supports,
    right_angle,
    blocks,
    vibrations,
)


def manufactured(cells: int, order: int) -> float:
    """Return the relative error in L2 of a known field on the unit cube."""
    mesh = box(cells, (1.0, 1.0, 1.0), order)
    mu, lam, way, p = 1.0, 1.5, np.array([1.0, 2.0, -1.0]), np.pi

    def field(x: np.ndarray) -> np.ndarray:
        bump = np.cos(p * x[0]) * np.cos(p * x[1]) * np.sin(p * x[2])
        return way[(...,) + (None,) * (x.ndim - 1)] * bump

    a, b, c = (p * s for s in mesh.points.T)
    # body force -mu lap u - (lam + mu) grad div u; grad div of bump(x) way, by its Hessian
    waves = [(np.cos(a), -np.sin(a)), (np.cos(b), -np.sin(b)), (np.sin(c), np.cos(c))]
    H = np.empty((3, 3, len(a)))
    for i in range(3):
        for j in range(3):
            turned = [w[(k == i) ^ (k == j)] for k, w in enumerate(waves)]
            H[i, j] = p**2 * np.prod(turned, axis=0) * (-1 if i == j else 1)
    laplace = np.einsum("iin->n", H)
    body = -mu * laplace[:, None] * way - (lam + mu) * np.einsum("ijn,j->ni", H, way)
    # a cube, unlike a plant, fills a direct factor: multigrid takes a tenth of its time
    model = ps.ElasticModel(
        mesh,
        ps.Material.lame(mu, lam, 1.0),
        fixed=mesh.surface_vertices,
        solver="multigrid",
    )
    nodal = (model.mass_matrix @ body.ravel()).reshape(-1, 3)
    u = model.solve(ps.force(np.arange(len(body)), nodal)).displacement
    basis = scalar_basis(mesh.points, mesh.tets, False)
    fine = skfem.Basis(basis.mesh, basis.elem, intorder=6)
    x = np.asarray(fine.global_coordinates())
    N = np.stack([np.asarray(f[0]) for f in fine.basis])
    ours = np.einsum(
        "aeq,eai->ieq", np.broadcast_to(N, (len(N), *fine.dx.shape)), u[mesh.tets]
    )
    exact = field(x)
    return float(
        np.sqrt((((ours - exact) ** 2) * fine.dx).sum() / ((exact**2) * fine.dx).sum())
    )


def rate(order: int, cells: tuple[int, ...]) -> tuple[list[float], float]:
    """Return the errors, and the fitted power of the cell's size."""
    errors = [manufactured(n, order) for n in cells]
    slope = np.polyfit(np.log(1 / np.array(cells)), np.log(errors), 1)[0]
    return errors, float(slope)


def run(case: Callable[[], Iterator[tuple[str, float, float]]]) -> list[Row]:
    began = time.process_time()
    found = list(case())
    seconds = time.process_time() - began
    return [Row(name, float(a), float(o), seconds) for name, a, o in found]


def main(quick: bool = False) -> None:
    print("| case | analytic | ours | error | s |\n|---|---|---|---|---|")
    for case in CASES:
        for r in run(case):
            print(
                f"| {r.case} | {r.analytic:.6g} | {r.ours:.6g} | {100 * r.error:+.2g} % | "
                f"{r.seconds:.1f} |",
                flush=True,
            )
    print("\n| case | length / radius | against | error |\n|---|---|---|---|")
    for case, slender, errors in slenderness() if not quick else ():
        for against, error in errors.items():
            print(
                f"| {case} | {slender:.0f} | {against} | {100 * error:+.2f} % |", flush=True
            )
    print("\n| order | cells a side | error in L2 | rate |\n|---|---|---|---|")
    for order, cells in ((1, (18, 27, 36)), (2, (5, 8, 12))):
        some = cells[:2] if quick else cells
        errors, slope = rate(order, some)
        for n, error in zip(some, errors, strict=True):
            print(f"| {order} | {n} | {error:.2e} | {slope:.2f} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="coarser cubes only")
    main(parser.parse_args().quick)
