// Measured points beside a deformed surface: a dot where each was measured, a line from where the model has it, bars.

// positions of dots first, then of line ends; `field` is what moves the nodes (null: no answer), drawn `scale` times
function marksOf(points, measured, step, field, scale) {
  if (!field) return null;
  const dots = [], ends = [], edges = [], gaps = [];
  for (const { step: own, nodes, weights, value, uncertainty } of measured) {
    if (own !== step) continue;
    const at = (array) => [0, 1, 2].map((k) => nodes.reduce((sum, node, c) => sum + weights[c] * array[3 * node + k], 0));
    const rest = at(points), moved = at(field);
    const place = (u) => rest.map((x, k) => x + scale * u[k]);
    const found = moved.map((u, k) => value[k] ?? u); // what was not measured is as the model says
    dots.push(...place(found));
    ends.push(place(moved), place(found));
    value.forEach((v, k) => {
      if (v === null) return;
      for (const sign of [-1, 1]) ends.push(place(found.map((u, j) => u + (j === k ? sign * uncertainty : 0))));
    });
    gaps.push(Math.hypot(...found.map((u, k) => u - moved[k])));
  }
  const count = dots.length / 3;
  for (let k = 0; k < ends.length; k++) edges.push(count + k);
  return { count, positions: new Float32Array([...dots, ...ends.flat()]), edges: new Uint32Array(edges), gaps };
}

// in words, for who does not see them
function marksInWords(marks) {
  if (!marks || !marks.count) return "";
  const worst = largest(marks.gaps), [factor, unit] = lengthUnit(worst);
  return `${marks.count} measured point${marks.count > 1 ? "s" : ""}, up to ${digits(worst / factor)} ${unit} away`;
}
