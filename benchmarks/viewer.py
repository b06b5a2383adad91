"""What a frame of the live viewer costs on the side that computes.

    python benchmarks/viewer.py [--quick]

For plants of some sizes: processor time to take hold of six vertices, and for a frame of a
drag (surface, force, and all messages made for the page, no page open), as a median; the
frames a second that this would allow a core; and the same as a ratio to one fresh sparse
solve, which is the frame of the paper's programme. Of corotational kinematics a frame is
the tangent's answer; `balance` is the processor time of an equilibrium, solved for beside
the frames. What a browser can draw is not measured.
"""

import argparse
import time
from dataclasses import replace

import numpy as np
from scipy.sparse.linalg import spsolve

import plantsim as ps
from plantsim.view.app import Viewer
from plantsim.view.touching import Touching

FRAMES = 60


def plants(quick: bool) -> list[tuple[str, ps.TetMesh]]:
    fork = ps.tetrahedralize(ps.sweep(ps.fork(0.5, 0.02)), order=1)
    out = [("fork, order 1", fork)]
    if not quick:
        for name, limbs in (("pepper", 6), ("apple", 12)):
            skeleton = ps.weber_penn(name, rng=7).pruned(max_limbs=limbs)
            mesh = ps.tetrahedralize(ps.sweep(skeleton))
            out.append((f"{name}, {limbs} limbs, order 2", mesh))
    return out


def far(mesh: ps.TetMesh) -> dict[str, float]:
    """Measure a hand that leads a corotational plant."""
    linear = ps.ElasticModel(mesh, ps.Material(6e9, 0.35, 900.0))
    touching = Touching(replace(linear, kinematics="corotational"))
    tip = mesh.points[mesh.points[:, 2].argmax()]
    ids = touching.patch(tip, mesh.points[mesh.surface_vertices], 6)
    began = time.process_time()
    touching.hold(ids)
    hold = time.process_time() - began
    seconds = []
    for i in range(FRAMES):
        began = time.process_time()
        touching.drag((1e-4 * i, 0, 0))
        seconds.append(time.process_time() - began)
    balances = []
    for depth in (0.01, 0.02, 0.03):
        touching.drag((depth, 0, 0))
        solve = touching.correction()
        began = time.process_time()
        if solve is not None:
            touching.correct(solve())
        balances.append(time.process_time() - began)
    frame, balance = float(np.median(seconds)), float(np.median(balances))
    return {"hold": hold, "frame": frame, "balance": balance}


def measure(mesh: ps.TetMesh) -> dict[str, float]:
    with Viewer(mesh, port=0) as viewer:
        ids = viewer.touching.patch(
            mesh.points[mesh.points[:, 2].argmax()], mesh.points[mesh.surface_vertices], 6
        )
        began = time.process_time()
        viewer.hold(ids)
        viewer.settle()
        hold = time.process_time() - began
        seconds = []
        for i in range(FRAMES):
            began = time.process_time()
            viewer.drag((1e-4 * i, 0, 0))
            viewer.settle()
            seconds.append(time.process_time() - began)
        model = viewer.touching.model
        held = np.union1d(model.fixed_ids, ids)
        free = np.setdiff1d(np.arange(len(mesh.points)), held)
        K = model.pattern.condense(model.stiffness, free, free)
        began = time.process_time()
        spsolve(K.tocsc(), np.ones(K.shape[0]))
        fresh = time.process_time() - began
    return {"hold": hold, "frame": float(np.median(seconds)), "fresh": fresh}


def main(quick: bool) -> None:
    meshes = plants(quick)
    print("| plant | unknowns | hold, s | frame, ms | frames/s | fresh solve / frame |")
    print("|---|---|---|---|---|---|")
    for name, mesh in meshes:
        m = measure(mesh)
        print(
            f"| {name} | {3 * len(mesh.points):,} | {m['hold']:.2f} | "
            f"{1e3 * m['frame']:.2f} | {1 / m['frame']:.0f} | "
            f"{m['fresh'] / m['frame']:.0f} |"
        )
    print("\n| plant, corotational | hold, s | frame, ms | frames/s | balance, s |")
    print("|---|---|---|---|---|")
    for name, mesh in meshes:
        m = far(mesh)
        print(
            f"| {name} | {m['hold']:.2f} | {1e3 * m['frame']:.2f} | "
            f"{1 / m['frame']:.0f} | {m['balance']:.2f} |"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    main(parser.parse_args().quick)
