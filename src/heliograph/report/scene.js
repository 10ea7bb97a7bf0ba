// The map in three dimensions: points with a depth buffer on a plain canvas, so that it turns at once without a graphics
// card and without a library; way, sigmas and loops are lines over it.
// @ts-check
"use strict";
(() => {
  const DOT = 0.05; // edge of a point [m]
  const NEAR = 0.2; // what is closer to the eye is not drawn [m]
  const START = { yaw: -1.95, pitch: 0.75 };
  /** @typedef {{dtype: string, bdata: string}} Packed */
  /** @param {string} id */
  const part = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
  /** @param {Packed} packed */
  const floats = (packed) => new Float32Array(Uint8Array.from(atob(packed.bdata), (c) => c.charCodeAt(0)).buffer);
  /** @param {string} name */
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  const place = part("scene-view");
  const canvas = document.createElement("canvas");
  const [paper, cloud] = [canvas, document.createElement("canvas")].map((c) => /** @type {CanvasRenderingContext2D} */ (c.getContext("2d")));
  const told = document.createElement("p");
  told.setAttribute("role", "status");

  /** What is shown, once the view is opened.
   * @type {any} */
  let held = null;
  const eye = { ...START, distance: 1, x: 0, y: 0, z: 0 };
  let asked = false;

  function load() {
    const data = JSON.parse(part("scene-data").textContent ?? "{}");
    const points = data.points.map(floats);
    const bounds = points.map((/** @type {Float32Array} */ column) => {
      const sorted = column.slice().sort();
      const at = (/** @type {number} */ share) => sorted[Math.floor(share * (sorted.length - 1))];
      return [at(0.01), at(0.99)];
    });
    const anchors = data.colors.map((/** @type {string} */ hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)));
    const [low, high] = bounds[2];
    const colors = Uint32Array.from(points[2], (/** @type {number} */ z) => {
      const at = Math.min(Math.max((z - low) / Math.max(high - low, 1e-3), 0), 0.9999) * (anchors.length - 1);
      const [i, share] = [Math.floor(at), at % 1];
      const [r, g, b] = anchors[i].map((/** @type {number} */ c, /** @type {number} */ k) => Math.round(c + share * (anchors[i + 1][k] - c)));
      return (255 << 24 | b << 16 | g << 8 | r) >>> 0;
    });
    const [path, rings, loops] = [data.path, data.rings, data.loops].map((lines) => lines.map(floats));
    return { points, colors, bounds, path, rings, loops, seconds: floats(data.seconds), seen: new Float32Array(2 * path[0].length) };
  }

  function home() {
    const [x, y, z] = held.bounds;
    const size = Math.hypot(x[1] - x[0], y[1] - y[0], z[1] - z[0]);
    Object.assign(eye, START, { distance: 0.9 * Math.max(size, 1), x: (x[0] + x[1]) / 2, y: (y[0] + y[1]) / 2, z: (z[0] + z[1]) / 2 });
  }

  /** Right, up and forward of the eye, and where it is. */
  function camera() {
    const [cy, sy, cp, sp] = [Math.cos(eye.yaw), Math.sin(eye.yaw), Math.cos(eye.pitch), Math.sin(eye.pitch)];
    const f = [-cy * cp, -sy * cp, -sp];
    return { f, r: [-sy, cy, 0], u: [-cy * sp, -sy * sp, cp], at: [eye.x, eye.y, eye.z].map((c, k) => c - f[k] * eye.distance) };
  }

  function draw() {
    asked = false;
    const ratio = Math.min(devicePixelRatio, 2);
    const [w, h] = [place.clientWidth, place.clientHeight].map((size) => Math.max(Math.round(size * ratio), 1));
    for (const context of [paper, cloud]) {
      if (context.canvas.width !== w || context.canvas.height !== h) [context.canvas.width, context.canvas.height] = [w, h];
    }
    const { f, r, u, at } = camera();
    const focal = 1.1 * Math.min(w, 1.4 * h);
    /** Where a place is seen, [x, y, depth].
     * @param {number} x
     * @param {number} y
     * @param {number} z */
    const seen = (x, y, z) => {
      const [dx, dy, dz] = [x - at[0], y - at[1], z - at[2]];
      const depth = dx * f[0] + dy * f[1] + dz * f[2];
      const scale = focal / depth;
      return [w / 2 + scale * (dx * r[0] + dy * r[1]), h / 2 - scale * (dx * u[0] + dy * u[1] + dz * u[2]), depth];
    };
    drawPoints(w, h, focal, at, f, r, u);
    paper.clearRect(0, 0, w, h);
    paper.lineWidth = ratio;
    const step = drawGround(seen, css("--line"));
    paper.drawImage(cloud.canvas, 0, 0);
    drawLine(held.loops, seen, css("--c5"), 1.5 * ratio, [4 * ratio, 3 * ratio]);
    drawLine(held.path, seen, css("--ink"), 2.5 * ratio, []);
    drawLine(held.rings, seen, css("--c3"), 1.5 * ratio, []);
    for (let i = 0; i < held.path[0].length; i++) {
      const [x, y, depth] = seen(held.path[0][i], held.path[1][i], held.path[2][i]);
      held.seen[2 * i] = depth > NEAR ? x / ratio : NaN;
      held.seen[2 * i + 1] = y / ratio;
    }
    drawAxes(r, u, ratio, h, step);
    place.dataset.eye = [eye.yaw, eye.pitch, eye.distance].map((value) => value.toFixed(4)).join(" ");
  }

  /** @param {number} w
   * @param {number} h
   * @param {number} focal
   * @param {number[]} at
   * @param {number[]} f
   * @param {number[]} r
   * @param {number[]} u */
  function drawPoints(w, h, focal, at, f, r, u) {
    if (held.image?.width !== w || held.image?.height !== h) {
      held.image = cloud.createImageData(w, h);
      held.depth = new Float32Array(w * h);
    }
    const pixels = new Uint32Array(held.image.data.buffer);
    const { depth, colors, points: [X, Y, Z] } = held;
    pixels.fill(0);
    depth.fill(Infinity);
    for (let i = 0; i < X.length; i++) {
      const [dx, dy, dz] = [X[i] - at[0], Y[i] - at[1], Z[i] - at[2]];
      const far = dx * f[0] + dy * f[1] + dz * f[2];
      if (!(far > NEAR)) continue;
      const scale = focal / far;
      const edge = Math.min(Math.max(Math.round(DOT * scale), 2), 6);
      const left = Math.round(w / 2 + scale * (dx * r[0] + dy * r[1])) - (edge >> 1);
      const top = Math.round(h / 2 - scale * (dx * u[0] + dy * u[1] + dz * u[2])) - (edge >> 1);
      if (left < 0 || top < 0 || left + edge > w || top + edge > h) continue;
      for (let row = top; row < top + edge; row++) {
        for (let k = row * w + left; k < row * w + left + edge; k++) {
          if (far < depth[k]) {
            depth[k] = far;
            pixels[k] = colors[i];
          }
        }
      }
    }
    cloud.putImageData(held.image, 0, 0);
  }

  /** @param {Float32Array[]} columns
   * @param {(x: number, y: number, z: number) => number[]} seen
   * @param {string} color
   * @param {number} width
   * @param {number[]} dash */
  function drawLine([X, Y, Z], seen, color, width, dash) {
    paper.strokeStyle = color;
    paper.lineWidth = width;
    paper.setLineDash(dash);
    paper.beginPath();
    let begun = false;
    for (let i = 0; i < X.length; i++) {
      const [x, y, depth] = seen(X[i], Y[i], Z[i]);
      if (!(depth > NEAR)) begun = false; // parted, or behind the eye
      else if (begun) paper.lineTo(x, y);
      else {
        paper.moveTo(x, y);
        begun = true;
      }
    }
    paper.stroke();
    paper.setLineDash([]);
  }

  /** Draws a grid on the ground and returns its step [m].
   * @param {(x: number, y: number, z: number) => number[]} seen
   * @param {string} color */
  function drawGround(seen, color) {
    const [[x0, x1], [y0, y1], [z]] = held.bounds;
    const rough = Math.max(x1 - x0, y1 - y0, 0.1) / 8;
    const tens = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((digit) => digit * tens).find((size) => size >= rough) ?? 10 * tens;
    const [left, right, near, far] = [Math.floor(x0 / step), Math.ceil(x1 / step), Math.floor(y0 / step), Math.ceil(y1 / step)];
    for (let i = left; i <= right; i++) drawLine(stretch(i * step, i * step, near * step, far * step, z), seen, color, paper.lineWidth, []);
    for (let i = near; i <= far; i++) drawLine(stretch(left * step, right * step, i * step, i * step, z), seen, color, paper.lineWidth, []);
    return step;
  }

  /** A line in pieces, of which those behind the eye are left out.
   * @param {number} x0
   * @param {number} x1
   * @param {number} y0
   * @param {number} y1
   * @param {number} z */
  function stretch(x0, x1, y0, y1, z) {
    const shares = Float32Array.from({ length: 17 }, (_, k) => k / 16);
    return [shares.map((s) => x0 + s * (x1 - x0)), shares.map((s) => y0 + s * (y1 - y0)), shares.map(() => z)];
  }

  /** @param {number[]} r
   * @param {number[]} u
   * @param {number} ratio
   * @param {number} h
   * @param {number} step */
  function drawAxes(r, u, ratio, h, step) {
    const [x, y, length] = [44 * ratio, h - 44 * ratio, 26 * ratio];
    paper.font = `${12 * ratio}px system-ui, sans-serif`;
    paper.fillStyle = paper.strokeStyle = css("--soft");
    paper.lineWidth = 1.5 * ratio;
    paper.textAlign = "center";
    paper.textBaseline = "middle";
    for (let k = 0; k < 3; k++) {
      paper.beginPath();
      paper.moveTo(x, y);
      paper.lineTo(x + length * r[k], y - length * u[k]);
      paper.stroke();
      paper.fillText("xyz"[k], x + 1.4 * length * r[k], y - 1.4 * length * u[k]);
    }
    paper.textAlign = "left";
    paper.fillText(`grid ${Number(step.toPrecision(2))} m`, 90 * ratio, h - 14 * ratio);
  }

  function ask() {
    if (held && !asked) {
      asked = true;
      requestAnimationFrame(draw);
    }
  }

  /** @param {number} right
   * @param {number} up */
  function turn(right, up) {
    eye.yaw -= right;
    eye.pitch = Math.min(Math.max(eye.pitch + up, -1.55), 1.55);
    ask();
  }

  /** @param {number} right
   * @param {number} down */
  function shift(right, down) {
    const { r, u } = camera();
    const scale = eye.distance / place.clientHeight;
    for (const [k, axis] of /** @type {const} */ (["x", "y", "z"]).entries()) eye[axis] -= scale * (right * r[k] - down * u[k]);
    ask();
  }

  /** @param {number} factor */
  function zoom(factor) {
    eye.distance = Math.min(Math.max(eye.distance * factor, 0.5), 1e5);
    ask();
  }

  /** Says what pose of the way is nearest to the pointer.
   * @param {number} x
   * @param {number} y */
  function tell(x, y) {
    let [best, least] = [-1, 14 ** 2];
    for (let i = 0; 2 * i < held.seen.length; i++) {
      const off = (held.seen[2 * i] - x) ** 2 + (held.seen[2 * i + 1] - y) ** 2;
      if (off < least) [best, least] = [i, off];
    }
    const [px, py, pz] = held.path.map((/** @type {Float32Array} */ column) => column[best]?.toFixed(2));
    told.textContent = best < 0 ? "" : `${held.seconds[best].toFixed(1)} s: (${px}, ${py}, ${pz}) m`;
  }

  /** @type {Map<number, {x: number, y: number}>} */
  const down = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
  });
  for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) canvas.addEventListener(name, (event) => down.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before) {
      if (held) tell(event.offsetX, event.offsetY);
      return;
    }
    const [dx, dy] = [event.offsetX - before.x, event.offsetY - before.y];
    const other = [...down].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const [was, is] = [before, { x: event.offsetX, y: event.offsetY }].map((p) => Math.hypot(p.x - other.x, p.y - other.y));
      zoom(Math.max(was, 1) / Math.max(is, 1));
      shift(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 2) shift(dx, dy);
    else turn(0.006 * dx, 0.006 * dy);
    down.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(0.001 * event.deltaY));
  }, { passive: false });
  place.addEventListener("keydown", (event) => {
    /** @type {Record<string, () => void>} */
    const keys = {
      ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
      "+": () => zoom(0.85), "-": () => zoom(1 / 0.85), Home: () => { home(); ask(); },
    };
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  part("scene").addEventListener("toggle", () => {
    if (held) return;
    held = load();
    place.append(canvas, told);
    home();
    new ResizeObserver(ask).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", ask);
    ask();
  });
})();
