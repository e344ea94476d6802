"""Local belief: dividing follows the slopes of the estimate only where they flatten the planes nearby."""

import numpy as np
import pytest
import trimesh

from hyjax.geometry.mesh_arrays import MeshArrays
from hyjax.photo_light.belief import EXPONENTS, NO_BELIEF, Belief
from hyjax.photo_light.local_belief import divisor_log, local_divisor, local_exponents

BELIEF = Belief(0.75, 0.5, (1.0,) * len(EXPONENTS))


@pytest.fixture(scope="module")
def floor() -> trimesh.Trimesh:
    """Floor of 4 by 2 metres."""
    corners = [[0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    return mesh.subdivide_to_size(0.1)


def evidence(mesh: trimesh.Trimesh, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a floor whose left half is lit as estimated and whose right half evenly."""
    x = mesh.vertices[:, 0]
    pairs = np.random.default_rng(0).integers(0, len(x), (6000, 2))
    pairs = pairs[(x[pairs] < 2.0).all(axis=1) | (x[pairs] > 2.0).all(axis=1)]
    own = light * (x < 2.0)
    c, e = (values[pairs[:, 0]] - values[pairs[:, 1]] for values in (own, light))
    return pairs, np.abs(c[:, None] - np.array(EXPONENTS) * e[:, None])


def test_each_half_of_a_floor_gets_its_exponent(floor: trimesh.Trimesh) -> None:
    light, x = 0.5 * np.sin(2.0 * floor.vertices[:, 0]), floor.vertices[:, 0]
    normals = np.tile([0.0, 0.0, 1.0], (len(x), 1))
    found = local_exponents(floor.vertices, normals, *evidence(floor, light), 0.75)
    assert found[x < 1.5].min() > 0.85 and found[x > 2.5].max() < 0.4
    lone = local_exponents(floor.vertices, -normals, *(part[:0] for part in evidence(floor, light)), 0.75)
    np.testing.assert_allclose(lone, 0.75)


def test_one_exponent_gives_its_power_and_two_follow_their_slopes(floor: trimesh.Trimesh) -> None:
    x = floor.vertices[:, 0]
    light, normals = 0.5 * (x - x.mean()), np.tile([0.0, 0.0, 1.0], (len(x), 1))
    mesh = floor.vertices, normals, floor.faces
    np.testing.assert_allclose(divisor_log(light, np.full(len(x), 0.6), 0.6, *mesh), 0.6 * light, atol=1e-3)
    found = divisor_log(light, np.where(x < 2.0, 1.0, 0.0), 0.75, *mesh)
    slopes = [np.polyfit(x[part], found[part], 1)[0] for part in ((x > 0.3) & (x < 1.5), (x > 2.5) & (x < 3.7))]
    assert slopes[0] > 0.4 and slopes[1] < 0.15


def test_without_belief_nothing_is_divided_and_hue_has_its_own_exponent(floor: trimesh.Trimesh) -> None:
    mesh, count = MeshArrays.of(floor), len(floor.vertices)
    bright, hue = 0.1 * floor.vertices[:, :1], np.tile([0.2, 0.0, -0.2], (count, 1))
    normals = np.tile([0.0, 0.0, 1.0], (count, 1))
    proof = evidence(floor, bright[:, 0])
    assert (local_divisor(mesh, normals, (bright, hue), NO_BELIEF, proof) == 1).all()
    found = local_divisor(mesh, normals, (bright, hue), BELIEF, proof)
    np.testing.assert_allclose(np.log(found[:, 0] / found[:, 2]), 0.5 * 0.4, rtol=1e-6)
