// The view of the map in three dimensions: drawn when it is opened, by the library kept as text in this page.
// @ts-check
"use strict";
/** @param {string} id */
const part = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
/** @typedef {{dtype: string, bdata: string}} Packed */
part("scene").addEventListener("toggle", () => {
  const place = part("scene-view");
  if (place.dataset.drawn) return;
  place.dataset.drawn = "yes";
  const library = document.createElement("script");
  library.textContent = part("scene-library").textContent;
  document.head.append(library);
  const data = JSON.parse(part("scene-data").textContent ?? "{}");
  /** @param {string} name */
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const [x, y, z] = data.points;
  /** @param {Packed[]} places
   * @param {string} name
   * @param {string} color
   * @param {number} width
   * @param {string} [dash] */
  const line = ([lx, ly, lz], name, color, width, dash) => ({
    type: "scatter3d", mode: "lines", x: lx, y: ly, z: lz, name, line: { color, width, dash }, hoverinfo: "skip", connectgaps: false,
  });
  const axis = (/** @type {string} */ title) => ({ title: { text: `${title} [m]` }, color: css("--soft"), gridcolor: css("--line"), showbackground: false });
  const traces = [
    { type: "scatter3d", mode: "markers", x, y, z, name: "map", hoverinfo: "skip",
      marker: { size: 1.3, color: z, colorscale: data.colors } },
    { ...line(data.path, "path", css("--ink"), 4), customdata: data.seconds, hoverinfo: undefined,
      hovertemplate: "%{customdata:.1f} s<br>(%{x:.2f}, %{y:.2f}, %{z:.2f}) m<extra></extra>" },
    line(data.rings, "3 sigma", css("--c3"), 2),
    line(data.loops, "loops", css("--c5"), 3, "dot"),
  ];
  const far = place.clientWidth < 600 ? 1.5 : 1; // a narrow window sees less to the sides
  Plotly.newPlot(place, traces, {
    margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false, font: { family: "inherit" },
    scene: { aspectmode: "data", xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), camera: { eye: { x: 0.1 * far, y: -1.35 * far, z: 1.25 * far }, center: { x: 0, y: 0, z: -0.15 } } },
  }, { displaylogo: false, responsive: true, displayModeBar: false });
});
