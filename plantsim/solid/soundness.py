"""What every mesh of a solid is held to before anybody gets it."""

import numpy as np

from plantsim.errors import MeshError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.mesh.topology import topology
from plantsim.solid.sweep import Solid

WORST = 0.05  # smallest gamma of a tet
VOLUME = 0.05  # largest relative distance of the volume from the union of the tubes


def check_sound(solid: Solid, mesh: TetMesh) -> int:
    """Return the genus of a mesh of a solid; MeshError, naming a limb, unless it is sound.

    Held: worst gamma, one body joined through faces, one closed surface without edges or
    vertices where it touches itself (so that V - E + F is 2 - 2 genus), every limb there up
    to its tip, a foot, and the volume. TetMesh itself refuses inverted and folded tets and
    vertices in no tet.
    """
    worst = int(mesh.quality.argmin())
    if mesh.quality[worst] < WORST:
        raise MeshError(
            f"limb {_name(mesh, worst)}: a tet has gamma {mesh.quality[worst]:.3f}, wanted "
            f"{WORST}. Try another size, or thin limbs that graze it."
        )
    found = topology(mesh)
    if found.body.max():
        apart = int(np.flatnonzero(found.body)[0])
        raise MeshError(
            f"limb {_name(mesh, apart)}: {int((found.body > 0).sum())} tets share no face "
            f"with the rest, in {found.body.max()} pieces. Start the limb deeper in its "
            "parent."
        )
    odd = [*found.open_edges.ravel(), *found.pinched]
    if odd:
        raise MeshError(
            f"limb {_at(mesh, int(odd[0]))}: the surface touches itself at "
            f"{len(found.open_edges)} edges and {len(found.pinched)} vertices. Move limbs "
            "that graze each other apart, or let them overlap."
        )
    if len(found.euler) > 1:
        raise MeshError(
            f"the surface has {len(found.euler)} closed pieces, so there is a hollow "
            "inside. Move limbs that enclose a gap apart."
        )
    region = np.asarray(mesh.region)
    order = np.argsort(region, kind="stable")
    cuts = np.searchsorted(region[order], np.arange(1, len(solid.tubes)))
    for tube, mine in zip(solid.tubes, np.split(order, cuts), strict=True):
        corners = np.unique(mesh.tets[mine, :4])
        end = np.linalg.norm(mesh.points[corners] - tube.axis(1.0), axis=1)
        if not len(corners) or end.min() > 1.5 * tube.radius(1.0):
            raise MeshError(
                f"limb {tube.name} is not in the mesh up to its tip. Lengthen it, or drop "
                "it: skeleton.pruned(min_radius=...)."
            )
    if not len(mesh.sets.get("base", ())):
        raise MeshError(
            f"limb {solid.tubes[0].name}: no vertex is on the flat foot, to hold the plant "
            "by. Start its limbs higher up."
        )
    off = mesh.volume / solid.volume - 1
    if abs(off) > VOLUME:
        mine = np.bincount(np.asarray(mesh.region), mesh.volumes, len(solid.tubes))
        wanted = np.array([t.volume for t in solid.tubes]) - solid.buried
        limb = solid.tubes[int(np.abs(mine - wanted).argmax())].name
        act = "Give a smaller size, or move limbs that run along it away."
        if mesh.tets.shape[1] == 4:
            act = (
                "Order 1 takes wider rings to make up for straight edges, too wide at a "
                "flare and at joints with thin limbs: give a smaller size, or order=2."
            )
        raise MeshError(
            f"the mesh's volume is {100 * off:+.1f} % off the union of its limbs (wanted "
            f"{100 * VOLUME:.0f} %), most of it at limb {limb}. {act}"
        )
    return found.genus


def _name(mesh: TetMesh, tet: int) -> str:
    return mesh.region_names[mesh.region[tet]]  # type: ignore[index]


def _at(mesh: TetMesh, vertex: int) -> str:
    return _name(mesh, int((mesh.tets == vertex).any(axis=1).argmax()))
