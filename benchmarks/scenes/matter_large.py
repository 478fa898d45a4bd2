# SPDX-License-Identifier: GPL-3.0-or-later
"""The same matter as large as users have it: for figures, not for tests."""

from __future__ import annotations

from benchmarks.scenes.displaced import displaced, noise
from benchmarks.scenes.matter import bust, fibre, grow, haired_head, rug_under_blinds, statues
from benchmarks.scenes.plants import forest, meadow
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    camera,
    diffuse,
    light,
    lit_stage,
    material,
    resolution,
    sphere,
    world,
)


@scene("large-fur", samples=128)
def fur() -> None:
    """A ball of fur of 100,000 strands."""
    lit_stage()
    ball = add_object("Ball", sphere("Ball", diffuse((0.3, 0.2, 0.1)), 0.75), (0.0, 0.0, 1.0))
    surface = material("Fur", lambda nodes: fibre(nodes, 0.3))
    grow(ball, 100_000, 0.4, 0.004, surface, clump_factor=0.5, kink="WAVE", kink_amplitude=0.05)


@scene("large-head", samples=128)
def head() -> None:
    """A head of skin with 50,000 strands of hair."""
    lit_stage()
    haired_head(50_000, 0.005)


@scene("large-rug", samples=128)
def rug() -> None:
    """A rug of 80,000 strands under a lamp behind blinds."""
    rug_under_blinds(80_000, 0.006)


@scene("large-statues", samples=128)
def marble_and_milk() -> None:
    """Marble and milk, smooth."""
    lit_stage()
    statues(3)


@scene("large-planet", samples=128)
def planet() -> None:
    """A sphere with mountains, diced by the size of a pixel."""
    resolution()
    camera((0.0, -4.0, 1.0), (0.0, 0.0, 0.1))
    world((0.05, 0.05, 0.08))
    light("SUN", 4.0, (3.0, -1.0, 2.5), angle=0.01)

    def heights(nodes: Nodes) -> Socket:
        return nodes("Displacement", Height=noise(nodes, "Object", 3.0, 8.0), Midlevel=0.5, Scale=0.4)

    surface = displaced(heights, color=(0.5, 0.45, 0.4))
    modifier = add_object("Planet", sphere("Planet", surface, 1.2)).modifiers.new("Subdivision", "SUBSURF")
    modifier.render_levels = 5
    if hasattr(modifier, "use_adaptive_subdivision"):
        modifier.use_adaptive_subdivision = True


@scene("large-meadow", samples=128)
def grassland() -> None:
    """A meadow of 200,000 blades and 3,000 flowers."""
    meadow(200_000, 3_000)


@scene("large-forest", samples=128)
def woods() -> None:
    """A wood of 600 trees of 4,000 leaves each."""
    forest(600, 4_000)


@scene("large-bust", samples=128)
def scan() -> None:
    """A head of 200,000 points."""
    lit_stage()
    bust(200_000, 0.005)
