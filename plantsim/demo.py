"""The whole chain once: from a seed to a bent plant, its fitted stiffness, and pictures."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from plantsim.arrays import Array
from plantsim.elastic.files import write_state
from plantsim.elastic.loads import move
from plantsim.elastic.material import Material
from plantsim.elastic.model import ElasticModel
from plantsim.errors import DependencyError
from plantsim.estimation.estimate import estimate
from plantsim.estimation.files import write_observations
from plantsim.estimation.observation import observe
from plantsim.estimation.parameters import per_limb
from plantsim.mesh.files import write_mesh
from plantsim.mesh.tetmesh import TetMesh
from plantsim.plant.weber_penn import WeberPenn, species, weber_penn
from plantsim.solid.sweep import sweep
from plantsim.solid.tetrahedralize import tetrahedralize
from plantsim.view.figures import figure_deformation, figure_material

YOUNG = 6e9  # the prior's Young's modulus [Pa]; the plant's limbs scatter about it
TOUCHES = 5
PUSHED = 10  # vertices moved together, as in the paper
PUSH = 0.01  # [m] downwards
STAGES = 10  # that the walk tells of
DRAWN = 3.0  # displacements in the picture, times the real ones


@dataclass(frozen=True)
class Stage:
    """One line of the demo's table."""

    name: str
    made: str
    seconds: float
    paper: str = ""  # what the paper reports for the same stage


def young_aspen() -> WeberPenn:
    """Return the demo's parameters: an aspen sapling about 2 m high."""
    return species("quaking_aspen").with_(
        scale=2.0,
        scale_v=0.3,
        scale0_v=0.0,
        lobes=0,
        base_size=0.25,
        ratio=0.012,
        ratio_power=0.8,
        flare=0.4,
        branches=(1, 14, 0, 0),
        length=(1.0, 0.42, 0.6, 0.0),
    )


def run(seed: int, out: Path, tell: Callable[[Stage], None]) -> list[Path]:
    """Walk the chain, tell each stage as it ends; return the files written to `out`."""
    clock = time.perf_counter()

    def done(name: str, made: str, paper: str = "") -> None:
        nonlocal clock
        now = time.perf_counter()
        tell(Stage(name, made, now - clock, paper))
        clock = time.perf_counter()

    out.mkdir(parents=True, exist_ok=True)
    skeleton = weber_penn(young_aspen(), rng=seed, levels=2).pruned(min_radius=0.0045)
    limbs = skeleton.limbs
    done("grow", f"{len(limbs)} limbs, {skeleton.height:.2f} m high", "0.007 s")
    mesh = tetrahedralize(sweep(skeleton))
    worst = mesh.quality.min()
    done("mesh", f"{len(mesh.tets):,} tets of order 2, worst gamma {worst:.2f}", "52.5 s")
    rng = np.random.default_rng(seed)
    modulus = YOUNG * np.exp(rng.normal(0, 0.35, len(limbs)))
    truth = ElasticModel(mesh, Material(modulus[mesh.region], 0.35, 900.0))
    truth.stiffness  # noqa: B018  made at first use
    unknowns = 3 * (len(mesh.points) - len(mesh.sets["base"]))
    done("stiffness", f"K of {unknowns:,} unknowns", "~10 s")
    ids = touch_points(mesh, rng)
    state = truth.solve(move(ids, (0, 0, -PUSH)))
    turn = np.degrees(state.max_rotation)
    done(
        "push",
        f"{PUSHED} vertices down {100 * PUSH:.0f} cm; linear theory, at {turn:.0f} degrees",
    )
    contact = truth.contact(ids)
    done("prepare", f"contact at {PUSHED} vertices, for any motion of theirs")
    seconds = []
    for depth in np.linspace(0, PUSH, 15):
        began = time.perf_counter()
        contact.displacement((0, 0, -depth))
        seconds.append(time.perf_counter() - began)
    clock = time.perf_counter() - float(np.median(seconds))
    done("frame", "whole field and contact force, median of 15", "~0.025 s")
    touches = [
        observe(truth, move(touch_points(mesh, rng), (0, 0, -PUSH))) for _ in range(TOUCHES)
    ]
    done("touch", f"{TOUCHES} simulated touches, {PUSHED} vertices each")
    prior = truth.with_material(Material(YOUNG, 0.35, 900.0))
    found = estimate(
        prior, touches, parameters=per_limb(), method="force-balance", rows="balance"
    )
    before = float(np.median(np.abs(YOUNG / modulus - 1)))
    fitted = np.array([found.young()[limb.name] for limb in limbs])
    after = float(np.median(np.abs(fitted / modulus - 1)))
    done("estimate", f"Young of a limb: median error {before:.1%} -> {after:.2%}")
    files = [
        write_mesh(mesh, out / "plant.msh"),
        write_state(state, out / "pushed.vtu"),
        write_observations(touches, out / "touches.npz"),
    ]
    done("write", ", ".join(f.name for f in files))
    try:
        files += [
            figure_deformation(state, out / "pushed.png", scale=DRAWN),
            figure_material(mesh, found.material.young / 1e9, out / "stiffness.png"),
        ]
        done("draw", ", ".join(f.name for f in files[3:]))
    except DependencyError as why:
        done("draw", str(why))
    return files


def touch_points(mesh: TetMesh, rng: np.random.Generator) -> Array:
    """Return random corners on the surface of the branches."""
    trunk = np.unique(mesh.tets[mesh.region == 0])
    corners = np.setdiff1d(np.unique(mesh.surface[:, :3]), trunk)
    return np.sort(rng.choice(corners, PUSHED, replace=False))
