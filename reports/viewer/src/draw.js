// The picture of one layer on a canvas: outlines, islands, beads up to a moment, disagreement; with a scale bar.

import { CURVE, ISLAND, NAMED, OVER, TRAVEL, scale } from "./colours.js";

/** @typedef {import("./layer.js").Layer} Layer @typedef {import("./state.js").State} State */

const BINS = 32; // colours of a scale that are told apart
const MARGIN = 0.06; // of the window, around the part

/** View of millimetres on a canvas: its middle, and pixels a millimetre. */
export class View {
  /** @param {HTMLCanvasElement} canvas @param {{box: [number, number, number, number]}} index */
  constructor(canvas, index) {
    this.canvas = canvas;
    this.box = index.box;
    this.x = (this.box[0] + this.box[2]) / 2;
    this.y = (this.box[1] + this.box[3]) / 2;
    this.zoom = 1;
  }

  get ratio() {
    return window.devicePixelRatio || 1;
  }

  /** Zoom at which the whole part is seen. */
  get whole() {
    const { clientWidth: width, clientHeight: height } = this.canvas, [x0, y0, x1, y1] = this.box;
    return Math.max(Math.min(width / Math.max(x1 - x0, 1e-3), height / Math.max(y1 - y0, 1e-3)) * (1 - 2 * MARGIN), 1e-6);
  }

  /** Whether nothing is moved or zoomed. */
  get isWhole() {
    return this.zoom === this.whole && this.x === (this.box[0] + this.box[2]) / 2 && this.y === (this.box[1] + this.box[3]) / 2;
  }

  fit() {
    [this.x, this.y, this.zoom] = [(this.box[0] + this.box[2]) / 2, (this.box[1] + this.box[3]) / 2, this.whole];
  }

  /** Place under a point of the canvas. @param {number} px @param {number} py @returns {[number, number]} */
  place(px, py) {
    return [this.x + (px - this.canvas.clientWidth / 2) / this.zoom, this.y - (py - this.canvas.clientHeight / 2) / this.zoom];
  }

  /** Point of the canvas over a place. @param {number} x @param {number} y @returns {[number, number]} */
  point(x, y) {
    return [this.canvas.clientWidth / 2 + (x - this.x) * this.zoom, this.canvas.clientHeight / 2 - (y - this.y) * this.zoom];
  }

  /** Zoom by a factor about a point of the canvas, which keeps its place. @param {number} factor @param {number} px @param {number} py */
  scaled(factor, px, py) {
    const [x, y] = this.place(px, py);
    this.zoom = Math.min(Math.max(this.zoom * factor, this.whole / 20), 1e6);
    this.x = x - (px - this.canvas.clientWidth / 2) / this.zoom;
    this.y = y + (py - this.canvas.clientHeight / 2) / this.zoom;
  }

  /** Let a context draw in millimetres. @param {CanvasRenderingContext2D} context */
  apply(context) {
    const s = this.zoom * this.ratio;
    context.setTransform(s, 0, 0, -s, (this.canvas.clientWidth / 2) * this.ratio - this.x * s, (this.canvas.clientHeight / 2) * this.ratio + this.y * s);
  }
}

/** Range of the values of motions that lay metal. @param {Layer} layer @param {string} measure @returns {[number, number]} */
export function range(layer, measure) {
  let low = Infinity, high = -Infinity;
  const values = layer.values(measure);
  for (let k = 0; k < layer.count; k++) {
    if (!layer.lays(k) || values[k] < 0) continue;
    low = Math.min(low, values[k]);
    high = Math.max(high, values[k]);
  }
  return low <= high ? [low, high] : [0, 0];
}

/** Draw what the state asks for. @param {View} view @param {Layer} layer @param {State} state @param {any} index */
export function draw(view, layer, state, index) {
  const { canvas } = view, context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const [width, height] = [Math.round(canvas.clientWidth * view.ratio), Math.round(canvas.clientHeight * view.ratio)];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, width, height);
  view.apply(context);
  const px = 1 / view.zoom;
  [context.lineJoin, context.lineCap] = ["round", "round"];
  if (state.draw.includes("difference") && state.pair.length === 2) difference(view, context, layer, state.pair);
  if (state.draw.includes("islands")) stroke(context, layer.islands(), ISLAND, px);
  if (state.draw.includes("beads") || state.draw.includes("travel")) beads(context, layer, state, index, px);
  for (const name of state.show) stroke(context, layer.outline(name), NAMED[index.slicers.indexOf(name) % NAMED.length], 1.5 * px);
  if (state.draw.includes("curves")) stroke(context, layer.curves(), CURVE, 1.5 * px);
  context.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
  if (state.draw.includes("numbers")) numbers(view, context, layer);
  bar(view, context);
}

/** @param {CanvasRenderingContext2D} context @param {Path2D} path @param {string} colour @param {number} width */
function stroke(context, path, colour, width) {
  [context.strokeStyle, context.lineWidth] = [colour, width];
  context.stroke(path);
}

/** Area that only one of two slicers has. @param {View} view @param {CanvasRenderingContext2D} context @param {Layer} layer @param {string[]} pair */
function difference(view, context, layer, pair) {
  const apart = document.createElement("canvas");
  [apart.width, apart.height] = [view.canvas.width, view.canvas.height];
  const other = /** @type {CanvasRenderingContext2D} */ (apart.getContext("2d"));
  view.apply(other);
  other.fillStyle = OVER;
  other.fill(layer.outline(pair[0]), "evenodd");
  other.globalCompositeOperation = "xor";
  other.fill(layer.outline(pair[1]), "evenodd");
  context.save();
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.drawImage(apart, 0, 0);
  context.restore();
}

/** Beads and ways up to the moment, those of one colour in one path. @param {CanvasRenderingContext2D} context @param {Layer} layer @param {State} state @param {any} index @param {number} px */
function beads(context, layer, state, index, px) {
  const moment = layer.moment(state.t), values = layer.values(state.color), [low, high] = range(layer, state.color);
  /** @type {Path2D[]} */
  const paths = [], ways = new Path2D();
  const ended = new Map(); // last motion of each path, to go on where it stands
  for (let k = 0; k <= moment.row; k++) {
    const share = k < moment.row ? 1 : moment.share;
    if (share <= 0) continue;
    if (!layer.lays(k)) {
      layer.trace(ways, k, share, false);
      continue;
    }
    const bin = high > low ? Math.min(Math.floor(((values[k] - low) / (high - low)) * BINS), BINS - 1) : BINS - 1;
    const at = Math.max(bin, 0);
    paths[at] ||= new Path2D();
    layer.trace(paths[at], k, share, ended.get(at) === k - 1);
    ended.set(at, k);
  }
  if (state.draw.includes("travel")) {
    context.setLineDash([4 * px, 4 * px]);
    stroke(context, ways, TRAVEL, px);
    context.setLineDash([]);
  }
  if (!state.draw.includes("beads")) return;
  const wide = index.bead_mm;
  paths.forEach((path, bin) => {
    context.globalAlpha = 0.28;
    stroke(context, path, scale((bin + 0.5) / BINS), wide);
    context.globalAlpha = 1;
    stroke(context, path, scale((bin + 0.5) / BINS), Math.max(1.6 * px, wide * 0.06));
  });
  if (moment.row >= 0 && state.t < layer.time) {
    const [x, y] = layer.point(moment.row, moment.share);
    context.beginPath();
    context.arc(x, y, 5 * px, 0, 2 * Math.PI);
    [context.fillStyle, context.strokeStyle, context.lineWidth] = [OVER, "#ffffff", 1.5 * px];
    context.fill();
    context.stroke();
  }
}

/** Numbers of islands, where there is room for them. @param {View} view @param {CanvasRenderingContext2D} context @param {Layer} layer */
function numbers(view, context, layer) {
  const { "i.number": number, "i.cx": x, "i.cy": y } = layer.columns;
  [context.font, context.textAlign, context.textBaseline, context.lineWidth] = ["11px system-ui, sans-serif", "center", "middle", 3];
  [context.strokeStyle, context.fillStyle] = [ink("--page"), ink("--ink")];
  for (let k = 0; number && k < number.length; k++) {
    const [px, py] = view.point(x[k] * layer.step, y[k] * layer.step);
    context.strokeText(String(k + 1), px, py);
    context.fillText(String(k + 1), px, py);
  }
}

/** @param {string} name */
const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name) || "#000";

/** Length of a scale bar: 1, 2 or 5 times a power of ten, mm, and its words. @param {number} zoom */
export function barOf(zoom) {
  const most = 140 / zoom, power = 10 ** Math.floor(Math.log10(most));
  const mm = [5, 2, 1].map((n) => n * power).find((n) => n <= most) || power;
  return { mm, text: mm >= 1 ? `${+mm.toPrecision(3)} mm` : `${+(mm * 1000).toPrecision(3)} µm` };
}

/** @param {View} view @param {CanvasRenderingContext2D} context */
function bar(view, context) {
  const { mm, text } = barOf(view.zoom), [x, y] = [14, view.canvas.clientHeight - 16], length = mm * view.zoom;
  [context.strokeStyle, context.fillStyle, context.lineWidth, context.lineCap] = [ink("--ink"), ink("--ink"), 2, "butt"];
  [context.font, context.textAlign, context.textBaseline] = ["12px system-ui, sans-serif", "left", "bottom"];
  context.beginPath();
  context.moveTo(x, y - 5);
  context.lineTo(x, y);
  context.lineTo(x + length, y);
  context.lineTo(x + length, y - 5);
  context.stroke();
  context.fillText(text, x + 4, y - 4);
}

/** A mark around a place. @param {View} view @param {[number, number]} at */
export function mark(view, at) {
  const context = /** @type {CanvasRenderingContext2D} */ (view.canvas.getContext("2d")), [x, y] = view.point(...at);
  context.setTransform(view.ratio, 0, 0, view.ratio, 0, 0);
  for (const [colour, width] of /** @type {[string, number][]} */ ([["#ffffff", 5], [OVER, 2]])) {
    context.beginPath();
    context.arc(x, y, 14, 0, 2 * Math.PI);
    [context.strokeStyle, context.lineWidth] = [colour, width];
    context.stroke();
  }
}

/** What is seen as a text of SVG, in millimetres. @param {View} view @param {Layer} layer @param {State} state @param {any} index */
export function svg(view, layer, state, index) {
  const [x0, y1] = view.place(0, 0), [x1, y0] = view.place(view.canvas.clientWidth, view.canvas.clientHeight), s = layer.step, px = 1 / view.zoom;
  /** @type {string[]} */
  const parts = [];
  /** @param {string} d @param {string} colour @param {number} width @param {number} opacity */
  const path = (d, colour, width, opacity = 1) => d && parts.push(`<path d="${d}" fill="none" stroke="${colour}" stroke-width="${width}" stroke-opacity="${opacity}" stroke-linecap="round" stroke-linejoin="round"/>`);
  /** @param {string} name @param {Float64Array | null} closed */
  const rings = (name, closed) => {
    const { [`${name}.size`]: size, [`${name}.x`]: x, [`${name}.y`]: y } = layer.columns, words = [];
    for (let ring = 0, at = 0; size && ring < size.length; ring++) {
      for (let k = 0; k < size[ring]; k++, at++) words.push(`${k ? "L" : "M"}${+(x[at] * s).toFixed(4)} ${+(-y[at] * s).toFixed(4)}`);
      if (!closed || closed[ring]) words.push("Z");
    }
    return words.join("");
  };
  if (state.draw.includes("islands")) path(rings("i", null), ISLAND, px);
  if (state.draw.includes("beads")) {
    const values = layer.values(state.color), [low, high] = range(layer, state.color), moment = layer.moment(state.t);
    for (let k = 0; k <= moment.row; k++) {
      if (!layer.lays(k)) continue;
      const chords = layer.columns["m.kind"][k] === 1 ? 1 : 12, share = k < moment.row ? 1 : moment.share;
      const d = Array.from({ length: chords + 1 }, (_, n) => layer.point(k, (share * n) / chords)).map(([x, y], n) => `${n ? "L" : "M"}${+x.toFixed(4)} ${+(-y).toFixed(4)}`).join("");
      path(d, scale(high > low ? (values[k] - low) / (high - low) : 1), Math.max(1.6 * px, index.bead_mm * 0.06));
    }
  }
  for (const name of state.show) path(rings(`c.${name}`, layer.columns[`c.${name}.closed`]), NAMED[index.slicers.indexOf(name) % NAMED.length], 1.5 * px);
  const width = x1 - x0, height = y1 - y0;
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${width}mm" height="${height}mm" viewBox="${x0} ${-y1} ${width} ${height}">${parts.join("\n")}</svg>\n`;
}
