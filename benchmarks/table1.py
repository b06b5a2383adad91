"""The paper's Table I: errors on unseen touches after 0, 1, 5 and 10 shots.

    python benchmarks/table1.py [mesh.npz ...] [--seeds 5] [--fields smooth rough limb]
        [--noise exact 1mm camera] [--shots 1 5 10] [--methods map contact balance]
        [--out table1]

The paper's protocol: the lowest 10 % of the vertices fixed; a touch moves ten of the upper
85 % together, 15 cm down. Fields: `smooth`, the paper's (mu = 8 - z, lam = 7 + 0.4 y - 0.1
z); `rough`, log-normal of 0.5, correlated along the plant; `limb`, log-normal of 0.4 by
limb. Noise: none; 1 mm and 2 % of a touch's root mean square force; 3 mm and 5 %, and one
camera that sees one side of the surface. Prior: mu = 1, lam = 10. Methods: maximum a
posteriori, and force balance by the rows of contact (the paper's formula) or of all free
vertices. Without a mesh, a fork of our own. Errors are those of `ps.score` over 12 unseen
touches, as ratios 0-shot / n-shot: medians over meshes and seeds, and the range.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, diags_array, eye_array
from scipy.sparse.linalg import splu

import plantsim as ps

PAPER = {0: (1.61, 13.411), 1: (1.60, 13.394), 5: (1.08, 9.330), 10: (1.07, 6.733)}
NOISE = {"exact": (0.0, 0.0), "1mm": (1e-3, 0.02), "camera": (3e-3, 0.05)}


@dataclass(frozen=True)
class Row:
    """One estimate: its errors over those of the prior."""

    mesh: str
    field: str
    noise: str
    method: str
    shots: int
    seed: int
    visual: float  # [cm]
    tactile: float
    prior_visual: float
    prior_tactile: float
    seconds: float  # of the processor


def truth_of(mesh: ps.TetMesh, field: str, seed: int) -> ps.Material:
    x = mesh.points[mesh.tets[:, :4]].mean(axis=1)
    if field == "smooth":
        return ps.Material.lame(8 - x[:, 2], 7 + 0.4 * x[:, 1] - 0.1 * x[:, 2])
    random = np.random.default_rng(seed + 5)
    if field == "limb":
        z = 0.4 * random.normal(size=len(mesh.region_names))[mesh.region]
    else:
        m = len(mesh.tets)
        i, j = mesh.neighbours.T
        A = coo_array((np.ones(len(i)), (i, j)), shape=(m, m))
        A = A + A.T
        L = diags_array(np.asarray(A.sum(axis=1)).ravel()) - A
        z = splu((L + 1e-3 * eye_array(m)).tocsc()).solve(random.normal(size=m))
        z = 0.5 * (z - z.mean()) / z.std()
    return ps.Material.lame(8 * np.exp(z), 7 * np.exp(z))


def camera_view(mesh: ps.TetMesh) -> np.ndarray:
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    eye = (low + high) / 2 + np.array([0.0, -3.0, 0.2]) * (high - low).max()
    return ps.visible_vertices(mesh, eye)


def seen_touches(
    truth: ps.ElasticModel, noise: str, shots: int, seed: int
) -> list[ps.Observation]:
    by_u, by_f = NOISE[noise]
    view = camera_view(truth.mesh) if noise == "camera" else None
    random = np.random.default_rng(seed)
    out = []
    for touch in ps.sample_touches(truth, shots, rng=seed + 1):
        force = truth.contact(touch.ids).force(touch.moves[-1])
        out.append(
            ps.observe(
                truth,
                touch.last,
                seen=view,
                displacement_noise=by_u,
                force_noise=by_f * float(np.sqrt((force**2).mean())),
                rng=random,
            )
        )
    return out


def found_by(
    method: str, prior: ps.ElasticModel, seen: list[ps.Observation], field: str
) -> ps.Estimate:
    kind = ps.per_limb() if field == "limb" else ps.per_element()
    if method == "map":
        return ps.estimate(prior, seen, parameters=kind)
    rows = "balance" if method == "balance" else "contact"
    return ps.estimate(prior, seen, parameters=kind, method="force-balance", rows=rows)


def experiment(
    name: str,
    mesh: ps.TetMesh,
    field: str,
    noise: str,
    methods: list[str],
    shots: list[int],
    seed: int,
    queries: int = 12,
) -> Iterator[Row]:
    fixed = ps.lowest(mesh)
    truth = ps.ElasticModel(mesh, truth_of(mesh, field, seed), fixed=fixed)
    prior = truth.with_material(ps.Material.lame(1.0, 10.0))
    unseen = ps.sample_touches(truth, queries, rng=seed + 99)
    seen = seen_touches(truth, noise, max(shots), seed)
    before = ps.score(prior, truth, unseen)
    for method, n in product(methods, shots):
        if method != "map" and noise == "camera":
            continue  # force balance needs every vertex around a touched one
        began = time.process_time()
        found = found_by(method, prior, seen[:n], field)
        spent = time.process_time() - began
        after = ps.score(found, truth, unseen)
        yield Row(
            name,
            field,
            noise,
            method,
            n,
            seed,
            after.visual,
            after.tactile,
            before.visual,
            before.tactile,
            spent,
        )


def table(rows: list[Row]) -> str:
    lines = [
        "| field | noise | method | shots | visual, cm | visual 0/n | tactile, N | "
        "tactile 0/n | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    keys = dict.fromkeys((r.field, r.noise, r.method, r.shots) for r in rows)
    for field, noise, method, shots in keys:
        some = [
            r
            for r in rows
            if (r.field, r.noise, r.method, r.shots) == (field, noise, method, shots)
        ]
        v = [r.prior_visual / r.visual for r in some]
        t = [r.prior_tactile / r.tactile for r in some]
        lines.append(
            f"| {field} | {noise} | {method} | {shots} | "
            f"{np.median([r.visual for r in some]):.3g} | {_spread(v)} | "
            f"{np.median([r.tactile for r in some]):.3g} | {_spread(t)} | "
            f"{np.median([r.seconds for r in some]):.2g} |"
        )
    return "\n".join(lines)


def _spread(x: list[float]) -> str:
    return f"{np.median(x):.3g} ({min(x):.3g} to {max(x):.3g})"


def draw(rows: list[Row], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4.5))
    for axis, what in zip(axes, ("visual", "tactile"), strict=True):
        for key in dict.fromkeys((r.field, r.noise, r.method) for r in rows):
            some = [r for r in rows if (r.field, r.noise, r.method) == key]
            shots = sorted({r.shots for r in some})
            share = [
                np.median(
                    [
                        getattr(r, what) / getattr(r, f"prior_{what}")
                        for r in some
                        if r.shots == n
                    ]
                )
                for n in shots
            ]
            axis.plot([0, *shots], [1, *share], "o-", label=", ".join(key))
        column = 0 if what == "visual" else 1
        ours = [PAPER[n][column] / PAPER[0][column] for n in PAPER]
        axis.plot(list(PAPER), ours, "k--", label="the paper's print")
        axis.set(yscale="log", xlabel="shots", ylabel=f"{what} error over 0 shots")
    axes[0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main(
    meshes: dict[str, ps.TetMesh],
    fields: list[str],
    noises: list[str],
    methods: list[str],
    shots: list[int],
    seeds: int,
    out: Path | None = None,
    queries: int = 12,
) -> list[Row]:
    rows: list[Row] = []
    jobs = list(product(range(seeds), meshes, fields, noises))
    began = time.perf_counter()
    for i, (seed, name, field, noise) in enumerate(jobs):
        if field == "limb" and len(meshes[name].region_names) == 1:
            continue
        rows += experiment(name, meshes[name], field, noise, methods, shots, seed, queries)
        gone = time.perf_counter() - began
        left = gone / (i + 1) * (len(jobs) - i - 1)
        print(
            f"{name}, {field}, {noise}, seed {seed}: {gone:.0f} s gone, some {left:.0f} s "
            "left",
            flush=True,
        )
    print("\nthe paper's print (visual cm, tactile N):", PAPER, "\n")
    print(table(rows))
    if out is not None:
        out.with_suffix(".md").write_text(table(rows) + "\n", encoding="utf-8")
        draw(rows, out.with_suffix(".png"))
    return rows


def own_plants() -> dict[str, ps.TetMesh]:
    skeleton = ps.fork(length=1.0, radius=0.03)
    return {"fork": ps.tetrahedralize(ps.sweep(skeleton), 1.2, order=1)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--fields", nargs="+", default=["smooth", "rough", "limb"])
    parser.add_argument("--noise", nargs="+", default=list(NOISE))
    parser.add_argument("--methods", nargs="+", default=["map", "contact"])
    parser.add_argument("--shots", nargs="+", type=int, default=[1, 5, 10])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    main(
        {path.stem: ps.read_mesh(path) for path in options.meshes} or own_plants(),
        options.fields,
        options.noise,
        options.methods,
        options.shots,
        options.seeds,
        options.out,
    )
