"""The paper's own solutions on its own meshes."""

import numpy as np
import pytest

import plantsim as ps


@pytest.mark.parametrize("solver", ["direct", "multigrid"])
@pytest.mark.parametrize("tree", ["00", "01", "03"])
def test_reference_solution(reference, tree, solver):
    z = np.load(reference / f"test_tree_{tree}_solution.npz")
    mesh = ps.read_mesh(reference / f"test_tree_{tree}.npz")
    material = ps.Material.lame(z["mu"], z["lam"])
    model = ps.ElasticModel(mesh, material, fixed=z["fixed"], solver=solver)
    state = model.solve(ps.move(z["moved"], z["move"]))

    def far(ours, theirs):
        return np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)

    at = z["moved"]
    assert far(state.displacement, z["displacement"]) < 1e-6
    assert far(state.force[at], z["force"][at]) < 1e-6
    assert far(state.force, z["force"]) < 1e-6
