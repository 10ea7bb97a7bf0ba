// Values under the pointer, or under the arrow keys, of every chart in this page: they are in the page as numbers.
// @ts-check
"use strict";
(() => {
  const NS = "http://www.w3.org/2000/svg";
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.setAttribute("role", "status");
  document.body.append(tip);

  /** @param {string | undefined} text */
  const floats = (text) => new Float32Array(Uint8Array.from(atob(text ?? ""), (c) => c.charCodeAt(0)).buffer);
  /** @param {number} value */
  const short = (value) => {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    return size !== 0 && (size < 1e-3 || size >= 1e6) ? value.toExponential(2) : String(Number(value.toPrecision(4)));
  };

  /** @param {Float32Array} x
   * @param {number} value */
  function nearest(x, value) {
    let [low, high] = [0, x.length - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (x[middle] < value) low = middle;
      else high = middle;
    }
    return value - x[low] < x[high] - value ? low : high;
  }

  /** @param {SVGSVGElement} chart */
  function listen(chart) {
    /** @type {{columns: string[], places: number, axes: number[] | null}} */
    const about = JSON.parse(chart.dataset.hover ?? "{}");
    /** @type {Float32Array[] | null} */
    let columns = null;
    let at = -1;
    const mark = document.createElementNS(NS, "path");
    mark.setAttribute("class", "hover");

    const load = () => {
      if (columns) return columns;
      const all = floats(chart.dataset.values);
      const rows = all.length / about.places;
      columns = Array.from({ length: about.places }, (_, i) => all.subarray(i * rows, (i + 1) * rows));
      return columns;
    };

    /** @param {number} index */
    function tell(index) {
      const data = load();
      if (!data[0].length) return;
      at = Math.max(0, Math.min(index, data[0].length - 1));
      const box = chart.getBoundingClientRect();
      const view = chart.viewBox.baseVal;
      let [x, y] = [0, 0];
      let first = 0;
      if (about.axes) {
        const [low, high, start, end, top, bottom] = about.axes;
        x = start + ((data[0][at] - low) / (high - low)) * (end - start);
        y = top;
        mark.setAttribute("d", `M${x} ${top}V${bottom}`);
      } else {
        [x, y] = [data[0][at], data[1][at]];
        first = 2;
        mark.setAttribute("d", `M${x - 7} ${y}H${x + 7}M${x} ${y - 7}V${y + 7}`);
      }
      chart.append(mark);
      const lines = [];
      for (let i = 0, column = first; i < about.columns.length; i++, column++) {
        const band = about.columns[i].endsWith("±");
        const name = band ? about.columns[i].slice(0, -1) : about.columns[i];
        const [, word, unit] = /^(.*?)\s*(?:\[(.*)\])?$/.exec(name) ?? ["", name, ""];
        const value = `${short(data[column][at])}${band ? ` ± ${short(data[++column][at])}` : ""}`;
        lines.push([word, value, unit === "1" ? "" : unit].filter(Boolean).join(" "));
      }
      tip.replaceChildren(...lines.map((line) => Object.assign(document.createElement("div"), { textContent: line })));
      tip.style.display = "block";
      const left = box.left + (x / view.width) * box.width;
      const right = left + 14 + tip.offsetWidth > innerWidth;
      tip.style.left = `${scrollX + Math.max(4, right ? left - 10 - tip.offsetWidth : left + 10)}px`;
      tip.style.top = `${scrollY + box.top + (y / view.height) * box.height + 8}px`;
    }

    function leave() {
      at = -1;
      mark.remove();
      tip.style.display = "none";
    }

    /** @param {PointerEvent} event */
    function point(event) {
      const data = load();
      const box = chart.getBoundingClientRect();
      const view = chart.viewBox.baseVal;
      const x = ((event.clientX - box.left) / box.width) * view.width;
      const y = ((event.clientY - box.top) / box.height) * view.height;
      if (about.axes) {
        const [low, high, start, end] = about.axes;
        tell(nearest(data[0], low + ((x - start) / (end - start)) * (high - low)));
        return;
      }
      let [best, least] = [0, Infinity];
      for (let i = 0; i < data[0].length; i++) {
        const far = (data[0][i] - x) ** 2 + (data[1][i] - y) ** 2;
        if (far < least) [best, least] = [i, far];
      }
      tell(best);
    }

    /** @param {KeyboardEvent} event */
    function press(event) {
      const count = load()[0].length;
      const step = event.shiftKey ? Math.ceil(count / 20) : 1;
      const to = { ArrowRight: at + step, ArrowLeft: at < 0 ? count - 1 : at - step, Home: 0, End: count - 1 }[event.key];
      if (event.key === "Escape") leave();
      if (to === undefined) return;
      event.preventDefault();
      tell(to);
    }

    chart.addEventListener("pointermove", point);
    chart.addEventListener("pointerdown", point);
    chart.addEventListener("pointerleave", leave);
    chart.addEventListener("keydown", press);
    chart.addEventListener("blur", leave);
  }

  for (const chart of document.querySelectorAll("svg[data-hover]")) listen(/** @type {SVGSVGElement} */ (chart));
})();
