"""Strength: the largest fibre stress of each limb against what its wood bears."""

import warnings
from typing import TYPE_CHECKING

import numpy as np

from plantsim.arrays import Array
from plantsim.errors import BreakageWarning, ModelError

if TYPE_CHECKING:
    from plantsim.elastic.equilibrium import Equilibrium

# Stresses at the four points of a tet are linear in between; at a corner they differ from
# the mean by this times the nearest point's (Gauss points at 0.5854 and 0.1382)
CORNER = np.sqrt(5.0)


def fibre_stress(state: "Equilibrium") -> Array:
    """Return the largest principal stress by size in each tet, (m,) [Pa].

    Of order 2 at the tets' corners, from the points at which strain is measured; of order 1
    the mean of the tet, which is too low where tets are as thick as the limb.
    """
    model = state.model
    mu, lam, _ = model.material.per_tet(len(model.mesh.tets))
    turned = model.points.at(state.displacement, mu, lam)
    q = model.points.weight.shape[1]
    if model.kinematics == "linear":
        H = turned.H
        E = (H + H.transpose(0, 2, 1)) / 2
    else:
        E = turned.stretch
    spherical = np.repeat(lam, q) * np.trace(E, axis1=1, axis2=2)
    T = 2 * np.repeat(mu, q)[:, None, None] * E + spherical[:, None, None] * np.eye(3)
    T = T.reshape(len(mu), q, 3, 3)
    if q > 1:
        mean = T.mean(axis=1, keepdims=True)
        T = mean + CORNER * (T - mean)
    return np.abs(np.linalg.eigvalsh(T)).max(axis=(1, 2))


def margins(state: "Equilibrium") -> dict[str, float]:
    """Return strength / largest fibre stress of each limb by name; below 1 it breaks."""
    strength = state.model.material.strength
    if strength is None:
        raise ModelError(
            "margin: the material has no strength. Take ps.wood(name), or give "
            "Material(..., strength=...) in Pa."
        )
    mesh = state.model.mesh
    # what is held or pushed in a point is crushed there in the model, not in the plant
    apart = np.ones(len(mesh.points), dtype=bool)
    apart[state.moved] = apart[state.model.fixed_ids] = False
    away = apart[mesh.tets].all(axis=1)
    share = fibre_stress(state) / strength
    region = np.asarray(mesh.region)
    out = {}
    for r, name in enumerate(mesh.region_names):
        own = (region == r) & away
        if own.any():
            worst = float(share[own].max())
            out[name] = 1 / worst if worst else np.inf
    return out


def warn_of_breakage(state: "Equilibrium") -> None:
    """Warn where a limb would break; silent where the material has no strength."""
    if state.model.material.strength is None:
        return
    weak = {name: m for name, m in margins(state).items() if m < 1}
    if weak:
        name = min(weak, key=lambda key: weak[key])
        warnings.warn(
            f"{len(weak)} limbs would break, first {name}: its fibres bear "
            f"{100 * weak[name]:.0f} % of this stress. Push less far, or elsewhere.",
            BreakageWarning,
            stacklevel=4,
        )
