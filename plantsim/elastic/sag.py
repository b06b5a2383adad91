"""Sag: the plant under its own weight, and the shape that it has without it."""

from typing import TYPE_CHECKING

import numpy as np

from plantsim.elastic.equilibrium import Equilibrium
from plantsim.elastic.loads import Composite, Load, Move
from plantsim.elastic.newton import TOLERANCE
from plantsim.errors import MeshError, ModelError, SolverError
from plantsim.mesh.tetmesh import TetMesh

if TYPE_CHECKING:
    from plantsim.elastic.model import ElasticModel

TURNS = 60  # of the fixed point
PATIENCE = 10  # turns in which the distance has to halve
HALVINGS = 8  # of a step whose rest shape has tets turned over
LOOSE = 1e-6  # residual of balance while the shape is not yet found
DEPTH = 3  # differences that Anderson's mixing keeps


def unloaded(
    model: "ElasticModel", loads: tuple[Load, ...], tolerance: float
) -> tuple["ElasticModel", Equilibrium]:
    """Return the model whose equilibrium under `loads` has the shape of this model's mesh.

    By the fixed point X <- X - (x(X) - shape), speeded by Anderson's mixing, until no
    vertex is farther than `tolerance` [m] from the shape. Second, that equilibrium. Until
    then balance is loose, and factors go on in the order of the turn before.
    Source of the fixed point: Sellier 2011, An iterative method for the inverse
    elasto-static problem; of the mixing: Walker and Ni 2011.
    """
    if any(isinstance(load, Move) for load in loads):
        raise ModelError("unloaded: moved vertices are no load. Give forces and gravity.")
    shape, mesh = model.mesh.points, model.mesh
    # what hangs stays on the vertices that bear it where the plant was seen
    loads = tuple(
        part
        for load in loads
        for part in (load.parts(mesh) if isinstance(load, Composite) else (load,))
    )
    rest = shape.copy()
    state, trail, offs = None, [], [np.inf]
    for _ in range(TURNS):
        new, rest = _sound(model, rest, trail[-1][0] if trail else shape)
        for residual in (LOOSE, TOLERANCE):
            state = new.solve(*loads, start=state, tolerance=residual)
            if (part := getattr(state.stats, "fraction", 1.0)) < 1:
                raise SolverError(
                    f"unloaded: the plant carries {100 * part:.3g} % of the load and no "
                    "more. Check moduli and density; the mesh has "
                    f"{len(shape)} vertices and weighs {model.mass:.3g} kg."
                )
            lack = shape - (rest + state.displacement)
            off = float(np.linalg.norm(lack, axis=1).max())
            if off > tolerance:
                break
        else:
            return new, state
        offs.append(off)
        if len(offs) > PATIENCE and min(offs[-PATIENCE:]) > min(offs[:-PATIENCE]) / 2:
            break
        trail = [*trail, (rest, lack)][-DEPTH - 1 :]
        rest = _mixed(trail)
        rest[model.fixed_ids] = shape[model.fixed_ids]
    raise SolverError(
        f"unloaded: {1e3 * min(offs):.2g} mm from the shape after {len(offs) - 1} turns, "
        f"wanted {1e3 * tolerance:.2g}. Check moduli and density: it may be that no plant "
        "so soft can stand so."
    )


def _mixed(trail: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the next rest shape: the fixed point's step on the best mix of the last."""
    X, F = (np.array([part[i].ravel() for part in trail]) for i in (0, 1))
    if len(trail) == 1:
        return (X[0] + F[0]).reshape(-1, 3)
    dX, dF = np.diff(X, axis=0), np.diff(F, axis=0)
    gamma = np.linalg.lstsq(dF.T, F[-1], rcond=None)[0]
    return (X[-1] + F[-1] - gamma @ (dX + dF)).reshape(-1, 3)


def _sound(
    model: "ElasticModel", rest: np.ndarray, last: np.ndarray
) -> tuple["ElasticModel", np.ndarray]:
    """Return the model at a rest shape, nearer the last one where tets would turn over."""
    for _ in range(HALVINGS):
        try:
            return _at(model, rest), rest
        except MeshError:
            rest = (rest + last) / 2
    raise SolverError(
        "unloaded: the rest shape sought has tets turned over. Check moduli and density: "
        "it may be that no plant so soft can stand so."
    )


def _at(model: "ElasticModel", rest: np.ndarray) -> "ElasticModel":
    mesh = model.mesh
    new = TetMesh(
        rest, mesh.tets, mesh.region, dict(mesh.sets), mesh.region_names, mesh.report
    )
    return type(model)(new, model.material, model.fixed_ids, model.solver, model.kinematics)
