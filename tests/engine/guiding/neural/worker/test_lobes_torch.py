# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixtures in torch: the kernels' values, and gradients that training can live with."""

import numpy as np
import pytest

from engine.guiding.fields.vmm.field import GUIDE_KAPPA, GUIDE_WEIGHT, GUIDE_X, GUIDE_Z
from engine.guiding.neural.networks.lobes.nasg import NASG_LOG_A, NASG_OUTPUTS, NASG_WEIGHT, NASG_X, NASG_Z
from engine.guiding.neural.networks.lobes.vmf import VMF_LOG_KAPPA, VMF_LOGIT, VMF_OUTPUTS
from tests.helpers.guiding_harness import sphere_grid, uniform_directions, unit
from tests.helpers.lobe_mixtures import (
    A_CAP,
    ECCENTRICITIES,
    HOSTILE,
    KAPPAS,
    ORIENTATIONS,
    OUTPUTS,
    Mixtures,
    from_quantiles,
    outputs_of,
)
from tests.helpers.training import require_torch

torch = require_torch()
lobes = pytest.importorskip("engine.guiding.neural.worker.lobes")

LOG_UNIFORM = -np.log(4.0 * np.pi)
DTYPES = [torch.float32, torch.float64]


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def log_pdf(model, raw, directions, dtype=torch.float64):
    """Logarithms of densities, and their sum's gradient in the outputs."""
    raw = torch.tensor(np.asarray(raw), dtype=dtype, requires_grad=True)
    directions = torch.tensor(np.asarray(directions), dtype=dtype)
    values = lobes.log_pdf(lobes.decode(model, raw), directions)
    (gradient,) = torch.autograd.grad(values.sum(), raw)
    return values.detach().numpy(), gradient.numpy()


def rounded(directions):
    """Directions as float32 has them, in float64."""
    return np.asarray(directions, np.float32).astype(np.float64)


def near_lobes(model, raw, rng):
    """A direction for each row of outputs, most of them drawn from it and some from anywhere."""
    mixtures = Mixtures(model, raw)
    drawn = np.concatenate([mixtures.sample(rng.random((1, 3)), lane) for lane in range(len(raw))])
    anywhere = rng.random(len(raw)) < 0.2
    return rounded(np.where(anywhere[:, None], uniform_directions(rng, len(raw)), drawn))


def random_outputs(model, rng, count, lobe_count=8, scale=2.0):
    """Outputs that cover most of what can be decoded, as float32 has them."""
    raw = rng.normal(size=(count, lobe_count, OUTPUTS[model])) * scale
    raw[..., 1] = rng.uniform(-6.8, 10.3, raw.shape[:2])
    if model == "nasg":
        raw[..., NASG_LOG_A] = rng.uniform(-9.9, 6.9, raw.shape[:2])
    return rounded(raw.reshape(count, -1))


# ---------------------------------------------------------------------------------------------------------------------
# The kernels' values


@pytest.mark.parametrize("dtype", DTYPES)
def test_decoding_is_the_kernels(dtype):
    rng = np.random.default_rng(1)
    for model, lobe_count in (("vmf", 8), ("sg", 14), ("nasg", 8)):
        kernel_model = "nasg" if model == "nasg" else "vmf"
        assert lobes.LOBE_MODELS[model] == (OUTPUTS[kernel_model], lobe_count)
        raw = random_outputs(kernel_model, rng, 500, lobe_count)
        raw[:40] *= 10.0
        raw[40:60, 2 * OUTPUTS[kernel_model] + 2] = np.nan
        decoded = lobes.decode(model, torch.tensor(raw, dtype=dtype))
        stored = Mixtures(kernel_model, raw).guide.lobes[:, :, :lobe_count]
        weight, kappa, mean = (
            (NASG_WEIGHT, 1, slice(NASG_Z, NASG_Z + 3))
            if model == "nasg"
            else (GUIDE_WEIGHT, GUIDE_KAPPA, slice(GUIDE_X, GUIDE_Z + 1))
        )
        assert np.allclose(decoded.log_weight.exp().numpy(), stored[:, weight], rtol=3e-6)
        assert np.allclose(decoded.kappa.numpy(), stored[:, kappa], rtol=3e-6)
        assert np.allclose(decoded.mean.numpy().transpose(0, 2, 1), stored[:, mean], atol=1e-6)
        if model == "nasg":
            assert np.allclose(decoded.a.numpy(), stored[:, 2], rtol=3e-6)
            assert np.allclose(decoded.x.numpy().transpose(0, 2, 1), stored[:, NASG_X : NASG_X + 3], atol=1e-6)


@pytest.mark.parametrize("model", OUTPUTS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_densities_are_the_kernels(model, dtype):
    rng = np.random.default_rng(2)
    raw = random_outputs(model, rng, 3000)
    directions = near_lobes(model, raw, rng)
    found, _ = log_pdf(model, raw, directions, dtype)
    mixtures = Mixtures(model, raw)
    expected = np.concatenate([mixtures.pdf(directions[i : i + 1], i) for i in range(len(raw))])
    is_normal = expected > 1e-30
    assert is_normal.mean() > 0.95
    # An axis that is 1e-7 off moves the density of the narrowest lobe by 1e-3.
    assert np.abs(found[is_normal] - np.log(expected[is_normal])).max() < 5e-3
    assert np.median(np.abs(found[is_normal] - np.log(expected[is_normal]))) < 2e-6


def test_densities_integrate_to_one():
    directions = sphere_grid(80, 160)
    rng = np.random.default_rng(3)
    for model in OUTPUTS:
        raw = rng.normal(size=8 * OUTPUTS[model])
        raw[1 :: OUTPUTS[model]] -= 1.0
        values, _ = log_pdf(model, np.tile(raw, (len(directions), 1)), directions)
        assert np.exp(values).mean() * 4.0 * np.pi == pytest.approx(1.0, abs=1e-3)


def test_product_with_the_cosine_is_the_kernels():
    rng = np.random.default_rng(4)
    raw = random_outputs("vmf", rng, 1000)
    raw[0, 3] = np.nan
    normals = uniform_directions(rng, 1000).astype(np.float32)
    normals[1] = np.nan
    normals[2] = 0.0
    mixtures = Mixtures("vmf", raw)
    mixtures.multiply_cosine(normals)
    directions = uniform_directions(rng, 1000).astype(np.float32)
    expected = np.concatenate([mixtures.pdf(directions[i : i + 1], i) for i in range(len(raw))])
    for dtype in DTYPES:
        outputs = torch.tensor(raw, dtype=dtype, requires_grad=True)
        product = lobes.multiply_cosine(lobes.decode("vmf", outputs), torch.tensor(normals, dtype=dtype))
        values = lobes.log_pdf(product, torch.tensor(directions, dtype=dtype))
        is_normal = expected > 1e-25
        assert np.allclose(values.detach().numpy()[is_normal], np.log(expected[is_normal]), atol=5e-3)
        values.sum().backward()
        assert torch.isfinite(outputs.grad).all()
    with pytest.raises(ValueError, match="closed form"):
        lobes.multiply_cosine(lobes.decode("nasg", torch.zeros(1, 8)), torch.ones(1, 3))


# ---------------------------------------------------------------------------------------------------------------------
# Gradients


@pytest.mark.parametrize("model, with_cosine", [("vmf", False), ("vmf", True), ("nasg", False)])
def test_gradients_are_finite_differences(model, with_cosine):
    rng = np.random.default_rng(5)
    raw = rng.normal(size=(18, 2 * OUTPUTS[model])) * 1.5
    raw[:6, 1 :: OUTPUTS[model]] = rng.uniform(-6.5, -2.0, (6, 2))
    raw[6:12, 1 :: OUTPUTS[model]] = rng.uniform(3.0, 6.0, (6, 2))
    directions = torch.tensor(near_lobes(model, raw, rng))
    normals = torch.tensor(uniform_directions(rng, len(raw)))

    def value(outputs):
        decoded = lobes.decode(model, outputs)
        return lobes.log_pdf(lobes.multiply_cosine(decoded, normals) if with_cosine else decoded, directions)

    outputs = torch.tensor(raw, requires_grad=True)
    assert torch.autograd.gradcheck(value, (outputs,), eps=1e-7, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("model", OUTPUTS)
def test_gradients_of_float32_are_those_of_float64(model):
    rng = np.random.default_rng(6)
    raw = random_outputs(model, rng, 3000, scale=1.5)
    raw[:300, 1 :: OUTPUTS[model]] = np.float32(-6.8)
    directions = near_lobes(model, raw, rng)
    _, exact = log_pdf(model, raw, directions)
    _, found = log_pdf(model, raw, directions, torch.float32)
    assert np.isfinite(found).all()
    error = np.abs(found - exact).max(1) / np.maximum(np.abs(exact).max(1), 1e-2)
    assert np.median(error) < 1e-5
    assert np.quantile(error, 0.99) < 2e-3


@pytest.mark.parametrize("kappa", [*KAPPAS, 0.2499, 0.2501])
def test_gradient_of_the_normalisation_does_not_cancel(kappa):
    """d log C / d log kappa = 1 + kappa - kappa coth(kappa), here from its series or in more digits."""
    exact = np.float64(np.longdouble(1) + np.longdouble(kappa) - np.longdouble(kappa) / np.tanh(np.longdouble(kappa)))
    if kappa < 0.1:
        exact = kappa - kappa**2 / 3.0 + kappa**4 / 45.0
    raw = outputs_of("vmf", kappa)[None]
    mean = lobes.decode("vmf", torch.tensor(raw)).mean[0, 0].numpy()
    for dtype, tolerance in ((torch.float32, 3e-6), (torch.float64, 1e-9)):
        _, gradient = log_pdf("vmf", raw, mean[None], dtype)
        assert gradient[0, VMF_LOG_KAPPA] == pytest.approx(exact, rel=tolerance)


@pytest.mark.parametrize("dtype", DTYPES)
def test_gradients_are_finite_at_and_around_the_poles(dtype):
    """Directions at a lobe's mean, opposite to it and as close as float32 gets, for all kinds of lobes."""
    rows, directions = [], []
    for model_row, (kappa, a) in enumerate((kappa, a) for kappa in KAPPAS for a in ECCENTRICITIES):
        raw = outputs_of("nasg", kappa, a, ORIENTATIONS[model_row % len(ORIENTATIONS)])
        _, _, (x, y, z) = Mixtures("nasg", [raw]).lobe()
        for step in (0.0, 1e-12, 1e-8, 1e-7, 3e-7, 1e-5, 1e-3):
            for axis in (x, y, x + y):
                for sign in (-1.0, 1.0):
                    rows.append(raw)
                    directions.append(unit(sign * z + step * axis))
    values, gradient = log_pdf("nasg", rows, directions, dtype)
    assert np.isfinite(values).all() and np.isfinite(gradient).all()
    chord = np.asarray(directions) - lobes.decode("nasg", torch.tensor(np.asarray(rows))).mean[:, 0].numpy()
    # About the mean all is tame. Opposite to it g^q really is that steep, but no steeper than LEAST_GAP lets it be.
    assert np.abs(gradient[(chord**2).sum(1) < 1e-9]).max() < 1e3
    assert np.abs(gradient).max() < 50.0 * A_CAP / 2.0**-12


@pytest.mark.parametrize("model", OUTPUTS)
@pytest.mark.parametrize("dtype", DTYPES)
def test_broken_outputs_have_finite_values_and_gradients(model, dtype):
    rng = np.random.default_rng(7)
    width = 8 * OUTPUTS[model]
    raw = rng.normal(size=(2000, width)) * 3.0
    for row, share in enumerate(np.linspace(0.02, 1.0, len(raw))):
        chosen = rng.random(width) < share
        raw[row, chosen] = rng.choice(HOSTILE, chosen.sum())
    directions = rounded(uniform_directions(rng, len(raw)))
    values, gradient = log_pdf(model, raw, directions, dtype)
    assert np.isfinite(values).all() and np.isfinite(gradient).all()
    broken = np.isnan(raw.reshape(len(raw), 8, -1)).any(-1)
    assert broken.sum() > 1000 and (gradient.reshape(len(raw), 8, -1)[broken] == 0.0).all()
    mixtures = Mixtures(model, raw)
    expected = np.concatenate([mixtures.pdf(directions[i : i + 1], i) for i in range(len(raw))])
    is_normal = expected > 1e-30
    assert np.abs(values[is_normal] - np.log(expected[is_normal])).max() < 1e-2


def test_clamped_outputs_find_their_way_back():
    """A loss that falls outwards has no gradient, one that falls inwards has its own."""

    def loss_gradient(raw, directions):
        outputs = torch.tensor(raw, requires_grad=True)
        loss = -lobes.log_pdf(lobes.decode("vmf", outputs), torch.tensor(directions)).sum()
        loss.backward()
        return outputs.grad.numpy()

    raw = np.repeat(outputs_of("vmf")[None], 4, 0)
    raw[:, VMF_LOG_KAPPA] = 12.0, 12.0, -9.0, -9.0
    mean = lobes.decode("vmf", torch.tensor(raw)).mean[0, 0].numpy()
    gradient = loss_gradient(raw, np.stack([mean, -mean, mean, -mean]))[:, VMF_LOG_KAPPA]
    # Too narrow: at the mean it would become narrower still, opposite to it wider. Too wide: the other way round.
    assert gradient[0] == 0.0 and gradient[1] > 1e3
    assert gradient[2] < 0.0 and gradient[3] == 0.0

    # The wide lobe has too much weight, and the narrow one, which the direction asks for, too little; or none of both.
    both = np.concatenate([raw[0], raw[0]])[None]
    both[0, [VMF_LOG_KAPPA, VMF_OUTPUTS + VMF_LOG_KAPPA]] = -2.0, 3.0
    both[0, [VMF_LOGIT, VMF_OUTPUTS + VMF_LOGIT]] = 20.0, -15.0
    gradient = loss_gradient(both, mean[None])[0]
    assert gradient[VMF_LOGIT] > 0.0 and gradient[VMF_OUTPUTS + VMF_LOGIT] < 0.0
    gradient = loss_gradient(both, -mean[None])[0]
    assert gradient[VMF_LOGIT] == 0.0 and gradient[VMF_OUTPUTS + VMF_LOGIT] == 0.0


def test_what_is_no_direction_says_nothing():
    directions = np.array([[np.nan, 0, 1], [np.inf, 0, 0], [1e30, 0, 0], [0, 0, 0]])
    for model in OUTPUTS:
        raw = np.random.default_rng(8).normal(size=(4, 8 * OUTPUTS[model]))
        for dtype in DTYPES:
            values, gradient = log_pdf(model, raw, directions, dtype)
            assert np.allclose(values, LOG_UNIFORM) and (gradient == 0.0).all()


@pytest.mark.parametrize("model, width", [("nasg", 12), ("vmf", 0), ("sphere", 8)])
def test_wrong_shapes_and_names_are_refused(model, width):
    with pytest.raises(ValueError):
        lobes.decode(model, torch.zeros(3, width))


def test_training_finds_an_anisotropic_lobe():
    """Maximum likelihood on samples of the kernel, from somewhere else."""
    truth = outputs_of("nasg", 60.0, 20.0, (0.3, -0.7, 0.4, 0.9, 0.2))
    mixtures = Mixtures("nasg", [truth])
    directions = torch.tensor(mixtures.sample(1500))
    start = np.float32(outputs_of("nasg", 3.0, 1.0, (0.8, -0.3, 0.7, 0.5, 0.6)))
    outputs = torch.tensor(start, requires_grad=True)
    optimizer = torch.optim.Adam([outputs], lr=0.1)
    for _ in range(150):
        optimizer.zero_grad()
        loss = -lobes.log_pdf(lobes.decode("nasg", outputs[None].expand(len(directions), NASG_OUTPUTS)), directions)
        loss.mean().backward()
        optimizer.step()
    entropy = -np.log(mixtures.pdf(directions.numpy())).mean()
    assert loss.mean().item() == pytest.approx(entropy, abs=0.02)
    found = lobes.decode("nasg", outputs.detach()[None])
    kappa, a, axes = mixtures.lobe()
    assert found.kappa.item() == pytest.approx(kappa, rel=0.15)
    assert found.a.item() == pytest.approx(a, rel=0.2)
    assert found.mean[0, 0].numpy() @ axes[2] > 0.999
    assert abs(found.x[0, 0].numpy() @ axes[0]) > 0.99


def test_quantiles_of_the_harness_invert_the_density():
    """log_pdf in float64 against the geometry by which the tests of kernels integrate."""
    rng = np.random.default_rng(9)
    for kappa in KAPPAS:
        for a in ECCENTRICITIES:
            raw = outputs_of("nasg", kappa, a)
            decoded = lobes.decode("nasg", torch.tensor(raw[None]))
            z, x = decoded.mean[0, 0].numpy(), decoded.x[0, 0].numpy()
            directions, measure = from_quantiles(
                rng.random(200) * 0.999, rng.random(200) * 6.28, kappa, a, np.stack([x, np.cross(z, x), z])
            )
            values, _ = log_pdf("nasg", np.repeat(raw[None], 200, 0), directions)
            assert np.allclose(np.exp(values) * measure * 2.0 * np.pi, 1.0, rtol=1e-6)
