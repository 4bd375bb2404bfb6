// What is seen, and the part of the address after `#` that says so.

/** @typedef {{layer: number, t: number, show: string[], draw: string[], pair: string[], color: string, at: [number, number] | null, zoom: number, line: string}} State */

export const DRAWN = ["curves", "islands", "numbers", "beads", "travel", "difference"];

/** @param {any} index @returns {State} */
export function first(index) {
  const show = index.slicers.includes(index.primary) ? [index.primary] : index.slicers.slice(0, 1);
  const pair = [index.primary, ...index.slicers.filter((/** @type {string} */ s) => s !== index.primary)].slice(0, 2);
  return { layer: 1, t: Infinity, show, draw: ["islands", "beads"], pair, color: "time", at: null, zoom: 0, line: "" };
}

/** Take over what an address says; what it says wrongly is left out. @param {State} state @param {string} hash @param {any} index */
export function read(state, hash, index) {
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const number = (/** @type {string} */ name) => (given.has(name) && given.get(name) !== "" ? Number(given.get(name)) : NaN);
  const list = (/** @type {string} */ name) => (given.get(name) || "").split(",").filter(Boolean);
  if (Number.isInteger(number("layer"))) state.layer = Math.min(Math.max(number("layer"), 1), Math.max(index.layers, 1));
  if (number("t") >= 0) state.t = number("t");
  else if (given.has("layer")) state.t = Infinity; // the whole layer
  if (given.has("show")) state.show = list("show").filter((name) => index.slicers.includes(name));
  if (given.has("draw")) state.draw = list("draw").filter((name) => DRAWN.includes(name));
  if (list("pair").length === 2 && list("pair").every((name) => index.slicers.includes(name))) state.pair = list("pair");
  if (given.get("color")) state.color = given.get("color") || state.color;
  const at = list("at").map(Number);
  if (at.length === 2 && at.every(Number.isFinite)) state.at = [at[0], at[1]];
  if (number("zoom") > 0) state.zoom = number("zoom");
  if (/^[\w.-]+:\d+$/.test(given.get("line") || "")) state.line = given.get("line") || "";
}

/** @param {State} state */
export function written(state) {
  const parts = [`layer=${state.layer}`, `t=${Number.isFinite(state.t) ? +state.t.toFixed(3) : ""}`, `show=${state.show.join(",")}`,
    `draw=${state.draw.join(",")}`, `color=${state.color}`];
  if (state.draw.includes("difference")) parts.push(`pair=${state.pair.join(",")}`);
  if (state.at) parts.push(`at=${state.at.map((v) => +v.toFixed(4)).join(",")}`);
  if (state.zoom) parts.push(`zoom=${+state.zoom.toPrecision(6)}`);
  if (state.line) parts.push(`line=${state.line}`);
  return `#${parts.filter((part) => !part.endsWith("=") || part === "show=" || part === "draw=").join("&")}`;
}
