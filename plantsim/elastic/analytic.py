"""Closed-form answers of beam theory that solutions are checked against.

Timoshenko's theory: bending and shear, small rotations, a clamp that holds the section
plane.
"""

import numpy as np
from scipy.integrate import quad


def shear_coefficient(poisson: float) -> float:
    """Return the shear coefficient of a solid circular section.

    Source: Cowper 1966, The shear coefficient in Timoshenko's beam theory, J. Appl. Mech.
    33.

    >>> round(shear_coefficient(0.3), 4)
    0.8864
    """
    return 6 * (1 + poisson) / (7 + 6 * poisson)


def cantilever_tip(
    length: float,
    base_radius: float,
    tip_radius: float,
    young: float,
    poisson: float,
    *,
    end_load: float = 0.0,
    weight: float = 0.0,
) -> float:
    """Return the tip deflection [m] of a round cantilever whose radius falls linearly.

    `end_load` [N] at the tip; `weight` [N/m^3] of the material (density times
    acceleration); both across the axis. By the unit-load theorem, tip = int M m / (E I) + V
    v / (kappa G A) ds. Source: Gere and Goodno, Mechanics of Materials, chapter 9; shear as
    Timoshenko 1921.

    >>> young, inertia = 1e9, np.pi * 0.01**4 / 4
    >>> slender = cantilever_tip(1.0, 0.01, 0.01, young, 0.0, end_load=1.0)
    >>> round(slender / (1.0 / (3 * young * inertia)), 3)
    1.0
    """
    shear_modulus = young / (2 * (1 + poisson))
    kappa = shear_coefficient(poisson)

    def radius(x: float) -> float:
        return base_radius + (tip_radius - base_radius) * x / length

    def beyond(x: float) -> tuple[float, float]:
        """Shear force and bending moment at x from all that acts beyond it."""
        s, a, b = length - x, radius(x), tip_radius
        # of the frustum beyond x: volume, and first moment of its area about x
        volume = np.pi * s * (a * a + a * b + b * b) / 3
        moment = np.pi * s * s * (a * a + 2 * a * b + 3 * b * b) / 12
        return end_load + weight * volume, end_load * s + weight * moment

    def strain(x: float) -> float:
        r = radius(x)
        force, moment = beyond(x)
        bending = moment * (length - x) / (young * np.pi * r**4 / 4)
        return bending + force / (kappa * shear_modulus * np.pi * r**2)

    return float(quad(strain, 0, length, epsabs=0, epsrel=1e-10)[0])
