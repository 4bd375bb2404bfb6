// Colours that people with any sight tell apart: Okabe and Ito's for names, cividis for values.

export const NAMED = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c564b", "#7f7f7f"];
export const CURVE = "#cc00cc", ISLAND = "#8a8a8a", TRAVEL = "#b08d57", OVER = "#d50000";

const CIVIDIS = [[0, 34, 78], [18, 53, 112], [59, 73, 108], [87, 93, 109], [112, 113, 115], [138, 134, 121], [165, 156, 116], [195, 179, 105], [225, 204, 85], [253, 231, 55]];

/** Colour of a share 0 .. 1. @param {number} share */
export function scale(share) {
  const at = Math.min(Math.max(share, 0), 1) * (CIVIDIS.length - 1), k = Math.min(Math.floor(at), CIVIDIS.length - 2);
  const mixed = CIVIDIS[k].map((a, n) => Math.round(a + (at - k) * (CIVIDIS[k + 1][n] - a)));
  return `rgb(${mixed.join(",")})`;
}

/** Colour of a share of a limit: a scale up to it, red beyond. @param {number} share */
export const ofLimit = (share) => (share > 1 ? OVER : scale(share));
