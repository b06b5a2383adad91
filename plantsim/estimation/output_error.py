"""Output error: the maximum a posteriori estimate, by Gauss-Newton in log-moduli.

    minimise   |(u(theta) - u_seen) / s_u|^2 + |(Q f(theta) - f_felt) / s_f|^2 + |xi|^2

over xi, halved; log theta is linear in xi (see `parameters`). The model's displacements are
compared with those seen, so that noise is not amplified, and what was not seen or felt has
no term. While the misfit is far above the noise it is tempered: divided by what it is on
the whole, at most a quarter less an iteration, so that the strongest readings do not lead
the way alone. Where the cost bends away from its quadratic model within a step, the step
is bent too, by a second-order correction: soft moduli then follow the curved valleys that
stiff readings leave them.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.elastic.material import Material
from plantsim.elastic.model import ElasticModel
from plantsim.errors import EstimateError, SolverError
from plantsim.estimation.cases import Case
from plantsim.estimation.direction import FEW, FEWER, Memory, direction_of
from plantsim.estimation.large_response import respond
from plantsim.estimation.parameters import Chart
from plantsim.estimation.response import Response

FAR = 2.0  # largest change of a log-modulus in one step
SUFFICIENT = 1e-4  # of the decrease that the gradient promises (Armijo)
HALVINGS = 12
COOLING = 4.0  # the misfit is divided by so much less every iteration, at most
DEAR = 25.0  # times what is enough to stop at: that rule counts no larger gains
FIRST = 2  # touches that lead the way
QUICK = 16.0  # COOLING of theirs
ROUGH = 100.0  # times the tolerance at which they stop
BRIEF = 12  # iterations that they have
EXPLAINED = 4.0  # misfit over noise, squared, above which they would mislead
STRAIGHT = 0.5  # of the forecast decrease: less, and a step is bent


@dataclass(frozen=True)
class Step:
    """One iteration of the estimate."""

    iteration: int
    cost: float
    gradient: float  # 2-norm in xi, where the prior has unit variance
    change: float  # largest change of a log-modulus in the step that led here
    share: float  # of the Gauss-Newton step that was taken
    inner: int  # CG iterations
    seconds: float


@dataclass(frozen=True)
class MapStats:
    """How a maximum a posteriori estimate was found."""

    method: str
    status: str  # "converged"
    iterations: int
    parameters: int
    readings: int  # numbers seen and felt, after proportional touches are joined
    cases: int
    cost: float
    misfit: float  # the part of the cost that is due to the readings
    path: tuple[Step, ...]
    seconds: float


@dataclass(frozen=True)
class Options:
    """When to stop, and how hard to work."""

    tolerance: float = 3e-4  # stop when a step promises less than this share of the cost
    iterations: int = 40
    inner: int = 200  # CG iterations of one Gauss-Newton step
    progress: Callable[[Step], Any] | None = None


class Objective:
    """The cost at one xi, its gradient and Gauss-Newton Hessian."""

    def __init__(
        self,
        model: ElasticModel,
        chart: Chart,
        cases: Sequence[Case],
        xi: Array,
        like: Response | None = None,
    ) -> None:
        """Solve for every case; `like` is one at another xi, whose pattern is shared."""
        self.chart, self.cases, self.xi = chart, cases, xi
        mu, lam = np.split(chart.moduli(xi), 2)
        material = Material.lame(mu, lam, model.material.density)
        self.model = model.with_material(material)
        self.response = respond(self.model, cases, like)
        free = (3 * self.response.free[:, None] + np.arange(3)).ravel()
        self.weight = np.stack([c.displacement_weight[free] for c in cases]).T
        seen = np.stack([c.displacement[free] for c in cases]).T
        self.miss_u = self.response.u - seen
        self.miss_f = [
            c.feel @ f - c.force for c, f in zip(cases, self.response.force, strict=True)
        ]
        self.misfit = 0.5 * float(np.vdot(self.miss_u, self.weight * self.miss_u))
        for c, r in zip(cases, self.miss_f, strict=True):
            self.misfit += 0.5 * float(r @ (c.force_weight * r))
        self.prior = 0.5 * float(xi @ xi)
        self.temper = 1.0  # the misfit counts that many times less

    @property
    def readings(self) -> int:
        """Numbers seen and felt."""
        seen = sum(int((c.displacement_weight > 0).sum()) for c in self.cases)
        return seen + sum(len(c.force) for c in self.cases)

    @property
    def cost(self) -> float:
        """Return what is minimised."""
        return self.misfit / self.temper + self.prior

    def _weigh(
        self, own: slice, du: Array, felt: Sequence[Array]
    ) -> tuple[Array, list[Array]]:
        """Return displacements (free, k) and readings of force of some cases, weighed."""
        cases = zip(self.cases[own], felt, strict=True)
        return self.weight[:, own] * du, [c.feel.T @ (c.force_weight * r) for c, r in cases]

    def _back(self, by_u: Array, by_f: Sequence[Array]) -> Array:
        """Return the weighed readings' pull on xi."""
        pulled = self.response.pull(*self._weigh(slice(None), by_u, by_f))
        return self.chart.adjoint(pulled)

    def gradient(self) -> Array:
        """Return the derivative of the cost by xi, exactly."""
        return self.xi + self._back(self.miss_u, self.miss_f) / self.temper

    def bend(self, there: "Objective", step: Array) -> Array:
        """Return the pull on xi of what readings `there` are off the linear forecast."""
        du = there.miss_u - self.miss_u
        df = [b - a for a, b in zip(self.miss_f, there.miss_f, strict=True)]
        return (self._back(du, df) - self.hessian(step)) / self.temper

    def hessian(self, v: Array) -> Array:
        """Return the Gauss-Newton Hessian of the misfit, without the prior's, times v."""

        def weigh(own: slice, du: Array, df: list[Array]) -> tuple[Array, list[Array]]:
            cases = zip(self.cases[own], df, strict=True)
            return self._weigh(own, du, [c.feel @ f for c, f in cases])

        return self.chart.adjoint(self.response.around(self.chart.log(v), weigh))

    def small_hessian(self) -> Array:
        """Return the same as a matrix (q, q) over the logarithms of the chart's columns."""
        q = self.chart.columns.shape[1]
        H = np.zeros((q, q))
        for t, c in enumerate(self.cases):
            seen = np.flatnonzero(self.weight[:, t])
            du, df = self.response.change_of(t, self.chart.columns)
            du = du[seen] * np.sqrt(self.weight[seen, t])[:, None]
            felt = (c.feel @ df) * np.sqrt(c.force_weight)[:, None]
            H += du.T @ du + felt.T @ felt
        return H

    @cached_property
    def dense_hessian(self) -> Array:
        """The Gauss-Newton Hessian of the misfit by xi, (p, p)."""
        mix = self.chart.unwhiten(self.chart.mix.T.toarray()).T  # (q, p)
        return mix.T @ self.small_hessian() @ mix


def solve(
    model: ElasticModel, chart: Chart, cases: Sequence[Case], options: Options
) -> tuple[Objective, MapStats]:
    """Return the objective at its minimum, and how that was found.

    Where the Hessian is made whole, and not at every iteration, a few touches lead the way:
    their minimum, roughly, is where all begin, if it explains the few. Where it does not,
    the model errs, and fits them by moduli far off.
    """
    track = _Track(options)
    start = None
    if FEWER < chart.columns.shape[1] <= FEW and len(cases) > 2 * FIRST:
        few = sorted(cases, key=lambda c: not len(c.force))[:FIRST]
        rough = replace(
            options,
            tolerance=min(ROUGH * options.tolerance, 0.1),
            iterations=min(BRIEF, options.iterations),
        )
        there, why_not = _descend(_first(model, chart, few), rough, track, few=True)
        if not why_not and 2 * there.misfit < EXPLAINED * there.readings:
            start = there.xi
    if start is None:
        here = _first(model, chart, cases)
    else:
        here = Objective(model, chart, cases, start)
    here, why_not = _descend(here, options, track)
    if why_not:
        raise EstimateError(why_not)
    stats = MapStats(
        "map",
        "converged",
        len(track.path) - 1,
        chart.size,
        here.readings,
        len(cases),
        here.cost,
        here.misfit,
        tuple(track.path),
        time.perf_counter() - track.began,
    )
    return here, stats


class _Track:
    """The path so far, told to the caller."""

    def __init__(self, options: Options) -> None:
        self.path: list[Step] = []
        self.began = time.perf_counter()
        self.progress = options.progress

    def add(self, cost: float, gradient: float, how: tuple[float, float, int]) -> None:
        seconds = time.perf_counter() - self.began
        self.path.append(Step(len(self.path), cost, gradient, *how, seconds))
        if self.progress is not None:
            self.progress(self.path[-1])


def _descend(
    here: Objective, options: Options, track: _Track, few: bool = False
) -> tuple[Objective, str]:
    """Return the objective at the minimum found from here, and why it is none, or "".

    `few`: of few touches, roughly, for others to begin from.
    """
    memory = Memory(fresh=few)
    cooling = QUICK if few else COOLING
    change, share, inner = 0.0, 1.0, 0
    temper = np.inf
    for count in range(options.iterations + 1):
        temper = max(1.0, min(temper / cooling, 2 * here.misfit / here.readings))
        here.temper = temper
        g = here.gradient()
        size = float(np.linalg.norm(g))
        track.add(here.cost, size, (change, share, inner))
        enough = 2 * options.tolerance * max(here.cost, here.readings / 2)
        dear = DEAR * enough / 2 if temper == 1 else np.inf
        direction, inner = direction_of(here, g, memory, options.inner, dear)
        promise = -float(g @ direction)  # twice the decrease of the quadratic model
        if temper == 1 and promise <= enough:
            return here, ""
        if count == options.iterations:
            return here, (
                f"map: not converged after {options.iterations} iterations; the next step "
                f"promises {promise / 2 / here.cost:.1e} of the cost, wanted "
                f"{options.tolerance:.0e}. Raise iterations=, or check the noise given."
            )
        far = float(np.abs(here.chart.log(direction)).max())
        there, share = _search(
            here,
            direction,
            promise,
            min(1.0, FAR / far),
            lambda y, here=here, dear=dear: direction_of(
                here, y, memory, options.inner, dear
            )[0],
        )
        if there is None:
            return here, (
                "map: no step lowers the cost, though the gradient is "
                f"{size:.2g}. The readings may be exact beyond rounding: give noise."
            )
        change = share * far
        here = there
    raise AssertionError("the last pass returns")


def _first(model: ElasticModel, chart: Chart, cases: Sequence[Case]) -> Objective:
    """Return the objective at the prior's moduli times what fits the forces best.

    Without loads the field does not depend on that factor; forces are proportional to it.
    """
    none = Objective(model, chart, cases, np.zeros(chart.size))
    if any(c.load.any() for c in cases):
        return none
    above = below = 0.0
    for c, f in zip(cases, none.response.force, strict=True):
        model_f = c.feel @ f
        above += float(model_f @ (c.force_weight * c.force))
        below += float(model_f @ (c.force_weight * model_f))
    if not (above > 0 and below > 0):
        return none
    xi = chart.start(float(np.log(above / below)))
    return Objective(model, chart, cases, xi, none.response)


def _search(
    here: Objective,
    direction: Array,
    promise: float,
    share: float,
    newton: Callable[[Array], Array],
) -> tuple[Objective | None, float]:
    """Return the objective after the largest share of a step that lowers the cost.

    And the share. A step that brings less than forecast is bent by the second-order
    correction of its end, half the geodesic acceleration of Transtrum and
    Sethna 2012, arXiv:1201.5885; `newton` solves for it.
    """
    curve: Array | None = None  # the correction at a share of 1
    for _ in range(HALVINGS):
        step = share * direction
        there = _at(here, here.xi + step + (0 if curve is None else share**2 * curve))
        forecast = promise * share * (1 - share / 2)
        if (
            there is not None
            and curve is None
            and here.cost - there.cost < STRAIGHT * forecast
        ):
            curve = newton(here.bend(there, step)) / share**2
            bent = _at(here, here.xi + step + share**2 * curve)
            if bent is not None and bent.cost < there.cost:
                there = bent
        if there is not None and here.cost - there.cost >= SUFFICIENT * share * promise:
            return there, share
        share /= 2
    return None, 0.0


def _at(here: Objective, xi: Array) -> Objective | None:
    """Return the objective at xi, as tempered as here; None where it cannot be solved."""
    try:
        there = Objective(here.model, here.chart, here.cases, xi, here.response)
    except SolverError:
        return None
    there.temper = here.temper
    return there
