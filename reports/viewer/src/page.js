// The controls around the picture, built once; what they do is said in `main.js`.

import { MEASURES } from "./layer.js";
import { NAMED } from "./colours.js";
import { DRAWN } from "./state.js";

/** An element with attributes, handlers (`onclick`) and children; texts are never read as markup.
 * @param {string} name @param {Record<string, any>} [given] @param {...(Node | string)} children @returns {any} */
export function make(name, given = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(given)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key in element && key !== "list") /** @type {any} */ (element)[key] = value;
    else element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}

const WORDS = {
  curves: "fitted curves", islands: "islands", numbers: "numbers of islands", beads: "beads", travel: "travel", difference: "disagreement of",
};

const KEYS = [
  ["Up, Down", "layer above, below"], ["Page Up, Page Down", "ten layers"], ["Left, Right", "motion before, after"], ["Space", "play, stop"],
  ["+, -", "zoom"], ["0", "whole part"], ["F", "layer that is nearest to a limit"], ["D", "three dimensions, or the layer"], ["N", "next finding or failed check"], ["L", "link to this view"], ["?", "this list"],
];

/** Build the page. @param {any} index @param {any} act handlers by name */
export function page(index, act) {
  const has = (/** @type {string} */ what) => what in MEASURES || index.slicers.length;
  const button = (/** @type {string} */ text, /** @type {string} */ title, /** @type {any} */ onclick) => make("button", { type: "button", title, onclick }, text);
  const check = (/** @type {string} */ text, /** @type {string} */ name, /** @type {any} */ onchange, /** @type {number} */ colour = -1) => {
    const box = make("input", { type: "checkbox", name, onchange });
    const label = make("label", {}, box, text);
    if (colour >= 0) label.style.borderLeft = `4px solid ${NAMED[colour % NAMED.length]}`;
    return label;
  };
  const select = (/** @type {string} */ title, /** @type {[string, string][]} */ options, /** @type {any} */ onchange) =>
    make("select", { title, onchange }, ...options.map(([value, text]) => make("option", { value }, text)));
  const slicers = index.slicers.map((/** @type {string} */ name) => /** @type {[string, string]} */ ([name, name]));

  const parts = {
    canvas: make("canvas", { id: "picture", tabIndex: 0, "aria-label": "picture of the layer" }),
    solid: make("canvas", { id: "solid", hidden: true, "aria-label": "the build in three dimensions" }),
    turned: button("3D", "the build in three dimensions, or the layer (D)", act.solid),
    strip: make("canvas", { id: "strip", title: "how near each layer is to its limits, one column a gate; click: go there" }),
    layer: make("input", { id: "layer", type: "range", min: 1, max: Math.max(index.layers, 1), step: 1, title: "layer", oninput: act.layer }),
    time: make("input", { id: "time", type: "range", min: 0, max: 1, step: "any", title: "time in the layer", oninput: act.time }),
    play: button("Play", "play or stop (Space)", act.play),
    speed: select("speed", [["1", "1 x"], ["10", "10 x"], ["60", "60 x"], ["600", "600 x"]], act.speed),
    said: make("div", { id: "said", role: "status" }),
    under: make("div", { id: "under" }),
    legend: make("div", { id: "legend" }),
    text: make("ol", { id: "text", title: "blocks of the program; click: go there" }),
    color: select("colour of beads", Object.entries(MEASURES).map(([name, [words]]) => /** @type {[string, string]} */ ([name, words])), act.color),
    first: select("slicer", slicers, act.pair), second: select("other slicer", slicers, act.pair),
    goal: make("input", { id: "goal", type: "search", placeholder: "layer, FILE:line or x, y", title: "go to a layer, a line of the program, or a place", onchange: act.goal }),
    show: index.slicers.map((/** @type {string} */ name, /** @type {number} */ n) => check(name, `show-${name}`, act.show, n)),
    draw: DRAWN.map((name) => check(/** @type {any} */ (WORDS)[name], `draw-${name}`, act.draw)),
    help: make("dialog", { id: "help" }),
  };
  parts.speed.value = "60";
  parts.help.append(make("h2", {}, "Keys"), make("dl", {}, ...KEYS.flatMap(([key, text]) => [make("dt", {}, key), make("dd", {}, text)])), button("Close", "close", () => parts.help.close()));
  const good = index.verdict === "VALIDATED" || index.verdict === "AGREED";
  const worst = index.strips.map((/** @type {any} */ strip) => button(`worst ${strip.gate}`, `layer nearest to the limit of ${strip.gate}`, () => act.worst(strip)));
  const notes = index.notes.map((/** @type {any} */ note) => make("li", { class: note.good ? "good" : "bad" },
    make("button", { type: "button", disabled: !note.layer && !note.line, title: note.layer || note.line ? "go there" : "it names no place", onclick: () => act.note(note) },
      make("b", {}, `${note.good ? "✓" : "✗"} ${note.name}`), ` ${note.text}`), note.good || !note.remedy ? "" : make("p", {}, note.remedy)));
  const bad = index.notes.filter((/** @type {any} */ note) => !note.good).length;

  const app = /** @type {HTMLElement} */ (document.getElementById("app"));
  app.append(
    make("header", {}, make("h1", {}, index.name || "viewer"), make("strong", { class: good ? "good" : "bad" }, index.verdict || ""), parts.goal,
      ...worst, parts.turned, button("PNG", "save the picture", act.png), button("SVG", "save the layer as SVG, in millimetres", act.svg), button("Link", "address of this view (L)", act.link), button("?", "keys", act.help)),
    make("main", {}, make("div", { id: "stage" }, parts.canvas, parts.solid, parts.under), make("div", { id: "layers" }, make("div", { id: "limits" }, make("div", { id: "gates" }, ...index.strips.map((/** @type {any} */ strip) => make("span", { title: `${strip.gate}: share of its limit` }, strip.gate.slice(0, 3)))), parts.strip), parts.layer)),
    make("footer", {}, parts.play, parts.speed, parts.time, parts.said),
    make("aside", {},
      make("section", {}, make("h2", {}, "Slicers"), ...parts.show),
      make("section", {}, make("h2", {}, "Layer"), ...parts.draw, has("pair") && slicers.length > 1 ? make("div", { class: "pair" }, parts.first, " and ", parts.second) : ""),
      make("section", {}, make("h2", {}, "Beads by"), parts.color, parts.legend),
      make("section", {}, make("h2", {}, "Program"), parts.text),
      make("section", {}, make("h2", {}, index.notes.length ? `Gates, findings, checks: ${bad ? `${bad} to look at` : "all passed"}` : "No run: nothing was judged"), make("ul", { id: "notes" }, ...notes))),
    parts.help);
  return parts;
}
