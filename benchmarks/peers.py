"""The reference problem in plantsim and in other packages, side by side.

    python -m venv peers && peers/bin/pip install . sfepy felupe torch-fem
    peers/bin/python benchmarks/peers.py mesh.npz [--repeat 5]

Same mesh and material (mu = 7, lam = 6), order 1; the lowest 10 % fixed, ten vertices moved
down together. Medians in ms, the packages in turn and the turn reversed every other round:
set-up (mesh to K, or what comes next to it), the first static solve, the same vertices
moved otherwise, ten other vertices. A package that is not installed is left out.
"""

import argparse
import contextlib
import io
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import plantsim as ps

MU, LAM = 7.0, 6.0
YOUNG, POISSON = MU * (3 * LAM + 2 * MU) / (LAM + MU), LAM / (2 * (LAM + MU))
STAGES = ("set-up", "static solve", "same vertices again", "ten other vertices")
Solve = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Ours:
    """A model; a contact for vertices moved again."""

    def __init__(self, points: np.ndarray, tets: np.ndarray, fixed: np.ndarray) -> None:
        self.model = ps.ElasticModel(
            ps.TetMesh(points, tets), ps.Material.lame(MU, LAM), fixed=fixed
        )
        self.model.stiffness  # noqa: B018
        self.contact: Any = None

    def first(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        return self.model.solve(ps.move(ids, d)).displacement

    def prepare(self, ids: np.ndarray) -> None:
        """Make the contact that serves the same vertices, and all others, from then on."""
        self.contact = self.model.contact(ids)
        self.contact.displacement(np.zeros((len(ids), 3)))

    def again(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        assert (self.contact.ids == ids).all()
        return self.contact.displacement(np.tile(d, (len(ids), 1)))

    def other(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        return self.model.solve(ps.move(ids, d)).displacement


class Felupe:
    """SolidBody's matrix; condensed and solved by its own `solve`."""

    def __init__(self, points: np.ndarray, tets: np.ndarray, fixed: np.ndarray) -> None:
        import felupe as fem

        self.fem, self.fixed = fem, fixed
        mesh = fem.Mesh(points, tets, "tetra")
        self.field = fem.FieldContainer([fem.Field(fem.RegionTetra(mesh), dim=3)])
        body = fem.SolidBody(fem.LinearElastic(E=YOUNG, nu=POISSON), self.field)
        self.K = body.assemble.matrix()

    def first(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        fem = self.fem
        n = len(self.field[0].values)
        held = np.zeros(n, dtype=bool)
        moved = np.zeros(n, dtype=bool)
        held[self.fixed], moved[ids] = True, True
        bounds = {"base": fem.Boundary(self.field[0], mask=held)}
        for i in range(3):
            skip = [int(j != i) for j in range(3)]
            bounds[f"move {i}"] = fem.Boundary(
                self.field[0], mask=moved, skip=skip, value=float(d[i])
            )
        dof0, dof1 = fem.dof.partition(self.field, bounds)
        ext = fem.dof.apply(self.field, bounds, dof0)
        system = fem.solve.partition(self.field, self.K, dof1, dof0)
        return np.asarray(fem.solve.solve(*system, ext)).reshape(-1, 3)

    again = other = first


class TorchFem:
    """torchfem's Solid."""

    def __init__(self, points: np.ndarray, tets: np.ndarray, fixed: np.ndarray) -> None:
        import torch
        import torchfem
        from torchfem.materials import IsotropicElasticity3D

        torch.set_default_dtype(torch.float64)
        self.torch, self.fixed = torch, fixed
        material = IsotropicElasticity3D(E=YOUNG, nu=POISSON)
        self.solid = torchfem.Solid(torch.tensor(points), torch.tensor(tets), material)

    def first(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        torch, solid = self.torch, self.solid
        held = torch.zeros_like(solid.constraints)
        held[torch.tensor(np.append(self.fixed, ids))] = True
        goal = torch.zeros_like(solid.displacements)
        goal[torch.tensor(ids)] = torch.tensor(d)
        solid.constraints, solid.displacements = held, goal
        return solid.solve(verbose=False)[0].detach().numpy().reshape(-1, 3)

    again = other = first


class Sfepy:
    """A linear elastic term, its own SciPy direct solver."""

    def __init__(self, points: np.ndarray, tets: np.ndarray, fixed: np.ndarray) -> None:
        from sfepy.base.base import output
        from sfepy.discrete import FieldVariable, Integral, Material
        from sfepy.discrete.fem import FEDomain, Field, Mesh
        from sfepy.mechanics.matcoefs import stiffness_from_lame
        from sfepy.terms import Term

        output.set_output(quiet=True)
        groups = np.zeros(len(tets), dtype=np.int32)
        mesh = Mesh.from_data(
            "tree", points, None, [tets.astype(np.int32)], [groups], ["3_4"]
        )
        self.domain = FEDomain("domain", mesh)
        self.whole = self.domain.create_region("whole", "all")
        self.base = self._region("base", fixed)
        field = Field.from_args("field", np.float64, "vector", self.whole, approx_order=1)
        self.u = FieldVariable("u", "unknown", field)
        v = FieldVariable("v", "test", field, primary_var_name="u")
        material = Material("m", D=stiffness_from_lame(dim=3, lam=LAM, mu=MU))
        self.term = Term.new(
            "dw_lin_elastic(m.D, v, u)",
            Integral("i", order=1),
            self.whole,
            m=material,
            v=v,
            u=self.u,
        )
        self.count = 0

    def _region(self, name: str, ids: np.ndarray) -> Any:
        return self.domain.create_region(
            name, "vertex " + ",".join(map(str, ids)), "vertex"
        )

    def first(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        from sfepy.discrete import Equation, Equations, Problem
        from sfepy.discrete.conditions import Conditions, EssentialBC
        from sfepy.solvers.ls import ScipyDirect
        from sfepy.solvers.nls import Newton

        self.count += 1
        moved = self._region(f"moved{self.count}", ids)
        problem = Problem("p", equations=Equations([Equation("balance", self.term)]))
        values = {f"u.{i}": float(d[i]) for i in range(3)}
        hold = EssentialBC("hold", self.base, {"u.all": 0.0})
        problem.set_bcs(ebcs=Conditions([hold, EssentialBC("move", moved, values)]))
        problem.set_solver(Newton({"is_linear": True}, lin_solver=ScipyDirect({})))
        state = problem.solve(save_results=False)
        return np.array(state.get_state_parts()["u"]).reshape(-1, 3)

    again = other = first


PACKAGES: dict[str, Any] = {
    "plantsim": Ours,
    "felupe": Felupe,
    "torch-fem": TorchFem,
    "sfepy": Sfepy,
}


def main(
    mesh: ps.TetMesh, repeat: int = 5, packages: tuple[str, ...] = tuple(PACKAGES)
) -> dict[str, dict[str, list[float]]]:
    fixed = ps.lowest(mesh)
    points, tets = np.array(mesh.points), np.array(mesh.tets)
    probe = ps.ElasticModel(mesh, ps.Material.lame(MU, LAM), fixed=fixed)
    touches = ps.sample_touches(probe, 2, depth=0.01, steps=1, rng=0)
    one, two = (t.ids.copy() for t in touches)
    down, aside = np.array([0, 0, -0.01]), np.array([0.01, 0, 0.005])
    known = [
        probe.solve(ps.move(i, d)).displacement
        for i, d in ((one, down), (one, aside), (two, down))
    ]
    times: dict[str, dict[str, list[float]]] = {}
    apart: dict[str, float] = {}
    missing: dict[str, str] = {}
    prepared: list[float] = []
    for round_ in range(repeat + 1):  # the first is a rehearsal
        for name in packages[:: 1 if round_ % 2 else -1]:
            if name in missing:
                continue
            quiet = io.StringIO()
            try:
                with contextlib.redirect_stdout(quiet):
                    marks = [time.perf_counter()]
                    package = PACKAGES[name](points, tets, fixed)
                    marks.append(time.perf_counter())
                    answers = []
                    ready = 0.0
                    for act, ids, d in (
                        (package.first, one, down),
                        (package.again, one, aside),
                        (package.other, two, down),
                    ):
                        answers.append(act(ids, d))
                        marks.append(time.perf_counter() - ready)
                        if act == package.first and hasattr(package, "prepare"):
                            began = time.perf_counter()
                            package.prepare(ids)
                            ready = time.perf_counter() - began
                            prepared.append(1000 * ready)
            except (ImportError, AttributeError, TypeError, ValueError) as why:
                missing[name] = f"{type(why).__name__}: {why}"
                continue
            off = [
                np.linalg.norm(a - k) / np.linalg.norm(k)
                for a, k in zip(answers, known, strict=True)
            ]
            apart[name] = max(apart.get(name, 0.0), *off)
            if round_:
                stages = times.setdefault(name, {s: [] for s in STAGES})
                for stage, took in zip(STAGES, np.diff(marks), strict=True):
                    stages[stage].append(1000 * took)
    print("| package | " + " | ".join(STAGES) + " | displacements apart |")
    print("|---" * (len(STAGES) + 2) + "|")
    for name, stages in times.items():
        cells = " | ".join(f"{median(stages[s]):.3g}" for s in STAGES)
        print(f"| {name} | {cells} | {apart[name]:.0e} |")
    if prepared:
        print(f"\nplantsim's contact is prepared in {median(prepared):.3g} ms, once.")
    for name, why in missing.items():
        print(f"\n{name} is left out ({why}).")
    return times


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--packages", nargs="+", default=list(PACKAGES), choices=PACKAGES)
    options = parser.parse_args()
    main(ps.read_mesh(options.mesh), options.repeat, tuple(options.packages))
