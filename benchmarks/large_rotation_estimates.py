"""Young's modulus of each limb from touches 0.15 m deep, by either kinematics.

    python benchmarks/large_rotation_estimates.py

A fork of 0.5 m limbs bends as the corotational model says; force balance, at the touched
vertices or over all free ones, without noise, then fits either model to what was seen. The
prior is 6 GPa everywhere. Errors are those of the fitted modulus.
"""

import numpy as np

import plantsim as ps

TRUTH = np.array([6e9, 9e9, 3.5e9])


def errors(depth: float) -> dict[tuple[str, str], dict[str, float] | str]:
    """Return each limb's relative error by kinematics and rows, or why there is none."""
    skeleton = ps.fork(0.5, 0.012)
    mesh = ps.tetrahedralize(ps.sweep(skeleton), order=1)
    young = TRUTH[np.asarray(mesh.region)]
    truth = ps.ElasticModel(mesh, ps.Material(young, 0.3), kinematics="corotational")
    seen = []
    for limb in skeleton.limbs[1:]:
        tip = ps.nearest_vertices(mesh, limb.tip, count=5)
        for way in ((0.6, 0.0, -0.8), (0.0, 1.0, 0.0)):
            seen.append(ps.observe(truth, ps.move(tip, depth * np.array(way))))
    out = {}
    for kinematics in ("linear", "corotational"):
        model = ps.ElasticModel(mesh, ps.Material(6e9, 0.3), kinematics=kinematics)
        for rows in ("contact", "balance"):
            try:
                found = ps.estimate(model, seen, method="force-balance", rows=rows)
            except ps.EstimateError as why:
                out[kinematics, rows] = str(why).split(".")[0]
                continue
            pairs = zip(found.young().items(), TRUTH, strict=True)
            out[kinematics, rows] = {name: E / true - 1 for (name, E), true in pairs}
    return out


def main() -> None:
    print(
        "| depth | kinematics | rows | limb 0 | limb 1 | limb 2 |\n"
        "|---|---|---|---|---|---|"
    )
    for depth in (0.001, 0.01, 0.05, 0.15):
        for (kinematics, rows), limbs in errors(depth).items():
            told = (
                f"{limbs} | | "
                if isinstance(limbs, str)
                else " | ".join(f"{error:+.2%}" for error in limbs.values())
            )
            print(f"| {1000 * depth:g} mm | {kinematics} | {rows} | {told} |", flush=True)


if __name__ == "__main__":
    main()
