"""Closed-form answers of beam theory that solutions are checked against.

Timoshenko's theory: bending and shear, small rotations, a clamp that holds the section
plane.
"""

from typing import Any

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq


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


def arc_tip(
    bend: float, radius: float, young: float, poisson: float, *, across: bool
) -> float:
    """Return the deflection [m] of the tip of a clamped quarter circle by 1 N there.

    `bend` is the radius of the circle, `radius` that of the round section. The load goes
    along the tangent at the clamp, or `across` the plane of the arc. By the unit-load
    theorem, bending, torsion, shear and extension. Source: Timoshenko, Strength of
    Materials, part I, section 80 (in its plane); part II, section 10 (across).

    >>> EI = 1e9 * np.pi * 0.01**4 / 4
    >>> bool(abs(arc_tip(1.0, 0.01, 1e9, 0.0, across=False) * EI / (np.pi / 4) - 1) < 1e-3)
    True
    """
    area, inertia = np.pi * radius**2, np.pi * radius**4 / 4
    G = young / (2 * (1 + poisson))
    quarter = bend * np.pi / 2
    GA = shear_coefficient(poisson) * G * area
    if across:
        bending = bend**3 * np.pi / 4 / (young * inertia)
        torsion = bend**3 * (3 * np.pi / 4 - 2) / (G * 2 * inertia)
        return bending + torsion + quarter / GA
    extension = quarter / 2 / (young * area)
    return bend**3 * np.pi / 4 / (young * inertia) + quarter / 2 / GA + extension


def twist(
    length: float, base_radius: float, tip_radius: float, young: float, poisson: float
) -> float:
    """Return the twist [rad] of a round bar by an end torque of 1 N m.

    Saint-Venant, 2 L (a^2 + a b + b^2) / (3 pi G a^3 b^3) for radii a to b; exact for
    a = b. Source: Gere and Goodno, Mechanics of Materials, section 3.4.

    The tapered bar of code_aster's V3.01.400, under 100 N m:

    >>> round(1e7 * 100 * twist(1.0, 0.1, 0.05, 2e11, 0.3), 2)
    386.22
    """
    G = young / (2 * (1 + poisson))
    a, b = base_radius, tip_radius
    return 2 * length * (a * a + a * b + b * b) / (3 * np.pi * G * a**3 * b**3)


def bending_tip(
    length: float, base_radius: float, tip_radius: float, young: float
) -> float:
    """Return the deflection [m] by an end load of 1 N, of bending alone.

    4 L^3 / (3 pi E a^3 b). Source: Gere and Goodno, problem 9.7. The tapered bar of
    code_aster's V3.01.400, under 100 N:

    >>> round(1e8 * 100 * bending_tip(1.0, 0.1, 0.05, 2e11), 2)
    424.41
    """
    return 4 * length**3 / (3 * np.pi * young * base_radius**3 * tip_radius)


def end_moment(
    length: float, base_radius: float, tip_radius: float, young: float
) -> tuple[float, float]:
    """Return turn [rad] and deflection [m] of a round bar's tip by an end moment of 1 N m.

    4 L (a^2 + a b + b^2) / (3 pi E a^3 b^3) and 2 L^2 (a + 2 b) / (3 pi E a^3 b^2) for
    radii a to b, by the unit-load theorem. Source: Gere and Goodno, chapter 9.

    >>> EI = 6e9 * np.pi * 0.02**4 / 4
    >>> turn, deflection = end_moment(3.0, 0.02, 0.02, 6e9)
    >>> round(turn * EI, 9), round(deflection * EI, 9)
    (3.0, 4.5)
    """
    a, b = base_radius, tip_radius
    turn = 4 * length * (a * a + a * b + b * b) / (3 * np.pi * young * a**3 * b**3)
    return turn, 2 * length**2 * (a + 2 * b) / (3 * np.pi * young * a**3 * b**2)


def beam_middle(
    length: float,
    radius: float,
    young: float,
    poisson: float,
    weight: float,
    *,
    far_end: str,
) -> float:
    """Return the deflection [m] at the middle of a clamped round beam by its own weight.

    `weight` [N/m^3]; `far_end` "clamped" or "propped". Timoshenko: bending and shear.
    Source: Gere and Goodno, tables H-1 and H-2, each with its shear term.
    """
    area, inertia = np.pi * radius**2, np.pi * radius**4 / 4
    EI = young * inertia
    GA = shear_coefficient(poisson) * young / (2 * (1 + poisson)) * area
    w, L = weight * area, length
    if far_end == "clamped":
        return w * L**4 / (384 * EI) + w * L**2 / (8 * GA)
    tip = w * L**4 / (8 * EI) + w * L**2 / (2 * GA)
    prop = tip / (L**3 / (3 * EI) + L / GA)
    x = L / 2
    free = (
        w * x**2 * (6 * L**2 - 4 * L * x + x**2) / (24 * EI) + w * (L * x - x**2 / 2) / GA
    )
    return free - prop * (x**2 * (3 * L - x) / (6 * EI) + x / GA)


def cantilever_frequencies(
    length: float, radius: float, young: float, density: float
) -> np.ndarray:
    """Return the first three bending frequencies [Hz] of a round cantilever.

    Euler-Bernoulli, from the roots of cos x cosh x = -1. Source: Rao, Mechanical
    Vibrations, section 8.5.

    >>> bool(abs(cantilever_frequencies(1.0, 0.02, 6e9, 800.0)[0] - 15.325) < 1e-3)
    True
    """
    roots = np.array([1.875104069, 4.694091133, 7.854757438])
    speed = np.sqrt(young * radius**2 / (4 * density))  # sqrt(E I / (rho A))
    return roots**2 * speed / (2 * np.pi * length**2)


def timoshenko_frequencies(
    length: float, radius: float, young: float, poisson: float, density: float
) -> np.ndarray:
    """Return the first three bending frequencies [Hz] of a round cantilever, with shear.

    And with rotary inertia; all below those of Euler and Bernoulli, the more the shorter
    the bar. Source: Huang 1961, The effect of rotatory inertia and of shear deformation on
    the frequency and normal mode equations of uniform beams, J. Appl. Mech. 28.

    >>> slender = timoshenko_frequencies(1.0, 1e-4, 6e9, 0.3, 800.0)
    >>> known = cantilever_frequencies(1.0, 1e-4, 6e9, 800.0)
    >>> bool(abs(slender / known - 1).max() < 1e-4)
    True
    """
    known = cantilever_frequencies(length, radius, young, density)
    r2 = radius**2 / (4 * length**2)  # I / (A L^2)
    s2 = r2 * 2 * (1 + poisson) / shear_coefficient(poisson)  # E I / (kappa G A L^2)
    # of the frequency parameter b = omega L^2 sqrt(rho A / (E I)), b / omega in seconds
    unit = length**2 / np.sqrt(young * radius**2 / (4 * density))

    def characteristic(b: float) -> float:
        root = np.sqrt((r2 - s2) ** 2 + 4 / b**2)
        wide, fast = (np.sqrt((sign * (r2 + s2) + root) / 2) for sign in (-1, 1))
        coupling = b * (r2 + s2) / np.sqrt(1 - b**2 * r2 * s2)
        return (
            2
            + (b**2 * (r2 - s2) ** 2 + 2) * np.cosh(b * wide) * np.cos(b * fast)
            - coupling * np.sinh(b * wide) * np.sin(b * fast)
        )

    out = []
    for high in known * 2 * np.pi * unit:
        low = 0.98 * high
        while characteristic(low) * characteristic(1.001 * high) > 0:
            low *= 0.98
        root: Any = brentq(characteristic, low, 1.001 * high)
        out.append(float(root))
    return np.array(out) / (2 * np.pi * unit)


def right_angle_tip(
    length: float,
    radius: float,
    arm: float,
    arm_radius: float,
    young: float,
    poisson: float,
    *,
    joint: float = 0.0,
) -> float:
    """Return how far 1 N along the trunk moves the end of an arm at a right angle [m].

    A trunk clamped at its foot, a round arm from its top; bending, shear and tension.
    `joint` [m]: the first part of the arm that is taken for rigid. None of it, two lines
    that meet, is softer than the solid; the trunk's radius, up to its face, is stiffer.
    Source: Gere and Goodno, chapter 9, by Castigliano's theorem.
    """
    trunk, slim = (young * np.pi * r**4 / 4 for r in (radius, arm_radius))
    shear = shear_coefficient(poisson) * young / (2 * (1 + poisson)) * np.pi * arm_radius**2
    free = arm - joint
    return (
        free**3 / (3 * slim)
        + free / shear
        + arm**2 * length / trunk
        + length / (young * np.pi * radius**2)
    )
