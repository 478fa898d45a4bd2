# SPDX-License-Identifier: GPL-3.0-or-later
"""The SD-tree: sampling against density, both trees' growth, variance-aware targets, and what must not break it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from engine.guiding.fields.sdtree import query
from engine.guiding.fields.sdtree.field import QUAD_LEAF, allocate_sdtree_guide, no_sdtree_field
from engine.guiding.fields.sdtree.model import SdTreeModel
from engine.guiding.records.vertices import allocate_vertex_records
from engine.runtime.jit import kernel
from tests.helpers import chi2
from tests.helpers.guiding_harness import mixture_density, sphere_grid, uniform_directions, unit

BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
#: Family-wise significance of the chi-square tests.
SIGNIFICANCE = 0.01
EVEN = 0.25 / np.pi

LIGHTS = [(0.5, 30.0, (0.3, 0.1, 0.9)), (0.3, 300.0, (-0.8, 0.2, 0.1)), (0.2, 0.0, (0.0, 0.0, 1.0))]


@kernel
def _densities(guide, directions, out):
    for k in range(directions.shape[0]):
        wi = (directions[k, 0], directions[k, 1], directions[k, 2])
        out[k, 0] = query.eval_sdtree(guide, 0, wi)
        out[k, 1] = query.predict_sdtree(guide, 0, wi, out[k, 0])


@kernel
def _samples(guide, u, out):
    for k in range(u.shape[0]):
        wi = query.sample_sdtree(guide, 0, u[k, 0], u[k, 1], 0.5)
        for axis in range(3):
            out[k, axis] = wi[axis]


@kernel
def _look_ups(field, p, bits, is_blurred, out):
    for k in range(p.shape[0]):
        out[k] = query.look_up_sdtree(field, (p[k, 0], p[k, 1], p[k, 2]), bits[k], is_blurred)


@kernel
def _prepare(guide, region):
    query.prepare_sdtree_guide(guide, 0, region)


def guide_of(field, region=0):
    guide = allocate_sdtree_guide(1, field)
    _prepare(guide, region)
    return guide


def densities(guide, directions):
    """`eval_sdtree` and `predict_sdtree`: two float64 (N,)."""
    out = np.zeros((len(directions), 2), np.float32)
    _densities(guide, np.asarray(directions, np.float32), out)
    return out[:, 0].astype(np.float64), out[:, 1].astype(np.float64)


def samples(guide, u):
    out = np.zeros((len(u), 3), np.float32)
    _samples(guide, np.asarray(u, np.float32), out)
    return out.astype(np.float64)


def look_ups(field, points, bits, is_blurred):
    out = np.zeros(len(points), np.int32)
    _look_ups(field, np.asarray(points, np.float32).reshape(-1, 3), np.asarray(bits, np.uint32), is_blurred, out)
    return out


def records_of(position, direction, radiance, pdf, contribution_squared=None):
    """`VertexRecords` of grey radiance; the pixel sees what the vertex sees, unless said otherwise."""
    radiance = np.broadcast_to(np.asarray(radiance, np.float64), len(direction))
    records = allocate_vertex_records(len(direction))
    records.position[:] = position
    records.direction[:] = direction
    records.radiance[:] = radiance[:, None]
    records.pdf[:] = pdf
    records.contribution_squared[:] = (radiance / pdf) ** 2 if contribution_squared is None else contribution_squared
    return records


def uniform_records(rng, count, radiance, low=(-1.0, -1.0, -1.0), high=(1.0, 1.0, 1.0)):
    directions = uniform_directions(rng, count)
    return records_of(rng.uniform(low, high, (count, 3)), directions, radiance(directions), EVEN)


def one_region(**options):
    return SdTreeModel(BOX, spatial_threshold=1e9, **options)


def learn(seed, radiance, count, lengths=(1, 2, 4), model=None, **box):
    model = model or one_region()
    rng = np.random.default_rng(seed)
    for samples_per_pixel in lengths:
        model.update(uniform_records(rng, count * samples_per_pixel, radiance, **box), count * samples_per_pixel,
                     samples_per_pixel)  # fmt: skip
    return model


def lit(directions):
    return mixture_density(directions, LIGHTS)


def constant(directions):
    return np.ones(len(directions))


def leaves(field, region=0):
    """Corner, side and probability of every leaf of a quadtree, from its arrays alone, in float64."""
    root = int(field.quad_root[region])
    pending, found = [(0, 0.0, 0.0, 1.0, 1.0)], []
    while pending:
        node, x, y, size, mass = pending.pop()
        phi, *z = field.quad_split[root + node].astype(np.float64)
        for quadrant in range(4):
            column, row = quadrant % 2, quadrant // 2
            share = (phi if column == 0 else 1.0 - phi) * (z[column] if row == 0 else 1.0 - z[column])
            at = (x + 0.5 * size * column, y + 0.5 * size * row, 0.5 * size, mass * share)
            child = int(field.quad_child[root + node, quadrant])
            if child == QUAD_LEAF:
                found.append(at)
            else:
                assert child > node
                pending.append((child, *at))
    return np.array(found)


def assert_sound(field):
    """Every quadtree covers the square once, its density is finite, positive and integrates to one."""
    for array in (field.quad_split, field.fluence, field.node_split, field.extent):
        assert np.isfinite(array).all()
    assert (field.quad_split > 0.0).all() and (field.quad_split < 1.0).all()
    for region in range(len(field.quad_root)):
        cells = leaves(field, region)
        assert (cells[:, 2] ** 2).sum() == pytest.approx(1.0, abs=1e-12)
        assert cells[:, 3].sum() == pytest.approx(1.0, abs=1e-12)
        # What kernels see at the middle of every leaf is its probability over its solid angle.
        z = 2.0 * cells[:, 1] + cells[:, 2] - 1.0
        phi = 2.0 * np.pi * (cells[:, 0] + 0.5 * cells[:, 2])
        sine = np.sqrt(1.0 - z * z)
        middle = np.stack([sine * np.cos(phi), sine * np.sin(phi), z], 1)
        # Cells of a few float32 steps may be missed.
        wide = cells[:, 2] > 1e-4
        found, predicted = densities(guide_of(field, region), middle[wide])
        expected = cells[wide, 3] / (4.0 * np.pi * cells[wide, 2] ** 2)
        np.testing.assert_allclose(found, expected, rtol=2e-5)
        assert np.isfinite(predicted).all() and (predicted >= 0.0).all()


def divergence(truth, field, region=0):
    """Kullback-Leibler divergence of a region's density from `truth(directions)`."""
    directions = sphere_grid(400, 800)
    pdf, _ = densities(guide_of(field, region), directions)
    target = truth(directions)
    target = target / target.mean() * EVEN
    shown = target > 0.0
    return float((target[shown] * np.log(target[shown] / pdf[shown])).sum() * 4.0 * np.pi / len(directions))


# ---------------------------------------------------------------------------------------------------------------------
# Sampling and density


def seam_and_poles(directions):
    """Bright at both poles, across the seam of phi and on an edge of quadrants."""
    return (
        0.02 + 30.0 * (np.abs(directions[:, 2]) > 0.995) + 20.0 * (directions[:, 0] > 0.99)
        + 5.0 * (np.abs(directions[:, 2]) < 0.02)
    )  # fmt: skip


@pytest.mark.parametrize("is_variance_aware", [False, True])
@pytest.mark.parametrize("radiance", [lit, seam_and_poles])
def test_samples_follow_their_density(radiance, is_variance_aware):
    model = learn(1, radiance, 8000, model=one_region(is_variance_aware=is_variance_aware))
    assert_sound(model.field)
    guide = guide_of(model.field)
    count = 200_000
    drawn = samples(guide, np.random.default_rng(2).random((count, 2)))
    assert np.abs(np.linalg.norm(drawn, axis=1) - 1.0).max() < 1e-6
    # Sub-cells are as small as leaves that hold much, so that no edge of one runs through them.
    probability = chi2.cell_integrals(lambda d: densities(guide, d)[0], 32, 64, points=2, subdivisions=16)
    assert probability.sum() == pytest.approx(1.0, abs=1e-4)
    assert chi2.p_value(chi2.histogram(drawn, 32, 64), probability, count) > chi2.sidak(SIGNIFICANCE, 4)


def test_every_random_number_gives_a_direction_of_positive_density():
    field = learn(3, seam_and_poles, 8000).field
    edge = np.array([0.0, 2.0**-24, 0.25, 0.5 - 2.0**-24, 0.5, 0.75, 1.0 - 2.0**-24])
    drawn = samples(guide_of(field), np.stack(np.meshgrid(edge, edge), -1).reshape(-1, 2))
    assert np.isfinite(drawn).all() and np.abs(np.linalg.norm(drawn, axis=1) - 1.0).max() < 1e-6
    pdf, _ = densities(guide_of(field), drawn)
    assert (pdf > 0.0).all() and np.isfinite(pdf).all()


def test_strange_directions_have_finite_densities():
    field = learn(4, lit, 4000, (1,)).field
    poles = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (-1, -0.0, 0), (-1, -1e-30, 0), (0, 1e-38, 1)]
    strange = [(0, 0, 0), (np.nan, 0, 1), (0, np.nan, 1), (0, 0, np.nan), (np.inf, 0, 0), (0, 0, -np.inf), (1e30, 0, 0)]
    pdf, predicted = densities(guide_of(field), np.array(poles + strange))
    assert np.isfinite(pdf).all() and np.isfinite(predicted).all()
    assert (pdf[: len(poles)] > 0.0).all()
    assert (pdf[-6:] == 0.0).all()


def test_nothing_known_is_uniform():
    directions = sphere_grid(20, 40)
    black = learn(5, lambda d: np.zeros(len(d)), 3000).field
    for field in (no_sdtree_field(), one_region().field, black):
        pdf, predicted = densities(guide_of(field), directions)
        np.testing.assert_allclose(pdf, EVEN, rtol=1e-6)
        assert (predicted == 0.0).all() and not field.is_ready.any()
    assert (look_ups(black, [(0, 0, 0)], [1], True) == -1).all()


def test_prediction_is_fluence_times_density_and_partly_even():
    field = learn(6, lambda d: 7.0 * lit(d), 20_000).field
    assert field.fluence[0] == pytest.approx(7.0, rel=0.03)
    directions = sphere_grid(50, 100)
    pdf, predicted = densities(guide_of(field), directions)
    np.testing.assert_allclose(predicted, field.fluence[0] * (0.7 * pdf + 0.3 * EVEN), rtol=1e-5)


# ---------------------------------------------------------------------------------------------------------------------
# Learning


@pytest.mark.parametrize("filters", [False, True])
def test_density_approaches_the_radiance(filters):
    model = one_region(filters=filters)
    rng = np.random.default_rng(7)
    found = []
    for length in (1, 2, 4, 8, 8, 8):
        model.update(uniform_records(rng, 8000 * length, lit), 8000 * length, length)
        found.append(divergence(lit, model.field))
    assert (np.diff(found) < 0.0).all()
    # A uniform density has 1.6.
    assert found[-1] < 0.12 < 0.25 < found[0]
    assert model.field.fluence[0] == pytest.approx(1.0, rel=0.03)


def test_density_does_not_depend_on_what_drew_the_records():
    rng = np.random.default_rng(8)
    source = guide_of(learn(9, lambda d: 0.2 + (d[:, 0] < -0.5), 10_000).field)
    model = one_region()
    for length in (1, 2, 4):
        count = 10_000 * length
        directions = samples(source, rng.random((count, 2)))
        pdf = densities(source, directions)[0]
        model.update(records_of(rng.uniform(-1, 1, (count, 3)), directions, lit(directions), pdf), count, length)
    assert divergence(lit, model.field) < 0.2


def test_quadrants_follow_a_bright_spot():
    spot = unit((0.4, -0.6, 0.5))

    def radiance(d):
        return 0.1 + 1e5 * (d @ spot > np.cos(0.01))

    model = one_region()
    rng = np.random.default_rng(10)
    pdfs = []
    for length in (1, 2, 4, 4):
        count = 20_000 * length
        directions = uniform_directions(rng, count)
        # A third of the records looks for the spot.
        near = rng.random(count) < 1.0 / 3.0
        directions[near] = spot + 0.02 * rng.normal(size=(near.sum(), 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        below = 0.5 * ((directions - spot) ** 2).sum(1)
        pdf = 2.0 / 3.0 * EVEN + np.exp(-below / 0.02**2) / (2.0 * np.pi * 0.02**2) / 3.0
        model.update(records_of(rng.uniform(-1, 1, (count, 3)), directions, radiance(directions), pdf), count, length)
        pdfs.append(densities(guide_of(model.field), spot[None])[0][0])
    # The spot covers 3e-4 sr, and brings 25 times what the rest does.
    assert pdfs[0] < 30.0 and pdfs[1] > 5.0 * pdfs[0] and pdfs[3] > 1000.0
    cells = leaves(model.field)
    assert cells[:, 2].min() < 1.0 / 256.0
    # Where it is dark, quadrants join again.
    assert cells[:, 2].max() >= 1.0 / 4.0
    assert len(cells) < 400
    assert_sound(model.field)


def test_depth_ends_where_it_is_told():
    rng = np.random.default_rng(11)
    direction = np.repeat(unit((0.3, 0.4, 0.8))[None], 2000, 0)
    for depth in (1, 3, 20):
        model = one_region(max_quadtree_depth=depth)
        for _ in range(8):
            model.update(records_of(rng.uniform(-1, 1, (2000, 3)), direction, 1.0, 1.0), 2000, 1.0)
        assert leaves(model.field)[:, 2].min() == 0.5**depth
        assert_sound(model.field)


def test_iterations_of_one_length_add_up():
    """The same number of records again and again: the density goes on to settle, and follows a change of light."""
    wide = [(1.0, 20.0, (0.0, 1.0, 0.0))]
    model = one_region()
    rng = np.random.default_rng(12)
    found = []
    for _ in range(10):
        model.update(uniform_records(rng, 4000, lambda d: mixture_density(d, wide)), 4000, 16.0)
        found.append(divergence(lambda d: mixture_density(d, wide), model.field))
    assert found[-1] < 0.7 * found[2]
    for _ in range(10):
        model.update(uniform_records(rng, 4000, lit), 4000, 16.0)
    # What is left of the old light is 0.75^10; so few records tell no more at first either.
    fresh = learn(12, lit, 4000, (1,))
    assert divergence(lit, model.field) < 1.2 * divergence(lit, fresh.field)


# ---------------------------------------------------------------------------------------------------------------------
# Variance


def noisy_records(rng, count):
    """Two windows of the same mean radiance, the second of which shows it one time in 25 only, on a dim sky.

    Radiance and second moment: 1 and 1; 1 and 25; 0.02 and 0.0004.
    """
    directions = uniform_directions(rng, count)
    steady = directions[:, 2] > 0.8
    rare = directions[:, 2] < -0.8
    radiance = np.where(steady, 1.0, 0.02)
    radiance[rare] = 25.0 * (rng.random(rare.sum()) < 0.04)
    return records_of(rng.uniform(-1, 1, (count, 3)), directions, radiance, EVEN)


def root_second_moment(d):
    return np.where(d[:, 2] > 0.8, 1.0, np.where(d[:, 2] < -0.8, 5.0, 0.02))


def mean_radiance(d):
    return np.where(np.abs(d[:, 2]) > 0.8, 1.0, 0.02)


def test_variance_aware_trees_approach_the_root_of_the_second_moment():
    found = {}
    for is_variance_aware in (False, True):
        model = one_region(is_variance_aware=is_variance_aware)
        rng = np.random.default_rng(13)
        for length in (1, 2, 4, 4):
            model.update(noisy_records(rng, 20_000 * length), 20_000 * length, length)
        assert_sound(model.field)
        assert model.field.fluence[0] == pytest.approx(4.0 * np.pi * (0.2 + 0.8 * 0.02), rel=0.1)
        found[is_variance_aware] = [divergence(truth, model.field) for truth in (mean_radiance, root_second_moment)]
    assert found[True][1] < 0.5 * found[True][0]
    assert found[False][0] < 0.5 * found[False][1]
    assert found[False][1] > 2.0 * found[True][1]


def test_variance_aware_trees_lower_the_second_moment():
    """What sampling by the tree would cost, E[L^2 / g]: the variance-aware tree is near the optimum, the plain not."""
    directions = sphere_grid(400, 800)
    solid_angle = 4.0 * np.pi / len(directions)
    root = root_second_moment(directions)
    least = (root.sum() * solid_angle) ** 2
    cost = {}
    for is_variance_aware in (False, True):
        model = one_region(is_variance_aware=is_variance_aware)
        rng = np.random.default_rng(14)
        for length in (1, 2, 4, 4):
            model.update(noisy_records(rng, 20_000 * length), 20_000 * length, length)
        pdf, _ = densities(guide_of(model.field), directions)
        cost[is_variance_aware] = (root**2 / pdf).sum() * solid_angle / least
    assert cost[True] < 1.4
    assert cost[False] > 1.5 * cost[True]


def test_the_second_moment_is_the_same_whatever_drew_the_records():
    """p C^2 with C = t / p: the records' own density must cancel, one power of it."""
    rng = np.random.default_rng(15)
    source = guide_of(learn(16, lambda d: 0.2 + (d[:, 0] < -0.5), 10_000).field)
    model = one_region(is_variance_aware=True)
    # The units of contributions change after the first iteration, as a renderer's do.
    for length, units in ((1, 1e8), (2, 1.0), (4, 1e-3)):
        count = 20_000 * length
        directions = samples(source, rng.random((count, 2)))
        pdf = densities(source, directions)[0]
        contribution = units * (lit(directions) / pdf) ** 2
        model.update(records_of(np.zeros((count, 3)), directions, 1.0, pdf, contribution), count, length)
    assert divergence(lit, model.field) < 0.15


# ---------------------------------------------------------------------------------------------------------------------
# The tree over space


def test_cells_are_halved_by_their_records():
    model = learn(17, constant, 8000, (1, 2, 4), SdTreeModel(BOX, spatial_threshold=2000))
    # 32000 records at 2000 sqrt(4 / 4) a cell.
    assert 16 <= model.region_count <= 64
    field = model.field
    points = np.random.default_rng(18).uniform(-1, 1, (4000, 3))
    region = model.region_of(points)
    assert set(region) == set(range(model.region_count))
    # Half cells of half cells of a cube: sizes are powers of two of it.
    cube = field.box[1] - field.box[0]
    steps = np.log2(cube / field.extent)
    assert np.abs(steps - np.round(steps)).max() < 1e-3
    assert field.extent.prod(1).sum() == pytest.approx(cube.prod(), rel=1e-4)
    assert_sound(field)


def test_regions_differ_where_the_light_does():
    """Light from +z on one side of the room, from -z on the other."""
    model = SdTreeModel(BOX, spatial_threshold=2000)
    rng = np.random.default_rng(19)
    for length in (1, 2, 4):
        count = 8000 * length
        positions, directions = rng.uniform(-1, 1, (count, 3)), uniform_directions(rng, count)
        radiance = directions[:, 2] * np.sign(positions[:, 0]) > 0.7
        model.update(records_of(positions, directions, radiance, EVEN), count, length)
    for x, z in ((-0.7, -1.0), (0.7, 1.0)):
        region = int(model.region_of([(x, 0.1, 0.1)])[0])
        pdf, _ = densities(guide_of(model.field, region), np.array([[0.1, 0.1, z], [0.1, 0.1, -z]]))
        assert pdf[0] > 20.0 * pdf[1]


def test_look_ups_blend_over_borders():
    model = learn(20, constant, 8000, (1, 2), SdTreeModel(BOX, spatial_threshold=4000))
    field = model.field
    rng = np.random.default_rng(21)
    count = 20_000
    for point in rng.uniform(-0.4, 0.4, (6, 3)):
        points = np.repeat(point[None], count, 0)
        home = int(model.region_of(point)[0])
        assert (look_ups(field, points, rng.integers(0, 2**32, count), False) == home).all()
        found = look_ups(field, points, rng.integers(0, 2**32, count), True)
        near = points + rng.uniform(-0.5, 0.5, (count, 3)) * field.extent[home]
        expected = np.bincount(model.region_of(np.clip(near, *field.bounds)), minlength=model.region_count)
        share = np.bincount(found, minlength=model.region_count)
        # Six standard errors of a difference of shares.
        assert np.abs(share - expected).max() / count < 6.0 * 0.5 * np.sqrt(2.0 / count)
        assert (share > 0).sum() > 1


def test_nothing_is_found_outside():
    model = learn(22, constant, 4000, (1,))
    points = [(0, 0, 0), (2, 0, 0), (0, -1.5, 0), (np.nan, 0, 0), (0, 0, np.nan), (np.inf, 0, 0), (0, 0, -1e30)]
    assert list(model.region_of(points)) == [0] + 6 * [-1]
    for is_blurred in (False, True):
        assert list(look_ups(model.field, points, np.arange(7), is_blurred)) == [0] + 6 * [-1]


def test_an_empty_half_keeps_what_the_whole_knew():
    model = SdTreeModel(BOX, spatial_threshold=2000, filters=False)
    rng = np.random.default_rng(23)
    # 4 samples a pixel: cells of more than 2000; then 7, of which 3 are left: of more than 2646.
    model.update(uniform_records(rng, 1900, lit), 1900, 4.0)
    assert model.region_count == 1
    model.update(uniform_records(rng, 1500, lit, low=(0.2, -1, -1)), 1500, 4.0)
    assert model.region_count == 2
    empty, full = model.region_of([(-0.9, 0, 0), (0.9, 0, 0)])
    assert empty != full and model.field.is_ready.all()
    assert divergence(lit, model.field, empty) < 0.8 < 1.4 < divergence(lit, no_sdtree_field())
    # Nor does it forget while nothing comes.
    kept = divergence(lit, model.field, empty)
    for _ in range(5):
        model.update(uniform_records(rng, 500, constant, low=(0.2, -1, -1)), 500, 4.0)
    empty = model.region_of([(-0.9, 0, 0)])[0]
    assert divergence(lit, model.field, empty) == pytest.approx(kept, abs=0.05)
    assert_sound(model.field)


@pytest.mark.parametrize("flat", [(0,), (1, 2), (0, 1, 2)])
def test_positions_without_extent(flat):
    low, high = np.full(3, -0.5), np.full(3, 0.5)
    for axis in flat:
        low[axis] = high[axis] = 0.1234567
    model = learn(24, constant, 5000, (1, 1, 1), SdTreeModel(BOX, spatial_threshold=2000), low=low, high=high)
    assert (model.region_count == 1) == (len(flat) == 3)
    assert (look_ups(model.field, [(low + high) / 2], [5], True) >= 0).all()
    axes = model.field.node_link[:, 0]
    assert not set(flat) & set(axes[axes >= 0])
    # Bounds of no extent either.
    model = learn(25, constant, 500, (1, 1), SdTreeModel((low, high), spatial_threshold=100), low=low, high=high)
    assert (look_ups(model.field, [(low + high) / 2], [5], True) >= 0).all()
    assert_sound(model.field)


def test_huge_and_distant_coordinates():
    """Most records lie in a cubic metre of a world 2e9 m wide, far from its origin, and two of them side by side."""
    rng = np.random.default_rng(26)
    model = SdTreeModel(((-1e9,) * 3, (1e9,) * 3), spatial_threshold=2000)
    for length in (1, 2, 4):
        positions = rng.uniform(0, 1, (8000, 3)) + (1000.0, 0, 0)
        positions[:50] = rng.uniform(-1e9, 1e9, (50, 3))
        model.update(records_of(positions, uniform_directions(rng, 8000), 1.0, EVEN), 8000, length)
    assert_sound(model.field)
    inside = rng.uniform(0, 1, (500, 3)) + (1000.0, 0, 0)
    assert len(set(model.region_of(inside))) > 3
    assert model.region_count < 300
    assert model.report()["records_outside"] == 0
    # Nothing there to tell apart: halving ends all the same.
    pair = np.repeat([[1000.0, 0.5, 0.5], [np.nextafter(np.float32(1000.0), np.float32(2e3)), 0.5, 0.5]], 4000, 0)
    model.update(records_of(pair, uniform_directions(rng, 8000), 1.0, EVEN), 8000, 4.0)
    assert model.region_count < 500
    model = SdTreeModel(((-3e38, 0, 0), (-1e38, 0, 0)))
    assert np.isfinite(model.field.box).all()


# ---------------------------------------------------------------------------------------------------------------------
# What must not break it


def adversarial(kind, rng, count=3000):
    """Records of one sort of trouble."""
    position, direction = rng.uniform(-1, 1, (count, 3)), uniform_directions(rng, count)
    records = records_of(position, direction, lit(direction), EVEN)
    part = rng.random(count) < 0.3
    if kind in ("nan", "inf", "negative"):
        value = {"nan": np.nan, "inf": np.inf, "negative": -1.0}[kind]
        columns = (records.radiance, records.pdf, records.position, records.direction, records.contribution_squared)
        for column in columns:
            column[rng.random(count) < 0.1] = value
    elif kind == "huge":
        records.radiance[part] = 1e30
        records.contribution_squared[part] = 3e38
        records.pdf[part] = 1e-30
    elif kind == "tiny":
        records.radiance[:] = 1e-38
        records.contribution_squared[:] = 1e-45
        records.pdf[part] = 1e30
    elif kind == "narrow":
        records.pdf[:] = 1e30
    elif kind == "zero":
        records.radiance[:] = 0.0
        records.contribution_squared[:] = 0.0
    else:
        records.direction[:] = {
            "pole": (0, 0, 1), "antipole": (0, 0, -1), "seam": (1, 0, 0), "below the seam": (1, -1e-30, 0),
            "edge": (-1, 0, 0), "corner": (0, 1, 0), "anywhere": unit((0.1, -0.7, 0.3)),
        }[kind]  # fmt: skip
    return records


@pytest.mark.parametrize("is_variance_aware", [False, True])
@pytest.mark.parametrize(
    "kind",
    ["nan", "inf", "negative", "huge", "tiny", "narrow", "zero", "pole", "antipole", "seam", "below the seam", "edge",
     "corner", "anywhere"],
)  # fmt: skip
def test_adversarial_records_leave_a_density(kind, is_variance_aware):
    rng = np.random.default_rng(27)
    model = SdTreeModel(BOX, spatial_threshold=4000, is_variance_aware=is_variance_aware)
    for length in (1, 2, 4, 8, 8):
        model.update(adversarial(kind, rng), 3000, length)
        assert_sound(model.field)
    drawn = samples(guide_of(model.field), rng.random((2000, 2)))
    pdf, _ = densities(guide_of(model.field), drawn)
    assert np.isfinite(drawn).all() and np.isfinite(pdf).all() and (pdf > 0.0).all()
    if kind in ("pole", "antipole", "seam", "edge", "corner", "anywhere"):
        towards = adversarial(kind, rng, 1).direction
        assert densities(guide_of(model.field), towards)[0][0] > 1000.0


def test_unusable_records_are_left_out_and_counted():
    def records():
        return uniform_records(np.random.default_rng(28), 2000, lit)

    dirty = records()
    bad = np.arange(0, 1000, 100)
    dirty.radiance[0] = np.nan
    dirty.radiance[100, 1] = np.inf
    dirty.position[200, 2] = np.nan
    dirty.direction[300] = np.nan
    dirty.direction[400] = 0.0
    dirty.pdf[500] = 0.0
    dirty.pdf[600] = np.nan
    dirty.radiance[700, 2] = -1.0
    dirty.contribution_squared[800] = np.nan
    dirty.position[900] = 5.0
    clean = records()
    # Nowhere to be found instead.
    clean.position[bad] = 5.0
    fields = []
    for rows in (clean, dirty):
        model = SdTreeModel(BOX, is_variance_aware=True)
        model.update(rows, 2000, 1.0)
        fields.append(model.field)
    report = model.report()
    assert report["records_invalid"] == 9 and report["records_outside"] == 1
    assert all(np.array_equal(a, b) for a, b in zip(*fields, strict=True))


@pytest.mark.parametrize("is_variance_aware", [False, True])
def test_a_single_bright_record_does_not_bend_the_field(is_variance_aware):
    results = []
    for brightness in (None, 1e6):
        model = one_region(is_variance_aware=is_variance_aware)
        rng = np.random.default_rng(29)
        for length in (1, 2, 4):
            records = uniform_records(rng, 4000 * length, lit)
            if brightness is not None and length == 4:
                records.radiance[1234] = brightness
                records.contribution_squared[1234] = (brightness / EVEN) ** 2
                records.direction[1234] = unit((-0.2, -0.1, -1.0))
            model.update(records, 4000 * length, length)
        results.append((divergence(lit, model.field), model.field.fluence[0]))
    # Under the root a share is worth more.
    assert results[1][0] < results[0][0] + (0.15 if is_variance_aware else 0.06)
    assert results[1][1] < 1.1 * results[0][1]


@pytest.mark.parametrize("is_variance_aware", [False, True])
def test_threads_do_not_change_the_field(is_variance_aware):
    fields = []
    for threads in (1, 4):
        rng = np.random.default_rng(30)
        model = SdTreeModel(BOX, spatial_threshold=1500, is_variance_aware=is_variance_aware)
        with ThreadPoolExecutor(threads) as executor:
            for length in (1, 2, 4):
                # More than one chunk.
                model.update(uniform_records(rng, 20_000, lit), 20_000, length, executor, threads)
        fields.append(model.field)
    assert len(fields[0].quad_root) > 16
    assert all(np.array_equal(a, b) for a, b in zip(*fields, strict=True))
    assert all(a.shape == b.shape for a, b in zip(*fields, strict=True))


def test_the_seed_matters_and_nothing_else_does():
    def learned(seed):
        return learn(31, lit, 4000, (1,), one_region(seed=seed)).field.quad_split

    assert np.array_equal(learned(1), learned(1))
    assert not np.array_equal(learned(1), learned(2))


def test_nothing_to_learn_from():
    model = SdTreeModel(BOX)
    model.update(uniform_records(np.random.default_rng(32), 16, lit), 0, 1.0)
    assert model.region_count == 1 and not model.field.is_ready.any()
    with pytest.raises(ValueError, match="bounds"):
        SdTreeModel(((0, 0, np.nan), (1, 1, 1)))
    with pytest.raises(ValueError, match="samples"):
        model.update(allocate_vertex_records(1), 1, 0.0)
    with pytest.raises(ValueError, match="thresholds"):
        SdTreeModel(BOX, flux_share=0.0)


def test_a_published_field_never_changes():
    model = learn(33, lit, 4000, (1,), SdTreeModel(BOX, spatial_threshold=1000))
    field = model.field
    before = [array.copy() for array in field]
    sums = np.arange(model.region_count, dtype=np.float64)
    model.update(uniform_records(np.random.default_rng(34), 16_000, lit), 16_000, 2.0)
    assert all(np.array_equal(a, b) for a, b in zip(before, field, strict=True))
    assert model.region_count > len(sums)
    carried = model.inherited(sums, 1.0)
    assert (carried[: len(sums)] == sums).all()
    for region, parent in model.split_log:
        assert carried[region] == carried[parent]
