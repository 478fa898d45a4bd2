# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders by a source of directions that is not the engine's own: `python -m examples.add_source`.

The source is `examples/cosine_source.py`. To offer it to users of Blender, put these two lines into `engine/methods.py`
instead: menus, settings and the command line follow.
"""

from __future__ import annotations

from engine.methods import METHODS, SOURCES, Method, Source

SOURCES["COSINE"] = Source("COSINE", "Cosine", "Draw about the normal", "examples.cosine_source")
METHODS["COSINE"] = Method("COSINE", "Cosine", "Draw about the normal", "a cosine lobe", source="COSINE")

# Settings take their choices from these tables when they are imported: after the lines above.
from engine.render.session import Session  # noqa: E402
from engine.settings import RenderSettings  # noqa: E402
from examples.pictures import noise  # noqa: E402
from examples.room import room  # noqa: E402


def main() -> dict[str, tuple[float, float]]:
    """Render the room without guiding and by the new source; the mean and the noise of each."""
    found = {}
    for method in ("OFF", "COSINE"):
        session = Session(RenderSettings(samples=31, guiding_method=method, guiding_trial=False))
        session.load(room())
        passes = session.render(passes=("Combined", "Variance")).passes
        session.close()
        found[method] = float(passes["Combined"][..., :3].mean()), noise(passes)
        # No source changes the picture, only its noise.
        print("{}: mean {:.3f}, noise {:.3f}".format(method, *found[method]))
    return found


if __name__ == "__main__":
    main()
