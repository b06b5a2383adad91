"""Direction: the Gauss-Newton step, by CG with what was learnt before, or a whole Hessian.

An iteration of CG takes two back-solves a case, the whole Hessian one a case and column.
So one is made for few columns, and preconditions CG at later iterates until it is worn.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import LinearOperator, cg

from plantsim.arrays import Array

if TYPE_CHECKING:
    from plantsim.estimation.output_error import Objective

FEW = 128  # columns of a chart up to which a Hessian is made, not only applied
FEWER = 20  # up to which that is as cheap as CG, and done at every iteration
PAIRS = 100  # directions remembered for the preconditioner
WORN = 15  # CG iterations from which on a whole Hessian is made anew
GAIN = 0.1  # of the mean gain of CG's iterations: less, and it stops
RESIDUAL = 1e-6  # of the gradient at which CG stops anyhow


def direction_of(
    here: "Objective",
    g: Array,
    memory: "Memory",
    most: int,
    dear: float,
    gain: float = GAIN,
) -> tuple[Array, int]:
    """Return the Gauss-Newton step, and the CG iterations it took, `most` at most."""
    p, q = len(g), here.chart.columns.shape[1]
    if q <= FEWER or (q <= FEW and (memory.whole is None or memory.worn)):
        memory.whole, memory.worn = here.dense_hessian, False
        memory.clear()
        return -np.linalg.solve(here.dense_hessian / here.temper + np.eye(p), g), 0

    def product(v: Array) -> Array:
        v = np.ravel(v).copy()
        Av = here.hessian(v)
        new.append((v, Av))
        return v + Av / here.temper

    new: list[tuple[Array, Array]] = []
    H: Any = LinearOperator((p, p), matvec=product, dtype=float)  # type: ignore[call-arg]
    M: Any = LinearOperator((p, p), matvec=memory.inverse(here.temper), dtype=float)  # type: ignore[call-arg]
    watch = _Watch(g, gain, dear)
    try:
        step, _ = cg(H, -g, M=M, rtol=RESIDUAL, maxiter=most, callback=watch)
    except _Enough:
        step = watch.step
    memory.add(new)
    memory.worn = watch.count > WORN
    return step, watch.count


class Memory:
    """What CG learnt of the Hessian, as the preconditioner of the next steps.

    Source: Morales and Nocedal 2000, SIAM J. Optim. 10, automatic preconditioning by
    limited memory quasi-Newton updating.
    """

    def __init__(self, pairs: int = PAIRS) -> None:
        """Keep up to so many pairs of a direction v and the misfit's Hessian A v."""
        self.pairs = pairs
        self.kept: list[tuple[Array, Array]] = []
        self.whole: Array | None = None  # the Hessian of an earlier iterate, if made
        self.worn = False  # whether that serves no more

    def add(self, new: Sequence[tuple[Array, Array]]) -> None:
        """Add pairs, forgetting the oldest."""
        self.kept = [*self.kept, *new][-self.pairs :]

    def clear(self) -> None:
        """Forget all."""
        self.kept = []

    def inverse(self, temper: float) -> Callable[[Array], Array]:
        """Return the approximate inverse of I + A / temper: L-BFGS, two loops."""
        pairs = []
        for v, Av in self.kept:
            y = v + Av / temper
            size = np.sqrt(np.einsum("i,i", v, y))
            pairs.append((v / size, y / size))
        whole = None
        if self.whole is not None:
            whole = cho_factor(self.whole / temper + np.eye(len(self.whole)))

        def apply(v: Array) -> Array:
            out = np.ravel(v).copy()
            share = []
            for s, y in reversed(pairs):
                share.append(float(np.einsum("i,i", s, out)))
                out -= share[-1] * y
            if whole is not None:
                out = cho_solve(whole, out)
            for s, y in pairs:
                out += (share.pop() - float(np.einsum("i,i", y, out))) * s
            return out

        return apply


class _Enough(Exception):
    """CG has gone far enough: no error."""


class _Watch:
    """Stops CG where its next step would gain little of what it has gained.

    From zero, CG's k-th point x has the quadratic model g x / 2. The rule is that of Nash
    and Sofer 1990, Oper. Res. Lett. 9: stop when an iteration gains less than a share of
    the mean of those before it. Large gains at first do not hide what is still to be had:
    they count as `dear` at most.
    """

    def __init__(self, g: Array, gain: float, dear: float) -> None:
        self.g, self.least, self.dear = g, gain, dear
        self.count, self.gained = 0, 0.0
        self.step = np.zeros_like(g)

    def __call__(self, x: Array) -> None:
        self.count += 1
        gained = -0.5 * float(self.g @ x)
        now = gained - self.gained
        self.gained, self.step = gained, x.copy()
        if self.count > 1 and self.count * now < self.least * min(gained, self.dear):
            raise _Enough
