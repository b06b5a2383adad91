"""One plant of a data set, from its number to arrays: grown, meshed, bent, touched."""

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from plantsim.arrays import Array
from plantsim.datasets.draw import (
    GROWTH,
    MODULI,
    NOISE,
    TOUCHES,
    Drawn,
    drawn,
    limb_field,
    split_of,
    stream,
)
from plantsim.datasets.recipe import Recipe, Touching
from plantsim.elastic.loads import move as moved_by
from plantsim.elastic.material import Material
from plantsim.elastic.model import ElasticModel
from plantsim.elastic.weight import gravity
from plantsim.errors import ModelError
from plantsim.mesh.tetmesh import TetMesh
from plantsim.plant.skeleton import Skeleton
from plantsim.plant.weber_penn import weber_penn
from plantsim.solid.sweep import sweep
from plantsim.solid.tetrahedralize import tetrahedralize
from plantsim.touch.sequences import TOUCHABLE

PACKAGES = (  # whatever has a hand in the numbers
    *("plantsim", "numpy", "scipy", "scikit-fem", "gmsh", "h5py"),
    *("pyamg", "pypardiso", "manifold3d", "mmgpy", "pytetwild"),
)


@dataclass(frozen=True, eq=False)
class Made:
    """A plant's arrays by their place in the file, its facts, and seconds by stage."""

    arrays: dict[str, Array]
    facts: dict[str, Any]
    seconds: dict[str, float]


def make_plant(recipe: Recipe, plant: int) -> Made:
    """Return plant number `plant` of a recipe.

    Raises what the stages raise: GeometryError, MeshError, ModelError, SolverError.
    """
    seconds: dict[str, float] = {}
    draw = drawn(recipe, plant)
    with _timed(seconds, "grow"):
        skeleton = weber_penn(
            draw.model,
            stream(recipe, plant, GROWTH),
            draw.kind.levels,
            min_radius=draw.kind.min_radius or None,
            max_limbs=draw.max_limbs,
        )
    with _timed(seconds, "mesh"):
        kernel: Any = recipe.mesh.kernel
        mesh = tetrahedralize(
            sweep(skeleton), recipe.mesh.size, order=recipe.mesh.order, kernel=kernel
        )
    with _timed(seconds, "model"):
        young = limb_moduli(skeleton, draw, stream(recipe, plant, MODULI))
        region = np.asarray(mesh.region)
        material = Material(young[region], draw.poisson, draw.density)
        model = ElasticModel(mesh, material, fixed="base")
        sag = model.solve(gravity())
    with _timed(seconds, "touch"):
        touched = touch(model, recipe.touch, recipe.seed, stream(recipe, plant, TOUCHES))
        arrays = noisy(touched, recipe.touch, stream(recipe, plant, NOISE))
    arrays |= _skeleton_arrays(skeleton) | _mesh_arrays(mesh)
    arrays["material/young"] = young
    arrays["material/poisson"] = np.full(len(young), draw.poisson)
    arrays["material/density"] = np.full(len(young), draw.density)
    attempts = (mesh.report or {})["attempts"]
    push = np.linalg.norm(touched["force"].sum(axis=2), axis=-1)[:, -1:]
    deep = np.linalg.norm(touched["move"], axis=-1).max(axis=2)[:, -1:]
    facts = {
        "plant": plant,
        "species": draw.kind.name,
        "split": split_of(recipe, plant),
        "seed": recipe.seed,
        "fingerprint": recipe.fingerprint,
        "limbs": len(skeleton.first),
        "nodes": len(mesh.points),
        "tets": len(mesh.tets),
        "touches": len(arrays["touches/moved"]),
        "height_m": skeleton.height,
        "volume_m3": mesh.volume,
        "mass_kg": model.mass,
        "young_pa": draw.young,
        "worst_gamma": float(mesh.quality.min()),
        "median_gamma": float(np.median(mesh.quality)),
        "sag_m": float(np.linalg.norm(sag.displacement, axis=1).max()),
        "sag_rotation_rad": float(sag.max_rotation),
        "touch_force_n": float(np.median(push)) if push.size else 0.0,
        "touch_depth_m": float(np.median(deep)) if deep.size else 0.0,
        "backward_error": float(sag.stats.backward_error),
        "mesh_attempts": len(attempts),
        "mesher": f"{recipe.mesh.kernel}, {attempts[-1]['algorithm']}",
        "solver": sag.stats.backend,
        "note": skeleton.note,
        "parameters": json.dumps(asdict(draw.model), sort_keys=True),
        "versions": json.dumps({name: _version(name) for name in PACKAGES}),
    }
    return Made(arrays, facts, seconds)


def limb_moduli(skeleton: Skeleton, draw: Drawn, rng: np.random.Generator) -> Array:
    """Return Young's modulus of each limb, (limbs,) [Pa]."""
    field = limb_field(skeleton.carrier, draw.kind.correlation, rng)
    return draw.young * np.exp(draw.kind.spread * field)


def touch(
    model: ElasticModel, how: Touching, seed: int, rng: np.random.Generator
) -> dict[str, Array]:
    """Return touches without noise: moved, move, force, seen, displacement.

    Shapes (T, k), (T, S, k, 3), (T, S, k, 3), (V,), (T, S, V, 3). Limbs are touched alike
    often, on their surface, above the lowest 15 % of the vertices by height. A model that
    has its base factored already takes one solve a touch.
    """
    mesh = model.mesh
    pools = _pools(model, how.vertices)
    seen = _seen(mesh, how, rng)
    share = np.arange(1, how.steps + 1) / how.steps
    moved, move, force, displacement = [], [], [], []
    for _ in range(how.touches):
        pool = pools[int(rng.integers(len(pools)))]
        first = int(rng.choice(pool))
        away = np.linalg.norm(mesh.points[pool] - mesh.points[first], axis=1)
        ids = pool[np.argsort(away, kind="stable")[: how.vertices]]
        way = _direction(mesh, ids, first, how, rng)
        state = model.solve(moved_by(ids, how.depth.draw(rng) * way))
        total = float(np.linalg.norm(state.force[ids].sum(axis=0)))
        turn = float(np.degrees(state.max_rotation))
        factor = 1 / max(1.0, turn / how.max_rotation, total / how.max_force)
        steps = (factor * share)[:, None, None]
        moved.append(ids)
        move.append(steps * state.displacement[ids])
        force.append(steps * state.force[ids])
        displacement.append(steps * state.displacement[seen])
    shape = (how.touches, how.steps)
    return {
        "moved": np.array(moved, dtype=np.int32).reshape(-1, how.vertices),
        "move": np.array(move).reshape(*shape, how.vertices, 3),
        "force": np.array(force).reshape(*shape, how.vertices, 3),
        "seen": seen.astype(np.int32),
        "displacement": np.array(displacement).reshape(*shape, len(seen), 3),
    }


def noisy(
    touched: dict[str, Array], how: Touching, rng: np.random.Generator
) -> dict[str, Array]:
    """Return the touches as they are stored: as measured, and as they are."""
    out = {f"touches/{name}": value for name, value in touched.items()}
    for name, noise in (
        ("force", how.force_noise),
        ("displacement", how.displacement_noise),
    ):
        true = touched[name]
        out[f"touches/true_{name}"] = true
        out[f"touches/{name}"] = true + noise * rng.normal(size=true.shape)
    out["touches/noise"] = np.array([how.force_noise, how.displacement_noise])
    return out


def _pools(model: ElasticModel, least: int) -> list[Array]:
    """Return the vertices that can be touched, limb by limb."""
    mesh = model.mesh
    z = mesh.points[:, 2]
    high = mesh.surface_vertices[z[mesh.surface_vertices] >= np.quantile(z, 1 - TOUCHABLE)]
    free = np.zeros(len(z), dtype=bool)
    free[high] = True
    free[model.fixed_ids] = False
    region = np.asarray(mesh.region)
    own = (np.unique(mesh.tets[region == r]) for r in range(len(mesh.region_names)))
    pools = [ids[free[ids]] for ids in own]
    pools = [ids for ids in pools if len(ids) >= least]
    if not pools:
        raise ModelError(
            f"no limb has {least} vertices that can be touched. Touch with fewer."
        )
    return pools


def _direction(
    mesh: TetMesh, ids: Array, first: int, how: Touching, rng: np.random.Generator
) -> Array:
    """Return the unit vector along which a patch is pushed."""
    if how.direction == "down":
        return np.array([0.0, 0.0, -1.0])
    if how.direction == "random":
        way = rng.normal(size=3)
        return way / np.linalg.norm(way)
    on = mesh.surface_vertices
    inward = -mesh.normals[np.searchsorted(on, ids)]
    own = -mesh.normals[np.searchsorted(on, first)]
    mean = inward[inward @ own > 0].mean(axis=0)  # of this side of the limb
    return mean / np.linalg.norm(mean)


def _seen(mesh: TetMesh, how: Touching, rng: np.random.Generator) -> Array:
    """Return the vertices that are seen all through a plant's touches, ascending."""
    on = mesh.surface_vertices
    if how.facing:
        turn = rng.uniform(0, 2 * np.pi)
        eye = np.array([np.cos(turn), np.sin(turn), 0.0])
        on = on[mesh.normals @ eye > 0]
    count = min(how.seen, len(on))
    return np.sort(rng.choice(on, count, replace=False))


def _skeleton_arrays(skeleton: Skeleton) -> dict[str, Array]:
    assert skeleton.level is not None
    return {
        "skeleton/points": skeleton.points,
        "skeleton/radius": skeleton.radius,
        "skeleton/parent": skeleton.parent.astype(np.int32),
        "skeleton/limb": skeleton.limb.astype(np.int32),
        "skeleton/level": skeleton.level.astype(np.int32),
    }


def _mesh_arrays(mesh: TetMesh) -> dict[str, Array]:
    names = [name.encode() for name in mesh.region_names]
    return {
        "mesh/points": mesh.points,
        "mesh/tets": mesh.tets.astype(np.int32),
        "mesh/region": np.asarray(mesh.region).astype(np.int32),
        "mesh/region_names": np.array(names, dtype=bytes),
        "mesh/base": mesh.sets["base"].astype(np.int32),
    }


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    began = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - began


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
