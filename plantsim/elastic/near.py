"""Contact and dragging about an equilibrium of a corotational model."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from plantsim.arrays import Array
from plantsim.elastic.contact import Contact
from plantsim.elastic.equilibrium import Equilibrium


@dataclass(frozen=True, eq=False)
class NearContact:
    """Moved vertices, prepared for small displacements from a state. See `Contact`.

    Displacements are from where the vertices are in the state, (3,) for all alike, (k, 3),
    or many at once, (T, k, 3); forces and fields are whole, not changes.
    """

    state: Equilibrium
    contact: Contact  # of the tangent

    @property
    def ids(self) -> Array:
        """Ids (k,) of the vertices."""
        return self.contact.ids

    @property
    def stiffness(self) -> Array:
        """Tangent stiffness (3k, 3k) [N/m]."""
        return self.contact.stiffness

    def force(self, displacement: ArrayLike) -> Array:
        """Return the external force [N], (k, 3) or (T, k, 3), that displaces them so."""
        return self.state.force[self.ids] + self.contact.force(displacement)

    def displacement(self, displacement: ArrayLike) -> Array:
        """Return the whole field [m], (n, 3) or (T, n, 3), when they are displaced so."""
        return self.state.displacement + self.contact.displacement(displacement)


def near_contact(state: Equilibrium, ids: Array) -> NearContact:
    """Return the contact of vertices about a state."""
    model = state.model
    others = np.setdiff1d(state.moved, ids)
    if len(others) == len(state.moved):
        linear = state.linear
    else:
        linear = model.about(state.tangent, np.union1d(model.fixed_ids, others))
    return NearContact(state, Contact(linear, ids))
