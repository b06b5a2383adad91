"""Plants for the viewer: grown, made ready, meshed, with their fruit."""

from dataclasses import dataclass

from plantsim.elastic.material import Material
from plantsim.errors import GeometryError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.plant.hung import Masses
from plantsim.plant.weber_penn import weber_penn
from plantsim.solid.sweep import sweep
from plantsim.solid.tetrahedralize import tetrahedralize

GREEN_WOOD = Material(6e9, 0.35, 900.0)


@dataclass(frozen=True, eq=False)
class Potted:
    """A plant that can be shown."""

    name: str
    mesh: TetMesh
    material: Material
    masses: Masses | None


def potted(
    species: str,
    seed: int,
    limbs: int = 12,
    *,
    order: int = 2,
    timeout: float | None = None,
) -> Potted:
    """Return a species grown from a seed, its `limbs` thickest limbs meshed.

    With its fruit as masses, where the fruit of the species is known. `timeout` [s]: mesh
    it in a process of its own, as a thread that is not the main one must.
    """
    skeleton = weber_penn(species, rng=seed).pruned(max_limbs=limbs)
    try:
        masses = skeleton.with_fruit(species).masses
    except GeometryError:
        masses = None
    mesh = tetrahedralize(sweep(skeleton), order=order, timeout=timeout)
    return Potted(f"{species} {seed}", mesh, GREEN_WOOD, masses)
