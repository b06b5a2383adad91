"""Dragging at frame rate: vertices led along by 5 mm a frame, every frame an equilibrium.

    OMP_NUM_THREADS=1 python benchmarks/drag.py [mesh.npz ...] [--frames 30] [--step 0.005]

The paper's protocol holds the lowest 10 % of the vertices. One vertex of the upper 85 % is
led down in a straight line, and another round a circle; then ten vertices together, down.
Last, `state.contact` about the state that the drag ended in: the rate of its forces and of
whole fields. Seconds are CPU seconds of one process, and by the clock.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import plantsim as ps


@dataclass(frozen=True)
class Ride:
    """One drag, frame by frame."""

    path: str
    cpu: np.ndarray  # (frames,) [s]
    clock: np.ndarray  # (frames,) [s]
    iterations: int
    factors: int
    residual: float  # worst of the frames
    rotation: float  # [degrees] at most
    off: float  # force in the end, against `solve` to 1e-8, over the largest on the way
    apart: float  # largest distance [m] of a vertex from there
    state: ps.Equilibrium


def straight(frames: int, step: float) -> np.ndarray:
    return np.arange(1, frames + 1)[:, None] * np.array((0.0, 0.0, -step))


def circle(frames: int, step: float) -> np.ndarray:
    """Return a circle through the start whose circumference is the whole way."""
    angle = 2 * np.pi * np.arange(1, frames + 1) / frames
    radius = frames * step / (2 * np.pi)
    return radius * np.stack([1 - np.cos(angle), 0 * angle, -np.sin(angle)], axis=1)


def ride(model: ps.ElasticModel, ids: np.ndarray, name: str, way: np.ndarray) -> Ride:
    drag = model.drag(ids)
    cpu, clock, iterations, factors, residual = [], [], 0, 0, 0.0
    most, turn = 0.0, 0.0
    for goal in way:
        began, at = time.process_time(), time.perf_counter()
        state = drag.to(goal)
        cpu.append(time.process_time() - began)
        clock.append(time.perf_counter() - at)
        iterations += state.stats.iterations
        factors += state.stats.factors
        residual = max(residual, state.stats.residual)
        most = max(most, float(np.linalg.norm(state.force[ids])))
        turn = max(turn, float(np.degrees(state.max_rotation)))
    state = drag.state
    known = model.solve(ps.move(ids, way[-1]), start=state)
    off = float(np.linalg.norm(state.force[ids] - known.force[ids]))
    return Ride(
        name,
        np.array(cpu),
        np.array(clock),
        iterations,
        factors,
        residual,
        turn,
        off / most,
        float(np.linalg.norm(state.displacement - known.displacement, axis=1).max()),
        state,
    )


def rides(model: ps.ElasticModel, frames: int, step: float) -> list[Ride]:
    one, other = ps.sample_touches(model, 2, vertices=1, rng=1)
    ten = ps.sample_touches(model, 1, rng=0)[0]
    return [
        ride(model, one.ids, "one vertex, down", straight(frames, step)),
        ride(model, other.ids, "one vertex, circle", circle(frames, step)),
        ride(model, ten.ids, "ten vertices, down", straight(frames, step)),
    ]


def contact_rates(state: ps.Equilibrium, repeat: int = 2000) -> tuple[float, float, float]:
    """Return ms to prepare the contact with its field, forces a second, fields a second."""
    began = time.process_time()
    contact = state.contact(state.moved)
    d = np.random.default_rng(0).normal(size=(repeat, len(state.moved), 3)) * 1e-3
    contact.displacement(d[0])
    ready = time.process_time() - began
    began = time.process_time()
    for each in d:
        contact.force(each)
    force = (time.process_time() - began) / repeat
    began = time.process_time()
    for each in d[: repeat // 20]:
        contact.displacement(each)
    field = (time.process_time() - began) / (repeat // 20)
    return 1000 * ready, 1 / force, 1 / field


def main(meshes: dict[str, ps.TetMesh], frames: int = 30, step: float = 0.005) -> None:
    print(
        f"{frames} frames of {1000 * step:g} mm\n\n| plant | tets | drag | frames/s "
        "by the clock | by CPU s | "
        "median frame ms | slowest ms | Newton a frame | factors | worst residual | turned "
        "| force off | vertices off mm |\n|" + "---|" * 13
    )
    last = []
    for name, mesh in meshes.items():
        model = ps.ElasticModel(
            mesh, ps.Material.lame(8e6, 7e6), ps.lowest(mesh), kinematics="corotational"
        )
        model.solve()
        for r in rides(model, frames, step):
            print(
                f"| {name} | {len(mesh.tets):,} | {r.path} | "
                f"{frames / r.clock.sum():.1f} | {frames / r.cpu.sum():.1f} | "
                f"{1000 * np.median(r.cpu):.0f} | "
                f"{1000 * r.cpu.max():.0f} | "
                f"{r.iterations / frames:.1f} | {r.factors} | {r.residual:.0e} | "
                f"{r.rotation:.0f} deg | {r.off:.0e} | {1000 * r.apart:.1g} |",
                flush=True,
            )
            last.append((name, r))
    print(
        "\n| plant | contact about the end of | prepared, ms | forces/s | fields/s |\n"
        "|---|---|---|---|---|"
    )
    for name, r in last:
        ready, force, field = contact_rates(r.state)
        print(f"| {name} | {r.path} | {ready:.0f} | {force:,.0f} | {field:,.0f} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--step", type=float, default=0.005)
    options = parser.parse_args()
    chosen = {path.stem: ps.read_mesh(path) for path in options.meshes} or {
        "fork": ps.tetrahedralize(ps.sweep(ps.fork()), order=1)
    }
    main(chosen, options.frames, options.step)
