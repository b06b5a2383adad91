import numpy as np
import pytest

import plantsim as ps


def test_fruit_weighs_on_its_own_limb():
    skeleton = ps.fork(0.3, 0.02).with_fruit(count=6, mass=0.2, stalk=0.05, rng=3)
    mesh = ps.tetrahedralize(ps.sweep(skeleton), 1.2)
    model = ps.ElasticModel(mesh, ps.Material(density=900))
    masses = skeleton.masses
    assert masses.total == pytest.approx(1.2)
    bare = model.solve(ps.gravity())
    state = model.solve(ps.gravity(masses=masses))
    size = np.abs(state.force).sum()
    assert np.abs(state.force.sum(axis=0)).max() < 1e-9 * size
    assert np.abs(np.cross(mesh.points, state.force).sum(axis=0)).max() < 1e-9 * size
    base = mesh.sets["base"]
    more = (state.force - bare.force)[base].sum(axis=0)
    assert more == pytest.approx([0, 0, 1.2 * 9.80665], abs=1e-9)
    # the base feels the moment of the fruits where they hang
    turn = np.cross(mesh.points[base], (state.force - bare.force)[base]).sum(axis=0)
    known = -np.cross(masses.points, masses.mass[:, None] * [0, 0, -9.80665]).sum(axis=0)
    assert turn == pytest.approx(known, abs=1e-9)
    loaded = np.unique(np.asarray(masses.limb))
    extra = np.flatnonzero(np.abs(state.force - bare.force).sum(axis=1) > 1e-9)
    touched = np.setdiff1d(extra, base)
    regions = {int(r) for r in mesh.region[np.isin(mesh.tets[:, :4], touched).any(axis=1)]}
    assert regions <= {0, *map(int, loaded)}


def test_a_mass_needs_its_limb(cube):
    skeleton = ps.fork(0.3, 0.02).with_fruit(count=6, mass=0.2, stalk=0.05, rng=3)
    with pytest.raises(ps.ModelError, match="limb"):
        ps.ElasticModel(cube, ps.Material()).solve(ps.gravity(masses=skeleton.masses))
