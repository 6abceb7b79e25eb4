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
