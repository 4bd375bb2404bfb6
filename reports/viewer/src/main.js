// The viewer: keeps what is seen, the address and the controls in step.

import { Store } from "./columns.js";
import { ofLimit, scale } from "./colours.js";
import { barOf, draw, mark, range, svg, View } from "./draw.js";
import { Layer, MEASURES } from "./layer.js";
import { make, page } from "./page.js";
import { Solid } from "./solid.js";
import * as states from "./state.js";

const AROUND = 7; // lines of the program before and after the one that is shown
const REACH_PX = 8; // of the pointer
const NEAR_ZOOM = 12; // pixels a millimetre at which a place is shown

const index = JSON.parse(/** @type {HTMLElement} */ (document.getElementById("index")).textContent || "{}");
const store = new Store(), state = states.first(index);
/** @type {Layer} */
let layer = new Layer({}, index.step_mm);
let playing = 0, marked = /** @type {[number, number] | null} */ (null), under = /** @type {any} */ (null), measured = /** @type {any} */ (null);
let shown = 0; // layer whose columns `layer` holds

const act = {
  layer: () => go(Number(parts.layer.value)),
  time: () => at(Number(parts.time.value)),
  play: () => (playing ? stop() : play()),
  speed: () => {},
  show: () => toggled("show", index.slicers),
  draw: () => toggled("draw", states.DRAWN),
  color: () => seen(() => (state.color = parts.color.value)),
  pair: () => seen(() => (state.pair = [parts.first.value, parts.second.value])),
  goal: () => goal(parts.goal.value),
  worst: (/** @type {any} */ strip) => worst(strip),
  note: (/** @type {any} */ note) => jump(note),
  png: () => view.canvas.toBlob((blob) => blob && save(blob, "png")),
  svg: () => save(new Blob([svg(view, layer, state, index)], { type: "image/svg+xml" }), "svg"),
  link: () => navigator.clipboard?.writeText(location.href).then(() => (parts.said.textContent = "the address of this view is on the clipboard"), () => {}),
  help: () => parts.help.showModal(),
  solid: () => turned(),
};
const parts = page(index, act), view = new View(parts.canvas, index);
let solid = /** @type {Solid | null} */ (null);

// -- what is seen ----------------------------------------------------------------------------------

/** Change the state, then show it. @param {() => void} change */
function seen(change) {
  change();
  show();
}

/** @param {"show" | "draw"} list @param {string[]} names */
function toggled(list, names) {
  const boxes = /** @type {HTMLLabelElement[]} */ (parts[list]);
  seen(() => (state[list] = names.filter((_, n) => /** @type {HTMLInputElement} */ (boxes[n].firstChild).checked)));
}

/** Draw everything by the state, and write it into the address. */
function show() {
  if (view.canvas.clientWidth && view.canvas.clientHeight) {
    draw(view, layer, state, index);
    if (marked) mark(view, marked);
  }
  if (solid && !parts.solid.hidden) solid.draw(layer, state);
  strip();
  const boxes = (/** @type {HTMLLabelElement[]} */ labels, /** @type {string[]} */ names, /** @type {string[]} */ on) =>
    labels.forEach((label, n) => (/** @type {HTMLInputElement} */ (label.firstChild).checked = on.includes(names[n])));
  boxes(parts.show, index.slicers, state.show);
  boxes(parts.draw, states.DRAWN, state.draw);
  [parts.color.value, parts.first.value, parts.second.value] = [state.color, state.pair[0] || "", state.pair[1] || ""];
  parts.layer.value = String(state.layer);
  parts.time.max = String(layer.time || 1);
  parts.time.value = String(Math.min(state.t, layer.time || 1));
  legend();
  const z = index.z_mm?.[state.layer - 1] ?? index.cut_mm[state.layer - 1];
  const time = layer.time ? `, ${Math.min(state.t, layer.time).toFixed(1)} of ${layer.time.toFixed(1)} s` : "";
  parts.said.textContent = `layer ${state.layer} of ${index.layers}, Z ${z === null || z === undefined ? "unknown" : z.toFixed(3)} mm${time}`;
  if (view.canvas.clientWidth) [state.at, state.zoom] = view.isWhole ? [null, 0] : [[view.x, view.y], view.zoom];
  history.replaceState(null, "", states.written(state));
}

/** Go to a layer, counted from 1; at its end where no time is given. @param {number} to @param {number} [time] */
async function go(to, time = Infinity) {
  state.layer = Math.min(Math.max(Math.round(to), 1), Math.max(index.layers, 1));
  state.t = time;
  await load();
}

/** Show the layer of the state, opened where it has not been. */
async function load() {
  const wanted = state.layer;
  if (shown !== wanted) {
    const columns = await store.layer(wanted);
    if (state.layer !== wanted) return; // another one is on its way
    [layer, shown] = [new Layer(columns, index.step_mm), wanted];
  }
  show();
}

/** Change between the layer and the build in three dimensions. */
function turned() {
  parts.solid.hidden = !parts.solid.hidden;
  [parts.canvas.hidden, parts.turned.textContent] = [!parts.solid.hidden, parts.solid.hidden ? "3D" : "2D"];
  solid ||= new Solid(parts.solid, index, store, () => show());
  if (!solid.works) {
    [parts.solid.hidden, parts.canvas.hidden, parts.turned.disabled, parts.turned.textContent] = [true, false, true, "3D"];
    parts.under.textContent = "this browser has no WebGL 2: layers are shown in two dimensions";
  }
  show();
  solid.load();
}

/** @param {number} time s */
function at(time) {
  seen(() => (state.t = Math.min(Math.max(time, 0), layer.time)));
  const { row } = layer.moment(state.t);
  if (row >= 0) blocks(row);
}

/** Blocks of the program around a motion. @param {number} row */
async function blocks(row) {
  const file = index.files?.[state.layer - 1];
  if (file && row >= 0) await lines(file, layer.columns["m.line"][row]);
}

/** @param {string} file @param {number} line */
async function lines(file, line) {
  const every = await store.lines(file), from = Math.max(line - AROUND, 1);
  state.line = `${file}:${line}`;
  if (under && under.file === file) under.text = every[under.line - 1] || "";
  parts.text.start = from;
  parts.text.replaceChildren(...every.slice(from - 1, line + AROUND).map((text, n) =>
    make("li", { class: from + n === line ? "now" : "" }, make("button", { type: "button", onclick: () => toLine(file, from + n) }, text || " "))));
  history.replaceState(null, "", states.written(state));
}

/** Go to a line of the program. @param {string} file @param {number} line */
async function toLine(file, line) {
  const files = /** @type {string[]} */ (index.files || []), first = files.indexOf(file); // a file may hold several layers
  const place = files.findLastIndex((name, k) => name === file && (k === first || index.lines[k] <= line));
  if (place >= 0) {
    if (state.layer !== place + 1) await go(place + 1);
    const row = layer.ofLine(line);
    if (row >= 0) {
      state.t = layer.ends[row];
      focus(layer.point(row, 0.5));
      underOf(row);
    }
  }
  await lines(file, line);
  show();
}

/** Mark a place and bring it into the middle. @param {[number, number]} place */
function focus(place) {
  marked = place;
  [view.x, view.y, view.zoom] = [place[0], place[1], Math.max(view.zoom, Math.min(view.whole * 8, NEAR_ZOOM))];
}

/** Where a note points to. @param {any} note */
async function jump(note) {
  if (note.layer) await go(note.layer);
  if (note.at) seen(() => focus(note.at));
  const [file, line] = (note.line || "").split(":");
  if (file && (!note.layer || !note.at)) await toLine(file, Number(line));
}

/** Layer of a strip that takes most of its limit. @param {any} one */
const peak = (one) => one.share.reduce((/** @type {number} */ best, /** @type {number} */ share, /** @type {number} */ k) => (share > one.share[best] ? k : best), 0);

/** Go to the layer nearest to a limit: of one gate, or of all. @param {any} [one] */
async function worst(one) {
  const strips = one ? [one] : index.strips;
  if (!strips.length) return;
  const found = strips.reduce((/** @type {any} */ a, /** @type {any} */ b) => (b.share[peak(b)] > a.share[peak(a)] ? b : a));
  const k = peak(found), place = found.at[k], pair = (found.of[k] || "").split(", ");
  if (pair.length === 2) [state.pair, state.draw, state.show] = [pair, [...new Set([...state.draw, "difference"])], [...new Set([...state.show, ...pair])]];
  await go(k + 1);
  if (place && place[0] !== null) seen(() => focus(place));
  parts.under.textContent = `worst ${found.gate}: ${found.figure[k]} of ${found.limit[k]} ${found.unit}${pair.length === 2 ? ` between ${pair.join(" and ")}` : ""}`;
}

/** What was typed: a layer, a line of the program, or a place. @param {string} text */
async function goal(text) {
  const line = /^\s*([\w.-]+\.\w+):(\d+)\s*$/.exec(text), place = /^\s*(-?[\d.]+)\s*[,;\s]\s*(-?[\d.]+)\s*$/.exec(text);
  if (line) await toLine(line[1], Number(line[2]));
  else if (place) seen(() => focus([Number(place[1]), Number(place[2])]));
  else if (/^\s*\d+\s*$/.test(text)) await go(Number(text));
  else parts.said.textContent = `${text}: give a layer, FILE:line, or x, y`;
}

// -- legend and strip ------------------------------------------------------------------------------

function legend() {
  const [low, high] = range(layer, state.color), [, unit] = /** @type {any} */ (MEASURES)[state.color] || ["", ""], own = state.color === "rank" ? 1 : 0;
  const steps = make("span", { class: "steps" }, ...Array.from({ length: 24 }, (_, n) => {
    const step = make("i");
    step.style.background = scale(n / 23);
    return step;
  }));
  const text = (/** @type {number} */ v) => `${+(v + own).toPrecision(5)}`;
  parts.legend.replaceChildren(text(low), steps, `${text(high)} ${unit}`);
}

/** One column a gate, one row a layer, the lowest at the bottom. */
function strip() {
  const canvas = parts.strip, count = Math.max(index.layers, 1), wide = Math.max(index.strips.length, 1);
  [canvas.width, canvas.height] = [wide, count];
  const context = canvas.getContext("2d");
  index.strips.forEach((/** @type {any} */ one, /** @type {number} */ n) => one.share.forEach((/** @type {number} */ share, /** @type {number} */ k) => {
    context.fillStyle = ofLimit(share * one.step);
    context.fillRect(n, count - 1 - k, 1, 1);
  }));
}

// -- the pointer -----------------------------------------------------------------------------------

/** What is told of the motion under the pointer. @param {number} row */
function underOf(row) {
  const file = index.files?.[state.layer - 1] || "", c = layer.columns, [x, y] = layer.point(row, 0.5);
  under = { file, line: c["m.line"][row], text: "", x, y };
  const power = c["m.power"][row] / 10, feed = c["m.feed"][row] / 100, wire = c["m.wire"][row] / 1000, begin = layer.begins[row];
  const what = c["m.ring"][row] >= 0 ? `contour ${c["m.ring"][row]}` : layer.rank[row] >= 0 ? `island ${layer.rank[row] + 1} in its order` : "bead";
  return `${file}:${under.line}, ${what}, at ${begin.toFixed(1)} s, F${+feed.toFixed(2)} mm/min, ${+power.toFixed(1)} W, wire ${+wire.toFixed(3)} mm/s`;
}

function pointer() {
  const fingers = new Map();
  /** @param {PointerEvent} event @returns {[number, number]} */
  const spot = (event) => [event.offsetX, event.offsetY];
  view.canvas.addEventListener("pointerdown", (event) => {
    view.canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { begin: spot(event), last: spot(event) });
    measured = event.shiftKey ? { from: view.place(...spot(event)) } : null;
  });
  view.canvas.addEventListener("pointermove", (event) => {
    const here = spot(event), place = view.place(...here), finger = fingers.get(event.pointerId);
    if (!finger) return hover(place);
    if (measured) return tell(`${Math.hypot(place[0] - measured.from[0], place[1] - measured.from[1]).toFixed(4)} mm, dx ${(place[0] - measured.from[0]).toFixed(4)}, dy ${(place[1] - measured.from[1]).toFixed(4)}`, place);
    if (fingers.size === 2) {
      const other = [...fingers.entries()].find(([id]) => id !== event.pointerId)?.[1].last;
      const apart = (/** @type {[number, number]} */ p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
      view.scaled(apart(here) / Math.max(apart(finger.last), 1), (here[0] + other[0]) / 2, (here[1] + other[1]) / 2);
    } else {
      view.x -= (here[0] - finger.last[0]) / view.zoom;
      view.y += (here[1] - finger.last[1]) / view.zoom;
    }
    finger.last = here;
    show();
  });
  const lifted = (/** @type {PointerEvent} */ event) => {
    const finger = fingers.get(event.pointerId), here = spot(event);
    fingers.delete(event.pointerId);
    if (finger && !measured && event.type === "pointerup" && Math.hypot(here[0] - finger.begin[0], here[1] - finger.begin[1]) < 3) {
      const row = layer.nearest(...view.place(...here), REACH_PX / view.zoom);
      if (row >= 0) blocks(row);
    }
  };
  view.canvas.addEventListener("pointerup", lifted);
  view.canvas.addEventListener("pointercancel", lifted);
  view.canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    view.scaled(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    show();
  }, { passive: false });
  parts.strip.addEventListener("click", (/** @type {MouseEvent} */ event) => {
    const { height, width } = parts.strip.getBoundingClientRect();
    const to = Math.ceil((1 - event.offsetY / height) * index.layers), one = index.strips[Math.floor((event.offsetX / width) * index.strips.length)];
    go(to).then(() => one && one.at[state.layer - 1]?.[0] != null && seen(() => focus(one.at[state.layer - 1])));
  });
}

/** @param {[number, number]} place */
async function hover(place) {
  const row = layer.nearest(...place, REACH_PX / view.zoom);
  under = null;
  const told = row >= 0 ? underOf(row) : "";
  tell(told, place);
  if (!under) return;
  const one = under, every = await store.lines(one.file);
  if (under === one) [one.text] = [every[one.line - 1] || ""];
}

/** @param {string} text @param {[number, number]} place */
function tell(text, place) {
  parts.under.textContent = `X ${place[0].toFixed(4)}  Y ${place[1].toFixed(4)}${text ? `  ${text}` : ""}`;
}

// -- time and keys ---------------------------------------------------------------------------------

function play() {
  if (!layer.time) return;
  if (state.t >= layer.time) state.t = 0;
  parts.play.textContent = "Stop";
  let last = performance.now();
  const step = async (/** @type {number} */ now) => {
    if (!playing) return;
    const time = state.t + ((now - last) / 1000) * Number(parts.speed.value);
    last = now;
    if (time >= layer.time && state.layer < index.layers) await go(state.layer + 1, 0);
    else at(time);
    if (time >= layer.time && state.layer >= index.layers) stop();
    else playing = requestAnimationFrame(step);
  };
  playing = requestAnimationFrame(step);
}

function stop() {
  cancelAnimationFrame(playing);
  playing = 0;
  parts.play.textContent = "Play";
}

/** @param {number} by motions */
function stepped(by) {
  const { row, share } = layer.moment(state.t), to = Math.min(Math.max(share > 0 || by < 0 ? row + by : row, 0), layer.count - 1);
  if (layer.count) at(layer.ends[to]);
}

let noted = -1;
function nextNote() {
  const bad = index.notes.filter((/** @type {any} */ note) => !note.good && (note.layer || note.line));
  const every = bad.length ? bad : index.notes.filter((/** @type {any} */ note) => note.layer || note.line);
  if (every.length) jump(every[(noted = (noted + 1) % every.length)]);
}

/** @param {number} factor */
const zoomed = (factor) => seen(() => view.scaled(factor, view.canvas.clientWidth / 2, view.canvas.clientHeight / 2));

/** @type {Record<string, () => void>} */
const KEYS = {
  ArrowUp: () => go(state.layer + 1), ArrowDown: () => go(state.layer - 1), PageUp: () => go(state.layer + 10), PageDown: () => go(state.layer - 10),
  Home: () => go(1), End: () => go(index.layers), ArrowLeft: () => stepped(-1), ArrowRight: () => stepped(1), " ": act.play,
  "+": () => zoomed(1.5), "=": () => zoomed(1.5), "-": () => zoomed(1 / 1.5), 0: () => seen(() => ((marked = null), view.fit())),
  d: act.solid, f: () => worst(), n: nextNote, l: act.link, "?": act.help,
};

function save(/** @type {Blob} */ blob, /** @type {string} */ ending) {
  const link = make("a", { href: URL.createObjectURL(blob), download: `${index.name || "layer"}-L${state.layer}.${ending}` });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

async function follow() {
  states.read(state, location.hash, index);
  if (state.at) [view.x, view.y] = state.at;
  if (state.zoom) view.zoom = state.zoom;
  const { line } = state;
  await load();
  if (line) await toLine(...(/** @type {[string, number]} */ ([line.split(":")[0], Number(line.split(":")[1])])));
}

document.addEventListener("keydown", (event) => {
  const typed = event.target instanceof HTMLElement && event.target.matches("input[type=search], select");
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (typed || event.ctrlKey || event.metaKey || event.altKey || !(key in KEYS) || parts.help.open) return;
  event.preventDefault();
  KEYS[key]();
});
window.addEventListener("hashchange", follow);
window.addEventListener("resize", () => {
  if (!state.zoom) view.fit();
  show();
});

/** What is seen, for whoever drives the page. */
/** @type {any} */ (window).ebamcheck = {
  state: () => ({
    layer: state.layer, layers: index.layers, z_mm: index.z_mm?.[state.layer - 1] ?? index.cut_mm[state.layer - 1] ?? null,
    time_s: Math.min(state.t, layer.time), layer_time_s: layer.time, shown: [...state.show], drawn: [...state.draw], verdict: index.verdict, solid: !parts.solid.hidden, scale_bar: barOf(view.zoom),
    worst: Object.fromEntries(index.strips.map((/** @type {any} */ s) => [s.gate, { layer: peak(s) + 1, figure: s.figure[peak(s)], limit: s.limit[peak(s)], unit: s.unit }])), under,
  }),
};

pointer();
view.fit();
follow().then(() => (document.documentElement.dataset.ready = "1"));
