"""Make the pictures of the demo and of the chain's pages: python docs/make_images.py.

docs/images/demo.png from the demo's two pictures; docs/pictures/chain/ by .plot().
"""

import tempfile
from pathlib import Path

import matplotlib.image
import numpy as np

import plantsim as ps
from plantsim.demo import run, young_aspen

HERE = Path(__file__).resolve().parent / "images"
CHAIN = HERE.parent / "pictures" / "chain"


def trimmed(path: Path) -> np.ndarray:
    """Return the picture without the white columns at its sides."""
    picture = matplotlib.image.imread(path)[:, :, :3]
    columns = np.flatnonzero((picture < 0.99).any(axis=(0, 2)))
    return picture[:, max(columns[0] - 40, 0) : columns[-1] + 40]


def chain() -> None:
    """Draw a picture of each value of the chain, of a fork and one touch."""
    CHAIN.mkdir(parents=True, exist_ok=True)
    sapling = ps.weber_penn(young_aspen(), rng=7, levels=2).pruned(min_radius=0.0045)
    sapling.plot(CHAIN / "skeleton.png")
    skeleton = ps.fork(length=0.5, radius=0.02)
    solid = ps.sweep(skeleton)
    solid.plot(CHAIN / "solid.png")
    mesh = ps.tetrahedralize(solid, order=1)
    mesh.plot(CHAIN / "mesh.png")
    young = np.array([7e9, 9e9, 4e9])[np.asarray(mesh.region)]
    prior = ps.ElasticModel(mesh, ps.Material(6e9, 0.35, 900.0))
    truth = prior.with_material(prior.material.with_young(young))
    truth.plot(CHAIN / "model.png")
    tips = [ps.nearest_vertices(mesh, limb.tip, count=6) for limb in skeleton.limbs[1:]]
    pull = ps.move(tips[0], (0.02, 0.0, -0.05))
    truth.solve(pull).plot(CHAIN / "state.png", forces=True)
    touch = ps.observe(
        truth,
        ps.move(tips[0], (0.004, 0.0, -0.006)),
        seen=mesh.surface_vertices[::20],
        displacement_noise=2e-3,
        force_noise=1.0,
        feels="total",
        rng=1,
    )
    seen = mesh.surface_vertices[::4]
    ps.observe(truth, pull, seen=seen, displacement_noise=1e-3, rng=1).plot(
        mesh, CHAIN / "touch.png"
    )
    found = ps.estimate(prior, touch, parameters=ps.per_limb(moduli="young"))
    where = ps.next_touch(found, [int(ids[0]) for ids in tips])
    found.plot(CHAIN / "estimate.png", next_touch=where.touch.ids)
    for path in CHAIN.glob("*.png"):  # without what is white all round
        if path.stem not in ("skeleton", "estimate"):
            matplotlib.image.imsave(path, trimmed(path))


if __name__ == "__main__":
    chain()
    with tempfile.TemporaryDirectory() as folder:
        run(7, Path(folder), lambda stage: None)
        pair = [trimmed(Path(folder) / name) for name in ("pushed.png", "stiffness.png")]
    matplotlib.image.imsave(HERE / "demo.png", np.hstack(pair))
