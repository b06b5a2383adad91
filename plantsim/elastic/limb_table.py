"""LimbTable: what each limb carries at its base, how hard it is stressed, how far it goes.

The forces on a limb's base section are those of its own tets and of all that grows from it,
summed over the vertices shared with the rest: exact for the mesh, with no stress recovered.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order

from plantsim.arrays import Array
from plantsim.errors import ModelError

if TYPE_CHECKING:
    from plantsim.elastic.equilibrium import Equilibrium


@dataclass(frozen=True, eq=False)
class LimbLoad:
    """What one limb carries through its base section, and how far its tip goes."""

    name: str
    axial: float  # [N], positive in tension
    shear: float  # [N]
    bending: float  # [N m]
    torsion: float  # [N m]
    stress: float  # largest von Mises stress of a tet's mean stress [Pa]
    tip: Array  # (3,) displacement [m] of the vertex farthest from the base section


@dataclass(frozen=True, eq=False, repr=False)
class LimbTable:
    """One row a limb, in the order of the mesh's regions; also by name, table["3.1"]."""

    rows: tuple[LimbLoad, ...]

    def __iter__(self) -> Iterator[LimbLoad]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> LimbLoad:
        for row in self.rows:
            if row.name == name:
                return row
        names = ", ".join(row.name for row in self.rows)
        raise ModelError(f"no limb {name!r}; there are: {names}.")

    def __repr__(self) -> str:
        lines = [
            f"{'limb':>8} {'axial N':>9} {'shear N':>9} {'bending Nm':>11} "
            f"{'torsion Nm':>11} {'stress MPa':>11} {'tip mm':>8}"
        ]
        lines += [
            f"{r.name:>8} {r.axial:9.3g} {r.shear:9.3g} {r.bending:11.3g} "
            f"{r.torsion:11.3g} {r.stress / 1e6:11.3g} {1000 * np.linalg.norm(r.tip):8.3g}"
            for r in self.rows
        ]
        return "\n".join(lines)


def limb_table(state: "Equilibrium") -> LimbTable:
    """Return the table of a state; its regions are taken for limbs.

    A limb's axis goes from the centre of its base section to its centre of mass. A region
    hangs from the neighbour by which it is reached first from the fixed vertices.
    """
    model, mesh = state.model, state.model.mesh
    region = np.asarray(mesh.region)
    nodal = state.deformed.tet_forces
    at = mesh.points
    if model.kinematics != "linear":  # arms are those of the plant where it is
        at = at + state.displacement
    touches = _touching(mesh.tets, region, len(mesh.points), len(mesh.region_names))
    fixed = np.zeros(len(mesh.points), dtype=bool)
    fixed[model.fixed_ids] = True
    beyond = _beyond(touches, np.unique(region[fixed[mesh.tets].any(axis=1)]))
    rows = []
    for r, name in enumerate(mesh.region_names):
        own = region == r
        if not own.any():
            continue
        on = np.isin(region, beyond[r])
        force = np.zeros_like(mesh.points)
        np.add.at(force, mesh.tets[on], nodal[on])
        inside = np.zeros(len(mesh.points), dtype=bool)
        outside = np.zeros(len(mesh.points), dtype=bool)
        inside[mesh.tets[on]] = True
        outside[mesh.tets[~on]] = True
        section = np.flatnonzero(inside & (outside | fixed))
        ids = np.unique(mesh.tets[own])
        centre = at[section].mean(axis=0)
        far = ids[np.linalg.norm(at[ids] - centre, axis=1).argmax()]
        share = mesh.volumes[own] / mesh.volumes[own].sum()
        axis = share @ at[mesh.tets[own, :4]].mean(axis=1) - centre
        axis /= max(float(np.linalg.norm(axis)), 1e-300)
        total = force[section].sum(axis=0)
        moment = np.cross(at[section] - centre, force[section]).sum(axis=0)
        rows.append(
            LimbLoad(
                name,
                float(-total @ axis),  # pulled towards the base: tension
                float(np.linalg.norm(total - (total @ axis) * axis)),
                float(np.linalg.norm(moment - (moment @ axis) * axis)),
                float(moment @ axis),
                float(state.von_mises[own].max()),
                state.displacement[far],
            )
        )
    return LimbTable(tuple(rows))


def _touching(tets: Array, region: Array, vertices: int, regions: int) -> csr_array:
    """Return which regions share vertices, (regions, regions)."""
    shape = (vertices, regions)
    labels = np.repeat(region, tets.shape[1])
    on = coo_array((np.ones(tets.size), (tets.ravel(), labels)), shape=shape).tocsr()
    return csr_array(on.T @ on)


def _beyond(touches: csr_array, roots: Array) -> list[Array]:
    """Return, for each region, itself and all regions that hang from it."""
    count = len(touches.indptr) - 1
    out = [[r] for r in range(count)]
    # one more region, the ground, touches those that are fixed
    graph = touches.tolil()
    graph.resize((count + 1, count + 1))
    graph[count, roots] = 1
    order, parent = breadth_first_order(graph.tocsr(), count, directed=True)
    for r in order[:0:-1]:
        if 0 <= parent[r] < count:
            out[parent[r]] += out[r]
    return [np.array(regions) for regions in out]
