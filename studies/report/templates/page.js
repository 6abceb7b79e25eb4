"use strict";
// Tables: copy, download as CSV, sort, unfold. The page is complete without this script.
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
  const title = (cell) => {
    const unit = cell.dataset.unit ? " [" + cell.dataset.unit + "]" : "";
    return safe(words(cell).filter(Boolean).join(", ") + unit);
  };
  const separated = (table, separator, quote) =>
    [...table.rows]
      .map((row, k) => [...row.cells].map((cell) => quote(k ? entry(cell) : title(cell))).join(separator))
      .join("\n") + "\n";

  const download = (table) => {
    const link = document.createElement("a");
    link.download = table.dataset.name + ".csv";
    link.href = "data:text/csv;charset=utf-8," + encodeURIComponent(separated(table, ",", quoted));
    link.click();
    return link.href;
  };

  const copy = async (table, button) => {
    const text = separated(table, "\t", (t) => t.replace(/[\t\n\r]+/g, " "));
    const label = button.textContent;
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "Copied";
    } catch {
      button.textContent = "Copying is blocked here";
    }
    setTimeout(() => { button.textContent = label; }, 1600);
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
        else if (button.dataset.action === "copy") copy(table, button);
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
