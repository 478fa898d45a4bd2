# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of data without Blender: how they are asked for, merged over units and strata, and what they leave alone."""

from __future__ import annotations

import numpy as np
import pytest

from engine.render.data_passes import data_images, data_layout
from engine.render.film import Film
from engine.render.session import Session
from engine.render.strata import StrataFilm
from engine.scene.cryptomatte import matte_id
from engine.scene.description import Link, Node
from engine.scene.pass_names import aov_pass, matte_passes
from engine.scene.passes import Aov, PassSettings
from engine.settings import RenderSettings
from engine.state.film import FilmLayout, allocate_tile
from engine.state.unit import ALL_STRATA
from tests.helpers.small_scenes import corner_scene

MATTES = {*matte_passes("CryptoObject", 3), *matte_passes("CryptoMaterial", 4)}


def with_aov(description):
    """The scene with a value for an AOV of its material."""
    graph = description.materials[0].graph
    graph.nodes.append(Node("ShaderNodeNewGeometry", "Geometry"))
    graph.nodes.append(
        Node("ShaderNodeOutputAOV", "AOV", {"Color": Link(len(graph.nodes) - 1, "Position")}, {"aov_name": "Place"})
    )
    graph.aovs.append(len(graph.nodes) - 1)
    description.passes = PassSettings(aovs=(Aov("Place", True),))
    return description


def test_passes_get_columns_and_slots_of_their_own():
    data = data_layout(["UV", "Vector", *MATTES], PassSettings(aovs=(Aov("a", True), Aov("b", False))))
    options = data.options
    assert (options.mist, options.uv, options.vector, options.aov, data.width) == (-1, 0, 3, 8, 13)
    assert (options.object_mattes, options.material_mattes, options.asset_mattes) == (0, 4, -1)
    assert (options.matte_slots, data.matte_count) == (4, 8)
    assert not data_layout(["Depth"], PassSettings()).options.is_used


def test_motion_for_denoisers_is_a_mean_of_all_samples():
    names = ["Denoising Backward Motion", "Denoising Specular Motion"]
    layout = data_layout(["Vector", *names], PassSettings())
    assert (layout.options.vector, layout.options.backward_motion, layout.options.specular_motion) == (0, 5, 8)
    # One sample of four has met something.
    sums = np.zeros((1, layout.width), np.float32)
    sums[0] = (3.0, 4.0, 0.0, 0.0, 1.0, 3.0, 4.0, 8.0, 2.0, -2.0)
    mattes, scale = np.zeros((1, 0, 2), np.float32), np.full((1, 1), 0.25, np.float32)
    images = data_images(layout, sums, mattes, scale, (1, 1), ["Vector", *names])
    np.testing.assert_array_equal(images["Vector"][0, 0], (3.0, 4.0, 0.0, 0.0))
    np.testing.assert_array_equal(images[names[0]][0, 0], (0.75, 1.0, 2.0))
    np.testing.assert_array_equal(images[names[1]][0, 0], (0.5, -0.5, 0.0))


def test_specular_albedo_and_roughness_are_means_of_all_samples():
    names = ["Denoising Specular Albedo", "Denoising Roughness"]
    layout = data_layout(names, PassSettings(follows_mirrors=False))
    options = layout.options
    assert (options.specular_albedo, options.roughness, options.asks_for_mirrors) == (0, 3, 1)
    assert (options.follows_mirrors, options.weighs_by_roughness) == (0, 1)
    sums, scale = np.array([[3.0, 2.0, 1.0, 2.5]], np.float32), np.full((1, 1), 0.25, np.float32)
    images = data_images(layout, sums, np.zeros((1, 0, 2), np.float32), scale, (1, 1), names)
    np.testing.assert_array_equal(images[names[0]], [[(0.75, 0.5, 0.25)]])
    np.testing.assert_array_equal(images[names[1]], [[(0.625,)]])


def film_and_tile(strata=1):
    layout = FilmLayout(use_features=True, data=data_layout(matte_passes("CryptoObject", 2), PassSettings()))
    film = Film(1, 1, layout) if strata == 1 else StrataFilm(1, 1, strata, layout)
    return film, lambda: allocate_tile(strata, 3, layout)


def test_mattes_of_units_are_merged_by_id():
    """Two slots and three ids: the third adds to the last slot, as in Cycles; the larger one comes first."""
    film, tile = film_and_tile()
    for pairs in ([(1.5, 2.0), (2.5, 1.0)], [(2.5, 5.0), (1.5, 1.0)], [(3.5, 1.0), (0.0, 0.0)]):
        unit = tile()
        unit.mattes[0], unit.count[0] = pairs, 4
        film.merge(np.array([0]), unit)
    image = film.passes({"CryptoObject00"}, exposure=1.0)["CryptoObject00"]
    np.testing.assert_allclose(image[0, 0], (2.5, 7.0 / 12.0, 1.5, 3.0 / 12.0))


def test_strata_count_the_same_in_mattes():
    film, tile = film_and_tile(strata=2)
    unit = tile()
    unit.mattes[0, 0], unit.mattes[1, 0], unit.count[:] = (1.5, 2.0), (2.5, 6.0), (2, 6)
    film.merge_stratum(np.array([0]), unit, 1.0, ALL_STRATA)
    image = film.passes({"CryptoObject00"}, exposure=1.0)["CryptoObject00"]
    assert sorted(image[0, 0].tolist()) == pytest.approx([0.5, 0.5, 1.5, 2.5])


@pytest.mark.parametrize("method", ["OFF", pytest.param("VMM", marks=pytest.mark.slow)])
def test_passes_depend_on_no_thread_and_change_no_picture(method):
    """A floor and a wall share the pixels: each is one's or the other's, and where it is is the AOV's colour."""
    names = {"Combined", "Position", "Mist", aov_pass("Place"), *MATTES}
    settings = {"samples": 24, "guiding_method": method, "deterministic": True}
    images = []
    for threads in (1, 2):
        session = Session(RenderSettings(threads=threads, **settings))
        session.load(with_aov(corner_scene()))
        images.append(session.render(passes=names).passes)
    for name in names:
        np.testing.assert_array_equal(images[0][name], images[1][name], name)
    combined = []
    for passes in (["Combined"], names - {aov_pass("Place")}):
        session = Session(RenderSettings(threads=2, **settings))
        session.load(corner_scene())
        combined.append(session.render(passes=passes).passes["Combined"])
    np.testing.assert_array_equal(*combined)
    # A program with an AOV takes another way through the interpreter.
    np.testing.assert_allclose(images[0]["Combined"], combined[0], rtol=1e-6)
    found = images[0]
    matte = found["CryptoObject00"]
    covered = found[aov_pass("Place")][..., 3]
    assert set(np.unique(matte[..., ::2]).tolist()) <= {0.0, float(matte_id("Floor"))}
    np.testing.assert_allclose(matte[..., 1], covered, atol=1e-6)
    seen = covered > 0.999
    assert seen.any()
    difference = found[aov_pass("Place")][seen][:, :3] - found["Position"][seen]
    assert np.abs(difference).max() < 0.5
