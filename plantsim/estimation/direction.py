"""Direction: the Gauss-Newton step, by CG with what was learnt before, or a whole Hessian.

An iteration of CG takes two back-solves a case, the whole Hessian one a case and column.
So one is made for few columns, and preconditions CG at later iterates until it is worn.
Along sections many right-hand sides at once cost a third each of ten: few cases have it
made anew.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from plantsim.arrays import Array

if TYPE_CHECKING:
    from plantsim.estimation.output_error import Objective

FEW = 128  # columns of a chart up to which a Hessian is made, not only applied
FEWER = 20  # up to which that is as cheap as CG, and done at every iteration
PAIRS = 200  # directions remembered for the preconditioner
WORN = 15  # CG iterations from which on a whole Hessian is made anew
GAIN = 0.1  # of the mean gain of CG's iterations: less, and it stops
LATELY = 5  # iterations whose mean gain is compared with that
RESIDUAL = 1e-6  # of the gradient at which CG stops anyhow


def direction_of(
    here: "Objective", g: Array, memory: "Memory", most: int, dear: float
) -> tuple[Array, int]:
    """Return the Gauss-Newton step, and the CG iterations it took, `most` at most."""
    p, q = len(g), here.chart.columns.shape[1]
    if q <= FEWER or (q <= FEW and (memory.whole is None or memory.worn)):
        memory.whole, memory.worn = here.dense_hessian, memory.fresh
        memory.clear()
        return -np.linalg.solve(here.dense_hessian / here.temper + np.eye(p), g), 0

    def product(v: Array) -> Array:
        return v + here.hessian(v) / here.temper

    inverse = memory.inverse(here.temper)
    ways = memory.inverse(here.temper, among=True), inverse
    step, P, HP = conjugate_step(product, g, ways, most, dear)
    memory.add(P, (HP - P) * here.temper)
    memory.worn = len(P) > WORN
    return step, len(P)


def conjugate_step(
    product: Callable[[Array], Array],
    g: Array,
    inverse: Callable[[Array], Array] | tuple[Callable[[Array], Array], ...],
    most: int,
    dear: float,
) -> tuple[Array, Array, Array]:
    """Return -H^-1 g by CG, as far as it pays; its directions P (k, p), P H P^T = 1; H P.

    `inverse`: the preconditioner, or one an iteration, of which the last serves on.
    Every direction is made conjugate to all before it, not to the last alone. H has a few
    eigenvalues a million times the others, which by rounding would be found again and
    again: that took twice the iterations.

    From zero, the k-th point x has the quadratic model g x / 2. The rule is that of Nash
    and Sofer 1990, Oper. Res. Lett. 9: stop when an iteration gains less than a share of
    the mean of those before it. Near the end, where `dear` is finite, large gains at first
    do not hide what is still to be had: they count as `dear` at most, and some iterations
    are looked at together, since one alone may be poor. Far from it a step need not be so
    good. Without BLAS, as `solve.stats.norm`.
    """
    x, r = np.zeros_like(g), -g
    P, HP = (np.empty((most, len(g))) for _ in range(2))  # apart: P alone is remembered
    window = LATELY if np.isfinite(dear) else 1
    least = RESIDUAL**2 * _dot(g, g)
    gains: list[float] = []
    ways = inverse if isinstance(inverse, tuple) else (inverse,)
    for k in range(most):
        p = ways[min(k, len(ways) - 1)](r)
        p -= np.einsum("ij,i->j", P[:k], np.einsum("ij,j->i", HP[:k], p))
        Hp = product(p)
        size = np.sqrt(_dot(p, Hp))
        P[k], HP[k] = p / size, Hp / size
        along = _dot(P[k], r)
        x += along * P[k]
        r -= along * HP[k]
        gains.append(along**2 / 2)
        now = sum(gains[-window:]) / window
        poor = (k + 1) * now < GAIN * min(sum(gains), dear)
        if (k > 0 and k + 1 >= window and poor) or _dot(r, r) <= least:
            return x, P[: k + 1], HP[: k + 1]
    return x, P, HP


def _dot(a: Array, b: Array) -> float:
    return float(np.einsum("i,i->", a, b))


class Memory:
    """What CG learnt of the Hessian, as the preconditioner of the next steps.

    Source: Morales and Nocedal 2000, SIAM J. Optim. 10, automatic preconditioning by
    limited memory quasi-Newton updating.
    """

    def __init__(self, pairs: int = PAIRS, *, fresh: bool = False) -> None:
        """Keep up to so many pairs of a direction v and the misfit's Hessian A v.

        `fresh`: a whole Hessian serves one iteration.
        """
        self.pairs, self.fresh = pairs, fresh
        self.kept: list[tuple[Array, Array]] = []
        self.whole: Array | None = None  # the Hessian of an earlier iterate, if made
        self.worn = False  # whether that serves no more

    def add(self, V: Array, AV: Array) -> None:
        """Add pairs, rows of V and AV, forgetting the oldest."""
        self.kept = [*self.kept, *zip(V, AV, strict=True)][-self.pairs :]

    def clear(self) -> None:
        """Forget all."""
        self.kept = []

    def inverse(self, temper: float, among: bool = False) -> Callable[[Array], Array]:
        """Return the approximate inverse of I + A / temper: L-BFGS, two loops.

        With `among`, of the directions remembered alone: the rest, of which no more than a
        scale is known, would spoil the step that they give.
        """
        pairs = []
        for v, Av in self.kept:
            y = v + Av / temper
            size = np.sqrt(_dot(v, y))
            pairs.append((v / size, y / size))
        scale = 1.0
        if pairs and self.whole is None:
            # what is not remembered is as stiff as what was last found
            scale = 0.0 if among else _dot(pairs[-1][0], pairs[-1][0])
        whole = None
        if self.whole is not None:
            whole = cho_factor(self.whole / temper + np.eye(len(self.whole)))

        def apply(v: Array) -> Array:
            out = np.ravel(v).copy()
            share = []
            for s, y in reversed(pairs):
                share.append(_dot(s, out))
                out -= share[-1] * y
            if whole is not None:
                out = cho_solve(whole, out)
            out *= scale
            for s, y in pairs:
                out += (share.pop() - _dot(y, out)) * s
            return out

        return apply
