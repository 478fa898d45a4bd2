// SPDX-License-Identifier: GPL-3.0-or-later
// Pictures side by side: all panes of a scene show the same part. The view is kept in the viewer's data attributes:
// scale (1 = whole picture), x and y (what lies at the upper left corner, as shares of the picture).
"use strict";

const MOST = 64;

function setUp(viewer) {
  const view = { scale: 1, x: 0, y: 0 };
  const panes = [...viewer.querySelectorAll(".pane")];
  const choices = [...viewer.querySelectorAll("input[name=rival]")];
  const budget = viewer.querySelector("select[name=budget]");
  const content = viewer.querySelector("select[name=content]");
  const exposure = viewer.querySelector("input[name=exposure]");
  const told = viewer.querySelector("output");

  function show() {
    const room = 1 - 1 / view.scale;
    view.x = Math.min(Math.max(view.x, 0), room);
    view.y = Math.min(Math.max(view.y, 0), room);
    for (const pane of panes) {
      const image = pane.querySelector("img");
      image.style.transform =
        `scale(${view.scale}) translate(${-100 * view.x}%, ${-100 * view.y}%)`;
    }
    Object.assign(viewer.dataset, view);
  }

  function zoom(factor, shareX, shareY) {
    const scale = Math.min(Math.max(view.scale * factor, 1), MOST);
    // What is under the pointer stays there.
    view.x += shareX / view.scale - shareX / scale;
    view.y += shareY / view.scale - shareY / scale;
    view.scale = scale;
    show();
  }

  function choose() {
    const wanted = new Set(choices.filter((box) => box.checked).map((box) => box.value));
    const isError = content.value === "error";
    for (const pane of panes) {
      const { rival, budget: of, picture, error } = pane.dataset;
      pane.hidden = !(wanted.has(rival) && (of === "" || of === budget.value) && (!isError || error));
      const image = pane.querySelector("img");
      const file = isError ? error : picture;
      if (!pane.hidden && image.getAttribute("src") !== file) image.setAttribute("src", file);
      const kind = isError ? "error of " : "";
      image.alt = kind + pane.dataset.label;
    }
    expose();
  }

  function expose() {
    // Light is multiplied, not sRGB's code values: by a filter that works on linear values. Error maps stay.
    const stops = Number(exposure.value);
    const slope = 2 ** stops;
    const filter = document.getElementById(viewer.dataset.filter);
    for (const part of filter.querySelectorAll("feFuncR, feFuncG, feFuncB")) part.setAttribute("slope", slope);
    const use = stops !== 0 && content.value === "picture";
    for (const pane of panes) pane.querySelector("img").style.filter = use ? `url(#${filter.id})` : "";
    told.textContent = (stops > 0 ? "+" : "") + stops + " stops";
  }

  function reset() {
    Object.assign(view, { scale: 1, x: 0, y: 0 });
    show();
  }

  for (const pane of panes) {
    const frame = pane.querySelector(".frame");
    let held = null;
    const shares = (event) => {
      const box = frame.getBoundingClientRect();
      return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
    };
    frame.addEventListener("wheel", (event) => {
      // The whole picture lets the page scroll on.
      if (view.scale === 1 && event.deltaY > 0) return;
      event.preventDefault();
      zoom(Math.exp(-event.deltaY * 0.002), ...shares(event));
    }, { passive: false });
    frame.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      held = shares(event);
      frame.setPointerCapture(event.pointerId);
    });
    frame.addEventListener("pointermove", (event) => {
      if (held === null) return;
      const now = shares(event);
      view.x -= (now[0] - held[0]) / view.scale;
      view.y -= (now[1] - held[1]) / view.scale;
      held = now;
      show();
    });
    for (const end of ["pointerup", "pointercancel"]) frame.addEventListener(end, () => { held = null; });
    frame.addEventListener("dblclick", reset);
    frame.addEventListener("keydown", (event) => {
      const step = 0.1 / view.scale;
      const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
      if (event.key === "+" || event.key === "=") zoom(1.5, 0.5, 0.5);
      else if (event.key === "-") zoom(1 / 1.5, 0.5, 0.5);
      else if (event.key === "0") reset();
      else if (event.key in moves && view.scale > 1) {
        view.x += moves[event.key][0];
        view.y += moves[event.key][1];
        show();
      } else return;
      event.preventDefault();
    });
  }
  for (const control of [...choices, budget, content]) control.addEventListener("change", choose);
  exposure.addEventListener("input", expose);
  viewer.querySelector("button[name=reset]").addEventListener("click", () => {
    exposure.value = 0;
    expose();
    reset();
  });
  choose();
  show();
}

document.querySelectorAll(".viewer").forEach(setUp);
