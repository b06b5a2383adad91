"""The reference problem in plantsim and in other packages, side by side.

    python -m venv peers && peers/bin/pip install . sfepy felupe torch-fem ngsolve
    OMP_NUM_THREADS=1 peers/bin/python benchmarks/peers.py mesh.npz [--repeat 5]

Same mesh and material (mu = 7, lam = 6), order 1; the lowest 10 % fixed, ten vertices moved
down together. Medians of CPU time in ms, the packages in turn and the turn reversed every
other round: set-up (mesh to K), the first static solve, both together, the same vertices
moved otherwise, ten other vertices; then the gradient of a scalar misfit of the field,
|u - u*|^2 / 2, in mu and lam of every tet: with all that is kept of the solve, and of a
material just given. Ours and NGSolve's by an adjoint, torch-fem's by its autograd; felupe
and sfepy have none. A package that is not installed is left out. sfepy and torch-fem make
K within each solve, so their set-up is without it: compare set-up and solve together.
NGSolve keeps its factor of the moved set; torch-fem goes by its direct solver, since its
default at this size, conjugate gradients, takes far longer.
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
STAGES = (
    "set-up",
    "static solve",
    "both",
    "same vertices again",
    "ten other vertices",
    "gradient, factor kept",
    "gradient, new material",
)
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
        self.latest = ids
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

    def gradient(self, ids: np.ndarray, d: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return d misfit / d (mu, lam), (2, m); the factor of `ids` is the model's."""
        return self._gradient(self.model, ids, d, goal)

    def afresh(
        self, lame: np.ndarray, ids: np.ndarray, d: np.ndarray, goal: np.ndarray
    ) -> np.ndarray:
        """Return the same of a material (2, m) [Pa] not met before."""
        model = self.model.with_material(ps.Material.lame(*lame))
        return self._gradient(model, ids, d, goal)

    @staticmethod
    def _gradient(
        model: ps.ElasticModel, ids: np.ndarray, d: np.ndarray, goal: np.ndarray
    ) -> np.ndarray:
        u = model.solve(ps.move(ids, d)).displacement
        free, factor, _ = model.factor(np.union1d(model.fixed_ids, ids))
        adjoint = np.zeros_like(u)
        adjoint[free] = factor((u - goal)[free].ravel())[0].reshape(-1, 3)
        return -np.stack(model.blocks.work(model.mesh.tets, u, adjoint))


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
        self.material = IsotropicElasticity3D
        material = IsotropicElasticity3D(E=YOUNG, nu=POISSON)
        self.make = torchfem.Solid
        self.nodes, self.elements = torch.tensor(points), torch.tensor(tets)
        self.solid = self.make(self.nodes, self.elements, material)

    def first(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        return self._solve(self.solid, ids, d).detach().numpy().reshape(-1, 3)

    def _solve(self, solid: Any, ids: np.ndarray, d: np.ndarray, *lame: Any) -> Any:
        torch = self.torch
        held = torch.zeros_like(solid.constraints)
        held[torch.tensor(np.append(self.fixed, ids))] = True
        goal = torch.zeros_like(solid.displacements)
        goal[torch.tensor(ids)] = torch.tensor(d)
        solid.constraints, solid.displacements = held, goal
        return solid.solve(method="direct", differentiable_parameters=lame)[0]

    again = other = first  # no factor is kept

    def afresh(
        self, lame: np.ndarray, ids: np.ndarray, d: np.ndarray, goal: np.ndarray
    ) -> np.ndarray:
        torch = self.torch
        mu, lam = (torch.tensor(x, requires_grad=True) for x in lame)
        young, poisson = mu * (3 * lam + 2 * mu) / (lam + mu), lam / (2 * (lam + mu))
        solid = self.make(self.nodes, self.elements, self.material(E=young, nu=poisson))
        u = self._solve(solid, ids, d, mu, lam)
        misfit = ((u - torch.tensor(goal)) ** 2).sum() / 2
        return np.stack([g.numpy() for g in torch.autograd.grad(misfit, (mu, lam))])

    def gradient(self, ids: np.ndarray, d: np.ndarray, goal: np.ndarray) -> np.ndarray:
        lame = np.repeat([[MU], [LAM]], len(self.elements), axis=1)
        return self.afresh(lame, ids, d, goal)


class NGSolve:
    """VectorH1, its own sparse Cholesky factor; moduli as elementwise constants."""

    def __init__(self, points: np.ndarray, tets: np.ndarray, fixed: np.ndarray) -> None:
        import netgen.meshing
        import ngsolve as ng

        self.ng, self.fixed, self.n = ng, fixed, len(points)
        raw = netgen.meshing.Mesh(3)
        raw.AddPoints(points)
        raw.AddElements(dim=3, index=1, data=tets.astype(np.int32), base=0)
        self.mesh = ng.Mesh(raw)
        self.space = ng.VectorH1(self.mesh, order=1)
        self.flat = ng.L2(self.mesh, order=0)
        self.form = self._assembled(MU, LAM)
        self.kept: Any = None

    def _strain(self, u: Any) -> Any:
        return (self.ng.Grad(u) + self.ng.Grad(u).trans) / 2

    def _assembled(self, mu: Any, lam: Any) -> Any:
        ng = self.ng
        u, v = self.space.TnT()
        form = ng.BilinearForm(self.space, symmetric=False)
        shear = 2 * mu * ng.InnerProduct(self._strain(u), self._strain(v))
        form += (shear + lam * ng.div(u) * ng.div(v)) * ng.dx
        form.Assemble()
        return form

    def _field(self, vector: Any) -> np.ndarray:
        return vector.FV().NumPy().reshape(3, self.n).T

    def _factor(self, form: Any, ids: np.ndarray) -> Any:
        free = self.ng.BitArray(self.space.ndof)
        free.Set()
        for i in np.append(self.fixed, ids).tolist():
            for k in range(3):
                free.Clear(i + k * self.n)
        return form.mat.Inverse(free, "sparsecholesky")

    def _solved(self, form: Any, inverse: Any, ids: np.ndarray, d: np.ndarray) -> Any:
        u = self.ng.GridFunction(self.space)
        self._field(u.vec)[ids] = d
        u.vec.data -= inverse * (form.mat * u.vec).Evaluate()
        return u

    def first(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        self.kept = ids, self._factor(self.form, ids)
        return self.again(ids, d)

    def again(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        assert (self.kept[0] == ids).all()
        return self._field(self._solved(self.form, self.kept[1], ids, d).vec).copy()

    def other(self, ids: np.ndarray, d: np.ndarray) -> np.ndarray:
        return self._field(
            self._solved(self.form, self._factor(self.form, ids), ids, d).vec
        ).copy()

    def gradient(self, ids: np.ndarray, d: np.ndarray, goal: np.ndarray) -> np.ndarray:
        assert (self.kept[0] == ids).all()
        return self._gradient(self.form, self.kept[1], ids, d, goal)

    def afresh(
        self, lame: np.ndarray, ids: np.ndarray, d: np.ndarray, goal: np.ndarray
    ) -> np.ndarray:
        moduli = [self.ng.GridFunction(self.flat) for _ in lame]
        for field, values in zip(moduli, lame, strict=True):
            field.vec.FV().NumPy()[:] = values
        form = self._assembled(*moduli)
        return self._gradient(form, self._factor(form, ids), ids, d, goal)

    def _gradient(
        self, form: Any, inverse: Any, ids: np.ndarray, d: np.ndarray, goal: np.ndarray
    ) -> np.ndarray:
        ng = self.ng
        u = self._solved(form, inverse, ids, d)
        off, adjoint = u.vec.CreateVector(), ng.GridFunction(self.space)
        self._field(off)[:] = self._field(u.vec) - goal
        adjoint.vec.data = inverse * off
        q = self.flat.TestFunction()
        out = []
        for by in (
            2 * ng.InnerProduct(self._strain(u), self._strain(adjoint)),
            ng.div(u) * ng.div(adjoint),
        ):
            form = ng.LinearForm(self.flat)
            form += -by * q * ng.dx
            form.Assemble()
            out.append(form.vec.FV().NumPy().copy())
        return np.stack(out)


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
    "NGSolve": NGSolve,
}


def rehearse(
    package: Any, acts: dict[str, Callable[[], np.ndarray]]
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Return the milliseconds and the answer of each stage that a package has."""
    took, answers = {}, {}
    for stage, act in acts.items():
        began = time.process_time()
        answers[stage] = act()
        took[stage] = 1000 * (time.process_time() - began)
        if stage == "static solve" and hasattr(package, "prepare"):
            began = time.process_time()
            package.prepare(package.latest)
            took["prepared"] = 1000 * (time.process_time() - began)
    return took, answers


def main(
    mesh: ps.TetMesh, repeat: int = 5, packages: tuple[str, ...] = tuple(PACKAGES)
) -> dict[str, dict[str, list[float]]]:
    fixed = ps.lowest(mesh)
    points, tets = np.array(mesh.points), np.array(mesh.tets)
    probe = ps.ElasticModel(mesh, ps.Material.lame(MU, LAM), fixed=fixed)
    touches = ps.sample_touches(probe, 2, depth=0.01, steps=1, rng=0)
    one, two = (t.ids.copy() for t in touches)
    down, aside = np.array([0, 0, -0.01]), np.array([0.01, 0, 0.005])
    goal = 1.1 * np.array(probe.solve(ps.move(one, down)).displacement)
    lame, case = np.repeat([[MU], [LAM]], len(tets), axis=1), (one, down, goal)
    times: dict[str, dict[str, list[float]]] = {}
    apart: dict[str, dict[str, float]] = {}
    known: dict[str, np.ndarray] = {}
    missing: dict[str, str] = {}
    for round_ in range(repeat + 1):  # the first is a rehearsal
        turn = packages[:: -1 if round_ % 2 else 1]
        for name in turn:
            if name in missing:
                continue
            try:
                with contextlib.redirect_stdout(io.StringIO()):
                    began = time.process_time()
                    package = PACKAGES[name](points, tets, fixed)
                    ready = 1000 * (time.process_time() - began)
                    acts = {
                        "static solve": lambda p=package: p.first(one, down),
                        "same vertices again": lambda p=package: p.again(one, aside),
                        "ten other vertices": lambda p=package: p.other(two, down),
                    }
                    if hasattr(package, "gradient"):
                        acts |= {
                            "gradient, factor kept": lambda p=package: p.gradient(*case),
                            "gradient, new material": lambda p=package: p.afresh(
                                lame, *case
                            ),
                        }
                    took, answers = rehearse(package, acts)
            except (ImportError, AttributeError, TypeError, ValueError) as why:
                missing[name] = f"{type(why).__name__}: {why}"
                continue
            known = known or answers  # of the first package, ours
            worst = apart.setdefault(name, {"field": 0.0, "gradient": 0.0})
            for stage, answer in answers.items():
                off = np.linalg.norm(answer - known[stage]) / np.linalg.norm(known[stage])
                what = "gradient" if "gradient" in stage else "field"
                worst[what] = max(worst[what], float(off))
            if round_:
                took |= {"set-up": ready, "both": ready + took["static solve"]}
                for stage, ms in took.items():
                    times.setdefault(name, {}).setdefault(stage, []).append(ms)
    print("| package | " + " | ".join(STAGES) + " | fields apart | gradients apart |")
    print("|---" * (len(STAGES) + 3) + "|")
    for name, stages in times.items():
        cells = " | ".join(
            f"{median(stages[s]):.3g}" if s in stages else "-" for s in STAGES
        )
        has = "gradient, factor kept" in stages
        gradient = f"{apart[name]['gradient']:.0e}" if has else "-"
        print(f"| {name} | {cells} | {apart[name]['field']:.0e} | {gradient} |")
    for name, stages in times.items():
        if "prepared" in stages:
            ms = median(stages["prepared"])
            print(f"\n{name}'s contact is prepared in {ms:.3g} ms, once.")
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
