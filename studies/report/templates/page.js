"use strict";
// Tables: download as CSV, sort, unfold. The page is complete without this script.
(() => {
  document.documentElement.classList.add("scripted");

  const words = (cell) => {
    const detail = cell.querySelector(".detail");
    const own = cell.textContent.slice(0, cell.textContent.length - (detail ? detail.textContent.length : 0));
    return [own.trim(), detail ? detail.textContent.trim().replaceAll("\n", ", ") : ""];
  };

  // a text that a spreadsheet would run as a formula gets a quote in front; numbers stay numbers
  const safe = (text) => (/^[=+\-@\t\r]/.test(text) ? "'" + text : text);
  const quoted = (text) => (/[",\n\r]/.test(text) ? '"' + text.replaceAll('"', '""') + '"' : text);

  const entry = (cell) => {
    if (cell.dataset.value !== undefined) return cell.dataset.value;
    return safe(words(cell).filter(Boolean).join(", "));
  };
  const title = (cell, bar = "") => {
    const unit = cell.dataset.unit ? " [" + cell.dataset.unit + "]" : "";
    return safe(words(cell).filter(Boolean).join(", ") + bar + unit);
  };
  // a column of error bars stands after what has some
  const csv = (table) => {
    const [head, ...rows] = [...table.rows];
    const columns = [...head.cells].flatMap((column, k) => {
      const cells = rows.map((row) => row.cells[k]);
      const bars = [title(column, " ±"), ...cells.map((cell) => cell.dataset.bar ?? "")];
      return [[title(column), ...cells.map(entry)], ...(bars.slice(1).some(Boolean) ? [bars] : [])];
    });
    return columns[0].map((_, k) => columns.map((column) => quoted(column[k])).join(",")).join("\n") + "\n";
  };

  const download = (table) => {
    const link = document.createElement("a");
    link.download = table.dataset.name + ".csv";
    link.href = "data:text/csv;charset=utf-8," + encodeURIComponent(csv(table));
    link.click();
    return link.href;
  };

  const sort = (table, index, head) => {
    const down = head.getAttribute("aria-sort") !== "descending";
    for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const key = (row) => {
      const cell = row.cells[index];
      return cell.dataset.value === undefined ? cell.textContent.trim() : Number(cell.dataset.value);
    };
    const compare = (a, b) => {
      const [x, y] = [key(a), key(b)];
      if (typeof x !== typeof y) return typeof x === "number" ? -1 : 1;
      const order = typeof x === "number" ? x - y : x.localeCompare(y, undefined, { numeric: true });
      return down ? -order : order;
    };
    const bodies = [...table.tBodies];
    const sizes = bodies.map((body) => body.rows.length);
    const rows = bodies.flatMap((body) => [...body.rows]).sort(compare);
    for (const [k, body] of bodies.entries()) body.append(...rows.splice(0, sizes[k]));
  };

  for (const box of document.querySelectorAll(".table")) {
    const table = box.querySelector("table"), scroll = box.querySelector(".scroll");
    const hint = box.querySelector(".wide");
    if (hint) new ResizeObserver(() => { hint.hidden = scroll.scrollWidth <= scroll.clientWidth + 1; }).observe(scroll);
    for (const button of box.querySelectorAll("[data-action]")) {
      button.hidden = false;
      button.addEventListener("click", () => {
        if (button.dataset.action === "csv") download(table);
        else { box.classList.add("open"); button.remove(); }
      });
    }
    if (table.rows.length < 4) continue;
    for (const [index, head] of [...table.tHead.rows[0].cells].entries()) {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => sort(table, index, head));
    }
  }
})();
"use strict";
// Charts: the case under the pointer in words, and saving a chart as a file. They are complete without this script.
(() => {
  const NEAR = 14; // pixels
  const tip = Object.assign(document.createElement("div"), { className: "tip", hidden: true });
  document.body.append(tip);

  // the points of a chart with their words; places in units of the drawing
  const points = new WeakMap();
  function pointsOf(svg) {
    if (points.has(svg)) return points.get(svg);
    const found = [];
    for (const group of svg.querySelectorAll("[data-told]")) {
      const told = JSON.parse(group.dataset.told), marks = [...group.querySelectorAll("use")];
      const each = told.length === marks.length; // else the drawing left some out
      marks.forEach((mark, k) => found.push({
        x: Number(mark.getAttribute("x")), y: Number(mark.getAttribute("y")),
        words: each ? told[k] : told[0].split("\n")[0],
      }));
    }
    points.set(svg, found);
    return found;
  }

  function showTip(event) {
    const svg = event.target.closest?.(".plot");
    tip.hidden = true;
    if (!svg) return;
    const area = svg.getBoundingClientRect(), scale = area.width / svg.viewBox.baseVal.width;
    const [x, y] = [(event.clientX - area.x) / scale, (event.clientY - area.y) / scale];
    const distance = (p) => Math.hypot(p.x - x, p.y - y) * scale;
    const nearest = pointsOf(svg).reduce((best, p) => (distance(p) < (best ? distance(best) : NEAR) ? p : best), null);
    if (!nearest) return;
    tip.textContent = nearest.words;
    tip.hidden = false;
    const left = area.x + nearest.x * scale + 12;
    tip.style.left = `${scrollX + Math.max(4, Math.min(left, innerWidth - tip.offsetWidth - 8))}px`;
    tip.style.top = `${scrollY + area.y + nearest.y * scale + 12}px`;
  }
  for (const kind of ["pointermove", "pointerdown"]) document.addEventListener(kind, showTip);

  // --- saving ---

  // the values that the page has in light, whatever it is shown in
  const light = document.styleSheets[0].cssRules[0].style;
  const resolved = (text) => text.replace(/var\((--[\w-]+)\)/g, (_, name) => light.getPropertyValue(name).trim());

  function savedChart(figure) {
    const svg = figure.querySelector(".plot").cloneNode(true);
    const { width, height } = figure.querySelector(".plot").viewBox.baseVal;
    svg.setAttribute("width", `${width}pt`);
    svg.setAttribute("height", `${height}pt`);
    svg.setAttribute("style", "fill: var(--ink); font-family: sans-serif; font-size: 8.3px; background: #fff");
    svg.removeAttribute("class");
    for (const group of svg.querySelectorAll("[data-told]")) group.removeAttribute("data-told");
    return resolved(new XMLSerializer().serializeToString(svg));
  }

  for (const button of document.querySelectorAll("[data-action=svg]")) {
    button.hidden = false;
    button.addEventListener("click", () => {
      const figure = button.closest("figure"), title = figure.querySelector("figcaption").textContent;
      const link = document.createElement("a");
      const name = figure.matches(".scene") ? "scene" : title;
      link.download = `${document.title} ${name}`.trim().replace(/[^\w.-]+/g, "-") + ".svg";
      link.href = "data:image/svg+xml;charset=utf-8," + encodeURIComponent(savedChart(figure));
      link.click();
    });
  }
})();
