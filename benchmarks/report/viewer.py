# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures side by side, zoomed and moved together (`page.js`), and the crops."""

from __future__ import annotations

from html import escape

from benchmarks.report.collect import SceneResults
from benchmarks.report.html import key
from benchmarks.report.pictures import ScenePictures, scale_colours
from benchmarks.tables import format_figure


def _scale(pictures: ScenePictures) -> str:
    """The colour scale of error maps."""
    low, high = pictures.limits
    return (
        f'<div class="scale">relative squared error: {format_figure(low)}'
        f'<span style="background:linear-gradient(to right,{",".join(scale_colours())})"></span>'
        f"{format_figure(high)} (logarithmic)</div>"
    )


def viewer(scene: SceneResults, pictures: ScenePictures, identifier: str) -> str:
    """Controls and a pane for every render, of which those chosen are shown. Without scripts all are."""
    final = str(scene.final_budget())
    steps = sorted({batch.budget for batch in scene.batches}, key=lambda budget: (budget.seconds, budget.samples))
    budgets = [str(budget) for budget in steps]
    names = (["reference"] if scene.reference is not None else []) + scene.rivals
    boxes = "".join(
        f'<label><input type="checkbox" name="rival" value="{escape(name)}" checked> '
        f"{key(name) if name != 'reference' else 'reference'}</label>"
        for name in names
    )
    options = "".join(
        f'<option value="{escape(name)}"{" selected" if name == final else ""}>{escape(name)}</option>'
        for name in budgets
    )
    panes = []
    for picture in pictures.pictures:
        rival = picture.rival or "reference"
        shown = " hidden" if picture.budget not in ("", final) else ""
        label = f"{scene.name}, {picture.label}"
        panes.append(
            f'<figure class="pane" data-rival="{escape(rival)}" data-budget="{escape(picture.budget)}"'
            f' data-picture="{escape(picture.image)}" data-error="{escape(picture.error)}"'
            f' data-label="{escape(label)}"{shown}>'
            f'<div class="frame" tabindex="0" role="group" aria-label="{escape(label)}: plus and minus zoom,'
            f' arrows move, 0 shows all">'
            f'<img src="{escape(picture.image)}" width="{scene.width}" height="{scene.height}" draggable="false"'
            f' loading="lazy" alt="{escape(label)}"></div>'
            f"<figcaption>{key(rival) if picture.rival else 'reference'}"
            f"{', ' + escape(picture.budget) if picture.budget else ''}</figcaption></figure>"
        )
    linear = '<feComponentTransfer color-interpolation-filters="linearRGB">' + "".join(
        f'<feFunc{c} type="linear" slope="1"/>' for c in "RGB"
    )
    return (
        f'<div class="viewer" id="viewer-{identifier}" data-filter="exposure-{identifier}">'
        f'<svg width="0" height="0" aria-hidden="true" style="position:absolute"><filter id="exposure-{identifier}">'
        f"{linear}</feComponentTransfer></filter></svg>"
        f"<fieldset><legend>Show</legend>{boxes}"
        f'<label>after <select name="budget">{options}</select></label>'
        '<label><select name="content"><option value="picture">pictures</option>'
        '<option value="error">error maps</option></select></label>'
        '<label>exposure <input type="range" name="exposure" min="-4" max="4" step="0.5" value="0"></label>'
        '<output>0 stops</output><button type="button" name="reset">Show all</button></fieldset>'
        '<p class="soft">The wheel zooms, dragging moves, all pictures together; with the keyboard: plus, minus,'
        " arrows, 0. Pictures are of the first seed under one exposure, and clipped: less exposure brings no highlights"
        f' back. Error maps are of all seeds.</p><div class="panes">{"".join(panes)}</div>{_scale(pictures)}</div>'
    )


def crops(scene: SceneResults, pictures: ScenePictures) -> str:
    """Where rivals differ most: whole error maps with the crop marked, and picture and error of the crop."""
    crop = pictures.crop
    box = (
        f"left:{100 * crop.x / scene.width:.2f}%;top:{100 * crop.y / scene.height:.2f}%;"
        f"width:{100 * crop.width / scene.width:.2f}%;height:{100 * crop.height / scene.height:.2f}%"
    )
    size = f'width="{crop.width}" height="{crop.height}"'
    items = []
    for picture in pictures.pictures:
        if not picture.crop:
            continue
        label = escape(f"{scene.name}, {picture.label}")
        whole, what = (picture.error, "error map") if picture.error else (picture.image, "picture")
        error = (
            f'<img src="{escape(picture.crop_error)}" {size} alt="{label}: error map of the crop" loading="lazy">'
            if picture.crop_error
            else ""
        )
        items.append(
            f'<figure><span class="marked"><img src="{escape(whole)}" width="{scene.width}" height="{scene.height}"'
            f' alt="{label}: {what}, the crop marked" loading="lazy"><span style="{box}"></span></span>'
            f'<img src="{escape(picture.crop)}" {size} alt="{label}: the crop" loading="lazy">{error}'
            f"<figcaption>{key(picture.rival) + ', ' + escape(picture.budget) if picture.rival else 'reference'}"
            "</figcaption></figure>"
        )
    return (
        f'<p class="soft">Pixels {crop.x} to {crop.x + crop.width - 1} from the left and {crop.y} to'
        f" {crop.y + crop.height - 1} from the top, where the rivals' errors differ most.</p>"
        f'<div class="crops">{"".join(items)}</div>{_scale(pictures)}'
    )
