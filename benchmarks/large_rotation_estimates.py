"""Young's modulus of each limb from touches up to 0.15 m deep, by either kinematics.

    python benchmarks/large_rotation_estimates.py [--repeat 5]

A fork of 0.5 m limbs bends as the corotational model says, and the prior is 6 GPa all over.
First, force balance without noise, at the touched vertices or over all free ones. Then the
maximum a posteriori estimate with 1 mm of noise on every displacement and 2 % on forces,
four touches, repeated with other noise: mean error of each limb, and in how many cases the
90 % interval holds the truth. Last a reference tree, where one is given:

    python benchmarks/large_rotation_estimates.py --mesh tree.npz
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import plantsim as ps
from plantsim.elastic.loads import Move

TRUTH = np.array([6e9, 9e9, 3.5e9])
DEPTHS = (0.001, 0.01, 0.05, 0.15)
KINDS = ("linear", "corotational")


def fork() -> tuple[ps.ElasticModel, list[np.ndarray]]:
    """Return the true plant, and the vertices about the tips of its two branches."""
    skeleton = ps.fork(0.5, 0.012)
    mesh = ps.tetrahedralize(ps.sweep(skeleton), order=1)
    material = ps.Material(TRUTH[np.asarray(mesh.region)], 0.3)
    truth = ps.ElasticModel(mesh, material, kinematics="corotational")
    tips = [ps.nearest_vertices(mesh, limb.tip, count=5) for limb in skeleton.limbs[1:]]
    return truth, tips


def moves(tips: list[np.ndarray], depth: float) -> Iterator[Move]:
    for tip in tips:
        for way in ((0.6, 0.0, -0.8), (0.0, 1.0, 0.0)):
            yield ps.move(tip, depth * np.array(way))


def guess(truth: ps.ElasticModel, kinematics: str) -> ps.ElasticModel:
    """Return the prior of either kinematics."""
    material = ps.Material(6e9, 0.3)
    return ps.ElasticModel(truth.mesh, material, truth.fixed_ids, kinematics=kinematics)


def balances(depth: float) -> dict[tuple[str, str], dict[str, float] | str]:
    """Return each limb's relative error by kinematics and rows, or why there is none."""
    truth, tips = fork()
    seen = [ps.observe(truth, move) for move in moves(tips, depth)]
    out = {}
    for kinematics in KINDS:
        model = guess(truth, kinematics)
        for rows in ("contact", "balance"):
            try:
                found = ps.estimate(model, seen, method="force-balance", rows=rows)
            except ps.EstimateError as why:
                out[kinematics, rows] = str(why).split(".")[0]
                continue
            pairs = zip(found.young().items(), TRUTH, strict=True)
            out[kinematics, rows] = {name: E / true - 1 for (name, E), true in pairs}
    return out


@dataclass(frozen=True)
class Fit:
    """Estimates of all limbs, once for each noise."""

    error: np.ndarray  # (repeat, limbs) of log E
    std: np.ndarray  # (repeat, limbs)
    held: int  # of repeat x limbs: the 90 % interval holds the truth
    misfit: float  # rms of misfit over noise, mean
    seconds: float  # CPU of one estimate


def observed(
    truth: ps.ElasticModel, touches: list[Move], rng: np.random.Generator
) -> list[ps.Observation]:
    """Return touches seen to 1 mm, and felt to 2 % of the root mean square force."""
    out = []
    for touch in touches:
        exact = ps.observe(truth, touch)
        assert exact.force is not None
        noise = 0.02 * float(np.sqrt(np.mean(exact.force**2)))
        out.append(
            ps.observe(truth, touch, displacement_noise=1e-3, force_noise=noise, rng=rng)
        )
    return out


def maps(
    truth: ps.ElasticModel,
    prior: ps.ElasticModel,
    touches: list[Move],
    young: np.ndarray,
    repeat: int,
) -> Fit:
    """Return maximum a posteriori estimates of limbs whose true moduli are `young`."""
    errors, stds, held, misfits, seconds = [], [], 0, [], []
    for seed in range(repeat):
        seen = observed(truth, touches, np.random.default_rng(seed))
        began = time.process_time()
        found = ps.estimate(prior, seen)
        seconds.append(time.process_time() - began)
        bounds = found.interval(0.9)
        E = np.array(list(found.young().values()))
        errors.append(np.log(E / young))
        stds.append(list(found.std.values()))
        held += sum(
            low < true < high
            for (low, high), true in zip(bounds.values(), young, strict=True)
        )
        misfits.append(np.sqrt(2 * found.stats.misfit / found.stats.readings))
    return Fit(
        np.array(errors),
        np.array(stds),
        held,
        float(np.mean(misfits)),
        float(np.median(seconds)),
    )


def show_balances() -> None:
    print(
        "Force balance, no noise\n\n| depth | kinematics | rows | limb 0 | limb 1 | limb 2 "
        "|\n|---|---|---|---|---|---|"
    )
    for depth in DEPTHS:
        for (kinematics, rows), limbs in balances(depth).items():
            told = (
                f"{limbs} | | "
                if isinstance(limbs, str)
                else " | ".join(f"{error:+.2%}" for error in limbs.values())
            )
            print(f"| {1000 * depth:g} mm | {kinematics} | {rows} | {told} |", flush=True)


def show_maps(
    repeat: int, depths: tuple[float, ...] = DEPTHS
) -> dict[tuple[float, str], Fit]:
    """Print and return the fits by depth and kinematics."""
    print(
        "\nMaximum a posteriori, 1 mm and 2 % of noise: error of each limb, mean over "
        f"{repeat} noises (largest); intervals of 90 % that hold the truth\n\n| depth | "
        "kinematics | limb 0 | limb 1 | limb 2 | std | hold | misfit / noise | CPU s |\n"
        "|" + "---|" * 9
    )
    truth, tips = fork()
    out = {}
    for depth in depths:
        touches = list(moves(tips, depth))
        for kinematics in KINDS:
            fit = maps(truth, guess(truth, kinematics), touches, TRUTH, repeat)
            out[depth, kinematics] = fit
            limbs = " | ".join(
                f"{np.expm1(one.mean()):+.2%} ({np.expm1(one[np.abs(one).argmax()]):+.2%})"
                for one in fit.error.T
            )
            print(
                f"| {1000 * depth:g} mm | {kinematics} | {limbs} | {fit.std.mean():.2%} | "
                f"{fit.held} of {fit.error.size} | {fit.misfit:.2f} | {fit.seconds:.2g} |",
                flush=True,
            )
    return out


def show_tree(path: Path, repeat: int) -> None:
    """Fit the parts of a reference tree by height, each with its own modulus."""
    mesh = ps.read_mesh(path)
    height = mesh.points[mesh.tets].mean(axis=1)[:, 2]
    part = np.searchsorted(np.quantile(height, (0.35, 0.55, 0.75)), height)
    names = tuple(f"part {i}" for i in range(4))
    mesh = ps.TetMesh(mesh.points, mesh.tets, part, dict(mesh.sets), names)
    young = np.array([6e9, 9e9, 3.5e9, 5e9])
    fixed = ps.lowest(mesh)
    truth = ps.ElasticModel(
        mesh, ps.Material(young[part], 0.3), fixed, kinematics="corotational"
    )
    touches = [touch.last for touch in ps.sample_touches(truth, 6, rng=0)]
    print(
        f"\n{path.stem}, {len(mesh.tets):,} tets, six touches of ten vertices, 0.15 m"
        "\n\n| kinematics | part 0 | part 1 | part 2 | part 3 | hold | misfit / noise | "
        "CPU s |\n"
        "|" + "---|" * 8
    )
    for kinematics in KINDS:
        fit = maps(truth, guess(truth, kinematics), touches, young, repeat)
        parts = " | ".join(f"{np.expm1(one.mean()):+.2%}" for one in fit.error.T)
        print(
            f"| {kinematics} | {parts} | {fit.held} of {fit.error.size} | {fit.misfit:.2f} "
            f"| {fit.seconds:.2g} |",
            flush=True,
        )


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--mesh", type=Path)
    options = parser.parse_args(argv)
    if options.mesh is not None:
        show_tree(options.mesh, options.repeat)
        return
    show_balances()
    show_maps(options.repeat)


if __name__ == "__main__":
    main()
