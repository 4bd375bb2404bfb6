// The build in three dimensions: walls of the layers up to the one that is shown, and its beads up to the moment (WebGL 2).

import { scale } from "./colours.js";
import { range } from "./draw.js";
import { Layer } from "./layer.js";

/** @typedef {import("./state.js").State} State */

const BATCH = 16; // layers of one buffer
const CHORDS = 8; // of a curved bead

const VERTEX = `#version 300 es
uniform mat4 view; in vec3 place; in vec3 colour; out vec3 at; out vec3 tint;
void main() { at = place; tint = colour; gl_Position = view * vec4(place, 1.0); }`;

// A wall is lit by the direction that its own slope on the screen gives; a line keeps its colour.
const FRAGMENT = `#version 300 es
precision highp float; uniform float top; uniform bool lit; in vec3 at; in vec3 tint; out vec4 seen;
void main() {
  if (at.z > top) discard;
  vec3 normal = normalize(cross(dFdx(at), dFdy(at)));
  seen = vec4(lit ? tint * (0.35 + 0.65 * abs(dot(normal, normalize(vec3(0.4, -0.6, 0.7))))) : tint, 1.0);
}`;

export class Solid {
  /** @param {HTMLCanvasElement} canvas @param {any} index @param {import("./columns.js").Store} store @param {() => void} changed */
  constructor(canvas, index, store, changed) {
    this.canvas = canvas;
    this.index = index;
    this.store = store;
    this.changed = changed;
    this.gl = canvas.getContext("webgl2", { antialias: true });
    this.yaw = 0.6;
    this.pitch = 0.5;
    this.zoom = 1;
    this.pan = [0, 0];
    /** @type {{buffer: WebGLBuffer, count: number}[]} */
    this.walls = [];
    this.loaded = 0;
    if (this.gl) this.#prepare(this.gl);
  }

  /** Whether this browser can draw it. */
  get works() {
    return !!this.gl;
  }

  /** @param {WebGL2RenderingContext} gl */
  #prepare(gl) {
    const program = /** @type {WebGLProgram} */ (gl.createProgram());
    for (const [kind, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    this.program = program;
    this.beads = /** @type {WebGLBuffer} */ (gl.createBuffer());
    this.drag();
  }

  /** Heights of the bottom and the top of a layer, mm. @param {number} k from 0 @returns {[number, number]} */
  slab(k) {
    const z = this.index.z_mm || this.index.cut_mm, high = (/** @type {number} */ n) => z[n] ?? this.index.cut_mm[n] ?? 0;
    return [k > 0 ? high(k - 1) : Math.max(2 * high(0) - high(1), 0) || 0, high(k)];
  }

  /** Open all layers, a batch at a time, and draw after each. */
  async load() {
    const gl = this.gl, name = `c.${this.index.primary}`, step = this.index.step_mm;
    while (gl && this.loaded < this.index.layers) {
      const first = this.loaded, last = Math.min(first + BATCH, this.index.layers);
      /** @type {number[]} */
      const places = [];
      for (let k = first; k < last; k++) {
        const columns = await this.store.layer(k + 1), { [`${name}.size`]: size, [`${name}.x`]: x, [`${name}.y`]: y } = columns, [low, high] = this.slab(k);
        for (let ring = 0, at = 0; size && ring < size.length; at += size[ring++]) {
          for (let n = 0; n < size[ring]; n++) {
            const a = at + n, b = at + ((n + 1) % size[ring]);
            const [ax, ay, bx, by] = [x[a] * step, y[a] * step, x[b] * step, y[b] * step];
            places.push(ax, ay, low, bx, by, low, bx, by, high, ax, ay, low, bx, by, high, ax, ay, high);
          }
        }
      }
      const buffer = /** @type {WebGLBuffer} */ (gl.createBuffer());
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(places), gl.STATIC_DRAW);
      this.walls.push({ buffer, count: places.length / 3 });
      this.loaded = last;
      this.changed();
    }
  }

  /** @param {Layer} layer @param {State} state */
  draw(layer, state) {
    const { gl, program, canvas } = this;
    if (!gl || !program) return;
    const ratio = window.devicePixelRatio || 1;
    [canvas.width, canvas.height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [below, top] = this.slab(state.layer - 1), place = gl.getAttribLocation(program, "place"), colour = gl.getAttribLocation(program, "colour");
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "view"), false, this.matrix());
    gl.uniform1f(gl.getUniformLocation(program, "top"), below + 1e-4);
    gl.uniform1i(gl.getUniformLocation(program, "lit"), 1);
    gl.enableVertexAttribArray(place);
    gl.disableVertexAttribArray(colour);
    gl.vertexAttrib3f(colour, 0.62, 0.68, 0.74);
    for (const { buffer, count } of this.walls.slice(0, Math.ceil(state.layer / BATCH))) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
      gl.drawArrays(gl.TRIANGLES, 0, count);
    }
    const lines = this.lines(layer, state, top);
    gl.uniform1f(gl.getUniformLocation(program, "top"), top + 1e-3);
    gl.uniform1i(gl.getUniformLocation(program, "lit"), 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, /** @type {WebGLBuffer} */ (this.beads));
    gl.bufferData(gl.ARRAY_BUFFER, lines, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(colour);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 24, 0);
    gl.vertexAttribPointer(colour, 3, gl.FLOAT, false, 24, 12);
    gl.drawArrays(gl.LINES, 0, lines.length / 6);
  }

  /** Chords of the beads up to the moment, each end with its colour. @param {Layer} layer @param {State} state @param {number} z */
  lines(layer, state, z) {
    const moment = layer.moment(state.t), values = layer.values(state.color), [low, high] = range(layer, state.color);
    /** @type {number[]} */
    const found = [];
    for (let k = 0; k <= moment.row; k++) {
      if (!layer.lays(k)) continue;
      const share = k < moment.row ? 1 : moment.share, chords = layer.columns["m.kind"][k] === 1 ? 1 : CHORDS;
      const tint = (scale(high > low ? (values[k] - low) / (high - low) : 1).match(/\d+/g) || []).map((v) => Number(v) / 255);
      for (let n = 0, a = layer.start(k); n < chords; n++) {
        const b = layer.point(k, (share * (n + 1)) / chords);
        found.push(...a, z, ...tint, ...b, z, ...tint);
        a = b;
      }
    }
    return new Float32Array(found);
  }

  /** From millimetres to the window: seen from above at an angle, without perspective, so that lengths can be compared. */
  matrix() {
    const [x0, y0, x1, y1] = this.index.box, height = this.slab(Math.max(this.index.layers - 1, 0))[1];
    const middle = [(x0 + x1) / 2, (y0 + y1) / 2, height / 2], reach = Math.hypot(x1 - x0, y1 - y0, height) / 2 || 1;
    const [c, s, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const aspect = this.canvas.clientWidth / Math.max(this.canvas.clientHeight, 1), f = (this.zoom / reach) * Math.min(aspect, 1);
    const rows = [[(c * f) / aspect, (s * f) / aspect, 0], [-s * sp * f, c * sp * f, cp * f], [-s * cp, c * cp, -sp].map((v) => v / (4 * reach))];
    const shift = rows.map((row) => -row.reduce((sum, v, n) => sum + v * middle[n], 0));
    return new Float32Array([rows[0][0], rows[1][0], rows[2][0], 0, rows[0][1], rows[1][1], rows[2][1], 0, rows[0][2], rows[1][2], rows[2][2], 0,
      shift[0] + this.pan[0], shift[1] + this.pan[1], shift[2], 1]);
  }

  /** Turn by dragging, move with Shift, zoom by the wheel. */
  drag() {
    /** @type {[number, number] | null} */
    let last = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      last = [event.offsetX, event.offsetY];
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      const [dx, dy] = [event.offsetX - last[0], event.offsetY - last[1]];
      if (event.shiftKey) [this.pan[0], this.pan[1]] = [this.pan[0] + (2 * dx) / this.canvas.clientWidth, this.pan[1] - (2 * dy) / this.canvas.clientHeight];
      else [this.yaw, this.pitch] = [this.yaw + dx * 0.008, Math.min(Math.max(this.pitch + dy * 0.008, -Math.PI / 2), Math.PI / 2)];
      last = [event.offsetX, event.offsetY];
      this.changed();
    });
    this.canvas.addEventListener("pointerup", () => (last = null));
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom = Math.min(Math.max(this.zoom * Math.exp(-event.deltaY * 0.0015), 0.2), 500);
      this.changed();
    }, { passive: false });
  }
}
