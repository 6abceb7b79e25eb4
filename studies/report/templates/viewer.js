"use strict";
// The deformed surfaces of the page's key cases in WebGL 2, from the JSON beside it. Nothing is loaded.
(() => {
  const box = document.querySelector(".viewer");
  const canvas = box.querySelector(".stage > canvas");
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) return; // the still pictures stay
  const data = JSON.parse(document.querySelector(".viewer-data").textContent);
  const control = (name) => box.querySelector(`[data-control="${name}"]`);
  const output = (name) => box.querySelector(`[data-output="${name}"]`);

  // --- decoding ---

  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const once = (make) => { let made; return () => (made ??= make()); };

  const geometries = data.geometries.map((g) => once(() => {
    const raw = new Uint16Array(bytes(g.points));
    const points = Float32Array.from(raw, (v, k) => g.low[k % 3] + g.step[k % 3] * v);
    const triangles = g.wide ? new Uint32Array(bytes(g.triangles)) : Uint32Array.from(new Uint16Array(bytes(g.triangles)));
    return { points, triangles, edges: edgesOf(triangles), ...sphereOf(points) };
  }));

  function edgesOf(triangles) {
    const out = [];
    for (let f = 0; f < triangles.length; f += 3) {
      for (let k = 0; k < 3; k++) {
        const [a, b] = [triangles[f + k], triangles[f + ((k + 1) % 3)]];
        if (a < b) out.push(a, b); // a closed surface has each edge once in either direction
      }
    }
    return new Uint32Array(out);
  }

  function sphereOf(points) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let k = 0; k < points.length; k++) {
      low[k % 3] = Math.min(low[k % 3], points[k]);
      high[k % 3] = Math.max(high[k % 3], points[k]);
    }
    const centre = low.map((v, k) => (v + high[k]) / 2);
    let radius = 0;
    for (let k = 0; k < points.length; k += 3) radius = Math.max(radius, Math.hypot(points[k] - centre[0], points[k + 1] - centre[1], points[k + 2] - centre[2]));
    return { centre, radius };
  }

  const cases = data.cases.map((c) => ({
    ...c,
    models: c.models.map((m) => ({
      name: m.name,
      steps: m.steps.map((s) => ({
        message: s.message,
        field: once(() => (s.data === undefined ? null : Float32Array.from(new Int16Array(bytes(s.data)), (v) => v * s.scale))),
      })),
    })),
  }));

  // --- drawing ---

  const program = (vertex, fragment) => {
    const made = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, "#version 300 es\nprecision highp float;\n" + source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.bindAttribLocation(made, 0, "position");
    gl.bindAttribLocation(made, 1, "value");
    gl.linkProgram(made);
    return { made, at: (name) => gl.getUniformLocation(made, name) };
  };
  const VERTEX = `
    in vec3 position; in float value;
    uniform mat3 turn; uniform vec3 centre, size; uniform float point;
    out vec3 eye; out float shade;
    void main() {
      eye = turn * (position - centre); shade = value;
      gl_Position = vec4(eye * size, 1.0); gl_PointSize = point;
    }`;
  const surface = program(VERTEX, `
    in vec3 eye; in float shade;
    uniform sampler2D ramp;
    out vec4 colour;
    void main() {
      vec3 normal = normalize(cross(dFdx(eye), dFdy(eye)));
      float light = 0.62 + 0.30 * max(normal.z, 0.0) + 0.16 * max(dot(normal, normalize(vec3(-0.4, 0.7, 0.6))), 0.0);
      colour = vec4(texture(ramp, vec2(clamp(shade, 0.0, 1.0) * 0.996 + 0.002, 0.5)).rgb * light, 1.0);
    }`);
  const flat = program(VERTEX, `
    in vec3 eye; in float shade;
    uniform vec4 ink; uniform bool dot_;
    out vec4 colour;
    void main() {
      if (dot_ && distance(gl_PointCoord, vec2(0.5)) > 0.5) discard;
      colour = vec4(ink.rgb * ink.a, ink.a);
    }`);

  const ramps = Object.fromEntries(Object.entries(data.colours).map(([name, text]) => {
    const colours = new Uint8Array(bytes(text));
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
    for (const [key, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, key, value);
    return [name, { colours, texture }];
  }));

  const buffers = Object.fromEntries(["deformed", "rest", "value", "node", "triangles", "edges"].map((name) => [name, gl.createBuffer()]));
  const upload = (name, array, target = gl.ARRAY_BUFFER) => {
    gl.bindBuffer(target, buffers[name]);
    gl.bufferData(target, array, gl.DYNAMIC_DRAW);
  };
  const attribute = (index, name, size) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, size, gl.FLOAT, false, 0, 0);
  };

  const PITCH = 0.38; // from where the view begins, above the horizon
  const state = { case: 0, model: "", show: "model", step: 0, scale: 1, node: null, yaw: 0, pitch: PITCH, zoom: 1, fit: 1 };
  let scene = null; // what is uploaded: geometry, drawn positions, fields, range
  let waiting = false;
  const redraw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  };

  const axes = (yaw = state.yaw, pitch = state.pitch) => {
    const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
    return [[-sy, cy, 0], [-cy * sp, -sy * sp, cp], [cy * cp, sy * cp, sp]]; // right, up, towards the viewer
  };
  const sizes = () => {
    const aspect = canvas.width / canvas.height;
    const s = state.zoom * state.fit;
    return [s / aspect, s, -0.2 / scene.geometry.radius];
  };

  const ink = (variable, alpha) => {
    const probe = document.createElement("canvas").getContext("2d");
    probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(variable).trim();
    probe.fillRect(0, 0, 1, 1);
    return [...[...probe.getImageData(0, 0, 1, 1).data].slice(0, 3).map((v) => v / 255), alpha];
  };

  function draw() {
    const [right, up, towards] = axes();
    const { geometry } = scene;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const use = (p, point = 1) => {
      gl.useProgram(p.made);
      gl.uniformMatrix3fv(p.at("turn"), false, [0, 1, 2].flatMap((k) => [right[k], up[k], towards[k]]));
      gl.uniform3fv(p.at("centre"), geometry.centre);
      gl.uniform3fv(p.at("size"), sizes());
      gl.uniform1f(p.at("point"), point);
    };
    const lines = (positions, colour) => {
      use(flat);
      gl.uniform4fv(flat.at("ink"), colour);
      gl.uniform1i(flat.at("dot_"), 0);
      attribute(0, positions, 3);
      gl.disableVertexAttribArray(1);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.edges);
      gl.drawElements(gl.LINES, geometry.edges.length, gl.UNSIGNED_INT, 0);
    };
    use(surface);
    gl.bindTexture(gl.TEXTURE_2D, ramps[scene.ramp].texture);
    attribute(0, "deformed", 3);
    attribute(1, "value", 1);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.triangles);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    gl.drawElements(gl.TRIANGLES, geometry.triangles.length, gl.UNSIGNED_INT, 0);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (control("edges").checked) lines("deformed", ink("--paper", 0.35));
    if (control("rest").checked) lines("rest", ink("--ink", 0.28));
    if (state.node !== null) {
      const at = 3 * state.node;
      upload("node", scene.drawn.slice(at, at + 3));
      attribute(0, "node", 3);
      gl.disable(gl.DEPTH_TEST);
      for (const [size, variable] of [[13, "--paper"], [9, "--ink"]]) {
        use(flat, size * devicePixelRatio);
        gl.uniform4fv(flat.at("ink"), ink(variable, 1));
        gl.uniform1i(flat.at("dot_"), 1);
        gl.drawArrays(gl.POINTS, 0, 1);
      }
    }
  }

  // --- what is shown ---

  const modelNamed = (name) => cases[state.case].models.find((m) => m.name === name);
  const norms = (field) => Float32Array.from({ length: field.length / 3 }, (_, k) => Math.hypot(field[3 * k], field[3 * k + 1], field[3 * k + 2]));
  const gap = (a, b) => (a && b ? a.map((v, k) => v - b[k]) : null);
  const peak = (fields) => fields.filter(Boolean).reduce((top, field) => norms(field).reduce((a, b) => Math.max(a, b), top), 0);
  const fields = (name) => (modelNamed(name)?.steps ?? []).map((s) => s.field());

  const lengthUnit = (top) => (top >= 0.5 ? [1, "m"] : top >= 1e-4 ? [1e-3, "mm"] : [1e-6, "µm"]);
  const digits = (v) => (v === 0 ? "0" : Number(v.toPrecision(3)).toString().replace("-", "−"));

  function rebuild() {
    const shown = cases[state.case];
    const geometry = geometries[shown.geometry]();
    const fresh = scene?.geometry !== geometry;
    const name = state.show === "reference" ? shown.reference : state.model;
    const u = fields(name)[state.step], r = shown.reference ? fields(shown.reference)[state.step] : null;
    const difference = state.show === "difference";
    const coloured = difference ? gap(u, r) : u;
    const own = fields(state.model), reference = shown.reference ? fields(shown.reference) : [];
    const top = difference ? peak(own.map((f, k) => gap(f, reference[k]))) : peak([...own, ...reference]);
    const drawn = geometry.points.map((v, k) => v + state.scale * (u ? u[k] : 0));
    const values = coloured ? norms(coloured).map((v) => (top > 0 ? v / top : 0)) : new Float32Array(geometry.points.length / 3);
    scene = { geometry, drawn, top, u: fields(state.model)[state.step], r, ramp: difference ? "difference" : "displacement" };
    upload("deformed", drawn);
    upload("value", values);
    if (fresh) {
      upload("rest", geometry.points);
      upload("triangles", geometry.triangles, gl.ELEMENT_ARRAY_BUFFER);
      upload("edges", geometry.edges, gl.ELEMENT_ARRAY_BUFFER);
      control("node").max = geometry.points.length / 3 - 1;
    }
    describe(shown, name, modelNamed(name)?.steps[state.step].message);
    readNode();
    redraw();
  }

  function describe(shown, name, message) {
    const [factor, unit] = lengthUnit(scene.top);
    box.querySelector(".bar .high").textContent = `${digits(scene.top / factor)} ${unit}`;
    box.querySelector(".bar .low").textContent = "0";
    const what = state.show === "difference" ? `|${state.model} − ${shown.reference}|` : `${name}: |displacement|`;
    box.querySelector(".quantity").textContent = `${what}\n${shown.name}` + (message ? `\nstopped at this load: ${message}` : "");
    output("step").textContent = `× ${digits(shown.factors[state.step])}`;
    output("scale").textContent = `drawn × ${digits(state.scale)}`;
    const ramp = box.querySelector(".ramp").getContext("2d");
    const { colours } = ramps[scene.ramp];
    const image = ramp.createImageData(1, 256);
    for (let k = 0; k < 256; k++) image.data.set([...colours.slice(3 * (255 - k), 3 * (255 - k) + 3), 255], 4 * k);
    ramp.putImageData(image, 0, 0);
  }

  function readNode() {
    const readout = box.querySelector(".readout");
    readout.replaceChildren();
    control("node").value = state.node ?? "";
    if (state.node === null) {
      readout.append(Object.assign(document.createElement("p"), { className: "note", textContent: "Click or tap the surface to read the numbers of a node. Drag to turn, pinch or wheel to zoom." }));
      return;
    }
    const at = 3 * state.node;
    const take = (array) => (array ? [...array.slice(at, at + 3)] : null);
    const [x, u, r] = [take(scene.geometry.points), take(scene.u), take(scene.r)];
    const shown = cases[state.case];
    const reference = shown.reference !== null && shown.reference !== state.model;
    const rows = [[state.model, u]];
    if (reference) rows.push([`${shown.reference} (reference)`, r], ["difference", u && r ? u.map((v, k) => v - r[k]) : null]);
    const [factor, unit] = lengthUnit(Math.max(0, ...rows.flatMap(([, v]) => (v ? [Math.hypot(...v)] : []))));
    const [place, placeUnit] = lengthUnit(scene.geometry.radius);
    const table = document.createElement("table");
    table.createCaption().textContent = `Node ${state.node} at (${x.map((v) => digits(v / place)).join(", ")}) ${placeUnit}`;
    const head = table.createTHead().insertRow();
    for (const text of [`displacement [${unit}]`, "x", "y", "z", "length"]) head.append(Object.assign(document.createElement("th"), { textContent: text, scope: "col", className: text.length > 9 ? "" : "number" }));
    const body = table.createTBody();
    for (const [name, v] of rows) {
      const row = body.insertRow();
      row.append(Object.assign(document.createElement("th"), { textContent: name, scope: "row" }));
      for (const number of v ? [...v, Math.hypot(...v)] : [null, null, null, null]) {
        const cell = row.insertCell();
        cell.className = "number";
        cell.textContent = number === null ? "–" : digits(number / factor);
      }
    }
    readout.append(table);
  }

  // --- turning, zooming, picking ---

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

  // the body at rest and as it is drawn, seen from where the view begins, takes most of the stage
  function fitBody() {
    const [right, up] = axes(cases[state.case].azimuth, PITCH);
    const { points, centre } = scene.geometry;
    const places = scene.drawn.every(Number.isFinite) ? [points, scene.drawn] : [points];
    const reach = [right, up].map((axis) => {
      let low = Infinity, high = -Infinity;
      for (const at of places) {
        for (let k = 0; k < at.length; k += 3) {
          const along = axis[0] * (at[k] - centre[0]) + axis[1] * (at[k + 1] - centre[1]) + axis[2] * (at[k + 2] - centre[2]);
          low = Math.min(low, along);
          high = Math.max(high, along);
        }
      }
      for (let k = 0; k < 3; k++) centre[k] += (axis[k] * (low + high)) / 2;
      return (high - low) / 2;
    });
    state.fit = Math.min((0.82 * canvas.width) / canvas.height / reach[0], 0.78 / reach[1]);
  }

  function pick(clientX, clientY) {
    const area = canvas.getBoundingClientRect();
    const [right, up, towards] = axes(), [sx, sy] = sizes();
    const px = (((clientX - area.left) / area.width) * 2 - 1) / sx, py = (1 - ((clientY - area.top) / area.height) * 2) / sy;
    const { drawn, geometry } = scene;
    const seen = (axis, node) => axis[0] * (drawn[3 * node] - geometry.centre[0]) + axis[1] * (drawn[3 * node + 1] - geometry.centre[1]) + axis[2] * (drawn[3 * node + 2] - geometry.centre[2]);
    let found = null, nearest = -Infinity;
    for (let f = 0; f < geometry.triangles.length; f += 3) {
      const corners = geometry.triangles.subarray(f, f + 3);
      const [ax, bx, cx] = [...corners].map((n) => seen(right, n) - px), [ay, by, cy] = [...corners].map((n) => seen(up, n) - py);
      const weights = [bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay];
      const whole = weights[0] + weights[1] + weights[2];
      if (whole <= 0 || weights.some((w) => w < 0)) continue; // seen from behind, or beside the point
      const depth = [...corners].reduce((sum, n, k) => sum + (weights[k] / whole) * seen(towards, n), 0);
      if (depth <= nearest) continue;
      nearest = depth;
      found = corners[weights.indexOf(Math.max(...weights))];
    }
    state.node = found;
    readNode();
    redraw();
  }

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
    const area = canvas.getBoundingClientRect();
    const actions = {
      ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
      "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(1 / 1.15), 0: resetView,
      Enter: () => pick(area.left + area.width / 2, area.top + area.height / 2),
    };
    if (!actions[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    actions[event.key]();
  });

  // --- controls ---

  const option = (text, value) => Object.assign(document.createElement("option"), { textContent: text, value });
  control("case").append(...cases.map((c, k) => option(c.title, k)));
  control("case").closest("label").hidden = cases.length < 2;

  function chooseCase(index) {
    const shown = cases[index];
    const others = shown.models.filter((m) => m.name !== shown.reference).map((m) => m.name);
    const names = others.length ? others : shown.models.map((m) => m.name);
    const full = shown.factors.reduce((best, f, k, all) => (Math.abs(f) >= Math.abs(all[best]) ? k : best), 0);
    Object.assign(state, { case: index, step: full, scale: shown.scale, node: null });
    if (!names.includes(state.model)) state.model = names.includes(data.focus) ? data.focus : names[0];
    control("model").replaceChildren(...names.map((name) => option(name, name)));
    control("model").value = state.model;
    const kinds = shown.reference && others.length ? [["model", "Model"], ["reference", "Reference"], ["difference", "Difference"]] : [["model", "Model"]];
    if (!kinds.some(([kind]) => kind === state.show)) state.show = "model";
    control("show").hidden = kinds.length < 2;
    control("show").querySelectorAll("label").forEach((label) => label.remove());
    for (const [kind, text] of kinds) {
      const label = document.createElement("label");
      const radio = Object.assign(document.createElement("input"), { type: "radio", name: "viewer-show", value: kind, checked: kind === state.show });
      radio.addEventListener("change", () => { state.show = kind; rebuild(); });
      label.append(radio, " " + text);
      control("show").append(label);
    }
    control("step").max = shown.factors.length - 1;
    control("step").value = state.step;
    control("step").closest("label").hidden = shown.factors.length < 2;
    control("scale").value = 50;
    rebuild();
    resetView();
  }

  control("case").addEventListener("change", (event) => chooseCase(Number(event.target.value)));
  control("model").addEventListener("change", (event) => { state.model = event.target.value; rebuild(); });
  control("step").addEventListener("input", (event) => { state.step = Number(event.target.value); rebuild(); });
  control("scale").addEventListener("input", (event) => { state.scale = (cases[state.case].scale * event.target.value) / 50; rebuild(); });
  for (const name of ["rest", "edges"]) control(name).addEventListener("change", redraw);
  control("reset").addEventListener("click", resetView);
  control("node").addEventListener("change", (event) => {
    const node = Number(event.target.value);
    const valid = event.target.value !== "" && Number.isInteger(node) && node >= 0 && node < scene.geometry.points.length / 3;
    state.node = valid ? node : null;
    readNode();
    redraw();
  });

  const give_up = (event) => {
    event.preventDefault();
    box.hidden = true;
    document.documentElement.classList.remove("has-viewer");
  };
  canvas.addEventListener("webglcontextlost", give_up);
  box.hidden = false;
  document.documentElement.classList.add("has-viewer");
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  const fit = () => {
    const ratio = Math.min(devicePixelRatio, 2);
    [canvas.width, canvas.height] = [canvas.clientWidth * ratio, canvas.clientHeight * ratio].map((v) => Math.max(1, Math.round(v)));
    if (!scene) return;
    fitBody();
    redraw();
  };
  fit();
  new ResizeObserver(fit).observe(canvas);
  chooseCase(0);
})();
