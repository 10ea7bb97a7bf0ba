// Draws what the engine answered with the drawing library that the installed package ships; computes nothing itself.
// @ts-check

/** @typedef {{name: string, kind: string, x: any[], y: any[], z?: any[], values?: number[], color: number, dashed: boolean,
 *   frames?: {x: any[], y: any[]}[]}} Trace */
/** @typedef {{name: string, title: string, x: string, y: string, traces: Trace[], equal: boolean, log: boolean,
 *   x_range: number[] | null, y_range: number[] | null, lines: [number, string][]}} Chart */

const MANY = 400; // points from which they are drawn by the graphics card, where there is one
const HAS_WEBGL = Boolean(document.createElement("canvas").getContext("webgl"));
const CONFIG = { displaylogo: false, responsive: true, displayModeBar: false, scrollZoom: false };

const FRAME = 70; // milliseconds
const STILL = matchMedia("(prefers-reduced-motion: reduce)");
/** Counts what was shown; what moves ends when it grows. */
export const motion = { shown: 0, frames: 0 };

/** @param {string} name */
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
/** @param {number} number */
const color = (number) => css(`--c${number}`);

/** @param {Trace} trace */
function drawn(trace) {
  const paint = color(trace.color);
  const common = { x: trace.x, y: trace.y, name: trace.name, showlegend: trace.name !== "" };
  const dash = trace.dashed ? "dash" : "solid";
  switch (trace.kind) {
    case "points":
      return { ...common, type: trace.x.length > MANY && HAS_WEBGL ? "scattergl" : "scatter", mode: "markers",
        marker: { color: paint, size: trace.x.length > MANY ? 2 : 6 }, hoverinfo: trace.x.length > MANY ? "skip" : "x+y" };
    case "segments":
      return { ...common, type: "scatter", mode: "lines", line: { color: paint, width: 1 }, connectgaps: false, hoverinfo: "skip" };
    case "interval":
      return { ...common, type: "scatter", mode: "lines+markers", line: { color: paint, width: 3 },
        marker: { color: paint, size: [0, 11, 0] }, hovertemplate: `${trace.name}: %{x:.3f} m<extra></extra>` };
    case "bars":
      return { ...common, type: "bar", marker: { color: paint }, text: trace.y.map((y) => y.toPrecision(2)), textposition: "inside", insidetextanchor: "middle" };
    case "cloud":
      return { ...common, type: "scatter3d", mode: "markers", z: trace.z,
        marker: { size: 1.6, color: trace.values ?? paint, colorscale: "Viridis" } };
    default:
      return { ...common, type: "scatter", mode: "lines", line: { color: paint, width: 2, dash } };
  }
}

/** @param {Chart} chart */
function layout(chart) {
  const axis = { gridcolor: css("--grid"), zerolinecolor: css("--line"), linecolor: css("--line"), automargin: true };
  const span = (/** @type {number[] | null} */ range, /** @type {boolean} */ log) =>
    range ? { range: log ? range.map(Math.log10) : range } : {};
  const words = chart.traces.some((trace) => trace.kind === "bars");
  return {
    margin: { l: 52, r: 14, t: 8, b: 44 },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: css("--soft"), family: "inherit", size: 12 },
    legend: { orientation: "h", x: 0, y: 1, yanchor: "bottom", font: { size: 12 }, itemsizing: "constant" },
    hovermode: "closest",
    dragmode: "pan",
    uirevision: chart.name,
    xaxis: { ...axis, showticklabels: chart.x !== "" || words, title: { text: chart.x, standoff: 6 }, ...span(chart.x_range, false) },
    yaxis: {
      ...axis, showticklabels: chart.y !== "", title: { text: chart.y, standoff: 6 }, type: chart.log ? "log" : "-", exponentformat: "power",
      ...(chart.equal ? { scaleanchor: "x", scaleratio: 1 } : {}), ...span(chart.y_range, chart.log),
    },
    shapes: chart.lines.map(([y]) => ({ type: "line", xref: "paper", x0: 0, x1: 1, y0: y, y1: y, line: { color: css("--c6"), width: 1, dash: "dot" } })),
    annotations: chart.lines.map(([y, text]) => ({ xref: "paper", x: 0, xanchor: "left", y: chart.log ? Math.log10(y) : y, yanchor: "bottom", text, showarrow: false, bgcolor: css("--card"), borderpad: 1 })),
  };
}

/** Shows the charts inside `place`, and keeps those whose name is there already.
 * @param {HTMLElement} place
 * @param {Chart[]} charts */
export function show(place, charts) {
  motion.shown += 1;
  const wanted = new Set(charts.map((chart) => chart.name));
  for (const figure of [...place.querySelectorAll("figure")]) {
    if (!wanted.has(figure.dataset.name ?? "")) {
      Plotly.purge(figure.querySelector(".plot"));
      figure.remove();
    }
  }
  for (const [index, chart] of charts.entries()) {
    let figure = /** @type {HTMLElement | null} */ (place.querySelector(`figure[data-name="${chart.name}"]`));
    if (!figure) {
      figure = document.createElement("figure");
      figure.dataset.name = chart.name;
      figure.append(document.createElement("figcaption"), document.createElement("div"));
      figure.children[1].className = "plot";
      place.insertBefore(figure, place.children[index] ?? null);
    }
  }
  // All places are there before the first is filled: the grid's columns have their widths.
  for (const chart of charts) {
    const figure = /** @type {HTMLElement} */ (place.querySelector(`figure[data-name="${chart.name}"]`));
    figure.children[0].textContent = chart.title;
    figure.children[1].setAttribute("role", "img");
    figure.children[1].setAttribute("aria-label", chart.title);
    const fresh = !figure.children[1].classList.contains("js-plotly-plot");
    Plotly.react(figure.children[1], chart.traces.map(drawn), layout(chart), CONFIG);
    if (!fresh && figure.clientWidth !== Number(figure.dataset.width)) Plotly.Plots.resize(figure.children[1]);
    figure.dataset.width = String(figure.clientWidth);
  }
}

/** Lets the charts come to what they show: every trace's frames, one after another, of all charts at once. Whoever
 * asked for less motion sees the end only; so does who has stepped on meanwhile.
 * @param {HTMLElement} place
 * @param {Chart[]} charts */
export async function play(place, charts) {
  const moving = charts.flatMap((chart) => chart.traces.map((trace, index) => ({ chart, trace, index })))
    .filter(({ trace }) => trace.frames?.length);
  if (STILL.matches || !moving.length) return;
  const [shown, count] = [motion.shown, Math.max(...moving.map(({ trace }) => trace.frames?.length ?? 0))];
  for (let number = 0; number <= count; number++) {
    for (const { chart, trace, index } of moving) {
      const { x, y } = trace.frames?.[number] ?? trace;
      Plotly.restyle(place.querySelector(`figure[data-name="${chart.name}"] .plot`), { x: [x], y: [y] }, [index]);
    }
    motion.frames += 1;
    await new Promise((later) => { setTimeout(later, FRAME); });
    if (motion.shown !== shown) return;
  }
}
