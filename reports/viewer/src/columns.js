// Columns of integers, as `ebamcheck_viewer/columns.py` packs them, and the texts beside them; opened when they are first asked for.

/** @typedef {Record<string, Float64Array>} Columns */

const NUMBER_STEP = 10; // of block numbers that are left out
const KEPT = 32; // layers that stay open

/** @param {string} id @returns {Promise<Uint8Array>} */
async function opened(id) {
  const element = document.getElementById(id);
  if (!element) return new Uint8Array(0);
  const raw = atob(element.textContent || "");
  const bytes = Uint8Array.from(raw, (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Columns by their names. @param {Uint8Array} bytes @returns {Columns} */
export function unpacked(bytes) {
  /** @type {Columns} */
  const found = {};
  let at = 0;
  const number = () => {
    let value = 0, scale = 1, byte = 0;
    do {
      byte = bytes[at++];
      value += (byte & 127) * scale;
      scale *= 128;
    } while (byte & 128);
    return value % 2 ? -(value + 1) / 2 : value / 2; // zigzag
  };
  while (at < bytes.length) {
    const size = bytes[at++];
    const name = String.fromCharCode(...bytes.subarray(at, at + size));
    at += size;
    const column = new Float64Array(number());
    for (let k = 0, sum = 0; k < column.length; k++) column[k] = sum += number();
    found[name] = column;
  }
  return found;
}

/** Layers and texts of the page, each opened once while it stays among those asked for last. */
export class Store {
  constructor() {
    /** @type {Map<string, Promise<any>>} */
    this.held = new Map();
  }

  /** @template T @param {string} id @param {(bytes: Uint8Array) => T} read @returns {Promise<T>} */
  get(id, read) {
    const found = this.held.get(id) || opened(id).then(read);
    this.held.delete(id);
    this.held.set(id, found);
    for (const old of this.held.keys()) if (this.held.size > KEPT) this.held.delete(old);
    return found;
  }

  /** @param {number} layer counted from 1 @returns {Promise<Columns>} */
  layer(layer) {
    return this.get(`L${layer}`, unpacked);
  }

  /** Lines of a file of the program. @param {string} file @returns {Promise<string[]>} */
  lines(file) {
    return this.get(`T${file}`, (bytes) => {
      let number = 0;
      return new TextDecoder("latin1").decode(bytes).split("\n").map((text) => {
        const given = /^N(\d+) /.exec(text);
        if (given) number = Number(given[1]);
        return text.startsWith("\x01") ? `N${(number += NUMBER_STEP)} ${text.slice(1)}` : text;
      });
    });
  }
}
