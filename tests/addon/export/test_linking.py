# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking and shadow linking as Blender numbers its sets."""

from __future__ import annotations

from typing import Any

import pytest

from engine.scene.linking import ALL_SETS, Linking
from tests.helpers.blender_scenes import empty_scene

bpy = pytest.importorskip("bpy")


def export(scene: Any) -> Any:
    from addon.export.scene import export_scene

    depsgraph = bpy.context.evaluated_depsgraph_get()
    return export_scene(depsgraph)


def add(scene: Any, name: str, data: Any) -> Any:
    thing = bpy.data.objects.new(name, data)
    scene.collection.objects.link(thing)
    return thing


def square(name: str) -> Any:
    data = bpy.data.meshes.new(name)
    data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    return data


@pytest.fixture
def scene() -> Any:
    """Three squares, two lamps and a camera."""
    scene = empty_scene()
    scene.camera = add(scene, "Camera", bpy.data.cameras.new("Camera"))
    for name in ("A", "B", "C"):
        add(scene, name, square(name))
    for name in ("First", "Second"):
        add(scene, name, bpy.data.lights.new(name, "POINT"))
    return scene


def collection(scene: Any, states: dict[str, str], *children: Any) -> Any:
    """A collection of objects by name, INCLUDE or EXCLUDE each, and of others that are included."""
    made = bpy.data.collections.new("Linked")
    for name in states:
        made.objects.link(scene.objects[name])
    for entry, thing in zip(made.collection_objects, made.objects, strict=True):
        entry.light_linking.link_state = states[thing.name]
    for child in children:
        made.children.link(child)
    return made


def sets_of(description: Any, column: str = "receiver_set") -> dict[str, int]:
    linking: Linking = description.linking
    return dict(zip(description.instances.name, getattr(linking, column).tolist(), strict=True))


def lights_up(description: Any, lamp: str) -> dict[str, bool]:
    """Which objects a lamp lights."""
    names = [light.name for light in description.lights]
    bits = int(description.linking.lamp_receivers[names.index(lamp)])
    return {name: bool(bits >> number & 1) for name, number in sets_of(description).items()}


def test_nothing_is_linked_by_default(scene: Any) -> None:
    assert export(scene).linking is None


def test_a_lamp_lights_what_its_collection_includes(scene: Any) -> None:
    scene.objects["First"].light_linking.receiver_collection = collection(scene, {"A": "INCLUDE", "B": "INCLUDE"})
    description = export(scene)
    assert lights_up(description, "First") == {"A": True, "B": True, "C": False}
    assert lights_up(description, "Second") == {"A": True, "B": True, "C": True}
    assert sets_of(description)["A"] == sets_of(description)["B"] != 0
    assert not [notice for notice in description.notices if "linking" in notice.problem]


def test_a_lamp_lights_all_but_what_its_collection_excludes(scene: Any) -> None:
    scene.objects["First"].light_linking.receiver_collection = collection(scene, {"A": "EXCLUDE"})
    assert lights_up(export(scene), "First") == {"A": False, "B": True, "C": True}


def test_an_empty_collection_links_nothing(scene: Any) -> None:
    scene.objects["First"].light_linking.receiver_collection = collection(scene, {})
    assert lights_up(export(scene), "First") == {"A": True, "B": True, "C": True}


def test_nested_collections_go_by_the_outermost_entry(scene: Any) -> None:
    inner = collection(scene, {"B": "INCLUDE"})
    outer = collection(scene, {"A": "INCLUDE"}, inner)
    outer.collection_children[0].light_linking.link_state = "EXCLUDE"
    scene.objects["First"].light_linking.receiver_collection = outer
    assert lights_up(export(scene), "First") == {"A": True, "B": False, "C": False}


def test_what_two_lamps_treat_differently_has_sets_of_its_own(scene: Any) -> None:
    scene.objects["First"].light_linking.receiver_collection = collection(scene, {"A": "INCLUDE", "B": "INCLUDE"})
    scene.objects["Second"].light_linking.receiver_collection = collection(scene, {"B": "EXCLUDE"})
    description = export(scene)
    assert len(set(sets_of(description).values())) == 3
    assert lights_up(description, "First") == {"A": True, "B": True, "C": False}
    assert lights_up(description, "Second") == {"A": True, "B": False, "C": True}


def test_blockers_and_glowing_meshes_have_sets_too(scene: Any) -> None:
    scene.objects["C"].light_linking.blocker_collection = collection(scene, {"A": "INCLUDE"})
    description = export(scene)
    linking = description.linking
    assert sets_of(description, "blocker_set") == {"A": 1, "B": 0, "C": 0}
    row = description.instances.name.index("C")
    assert int(linking.surface_blockers[row]) == 2
    assert (linking.surface_receivers == ALL_SETS).all()
    assert (linking.lamp_blockers == ALL_SETS).all()


def test_instances_are_in_the_set_of_what_instances_them(scene: Any) -> None:
    held = bpy.data.collections.new("Held")
    held.objects.link(scene.objects["A"])
    scene.collection.objects.unlink(scene.objects["A"])
    empty = add(scene, "Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", held
    scene.objects["First"].light_linking.receiver_collection = collection(scene, {"Empty": "INCLUDE"})
    assert lights_up(export(scene), "First") == {"A": True, "B": False, "C": False}


def test_more_sets_than_there_may_be_are_named(scene: Any) -> None:
    for number in range(65):
        lamp = add(scene, f"Lamp {number}", bpy.data.lights.new("Lamp", "POINT"))
        name = f"Square {number}"
        add(scene, name, square(name))
        lamp.light_linking.receiver_collection = collection(scene, {name: "INCLUDE"})
    problems = [notice.problem for notice in export(scene).notices]
    assert "more than 64 collections for light linking are not supported" in problems
    assert "more than 64 sets of objects for light linking are not supported" in problems
