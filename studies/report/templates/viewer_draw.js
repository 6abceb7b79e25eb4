// What the page's JSON holds, decoded when it is first needed: surfaces, regions, displacements.

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const once = (make) => { let made; return () => (made ??= make()); };
const indices = (text, wide) => Uint32Array.from(wide ? new Uint32Array(bytes(text)) : new Uint16Array(bytes(text)));

function geometryOf(g) {
  const points = Float32Array.from(new Uint16Array(bytes(g.points)), (v, k) => g.low[k % 3] + g.step[k % 3] * v);
  const triangles = indices(g.triangles, g.wide);
  return { points, triangles, wide: g.wide, edges: edgesOf(triangles), ...sphereOf(points) };
}

// a closed surface has each edge once in either direction
function edgesOf(triangles) {
  const out = [];
  for (let f = 0; f < triangles.length; f += 3) {
    for (let k = 0; k < 3; k++) {
      const [a, b] = [triangles[f + k], triangles[f + ((k + 1) % 3)]];
      if (a < b) out.push(a, b);
    }
  }
  return new Uint32Array(out);
}

// the edges around the facets whose three nodes are in a region: those that only one of them has
function rimOf(triangles, nodes) {
  const inside = new Set(nodes), open = new Map();
  for (let f = 0; f < triangles.length; f += 3) {
    const corners = [...triangles.subarray(f, f + 3)];
    if (!corners.every((node) => inside.has(node))) continue;
    corners.forEach((a, k) => {
      const b = corners[(k + 1) % 3];
      if (!open.delete(`${b} ${a}`)) open.set(`${a} ${b}`, [a, b]);
    });
  }
  return new Uint32Array([...open.values()].flat());
}

function sphereOf(points) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < points.length; k++) {
    low[k % 3] = Math.min(low[k % 3], points[k]);
    high[k % 3] = Math.max(high[k % 3], points[k]);
  }
  const centre = low.map((v, k) => (v + high[k]) / 2);
  let radius = 0;
  for (let k = 0; k < points.length; k += 3) {
    radius = Math.max(radius, Math.hypot(points[k] - centre[0], points[k + 1] - centre[1], points[k + 2] - centre[2]));
  }
  return { centre, radius };
}

function stepOf(step) {
  const field = once(() => (step.data === undefined ? null : Float32Array.from(new Int16Array(bytes(step.data)), (v) => v * step.scale)));
  return { message: step.message, field };
}

function decoded(data) {
  const geometries = data.geometries.map((g) => once(() => geometryOf(g)));
  const cases = data.cases.map((c) => ({
    ...c,
    geometry: geometries[c.geometry],
    rims: once(() => c.regions.map((r) => {
      const { triangles, wide } = geometries[c.geometry]();
      return { colour: data.regionColours[r.kind], edges: rimOf(triangles, indices(r.nodes, wide)) };
    })),
    models: c.models.map((m) => ({ name: m.name, steps: m.steps.map(stepOf) })),
  }));
  const ramps = Object.fromEntries(Object.entries(data.colours).map(([name, text]) => [name, new Uint8Array(bytes(text))]));
  return { cases, ramps, focus: data.focus };
}

// --- fields and numbers ---

const norms = (field) => Float32Array.from({ length: field.length / 3 }, (_, k) => Math.hypot(field[3 * k], field[3 * k + 1], field[3 * k + 2]));
const gap = (a, b) => (a && b ? a.map((v, k) => v - b[k]) : null);
const largest = (values) => values.reduce((a, b) => Math.max(a, b), 0);
const peak = (fields) => largest(fields.filter(Boolean).map((field) => largest(norms(field))));

const lengthUnit = (top) => (top >= 0.5 ? [1, "m"] : top >= 1e-4 ? [1e-3, "mm"] : [1e-6, "µm"]);
const digits = (v) => (v === 0 ? "0" : Number(v.toPrecision(3)).toString().replace("-", "−"));

// round values from 0 up to `top`, at most six
function ticksTo(top) {
  if (!(top > 0)) return [0];
  const decade = 10 ** Math.floor(Math.log10(top / 5));
  const step = [1, 2, 5, 10].map((s) => s * decade).find((s) => top / s <= 5.001);
  return Array.from({ length: Math.floor(top / step + 1e-9) + 1 }, (_, k) => k * step);
}

// Drawing with WebGL 2. All that the graphics card holds is made here, and made again after its context was lost.

const VERTEX = `
  in vec3 position; in float value;
  uniform mat3 turn; uniform vec3 centre, size; uniform vec3 shift; uniform float point;
  out vec3 eye; out float shade;
  void main() {
    eye = turn * (position - centre); shade = value;
    gl_Position = vec4(eye * size + shift, 1.0); gl_PointSize = point;
  }`;
const SURFACE = `
  in vec3 eye; in float shade;
  uniform sampler2D ramp;
  out vec4 colour;
  void main() {
    vec3 normal = normalize(cross(dFdx(eye), dFdy(eye)));
    float above = max(dot(normal, normalize(vec3(-0.4, 0.7, 0.6))), 0.0);
    float light = 0.62 + 0.30 * max(normal.z, 0.0) + 0.16 * above;
    colour = vec4(texture(ramp, vec2(clamp(shade, 0.0, 1.0) * 0.996 + 0.002, 0.5)).rgb * light, 1.0);
  }`;
const FLAT = `
  in vec3 eye; in float shade;
  uniform vec4 ink; uniform bool dot_;
  out vec4 colour;
  void main() {
    if (dot_ && distance(gl_PointCoord, vec2(0.5)) > 0.5) discard;
    colour = vec4(ink.rgb * ink.a, ink.a);
  }`;
const AROUND = [[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]]; // of a thick line
const NEARER = 0.004; // of a thick line, so that the facets beside it do not cut it

function makeGpu(gl, ramps) {
  const program = (fragment) => {
    const made = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
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
  const surface = program(SURFACE), flat = program(FLAT);

  const textures = Object.fromEntries(Object.entries(ramps).map(([name, colours]) => {
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    return [name, texture];
  }));

  const buffers = {};
  const upload = (name, array) => {
    const target = array instanceof Uint32Array ? gl.ELEMENT_ARRAY_BUFFER : gl.ARRAY_BUFFER;
    buffers[name] ??= { made: gl.createBuffer(), size: 0 };
    buffers[name].size = array.length;
    gl.bindBuffer(target, buffers[name].made);
    gl.bufferData(target, array, gl.DYNAMIC_DRAW);
  };
  const attribute = (index, name, size) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name].made);
    gl.enableVertexAttribArray(index);
    gl.vertexAttribPointer(index, size, gl.FLOAT, false, 0, 0);
  };
  const elements = (mode, name) => {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[name].made);
    gl.drawElements(mode, buffers[name].size, gl.UNSIGNED_INT, 0);
  };

  function clear() {
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  // one view: {name, ramp, x, y, width, height in pixels from below}; camera: {axes, centre, sizes}
  function draw(view, camera, look) {
    gl.viewport(view.x, view.y, view.width, view.height);
    const use = (p, point = 1) => {
      gl.useProgram(p.made);
      const [right, up, towards] = camera.axes;
      gl.uniformMatrix3fv(p.at("turn"), false, [0, 1, 2].flatMap((k) => [right[k], up[k], towards[k]]));
      gl.uniform3fv(p.at("centre"), camera.centre);
      gl.uniform3fv(p.at("size"), camera.sizes);
      gl.uniform3f(p.at("shift"), 0, 0, 0);
      gl.uniform1f(p.at("point"), point);
    };
    const lines = (positions, edges, colour, thickness = 0) => {
      use(flat);
      gl.uniform4fv(flat.at("ink"), colour);
      gl.uniform1i(flat.at("dot_"), 0);
      attribute(0, positions, 3);
      gl.disableVertexAttribArray(1);
      for (const [x, y] of thickness ? AROUND : [[0, 0]]) {
        const nearer = thickness ? -NEARER : 0;
        gl.uniform3f(flat.at("shift"), (2 * thickness * x) / view.width, (2 * thickness * y) / view.height, nearer);
        elements(gl.LINES, edges);
      }
    };
    const dots = (positions, size, colour) => {
      attribute(0, positions, 3);
      use(flat, size * look.ratio);
      gl.uniform4fv(flat.at("ink"), colour);
      gl.uniform1i(flat.at("dot_"), 1);
      gl.drawArrays(gl.POINTS, 0, 1);
    };
    const deformed = "deformed " + view.name;
    use(surface);
    gl.bindTexture(gl.TEXTURE_2D, textures[view.ramp]);
    attribute(0, deformed, 3);
    attribute(1, "value " + view.name, 1);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    elements(gl.TRIANGLES, "triangles");
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (look.edges) lines(deformed, "edges", look.edges);
    if (look.rest) lines("rest", "edges", look.rest);
    gl.depthMask(false); // a line does not hide the finer one upon it
    for (const { name, colour, halo } of look.rims) {
      lines(deformed, name, halo, 1.8 * look.ratio);
      lines(deformed, name, colour, 0.8 * look.ratio);
    }
    gl.depthMask(true);
    if (!look.node) return;
    gl.disable(gl.DEPTH_TEST);
    for (const [size, colour] of look.node) dots("node " + view.name, size, colour);
    gl.enable(gl.DEPTH_TEST);
  }

  return { upload, clear, draw };
}

// What stands on the views, painted on a canvas above them and on saved pictures: titles, colour bars, axes.

function coloursOf(element) {
  const style = getComputedStyle(element);
  const named = (name) => style.getPropertyValue(name).trim();
  return { ink: named("--ink"), quiet: named("--quiet"), paper: named("--paper"), panel: named("--panel") };
}

// a CSS colour as four shares for the graphics card
function rgba(colour, alpha) {
  const probe = document.createElement("canvas").getContext("2d");
  probe.fillStyle = colour;
  probe.fillRect(0, 0, 1, 1);
  return [...probe.getImageData(0, 0, 1, 1).data.slice(0, 3)].map((v) => v / 255).concat(alpha);
}

function fitted(pen, text, width) {
  if (pen.measureText(text).width <= width) return text;
  let kept = text;
  while (kept && pen.measureText(kept + "…").width > width) kept = kept.slice(0, -1);
  return kept + "…";
}

// view: {left, top, wide, high} in CSS pixels, title, words, range (of the colours, in metres), colours (256 RGB)
function paintLabels(pen, view, axes, theme) {
  const { left, top, wide, high } = view;
  pen.textBaseline = "alphabetic";
  pen.textAlign = "left";
  pen.font = "600 13px system-ui, sans-serif";
  pen.fillStyle = theme.ink;
  pen.fillText(fitted(pen, view.title, wide - 24), left + 12, top + 22);
  pen.font = "12px system-ui, sans-serif";
  pen.fillStyle = theme.quiet;
  view.words.forEach((line, k) => pen.fillText(fitted(pen, line, wide - 24), left + 12, top + 40 + 17 * k));
  paintBar(pen, view, theme);
  paintTriad(pen, left + 38, top + high - 38, axes, theme);
}

// along the lower edge of a view, to the right of the axes
function paintBar(pen, view, theme) {
  const [factor, unit] = lengthUnit(view.range);
  const from = view.left + 84, length = view.wide - 84 - 44, upper = view.top + view.high - 36;
  for (let k = 0; k < length; k++) {
    const at = 3 * Math.round((255 * k) / length);
    pen.fillStyle = `rgb(${view.colours.slice(at, at + 3).join(",")})`;
    pen.fillRect(from + k, upper, 1, 9);
  }
  pen.fillStyle = pen.strokeStyle = theme.quiet;
  pen.textAlign = "center";
  pen.lineWidth = 1;
  for (const value of ticksTo(view.range / factor)) {
    const x = Math.round(from + length * (view.range > 0 ? (value * factor) / view.range : 0)) + 0.5;
    pen.beginPath();
    pen.moveTo(x, upper + 9);
    pen.lineTo(x, upper + 13);
    pen.stroke();
    pen.fillText(digits(value), x, upper + 25);
  }
  pen.textAlign = "left";
  pen.fillText(unit, from + length + 10, upper + 9);
}

// the axis that points away from the viewer most is painted first
function paintTriad(pen, x, y, axes, theme) {
  const [right, up, towards] = axes;
  const names = ["x", "y", "z"].map((name, k) => ({ name, k })).sort((a, b) => towards[a.k] - towards[b.k]);
  pen.strokeStyle = pen.fillStyle = theme.ink;
  pen.lineWidth = 1.4;
  pen.textAlign = "center";
  for (const { name, k } of names) {
    const [dx, dy] = [right[k], -up[k]];
    const length = Math.hypot(dx, dy);
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(x + 22 * dx, y + 22 * dy);
    if (length > 0.2) {
      const [ux, uy] = [dx / length, dy / length], [tipX, tipY] = [x + 22 * dx, y + 22 * dy];
      pen.moveTo(tipX - 5 * ux + 3 * uy, tipY - 5 * uy - 3 * ux);
      pen.lineTo(tipX, tipY);
      pen.lineTo(tipX - 5 * ux - 3 * uy, tipY - 5 * uy + 3 * ux);
    }
    pen.stroke();
    pen.fillText(name, x + 30 * dx, y + 30 * dy + 4);
  }
}

// the views as they are, with a line below that tells what they show: a data URL
function savedPicture(gl, labels, ratio, line, theme) {
  const out = document.createElement("canvas");
  const foot = Math.round(30 * ratio);
  [out.width, out.height] = [gl.width, gl.height + foot];
  const pen = out.getContext("2d");
  pen.fillStyle = theme.panel;
  pen.fillRect(0, 0, out.width, out.height);
  pen.drawImage(gl, 0, 0);
  pen.drawImage(labels, 0, 0);
  pen.scale(ratio, ratio);
  pen.font = "12px system-ui, sans-serif";
  pen.fillStyle = theme.quiet;
  pen.fillText(fitted(pen, line, out.width / ratio - 24), 12, gl.height / ratio + 19);
  return out.toDataURL("image/png");
}
