// Mouse, touch, keys and the controls beside the views; the start, and a new start after the graphics were lost.

const turn = (dx, dy) => {
  state.yaw -= dx;
  state.pitch = Math.max(-1.5, Math.min(1.5, state.pitch + dy));
  redraw();
};
const zoom = (factor) => { state.zoom = Math.max(0.4, Math.min(30, state.zoom * factor)); redraw(); };
const resetView = () => {
  Object.assign(state, { yaw: cases[state.case].azimuth, pitch: PITCH, zoom: 1 });
  fitBody();
  redraw();
};

const pointers = new Map();
let travelled = 0;
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
  if (pointers.size === 1) travelled = 0;
});
canvas.addEventListener("pointermove", (event) => {
  const before = pointers.get(event.pointerId);
  if (!before) return;
  const now = [event.clientX, event.clientY];
  travelled += Math.hypot(now[0] - before[0], now[1] - before[1]);
  if (pointers.size === 1) turn((now[0] - before[0]) / 160, (now[1] - before[1]) / 160);
  else if (pointers.size === 2) {
    const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
    const span = (p) => Math.max(10, Math.hypot(p[0] - other[0], p[1] - other[1]));
    zoom(span(now) / span(before));
  }
  pointers.set(event.pointerId, now);
});
for (const kind of ["pointerup", "pointercancel"]) {
  canvas.addEventListener(kind, (event) => {
    const last = pointers.size === 1;
    if (pointers.delete(event.pointerId) && last && kind === "pointerup" && travelled < 6) pick(event.clientX, event.clientY);
  });
}
canvas.addEventListener("wheel", (event) => {
  if (document.activeElement !== canvas && !event.ctrlKey) return; // let the page scroll until the viewer is in use
  event.preventDefault();
  zoom(Math.exp(-event.deltaY / 500));
}, { passive: false });
canvas.addEventListener("keydown", (event) => {
  const middle = () => {
    const stage = canvas.getBoundingClientRect(), { left, top, wide, high } = scene.views[0];
    pick(stage.x + left + wide / 2, stage.y + top + high / 2);
  };
  const actions = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
    "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15), 0: resetView, Enter: middle,
  };
  if (!actions[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  actions[event.key]();
});

// --- controls ---

const option = (text, value) => Object.assign(document.createElement("option"), { textContent: text, value });

function chooseCase(index) {
  const shown = cases[index];
  const others = shown.models.filter((m) => m.name !== shown.reference).map((m) => m.name);
  const names = others.length ? others : shown.models.map((m) => m.name);
  const full = shown.factors.reduce((best, f, k, all) => (Math.abs(f) >= Math.abs(all[best]) ? k : best), 0);
  Object.assign(state, { case: index, step: full, scale: shown.scale, node: null });
  if (!names.includes(state.model)) state.model = names.includes(focus) ? focus : names[0];
  control("model").replaceChildren(...names.map((name) => option(name, name)));
  control("model").value = state.model;
  control("step").max = shown.factors.length - 1;
  control("step").value = state.step;
  control("step").closest("label").hidden = shown.factors.length < 2;
  control("scale").value = 50;
  control("regions").closest("label").hidden = !shown.regions.length;
  rebuild();
  resetView();
}

control("case").append(...cases.map((c, k) => option(c.title, k)));
control("case").closest("label").hidden = cases.length < 2;
control("case").addEventListener("change", (event) => chooseCase(Number(event.target.value)));
control("model").addEventListener("change", (event) => { state.model = event.target.value; rebuild(); });
control("step").addEventListener("input", (event) => { state.step = Number(event.target.value); rebuild(); });
control("scale").addEventListener("input", (event) => { state.scale = (cases[state.case].scale * event.target.value) / 50; rebuild(); });
for (const name of ["rest", "edges", "regions"]) control(name).addEventListener("change", redraw);
control("reset").addEventListener("click", resetView);
control("node").addEventListener("change", (event) => {
  const node = Number(event.target.value), count = scene.geometry.points.length / 3;
  chooseNode(event.target.value !== "" && Number.isInteger(node) && node >= 0 && node < count ? node : null);
});
control("save").addEventListener("click", () => {
  draw();
  const { name, factors } = cases[state.case];
  const told = [name, `load × ${digits(factors[state.step])}`, `displacement drawn × ${digits(state.scale)}`].filter(Boolean);
  const link = document.createElement("a");
  link.download = `${document.title} ${state.model}.png`.replace(/[^\w.-]+/g, "-");
  link.href = savedPicture(canvas, labels, ratio, told.join(" · "), coloursOf(box));
  link.click();
});

// --- start, and start again ---

const inUse = (yes) => {
  box.hidden = !yes;
  document.documentElement.classList.toggle("has-viewer", yes);
};

let givingUp = 0;
canvas.addEventListener("webglcontextlost", (event) => {
  event.preventDefault(); // else the browser never gives it back
  gpu = null;
  redraw();
  givingUp = setTimeout(() => inUse(false), PATIENCE); // the still pictures come back
});
canvas.addEventListener("webglcontextrestored", () => {
  clearTimeout(givingUp);
  gpu = makeGpu(gl, ramps);
  inUse(true);
  send();
  place();
  draw();
});

if (gl) {
  gpu = makeGpu(gl, ramps);
  inUse(true);
  chooseCase(0);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  new ResizeObserver(() => { place(); fitBody(); draw(); }).observe(canvas); // at once: a new size empties a canvas
}
