// The key cases in three linked views: model, reference and difference. One camera, one load, one node.

const box = document.querySelector(".viewer");
const [canvas, labels] = box.querySelectorAll(".stage > canvas");
const { cases, ramps, focus } = decoded(JSON.parse(document.querySelector(".viewer-data").textContent));
const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
const control = (name) => box.querySelector(`[data-control="${name}"]`);
const output = (name) => box.querySelector(`[data-output="${name}"]`);

const PITCH = 0.38; // from where the view begins, above the horizon
const LABELS = 52; // pixels of a view above and below the body
const PATIENCE = 4000; // ms until a lost context is given up
const state = { case: 0, model: "", step: 0, scale: 1, node: null, yaw: 0, pitch: PITCH, zoom: 1, fit: 1 };
let gpu = null; // null while the graphics context is lost
let scene = null; // what the views show
let ratio = 1; // pixels per CSS pixel

// --- what is shown ---

const stepsOf = (name) => cases[state.case].models.find((m) => m.name === name)?.steps ?? [];

function rebuild() {
  const shown = cases[state.case], geometry = shown.geometry();
  const compared = shown.reference !== null && shown.reference !== state.model;
  const ours = stepsOf(state.model).map((s) => s.field());
  const theirs = compared ? stepsOf(shown.reference).map((s) => s.field()) : [];
  const u = ours[state.step], r = theirs[state.step];
  const range = peak([...ours, ...theirs]);
  const told = (name) => stepsOf(name)[state.step].message;
  const view = (name, title, moved, field, top, ramp, message) => {
    const sizes = field ? norms(field) : null;
    const drawn = geometry.points.map((v, k) => v + state.scale * (moved ? moved[k] : 0));
    const values = sizes ? sizes.map((v) => (top > 0 ? v / top : 0)) : new Float32Array(geometry.points.length / 3);
    const [factor, unit] = lengthUnit(sizes ? largest(sizes) : 0);
    const size = sizes ? `up to ${digits(largest(sizes) / factor)} ${unit}` : "no answer at this load";
    const words = message ? ["stopped at this load:", message] : [size];
    return { name, title, drawn, values, range: top, ramp, colours: ramps[ramp], words };
  };
  const views = [view("model", state.model, u, u, range, "displacement", told(state.model))];
  if (compared) {
    const gaps = ours.map((f, k) => gap(f, theirs[k]));
    views.push(view("reference", `reference: ${shown.reference}`, r, r, range, "displacement", told(shown.reference)));
    views.push(view("difference", "difference", u, gaps[state.step], peak(gaps), "difference", ""));
  }
  scene = { geometry, views, u, r, rims: shown.rims() };
  output("step").textContent = `× ${digits(shown.factors[state.step])}`;
  output("scale").textContent = `× ${digits(state.scale)}`;
  box.querySelector(".told").textContent = [...views.map((v) => `${v.title}, ${v.words.join(" ")}`), shown.name].join("\n");
  for (const place of box.querySelectorAll(".view")) place.hidden = !views.some((v) => v.name === place.dataset.view);
  control("node").max = geometry.points.length / 3 - 1;
  send();
  readNode();
  place();
  redraw();
}

// what the graphics card needs of the scene
function send() {
  if (!gpu) return;
  for (const view of scene.views) {
    gpu.upload("deformed " + view.name, view.drawn);
    gpu.upload("value " + view.name, view.values);
  }
  gpu.upload("rest", scene.geometry.points);
  gpu.upload("triangles", scene.geometry.triangles);
  gpu.upload("edges", scene.geometry.edges);
  scene.rims.forEach((rim, k) => gpu.upload("rim " + k, rim.edges));
}

// --- drawing ---

const axes = (yaw = state.yaw, pitch = state.pitch) => {
  const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
  return [[-sy, cy, 0], [-cy * sp, -sy * sp, cp], [cy * cp, sy * cp, sp]]; // right, up, towards the viewer
};
const sizes = () => {
  const { wide, high } = scene.views[0], s = state.zoom * state.fit;
  return [(s * high) / wide, s, -0.2 / scene.geometry.radius];
};

let waiting = false;
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; draw(); });
}

function draw() {
  const theme = coloursOf(box), pen = labels.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, labels.width, labels.height);
  if (!gpu) {
    pen.fillStyle = theme.ink;
    pen.font = "13px system-ui, sans-serif";
    pen.fillText("The browser took the graphics away. They come back in a moment.", 12, 22);
    return;
  }
  const look = {
    ratio,
    edges: control("edges").checked && rgba(theme.paper, 0.35),
    rest: control("rest").checked && rgba(theme.ink, 0.28),
    rims: control("regions").checked ? scene.rims.map((rim, k) => ({ name: "rim " + k, colour: rgba(rim.colour, 1), halo: rgba("#ffffff", 1) })) : [],
    node: state.node !== null && [[13, rgba(theme.paper, 1)], [9, rgba(theme.ink, 1)]],
  };
  const camera = { axes: axes(), centre: scene.geometry.centre, sizes: sizes() };
  gpu.clear();
  for (const view of scene.views) {
    if (state.node !== null) gpu.upload("node " + view.name, view.drawn.slice(3 * state.node, 3 * state.node + 3));
    const pixels = { x: view.left * ratio, y: canvas.height - (view.top + view.high) * ratio, width: view.wide * ratio, height: view.high * ratio };
    gpu.draw({ ...view, ...pixels }, camera, look);
    paintLabels(pen, view, camera.axes, theme);
  }
}

// where the views are on the canvas; the style sheet puts them side by side or below each other
function place() {
  ratio = Math.min(devicePixelRatio, 2);
  const stage = canvas.getBoundingClientRect();
  for (const each of [canvas, labels]) {
    const [width, height] = [stage.width, stage.height].map((v) => Math.max(1, Math.round(v * ratio)));
    if (each.width !== width || each.height !== height) [each.width, each.height] = [width, height];
  }
  for (const view of scene.views) {
    const area = box.querySelector(`[data-view="${view.name}"]`).getBoundingClientRect();
    Object.assign(view, { left: area.x - stage.x, top: area.y - stage.y, wide: Math.max(1, area.width), high: Math.max(1, area.height) });
  }
}

// the body at rest and as the views draw it, seen from where the view begins, takes most of a view
function fitBody() {
  const [right, up] = axes(cases[state.case].azimuth, PITCH);
  const { points, centre } = scene.geometry;
  const drawn = scene.views.map((v) => v.drawn).filter((at) => at.every(Number.isFinite));
  const reach = [right, up].map((axis) => {
    let low = Infinity, high = -Infinity;
    for (const at of [points, ...drawn]) {
      for (let k = 0; k < at.length; k += 3) {
        const along = axis[0] * (at[k] - centre[0]) + axis[1] * (at[k + 1] - centre[1]) + axis[2] * (at[k + 2] - centre[2]);
        low = Math.min(low, along);
        high = Math.max(high, along);
      }
    }
    for (let k = 0; k < 3; k++) centre[k] += (axis[k] * (low + high)) / 2;
    return (high - low) / 2;
  });
  const { wide, high } = scene.views[0];
  state.fit = Math.min((0.9 * wide) / high / reach[0], (1 - 2 * LABELS / high) / reach[1]);
}

// --- one node's numbers ---

function readNode() {
  const readout = box.querySelector(".readout");
  readout.replaceChildren();
  control("node").value = state.node ?? "";
  if (state.node === null) {
    const note = "Click or tap the surface to read the numbers of a node. Drag to turn, pinch or wheel to zoom.";
    readout.append(Object.assign(document.createElement("p"), { className: "note", textContent: note }));
    return;
  }
  const at = 3 * state.node, shown = cases[state.case];
  const take = (array) => (array ? [...array.slice(at, at + 3)] : null);
  const [x, u, r] = [take(scene.geometry.points), take(scene.u), take(scene.r)];
  const rows = [[state.model, u]];
  if (scene.views.length > 1) rows.push([`${shown.reference} (reference)`, r], ["difference", gap(u, r)]);
  const [factor, unit] = lengthUnit(largest(rows.map(([, v]) => (v ? Math.hypot(...v) : 0))));
  const [scale, scaleUnit] = lengthUnit(scene.geometry.radius);
  const table = document.createElement("table");
  table.createCaption().textContent = `Node ${state.node} at (${x.map((v) => digits(v / scale)).join(", ")}) ${scaleUnit}`;
  const head = table.createTHead().insertRow(), body = table.createTBody();
  const heading = (text, scope, className = "") => Object.assign(document.createElement("th"), { textContent: text, scope, className });
  head.append(heading(`displacement [${unit}]`, "col"), ...["x", "y", "z", "length"].map((text) => heading(text, "col", "number")));
  for (const [name, v] of rows) {
    const row = body.insertRow();
    row.append(heading(name, "row"));
    for (const number of v ? [...v, Math.hypot(...v)] : [null, null, null, null]) {
      const text = number === null ? "–" : digits(number / factor);
      Object.assign(row.insertCell(), { className: "number", textContent: text });
    }
  }
  readout.append(table);
}

function pick(clientX, clientY) {
  const stage = canvas.getBoundingClientRect(), [x, y] = [clientX - stage.x, clientY - stage.y];
  const view = scene.views.find((v) => x >= v.left && x <= v.left + v.wide && y >= v.top && y <= v.top + v.high);
  if (!view) return;
  const [right, up, towards] = axes(), [sx, sy] = sizes(), { centre, triangles } = scene.geometry;
  const px = (((x - view.left) / view.wide) * 2 - 1) / sx, py = (1 - ((y - view.top) / view.high) * 2) / sy;
  const seen = (axis, node) => [0, 1, 2].reduce((sum, k) => sum + axis[k] * (view.drawn[3 * node + k] - centre[k]), 0);
  let found = null, nearest = -Infinity;
  for (let f = 0; f < triangles.length; f += 3) {
    const corners = [...triangles.subarray(f, f + 3)];
    const [ax, bx, cx] = corners.map((n) => seen(right, n) - px), [ay, by, cy] = corners.map((n) => seen(up, n) - py);
    const weights = [bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay];
    const whole = weights[0] + weights[1] + weights[2];
    if (whole <= 0 || weights.some((w) => w < 0)) continue; // seen from behind, or beside the point
    const depth = corners.reduce((sum, n, k) => sum + (weights[k] / whole) * seen(towards, n), 0);
    if (depth <= nearest) continue;
    nearest = depth;
    found = corners[weights.indexOf(Math.max(...weights))];
  }
  chooseNode(found);
}

function chooseNode(node) {
  state.node = node;
  readNode();
  redraw();
}

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
  Object.assign(state, { case: index, step: shown.opens, scale: shown.scale, node: null });
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
