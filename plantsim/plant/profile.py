"""Radii along a stem, the crown's profile: formulas of the model, as arrays."""

import numpy as np

from plantsim.arrays import Array
from plantsim.plant.parameters import LEVELS, WeberPenn


def shape_ratio(shape: int, q: Array | float, m: WeberPenn | None = None) -> Array:
    """Return the crown profile S(shape, q), q = 0 at the top and 1 at the crown's base.

    Shape 8 is the pruning envelope and takes its parameters from `m`.
    """
    q = np.asarray(q, dtype=float)
    if shape == 8:
        assert m is not None
        high = 1 - m.prune_width_peak
        inside = (q >= 0) & (q <= 1)
        c = np.clip(q, 0, 1)
        # as printed the lower part jumps at the peak unless that is at 1/2
        below = high if not m.published else max(m.prune_width_peak, 1e-9)
        out = np.asarray(((1 - c) / below) ** m.prune_power_low)
        upper = c < high
        out[upper] = (c[upper] / high) ** m.prune_power_high
        return np.where(inside, out, 0.0)
    if shape in (5, 7):
        flame = np.where(q <= 0.7, q / 0.7, (1 - q) / 0.3)
        return flame if shape == 5 else 0.5 + 0.5 * flame
    return np.asarray(
        {
            0: 0.2 + 0.8 * q,
            1: 0.2 + 0.8 * np.sin(np.pi * q),
            2: 0.2 + 0.8 * np.sin(np.pi * q / 2),
            3: np.ones_like(q),
            4: 0.5 + 0.5 * q,
            6: 1 - 0.8 * q,
        }[shape]
    )


def radius_at(m: WeberPenn, level: int, size: Array, length: Array, z: Array) -> Array:
    """Return radii [m] at fractions z of stems of foot radius `size`; taper, flare."""
    taper = m.taper[min(level, LEVELS - 1)]
    unit = taper if taper < 1 else (2 - taper if taper < 2 else 0.0)
    cone = size * (1 - unit * z)
    radius = cone
    if taper >= 1:
        left = (1 - z) * length
        depth = np.where((taper < 2) | (left < cone), 1.0, taper - 2)
        bead = left
        if taper >= 2:
            span = 2 * np.maximum(cone, 1e-12)
            bead = np.abs(left - span * np.floor(left / span + 0.5))
        dome = np.sqrt(np.maximum(cone**2 - (bead - cone) ** 2, 0))
        radius = (1 - depth) * cone + depth * dome
        if taper < 2:
            radius = np.where(bead >= cone, cone, radius)
    if level == 0 and m.flare:
        radius = radius * (1 + m.flare * (100.0 ** np.maximum(0, 1 - 8 * z) - 1) / 100)
    if level == 0 and m.lobes:
        radius = radius * round_for_lobes(m.lobe_depth)
    return radius


def round_for_lobes(depth: float) -> float:
    """Return the radius of the round section that bends as a lobed one, over its own.

    The section is r (1 + depth sin(lobes phi)); the mean of its second moments of area over
    all directions is pi r^4 / 4 (1 + 3 depth^2 + 3/8 depth^4). A round section as stiff is
    heavier than the lobed one, by depth^2 of its weight.

    >>> round(round_for_lobes(0.1), 4)
    1.0074
    """
    return (1 + 3 * depth**2 + 3 / 8 * depth**4) ** 0.25
