// One opened layer: outlines as paths, motions with their times, and what is nearest to a place.

/** @typedef {import("./columns.js").Columns} Columns */

const RAPID = 0, LINE = 1, CURVE = 3, LEFT_ARC = 4; // kinds of motions; RIGHT_ARC is 5
const CHORDS = 12; // of a curve, where the pointer looks for it

/** What colours can show: name, unit, and the column that they are of. */
export const MEASURES = {
  time: ["time in the layer", "s"], rank: ["order of islands", ""], feed: ["feed", "mm/min"], power: ["beam power", "W"], wire: ["wire speed", "mm/s"],
};

export class Layer {
  /** @param {Columns} columns @param {number} step mm */
  constructor(columns, step) {
    this.columns = columns;
    this.step = step;
    /** @type {Map<string, Path2D>} */
    this.paths = new Map();
    this.count = (columns["m.kind"] || []).length;
    this.ends = new Float64Array(this.count); // s after the layer's begin
    this.begins = new Float64Array(this.count);
    this.rank = new Float64Array(this.count).fill(-1);
    this.bend = new Int32Array(this.count); // row of a curve among curves, of an arc among arcs
    const ranks = new Map(Array.from(columns["i.number"] || [], (n, k) => [n, k]));
    for (let k = 0, t = 0, curves = 0, arcs = 0; k < this.count; k++) {
      const kind = columns["m.kind"][k];
      this.begins[k] = t + columns["m.wait"][k] / 1000;
      this.ends[k] = t = this.begins[k] + columns["m.ms"][k] / 1000;
      this.bend[k] = kind === CURVE ? curves++ : kind >= LEFT_ARC ? arcs++ : 0;
      this.rank[k] = ranks.get(columns["m.island"][k]) ?? -1;
    }
    this.time = this.count ? this.ends[this.count - 1] : 0;
  }

  /** Rings of a slicer as one path, mm. @param {string} name */
  outline(name) {
    return this.#path(`c.${name}`, (path) => this.#rings(path, `c.${name}`, this.columns[`c.${name}.closed`]));
  }

  /** Outlines of islands, mm. */
  islands() {
    return this.#path("i", (path) => this.#rings(path, "i", null));
  }

  /** Fitted curves, mm. */
  curves() {
    return this.#path("f", (path) => {
      const { "f.size": size, "f.x": x, "f.y": y } = this.columns, s = this.step;
      for (let ring = 0, at = 0; size && ring < size.length; ring++) {
        path.moveTo(x[at] * s, y[at++] * s);
        for (let k = 0; k < size[ring]; k++, at += 3) path.bezierCurveTo(x[at] * s, y[at] * s, x[at + 1] * s, y[at + 1] * s, x[at + 2] * s, y[at + 2] * s);
      }
    });
  }

  /** @param {string} key @param {(path: Path2D) => void} fill */
  #path(key, fill) {
    let path = this.paths.get(key);
    if (!path) {
      fill((path = new Path2D()));
      this.paths.set(key, path);
    }
    return path;
  }

  /** @param {Path2D} path @param {string} name @param {Float64Array | null} closed */
  #rings(path, name, closed) {
    const { [`${name}.size`]: size, [`${name}.x`]: x, [`${name}.y`]: y } = this.columns, s = this.step;
    for (let ring = 0, at = 0; size && ring < size.length; ring++) {
      for (let k = 0; k < size[ring]; k++, at++) k ? path.lineTo(x[at] * s, y[at] * s) : path.moveTo(x[at] * s, y[at] * s);
      if (!closed || closed[ring]) path.closePath();
    }
  }

  // -- motions -------------------------------------------------------------------------------------

  /** Whether a motion lays metal. @param {number} k */
  lays(k) {
    return this.columns["m.kind"][k] !== RAPID && (this.columns["m.on"][k] & 1) === 1;
  }

  /** Start of a motion, mm. @param {number} k @returns {[number, number]} */
  start(k) {
    const c = this.columns, s = this.step;
    return k ? [c["m.x"][k - 1] * s, c["m.y"][k - 1] * s] : [c["m.x0"][0] * s, c["m.y0"][0] * s];
  }

  /** End of a motion, mm. @param {number} k @returns {[number, number]} */
  end(k) {
    return [this.columns["m.x"][k] * this.step, this.columns["m.y"][k] * this.step];
  }

  /** Centre, radius, first angle and sweep of an arc. @param {number} k */
  arc(k) {
    const c = this.columns, s = this.step, left = c["m.kind"][k] === LEFT_ARC;
    const [x, y] = [c["m.ax"][this.bend[k]] * s, c["m.ay"][this.bend[k]] * s], [a, b] = [this.start(k), this.end(k)];
    const first = Math.atan2(a[1] - y, a[0] - x);
    let sweep = Math.atan2(b[1] - y, b[0] - x) - first;
    while (left && sweep <= 1e-9) sweep += 2 * Math.PI;
    while (!left && sweep >= -1e-9) sweep -= 2 * Math.PI;
    return { x, y, radius: Math.hypot(a[0] - x, a[1] - y), first, sweep };
  }

  /** The four Bezier points of a curve. @param {number} k */
  bezier(k) {
    const c = this.columns, s = this.step, b = this.bend[k], end = this.end(k);
    /** @param {number} n */
    const inner = (n) => [end[0] + c[`m.b${n}`][b] * s, end[1] + c[`m.b${n + 1}`][b] * s];
    return [this.start(k), inner(0), inner(2), end];
  }

  /** Point of a motion at a share 0 .. 1 of its time. @param {number} k @param {number} t @returns {[number, number]} */
  point(k, t) {
    const kind = this.columns["m.kind"][k];
    if (kind >= LEFT_ARC) {
      const { x, y, radius, first, sweep } = this.arc(k);
      return [x + radius * Math.cos(first + t * sweep), y + radius * Math.sin(first + t * sweep)];
    }
    if (kind === CURVE) {
      const p = this.bezier(k), s = 1 - t, w = [s * s * s, 3 * s * s * t, 3 * s * t * t, t * t * t];
      const along = (/** @type {number} */ d) => w.reduce((sum, v, n) => sum + v * p[n][d], 0);
      return [along(0), along(1)];
    }
    const [a, b] = [this.start(k), this.end(k)];
    return [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
  }

  /** Draw a motion, up to a share of it, onto a path that stands where it ends or begins anew. @param {Path2D} path @param {number} k @param {number} share @param {boolean} joined */
  trace(path, k, share, joined) {
    const kind = this.columns["m.kind"][k];
    if (!joined) path.moveTo(...this.start(k));
    if (kind >= LEFT_ARC) {
      const { x, y, radius, first, sweep } = this.arc(k);
      path.arc(x, y, radius, first, first + share * sweep, sweep < 0);
    } else if (kind === CURVE && share >= 1) {
      const [, b, c, d] = this.bezier(k);
      path.bezierCurveTo(b[0], b[1], c[0], c[1], d[0], d[1]);
    } else if (kind === CURVE) {
      for (let n = 1; n <= CHORDS; n++) path.lineTo(...this.point(k, (share * n) / CHORDS));
    } else {
      path.lineTo(...this.point(k, share));
    }
  }

  /** Motion that is under way at a time, and the share of it that is done. @param {number} time s */
  moment(time) {
    let low = 0, high = this.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.ends[middle] <= time) low = middle + 1;
      else high = middle;
    }
    if (low >= this.count) return { row: this.count - 1, share: 1 };
    const took = this.ends[low] - this.begins[low];
    return { row: low, share: took > 0 ? Math.min(Math.max((time - this.begins[low]) / took, 0), 1) : 0 };
  }

  /** Values of all motions by a measure. @param {string} measure */
  values(measure) {
    const c = this.columns;
    if (measure === "time") return this.begins;
    if (measure === "rank") return this.rank;
    const scale = { feed: 0.01, power: 0.1, wire: 0.001 }[measure] || 1;
    return (c[`m.${measure}`] || new Float64Array(this.count)).map((v) => v * scale);
  }

  /** Motion whose path is nearest to a place, within a distance; -1 where there is none. @param {number} x @param {number} y @param {number} within mm */
  nearest(x, y, within) {
    let found = -1, least = within;
    for (let k = 0; k < this.count; k++) {
      if (!this.lays(k)) continue;
      const chords = this.columns["m.kind"][k] === LINE ? 1 : CHORDS;
      for (let n = 0, a = this.start(k); n < chords; n++) {
        const b = this.point(k, (n + 1) / chords), ux = b[0] - a[0], uy = b[1] - a[1], square = ux * ux + uy * uy;
        const t = square ? Math.min(Math.max(((x - a[0]) * ux + (y - a[1]) * uy) / square, 0), 1) : 0;
        const away = Math.hypot(x - a[0] - t * ux, y - a[1] - t * uy);
        if (away < least) [found, least] = [k, away];
        a = b;
      }
    }
    return found;
  }

  /** Motion of a line of the layer's file, or the first after it. @param {number} line */
  ofLine(line) {
    const found = (this.columns["m.line"] || new Float64Array(0)).findIndex((at) => at >= line);
    return found;
  }
}
