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
