"""The paper's Table I: errors on unseen touches after 0, 1, 5 and 10 shots.

    python benchmarks/table1.py [mesh.npz ...] [--seeds 5] [--fields smooth rough limb]
        [--noise exact 1mm camera] [--priors reference third] [--shots 1 5 10]
        [--methods map contact balance] [--one-each] [--log rows.jsonl] [--out table1]

The paper's protocol: the lowest 10 % of the vertices fixed; a touch moves ten of the upper
85 % together, 15 cm down. Fields: `smooth`, the paper's (mu = 8 - z, lam = 7 + 0.4 y - 0.1
z); `rough`, log-normal of 0.5, correlated along the plant; `limb`, log-normal of 0.4 by
limb. Noise: none; 1 mm and 2 % of each reading of force (of a hundredth of the touch's root
mean square at least); 3 mm and 5 %, and one camera that sees one side of the surface.
Prior: `reference`, mu = 1, lam = 10; or `third`, a third of the truth's mean moduli.
Methods: maximum a posteriori, and force balance by the rows of contact (the paper's
formula) or of all free vertices, which need every vertex around a touched one and so cannot
do with one camera. Without a mesh, two plants of our own, a fork and an apple of eight
limbs. Errors are those of `ps.score` over 12 unseen touches, as ratios 0-shot / n-shot: the
median over meshes of each one's median over seeds, and the range of all.

With `--one-each` seed k goes to mesh k alone. With `--log` every row is kept, and a run
that was cut goes on where it was.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array, diags_array, eye_array
from scipy.sparse.linalg import splu

import plantsim as ps
from plantsim.elastic.loads import Move
from plantsim.estimation.prediction import Score

PAPER = {0: (1.61, 13.411), 1: (1.60, 13.394), 5: (1.08, 9.330), 10: (1.07, 6.733)}
PRIORS = ("reference", "third")
# [m], and a share of each reading of force, which is at least LEAST of the touch's rms
NOISE = {"exact": (0.0, 0.0), "1mm": (1e-3, 0.02), "camera": (3e-3, 0.05)}
LEAST = 0.01


@dataclass(frozen=True)
class Row:
    """One estimate: its errors over those of the prior."""

    mesh: str
    field: str
    noise: str
    prior: str
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


def sample(mesh: ps.TetMesh, count: int, seed: int) -> list[Move]:
    """Draw touches as `ps.sample_touches` does, though in order of height.

    So seed 0 has the very touches of which the figures to beat were told.
    """
    random = np.random.default_rng(seed)
    high = np.argsort(mesh.points[:, 2])[-int(0.85 * len(mesh.points)) :]
    down = np.array([0.0, 0.0, -0.15])
    return [ps.move(random.choice(high, 10, replace=False), down) for _ in range(count)]


def seen_touches(
    truth: ps.ElasticModel, noise: str, shots: int, seed: int
) -> list[ps.Observation]:
    by_u, by_f = NOISE[noise]
    view = camera_view(truth.mesh) if noise == "camera" else None
    random = np.random.default_rng(seed)
    out = []
    for touch in sample(truth.mesh, shots, seed + 1):
        force = truth.contact(touch.ids).force(touch.displacement)
        reading = np.maximum(np.abs(force), LEAST * np.sqrt((force**2).mean()))
        out.append(
            ps.observe(
                truth,
                touch,
                seen=view,
                displacement_noise=by_u,
                force_noise=by_f * reading,
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
    if rows == "contact":  # the paper weighs all alike
        seen = [
            replace(o, force_noise=float(np.sqrt(np.mean(np.square(o.force_noise)))))
            for o in seen
        ]
    return ps.estimate(prior, seen, parameters=kind, method="force-balance", rows=rows)


def prior_of(truth: ps.ElasticModel, prior: str) -> ps.Material:
    if prior == "reference":
        return ps.Material.lame(1.0, 10.0)
    mu, lam = truth.material.mu, truth.material.lam
    return ps.Material.lame(float(np.mean(mu)) / 3, float(np.mean(lam)) / 3)


def experiment(
    name: str,
    mesh: ps.TetMesh,
    field: str,
    noise: str,
    prior: str,
    wanted: list[tuple[str, int]],
    seed: int,
    queries: int = 12,
) -> Iterator[Row]:
    fixed = ps.lowest(mesh)
    truth = ps.ElasticModel(mesh, truth_of(mesh, field, seed), fixed=fixed)
    start = truth.with_material(prior_of(truth, prior))
    unseen = sample(mesh, queries, seed + 99)
    seen = seen_touches(truth, noise, max(n for _, n in wanted), seed)
    before = ps.score(start, truth, unseen)
    for method, n in wanted:
        began = time.process_time()
        try:
            found = found_by(method, start, seen[:n], field)
            after = ps.score(found, truth, unseen)
        except ps.PlantsimError as why:
            print(f"{method}, {n} shots: {why}", flush=True)
            after = Score(np.nan, np.nan, np.nan, np.nan)
        spent = time.process_time() - began
        yield Row(
            name,
            field,
            noise,
            prior,
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
        "| field | noise | prior | method | shots | visual, cm | visual 0/n | tactile, N | "
        "tactile 0/n | seconds |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for n, (visual, tactile) in PAPER.items():
        first = (f"{PAPER[0][0] / visual:.3g}", f"{PAPER[0][1] / tactile:.3g}")
        lines.append(
            f"| smooth | none | | the paper's print | {n} | {visual} | {first[0]} | "
            f"{tactile} | {first[1]} | |"
        )
    keys = dict.fromkeys((r.field, r.noise, r.prior, r.method, r.shots) for r in rows)
    for key in keys:
        some = [r for r in rows if (r.field, r.noise, r.prior, r.method, r.shots) == key]
        failed = sum(np.isnan(r.visual) for r in some)
        some = [r for r in some if not np.isnan(r.visual)]
        if not some:
            lines.append(f"| {' | '.join(map(str, key))} | failed | | | | |")
            continue
        cells = []
        for what in ("visual", "tactile"):
            cells.append(f"{typical(some, lambda r, w=what: getattr(r, w)):.3g}")
            x = [better(r, what) for r in some]
            middle = typical(some, lambda r, w=what: better(r, w))
            cells.append(f"{middle:.3g} ({min(x):.3g} to {max(x):.3g})")
        lines.append(
            f"| {' | '.join(map(str, key))} | {' | '.join(cells)} | "
            f"{typical(some, lambda r: r.seconds):.2g}"
            f"{f' ({failed} failed)' if failed else ''} |"
        )
    return "\n".join(lines)


def better(row: Row, what: str) -> float:
    """Return how many times the prior's error the estimate's goes into."""
    return getattr(row, f"prior_{what}") / getattr(row, what)


def typical(rows: list[Row], value: Callable[[Row], float]) -> float:
    """Return the median over meshes of each one's median over seeds."""
    by_mesh: dict[str, list[float]] = {}
    for row in rows:
        by_mesh.setdefault(row.mesh, []).append(value(row))
    return float(np.median([np.nanmedian(x) for x in by_mesh.values()]))


def draw(rows: list[Row], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = [r for r in rows if not np.isnan(r.visual)]
    fields = list(dict.fromkeys(r.field for r in rows))
    figure, axes = plt.subplots(
        2, len(fields), figsize=(4 * len(fields), 7), squeeze=False, sharex=True
    )
    colours = dict(zip(NOISE, ("C0", "C1", "C2"), strict=True))
    marks = {"map": "o", "contact": "x", "balance": "+"}
    for (row, what), (column, field) in product(
        enumerate(("visual", "tactile")), enumerate(fields)
    ):
        axis = axes[row][column]
        mine = [r for r in rows if r.field == field]
        for key in dict.fromkeys((r.noise, r.prior, r.method) for r in mine):
            some = [r for r in mine if (r.noise, r.prior, r.method) == key]
            shots = sorted({r.shots for r in some})
            share = [
                typical(
                    [r for r in some if r.shots == n], lambda r, w=what: 1 / better(r, w)
                )
                for n in shots
            ]
            noise, prior, method = key
            axis.plot(
                [0, *shots],
                [1, *share],
                marks[method] + ("-" if prior == "reference" else ":"),
                color=colours[noise],
                label=", ".join(key),
            )
        if field == "smooth":
            print_ = [pair[row] / PAPER[0][row] for pair in PAPER.values()]
            axis.plot(list(PAPER), print_, "k--", label="the paper's print")
        axis.set(yscale="log", title=f"{field} field, {what} error over that of 0 shots")
        axis.title.set_fontsize(9)
    for axis in axes[1]:
        axis.set_xlabel("shots")
    handles = {
        label: handle
        for axis in axes.flat
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), fontsize=7, loc="lower center", ncols=4)
    figure.tight_layout(rect=(0, 0.1, 1, 1))
    figure.savefig(path, dpi=110)
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
    priors: list[str] | None = None,
    one_each: bool = False,
    log: Path | None = None,
) -> list[Row]:
    rows: list[Row] = []
    if log is not None and log.exists():
        lines = log.read_text(encoding="utf-8").splitlines()
        rows = [Row(**json.loads(line)) for line in lines]
    names = list(meshes)
    jobs = [
        job
        for job in product(range(seeds), names, fields, noises, priors or ["reference"])
        if (not one_each or job[0] % len(names) == names.index(job[1]))
        # by limb needs limbs
        and (job[2] != "limb" or len(meshes[job[1]].region_names) > 1)
    ]
    began = time.perf_counter()
    made = 0
    for i, (seed, name, field, noise, prior) in enumerate(jobs):
        had = {
            (r.method, r.shots)
            for r in rows
            if (r.seed, r.mesh, r.field, r.noise, r.prior)
            == (seed, name, field, noise, prior)
        }
        wanted = [
            (m, n)
            for m, n in product(methods, shots)
            if (m, n) not in had and (m == "map" or noise != "camera")
        ]
        if not wanted:
            continue
        mesh = meshes[name]
        for row in experiment(name, mesh, field, noise, prior, wanted, seed, queries):
            rows.append(row)
            if log is not None:
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(row)) + "\n")
        made += 1
        gone = time.perf_counter() - began
        print(
            f"{name}, {field}, {noise}, {prior} prior, seed {seed}: {gone:.0f} s gone, "
            f"some {gone / made * (len(jobs) - i - 1):.0f} s left",
            flush=True,
        )
    text = table(rows)
    print(f"\n{text}")
    if out is not None:
        out.with_suffix(".md").write_text(text + "\n", encoding="utf-8")
        draw(rows, out.with_suffix(".png"))
    return rows


def own_plants(names: list[str] | None = None) -> dict[str, ps.TetMesh]:
    made = {
        "fork": lambda: ps.fork(length=1.0, radius=0.03),
        "apple": lambda: ps.weber_penn("apple", rng=1, levels=2, max_limbs=8),
    }
    return {
        name: ps.tetrahedralize(ps.sweep(made[name]()), 1.2, order=1)
        for name in names or made
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path)
    parser.add_argument("--own", nargs="+", help="which of our own plants")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--fields", nargs="+", default=["smooth", "rough", "limb"])
    parser.add_argument("--noise", nargs="+", default=list(NOISE))
    parser.add_argument("--priors", nargs="+", default=list(PRIORS))
    parser.add_argument("--methods", nargs="+", default=["map", "contact"])
    parser.add_argument("--shots", nargs="+", type=int, default=[1, 5, 10])
    parser.add_argument("--one-each", action="store_true")
    parser.add_argument("--log", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    given = {path.stem: ps.read_mesh(path) for path in options.meshes}
    main(
        given or own_plants(options.own),
        options.fields,
        options.noise,
        options.methods,
        options.shots,
        options.seeds,
        options.out,
        priors=options.priors,
        one_each=options.one_each,
        log=options.log,
    )
